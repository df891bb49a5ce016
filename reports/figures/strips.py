"""Pose strips: one row for each method, the same moments side by side (as in the 2020 paper's figures 5 to 7)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from benchmark.motion.clip import MotionClip
from reports.drawing import Drawing
from reports.figures.bodies import draw_body
from reports.figures.style import FAINT, INK, PAGE, new_figure, style
from reports.run import FLOOR, RunView

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

#: Seen from 50 degrees to the figure's left and a little above: arms, legs and trunk all show.
_TURN, _TILT = np.deg2rad(50.0), np.deg2rad(8.0)
_LABEL_WIDTH, _ROW_HEIGHT = 1.15, 0.92


def moments(clip: MotionClip, poses: int) -> list[int]:
    """Indices of ``poses`` frames spread evenly from the first to the last; fewer for a shorter clip."""
    return sorted(set(np.linspace(0, len(clip) - 1, poses).round().astype(int).tolist()))


def strip(rows: Sequence[tuple[str, MotionClip]], *, poses: int = 10) -> Figure:
    """Draw ``poses`` moments of each clip, from its first frame to its last, one clip a row.

    Under each pose stands its time in seconds, so that a change of tempo shows. Bodies keep their true relative size.
    """
    tallest = max(float(np.percentile(clip.positions[..., 1], 99.5)) for _, clip in rows)
    below, above = 0.27 * tallest, 1.14 * tallest
    with style():
        figure = new_figure(PAGE, _ROW_HEIGHT * len(rows) + 0.05)
        grid = figure.subplots(len(rows), 1, squeeze=False)[:, 0]
        figure.subplots_adjust(left=_LABEL_WIDTH / PAGE, right=1.0, bottom=0.02, top=1.0, hspace=0.05)
        # Metres across a row when the figure's height fills it.
        across = (PAGE - _LABEL_WIDTH) / (_ROW_HEIGHT * 0.93) * (below + above)
        spacing = across / poses
        for axes, (label, clip) in zip(grid, rows, strict=True):
            axes.axhline(0.0, color=FAINT, linewidth=0.8, zorder=0)
            for column, frame in enumerate(moments(clip, poses)):
                at = (column + 0.5) * spacing
                draw_body(axes, clip.skeleton, clip.positions[frame], at=at, turn=_TURN, tilt=_TILT)
                moment = f"{frame / clip.fps:.2f} s"
                axes.text(at, -0.2 * tallest, moment, ha="center", va="center", fontsize=5.5, color=INK)
            axes.set_xlim(0.0, across)
            axes.set_ylim(-below, above)
            axes.set_aspect("equal", anchor="W")
            axes.axis("off")
            # The margin holds 18 letters of this size; a longer name is set smaller, not cut.
            size = 7.5 * min(1.0, 18 / max(map(len, label.split("\n"))))
            axes.text(-0.01, 0.5, label, transform=axes.transAxes, ha="right", va="center", fontsize=size)
    return figure


def poses_table(rows: Sequence[tuple[str, MotionClip]], *, poses: int = 10) -> pd.DataFrame:
    """The joint positions drawn by :func:`strip`, one row for each joint of each pose, in metres."""
    import pandas as pd

    parts = []
    for label, clip in rows:
        for frame in moments(clip, poses):
            part = pd.DataFrame(clip.positions[frame], columns=["x", "y", "z"])
            part.insert(0, "joint", list(clip.skeleton.names))
            part.insert(0, "seconds", frame / clip.fps)
            part.insert(0, "row", label.replace("\n", " "))
            parts.append(part)
    return pd.concat(parts, ignore_index=True)


def pose_strips(run: RunView) -> list[Drawing]:
    """One strip for each task: the source clip that moves most, as every method renders it, and a real performer."""
    drawings = []
    for task in run.tasks:
        chosen = run.showpiece(task)
        if chosen is None:
            continue
        source_style, _, target_style = task.partition(":")
        rows = [
            (f"{source_style} input" if method == FLOOR else run.label(method).replace("[", "\n["), clip)
            for method, clip in run.renderings(task, chosen)
        ]
        facts = run.clip_facts(chosen)
        who = f"{facts['actor'] or 'an unnamed actor'} ({'seen' if facts['seen_actor'] else 'not seen'} in training)"
        drawings.append(
            Drawing(
                name=f"pose-strip-{source_style}-to-{target_style}",
                figure=strip(rows),
                caption=(
                    f"{run.dataset_title}: \u201c{facts['action'].replace('-', ' ')}\u201d by {who}, "
                    f"{source_style} to {target_style}. "
                    "One row for each method's raw result for the same source clip (the input is on the target's body); the "
                    "last row is a held-out performer of the target style. Ten moments from the first frame to the last, with "
                    "their times. Blue: left, orange: right."
                ),
                data=poses_table(rows),
            )
        )
    return drawings
