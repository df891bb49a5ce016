"""Pose strips: one row for each method, the same moments side by side (as in the 2020 paper's figures 5 to 7)."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from benchmark.api import NotApplicableError
from benchmark.motion.canonical import heading
from eval.metrics.jump import names_a_jump
from reports.drawing import Drawing
from reports.figures.families import families, family, representatives
from reports.figures.mannequin import Camera, Seen, body_points, draw, floor, see
from reports.figures.moments import ALIKE, PAPER_FPS, STATED, Row, matching, sample, stretch
from reports.figures.style import INK, MUTED, PAGE, new_figure, style
from reports.run import FLOOR, RunView
from reports.sources import source_clip

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

#: Frames of the paper between poses, of methods side by side and of variants of one method.
STEP, ABLATION_STEP = 5, 3
POSES = 12
_LABEL_WIDTH, _HEAD, _GAP, _EDGE, _BETWEEN = 1.16, 0.17, 0.05, 0.04, 0.26
#: A body is at most so many inches tall, the second figure where few rows leave room for it.
_TALLEST, _FEW_ROWS = (0.95, 1.2), 6
#: Of the room that two neighbours would need to stand clear of one another, they get this share.
_CLOSE = 0.9
#: Metres of floor before and behind the figures.
_FLOOR = 0.3


def row_poses(row: Row, camera: Camera) -> list[Seen]:
    """The poses of a row, from a camera that keeps its angle to where the figure faces on the whole."""
    towards = sample(np.exp(1j * heading(row.clip)), row.clip, row.times).mean()
    seen_from = camera.turned(float(np.angle(towards)))
    points = sample(body_points(row.clip), row.clip, row.times)
    return [see(row.clip.skeleton, pose, seen_from) for pose in points]


@dataclass(frozen=True, eq=False)
class _Column:
    """The poses of one source clip: lines of poses (none where a method has no result), and where they stand."""

    lines: list[list[Seen] | None]
    lefts: NDArray[np.float64]
    gaps: NDArray[np.float64]
    right: float

    @property
    def width(self) -> float:
        """Metres that it needs."""
        return float(self.lefts[0] + self.gaps.sum() + self.right)

    def places(self, spare: float) -> NDArray[np.float64]:
        """Where each pose stands from the column's left edge, with ``spare`` metres more between them."""
        gaps = self.gaps + spare / max(len(self.gaps), 1)
        return self.lefts[0] + np.concatenate([[0.0], np.cumsum(gaps)])


def _column(rows: Sequence[Row | None], camera: Camera) -> _Column:
    lines = [None if row is None else row_poses(row, camera) for row in rows]
    count = max(len(line) for line in lines if line is not None)
    whole = [line for line in lines if line is not None and len(line) == count]
    lefts = np.max([[-pose.extent[0] for pose in line] for line in whole], axis=0)
    right = max(line[-1].extent[1] for line in whole)
    spans = [[a.extent[1] - b.extent[0] for a, b in itertools.pairwise(line)] for line in whole]
    return _Column(lines, lefts, _CLOSE * np.max(spans, axis=0) if count > 1 else np.zeros(0), right)


