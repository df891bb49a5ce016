"""Paths of hips and feet from above, the content's under each method's, as in figures 5 and 6 of the 2021 paper."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from benchmark.api import NotApplicableError
from benchmark.motion.clip import MotionClip
from benchmark.motion.contacts import detect
from benchmark.motion.skeleton import SIDES
from reports.drawing import Drawing
from reports.figures.families import representatives
from reports.figures.style import FAINT, INK, LEFT, MUTED, PAGE, RIGHT, new_figure, style
from reports.run import FLOOR, RunView

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DEVIATION, HEADING = "content/trajectory-deviation", "content/heading-deviation"
#: Clips shown for each task, panels in a row, and rows that are shown with all their variants.
_CLIPS, _COLUMNS, _MOST = 2, 4, 11
_LOOKS = {"hips": (INK, 1.1), "left": (LEFT, 0.7), "right": (RIGHT, 0.7)}


def paths(clip: MotionClip) -> dict[str, NDArray[np.float64]]:
    """(T, 2) paths over the floor in leg lengths from where the hips start: across (to the left) and ahead.

    ``hips``, and ``left`` and ``right``: the ankles.
    """
    skeleton = clip.skeleton
    floor = clip.positions[..., [0, 2]] / skeleton.leg_length
    floor = floor - floor[0, skeleton.joint("hips")]
    found = {"hips": floor[:, skeleton.joint("hips")]}
    for side in SIDES:
        if skeleton.has(f"{side}_ankle"):
            found[side] = floor[:, skeleton.joint(f"{side}_ankle")]
    return found


def footprints(clip: MotionClip) -> dict[str, NDArray[np.float64]]:
    """(N, 2) where each foot stood, in the terms of :func:`paths`: the mean place of the ankle in each contact."""
    own = paths(clip)
    contacts = detect(clip)
    found = {}
    for side in SIDES:
        if side in own:
            flags = np.concatenate([[False], contacts.side(side), [False]])
            edges = np.flatnonzero(flags[1:] != flags[:-1]).reshape(-1, 2)
            found[side] = np.array([own[side][start:stop].mean(axis=0) for start, stop in edges]).reshape(-1, 2)
    return found


def travellers(run: RunView, task: str, count: int = _CLIPS) -> list[str]:
    """The source clips whose hips come farthest over the floor, each of another action; those that most methods have first."""
    cells = run.cells(task)
    first = next((cell for cell in cells if cell.method == FLOOR), cells[0] if cells else None)
    if first is None:
        return []
    reach: dict[str, tuple[int, float]] = {}
    actions = {}
    for item in first.items:
        clip = first.clip(item["clip_id"])
        if clip is not None:
            hips = paths(clip)["hips"]
            have = sum(cell.item(item["clip_id"]) is not None for cell in cells)
            reach[item["clip_id"]] = (have, float(np.ptp(hips, axis=0).max()))
            actions[item["clip_id"]] = item["action"]
    chosen: list[str] = []
    for clip_id in sorted(reach, key=lambda name: (-reach[name][0], -reach[name][1], name)):
        if actions[clip_id] not in {actions[other] for other in chosen}:
            chosen.append(clip_id)
    return chosen[:count]


def deviations(run: RunView, task: str, clip_id: str) -> dict[str, float]:
    """The stored deviation of each method's path for one clip, leg lengths, mean over repetitions."""
    rows = run.results
    keep = (rows["task"] == task) & (rows["clip_id"] == clip_id) & (rows["variant"] == "raw")
    rows = rows[keep & (rows["metric"] == DEVIATION) & (rows["status"] == "ok")]
    return {str(name): float(value) for name, value in rows.groupby("method")["value"].mean().items()}


