"""``results.parquet`` and ``leaderboard.csv``: views over the cells of a plan, rebuilt when any of them changed."""

from __future__ import annotations

import csv
import io
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmark.digest import digest, file_digest
from benchmark.errors import StoreError
from benchmark.runner.items import read_items
from benchmark.runner.job import MetricJob
from benchmark.runner.parquet import write_rows
from benchmark.runner.plan import Cell
from benchmark.runner.score import read_scores, rows_digest
from benchmark.runner.store import CellStatus, RunStore, read_json, write_json, write_text

RESULTS, LEADERBOARD, MARK = "results.parquet", "leaderboard.csv", ".views.json"

#: Columns of ``results.parquet`` in order, with their types.
RESULT_COLUMNS = {
    "run": "string",
    "cell_key": "string",
    "method": "string",
    "method_version": "string",
    "params_digest": "string",
    "dataset": "string",
    "dataset_digest": "string",
    "split": "string",
    "split_digest": "string",
    "source_style": "string",
    "target_style": "string",
    "clip_id": "string",
    "actor": "string",
    "action": "string",
    "seen_actor": "bool",
    "repetition": "int64",
    "seed": "int64",
    "variant": "string",
    "metric": "string",
    "metric_version": "string",
    "probe_digest": "string",
    "value": "double",
    "unit": "string",
    "status": "string",
    "reason": "string",
}

LEADERBOARD_COLUMNS = (
    "dataset",
    "task",
    "method",
    "variant",
    "metric",
    "unit",
    "direction",
    "target",
    "mean",
    "sd",
    "n",
    "skipped",
    "failed",
    "repetitions",
    "real_mean",
    "real_n",
    "reason",
)

#: Metrics that the runner itself measures, with their units. Time and memory are of this run on this machine: their rows are
#: the only ones that differ between two runs of the same cells.
COSTS: Mapping[str, str] = {
    "cost/fit_seconds": "s",
    "cost/transfer_seconds": "s",
    "cost/peak_memory": "B",
    "cost/parameters": "1",
    "cost/model_bytes": "B",
}

#: The method whose row is real motion.
REAL = "child-reference"

Row = dict[str, Any]


def views_digest(
    folder: Path, cells: Sequence[Cell], metrics: Sequence[MetricJob], states: Mapping[str, CellStatus]
) -> str:
    """Digest of everything that the views are made of."""
    store = RunStore(folder)
    parts = [
        [cell.method, cell.key, cell.fate, cell.reason, _state(cell, states).state, _state(cell, states).reason]
        + [rows_digest(store.cell(cell.key)), _costs(_state(cell, states))]
        for cell in cells
    ]
    return digest({"run": folder.name, "cells": parts, "metrics": [[metric.name, metric.digest] for metric in metrics]})


def views_are_current(folder: Path, state: str) -> bool:
    """Whether the views on disk were made of ``state``, the :func:`views_digest` of now."""
    if not all((folder / name).is_file() for name in (MARK, RESULTS, LEADERBOARD)):
        return False
    try:
        return bool(read_json(folder / MARK) == _mark(folder, state))
    except StoreError:  # a damaged marker vouches for nothing
        return False


def _mark(folder: Path, state: str) -> dict[str, Any]:
    return {"state": state, "files": {name: file_digest(folder / name) for name in (RESULTS, LEADERBOARD)}}


