"""Ratings as the 2020 paper's figure 8 shows them: who was taken for the target style, and how natural it looked."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmark.api import NotApplicableError
from reports.drawing import Drawing
from reports.figures.style import COLUMN, FAINT, INK, LEFT, PAGE, RIGHT, new_figure, style
from reports.figures.values import no_statistics
from reports.ratings import STATS, ratings_stem
from reports.run import RunView

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Up to so many conditions every significant pair has a bracket; with more, those with real motion only.
_EVERY_PAIR = 6

_BLUE = "#9ecae1"

#: Height of a bracket in inches.
_STEP = 0.115

#: Width of a letter under the boxes in inches, and the slant in degrees of names that do not fit otherwise.
_LETTER, _SLANT = 0.058, 35


def order_conditions(names: Sequence[str], styles: tuple[str, str]) -> list[str]:
    """Real motion of the source style first and of the target style last, the others as they come."""
    return sorted(names, key=lambda name: (name == styles[1]) - (name == styles[0]))


def stars(p: float) -> str:
    """``*`` for p below .05, ``**`` below .01, ``***`` below .001; empty otherwise."""
    return "*" * sum(p < limit for limit in (0.05, 0.01, 0.001))


def brackets(
    contrasts: pd.DataFrame, order: Sequence[str], styles: tuple[str, str]
) -> list[tuple[int, list[tuple[int, str]]]]:
    """What to draw above the boxes of one question.

    Parameters
    ----------
    contrasts
        Rows of one question of ``ratings-contrasts.csv``, of one sample.
    order
        Conditions from left to right.
    styles
        Source and target style, which name the conditions of real motion.

    Returns
    -------
    list of (int, list of (int, str))
        For each bracket the position that it starts from, and the positions that differ from it with their marks: the stars of
        Holm's p, in brackets where the interval over raters and clips holds 0. With few conditions one for each significant
        pair, the shortest first; with many one for each condition of real motion.
    """
    place = {name: index for index, name in enumerate(order)}
    found: list[tuple[int, int, str]] = []
    row: Any
    for row in contrasts.itertuples():
        if not row.reject or row.a not in place or row.b not in place:
            continue
        carries = not row.low_clips <= 0 <= row.high_clips
        mark = stars(row.p_holm) if carries else f"({stars(row.p_holm)})"
        low, high = sorted((place[row.a], place[row.b]))
        found.append((low, high, mark))
    found.sort(key=lambda pair: (pair[1] - pair[0], pair[0]))
    if len(order) <= _EVERY_PAIR:
        return [(low, [(high, mark)]) for low, high, mark in found]
    combs = []
    for anchor in (place[name] for name in styles if name in place):
        teeth = [(low + high - anchor, mark) for low, high, mark in found if anchor in (low, high)]
        if teeth:
            combs.append((anchor, sorted(teeth)))
    return combs


def _levels(found: Sequence[tuple[int, list[tuple[int, str]]]]) -> list[int]:
    """The level of each bracket: the lowest on which it meets none before it."""
    taken: list[list[tuple[int, int]]] = []
    chosen = []
    for start, teeth in found:
        ends = [start, *(position for position, _ in teeth)]
        low, high = min(ends), max(ends)
        level = 0
        while level < len(taken) and any(
            low <= other_high and other_low <= high for other_low, other_high in taken[level]
        ):
            level += 1
        if level == len(taken):
            taken.append([])
        taken[level].append((low, high))
        chosen.append(level)
    return chosen


def boxes(
    conditions: pd.DataFrame, contrasts: pd.DataFrame, *, styles: tuple[str, str], kind: str, labels: dict[str, str]
) -> Figure:
    """Draw both questions, one above the other.

    Parameters
    ----------
    conditions
        ``ratings-conditions.csv``.
    contrasts
        ``ratings-contrasts.csv``, of the raters who count.
    styles
        Source and target style.
    kind
        Whose ratings they are; anything but people is said in the figure.
    labels
        Condition to what stands under its boxes.
    """
    order = order_conditions(conditions["condition"].tolist(), styles)
    table = conditions.set_index("condition").loc[order]
    panels = [
        ("child", f"called {styles[1]} [%]", 100.0, (0.0, 100.0), "#ffffff"),
        ("naturalness", "naturalness [1 to 7]", 1.0, (1.0, 7.0), _BLUE),
    ]
    found = [brackets(contrasts[contrasts["question"] == name], order, styles) for name, *_ in panels]
    comb = len(order) > _EVERY_PAIR
    heads = [_STEP * (max(_levels(marks), default=-1) + 1) + 0.06 for marks in found]
    width = PAGE if comb else COLUMN
    body, top, between = 1.25, 0.2 if kind != "people" else 0.05, 0.1
    longest = max(len(labels[name]) for name in order)
    left = 0.5
    slanted = longest * _LETTER > (width - left) / len(order)
    foot = 0.08 + (longest * _LETTER * np.sin(np.deg2rad(_SLANT)) + 0.1 if slanted else 0.14)
    height = top + foot + between + 2 * body + sum(heads)
    with style():
        figure = new_figure(width, height)
        y = height - top
        for index, ((name, title, scale, limits, face), marks, head) in enumerate(
            zip(panels, found, heads, strict=True)
        ):
            y -= body + head
            axes = figure.add_axes((left / width, y / height, (width - left - 0.03) / width, (body + head) / height))
            _panel(axes, table, name, scale, face)
            low, high = limits
            # Everything is drawn a little inside the scale, brackets above it.
            per_inch = (high - low) * 1.08 / body
            bottom, ceiling = low - 0.04 * (high - low), high + 0.04 * (high - low)
            axes.set_ylim(bottom, bottom + per_inch * (body + head))
            axes.set_xlim(-0.6, len(order) - 0.4)
            axes.set_ylabel(title, y=0.5 * body / (body + head), fontsize=7.5)
            axes.yaxis.set_label_coords(-0.38 / (width - left), 0.5 * body / (body + head))
            axes.set_yticks(np.linspace(0, 100, 5) if name == "child" else np.arange(1, 8))
            axes.spines["left"].set_bounds(low, high)
            for (start, teeth), level in zip(marks, _levels(marks), strict=True):
                _bracket(axes, start, teeth, ceiling + per_inch * (0.05 + _STEP * level), per_inch, comb=comb)
            axes.set_xticks(range(len(order)), [labels[each] for each in order] if index else [])
            axes.tick_params(axis="x", length=0, pad=2)
            if index and slanted:
                for label in axes.get_xticklabels():
                    label.set(rotation=_SLANT, ha="right", rotation_mode="anchor")
            y -= between
        if kind != "people":
            figure.text(
                (width - 0.03) / width,
                1.0 - 0.04 / height,
                kind,
                ha="right",
                va="top",
                fontsize=7.5,
                color=RIGHT,
                weight="bold",
            )
    return figure


def _panel(axes: Axes, table: pd.DataFrame, name: str, scale: float, face: str) -> None:
    if name == "child":
        axes.axhline(50, color=FAINT, linewidth=0.8, zorder=0)
    drawn = [
        {
            key: scale * float(row[f"{name}_{column}"])
            for key, column in (("whislo", "min"), ("q1", "q1"), ("med", "median"), ("q3", "q3"), ("whishi", "max"))
        }
        for _, row in table.iterrows()
    ]
    line = {"color": INK, "linewidth": 0.7}
    axes.bxp(
        drawn,
        positions=range(len(drawn)),
        widths=0.5,
        showfliers=False,
        patch_artist=True,
        boxprops={"facecolor": face, "edgecolor": INK, "linewidth": 0.7},
        medianprops={"color": INK, "linewidth": 1.6, "solid_capstyle": "butt"},
        whiskerprops=line,
        capprops=line,
    )
    if name == "child":
        columns = ("child_share", "child_low", "child_high")
    else:
        columns = ("naturalness_mean", "naturalness_low_clips", "naturalness_high_clips")
    for index, (_, row) in enumerate(table.iterrows()):
        mean, low, high = (scale * float(row[column]) for column in columns)
        # Beside the box, so that neither hides the other.
        axes.plot([index + 0.36] * 2, [low, high], color=LEFT, linewidth=1.0, solid_capstyle="butt")
        axes.plot(index + 0.36, mean, "D", color=LEFT, markersize=2.2)


def _bracket(axes: Axes, start: int, teeth: list[tuple[int, str]], y: float, per_inch: float, *, comb: bool) -> None:
    ends = [start, *(position for position, _ in teeth)]
    axes.plot([min(ends), max(ends)], [y, y], color=INK, linewidth=0.6)
    for position in ends[comb:]:
        axes.plot([position] * 2, [y - per_inch * 0.03, y], color=INK, linewidth=0.6)
    if comb:
        axes.plot(start, y, "o", color=INK, markersize=3.2)
    for position, mark in teeth:
        middle = position if comb else 0.5 * (start + position)
        axes.text(middle, y - per_inch * 0.012, mark, ha="center", va="bottom", fontsize=6.5)


def rating_drawing(folder: Path, stem: str, *, styles: tuple[str, str], what: str) -> Drawing | None:
    """The figure of an analysis of ratings that lies in ``folder``; ``None`` if there is none of both questions.

    Parameters
    ----------
    folder
        With ``STEM-conditions.csv`` and ``STEM-contrasts.csv``.
    stem
        As :func:`reports.ratings.ratings_stem` has it.
    styles
        Source and target style.
    what
        What was rated, in words, for the caption.
    """
    import pandas as pd

    paths = [folder / f"{stem}-{name}.csv" for name in ("conditions", "contrasts")]
    if not all(path.is_file() for path in paths):
        return None
    conditions, contrasts = (pd.read_csv(path) for path in paths)
    if not {"child_median", "naturalness_low_clips"} <= set(conditions) or "low_clips" not in contrasts:
        return None
    contrasts = contrasts[contrasts["sample"] == "attentive"]
    kind = str(conditions["kind"].iloc[0])
    labels = {name: f"{name} (real)" if name in styles else name for name in conditions["condition"]}
    figure = boxes(conditions, contrasts, styles=styles, kind=kind, labels=labels)
    pairs = len(contrasts) // 2
    which = (
        f"all {pairs} pairs of conditions are tested, and those that differ are marked"
        if len(conditions) <= _EVERY_PAIR
        else f"of the {pairs} pairs tested those that differ from real motion are marked, from the dot of each bracket; "
        f"the others stand in stats/{stem}-contrasts.csv"
    )
    head = "" if kind == "people" else f"{kind[0].upper()}{kind[1:]}. "
    order = order_conditions(conditions["condition"].tolist(), styles)
    data = conditions.set_index("condition").loc[order].reset_index()
    return Drawing(
        name=stem,
        figure=figure,
        caption=(
            f"{head}{what}: share of {styles[1]!r} answers (white) and naturalness (blue), "
            f"{int(conditions['raters'].max())} raters who passed the attention check, {_counts(conditions['clips'])} clips in "
            "each condition. Boxes: quartiles of raters' means, whiskers from the lowest to the highest rater; diamonds: mean "
            "with its 95 % interval over raters and clips; grey line: chance. Paired t tests over raters with Holm's "
            f"correction within each question: {which}; * p < .05, ** p < .01, *** p < .001, in brackets where the interval "
            "over raters and clips holds 0."
        ),
        data=data,
    )


def _counts(column: pd.Series) -> str:
    low, high = int(column.min()), int(column.max())
    return str(low) if low == high else f"{low} to {high}"


def ratings(run: RunView) -> list[Drawing]:
    """Box plots of the ratings of each task, as the 2020 paper's figure 8; simulated observers are named so in the figure."""
    drawings = []
    for task in run.tasks:
        source, _, target = task.partition(":")
        drawing = rating_drawing(
            run.folder / STATS,
            ratings_stem(run, task),
            styles=(source, target),
            what=f"{run.dataset_title}, {source} to {target}",
        )
        if drawing is not None:
            drawings.append(drawing)
    if not drawings:
        raise NotApplicableError(no_statistics(run))
    return drawings
