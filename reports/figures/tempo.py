"""Tempo and duration of results over those of real target performances, clip by clip."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from benchmark.api import NotApplicableError
from reports.drawing import Drawing
from reports.figures.style import FAINT, INK, MUTED, PAGE, REAL, looks, name_rows, new_figure, style
from reports.run import FLOOR, RunView

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

METRICS = {
    "timing/tempo-ratio": "tempo over that of real target clips",
    "timing/duration-ratio": "duration over that of real target clips",
}
#: Bins a doubling, and the fewest values of which a histogram says anything.
_BINS, _FEWEST = 8, 6
#: Where the axis may be labelled, close together for narrow ranges and far apart for wide ones.
_TICKS = (
    (0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.4, 1.6, 1.8, 2.0, 2.5),
    (0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0),
    (0.0625, 0.125, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0),
)


def ratios(run: RunView, task: str) -> pd.DataFrame:
    """Stored ratios of raw results: ``task, method, label, metric, clip_id, actor, action, value``, repetitions averaged."""
    rows = run.results
    rows = rows[
        (rows["task"] == task) & (rows["variant"] == "raw") & (rows["status"] == "ok") & rows["metric"].isin(METRICS)
    ]
    rows = rows[rows["value"] > 0]
    keys = ["task", "method", "metric", "clip_id", "actor", "action"]
    table = rows.groupby(keys)["value"].mean().reset_index()
    order = {method: rank for rank, method in enumerate(run.methods(task))}
    table.insert(2, "label", table["method"].map(run.label))
    return table.sort_values(["metric", "method"], key=lambda c: c.map(order) if c.name == "method" else c).reset_index(
        drop=True
    )


def edges(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Edges of bins that cover the values on an axis of logarithms, with 1 in the middle of one."""
    step = 1.0 / _BINS
    low, high = np.floor(np.log2(values.min()) / step), np.ceil(np.log2(values.max()) / step)
    return 2.0 ** (step * (np.arange(low - 1, high + 2) + 0.5))


def ridges(table: pd.DataFrame, methods: list[str], labels: dict[str, str], *, real: str) -> Figure:
    """Draw a histogram for each method and metric, one below the other on a common axis."""
    metrics = [metric for metric in METRICS if (table["metric"] == metric).any()]
    seen = looks(methods, floor=FLOOR, real=real)
    with style():
        height = 0.62 + 0.3 * len(methods)
        width = PAGE if len(metrics) > 1 else 0.62 * PAGE
        figure = new_figure(width, height)
        grid = figure.subplots(1, len(metrics), squeeze=False, sharey=True)[0]
        figure.subplots_adjust(
            left=1.2 / width, right=1.0 - 0.08 / width, bottom=0.4 / height, top=1.0 - 0.2 / height, wspace=0.1
        )
        for axes, metric in zip(grid, metrics, strict=True):
            part = table[table["metric"] == metric]
            bins = edges(part["value"].to_numpy(dtype=float))
            axes.axvline(1.0, color=INK, linewidth=0.8, linestyle=(0, (3, 2)), zorder=0)
            for row, method in enumerate(methods):
                values = part.loc[part["method"] == method, "value"].to_numpy(dtype=float)
                _ridge(axes, values, bins, len(methods) - 1 - row, REAL if method == real else seen[method].colour)
            axes.set_xscale("log", base=2)
            # At the right there is room for the counts.
            axes.set_xlim(bins[0], bins[-1] * (bins[-1] / bins[0]) ** 0.12)
            shown = [[tick for tick in ticks if bins[0] <= tick <= bins[-1]] for ticks in _TICKS]
            ticks = next((ticks for ticks in shown if 3 <= len(ticks) <= 8), shown[-1])
            axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
            axes.minorticks_off()
            axes.set_xlabel(METRICS[metric])
            axes.set_ylim(-0.12, len(methods) + 0.05)
            axes.spines["left"].set_visible(False)
            axes.tick_params(axis="y", length=0)
        at = [len(methods) - 0.75 - row for row in range(len(methods))]
        name_rows(grid[0], at, [labels[method] for method in methods], 1.12)
    return figure


def _ridge(axes: Axes, values: NDArray[np.float64], bins: NDArray[np.float64], base: float, colour: str) -> None:
    axes.axhline(base, color=FAINT, linewidth=0.6, zorder=0)
    where = axes.get_yaxis_transform()
    if len(values):
        axes.text(
            0.995, base + 0.5, f"n = {len(values)}", transform=where, ha="right", va="center", fontsize=5.5, color=MUTED
        )
    else:
        axes.text(0.5, base + 0.3, "no value", transform=where, ha="center", va="center", fontsize=5.5, color=MUTED)
        return
    if len(values) >= _FEWEST:
        counts, _ = np.histogram(values, bins)
        axes.stairs(
            base + 0.86 * counts / counts.max(), bins, baseline=base, fill=True, color=colour, alpha=0.55, linewidth=0
        )
        axes.stairs(base + 0.86 * counts / counts.max(), bins, baseline=base, color=colour, linewidth=0.8)
    else:
        axes.plot(
            values, np.full(len(values), base + 0.2), "o", color=colour, markersize=3.0, markeredgewidth=0, alpha=0.8
        )
    median = float(np.median(values))
    axes.plot([median, median], [base, base + 0.9], color=INK, linewidth=1.2, solid_capstyle="butt", zorder=3)


def tempo(run: RunView) -> list[Drawing]:
    """Histograms of the tempo and duration ratios of each task, with real performers last."""
    drawings = []
    for task in run.tasks:
        table = ratios(run, task)
        if table.empty:
            continue
        methods = [method for method in run.methods(task) if (table["method"] == method).any()]
        counts = {m: table.loc[table["metric"] == m].groupby("method").size().max() for m in table["metric"].unique()}
        over = " and ".join(f"{count} clips for {metric.partition('/')[2]}" for metric, count in counts.items())
        drawings.append(
            Drawing(
                name=f"tempo-{task.replace(':', '-to-')}",
                figure=ridges(table, methods, {m: run.label(m) for m in methods}, real=run.real_method),
                caption=(
                    f"{run.dataset_title}, {task.replace(':', ' to ')}: cycles a second and durations of raw results over the "
                    f"median of real target clips of the same action; each histogram is scaled to its own height, its bins are "
                    f"an eighth of a doubling wide, n = at most {over}, as written beside each (an action that does not repeat "
                    "has no tempo); fewer than "
                    f"{_FEWEST} are dots. Black: median; dashed: as real target clips. Green: the {run.label(run.real_method)} "
                    "against the other performers, where the run has one."
                ),
                data=table,
            )
        )
    if not drawings:
        raise NotApplicableError(f"it needs {' or '.join(METRICS)}")
    return drawings
