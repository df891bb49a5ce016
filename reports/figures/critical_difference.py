"""Critical-difference diagrams: mean ranks of methods on an axis, bars over those that are not told apart (Demsar 2006)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from benchmark.api import NotApplicableError
from reports.comparison import COMPARISON, RANKS
from reports.drawing import Drawing
from reports.figures.headline import headline_metrics
from reports.figures.style import FAINT, INK, PAGE, RIGHT, fitted, new_figure, style
from reports.figures.values import statistics_table
from reports.run import RunView
from reports.tables import arrow

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Of Nemenyi's test and of Friedman's, as the stored ranks have it.
ALPHA = 0.05

#: Share of the clips of the most common metric that another needs to be shown.
_ENOUGH = 0.5

#: More methods than this need the whole width for one diagram.
_NARROW = 10

#: Heights in inches: of the title and the bar of the critical difference, of one label, of one level of bars.
_HEAD, _LABEL, _BAR = 0.48, 0.125, 0.055

_WIDTH_OF_LETTER = 0.051


def bars(table: pd.DataFrame) -> list[tuple[float, float]]:
    """From the stored groups of one metric's ranks, the first and last mean rank of each bar, best first."""
    spans: dict[int, list[float]] = {}
    row: Any
    for row in table.itertuples():
        for number in str(row.groups).split() if isinstance(row.groups, str) else []:
            spans.setdefault(int(number), []).append(float(row.mean_rank))
    return sorted((min(ranks), max(ranks)) for ranks in spans.values())


def levels(spans: list[tuple[float, float]], *, gap: float = 0.8) -> list[int]:
    """For each bar the lowest level on which it keeps ``gap`` ranks from those already there."""
    reached: list[float] = []
    chosen = []
    for low, high in spans:
        level = next((index for index, end in enumerate(reached) if low - end > gap), len(reached))
        reached[level : level + 1] = [high]
        chosen.append(level)
    return chosen


def diagram(
    axes: Axes, table: pd.DataFrame, labels: dict[str, str], *, title: str, width: float, height: float
) -> None:
    """Draw one diagram into empty axes of ``width`` by ``height`` inches.

    Parameters
    ----------
    axes
        Get inches as coordinates.
    table
        Rows of one metric of ``metrics-ranks.csv``.
    labels
        Method to name.
    title
        Above it.
    width, height
        Inches.
    """
    rows: list[Any] = sorted(table.itertuples(), key=lambda row: (row.mean_rank, labels[row.method]))
    k, cd, p = len(rows), float(rows[0].cd), float(rows[0].p)
    half = (k + 1) // 2
    names = _names(labels, width)
    step = _step(names)
    margins = [
        max([_longest(*names[row.method]) for row in part], default=0.0) + 0.12 for part in (rows[:half], rows[half:])
    ]
    left, right = margins[0], width - margins[1]
    axes.set(xlim=(0, width), ylim=(height, 0))
    axes.axis("off")

    def at(rank: float) -> float:
        return left + 0.1 + (rank - 1.0) / max(1, k - 1) * (right - left - 0.2)

    def draw(x: list[float], y: list[float], **how: Any) -> None:
        axes.plot(x, y, color=INK, solid_capstyle="butt", clip_on=False, **how)

    axes.text(0, 0.08, title, fontsize=7, va="center", ha="left")
    line = _HEAD
    told = p < ALPHA
    if told and cd < k - 1:
        span = [at(1.0), at(1.0 + cd)]
        draw(span, [line - 0.2] * 2, linewidth=0.8)
        for x in span:
            draw([x, x], [line - 0.235, line - 0.165], linewidth=0.8)
        axes.text(span[1] + 0.04, line - 0.2, f"CD {cd:.2f}", fontsize=5.5, va="center", ha="left")
    draw([at(1), at(k)], [line] * 2, linewidth=0.8)
    for rank in range(1, k + 1):
        draw([at(rank)] * 2, [line - 0.035, line], linewidth=0.6)
        axes.text(at(rank), line - 0.05, str(rank), fontsize=5.5, va="bottom", ha="center")
    spans = bars(table) if told else [(float(rows[0].mean_rank), float(rows[-1].mean_rank))]
    places = levels(spans)
    for (low, high), level in zip(spans, places, strict=True):
        y = line + 0.06 + level * _BAR
        # Equal ranks still show as a bar.
        axes.plot(
            [at(low) - 0.025, at(high) + 0.025], [y, y], color=RIGHT, linewidth=2.2, solid_capstyle="round", zorder=3
        )
    first = line + 0.06 + (max(places, default=0) + 1) * _BAR + 0.06
    for index, row in enumerate(rows):
        on_left = index < half
        # The outermost ranks have the shortest way down, so that no two lines cross.
        y = first + (index if on_left else k - 1 - index) * step
        end = left - 0.04 if on_left else right + 0.04
        draw([at(row.mean_rank)] * 2 + [end], [line, y, y], linewidth=0.6)
        axes.text(
            end + (-0.04 if on_left else 0.04),
            y,
            names[row.method][0],
            fontsize=names[row.method][1],
            linespacing=0.95,
            va="center",
            ha="right" if on_left else "left",
        )
    note = f"n = {int(rows[0].n)} clips"
    if not told:
        note = f"Friedman p = {p:.2f}: not told apart, {note}"
    axes.text(width, 0.08, note, fontsize=5.8, color="#666666", va="center", ha="right")


