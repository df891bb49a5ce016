"""Style similarity as in figures 10 and 11 of the 2021 paper: distances to style and content, and their shares."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from benchmark.api import NotApplicableError
from reports.drawing import Drawing
from reports.figures.style import FAINT, INK, MUTED, PAGE, REAL, fitted, name_rows, new_figure, style
from reports.figures.values import INTERVALS, clips_line, metric_table
from reports.run import RunView

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_STYLE, _CONTENT = ("to the target style", "#0072B2"), ("to the content", "#E69F00")

#: The bars of each panel: title, and metric -> name and colour.
PANELS: tuple[tuple[str, dict[str, tuple[str, str]]], ...] = (
    ("shares $D_S$ ↓ and $D_C$", {"style/d-s": _STYLE, "content/d-c": _CONTENT}),
    ("Gram distances ↓", {"style/gram-distance": _STYLE, "content/gram-distance": _CONTENT}),
    ("change of poses (deg) ↓", {"content/pose-distance": _CONTENT}),
)


def similarity_table(run: RunView, task: str) -> pd.DataFrame:
    """One row for each method and metric drawn, with interval and n."""
    import pandas as pd

    parts = [metric_table(run, task, metric).reset_index() for _, bars in PANELS for metric in bars]
    table = pd.concat(parts, ignore_index=True)
    table.insert(0, "task", task)
    return table.drop(columns="reason")


def similarity(tables: dict[str, pd.DataFrame], *, real: str) -> Figure:
    """Draw one row of panels for each task."""
    shown = [panel for panel in PANELS if any((t["metric"].isin(panel[1])).any() for t in tables.values())]
    methods = {task: list(dict.fromkeys(table["method"])) for task, table in tables.items()}
    heights = [0.52 + 0.19 * len(methods[task]) for task in tables]
    with style():
        height = sum(heights) + 0.22
        figure = new_figure(PAGE, height)
        grid = figure.subplots(len(tables), len(shown), squeeze=False, height_ratios=heights)
        figure.subplots_adjust(
            left=1.25 / PAGE,
            right=0.985,
            bottom=0.3 / height,
            top=1.0 - 0.42 / height,
            wspace=0.12,
            hspace=0.55 / float(np.mean(heights)),
        )
        for line, (task, table) in zip(grid, tables.items(), strict=True):
            labels = dict(zip(table["method"], table["label"], strict=True))
            for axes, (title, bars) in zip(line, shown, strict=True):
                _bars(axes, table, methods[task], bars, real)
                axes.set_title(title, loc="left", fontsize=7)
            if len(tables) > 1:
                _head(line[0], task.replace(":", " to "))
            name_rows(line[0], range(len(methods[task])), [labels[method] for method in methods[task]], 1.18)
        handles = {}
        for axes in grid[0]:
            handles.update({name: bar for bar, name in zip(*axes.get_legend_handles_labels(), strict=True)})
        if handles:
            figure.legend(
                list(handles.values()),
                list(handles),
                loc="upper left",
                ncols=len(handles),
                frameon=False,
                bbox_to_anchor=(1.2 / PAGE, 1.0),
                handlelength=1.2,
                columnspacing=1.4,
                borderaxespad=0.1,
            )
    return figure


def _head(axes: Axes, task: str) -> None:
    """Name the task at the head of the margin that holds the methods' names, which is 1.2 inches wide."""
    _, size = fitted(task, 1.2, 7.0)
    axes.annotate(
        task, (0.0, 1.0), (-4, 4), xycoords="axes fraction", textcoords="offset points", ha="right", fontsize=size
    )


def _bars(axes: Axes, table: pd.DataFrame, methods: list[str], bars: dict[str, tuple[str, str]], real: str) -> None:
    thick = 0.76 / len(bars)
    for rank, (metric, (name, colour)) in enumerate(bars.items()):
        own = table[table["metric"] == metric].set_index("method")
        offset = (rank - 0.5 * (len(bars) - 1)) * thick
        rows = [i for i, method in enumerate(methods) if method in own.index]
        if not rows:
            continue
        part = own.loc[[methods[i] for i in rows]]
        at = np.array(rows) + offset
        drawn = axes.barh(at, part["mean"], height=thick * 0.92, color=colour, label=name)
        for bar, method in zip(drawn, part.index, strict=True):
            if method == real:
                bar.set(hatch="////", edgecolor="white", linewidth=0)
        axes.hlines(at, part["low"], part["high"], color=INK, linewidth=0.8)
        if real in own.index and (name, colour) == _STYLE:
            axes.axvline(float(own["mean"][real]), color=REAL, linewidth=0.9, linestyle=(0, (4, 2)), zorder=3)
    axes.set_ylim(len(methods) - 0.5, -0.5)
    axes.set_yticks(range(len(methods)), [])
    axes.tick_params(axis="y", length=0)
    axes.set_xlim(left=0.0)
    axes.locator_params(axis="x", nbins=4)
    axes.xaxis.grid(True, color=FAINT, linewidth=0.5)
    axes.set_axisbelow(True)
    axes.tick_params(axis="x", labelcolor=MUTED)


def _words(tasks: Iterable[str]) -> str:
    return ", ".join(task.replace(":", " to ") for task in tasks)


def style_similarity(run: RunView) -> list[Drawing]:
    """Bars of the distances to style and content for each task and method."""
    import pandas as pd

    tables = {task: similarity_table(run, task) for task in run.tasks}
    tables = {task: table for task, table in tables.items() if len(table)}
    if not tables:
        raise NotApplicableError(f"it needs one of {', '.join(metric for _, bars in PANELS for metric in bars)}")
    whole = pd.concat(tables.values(), ignore_index=True)
    # A page holds so many bars; more tasks go to figures of their own.
    groups = (
        [tables] if sum(t["method"].nunique() for t in tables.values()) <= 40 else [{k: t} for k, t in tables.items()]
    )
    drawings = []
    for group in groups:
        part = whole[whole["task"].isin(group)]
        named = "" if len(groups) == 1 else f"-{next(iter(group)).replace(':', '-to-')}"
        drawings.append(
            Drawing(
                name=f"style-similarity{named}",
                figure=similarity(group, real=run.real_method),
                caption=(
                    f"{run.dataset_title}, {_words(group)}: Gram distances to real clips of the target style and to the "
                    "source, and their shares D_S and D_C = 1 - D_S as in Wang et al. 2021 (lower D_S: nearer to the style "
                    "than to the source; the source itself is at 1). Raw results, means "
                    f"over {clips_line(part['n'])} with {INTERVALS}. Hatched bars and dashed green lines: the "
                    f"{run.label(run.real_method)}, where the run has one."
                ),
                data=part,
            )
        )
    return drawings
