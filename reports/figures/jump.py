"""The landing of a jump: knees, hips and wrists over time, of the source, the performers trained on and each method."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from benchmark.api import NotApplicableError
from benchmark.motion.clip import MotionClip
from eval.metrics.jump import knee_angle
from reports.drawing import Drawing
from reports.figures.style import FAINT, INK, LEFT, PAGE, REAL, fitted, new_figure, style
from reports.jumps import CLAIMS, JumpCase, JumpRow, jump_cases
from reports.run import RunView

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Column of the curves -> its title, and the claim whose measure is written into its panels with its unit and digits.
_PANELS: dict[str, tuple[str, str, str, int]] = {
    "knee_angle_deg": ("knee angle (deg)", "landing_knee_angle_deg", "°", 0),
    "hips_height_leg": ("hips height (leg lengths)", "landing_duration_s", " s", 2),
    "wrist_height_leg": ("wrist height (leg lengths)", "arm_swing_deg", "°", 0),
}
_MEASURED = {
    "landing_knee_angle_deg": "lowest",
    "landing_duration_s": "landing",
    "arm_swing_deg": "swing",
}
_LABEL_WIDTH, _ROW_HEIGHT, _HEAD, _FOOT = 1.12, 0.92, 0.5, 0.36
#: Seconds shown before the earliest take-off and after the latest end of a landing, and at most about touchdown.
_MARGIN, _BEFORE, _AFTER = 0.35, 1.5, 1.2


def curves(clip: MotionClip) -> dict[str, NDArray[np.float64]]:
    """The curves that are drawn, (T,) each: mean knee angle in degrees, hips' and mean wrists' heights in leg lengths."""
    skeleton = clip.skeleton
    heights = clip.positions[..., 1] / skeleton.leg_length
    return {
        "knee_angle_deg": knee_angle(clip),
        "hips_height_leg": heights[:, skeleton.joint("hips")],
        "wrist_height_leg": heights[:, skeleton.joints("left_wrist", "right_wrist")].mean(axis=1),
    }


def curves_table(case: JumpCase) -> pd.DataFrame:
    """The numbers drawn by :func:`landing`: the curves of every row with a jump, by seconds from its touchdown."""
    import pandas as pd

    parts = [
        pd.DataFrame(
            {
                "row": row.label,
                "role": row.role,
                "clip_id": row.clip_id,
                "seconds_from_touchdown": row.clip.times - row.jump.touchdown,
                **curves(row.clip),
            }
        )
        for row in _drawn(case)
        if row.jump is not None
    ]
    return pd.concat(parts, ignore_index=True)


def landing(case: JumpCase) -> Figure:
    """Draw one transferred jump: the real performances in the first row, one method in each of the others."""
    methods = case.of("method")
    real = [row for row in _drawn(case) if row.role != "method"]
    rows: list[JumpRow | None] = ([None] if real else []) + list(methods)
    from matplotlib.transforms import blended_transform_factory

    with style():
        height = _HEAD + _ROW_HEIGHT * len(rows) + _FOOT
        figure = new_figure(PAGE, height)
        grid = figure.subplots(len(rows), len(_PANELS), squeeze=False, sharex=True, sharey="col")
        figure.subplots_adjust(
            left=(_LABEL_WIDTH + 0.3) / PAGE,
            right=0.985,
            bottom=_FOOT / height,
            top=1.0 - _HEAD / height,
            wspace=0.24,
            hspace=0.14,
        )
        for line, row in zip(grid, rows, strict=True):
            for axes, column in zip(line, _PANELS, strict=True):
                axes.axvline(0.0, color=FAINT, linewidth=0.8, zorder=0)
                for background in real:
                    _curve(axes, background, column, faint=row is not None)
                if row is None:
                    _values(axes, case, column)
                elif row.jump is None:
                    axes.text(0.5, 0.5, "no jump is seen", transform=axes.transAxes, ha="center", fontsize=6.5)
                else:
                    _curve(axes, row, column, faint=False)
                    _verdict(axes, case, row, column)
                axes.locator_params(axis="y", nbins=4)
            label, size = ("real", 7.5) if row is None else fitted(row.label, _LABEL_WIDTH - 0.1, 7.5)
            figure_x = (_LABEL_WIDTH - 0.06) / PAGE
            place = blended_transform_factory(figure.transFigure, line[0].transAxes)
            line[0].text(figure_x, 0.5, label, transform=place, ha="right", va="center", fontsize=size)
        for axes, (title, *_) in zip(grid[0], _PANELS.values(), strict=True):
            axes.set_title(title, loc="left", fontsize=7.5)
        grid[-1, 1].set_xlabel("seconds from touchdown")
        grid[0, 0].set_xlim(*_limits(case))
        for axes in grid[0]:
            low, high = axes.get_ylim()
            # Room for what is written below the curves.
            axes.set_ylim(low - 0.3 * (high - low), high)
        _legend(figure, real, bool(methods))
    return figure


def jump_landing(run: RunView) -> list[Drawing]:
    """One figure for each task whose test clips hold a jump: the clip of which most rows show one."""
    drawings = []
    for task in run.tasks:
        cases = [case for case in jump_cases(run, task) if any(row.jump for row in _drawn(case))]
        if not cases:
            continue
        case = max(cases, key=lambda case: sum(row.jump is not None for row in _drawn(case)))
        drawings.append(
            Drawing(
                name=f"jump-landing-{task.replace(':', '-to-')}",
                figure=landing(case),
                caption=_caption(run, task, case, len(cases)),
                data=curves_table(case),
            )
        )
    if not drawings:
        raise NotApplicableError("no result holds a jump")
    return drawings


def _caption(run: RunView, task: str, case: JumpCase, count: int) -> str:
    source, _, target = task.partition(":")
    text = (
        f"{run.dataset_title}, {source} to {target}: \u201c{case.action.replace('-', ' ')}\u201d, clip {case.clip_id}"
        f"{f', one of {count} jumps transferred' if count > 1 else ''}. Curves from touchdown; triangle: take-off, disc: the "
        "landing's lowest point. Written in the panels: the lowest knee angle in landing (180° is straight), the time from "
        "touchdown to the hips' lowest point, and the largest angle between two directions of an arm. "
    )
    if case.problem:
        return (
            text
            + f"The real performances are missing, because the data set could not be read ({case.problem.rstrip('.')})."
        )
    if not case.of("trained on"):
        return (
            text
            + f"No {target} clip of this action is in the training set, so nothing is said of what is nearer to it."
        )
    whom = "the child" if target == "child" else f"the {target} performer"
    verdicts = []
    for row in case.of("method"):
        told = {CLAIMS[claim]: value for claim, value in case.nearer(row).items() if value is not None}
        if not told:
            verdicts.append(f"{row.label}: no value")
            continue
        holds = [words for words, value in told.items() if value]
        verdicts.append(f"{row.label}: {', '.join(holds) if holds else 'none'} ({len(holds)} of {len(told)})")
    return (
        text
        + _apart(source, case)
        + f"A tick: nearer than the {source} to {whom} trained on (Dong et al. 2018 state this of their result for all three). "
        + "Holds for "
        + "; ".join(verdicts)
        + "."
    )


def _apart(source: str, case: JumpCase) -> str:
    """How far the input is from those trained on: what is less than a frame or a sensor's error decides nothing."""
    row = case.of("source")[0]
    apart = [
        f"{abs(row.measures[claim] - case.aim[claim]):.{digits + 1}f}{unit} in {CLAIMS[claim]}"
        for _, claim, unit, digits in _PANELS.values()
        if np.isfinite(row.measures[claim] - case.aim[claim])
    ]
    if not apart:
        return ""
    frame = 1.0 / row.clip.fps
    return f"The {source} is {', '.join(apart)} from the performer trained on; a frame lasts {frame:.3f} s. "


