"""The jump as the poster of Dong et al. 2018 draws it (its figure 1): adult, child and result laid over one another."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from benchmark.api import NotApplicableError
from benchmark.motion.canonical import heading
from benchmark.motion.skeleton import SIDES
from reports.drawing import Drawing
from reports.figures.bodies import project
from reports.figures.families import representatives
from reports.figures.mannequin import body_points
from reports.figures.moments import sample
from reports.figures.style import FAINT, INK, LEFT, MUTED, PAGE, new_figure, style
from reports.jumps import JumpCase, JumpRow, jump_cases
from reports.run import FLOOR, RunView

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Nearly from the side, facing right.
_TURN, _TILT = np.deg2rad(-72.0), 0.0
MOMENTS = ("take-off", "highest point", "landing's lowest point")
_LABEL_WIDTH = 0.72
_COLUMNS = 8
_HEAD_SIZE = 0.15
#: Colour, width and order of each: the child broad and below, the adult thin and on top, so that all show where they agree.
_LOOKS = {"trained on": ("#7FCDB6", 2.5, 1), "method": (LEFT, 1.5, 2), "source": (INK, 0.8, 3)}


def moments(row: JumpRow) -> NDArray[np.float64]:
    """(3,) seconds of take-off, of the hips' highest point in flight, and of the landing's lowest point."""
    if row.jump is None:
        raise NotApplicableError("no jump is seen")
    times = row.clip.times
    hips = row.clip.positions[:, row.clip.skeleton.joint("hips"), 1]
    flight = np.flatnonzero((times >= row.jump.take_off) & (times <= row.jump.touchdown))
    top = times[flight[int(np.argmax(hips[flight]))]] if len(flight) else row.jump.touchdown
    return np.array([row.jump.take_off, top, row.jump.lowest])


def figures_at(row: JumpRow) -> NDArray[np.float64]:
    """(3, P, 3) points of the body at the three moments, facing +Z about the hips' place on the floor, in leg lengths."""
    clip = row.clip
    points = sample(body_points(clip), clip, moments(row)) / clip.skeleton.leg_length
    hips = points[:, clip.skeleton.joint("hips")] * [1.0, 0.0, 1.0]
    turn = -sample(np.unwrap(heading(clip)), clip, moments(row))
    x, y, z = np.moveaxis(points - hips[:, None], -1, 0)
    cos, sin = np.cos(turn)[:, None], np.sin(turn)[:, None]
    return np.stack([cos * x + sin * z, y, cos * z - sin * x], axis=-1)


