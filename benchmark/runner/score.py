"""Score one stored cell: every metric on every stored clip, without fitting or transferring anything again."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmark.api import Metric, NotApplicableError, Sample, StyleTask
from benchmark.data.base import Dataset
from benchmark.digest import file_digest
from benchmark.errors import ContractError, StoreError
from benchmark.motion.clip import MotionClip
from benchmark.runner.execute import OUTPUTS, ROUND_TRIP, TARGET, describe, load_extras
from benchmark.runner.items import read_items
from benchmark.runner.job import CellJob, MetricJob, Report
from benchmark.runner.parquet import read_rows, write_rows
from benchmark.runner.probes import LoadedProbes
from benchmark.runner.store import SCORES, SCORES_MARK, RunStore, read_json, sealed, unsealed, write_json

#: Columns of a cell's ``metrics.parquet``, with their types.
COLUMNS = {
    "clip_id": "string",
    "actor": "string",
    "action": "string",
    "seen_actor": "bool",
    "variant": "string",
    "metric": "string",
    "metric_version": "string",
    "probe_digest": "string",
    "value": "double",
    "unit": "string",
    "status": "string",
    "reason": "string",
}

Row = dict[str, Any]


@dataclass(frozen=True)
class Scores:
    """A cell's rows and, for each metric in them, the digest it was computed under."""

    rows: list[Row]
    digests: Mapping[str, str]


def missing_metrics(folder: Path, metrics: tuple[MetricJob, ...]) -> list[MetricJob]:
    """The metrics that a stored cell lacks or has from other code; from the marker alone, without reading rows."""
    digests = _read_mark(folder).get("digests", {})
    return [metric for metric in metrics if digests.get(metric.name) != metric.digest]


def _read_mark(folder: Path) -> dict[str, Any]:
    """The marker of a cell's rows; empty if there is none or the rows beside it are not those it was written for."""
    path, rows = folder / SCORES_MARK, folder / SCORES
    if not (path.is_file() and rows.is_file()):
        return {}
    try:
        mark = unsealed(read_json(path))
        stat = rows.stat()
        same = mark["size"] == stat.st_size and (
            mark["mtime_ns"] == stat.st_mtime_ns or mark["sha256"] == file_digest(rows)
        )
        if not (isinstance(mark["digests"], dict) and isinstance(mark["sha256"], str)):
            return {}
    except (StoreError, ValueError, KeyError, TypeError):
        return {}
    return mark if same else {}


def forget(folder: Path, metrics: Iterable[str]) -> None:
    """Make a cell forget that it has these metrics, so that they are computed again."""
    mark = _read_mark(folder)
    digests = mark.get("digests", {})
    left = {name: value for name, value in digests.items() if name not in set(metrics)}
    if left != digests:
        write_json(folder / SCORES_MARK, sealed({**mark, "digests": left}))


def rows_digest(folder: Path) -> str:
    """SHA-256 of the file of a cell's rows, as its marker states it; empty if it has none."""
    return str(_read_mark(folder).get("sha256", ""))


def read_scores(folder: Path) -> Scores:
    """The rows stored in a cell; none if they are missing or damaged."""
    mark = _read_mark(folder)
    if not mark:
        return Scores([], {})
    try:
        return Scores(read_rows(folder / SCORES, COLUMNS), mark["digests"])
    except StoreError:  # damaged without a trace in size and time: scored again
        return Scores([], {})


def write_scores(folder: Path, scores: Scores) -> None:
    """Store a cell's rows, then the marker that vouches for them."""
    write_rows(folder / SCORES, scores.rows, COLUMNS)
    stat = (folder / SCORES).stat()
    mark = {
        "digests": dict(scores.digests),
        "sha256": file_digest(folder / SCORES),
        "size": stat.st_size,
        "mtime_ns": stat.st_mtime_ns,
    }
    write_json(folder / SCORES_MARK, sealed(mark))


