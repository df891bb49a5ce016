"""Probes of a run: which are needed, their keys, and fitting them.

A probe is fitted once for a data set, split and task, in a process of its own before the cells that need it are scored, and
stored like a cell under ``probes/cells/KEY``. Scoring reads it from there; a changed metric never trains one again.
"""

from __future__ import annotations

import traceback
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from benchmark.api import CONTRACT_VERSION, FitContext, NotApplicableError, Probe, StyleTask
from benchmark.digest import digest, source_digest
from benchmark.errors import ContractError
from benchmark.registry import load_target
from benchmark.runner.execute import describe
from benchmark.runner.job import CellJob, DatasetSource, MetricJob, ProbeRef, Report
from benchmark.runner.plan import Cell
from benchmark.runner.selection import ProbeChoice
from benchmark.runner.store import RunStore
from benchmark.seeding import generator, seed_for

#: Folder of a run's probes, and of one probe's files in its cell.
PROBES, MODEL = "probes", "model"

#: Code outside probes that can change one.
PIPELINE = ("benchmark.motion", "benchmark.api", "benchmark.data.views", "benchmark.seeding", "benchmark.runner.probes")


@dataclass(frozen=True)
class ProbeUnit:
    """One probe to fit: what progress displays and the store know it by."""

    key: str
    name: str
    target: str
    task: str
    seed: int
    device: str = "cpu"

    @property
    def title(self) -> str:
        """For progress bars."""
        return f"probe {self.name} {self.task}"


@dataclass(frozen=True)
class ProbeJob:
    """What a worker process needs to fit a probe; for the backends it looks like a cell's job that scores nothing."""

    cell: ProbeUnit
    folder: Path
    dataset: DatasetSource
    split_file: Path
    threads: int
    execute: bool = True
    metrics: tuple[MetricJob, ...] = ()
    poisoned: Mapping[str, str] = field(default_factory=dict)
    dataset_digest: str = ""


def probe_store(folder: Path) -> RunStore:
    """Where the probes of the run in ``folder`` are."""
    return RunStore(folder / PROBES)


def probe_unit(choice: ProbeChoice, cell: Cell, *, seed: int, threads: int) -> ProbeUnit:
    """The probe ``choice`` for the data set, split and task of ``cell``."""
    axes: dict[str, str | int] = {"seed": seed, "dataset": cell.dataset, "task": cell.task, "probe": choice.name}
    ingredients = {
        "contract": CONTRACT_VERSION,
        "pipeline": source_digest(*PIPELINE),
        "source": choice.digest,
        "dataset_digest": cell.dataset_digest,
        "split_digest": cell.split_digest,
        "threads": threads,
        **axes,
    }
    return ProbeUnit(digest(ingredients), choice.name, choice.target, cell.task, seed_for(**axes))


def probe_jobs(
    jobs: Iterable[CellJob], choices: Iterable[ProbeChoice], *, force: Iterable[str] = ()
) -> tuple[list[ProbeJob], dict[str, dict[str, ProbeRef]]]:
    """What is to be fitted before ``jobs``, and for each task where the probes will be.

    Parameters
    ----------
    jobs
        The cells to be scored, all of one run.
    choices
        The probes that their metrics name.
    force
        Names of probes to fit again.
    """
    fits: dict[str, ProbeJob] = {}
    places: dict[str, dict[str, ProbeRef]] = {}
    for job in jobs:
        for choice in choices:
            if choice.error is not None or choice.name in places.get(job.cell.task, {}):
                continue
            unit = probe_unit(choice, job.cell, seed=job.seed, threads=job.threads)
            places.setdefault(job.cell.task, {})[choice.name] = ProbeRef(unit.key, choice.target)
            state = probe_store(job.folder).status(unit.key).state
            if state not in ("ok", "skipped") or choice.name in force:
                fits[unit.key] = ProbeJob(
                    unit,
                    job.folder / PROBES,
                    job.dataset,
                    job.split_file,
                    job.threads,
                    dataset_digest=job.cell.dataset_digest,
                )
    return list(fits.values()), places


def fit_probe(job: ProbeJob, report: Report) -> None:
    """Fit one probe and store it as ``ok``, ``skipped`` or ``failed``."""
    from benchmark.data.splits import Split
    from benchmark.data.views import target_skeleton, train_view

    store = RunStore(job.folder)
    key = job.cell.key
    try:
        source, _, target = job.cell.task.partition(":")
        report("execute", 0.0, "opening the data set")
        dataset, split = job.dataset.open(), Split.from_json(job.split_file)
        task = StyleTask(source, target, target_skeleton(dataset, split, target))
        train = train_view(dataset, split, source, target)
        probe: Probe = load_target(job.cell.target, f"probe {job.cell.name!r}")()
        context = FitContext("cpu", None, lambda fraction, message: report("execute", fraction, message))
        fitted = probe.fit(train, task, rng=generator(seed=job.cell.seed, stage="fit"), ctx=context)
        if fitted is not probe:
            raise ContractError(f"{type(probe).__name__}.fit must return self, not {type(fitted).__name__}")
        with store.writing(key) as folder:
            probe.save(folder / MODEL)
            store.commit(key, folder, "ok", facts={"probe": job.cell.name, "task": job.cell.task})
    except NotApplicableError as reason:
        with store.writing(key) as folder:
            store.commit(key, folder, "skipped", str(reason), {"probe": job.cell.name, "task": job.cell.task})
    except Exception as error:  # a plug-in may raise anything
        store.commit_failure(key, describe(error), traceback.format_exc())


class LoadedProbes:
    """The probes that scoring reads, each loaded when a metric first names it.

    Parameters
    ----------
    folder
        The run folder.
    places
        Where each probe is.
    """

    def __init__(self, folder: Path, places: Mapping[str, ProbeRef]) -> None:
        self._store, self._places = probe_store(folder), places
        self._problems: dict[str, tuple[str, str]] = {}
        self.loaded: dict[str, Probe] = {}

    def problem(self, name: str) -> tuple[str, str] | None:
        """Why the probe cannot be had, as ``(skipped or failed, reason)``; ``None`` once it is loaded."""
        if name not in self.loaded and name not in self._problems:
            found = self._load(name)
            if found is not None:
                self._problems[name] = found
        return self._problems.get(name)

    def digest(self, name: str) -> str:
        """The key of the probe, for the rows that were computed through it."""
        return self._places[name].key if name in self._places else ""

    def _load(self, name: str) -> tuple[str, str] | None:
        if name not in self._places:
            return "failed", f"probe {name}: it was not fitted"
        place = self._places[name]
        status = self._store.status(place.key)
        if status.state == "skipped":
            return "skipped", f"probe {name}: {status.reason}"
        if status.state != "ok":
            return "failed", f"probe {name}: {status.reason}"
        try:
            cls: type[Probe] = load_target(place.target, f"probe {name!r}")
            self.loaded[name] = cls.load(self._store.cell(place.key) / MODEL)
        except Exception as error:  # a plug-in may raise anything
            return "failed", f"probe {name}: {describe(error)}"
        return None