def strip(columns: Sequence[Sequence[Row | None]], *, heads: Sequence[str] = (), rules: Collection[int] = ()) -> Figure:
    """Draw the moments of each row side by side, to one scale for all bodies.

    Poses are as far apart as the widest ones need. Above stand the times of the first row; beside each row of a single column
    its own.

    Parameters
    ----------
    columns
        For each source clip its rows; ``None`` where there is no result. All have the same rows.
    heads
        What stands above each column.
    rules
        Indices of rows that begin a new block.
    """
    camera = Camera()
    with style():
        drawn = [_column(rows, camera) for rows in columns]
        named = [next(row for row in line if row is not None) for line in zip(*columns, strict=True)]
        poses = [[pose for column in drawn for pose in column.lines[index] or ()] for index in range(len(named))]
        heights = [max(pose.extent[3] for pose in line) for line in poses]
        depths = [min(-0.06, *(pose.extent[2] for pose in line)) for line in poses]
        across = PAGE - _LABEL_WIDTH - _EDGE - _BETWEEN * (len(drawn) - 1)
        needed = sum(column.width for column in drawn)
        scale = min(across / needed, _TALLEST[len(named) <= _FEW_ROWS] / max(heights))
        # What a low scale leaves over goes between the poses, to each column by the poses it has.
        spare = across / scale - needed
        shares = np.array([len(column.gaps) for column in drawn], dtype=float)
        shares = shares / shares.sum() if shares.any() else np.full(len(drawn), 1.0 / len(drawn))
        head = _HEAD + (0.15 if heads else 0.0)
        sizes = [(high - low) * scale for high, low in zip(heights, depths, strict=True)]
        height = head + sum(sizes) + _GAP * len(named) + 0.06 * len(rules)
        figure = new_figure(PAGE, height)
        left = _LABEL_WIDTH
        for number, column in enumerate(drawn):
            extra = spare * float(shares[number])
            width, at, top = (column.width + extra) * scale, column.places(extra), height - head
            if heads:
                figure.text(
                    left / PAGE, 1.0 - 0.06 / height, heads[number], ha="left", va="center", fontsize=7, color=INK
                )
            times = next(row for row in columns[number] if row is not None).times
            for x, time in zip(at, times, strict=False):
                figure.text(
                    (left + x * scale) / PAGE,
                    1.0 - (head - 0.11) / height,
                    f"{time:.2f} s",
                    ha="center",
                    va="center",
                    fontsize=5.5,
                    color=MUTED,
                )
            for index, (line, size) in enumerate(zip(column.lines, sizes, strict=True)):
                top -= 0.06 if index in rules else 0.0
                axes = figure.add_axes((left / PAGE, (top - size) / height, width / PAGE, size / height))
                axes.set_xlim(0.0, width / scale)
                axes.set_ylim(depths[index], heights[index])
                floor(axes, 0.0, width / scale, camera, depth=_FLOOR)
                if line is None:
                    axes.text(0.5, 0.5, "no result", transform=axes.transAxes, ha="center", fontsize=6, color=MUTED)
                else:
                    draw(axes, list(zip(line, at, strict=False)))
                axes.axis("off")
                if number == 0:
                    _label(figure, named[index], (top - 0.5 * size) / height, height, span=len(drawn) == 1)
                top -= size + _GAP
            left += width + _BETWEEN
    return figure


def _label(figure: Figure, row: Row, y: float, height: float, *, span: bool) -> None:
    # The margin holds 18 letters of this size; a longer name is set smaller, not cut.
    lines = row.label.split("\n")
    size = 7.5 * min(1.0, 18 / max(map(len, lines)))
    right = (_LABEL_WIDTH - 0.08) / PAGE
    lift = 0.05 / height if span else 0.0
    figure.text(right, y + lift, row.label, ha="right", va="center", fontsize=size, color=INK)
    if span:
        drop = (0.055 * len(lines) + 0.02) / height
        text = f"{row.times[0]:.2f}\u2013{row.times[-1]:.2f} s" if len(row.times) > 1 else f"{row.times[0]:.2f} s"
        figure.text(right, y - drop, text, ha="right", va="center", fontsize=5.5, color=MUTED)


def poses_table(rows: Sequence[Row]) -> pd.DataFrame:
    """The joint positions drawn by :func:`strip`, one row for each joint of each pose: seconds of the row's clip, metres."""
    import pandas as pd

    parts = []
    for row in rows:
        for column, (time, pose) in enumerate(
            zip(row.times, sample(row.clip.positions, row.clip, row.times), strict=True)
        ):
            part = pd.DataFrame(pose, columns=["x", "y", "z"])
            part.insert(0, "joint", list(row.clip.skeleton.names))
            part.insert(0, "seconds", time)
            part.insert(0, "pose", column)
            part.insert(0, "row", row.label.replace("\n", ""))
            parts.append(part)
    return pd.concat(parts, ignore_index=True)


def strip_rows(
    run: RunView, task: str, clip_id: str, methods: Iterable[str], *, step: int, poses: int = POSES
) -> list[Row]:
    """The input, the ``methods`` that have a result for it, and a real performer where there is one.

    The input is shown on its performer's own body where the data set can be read, else as the floor method has it.
    """
    cells = {cell.method: cell for cell in reversed(run.cells(task))}
    clips = dict(run.renderings(task, clip_id))
    source = source_clip(run, clip_id)
    on_own_body = source is not None
    source = source if source is not None else clips.get(FLOOR, next(iter(clips.values())))
    times = stretch(source, step=step, poses=poses)
    style_name = task.partition(":")[0]
    note = "" if on_own_body else "\n(target's body)"
    rows = [Row(f"{style_name} input{note}", source, times)]
    for method in dict.fromkeys((*methods, run.real_method)):
        if method == FLOOR or method not in clips:
            continue
        item = cells[method].item(clip_id) or {}
        shown, how = matching(
            source,
            times,
            clips[method],
            time_map=cells[method].time_map(clip_id),
            copied=bool(item.get("copied_from")),
        )
        rows.append(Row(run.label(method).replace("[", "\n["), clips[method], shown, how))
    return rows