def _lines(row: JumpRow, pose: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Chains of the stick figure on the page: trunk, arms, legs."""
    skeleton = row.clip.skeleton
    page = project(pose, turn=_TURN, tilt=_TILT)[:, :2]

    def chain(*roles: str) -> NDArray[np.float64]:
        return page[[skeleton.joint(role) for role in roles if skeleton.has(role)]]

    trunk = chain("hips", "spine", "chest", "neck")
    lines = [np.concatenate([trunk, page[-1:]])]
    for side in SIDES:
        arm = chain(*(f"{side}_{part}" for part in ("shoulder", "elbow", "wrist", "hand")))
        leg = chain(*(f"{side}_{part}" for part in ("hip", "knee", "ankle", "toe")))
        lines += [np.concatenate([trunk[-1:], arm]), np.concatenate([trunk[:1], leg])]
    return lines


def _stick(axes: Axes, row: JumpRow, pose: NDArray[np.float64]) -> None:
    from matplotlib.patches import Circle

    colour, width, order = _LOOKS[row.role]
    for line in _lines(row, pose):
        axes.plot(*line.T, color=colour, linewidth=width, solid_capstyle="round", solid_joinstyle="round", zorder=order)
    head = project(pose[-1], turn=_TURN, tilt=_TILT)
    place = (float(head[0]), float(head[1]))
    axes.add_patch(Circle(place, _HEAD_SIZE, facecolor="none", edgecolor=colour, linewidth=width, zorder=order))


def overlay(case: JumpCase, methods: list[JumpRow]) -> Figure:
    """Draw a column for each method and a row for each moment."""
    backs = [*case.of("source")[:1], *[row for row in case.of("trained on") if row.jump is not None][:1]]
    backs = [row for row in backs if row.jump is not None]
    poses = {id(row): figures_at(row) for row in (*backs, *methods)}
    reach = [
        np.concatenate([np.concatenate(_lines(row, pose)) for pose in poses[id(row)]]) for row in (*backs, *methods)
    ]
    low, high = np.concatenate(reach).min(axis=0) - 0.12, np.concatenate(reach).max(axis=0) + [0.12, 0.1]
    low[0], high[0] = -max(-low[0], high[0]), max(-low[0], high[0])
    with style():
        width = (PAGE - _LABEL_WIDTH) / max(len(methods), 4)
        scale = min(width / (high - low)[0], 0.62)
        per_row = []
        for moment in range(len(MOMENTS)):
            own = np.concatenate([np.concatenate(_lines(row, poses[id(row)][moment])) for row in (*backs, *methods)])
            heads = [project(poses[id(row)][moment][-1], turn=_TURN, tilt=_TILT)[1] for row in (*backs, *methods)]
            top_of_all = max(float(own[:, 1].max()), max(heads) + _HEAD_SIZE)
            per_row.append((min(-0.06, float(own[:, 1].min()) - 0.04), top_of_all + 0.05))
        sizes = [(top - bottom) * scale for bottom, top in per_row]
        height = 0.42 + sum(sizes) + 0.06 * len(sizes)
        figure = new_figure(PAGE, height)
        top = height - 0.42
        for moment, size in enumerate(sizes):
            for column, row in enumerate(methods):
                left = _LABEL_WIDTH + column * width
                axes = figure.add_axes((left / PAGE, (top - size) / height, width / PAGE, size / height))
                axes.axhline(0.0, color=FAINT, linewidth=0.8, zorder=0)
                for shown in (*backs, row):
                    _stick(axes, shown, poses[id(shown)][moment])
                half = 0.5 * width / scale
                axes.set_xlim(-half, half)
                axes.set_ylim(*per_row[moment])
                axes.axis("off")
                if moment == 0:
                    name = row.label.replace("[", "\n[")
                    longest = max(map(len, name.split("\n")))
                    figure.text(
                        (left + 0.5 * width) / PAGE,
                        1.0 - 0.27 / height,
                        name,
                        ha="center",
                        va="center",
                        fontsize=7.0 * min(1.0, 15.0 * width / 0.9 / longest),
                    )
            figure.text(
                (_LABEL_WIDTH - 0.06) / PAGE,
                (top - 0.5 * size) / height,
                MOMENTS[moment].replace(" ", "\n"),
                ha="right",
                va="center",
                fontsize=7,
                color=MUTED,
            )
            top -= size + 0.06
        _legend(figure, backs)
    return figure


def _legend(figure: Figure, backs: list[JumpRow]) -> None:
    from matplotlib.lines import Line2D

    entries = {}
    for row in backs:
        suffix = " (input)" if row.role == "source" else " (trained on)"
        entries[row.label + suffix] = row.role
    entries["result"] = "method"
    lines = [Line2D([], [], color=_LOOKS[role][0], linewidth=_LOOKS[role][1]) for role in entries.values()]
    figure.legend(
        lines,
        list(entries),
        loc="upper left",
        bbox_to_anchor=(_LABEL_WIDTH / PAGE, 1.0),
        ncols=len(entries),
        frameon=False,
        borderaxespad=0.0,
        handlelength=1.8,
    )


def poses_table(rows: list[JumpRow]) -> pd.DataFrame:
    """The joints drawn: ``row, role, clip_id, moment, seconds, joint, x, y, z``, leg lengths, facing +Z."""
    import pandas as pd

    parts = []
    for row in rows:
        names = list(row.clip.skeleton.names)
        for moment, time, pose in zip(MOMENTS, moments(row), figures_at(row), strict=True):
            part = pd.DataFrame(pose[: len(names)], columns=["x", "y", "z"])
            for at, (name, value) in enumerate(
                {"row": row.label, "role": row.role, "clip_id": row.clip_id, "moment": moment, "seconds": time}.items()
            ):
                part.insert(at, name, value)
            part.insert(5, "joint", names)
            parts.append(part)
    return pd.concat(parts, ignore_index=True)


def jump_overlay(run: RunView) -> list[Drawing]:
    """Skeletons of the adult, the child trained on and each result at three moments of a jump, for each task with one."""
    drawings = []
    for task in run.tasks:
        cases = [case for case in jump_cases(run, task) if any(row.jump for row in case.of("method"))]
        if not cases:
            continue
        case = max(cases, key=lambda case: (sum(row.jump is not None for row in case.rows), "high" in case.action))
        jumping = {row.label: row for row in case.of("method") if row.jump is not None}
        named = [name for name in representatives(jumping) if name not in (FLOOR, run.label(run.real_method))]
        methods = [jumping[name] for name in (named or list(jumping))][:_COLUMNS]
        backs = [row for row in (*case.of("source")[:1], *case.of("trained on")) if row.jump is not None]
        trained = [row for row in backs if row.role == "trained on"][:1]
        lacking = [row.label for row in case.of("method") if row.jump is None]
        drawings.append(
            Drawing(
                name=f"jump-overlay-{task.replace(':', '-to-')}",
                figure=overlay(case, methods),
                caption=(
                    f"{run.dataset_title}, {task.replace(':', ' to ')}: \u201c{case.action.replace('-', ' ')}\u201d, n = 1 "
                    f"clip ({case.clip_id}), raw results, first repetition: skeletons at the same moments of the jump, each at "
                    "its own time, over one another at the hips, seen from the side and in leg lengths, so that size does not "
                    "count. "
                    + (
                        f"Green: {trained[0].label} ({trained[0].clip_id}), a performance trained on. "
                        if trained
                        else ""
                    )
                    + (f"The real performances are missing: {case.problem.rstrip('.')}. " if case.problem else "")
                    + (f"No jump is seen in the result of {', '.join(lacking)}." if lacking else "")
                ).strip(),
                data=poses_table([*[row for row in backs if row.role == "source"], *trained, *methods]),
            )
        )
    if not drawings:
        raise NotApplicableError("no result holds a jump")
    return drawings
