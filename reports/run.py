"""A finished run as the figures and the page see it: what is stored, and nothing computed anew but means and intervals."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import StoreError
from benchmark.motion.clip import MotionClip
from benchmark.runner.items import read_items
from benchmark.runner.store import read_json
from benchmark.runner.views import LEADERBOARD, REAL, RESULT_COLUMNS, RESULTS, read_leaderboard

if TYPE_CHECKING:
    import pandas as pd

#: Columns of texts that hardly vary from row to row.
FEW = (
    *("run", "method_version", "params_digest", "dataset_digest", "split_digest"),
    *("metric_version", "probe_digest"),
)

#: The row to start a strip with, where the run has it: the source on the target's body.
FLOOR = "identity"


@dataclass(frozen=True)
class StoredCell:
    """One cell that ended ``ok``: its folder, its method's label, and what was transferred."""

    folder: Path
    method: str
    repetition: int
    items: tuple[dict[str, Any], ...]

    def clip(self, clip_id: str, variant: str = "raw") -> MotionClip | None:
        """The stored result for one source clip, or ``None`` if there is none."""
        from benchmark.motion import npz

        for item in self.items:
            if item["clip_id"] == clip_id and item["state"] == "ok":
                path = self.folder / "outputs" / f"{item['stem']}.{variant}.npz"
                return npz.load(path) if path.exists() else None
        return None

    def time_map(self, clip_id: str) -> NDArray[np.float64] | None:
        """(T,) the source time that each frame of the result shows, where the method stated it."""
        from benchmark.runner.execute import OUTPUTS, load_extras

        item = self.item(clip_id)
        return (
            None if item is None else load_extras(self.folder / OUTPUTS / f"{item['stem']}.extras.npz").get("time_map")
        )

    @property
    def results(self) -> list[str]:
        """Ids of the source clips that have a result."""
        return [item["clip_id"] for item in self.items if item["state"] == "ok"]

    def item(self, clip_id: str) -> dict[str, Any] | None:
        """What is stored of the transfer of one source clip, or ``None`` where it has no result."""
        return next((item for item in self.items if item["clip_id"] == clip_id and item["state"] == "ok"), None)


