"""Deviations of paths and headings from the source's, as tables for papers."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from eval.stats.bootstrap import clustered_mean
from reports.figures.trajectories import DEVIATION, HEADING
from reports.latex import fitted, latex_escape, latex_label
from reports.run import RunView
from reports.tables import number

if TYPE_CHECKING:
    import pandas as pd

_NAMES = {DEVIATION: "path (leg)", HEADING: "heading (deg)"}


def deviation_table(run: RunView, task: str) -> pd.DataFrame:
    """Mean stored deviations by method and action, and over all actions (``action`` is then ``all``).

    Columns ``method, label, metric, action, mean, low, high, n``: raw results, repetitions of a clip averaged first, 95 %
    intervals from resampling actors and then their clips.
    """
    import pandas as pd

    rows = run.results
    rows = rows[
        (rows["task"] == task) & (rows["variant"] == "raw") & rows["metric"].isin(_NAMES) & (rows["status"] == "ok")
    ]
    clips = rows.groupby(["method", "metric", "action", "actor", "clip_id"])["value"].mean().reset_index()
    order = {method: rank for rank, method in enumerate(run.methods(task))}
    table = []
    for metric in _NAMES:
        for method in order:
            own = clips[(clips["method"] == method) & (clips["metric"] == metric)]
            for action, part in [("all", own), *own.groupby("action")]:
                if len(part):
                    interval = clustered_mean(part["value"].to_numpy(), part["actor"].tolist())
                    entry = {"method": method, "label": run.label(method), "metric": metric, "action": action}
                    table.append({**entry, **interval._asdict(), "n": len(part)})
    return pd.DataFrame(table, columns=["method", "label", "metric", "action", "mean", "low", "high", "n"])


def latex_deviations(table: pd.DataFrame, *, caption: str, label: str, actions: int = 4) -> str:
    """A booktabs table: a row a method; all clips with intervals, then the ``actions`` of which the paths differ most."""
    whole = table[table["action"] == "all"]
    paths = table[(table["action"] != "all") & (table["metric"] == DEVIATION)]
    widest = paths.groupby("action")["mean"].max().sort_values(ascending=False).index[:actions].tolist()
    methods = list(dict.fromkeys(table["method"]))
    metrics = [metric for metric in _NAMES if metric in set(whole["metric"])]

    def cell(method: str, metric: str, action: str) -> str:
        found = table[(table["method"] == method) & (table["metric"] == metric) & (table["action"] == action)]
        if found.empty or not np.isfinite(found["mean"].iloc[0]):
            return "--"
        row = found.iloc[0]
        if action != "all" or row["n"] == 1:
            return number(row["mean"])
        return rf"{number(row['mean'])} {{\tiny [{number(row['low'])}, {number(row['high'])}]}}"

    columns = [(metric, "all") for metric in metrics] + [(DEVIATION, action) for action in widest]
    heads = [_NAMES[metric] if action == "all" else action.replace("-", " ") for metric, action in columns]
    labels = dict(zip(table["method"], table["label"], strict=True))
    tabular = [
        rf"\begin{{tabular}}{{l{'r' * len(columns)}}}",
        r"\toprule",
        " & ".join(["method", *(rf"\rotatebox{{60}}{{{latex_escape(head)}}}" for head in heads)]) + r" \\",
        r"\midrule",
        *(
            " & ".join([latex_escape(labels[method]), *(cell(method, *column) for column in columns)]) + r" \\"
            for method in methods
        ),
        r"\bottomrule",
        r"\end{tabular}",
    ]
    lines = [
        "% needs: booktabs, graphicx",
        r"\begin{table}",
        r"\centering\small",
        rf"\caption{{{latex_escape(caption)}}}",
        rf"\label{{{latex_label(label)}}}",
        *fitted(tabular),
        r"\end{table}",
    ]
    return "\n".join(lines) + "\n"


def write_trajectory_tables(run: RunView) -> list[Path]:
    """Write ``tables/trajectories-TASK.{csv,tex}`` for each task with stored deviations; return their paths."""
    written = []
    for task in run.tasks:
        table = deviation_table(run, task)
        if table.empty:
            continue
        folder = run.folder / "tables"
        folder.mkdir(exist_ok=True)
        stem = f"trajectories-{task.replace(':', '-to-')}"
        csv, tex = folder / f"{stem}.csv", folder / f"{stem}.tex"
        table.drop(columns="label").to_csv(csv, index=False)
        clips = int(table["n"].max())
        caption = (
            f"{run.dataset_title}, {task.replace(':', ' to ')}, raw results: mean deviation of the path over the floor and of "
            f"the heading from the source's, over {clips} clips with 95 % intervals (actors, then their clips), and of the "
            "path for the actions in which it differs most."
        )
        tex.write_text(latex_deviations(table, caption=caption, label=f"tab:{stem}"), encoding="utf-8")
        written += [csv, tex]
    return written
