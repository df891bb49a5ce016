"""Which joints a method changes: mean turn of each against the source, methods by joints."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from benchmark.api import NotApplicableError
from benchmark.motion import quat
from benchmark.motion.clip import MotionClip
from benchmark.motion.dtw import dtw
from benchmark.motion.pose import segment_directions
from benchmark.motion.skeleton import ROLES, SIDES
from eval.metrics.content import compared_joints, facing_rotations
from eval.metrics.shared import stride
from reports.drawing import Drawing
from reports.figures.style import INK, MUTED, PAGE, name_rows, new_figure, style
from reports.run import FLOOR, RunView, StoredCell

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

#: Clips that are looked at, for each method.
_MOST = 24


def joint_changes(
    clip: MotionClip, source: MotionClip, time_map: NDArray[np.float64] | None, *, copied: bool
) -> dict[str, float]:
    """Mean geodesic angle in degrees between local rotations of result and source, by joint role; the root without its heading.

    Frames correspond by the stated source times, else one by one where both last as long, else by time warping of the
    directions of limbs.

    Parameters
    ----------
    clip
        The result.
    source
        The source on the same skeleton.
    time_map
        (T,) source time of each frame of the result, if stated.
    copied
        Whether the result is another performance.
    """
    joints = compared_joints(clip.skeleton)
    ours, theirs = facing_rotations(clip, joints), facing_rotations(source, joints)
    if time_map is not None and len(time_map) == len(clip):
        rate = source.fps / stride(source.fps)
        paired = np.clip(np.round(time_map[:: stride(clip.fps)] * rate).astype(int), 0, len(theirs) - 1)
        mine = np.arange(len(ours))
    elif not copied and len(clip) == len(source):
        mine = paired = np.arange(len(ours))
    else:
        left, right = (
            segment_directions(part)[:: stride(part.fps)].reshape(-1, 3 * _segments(part)) for part in (clip, source)
        )
        mine, paired = dtw(left, right).path.T
    angles = np.degrees(quat.angle(ours[mine], theirs[paired]).mean(axis=0))
    roles = {joint: role for role, joint in clip.skeleton.roles.items()}
    return {roles[joint]: float(angle) for joint, angle in zip(joints, angles, strict=True)}


def _segments(clip: MotionClip) -> int:
    return segment_directions(clip.frames(0, 1)).shape[1]


def chosen_clips(cells: list[StoredCell], count: int = _MOST) -> list[str]:
    """At most ``count`` clips that the floor has a result for, spread over the order in which they were transferred."""
    floor = next((cell for cell in cells if cell.method == FLOOR), None)
    names = [] if floor is None else [item["clip_id"] for item in floor.items if item["state"] == "ok"]
    return [names[i] for i in sorted(set(np.linspace(0, len(names) - 1, min(count, len(names))).round().astype(int)))]


def changes_table(run: RunView, task: str) -> pd.DataFrame:
    """``task, method, label, joint, degrees, n``: means over clips, first repetition, raw results."""
    import pandas as pd

    cells = {cell.method: cell for cell in reversed(run.cells(task))}
    names = chosen_clips(list(cells.values()))
    sources = {name: cells[FLOOR].clip(name) for name in names}
    rows = []
    for method in run.methods(task):
        if method not in cells or method == FLOOR:
            continue
        found: dict[str, list[float]] = {}
        for name, source in sources.items():
            item, clip = cells[method].item(name), cells[method].clip(name)
            # A real performer has a body of its own; angles compare where it is the same tree of joints.
            if clip is None or source is None or item is None or not clip.skeleton.same_topology(source.skeleton):
                continue
            changes = joint_changes(clip, source, cells[method].time_map(name), copied=bool(item.get("copied_from")))
            for role, angle in changes.items():
                found.setdefault(role, []).append(angle)
        rows += [
            {
                "task": task,
                "method": method,
                "label": run.label(method),
                "joint": role,
                "degrees": float(np.mean(found[role])),
                "n": len(found[role]),
            }
            for role in ROLES
            if role in found
        ]
    return pd.DataFrame(rows)


def _order(roles: list[str]) -> list[str]:
    """Trunk from below, then arms and legs, left beside right."""
    trunk = [role for role in roles if not role.startswith(SIDES)]
    limbs = [role.partition("_")[2] for role in ROLES if role.startswith("left_")]
    return trunk + [f"{side}_{limb}" for limb in limbs for side in SIDES if f"{side}_{limb}" in roles]


def heat_map(table: pd.DataFrame, *, real: str) -> Figure:
    """Draw methods by joints, darker the more a joint is turned; numbers in degrees."""
    import matplotlib as mpl

    grid = table.pivot(index="method", columns="joint", values="degrees")
    methods = list(dict.fromkeys(table["method"]))
    joints = _order([role for role in ROLES if role in grid.columns])
    values = grid.loc[methods, joints].to_numpy(dtype=float)
    labels = dict(zip(table["method"], table["label"], strict=True))
    with style():
        width = min(PAGE, 1.3 + 0.6 + 0.265 * len(joints))
        height = 0.75 + 0.235 * len(methods)
        figure = new_figure(width, height)
        axes = figure.add_axes((1.2 / width, 0.06 / height, (width - 1.75) / width, (height - 0.75) / height))
        # Real performers differ by more than any method; the scale is the methods' own, so that these can be told apart.
        own = values[[method != real for method in methods]]
        top = float(np.nanpercentile(own, 98)) if np.isfinite(own).any() else float(np.nanmax(values))
        top = max(top, 1e-3)
        image = axes.imshow(values, cmap="Blues", vmin=0.0, vmax=top, aspect="auto")
        for row, column in np.argwhere(np.isfinite(values)):
            value = values[row, column]
            ink = "white" if value > 0.6 * top else INK
            axes.text(
                column,
                row,
                f"{value:.0f}" if value >= 9.95 else f"{value:.1f}",
                ha="center",
                va="center",
                fontsize=5.0,
                color=ink,
            )
        axes.set_xticks(
            range(len(joints)), [role.replace("_", " ") for role in joints], rotation=60, ha="left", fontsize=6
        )
        axes.xaxis.tick_top()
        name_rows(axes, range(len(methods)), [labels[method] for method in methods], 1.13)
        axes.tick_params(length=0, pad=2)
        for spine in axes.spines.values():
            spine.set_visible(False)
        axes.set_xticks(np.arange(len(joints) + 1) - 0.5, minor=True)
        axes.set_yticks(np.arange(len(methods) + 1) - 0.5, minor=True)
        axes.grid(which="minor", color="white", linewidth=1.0)
        axes.tick_params(which="minor", length=0)
        bar = figure.add_axes(((width - 0.45) / width, 0.06 / height, 0.09 / width, (height - 0.75) / height))
        figure.colorbar(image, cax=bar, extend="max" if np.nanmax(values) > top else "neither")
        bar.tick_params(labelsize=5.5, length=2, colors=MUTED)
        bar.set_title("deg", fontsize=6, loc="left")
        bar.yaxis.set_major_locator(mpl.ticker.MaxNLocator(4))
    return figure


def joint_change(run: RunView) -> list[Drawing]:
    """The heat map of each task, with real performers as the last row where their bodies have the same joints."""
    drawings = []
    for task in run.tasks:
        table = changes_table(run, task)
        if table.empty:
            continue
        clips = int(table["n"].max())
        whole = sum(item["state"] == "ok" for item in next(c for c in run.cells(task) if c.method == FLOOR).items)
        some = (
            f"{clips} of {whole} clips, spread over the test set"
            if clips < whole
            else f"{clips} clip{'s' * (clips > 1)}"
        )
        drawings.append(
            Drawing(
                name=f"joint-change-{task.replace(':', '-to-')}",
                figure=heat_map(table, real=run.real_method),
                caption=(
                    f"{run.dataset_title}, {task.replace(':', ' to ')}: mean angle in degrees by which each joint's rotation "
                    f"differs from the source's (hips: without heading), n = {some}, raw results, first repetition. Frames are "
                    "paired by the source times a method states, one by one where it keeps the clock, and by time warping for "
                    "other performances, whose row shows how far a real performance is from the source; colours end at the "
                    "98th percentile of the methods."
                ),
                data=table,
            )
        )
    if not drawings:
        raise NotApplicableError(f"it compares results with those of {FLOOR} on the same body, which this run lacks")
    return drawings