class RunView:
    """A finished run.

    Parameters
    ----------
    folder
        The run folder.

    Raises
    ------
    StoreError
        If the folder holds no finished run.
    """

    #: The method whose rows are real performers of the target style.
    real_method = REAL

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        for name in (RESULTS, LEADERBOARD):
            if not (folder / name).is_file():
                raise StoreError(
                    f"{folder} has no {name}: give the folder of a finished run, for example runs/synthetic-adult-child"
                )

    @cached_property
    def results(self) -> pd.DataFrame:
        """``results.parquet``, with a column ``task``; digests and versions, of which there are few, as categories."""
        import pyarrow.parquet as parquet

        try:
            # One thread: with more, each takes memory of its own for the texts, which costs more than it gains.
            stored = parquet.read_table(
                self.folder / RESULTS,
                read_dictionary=list(FEW),
                use_threads=False,
                page_checksum_verification=True,
            )
            table: pd.DataFrame = stored.select(list(RESULT_COLUMNS)).to_pandas(split_blocks=True, self_destruct=True)
        except (OSError, ValueError, KeyError) as error:  # those of pyarrow are such
            raise StoreError(
                f"{self.folder / RESULTS} is damaged ({error}): restore it with `python -m benchmark score {self.folder}`"
            ) from error
        table["task"] = table["source_style"] + ":" + table["target_style"]
        return table

    @cached_property
    def tasks(self) -> list[str]:
        """The tasks, as ``source:target``, in the order of the plan."""
        return [str(task) for task in self.results["task"].unique()]

    @cached_property
    def empty_cells(self) -> frozenset[str]:
        """Keys of the cells that did not end ``ok``; their rows hold the reason, once for each metric."""
        rows = self.results
        ended = rows[(rows["metric"] == "cost/fit_seconds") & (rows["status"] != "ok")]
        return frozenset(ended["cell_key"])

    @cached_property
    def dataset(self) -> str:
        """Id of the data set."""
        return str(self.results["dataset"].iloc[0])

    @cached_property
    def dataset_title(self) -> str:
        """The data set as captions name it; generated data is called synthetic."""
        return "Synthetic data" if self.dataset == "synthetic" else self.dataset

    def methods(self, task: str) -> list[str]:
        """The methods of a task in order: the floor first, real performers last."""
        if task not in self._methods:
            found = self.results.loc[self.results["task"] == task, "method"].unique().tolist()
            self._methods[task] = sorted(found, key=lambda name: (name == REAL) - (name == FLOOR))
        return list(self._methods[task])

    @cached_property
    def _methods(self) -> dict[str, list[str]]:
        return {}

    def variants(self, task: str) -> list[str]:
        """The variants of results that were scored, ``raw`` first."""
        rows = self.results
        found = set(rows.loc[(rows["task"] == task) & (rows["status"] == "ok"), "variant"].unique()) | {"raw"}
        return sorted(found, key=lambda name: (name != "raw", name))

    def label(self, method: str) -> str:
        """A method as figures and tables name it."""
        if method != REAL:
            return method
        return "held-out performer" if self.dataset == "synthetic" else "real performer"

    def cells(self, task: str) -> list[StoredCell]:
        """The cells of a task that ended ``ok``, in the order of :meth:`methods`, then by repetition."""
        if task not in self._cells:
            self._cells[task] = self._read_cells(task)
        return list(self._cells[task])

    @cached_property
    def _cells(self) -> dict[str, list[StoredCell]]:
        """Cells read so far: each figure asks for them several times."""
        return {}

    def _read_cells(self, task: str) -> list[StoredCell]:
        rows = self.results[self.results["task"] == task]
        found = []
        for row in rows[["cell_key", "method", "repetition"]].drop_duplicates().to_dict("records"):
            folder = self.folder / "cells" / row["cell_key"]
            if (folder / "items.json").is_file():
                items = tuple(read_items(folder))
                found.append(StoredCell(folder, row["method"], int(row["repetition"]), items))
        order = {method: rank for rank, method in enumerate(self.methods(task))}
        return sorted(found, key=lambda cell: (order[cell.method], cell.repetition))

    def leaderboard(self, task: str, *, variant: str = "raw", costs: bool = False) -> pd.DataFrame:
        """One row for each (method, metric), with means and intervals over clips within actors.

        Columns ``method, label, metric, unit, direction, target, mean, low, high, n, reason``; ``mean`` is NaN where no
        clip has a value, and ``reason`` then says why. Repetitions of a clip are averaged first.
        """
        key = (task, variant, costs)
        if key not in self._boards:
            self._boards[key] = self._leaderboard(task, variant=variant, costs=costs)
        return self._boards[key].copy()

    @cached_property
    def _boards(self) -> dict[tuple[str, str, bool], pd.DataFrame]:
        """Leaderboards made so far: figures, tables and page ask for the same ones, and intervals take their time."""
        return {}

    def _leaderboard(self, task: str, *, variant: str, costs: bool) -> pd.DataFrame:
        import pandas as pd

        from eval.stats.bootstrap import clustered_mean

        meaning = {
            (row["metric"]): (row["unit"], row["direction"], row["target"])
            for row in read_leaderboard(self.folder)
            if row["task"] == task
        }
        rows = self.results
        # A cell that failed or was skipped has no variants; its reason stands in the table of each.
        rows = rows[(rows["task"] == task) & ((rows["variant"] == variant) | rows["cell_key"].isin(self.empty_cells))]
        rows = rows[rows["metric"].str.startswith("cost/") == costs]
        order = {method: rank for rank, method in enumerate(self.methods(task))}
        good = rows[rows["status"] == "ok"]
        # Grouped once for all metrics: a table of its own for each would take most of a report's time.
        clips = good.groupby(["method", "metric", "actor", "clip_id"], sort=True)["value"].mean().reset_index()
        spans = clips.groupby(["method", "metric"]).indices
        values, actors = clips["value"].to_numpy(), clips["actor"].to_numpy(dtype=object)
        without = rows[rows["status"] != "ok"]
        told = without.groupby(["method", "metric"])["reason"].agg(lambda reasons: sorted(set(reasons))).to_dict()
        table = []
        for method, metric in rows[["method", "metric"]].drop_duplicates().itertuples(index=False):
            at = spans.get((method, metric), np.zeros(0, dtype=int))
            interval = clustered_mean(values[at], actors[at].tolist())
            unit, direction, target = meaning.get(metric, ("", "none", None))
            reasons = [] if len(at) else told.get((method, metric), [])
            table.append(
                {
                    "method": method,
                    "label": self.label(str(method)),
                    "metric": metric,
                    "unit": unit,
                    "direction": direction,
                    "target": float("nan") if target is None else target,
                    **interval._asdict(),
                    "n": len(at),
                    "reason": "; ".join(reasons),
                }
            )
        columns = ["method", "label", "metric", "unit", "direction", "target", "mean", "low", "high", "n", "reason"]
        frame = pd.DataFrame(table, columns=columns)
        rank = frame["method"].map(order)
        metric_order = {metric: rank for rank, metric in enumerate(dict.fromkeys(frame["metric"]))}
        metric_rank = frame["metric"].map(metric_order)
        return (
            frame.assign(_m=rank, _k=metric_rank)
            .sort_values(["_k", "_m"])
            .drop(columns=["_m", "_k"])
            .reset_index(drop=True)
        )

    def showpiece(self, task: str) -> str | None:
        """The source clip to show: see :meth:`showpieces`; ``None`` without results."""
        return next(iter(self.showpieces(task, 1)), None)

    def showpieces(self, task: str, count: int, *, among: Container[str] | None = None) -> list[str]:
        """Source clips of different actions that most methods have a result for and that, of those, move most.

        ``among``, where given, are the only ones to choose from.
        The measure of movement is the median over frames of the mean joint speed of the first method's result, in leg lengths
        a second; a median, because the fastest frames of a depth camera's capture are its misses.
        """
        if task not in self._movements:
            self._movements[task] = self._most_moving(task)
        chosen: dict[str, str] = {}
        for clip_id, action in self._movements[task]:
            if among is None or clip_id in among:
                chosen.setdefault(action, clip_id)
        return list(chosen.values())[:count]

    @cached_property
    def _movements(self) -> dict[str, list[tuple[str, str]]]:
        return {}

    def _most_moving(self, task: str) -> list[tuple[str, str]]:
        """Clip ids with their actions, those to show first first."""
        cells = self.cells(task)
        first = next((cell for cell in cells if cell.method != REAL), None)
        if first is None:
            return []
        counts: dict[str, int] = {}
        actions: dict[str, str] = {}
        for cell in cells:
            for item in cell.items:
                if item["state"] == "ok":
                    counts[item["clip_id"]] = counts.get(item["clip_id"], 0) + 1
                    actions[item["clip_id"]] = item["action"]

        def movement(clip_id: str) -> float:
            clip = first.clip(clip_id)
            if clip is None or len(clip) < 2:
                return -1.0
            local = clip.positions - clip.positions[:, :1]
            speed = np.linalg.norm(np.diff(local, axis=0), axis=-1).mean(axis=1) * clip.fps
            return float(np.median(speed) / clip.skeleton.leg_length)

        best = sorted(clip_id for clip_id in counts if counts[clip_id] == max(counts.values()))
        return [(clip_id, actions[clip_id]) for clip_id in sorted(best, key=movement, reverse=True)]

    def renderings(self, task: str, clip_id: str) -> list[tuple[str, MotionClip]]:
        """Every method's raw result for one source clip, first repetition."""
        found: dict[str, MotionClip] = {}
        for cell in self.cells(task):
            clip = cell.clip(clip_id)
            if clip is not None and cell.method not in found:
                found[cell.method] = clip
        return list(found.items())

    def clip_facts(self, clip_id: str) -> dict[str, Any]:
        """Actor, action and whether the actor was seen in training, of one source clip."""
        row = self.results[self.results["clip_id"] == clip_id].iloc[0]
        return {name: row[name] for name in ("clip_id", "actor", "action", "seen_actor")}

    def fit_residuals(self) -> dict[str, dict[str, float]]:
        """Per source clip, median and 95th percentile distance in metres of joints to where they were measured.

        Empty for captures that hold rotations.
        """
        items = [item for task in self.tasks for cell in self.cells(task) for item in cell.items]
        return {item["clip_id"]: item["fit_residual"] for item in items if item.get("fit_residual")}

    def document(self, name: str) -> Any:
        """A JSON file of the run folder, or ``None`` if the run did not write it."""
        path = self.folder / name
        return read_json(path) if path.is_file() else None