def _drawn(case: JumpCase) -> list[JumpRow]:
    return [row for row in case.rows if row.role != "not trained on"]


def _look(row: JumpRow) -> dict[str, Any]:
    if row.role == "source":
        return {"color": INK, "linestyle": (0, (3, 1.6)), "linewidth": 1.0}
    if row.role == "trained on":
        return {"color": REAL, "linestyle": "-", "linewidth": 1.0}
    return {"color": LEFT, "linestyle": "-", "linewidth": 1.3}


def _curve(axes: Axes, row: JumpRow, column: str, *, faint: bool) -> None:
    if row.jump is None:
        return
    look = _look(row)
    if faint:
        look = {**look, "linewidth": 0.7, "alpha": 0.75}
    values, times = curves(row.clip)[column], row.clip.times
    axes.plot(times - row.jump.touchdown, values, zorder=1 if faint else 2, **look)
    size = 2.4 if faint else 3.4
    for moment, sign in ((row.jump.take_off, "^"), (row.jump.lowest, "o")):
        at = float(np.interp(moment, times, values))
        axes.plot(
            moment - row.jump.touchdown, at, sign, color=look["color"], markersize=size, markeredgewidth=0, zorder=3
        )


def _values(axes: Axes, case: JumpCase, column: str) -> None:
    """The measure of the source, and the median of those trained on below it."""
    _, claim, unit, digits = _PANELS[column]
    source = case.of("source")[0].measures[claim]
    for value, head, height, colour in (
        (source, f"{_MEASURED[claim]} ", 0.21, INK),
        (case.aim[claim], "", 0.06, REAL),
    ):
        if np.isfinite(value):
            text = f"{head}{value:.{digits}f}{unit}"
            axes.text(0.985, height, text, transform=axes.transAxes, **_written(colour))