def overhead(clips: dict[str, MotionClip], stated: dict[str, float], labels: dict[str, str], content: str) -> Figure:
    """Draw a panel for each clip, all to one scale, with the content's hips behind each."""
    drawn = {method: paths(clip) for method, clip in clips.items()}
    everything = np.concatenate([path for own in drawn.values() for path in own.values()])
    low, high = everything.min(axis=0), everything.max(axis=0)
    # The longer way of walking runs across the page, so that panels are wide rather than tall.
    turned = bool(high[1] - low[1] > high[0] - low[0])
    axes_of = [1, 0] if turned else [0, 1]
    low, high = low[axes_of], high[axes_of]
    pad = 0.06 * float((high - low).max()) + 0.1
    low, high = low - pad, high + pad
    columns = min(_COLUMNS, len(drawn)) if (high - low)[0] < 2.6 * (high - low)[1] else min(2, len(drawn))
    rows = -(-len(drawn) // columns)
    with style():
        width = (PAGE - 0.1) / columns
        tall = float(np.clip(width * 0.94 * (high - low)[1] / (high - low)[0], 0.35, 2.2))
        head, foot = 0.2, 0.34
        height = rows * (tall + head) + foot
        figure = new_figure(PAGE, height)
        for index, (method, own) in enumerate(drawn.items()):
            row, column = divmod(index, columns)
            left = (0.05 + column * width) / PAGE
            bottom = 1.0 - ((row + 1) * (tall + head)) / height
            axes = figure.add_axes((left, bottom, 0.95 * width / PAGE, tall / height))
            if method != content:
                axes.plot(
                    *drawn[content]["hips"][:, axes_of].T,
                    color="#b5b5b5",
                    linewidth=2.6,
                    solid_capstyle="round",
                    zorder=0,
                )
            _panel(axes, own, footprints(clips[method]), axes_of)
            axes.set_xlim(low[0], high[0])
            axes.set_ylim(low[1], high[1])
            axes.set_aspect("equal")
            axes.set_xticks([])
            axes.set_yticks([])
            for spine in axes.spines.values():
                spine.set(visible=True, color=FAINT)
            axes.set_title(labels[method], loc="left", fontsize=7, pad=2.5)
            if method in stated and method != content:
                axes.set_title(f"{stated[method]:.2f} leg", loc="right", fontsize=6, color=MUTED, pad=2.5)
        _scale(figure, width, (high - low)[0])
        _legend(figure)
    return figure


def _panel(
    axes: Axes, own: dict[str, NDArray[np.float64]], feet: dict[str, NDArray[np.float64]], order: list[int]
) -> None:
    for name, path in reversed(own.items()):
        colour, width = _LOOKS[name]
        axes.plot(*path[:, order].T, color=colour, linewidth=width, alpha=1.0 if name == "hips" else 0.65, zorder=2)
    for side, places in feet.items():
        axes.plot(*places[:, order].T, "o", color=_LOOKS[side][0], markersize=2.2, markeredgewidth=0, zorder=3)
    hips = own["hips"][:, order]
    axes.plot(*hips[0], "o", color="white", markeredgecolor=INK, markersize=3.6, markeredgewidth=0.8, zorder=4)
    axes.plot(*hips[-1], "s", color=INK, markersize=3.2, markeredgewidth=0, zorder=4)


def _scale(figure: Figure, width: float, span: float) -> None:
    """A bar of a round number of leg lengths at the foot of the page."""
    height = figure.get_size_inches()[1]
    leg = next(size for size in (5.0, 2.0, 1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01) if size < 0.6 * span or size == 0.01)
    length = leg / span * 0.95 * width
    axes = figure.add_axes((0.05 / PAGE, 0.0, 2.0 / PAGE, 0.3 / height))
    axes.plot([0.0, length], [0.1, 0.1], color=INK, linewidth=1.4, solid_capstyle="butt")
    axes.text(length + 0.06, 0.1, f"{leg:g} leg length{'' if leg == 1 else 's'}", va="center", fontsize=6.5)
    axes.set_xlim(0.0, 2.0)
    axes.set_ylim(0.0, 0.3)
    axes.axis("off")


def _legend(figure: Figure) -> None:
    from matplotlib.lines import Line2D

    entries = {
        "content, hips": Line2D([], [], color="#b5b5b5", linewidth=2.6),
        "hips": Line2D([], [], color=INK, linewidth=1.1),
        "left foot": Line2D([], [], color=LEFT, linewidth=0.9, marker="o", markersize=2.4),
        "right foot": Line2D([], [], color=RIGHT, linewidth=0.9, marker="o", markersize=2.4),
        "start": Line2D([], [], color="white", markeredgecolor=INK, marker="o", markersize=3.6, linestyle="none"),
        "end": Line2D([], [], color=INK, marker="s", markersize=3.2, linestyle="none"),
    }
    figure.legend(
        list(entries.values()),
        list(entries),
        loc="lower right",
        bbox_to_anchor=(0.995, 0.0),
        ncols=len(entries),
        frameon=False,
        handlelength=1.6,
        columnspacing=1.2,
        borderaxespad=0.0,
        fontsize=6.5,
    )


def paths_table(clips: dict[str, MotionClip], labels: dict[str, str]) -> pd.DataFrame:
    """The numbers drawn: ``row, part, seconds, across, ahead``, leg lengths."""
    import pandas as pd

    parts = [
        pd.DataFrame(
            {"row": labels[method], "part": name, "seconds": clip.times, "across": path[:, 0], "ahead": path[:, 1]}
        )
        for method, clip in clips.items()
        for name, path in paths(clip).items()
    ]
    return pd.concat(parts, ignore_index=True)


def trajectories(run: RunView) -> list[Drawing]:
    """Paths over the floor for each task: the clips that go farthest, one panel for each method."""
    drawings = []
    for task in run.tasks:
        for rank, clip_id in enumerate(travellers(run, task)):
            clips = dict(run.renderings(task, clip_id))
            if len(clips) > _MOST:
                shown = {*representatives(clips), FLOOR, run.real_method}
                clips = {method: clip for method, clip in clips.items() if method in shown}
            content = FLOOR if FLOOR in clips else next(iter(clips))
            source = task.partition(":")[0]
            labels = {
                method: f"{source} input" if method == content == FLOOR else run.label(method) for method in clips
            }
            stated = deviations(run, task, clip_id)
            drawings.append(
                Drawing(
                    name=f"trajectories-{task.replace(':', '-to-')}" + ("" if rank == 0 else f"-{rank + 1}"),
                    figure=overhead(clips, stated, labels, content),
                    caption=_caption(run, task, clip_id),
                    data=paths_table(clips, labels),
                )
            )
    if not drawings:
        raise NotApplicableError("no method has a result for any clip")
    return drawings


def _caption(run: RunView, task: str, clip_id: str) -> str:
    facts = run.clip_facts(clip_id)
    return (
        f"{run.dataset_title}, {task.replace(':', ' to ')}: paths of hips and ankles from above, "
        f"\u201c{facts['action'].replace('-', ' ')}\u201d by {facts['actor'] or 'an unnamed actor'}, n = 1 clip ({clip_id}), "
        "raw results, first repetition. Leg lengths of each body, all panels to one scale, every path from where the hips "
        "start; dots: where a foot stood. Grey: the hips of the content. At the right of each title the mean deviation from it "
        f"as stored ({DEVIATION}; it first turns the path to fit best)."
    )
