"""Cost against quality: what each method takes to fit and transfer, what it gives, and which ones no other beats on both."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from benchmark.api import NotApplicableError
from reports.drawing import Drawing
from reports.figures.labels import Named, place
from reports.figures.plane import title
from reports.figures.style import FAINT, INK, MUTED, PAGE, REAL, looks, new_figure, style
from reports.figures.ticks import log_ticks
from reports.figures.values import INTERVALS, clips_line, metric_table
from reports.run import FLOOR, RunView

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

QUALITY = ("recognition/p-target-temporal", "style/d-s", "distribution/frechet-kinematic", "style/pose-distance")
_PANELS = 2
#: The axis of costs spans this factor at least: seconds on a shared machine say nothing of smaller differences.
_SPAN = 10.0


def costs(run: RunView, task: str) -> pd.DataFrame:
    """Seconds to fit and to transfer all test clips, by method, means over repetitions; methods without both are left out."""
    rows = run.results
    rows = rows[(rows["task"] == task) & (rows["status"] == "ok")]
    fit = rows[rows["metric"] == "cost/fit_seconds"].groupby("method")["value"].mean()
    transfers = rows[rows["metric"] == "cost/transfer_seconds"].groupby(["method", "repetition"])["value"]
    whole = transfers.sum().groupby("method").mean().rename("transfer_seconds")
    clips = transfers.size().groupby("method").max().rename("clips")
    return fit.rename("fit_seconds").to_frame().join([whole, clips], how="inner")


def front(cost: NDArray[np.float64], quality: NDArray[np.float64]) -> NDArray[np.int64]:
    """Indices of the points that no other beats on both, cheapest first; lower cost and higher quality are better."""
    best = -np.inf
    found = []
    for index in np.lexsort((-quality, cost)):
        if quality[index] > best:
            best = float(quality[index])
            found.append(int(index))
    return np.array(found, dtype=np.int64)


def pareto_table(run: RunView, task: str) -> pd.DataFrame:
    """One row for each method and panel: seconds, the metric with its interval, and whether it is on the front."""
    import pandas as pd

    spent = costs(run, task)
    parts: list[pd.DataFrame] = []
    for metric in QUALITY:
        own = metric_table(run, task, metric)
        both = [m for m in run.methods(task) if m in own.index and m in spent.index and m != run.real_method]
        if len(both) < 2 or len(parts) == _PANELS:
            continue
        part = pd.DataFrame(
            {
                "task": task,
                "method": both,
                "label": [run.label(method) for method in both],
                "metric": metric,
                "direction": own.loc[both, "direction"].to_numpy(),
                **{name: spent.loc[both, name].to_numpy() for name in ("fit_seconds", "transfer_seconds", "clips")},
                **{name: own.loc[both, name].to_numpy(dtype=float) for name in ("mean", "low", "high", "n")},
            }
        )
        part.insert(7, "seconds", part["fit_seconds"] + part["transfer_seconds"])
        sign = -1.0 if part["direction"].iloc[0] == "lower" else 1.0
        part["on_front"] = np.isin(
            np.arange(len(part)), front(part["seconds"].to_numpy(), sign * part["mean"].to_numpy())
        )
        parts.append(part)
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame()


def pareto(run: RunView, task: str, table: pd.DataFrame) -> Figure:
    """Draw the panels of one task."""
    metrics = list(dict.fromkeys(table["metric"]))
    seen = looks(run.methods(task), floor=FLOOR, real=run.real_method)
    with style():
        width = PAGE if len(metrics) > 1 else 0.6 * PAGE
        figure = new_figure(width, 3.0)
        grid = figure.subplots(1, len(metrics), squeeze=False)[0]
        figure.subplots_adjust(left=0.58 / width, right=1.0 - 0.14 / width, bottom=0.15, top=0.97, wspace=0.26)
        for axes, metric in zip(grid, metrics, strict=True):
            part = table[table["metric"] == metric]
            axes.set_xscale("log")
            real = metric_table(run, task, metric)
            if run.real_method in real.index:
                own = real.loc[run.real_method]
                axes.axhspan(own["low"], own["high"], color=REAL, alpha=0.15, linewidth=0)
                axes.axhline(own["mean"], color=REAL, linewidth=1.0)
            line = part[part["on_front"]].sort_values("seconds")
            axes.plot(line["seconds"], line["mean"], color=FAINT, linewidth=3.5, drawstyle="steps-post", zorder=0)
            points = []
            for row in part.to_dict("records"):
                look = seen[row["method"]]
                axes.plot([row["seconds"]] * 2, [row["low"], row["high"]], color=look.colour, linewidth=0.9, alpha=0.7)
                axes.plot(
                    row["seconds"],
                    row["mean"],
                    look.marker,
                    color=look.colour,
                    markersize=7.0 if row["method"] == FLOOR else 4.8,
                    markeredgecolor="white",
                    markeredgewidth=0.5,
                )
                points.append(
                    Named(
                        row["seconds"],
                        row["mean"],
                        row["label"],
                        INK if row["method"] != FLOOR else MUTED,
                        (row["seconds"], row["low"]),
                        (row["seconds"], row["high"]),
                    )
                )
            axes.margins(x=0.12, y=0.1)
            axes.set_xlabel("seconds to fit and to transfer the test clips ←")
            axes.set_ylabel(title(metric, part["direction"].iloc[0]))
            log_ticks(axes, "x", span=_SPAN)
            place(axes, points)
    return figure


def cost_quality(run: RunView) -> list[Drawing]:
    """Cost against quality of each task, with the front of those that no other method beats on both."""
    drawings = []
    for task in run.tasks:
        table = pareto_table(run, task)
        if not len(table):
            continue
        clips = int(table["clips"].max())
        drawings.append(
            Drawing(
                name=f"cost-quality-{task.replace(':', '-to-')}",
                figure=pareto(run, task, table),
                caption=(
                    f"{run.dataset_title}, {task.replace(':', ' to ')}: quality against the seconds to fit a method and to "
                    f"transfer the {clips} test clips with it, on this run's machine (log scale; means over repetitions). "
                    f"Quality: raw results, means over {clips_line(table['n'])} with {INTERVALS}. Grey line: the front, "
                    f"methods that no other beats on both. Green: the {run.label(run.real_method)}, where the run has one. An "
                    "arrow says which way is better."
                ),
                data=table,
            )
        )
    if not drawings:
        raise NotApplicableError(f"it needs costs and one of {', '.join(QUALITY)} of at least two methods")
    return drawings