def score_cell(job: CellJob, report: Report) -> None:
    """Compute the metrics that a stored cell lacks and store them beside those it has."""
    folder = RunStore(job.folder).cell(job.cell.key)
    wanted = missing_metrics(folder, job.metrics)
    if not wanted:
        return
    names = {metric.name for metric in wanted}
    stored = read_scores(folder)
    rows = [row for row in stored.rows if row["metric"] not in names]
    digests = {name: value for name, value in stored.digests.items() if name not in names}
    scorer = _Scorer(job, folder, report)
    rows += scorer.rows(wanted)
    # A metric that ended the process or lacks its probe gets its rows but no digest: it is tried again next time.
    again = {*job.poisoned, *scorer.blind}
    digests |= {metric.name: metric.digest for metric in wanted if metric.name not in again}
    order = {metric.name: index for index, metric in enumerate(job.metrics)}
    place = {row["clip_id"]: index for index, row in enumerate(read_items(folder))}
    variants = {variant: index for index, variant in enumerate(job.variants)}
    rows.sort(
        key=lambda row: (
            place.get(row["clip_id"], -1),
            variants.get(row["variant"], -1),
            order.get(row["metric"], len(order)),
            row["metric"],
        )
    )
    write_scores(folder, Scores(rows, digests))


class _Scorer:
    """The samples of one cell and the rows that metrics make of them."""

    def __init__(self, job: CellJob, folder: Path, report: Report) -> None:
        from benchmark.motion import npz

        self.job, self.folder, self.report = job, folder, report
        self.items: list[Row] = read_items(folder)
        self.dataset: Dataset = job.dataset.open()
        source, target = job.cell.styles
        self.task = StyleTask(source, target, npz.load(folder / TARGET).skeleton)
        self._clips: dict[str, MotionClip] = {}
        self._probes = LoadedProbes(job.folder, job.probes)
        #: Metrics whose probe could not be fitted.
        self.blind: set[str] = set()

    def rows(self, metrics: list[MetricJob]) -> list[Row]:
        """The rows of ``metrics``."""
        ready: list[tuple[MetricJob, Metric]] = []
        rows: list[Row] = []
        for job in metrics:
            error = job.error or self.job.poisoned.get(job.name)
            if error is None:
                try:
                    ready.append((job, job.load()))
                    continue
                except Exception as failure:  # a plug-in may raise anything
                    error = describe(failure)
            rows += [self._row({}, variant, job, None, "failed", error) for variant in self.job.variants]
        ready = [pair for pair in ready if self._sees(pair[0], rows)]
        by_clip = [pair for pair in ready if pair[1].info.scope == "clip"]
        by_set = [pair for pair in ready if pair[1].info.scope == "set"]
        kept: dict[str, list[Sample]] = {variant: [] for variant in self.job.variants}
        for item, variant, sample, problem in self._samples():
            if by_set and sample is not None:
                kept[variant].append(sample)
            for job, metric in by_clip:
                rows.append(self._clip_row(item, variant, job, metric, sample, problem))
        for variant, samples in kept.items():
            for job, metric in by_set:
                rows.append(self._set_row(variant, job, metric, samples))
        return rows

    def _samples(self) -> Iterator[tuple[Row, str, Sample | None, tuple[str, str]]]:
        """Every stored clip in every variant, action by action so that few reference clips are held at a time."""
        action = None
        for index, item in enumerate(sorted(self.items, key=lambda item: (item["action"], item["clip_id"]))):
            if item["action"] != action:
                self._clips.clear()
                action = item["action"]
            self.report("score", index / len(self.items), item["clip_id"])
            if item["state"] != "ok":
                for variant in self.job.variants:
                    yield item, variant, None, (item["state"], item["reason"])
                continue
            for variant in self.job.variants:
                problem = item["variants"].get(variant)
                if problem is None:
                    yield item, variant, self._sample(item, variant), ("ok", "")
                else:
                    yield item, variant, None, ("failed", problem)

    def _sample(self, item: Row, variant: str) -> Sample:
        from benchmark.motion import npz

        extras = load_extras(self.folder / OUTPUTS / f"{item['stem']}.extras.npz")
        references = [name for name in item["reference_ids"] if name != item["copied_from"]]
        truth_id = f"truth of {item['clip_id']}"
        if item["has_truth"] and truth_id not in self._clips:
            truth = self.dataset.truth(item["clip_id"], self.task.target_style, self.task.target_skeleton)
            if truth is not None:
                self._clips[truth_id] = truth
        return Sample(
            npz.load(self.folder / OUTPUTS / f"{item['stem']}.{variant}.npz"),
            self._clip(item["clip_id"]),
            tuple(self._clip(name) for name in references),
            self._clips.get(truth_id),
            self.task,
            extras.get("time_map"),
            extras.get("contacts"),
            item["copied_from"],
            self._round_trip(item["stem"]),
            self._probes.loaded,
        )

    def _round_trip(self, stem: str) -> MotionClip | None:
        from benchmark.motion import npz

        path = self.folder / OUTPUTS / f"{stem}.{ROUND_TRIP}.npz"
        return npz.load(path) if path.is_file() else None

    def _sees(self, job: MetricJob, rows: list[Row]) -> bool:
        """Whether the metric's probe is there; where it is not, its rows say why."""
        problem = self._probes.problem(job.probe) if job.probe else None
        if problem is None:
            return True
        rows += [self._row({}, variant, job, None, *problem) for variant in self.job.variants]
        if problem[0] == "failed":
            self.blind.add(job.name)
        return False

    def _clip(self, clip_id: str) -> MotionClip:
        if clip_id not in self._clips:
            self._clips[clip_id] = self.dataset.load(clip_id)
        return self._clips[clip_id]

    def _clip_row(
        self, item: Row, variant: str, job: MetricJob, metric: Metric, sample: Sample | None, problem: tuple[str, str]
    ) -> Row:
        if sample is None:
            return self._row(item, variant, job, None, *problem)
        needs = metric.info.needs
        if needs == "reference" and not sample.references:
            why = f"there is no other real {self.task.target_style} clip of {item['action']!r} outside the training set"
            return self._row(item, variant, job, None, "skipped", why)
        if needs == "truth" and sample.truth is None:
            return self._row(
                item, variant, job, None, "skipped", "the true performance is known of generated clips only"
            )
        self.report("metric", 0.0, job.name)
        return self._row(item, variant, job, *_value(lambda: metric.compute(sample)))

    def _set_row(self, variant: str, job: MetricJob, metric: Metric, samples: list[Sample]) -> Row:
        if not samples:
            return self._row({}, variant, job, None, "skipped", "no clip was transferred")
        self.report("metric", 1.0, job.name)
        return self._row({}, variant, job, *_value(lambda: metric.compute_set(samples)))

    def _row(self, item: Row, variant: str, job: MetricJob, value: float | None, status: str, reason: str) -> Row:
        return _row(item, variant, job, value, status, reason, self._probes.digest(job.probe))


def _value(compute: Any) -> tuple[float | None, str, str]:
    """Value, status and reason of one computation."""
    try:
        value = compute()
    except NotApplicableError as reason:
        return None, "skipped", str(reason)
    except Exception as error:  # a plug-in may raise anything; the other metrics go on
        return None, "failed", describe(error)
    try:
        number = float(value)
    except (TypeError, ValueError):
        return None, "failed", describe(ContractError(f"compute must return a number, not {type(value).__name__}"))
    if not math.isfinite(number):
        return None, "failed", f"the value is {number}"
    return number, "ok", ""


def _row(item: Row, variant: str, job: MetricJob, value: float | None, status: str, reason: str, probe: str) -> Row:
    return {
        "clip_id": item.get("clip_id", ""),
        "actor": item.get("actor", ""),
        "action": item.get("action", ""),
        "seen_actor": item.get("seen_actor"),
        "variant": variant,
        "metric": job.name,
        "metric_version": job.version,
        "probe_digest": probe,
        "value": value,
        "unit": job.unit,
        "status": status,
        "reason": reason,
    }
