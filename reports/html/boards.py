"""The leaderboard as tables: one for each task, variant and group of metrics, and one of a few metrics of every group."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from reports.html.metrics import GROUPS, meaning
from reports.run import FLOOR, RunView
from reports.tables import arrow, by_group, column_names, number, with_values

if TYPE_CHECKING:
    import pandas as pd

#: The metrics shown first, of those that the run has: one or two questions of each group, in their order.
OVERVIEW = (
    "truth/pose-distance",
    "recognition/p-target-temporal",
    "recognition/p-target-kinematic",
    "distribution/frechet-kinematic",
    "style/d-s",
    "style/speed-ratio",
    "content/pose-distance",
    "recognition/action-accuracy-temporal",
    "content/trajectory-deviation",
    "timing/duration-ratio",
    "physics/foot-skate-ratio",
    "physics/jerk-ratio",
)

#: The name of the table of these.
SUMMARY = "overview"


def task_boards(run: RunView, task: str) -> list[dict[str, Any]]:
    """The tables of one task: the overview, then one for each group; each for every variant of results."""
    boards = []
    methods = run.methods(task)
    for variant in run.variants(task):
        table = run.leaderboard(task, variant=variant)
        chosen = [metric for metric in OVERVIEW if metric in set(with_values(table)["metric"])]
        if len(chosen) > 1:
            part = table[table["metric"].isin(chosen)]
            order = part["metric"].map({metric: place for place, metric in enumerate(chosen)})
            boards.append(
                _board(run, task, methods, variant, SUMMARY, part.loc[order.sort_values(kind="stable").index])
            )
        boards += [_board(run, task, methods, variant, group, part) for group, part in by_group(table).items()]
    return boards


def group_names(boards: list[dict[str, Any]]) -> list[str]:
    """The groups that there are tables for, the overview first."""
    return list(dict.fromkeys(board["group"] for board in boards))


def meanings(run: RunView, tasks: list[str]) -> dict[str, list[dict[str, str]]]:
    """Every metric of the run in words, by group."""
    from benchmark.runner.views import COSTS, read_leaderboard

    rows: dict[str, dict[str, Any]] = {}
    for row in read_leaderboard(run.folder):
        if row["metric"] not in COSTS and row["task"] in tasks:
            rows.setdefault(row["metric"], row)
    found: dict[str, list[dict[str, str]]] = {}
    for metric, row in rows.items():
        entry = asdict(meaning(metric, row["unit"], row["direction"], row["target"]))
        found.setdefault(metric.partition("/")[0], []).append({**entry, "id": metric_id(metric)})
    return {
        group: found[group] for group in [*(g for g in GROUPS if g in found), *(g for g in found if g not in GROUPS)]
    }


def metric_id(metric: str) -> str:
    """The id of a metric's explanation on the page: letters, digits and hyphens, different for different names."""
    return "metric-" + "".join(sign if sign.isalnum() and sign.isascii() else f"-{ord(sign):x}-" for sign in metric)


def _board(
    run: RunView, task: str, methods: list[str], variant: str, group: str, table: pd.DataFrame
) -> dict[str, Any]:
    entries: dict[tuple[str, str], Any] = {}
    first: dict[str, Any] = {}
    row: Any
    for row in table.itertuples():
        entries[row.method, row.metric] = row
        first.setdefault(row.metric, row)
    names = {metric: metric for metric in first} if group == SUMMARY else column_names(first)
    columns = [_column(metric, names[metric], row, _counts(entries, methods, metric)) for metric, row in first.items()]
    best = {metric: _best(run, [entries.get((method, metric)) for method in methods]) for metric in first}
    return {
        "task": task,
        "group": group,
        "variant": variant,
        "title": f"{group}: {task.replace(':', ' to ')}" + ("" if variant == "raw" else f", {variant}"),
        "about": "a few metrics of every group" if group == SUMMARY else GROUPS.get(group, ""),
        "columns": columns,
        "rows": [
            {
                "label": run.label(method),
                "anchor": {FLOOR: "floor", run.real_method: "real"}.get(method, ""),
                "cells": [
                    _cell(entries.get((method, metric)), method in best[metric], varies=columns[index]["n"] == "")
                    for index, metric in enumerate(first)
                ],
            }
            for method in methods
        ],
        "reasons": _reasons(run, methods, first, entries, names),
    }


def _counts(entries: dict[tuple[str, str], Any], methods: list[str], metric: str) -> set[int]:
    rows = (entries.get((method, metric)) for method in methods)
    return {row.n for row in rows if row is not None and np.isfinite(row.mean)}


def _column(metric: str, name: str, row: Any, counts: set[int]) -> dict[str, Any]:
    group, _, short = name.rpartition("/")
    return {
        "metric": metric,
        "id": metric_id(metric),
        "group": f"{group}/" if group else "",
        "name": short,
        "arrow": arrow(row.direction, row.target),
        "unit": "" if row.unit in ("", "1") else row.unit,
        "direction": row.direction,
        "target": "" if not np.isfinite(row.target) else repr(float(row.target)),
        # Where methods differ in how many clips have a value, each cell says it.
        "n": "" if len(counts) != 1 else _count(counts.pop()),
    }


def _count(n: int) -> str:
    return f"n = {n}" if n > 1 else "one value"


def _best(run: RunView, rows: list[Any]) -> set[str]:
    """The methods with the best mean, without the floor and the real performers, who are no competitors; rounded as shown."""
    good = [
        row for row in rows if row is not None and np.isfinite(row.mean) and row.method not in (FLOOR, run.real_method)
    ]
    if len(good) < 2 or good[0].direction == "none":
        return set()
    direction, target = good[0].direction, good[0].target
    loss = {row.method: {"lower": row.mean, "higher": -row.mean}.get(direction, abs(row.mean - target)) for row in good}
    shown = {row.method: number(row.mean) for row in good}
    winner = min(loss, key=lambda method: loss[method])
    return {method for method in loss if shown[method] == shown[winner]}


def _cell(row: Any, best: bool, *, varies: bool) -> dict[str, Any]:
    if row is None or not np.isfinite(row.mean):
        reason = "not scored" if row is None else row.reason
        return {"value": "", "text": "–", "interval": "", "title": reason, "best": False, "n": ""}
    return {
        "value": repr(float(row.mean)),
        "text": number(row.mean),
        "interval": f"[{number(row.low)}, {number(row.high)}]" if row.n > 1 else "",
        "title": f"n = {row.n} clips" if row.n > 1 else "one value for all clips together",
        "best": best,
        "n": _count(row.n) if varies else "",
    }


def _reasons(
    run: RunView, methods: list[str], first: dict[str, Any], entries: dict[tuple[str, str], Any], names: dict[str, str]
) -> list[dict[str, str]]:
    """Why dashes are dashes: a line for each reason, with the metrics and methods it is of."""
    found: dict[str, tuple[dict[str, None], dict[str, None]]] = {}
    for metric in first:
        for method in methods:
            row = entries.get((method, metric))
            if row is None or not np.isfinite(row.mean):
                reason = "not scored" if row is None else row.reason
                metrics, rows = found.setdefault(reason, ({}, {}))
                metrics[names[metric]] = rows[run.label(method)] = None
    return [
        {
            "reason": reason,
            "metrics": "every metric" if len(metrics) == len(first) > 1 else ", ".join(metrics),
            "methods": "every method" if len(rows) == len(methods) > 1 else ", ".join(rows),
        }
        for reason, (metrics, rows) in found.items()
    ]