def pose_strips(run: RunView) -> list[Drawing]:
    """Strips for each task: the source clip that moves most, a jump, and the variants of each method that has some."""
    drawings = []
    for task in run.tasks:
        chosen = run.showpiece(task)
        if chosen is None:
            continue
        stem = task.replace(":", "-to-")
        methods = run.methods(task)
        shown = representatives(methods)
        jump = None if names_a_jump(run.clip_facts(chosen)["action"]) else highest_jump(run, task)
        for name, clip_id in ((f"pose-strip-{stem}", chosen), (f"pose-strip-{stem}-jump", jump)):
            if clip_id is not None:
                rows = strip_rows(run, task, clip_id, shown, step=STEP)
                left_out = [method for method in methods if method not in shown]
                drawings.append(
                    Drawing(name, strip([rows]), _caption(run, task, clip_id, rows, STEP, left_out), poses_table(rows))
                )
        for name, members in families(methods).items():
            if len(members) > 1:
                rows = strip_rows(run, task, chosen, members, step=ABLATION_STEP)
                drawings.append(
                    Drawing(
                        f"ablation-strip-{stem}-{name}",
                        strip([rows]),
                        _caption(run, task, chosen, rows, ABLATION_STEP, []),
                        poses_table(rows),
                    )
                )
    if not drawings:
        raise NotApplicableError("no method has a result for any clip")
    return drawings


def highest_jump(run: RunView, task: str) -> str | None:
    """The transferred clip of a jump, one "as high as you can" before others; ``None`` where nobody jumps."""
    names: dict[str, str] = {}
    for cell in run.cells(task):
        names.update({item["clip_id"]: item["action"] for item in cell.items if item["state"] == "ok"})
    jumps = sorted(clip_id for clip_id, action in names.items() if names_a_jump(action))
    return min(jumps, key=lambda clip_id: ("high" not in names[clip_id], "one-leg" in names[clip_id]), default=None)


def _caption(run: RunView, task: str, clip_id: str, rows: Sequence[Row], step: int, left_out: Sequence[str]) -> str:
    source_style, _, target_style = task.partition(":")
    facts = run.clip_facts(clip_id)
    who = f"{facts['actor'] or 'an unnamed actor'} ({'seen' if facts['seen_actor'] else 'not seen'} in training)"
    times = rows[0].times
    gap = step / PAPER_FPS
    text = (
        f"{run.dataset_title}, {source_style} to {target_style}: \u201c{facts['action'].replace('-', ' ')}\u201d by {who}, "
        f"n = 1 clip ({clip_id}), raw results, first repetition. A pose every {step} frames at {PAPER_FPS:g} frames a second "
        f"({gap:.3f} s): {len(times)} poses from {times[0]:.2f} to {times[-1]:.2f} s (frames {times[0] * PAPER_FPS:.0f} to "
        f"{times[-1] * PAPER_FPS:.0f}), where the input moves most. "
    )
    stated, alike = (
        [row.label.replace("\n", "") for row in rows if row.how == how and row is not rows[0]]
        for how in (STATED, ALIKE)
    )
    text += "Columns show the same phase: rows at the input's times"
    if stated:
        text += f"; {', '.join(stated)} by the source times that they state"
    if alike:
        text += (
            f"; of {', '.join(alike)}, which show other performances, the stretch most like the input, evenly spaced "
            "in its own time"
        )
    text += ". Beside each row its own times. All bodies are to one scale; left limbs are blue, right ones orange."
    if "target's body" in rows[0].label:
        text += " The input is shown on the target's body, since its data set could not be read."
    if left_out:
        others = sorted({family(method) for method in left_out})
        text += f" Variants of {', '.join(others)} are shown in a figure of their own."
    return text