def _names(labels: dict[str, str], width: float) -> dict[str, tuple[str, float]]:
    """Names with their sizes, so long at most that the axis of ranks keeps two fifths of the ``width`` in inches."""
    return {method: fitted(label, 0.3 * width - 0.12, 6.2) for method, label in labels.items()}


def _step(names: dict[str, tuple[str, float]]) -> float:
    """Inches from one name to the next below it."""
    return _LABEL * (1.5 if any("\n" in text for text, _ in names.values()) else 1.0)


def _longest(text: str, size: float) -> float:
    """Inches that a name of that size takes."""
    return max(map(len, text.split("\n"))) * _WIDTH_OF_LETTER * size / 6.2


def diagrams(table: pd.DataFrame, labels: dict[str, str]) -> Figure:
    """One diagram for each metric of ``table``, two beside each other where methods are few."""
    metrics = list(dict.fromkeys(table["metric"]))
    most = int(table["k"].max())
    columns = 2 if most <= _NARROW and len(metrics) > 1 else 1
    rows = -(-len(metrics) // columns)
    deepest = max(max(levels(bars(part)), default=0) + 1 for _, part in table.groupby("metric", sort=False))
    gutter = 0.25
    width = (PAGE - gutter * (columns - 1)) / columns
    height = _HEAD + 0.12 + deepest * _BAR + (most + 1) // 2 * _step(_names(labels, width)) + 0.1
    with style():
        figure = new_figure(PAGE, rows * height)
        for index, metric in enumerate(metrics):
            row, column = divmod(index, columns)
            place = (
                column * (width + gutter) / PAGE,
                1.0 - (row + 1) / rows,
                width / PAGE,
                1.0 / rows,
            )
            axes = figure.add_axes(place)
            part = table[table["metric"] == metric]
            sign = arrow(str(part["direction"].iloc[0]), None)
            diagram(axes, part, labels, title=f"{metric} {sign}".strip(), width=width, height=height)
            if row:
                figure.add_artist(_rule(place, rows))
    return figure


def _rule(place: tuple[float, float, float, float], rows: int) -> Any:
    from matplotlib.lines import Line2D

    y = place[1] + 1.0 / rows
    return Line2D([place[0], place[0] + place[2]], [y, y], color=FAINT, linewidth=0.6)


def critical_difference(run: RunView) -> list[Drawing]:
    """Mean ranks of methods by one metric of each group, one page a task; what they are not told apart by is under a bar."""
    import pandas as pd

    stored = statistics_table(run, RANKS)
    drawings = []
    for task in run.tasks:
        table = stored[
            (stored["task"] == task) & (stored["variant"] == "raw") & stored["p"].notna() & (stored["k"] > 2)
        ]
        if table.empty:
            continue
        # A metric with a value for few clips only (tempo, of cyclic motions) does not stand for a group that has a better one.
        common = table[table["n"] >= _ENOUGH * table["n"].max()]
        chosen = headline_metrics(common["metric"])
        part = table[table["metric"].isin(chosen)].copy()
        part["metric"] = pd.Categorical(part["metric"], categories=chosen)
        part = part.sort_values(["metric", "mean_rank"]).astype({"metric": str})
        rows = run.results
        rows = rows[(rows["task"] == task) & (rows["status"] == "ok") & (rows["clip_id"] != "")]
        actors = int(rows["actor"].nunique())
        drawings.append(
            Drawing(
                name=f"critical-difference-{task.replace(':', '-to-')}",
                figure=diagrams(part, {method: run.label(method) for method in part["method"]}),
                caption=(
                    f"{run.dataset_title}, {task.replace(':', ' to ')}, raw results: mean ranks over {_span(part['n'])} test "
                    f"clips of {actors} actors by one metric of each group, 1 is best. Under one orange bar: methods whose "
                    f"mean ranks differ by less than Nemenyi's critical difference CD (familywise alpha {ALPHA:g} within a "
                    "metric, after Friedman's test). Clips of one actor depend on one another and count here as independent, "
                    "so that differences are easier to find than they should be: the intervals of the leaderboard and of "
                    f"stats/{COMPARISON}, which draw actors first, are the ones to trust. All metrics: stats/{RANKS}."
                ),
                data=part,
            )
        )
    if not drawings:
        raise NotApplicableError("there are no three methods with values for the same clips, which ranks need")
    return drawings


def _span(counts: pd.Series) -> str:
    low, high = int(np.min(counts)), int(np.max(counts))
    return str(low) if low == high else f"{low} to {high}"
