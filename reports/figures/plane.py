"""Style against content: what each method gains in style, and what it gives up for that."""

from __future__ import annotations

from typing import TYPE_CHECKING

from benchmark.api import NotApplicableError
from reports.drawing import Drawing
from reports.figures.labels import Named, place
from reports.figures.style import FAINT, INK, MUTED, PAGE, looks, new_figure, style
from reports.figures.values import INTERVALS, clips_line, metric_table
from reports.run import FLOOR, RunView

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

#: What stands on the horizontal axis, and on the vertical one of each panel; those that a run has.
CONTENT = "content/pose-distance"
STYLE = ("recognition/p-target-temporal", "recognition/p-target-kinematic", "style/d-s", "style/pose-distance")
_PANELS = 2
NAMES = {
    "recognition/p-target-temporal": "P(target style), poses over time",
    "recognition/p-target-kinematic": "P(target style), speed and range",
    "style/d-s": "share of style distance $D_S$",
    "style/pose-distance": "distance to real target poses (leg)",
    "content/pose-distance": "change of poses from the source (deg)",
    "distribution/frechet-kinematic": "Fréchet distance to real target clips",
}


def title(metric: str, direction: str) -> str:
    """A metric in words with the way that is better."""
    arrow = {"lower": " ↓", "higher": " ↑"}.get(direction, "")
    return f"{NAMES.get(metric, metric)}{arrow}"


def plane_table(run: RunView, task: str) -> pd.DataFrame:
    """One row for each method and panel: the two means with their intervals; empty without the metrics."""
    import pandas as pd

    content = metric_table(run, task, CONTENT)
    parts = []
    # Two views of style that differ: what a network recognises, and what was measured.
    wanted = [metric for metric in STYLE if len(metric_table(run, task, metric))]
    chosen = [*[m for m in wanted if m.startswith("recognition/")][:1], *[m for m in wanted if m.startswith("style/")]]
    for metric in chosen[:_PANELS]:
        own = metric_table(run, task, metric)
        both = [method for method in run.methods(task) if method in own.index and method in content.index]
        parts.append(
            pd.DataFrame(
                {
                    "task": task,
                    "method": both,
                    "label": [run.label(method) for method in both],
                    "style_metric": metric,
                    "direction": [own.loc[method, "direction"] for method in both],
                    **{f"style_{name}": [own.loc[m, name] for m in both] for name in ("mean", "low", "high", "n")},
                    "content_metric": CONTENT,
                    **{
                        f"content_{name}": [content.loc[m, name] for m in both] for name in ("mean", "low", "high", "n")
                    },
                }
            )
        )
    return pd.concat(parts, ignore_index=True) if parts and any(map(len, parts)) else pd.DataFrame()


def plane(table: pd.DataFrame, *, floor: str, real: str) -> Figure:
    """Draw the panels of one task, a point for each method."""
    metrics = list(dict.fromkeys(table["style_metric"]))
    seen = looks(dict.fromkeys(table["method"]), floor=floor, real=real)
    with style():
        width = PAGE if len(metrics) > 1 else 0.6 * PAGE
        figure = new_figure(width, 3.1)
        grid = figure.subplots(1, len(metrics), squeeze=False)[0]
        figure.subplots_adjust(left=0.58 / width, right=1.0 - 0.05 / width, bottom=0.14, top=0.97, wspace=0.2)
        for axes, metric in zip(grid, metrics, strict=True):
            part = table[table["style_metric"] == metric]
            for anchor in (floor, real):
                line = part[part["method"] == anchor]
                if len(line):
                    axes.axhline(
                        float(line["style_mean"].iloc[0]), color=FAINT, linewidth=0.8, linestyle=(0, (4, 2)), zorder=0
                    )
            points = []
            for row in part.to_dict("records"):
                look = seen[row["method"]]
                low, high = ((float(row[f"content_{end}"]), float(row[f"style_{end}"])) for end in ("low", "high"))
                x, y = float(row["content_mean"]), float(row["style_mean"])
                axes.plot([low[0], high[0]], [y, y], color=look.colour, linewidth=0.9, alpha=0.7)
                axes.plot([x, x], [low[1], high[1]], color=look.colour, linewidth=0.9, alpha=0.7)
                size = {real: 8.0, floor: 7.0}.get(row["method"], 4.6)
                axes.plot(
                    x, y, look.marker, color=look.colour, markersize=size, markeredgecolor="white", markeredgewidth=0.5
                )
                ink = INK if row["method"] not in (floor, real) else look.colour
                points.append(Named(x, y, row["label"], ink if row["method"] != floor else MUTED, low, high))
            axes.margins(0.1)
            axes.set_xlim(left=min(0.0, axes.get_xlim()[0]))
            axes.set_xlabel(title(CONTENT, "lower"))
            axes.set_ylabel(title(metric, part["direction"].iloc[0]))
            place(axes, points)
    return figure


def style_content(run: RunView) -> list[Drawing]:
    """The plane of each task, with the floor and real performers as anchors."""
    drawings = []
    for task in run.tasks:
        table = plane_table(run, task)
        if len(table) < 2:
            continue
        drawings.append(
            Drawing(
                name=f"style-content-{task.replace(':', '-to-')}",
                figure=plane(table, floor=FLOOR, real=run.real_method),
                caption=(
                    f"{run.dataset_title}, {task.replace(':', ' to ')}: style gained against content changed, raw results, "
                    f"means over {clips_line(table['style_n'])} with {INTERVALS} on both axes. Dashed lines: {FLOOR} (the "
                    f"source itself) and the {run.label(run.real_method)}, where the run has them; real performances of the "
                    "same action differ from the source too, so no method need stay at 0. An arrow says which way is better."
                ),
                data=table,
            )
        )
    if not drawings:
        raise NotApplicableError(f"it needs {CONTENT} and one of {', '.join(STYLE)} of at least two methods")
    return drawings