def build_views(
    folder: Path,
    cells: Sequence[Cell],
    metrics: Sequence[MetricJob],
    states: Mapping[str, CellStatus],
    directions: Mapping[str, tuple[str, float | None]],
) -> None:
    """Write both views, each atomically."""
    tally = Tally()
    rows = (row for cell in cells for row in cell_rows(folder, cell, metrics, states))
    write_rows(folder / RESULTS, tally.counting(rows), RESULT_COLUMNS)
    text = io.StringIO()
    writer = csv.DictWriter(text, LEADERBOARD_COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(tally.leaderboard(directions))
    write_text(folder / LEADERBOARD, text.getvalue())
    write_json(folder / MARK, _mark(folder, views_digest(folder, cells, metrics, states)))


def _state(cell: Cell, states: Mapping[str, CellStatus]) -> CellStatus:
    if cell.fate != "run":
        return CellStatus(cell.fate, cell.reason)
    return states[cell.key]


def _costs(status: CellStatus) -> Mapping[str, Any]:
    costs: Mapping[str, Any] = status.facts.get("costs", {})
    return costs


def cell_rows(
    folder: Path, cell: Cell, metrics: Sequence[MetricJob], states: Mapping[str, CellStatus]
) -> Iterable[Row]:
    """The rows of one cell: its scores and costs, or one row for each metric that says why there are none."""
    source, target = cell.styles
    common = {
        "run": folder.name,
        "cell_key": cell.key,
        "method": cell.method,
        "method_version": cell.method_version,
        "params_digest": cell.params_digest,
        "dataset": cell.dataset,
        "dataset_digest": cell.dataset_digest,
        "split": cell.split,
        "split_digest": cell.split_digest,
        "source_style": source,
        "target_style": target,
        "repetition": cell.repetition,
        "seed": cell.seed,
    }
    status = _state(cell, states)
    if status.state != "ok":
        state = status.state if status.state in ("skipped", "failed") else "skipped"
        for metric in metrics:
            yield {
                **common,
                **_empty(metric.name, metric.unit, metric.version),
                "status": state,
                "reason": status.reason,
            }
        for name, unit in COSTS.items():
            yield {**common, **_empty(name, unit), "status": state, "reason": status.reason}
        return
    place = RunStore(folder).cell(cell.key)
    scores = read_scores(place)
    wanted = {metric.name: metric for metric in metrics}
    found = {row["metric"] for row in scores.rows}
    for row in scores.rows:
        if row["metric"] in wanted:
            yield {**common, **row}
    for name, metric in wanted.items():
        if name not in found:
            missing = {"status": "failed", "reason": "not scored: the scoring process did not finish"}
            yield {**common, **_empty(name, metric.unit, metric.version), **missing}
    costs = _costs(status)
    for name, unit in COSTS.items():
        if name == "cost/transfer_seconds":
            continue
        value = costs.get(name.removeprefix("cost/"))
        problem = {} if value is not None else {"status": "skipped", "reason": "not measured on this platform"}
        number = None if value is None else float(value)
        yield {**common, **_empty(name, unit), "value": number, "status": "ok", **problem}
    for item in read_items(place):
        row = {name: item[name] for name in ("clip_id", "actor", "action", "seen_actor")}
        row |= {"value": item.get("transfer_seconds"), "status": item["state"], "reason": item["reason"]}
        yield {**common, **_empty("cost/transfer_seconds", "s"), **row}


def _empty(metric: str, unit: str, version: str = "1") -> Row:
    return {
        "clip_id": "",
        "actor": "",
        "action": "",
        "seen_actor": None,
        "variant": "raw",
        "metric": metric,
        "metric_version": version,
        "probe_digest": "",
        "value": None,
        "unit": unit,
        "status": "skipped",
        "reason": "",
    }


@dataclass
class _Group:
    """What the leaderboard needs of the rows of one task, method, variant and metric."""

    dataset: str
    unit: str
    values: list[float] = field(default_factory=list)
    states: Counter[str] = field(default_factory=Counter)
    repetitions: set[int] = field(default_factory=set)
    reasons: set[str] = field(default_factory=set)


class Tally:
    """Counts rows of ``results.parquet`` as they go by, for the leaderboard: a run may have more than memory holds."""

    def __init__(self) -> None:
        self._groups: dict[tuple[str, str, str, str], _Group] = {}

    def counting(self, rows: Iterable[Row]) -> Iterator[Row]:
        """The same rows."""
        for row in rows:
            task = f"{row['source_style']}:{row['target_style']}"
            key = task, row["method"], row["variant"], row["metric"]
            group = self._groups.get(key)
            if group is None:
                group = self._groups[key] = _Group(row["dataset"], row["unit"])
            group.states[row["status"]] += 1
            group.repetitions.add(row["repetition"])
            if row["status"] == "ok":
                group.values.append(row["value"])
            else:
                group.reasons.add(row["reason"])
            yield row

    def leaderboard(self, directions: Mapping[str, tuple[str, float | None]]) -> list[Row]:
        """Mean over clips and repetitions of every (task, method, variant, metric), with the value of real motion beside it.

        Parameters
        ----------
        directions
            Direction and target of each metric.

        Returns
        -------
        list of dict
            In the order of the rows, with the columns :data:`LEADERBOARD_COLUMNS`; ``mean`` is empty where no row is ``ok``,
            and ``reason`` then says why.
        """
        table: list[Row] = []
        for (task, method, variant, metric), group in self._groups.items():
            values = group.values
            reference = self._groups.get((task, REAL, "raw", metric))
            real = reference.values if reference is not None else []
            direction, target = directions.get(metric, ("lower" if metric in COSTS else "none", None))
            table.append(
                {
                    "dataset": group.dataset,
                    "task": task,
                    "method": method,
                    "variant": variant,
                    "metric": metric,
                    "unit": group.unit,
                    "direction": direction,
                    "target": target,
                    "mean": _mean(values),
                    "sd": _sd(values),
                    "n": len(values),
                    "skipped": group.states["skipped"],
                    "failed": group.states["failed"],
                    "repetitions": len(group.repetitions),
                    "real_mean": _mean(real),
                    "real_n": len(real),
                    "reason": "; ".join(sorted(group.reasons)) if not values else "",
                }
            )
        return table


def leaderboard(rows: Iterable[Row], directions: Mapping[str, tuple[str, float | None]]) -> list[Row]:
    """:meth:`Tally.leaderboard` of ``rows``."""
    tally = Tally()
    for _ in tally.counting(rows):
        pass
    return tally.leaderboard(directions)


def _mean(values: Sequence[float]) -> float | None:
    return math.fsum(values) / len(values) if values else None


def _sd(values: Sequence[float]) -> float | None:
    if len(values) < 2:
        return None
    mean = math.fsum(values) / len(values)
    return math.sqrt(math.fsum((value - mean) ** 2 for value in values) / (len(values) - 1))


def read_leaderboard(folder: Path) -> list[Row]:
    """The rows of ``leaderboard.csv``, numbers as numbers; a :class:`StoreError` if the run has none yet."""
    if not (folder / LEADERBOARD).is_file():
        raise StoreError(
            f"{folder / LEADERBOARD} is missing: finish the run, or restore its tables with "
            f"`python -m benchmark score {folder}`"
        )
    numbers = {"target", "mean", "sd", "real_mean"}
    counts = {"n", "skipped", "failed", "repetitions", "real_n"}
    path, line = folder / LEADERBOARD, 1
    rows: list[Row] = []
    try:
        with path.open(encoding="utf-8", newline="") as file:
            reader = csv.DictReader(file, strict=True)
            if tuple(reader.fieldnames or ()) != LEADERBOARD_COLUMNS:
                raise ValueError(f"its columns must be {', '.join(LEADERBOARD_COLUMNS)}")
            for cells in reader:
                line = reader.line_num
                if None in cells or None in cells.values():
                    raise ValueError(f"there must be {len(LEADERBOARD_COLUMNS)} cells")
                rows.append(
                    {
                        key: (float(value) if value else None)
                        if key in numbers
                        else int(value)
                        if key in counts
                        else value
                        for key, value in cells.items()
                    }
                )
    except (OSError, ValueError, csv.Error) as error:
        raise StoreError(
            f"{path}, line {line}: {error}; restore it with `python -m benchmark score {folder}`"
        ) from error
    return rows