def _verdict(axes: Axes, case: JumpCase, row: JumpRow, column: str) -> None:
    _, claim, unit, digits = _PANELS[column]
    mark = {True: " ✓", False: " ✗", None: ""}[case.nearer(row)[claim]]
    text = f"{_MEASURED[claim]} {row.measures[claim]:.{digits}f}{unit}{mark}"
    axes.text(0.985, 0.06, text, transform=axes.transAxes, **_written(_look(row)["color"]))


def _written(colour: str) -> dict[str, Any]:
    box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.6}
    return {"ha": "right", "va": "bottom", "fontsize": 6.5, "color": colour, "bbox": box, "zorder": 4}


def _limits(case: JumpCase) -> tuple[float, float]:
    jumps = [row.jump for row in _drawn(case) if row.jump is not None]
    first = min(jump.take_off - jump.touchdown for jump in jumps) - 2.0 * _MARGIN
    last = max(jump.end - jump.touchdown for jump in jumps) + _MARGIN
    return max(first, -_BEFORE), min(last, _AFTER)


def _legend(figure: Figure, real: list[JumpRow], methods: bool) -> None:
    from matplotlib.lines import Line2D

    entries: dict[str, Line2D] = {}
    trained = list(dict.fromkeys(row.label for row in real if row.role == "trained on"))
    for row in real:
        # All performers trained on look the same, so several share an entry.
        many = row.role == "trained on" and len(trained) > 1
        label = f"{len(trained)} performers" if many else row.label
        suffix = " (input)" if row.role == "source" else " (trained on)"
        entries.setdefault(label + suffix, Line2D([], [], **_look(row)))
    if methods:
        entries["method"] = Line2D([], [], color=LEFT, linewidth=1.3)
    for name, sign in (("take-off", "^"), ("lowest point", "o")):
        entries[name] = Line2D([], [], color=INK, marker=sign, markersize=3.4, linestyle="none", markeredgewidth=0)
    figure.legend(
        list(entries.values()),
        list(entries),
        loc="upper left",
        bbox_to_anchor=((_LABEL_WIDTH + 0.2) / PAGE, 1.0),
        ncols=len(entries),
        frameon=False,
        handlelength=1.8,
        columnspacing=1.2,
    )
