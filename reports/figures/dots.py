"""The metrics of a group at a glance: one panel each, a dot with its interval for each method, real performers as a line."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from reports.drawing import Drawing
from reports.figures.style import FAINT, INK, PAGE, REAL, fitted, name_rows, new_figure, style
from reports.run import RunView
from reports.tables import by_group, with_values

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

_COLUMNS = 3


def _panel_title(metric: str, unit: str, direction: str) -> str:
    arrow = {"lower": " ↓", "higher": " ↑"}.get(direction, "")
    # The group is that of the whole figure; it stands in the caption.
    return f"{metric.partition('/')[2] or metric}{'' if unit in ('', '1') else f' ({unit})'}{arrow}"


def dots(table: pd.DataFrame, *, real: str) -> Figure:
    """Draw the leaderboard of one task.

    Parameters
    ----------
    table
        One row for each (method, metric): ``method, label, metric, unit, direction, target, mean, low, high, n``.
    real
        The method that stands for real performers; its mean is the green line of each panel.
    """
    values = ["mean", "low", "high"]
    # Rounding noise about zero would otherwise fill a panel.
    table = table.assign(**table[values].mask(table[values].abs() < 1e-9, 0.0))
    metrics = list(dict.fromkeys(table["metric"]))
    methods = list(dict.fromkeys(table.loc[table["method"] != real, "method"]))
    labels = dict(zip(table["method"], table["label"], strict=True))
    rows = -(-len(metrics) // _COLUMNS)
    with style():
        height = rows * (0.42 + 0.155 * len(methods)) + 0.1
        figure = new_figure(PAGE, height)
        grid = figure.subplots(rows, _COLUMNS, squeeze=False)
        for index, axes in enumerate(grid.flat):
            if index >= len(metrics):
                axes.axis("off")
                continue
            part = table[table["metric"] == metrics[index]].set_index("method")
            first = part.iloc[0]
            name = _panel_title(metrics[index], first["unit"], first["direction"])
            axes.set_title(name, loc="left", fontsize=fitted(name, 1.5, 7.0)[1])
            # One artist for all methods: a page of panels has hundreds of dots.
            axes.hlines(
                range(len(methods)), 0, 1, transform=axes.get_yaxis_transform(), color=FAINT, linewidth=0.5, zorder=0
            )
            own = part.reindex(methods)
            has = np.isfinite(own["mean"].to_numpy(dtype=float))
            at = np.flatnonzero(has)
            axes.hlines(at, own["low"][has], own["high"][has], color=INK, linewidth=1.0)
            axes.plot(own["mean"][has], at, "o", color=INK, markersize=3.2)
            for row in np.flatnonzero(~has):
                axes.text(
                    0.02,
                    row,
                    "no value",
                    transform=axes.get_yaxis_transform(),
                    fontsize=5.5,
                    va="center",
                    color="#777777",
                )
            if real in part.index and np.isfinite(part.loc[real, "mean"]):
                axes.axvspan(part.loc[real, "low"], part.loc[real, "high"], color=REAL, alpha=0.18, linewidth=0)
                axes.axvline(part.loc[real, "mean"], color=REAL, linewidth=1.0)
            if first["direction"] == "target" and np.isfinite(first["target"]):
                axes.axvline(first["target"], color=INK, linewidth=0.7, linestyle=(0, (2, 2)))
            axes.set_ylim(len(methods) - 0.5, -0.5)
            axes.set_yticks(range(len(methods)), [])
            if index % _COLUMNS == 0:
                name_rows(axes, range(len(methods)), [labels[method] for method in methods], 1.3)
            axes.tick_params(axis="y", length=0)
            axes.locator_params(axis="x", nbins=4)
            axes.margins(x=0.08)
        figure.tight_layout(h_pad=0.7, w_pad=0.8)
    return figure


def metric_dots(run: RunView) -> list[Drawing]:
    """Every metric of every method as a dot with its interval, real performers as a line; one page for each task and group."""
    drawings = []
    for task in run.tasks:
        for group, table in by_group(with_values(run.leaderboard(task, variant="raw"))).items():
            clips = int(table["n"].max())
            values = (
                f"means over at most {clips} test clips, with 95 % intervals from resampling actors and then their clips"
                if clips > 1
                else "one value for all test clips together"
            )
            drawings.append(
                Drawing(
                    name=f"metrics-{task.replace(':', '-to-')}-{group}",
                    figure=dots(table, real=run.real_method),
                    caption=(
                        f"{run.dataset_title}, {task.replace(':', ' to ')}, {group}, raw results: {values}. Green: the same "
                        "metric on held-out performers of the target style, where it can be had. Dashed: the value aimed at. "
                        "An arrow says which way is better."
                    ),
                    data=table,
                )
            )
    return drawings
