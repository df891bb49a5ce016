"""The leaderboard as tables: LaTeX (booktabs) for papers, Markdown for read-me files, CSV."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from reports.latex import fitted, latex_escape, latex_label
from reports.markdown import markdown_escape
from reports.run import RunView

if TYPE_CHECKING:
    import pandas as pd

#: The suite's groups of metrics in the order in which they are shown.
GROUPS = ("style", "recognition", "distribution", "truth", "content", "timing", "physics", "jump")

ARROWS = {"lower": "↓", "higher": "↑", "target": "→", "none": ""}
_LATEX_ARROWS = {"lower": r"$\downarrow$", "higher": r"$\uparrow$", "none": ""}


def number(value: float | None) -> str:
    """Three significant digits, without an exponent where that stays short; rounding noise is 0, no value a dash."""
    if value is None or not np.isfinite(value):
        return "–"
    if abs(value) < 1e-9:
        return "0"
    if not 1e-4 <= abs(value) < 1e9:
        return f"{value:.2e}"
    digits = max(0, 2 - int(np.floor(np.log10(abs(value)))))
    return f"{value:,.{digits}f}"


def column_names(metrics: Iterable[str]) -> dict[str, str]:
    """What heads the column of each metric: the name without its group, with it where two groups share the name."""
    short = {metric: metric.partition("/")[2] or metric for metric in metrics}
    counts = Counter(short.values())
    return {metric: name if counts[name] == 1 else metric for metric, name in short.items()}


def arrow(direction: str, target: float | None) -> str:
    """Which way is better, in a sign: ``↓``, ``↑``, ``→ 1``."""
    sign = ARROWS.get(direction, "")
    return f"{sign} {target:g}" if direction == "target" and target is not None and np.isfinite(target) else sign


def by_group(table: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """The rows of a leaderboard by the group of their metric, ``style`` of ``style/pose-distance``: style first."""
    groups = table["metric"].str.partition("/")[0]
    found = dict.fromkeys(groups)
    ordered = [group for group in GROUPS if group in found] + [group for group in found if group not in GROUPS]
    return {str(group): table[groups == group] for group in ordered}


def latex_leaderboard(table: pd.DataFrame, *, caption: str, label: str) -> str:
    """A booktabs table, one metric a row and one method a column, mean with its 95 % interval.

    Parameters
    ----------
    table
        As :meth:`reports.run.RunView.leaderboard` gives it.
    caption, label
        Of the LaTeX table.
    """
    rows: list[Any] = list(table.itertuples())
    metrics = list(dict.fromkeys(row.metric for row in rows))
    methods = list(dict.fromkeys(row.method for row in rows))
    cells = {(row.method, row.metric): row for row in rows}
    first = {row.metric: row for row in reversed(rows)}
    labels = {row.method: row.label for row in rows}
    names = column_names(metrics)

    def head(metric: str) -> str:
        row = first[metric]
        sign = rf"$\to {row.target:g}$" if row.direction == "target" else _LATEX_ARROWS.get(row.direction, "")
        unit = "" if row.unit in ("", "1") else f" [{latex_escape(row.unit)}]"
        return f"{latex_escape(names[metric])}{unit} {sign}".strip()

    def body(method: str, metric: str) -> str:
        row = cells.get((method, metric))
        if row is None or not np.isfinite(row.mean):
            return "--"
        if row.n == 1:
            return number(row.mean)
        return rf"\shortstack[r]{{{number(row.mean)}\\{{\tiny [{number(row.low)}, {number(row.high)}]}}}}"

    tabular = [
        rf"\begin{{tabular}}{{l{'r' * len(methods)}}}",
        r"\toprule",
        " & ".join(["metric", *(rf"\rotatebox{{60}}{{{latex_escape(labels[method])}}}" for method in methods)])
        + r" \\",
        r"\midrule",
        *(" & ".join([head(metric), *(body(method, metric) for method in methods)]) + r" \\" for metric in metrics),
        r"\bottomrule",
        r"\end{tabular}",
    ]
    lines = [
        "% needs: booktabs, graphicx",
        r"\begin{table}",
        r"\centering\footnotesize\setlength{\tabcolsep}{3pt}",
        rf"\caption{{{latex_escape(caption)}}}",
        rf"\label{{{latex_label(label)}}}",
        *fitted(tabular),
        r"\end{table}",
    ]
    return "\n".join(lines) + "\n"


def with_values(table: pd.DataFrame) -> pd.DataFrame:
    """The rows of those metrics for which some method has a value; no column of dashes for jumps where nobody jumps."""
    return table[table.groupby("metric")["mean"].transform("count") > 0]


def markdown_leaderboard(table: pd.DataFrame) -> str:
    """A Markdown table, one metric a row and one method a column, mean with its 95 % interval.

    Parameters
    ----------
    table
        As :meth:`reports.run.RunView.leaderboard` gives it.
    """
    rows: list[Any] = list(table.itertuples())
    labels = {row.method: row.label for row in rows}
    metrics = {row.metric: row for row in reversed(rows)}
    cells = {(row.method, row.metric): row for row in rows}

    def head(row: Any) -> str:
        unit = "" if row.unit in ("", "1") else f", {row.unit}"
        return markdown_escape(f"{row.metric}{unit} {arrow(row.direction, row.target)}")

    def body(row: Any) -> str:
        if row is None or not np.isfinite(row.mean):
            return "–"
        return f"{number(row.mean)} [{number(row.low)}, {number(row.high)}]" if row.n > 1 else number(row.mean)

    lines = [
        "| metric | " + " | ".join(map(markdown_escape, labels.values())) + " |",
        "| --- |" + " ---: |" * len(labels),
        *(
            f"| {head(metrics[metric])} | " + " | ".join(body(cells.get((method, metric))) for method in labels) + " |"
            for metric in dict.fromkeys(row.metric for row in rows)
        ),
    ]
    return "\n".join(lines) + "\n"


def write_tables(run: RunView) -> list[Path]:
    """Write ``tables/leaderboard-TASK-VARIANT.{csv,tex,md}`` for each task and variant; return their paths.

    The LaTeX file holds one table for each group of metrics.
    """
    folder = run.folder / "tables"
    folder.mkdir(exist_ok=True)
    written = []
    for task in run.tasks:
        for variant in run.variants(task):
            table = run.leaderboard(task, variant=variant)
            stem = f"leaderboard-{task.replace(':', '-to-')}-{variant}"
            csv, tex = folder / f"{stem}.csv", folder / f"{stem}.tex"
            table.drop(columns="label").to_csv(csv, index=False)
            how = "means over clips with 95 % intervals (clustered bootstrap, actors and then their clips)"
            parts = [
                latex_leaderboard(
                    part,
                    caption=f"{run.dataset_title}, {task.replace(':', ' to ')}, {variant} results, {group}: {how}.",
                    label=f"tab:{stem}-{group}",
                )
                for group, part in by_group(with_values(table)).items()
            ]
            tex.write_text("\n".join(parts), encoding="utf-8")
            markdown = folder / f"{stem}.md"
            markdown.write_text(markdown_leaderboard(with_values(table)), encoding="utf-8")
            written += [csv, tex, markdown]
    return written
