"""A whole run: prepare, plan, execute what is missing, score, and rebuild the views."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from benchmark.config import RunConfig, read_config, to_toml
from benchmark.data.base import Dataset
from benchmark.data.splits import Split, load_split, make_split
from benchmark.digest import canonical_json
from benchmark.errors import ConfigError, DataError, RegistryError, StoreError, UnknownNameError
from benchmark.registry import METHODS, METRICS, PROBES, Registry
from benchmark.runner import provenance
from benchmark.runner.backends import Observer, default_jobs, make_backend
from benchmark.runner.job import CellJob, DatasetSource, MetricJob, pack, scoring_digest
from benchmark.runner.locking import LOCK, SHARDS
from benchmark.runner.plan import Cell, GpuProbe, make_plan, plan_text, read_plan
from benchmark.runner.probes import ProbeJob, probe_jobs, probe_store
from benchmark.runner.score import forget, missing_metrics
from benchmark.runner.selection import MetricChoice, choose_methods, choose_metrics, importable
from benchmark.runner.store import CellStatus, RunStore, read_json, unwritable, write_json, write_text
from benchmark.runner.views import LEADERBOARD, MARK, REAL, RESULTS, build_views, views_are_current, views_digest

CONFIG, PLAN, ENVIRONMENT = "config.toml", "plan.json", "environment.json"

#: What a run was thought to take beside what it took.
ESTIMATE = "estimate.json"

#: What makes a run folder what it is; a run with others belongs into another folder.
IDENTITY = ("data set", "tasks", "split")


@dataclass(frozen=True)
class Prepared:
    """A run that is ready to start: everything resolved, nothing run.

    Attributes
    ----------
    config
        The settings, with tasks and run folder filled in.
    source, dataset
        The data set and how workers open it.
    splits
        One for each task.
    cells
        The plan.
    metrics
        The metrics as chosen.
    """

    config: RunConfig
    source: DatasetSource
    dataset: Dataset
    splits: tuple[Split, ...]
    cells: tuple[Cell, ...]
    metrics: tuple[MetricChoice, ...]

    @property
    def folder(self) -> Path:
        """The run folder."""
        return _folder(self.config)


@dataclass(frozen=True)
class Outcome:
    """How a run ended.

    Attributes
    ----------
    folder
        The run folder.
    cells
        The plan.
    states
        Of every cell, by key.
    executed, scored, cached
        How many cells were run, were scored again only, and were there already.
    rebuilt
        Whether the tables had to be written again.
    """

    folder: Path
    cells: tuple[Cell, ...]
    states: Mapping[str, CellStatus]
    executed: int
    scored: int
    cached: int
    rebuilt: bool

    @property
    def failures(self) -> list[tuple[Cell, str]]:
        """The cells that failed, with the reasons."""
        return [(cell, self.states[cell.key].reason) for cell in self.cells if self.states[cell.key].state == "failed"]

    @property
    def skips(self) -> list[tuple[Cell, str]]:
        """The cells that were skipped, with the reasons."""
        return [(cell, self.states[cell.key].reason) for cell in self.cells if self.states[cell.key].state == "skipped"]


def prepare(
    config: RunConfig,
    *,
    methods: Registry = METHODS,
    metrics: Registry = METRICS,
    probes: Registry = PROBES,
    opener: str | None = None,
    gpu: Any = None,
) -> Prepared:
    """Open the data set, make the splits and the plan. Reads no clip.

    Parameters
    ----------
    config
        The settings.
    methods, metrics, probes
        The registries.
    opener
        ``"module:function"`` that opens data sets, for those that the catalogue does not know.
    gpu
        Says whether there is a GPU; ``None`` looks for one where the cells will run.
    """
    named = config.dataset
    source = DatasetSource(named.name, named.root, dict(named.options))
    if opener is not None:
        source = replace(source, opener=opener)
    dataset = source.open()
    tasks = config.tasks or (default_task(dataset),)
    out = config.out or default_folder(named.name, tasks)
    config = config.model_copy(update={"tasks": tasks, "out": out})
    splits = tuple(_split(config, dataset, task) for task in tasks)
    chosen = choose_methods(methods, config.methods, config.params)
    if REAL in methods and all(choice.name != REAL for choice in chosen):
        chosen += choose_methods(methods, [REAL])
    names = {choice.name for choice in chosen} | {choice.label for choice in chosen}
    for name in config.force:
        if name not in names:
            raise UnknownNameError("method to force", name, names)
    if config.force and config.overwrite == "only-cached":
        raise ConfigError("force and overwrite 'only-cached' contradict each other: leave one out")
    cells = tuple(make_plan(config, dataset, splits, chosen, gpu=gpu or _gpu_probe(config)))
    return Prepared(config, source, dataset, splits, cells, tuple(choose_metrics(metrics, config.metrics, probes)))


def _gpu_probe(config: RunConfig) -> GpuProbe:
    if config.backend != "dask":
        return provenance.gpu_usable
    from benchmark.runner.cluster import has_gpu

    return partial(has_gpu, config.scheduler)


def default_task(dataset: Dataset) -> str:
    """``adult:child`` where the data set has both, else the only pair there is.

    Raises
    ------
    ConfigError
        If there are several; the message lists the styles.
    """
    if {"adult", "child"} <= set(dataset.styles):
        return "adult:child"
    if "normal" in dataset.styles and len(dataset.styles) == 2:
        (other,) = set(dataset.styles) - {"normal"}
        return f"normal:{other}"
    styles = ", ".join(dataset.styles)
    raise ConfigError(f"data set {dataset.id} has no task of its own: give --task SOURCE:TARGET (styles: {styles})")


def default_folder(dataset: str, tasks: Sequence[str]) -> Path:
    """``runs/DATASET-TASK``, in characters that every file system takes."""
    name = "-".join([dataset.removeprefix("folder:"), *tasks])
    return Path("runs") / re.sub(r"[^\w.]+", "-", name).strip("-.")


def _folder(config: RunConfig) -> Path:
    if config.out is None:
        raise ConfigError("the run has no folder: prepare() fills it in")
    return config.out


def _split(config: RunConfig, dataset: Dataset, task: str) -> Split:
    source, _, target = task.partition(":")
    wanted = config.split
    if wanted.file is not None:
        split = load_split(wanted.file, dataset)
        if (split.source_style, split.target_style) != (source, target):
            raise ConfigError(f"{wanted.file} is a split for {split.source_style}:{split.target_style}, not for {task}")
        return split
    return make_split(
        dataset, source, target, protocol=wanted.protocol, fold=wanted.fold, seed=wanted.seed, **wanted.parameters
    )


def split_path(folder: Path, tasks: Sequence[str], task: str) -> Path:
    """``split.json``, or ``split-SOURCE-TARGET.json`` where a run has several tasks."""
    return folder / ("split.json" if len(tasks) == 1 else f"split-{task.replace(':', '-')}.json")


def cell_states(prepared: Prepared) -> dict[str, CellStatus]:
    """The state of every cell as it is on disk, or as the plan decided."""
    store = RunStore(prepared.folder)
    return {cell.key: _disk_state(store, cell) for cell in prepared.cells}


def _disk_state(store: RunStore, cell: Cell) -> CellStatus:
    return store.status(cell.key) if cell.fate == "run" else CellStatus(cell.fate, cell.reason)


def to_execute(config: RunConfig, cell: Cell, status: CellStatus) -> bool:
    """Whether a cell in this state is to be run, by the overwrite word and the forced names."""
    if cell.fate != "run" or config.overwrite == "only-cached":
        return False
    if cell.name in config.force or cell.method in config.force or config.overwrite == "always":
        return True
    redone = ("missing", "damaged", "failed") if config.overwrite == "missing" else ("missing", "damaged")
    return status.state in redone


def run(prepared: Prepared, observer: Observer, *, methods: Registry = METHODS, metrics: Registry = METRICS) -> Outcome:
    """Execute and score what is missing, then bring the views up to date.

    Raises
    ------
    StoreError
        If the run folder is in use or belongs to other settings.

    With a ``shard`` in the settings the tables are left alone: a run without one makes them when all shards are done.
    """
    config, folder = prepared.config, prepared.folder
    _check_folder(folder, config)
    store = RunStore(folder)
    cells = shard_cells(prepared.cells, config.shard)
    with store.lock() if config.shard is None else store.lock_shard(config.shard):
        if config.shard is None:
            store.sweep()
        else:  # beside other shards
            for cell in cells:
                store.sweep(cell.key)
        paths = {}
        for task, split in zip(config.tasks, prepared.splits, strict=True):
            paths[task] = split_path(folder, config.tasks, task)
            if not (paths[task].is_file() and _same_split(paths[task], split)):
                try:
                    split.to_json(paths[task])
                except OSError as error:
                    raise unwritable(paths[task], error) from error
        metric_jobs = make_metric_jobs(prepared.metrics, metrics)
        write_text(folder / CONFIG, to_toml(config.model_copy(update={"shard": None})))
        write_text(folder / PLAN, plan_text(prepared.cells))
        states = cell_states(prepared)
        jobs = []
        classes: dict[str, bytes | Exception | None] = {}
        for cell in cells:
            execute = to_execute(config, cell, states[cell.key])
            if execute or (states[cell.key].state == "ok" and config.overwrite != "only-cached"):
                if cell.name not in classes:
                    try:
                        classes[cell.name] = _packed(methods, cell.name)
                    except Exception as error:  # pickling runs the class's own code
                        classes[cell.name] = error
                value = classes[cell.name] if execute else None
                if isinstance(value, Exception):
                    _refuse(store, cell, value)
                    continue
                job = CellJob(
                    cell,
                    folder,
                    prepared.source,
                    paths[cell.task],
                    config.variants,
                    config.limit,
                    config.seed,
                    config.threads,
                    execute,
                    metric_jobs,
                    method_value=value,
                )
                if execute or missing_metrics(store.cell(cell.key), metric_jobs):
                    jobs.append(job)
        environment = folder / environment_name(config.shard)
        if jobs or not environment.is_file():
            write_json(environment, provenance.environment(threads=config.threads, jobs=cells_at_a_time(config)))
        return _work(folder, cells, config, jobs, metric_jobs, prepared.metrics, observer)


def _work(
    folder: Path,
    cells: tuple[Cell, ...],
    config: RunConfig,
    jobs: Sequence[CellJob],
    metrics: tuple[MetricJob, ...],
    chosen: Sequence[MetricChoice],
    observer: Observer,
) -> Outcome:
    if jobs:
        named = {choice.probe.name: choice.probe for choice in chosen if choice.probe is not None}
        fits, places = probe_jobs(jobs, named.values())
        with make_backend(
            config.backend,
            jobs=cells_at_a_time(config),
            time_limit=config.time_limit,
            memory_limit=config.memory_limit,
            scheduler=config.scheduler,
        ) as backend:
            with _sharing(folder, fits, config) as left:
                backend.run(left, observer)
            jobs = [replace(job, probes=places.get(job.cell.task, {})) for job in jobs]
            backend.run(jobs, observer)
            # A method can reach the cells of others. Those that it spoiled after they were stored are made once more.
            spoiled = [job for job in jobs if job.execute and _gone(RunStore(folder).status(job.cell.key))]
            if spoiled:
                backend.run(spoiled, observer)
    store = RunStore(folder)
    states = {cell.key: _disk_state(store, cell) for cell in cells}
    for key, status in states.items():
        if _gone(status):
            states[key] = CellStatus("skipped", f"not in the cache: {status.reason}")
    executed = sum(job.execute for job in jobs)
    planned = sum(cell.fate == "run" for cell in cells)
    if config.shard is not None:
        return Outcome(folder, cells, states, executed, len(jobs) - executed, planned - len(jobs), False)
    current = views_are_current(folder, views_digest(folder, cells, metrics, states))
    if not current:
        build_views(folder, cells, metrics, states, directions(chosen))
    return Outcome(folder, cells, states, executed, len(jobs) - executed, planned - len(jobs), not current)


def _gone(status: CellStatus) -> bool:
    return status.state in ("missing", "damaged")


def _refuse(store: RunStore, cell: Cell, error: Exception) -> None:
    """Store as failed a cell whose method cannot be sent to a worker."""
    import traceback

    reason = f"the class cannot be sent to a worker process ({type(error).__name__}: {error}): put it into a module"
    store.commit_failure(cell.key, reason, "".join(traceback.format_exception(error)))


def shard_cells(cells: tuple[Cell, ...], shard: str | None) -> tuple[Cell, ...]:
    """The cells of one part ``k/n`` in the order of the plan; all of them for ``None``.

    Parts are made of the keys in their order, so that they depend on the plan alone, differ by at most one cell, and mix the
    methods.
    """
    if shard is None:
        return cells
    part, _, parts = shard.partition("/")
    keys = sorted(cell.key for cell in cells)
    own = set(keys[int(part) - 1 :: int(parts)])
    return tuple(cell for cell in cells if cell.key in own)


def environment_name(shard: str | None) -> str:
    """The file with the facts of the machine; a shard writes its own."""
    return ENVIRONMENT if shard is None else f"environment-shard-{shard.replace('/', '-of-')}.json"


@contextlib.contextmanager
def _sharing(folder: Path, fits: Sequence[ProbeJob], config: RunConfig) -> Iterator[Sequence[ProbeJob]]:
    """The probes that are left to fit: shards beside this one need the same, and each is fitted by one of them."""
    if config.shard is None or config.backend == "dask":  # workers of a cluster see to it themselves
        yield fits
        return
    store = probe_store(folder)
    with contextlib.ExitStack() as held:
        for fit in sorted(fits, key=lambda fit: fit.cell.key):
            held.enter_context(store.holding(fit.cell.key))
        yield [fit for fit in fits if store.status(fit.cell.key).state not in ("ok", "skipped")]


def cells_at_a_time(config: RunConfig) -> int:
    """How many cells a run works on at once, as far as this machine decides it."""
    if config.backend == "serial":
        return 1
    return config.jobs or default_jobs(config.threads)


def score(
    folder: Path,
    observer: Observer,
    *,
    requests: Sequence[str] = (),
    force: bool = False,
    jobs: int | None = None,
    metrics: Registry = METRICS,
    probes: Registry = PROBES,
    opener: str | None = None,
) -> Outcome:
    """Score the stored clips of a finished run, without fitting or transferring.

    Parameters
    ----------
    folder
        The run folder.
    observer
        Told what happens.
    requests
        Metrics to add to those of the run.
    force
        Compute the ``requests``, or all if there are none, again, not only those whose code changed.
    jobs
        Cells at a time; as in the run if ``None``.

    Raises
    ------
    StoreError
        If the folder is no run, is in use, or the data set has changed since: scores of two data sets must not mix.
    """
    config, cells = read_run(folder)
    named = config.dataset
    source = DatasetSource(named.name, named.root, dict(named.options))
    if opener is not None:
        source = replace(source, opener=opener)
    # Where the run computed is not where its metrics are looked at again.
    config = config.model_copy(
        update={"jobs": jobs or config.jobs, "backend": _here(config.backend), "scheduler": None}
    )
    chosen = choose_metrics(metrics, [*config.metrics, *requests], probes)
    again = (
        [choice.name for choice in (choose_metrics(metrics, requests, probes) if requests else chosen)] if force else []
    )
    metric_jobs = make_metric_jobs(chosen, metrics)
    store = RunStore(folder)
    with store.lock():
        store.sweep()
        work = []
        for cell in cells:
            if cell.fate != "run" or store.status(cell.key).state != "ok":
                continue
            path = split_path(folder, config.tasks, cell.task)
            job = CellJob(
                cell,
                folder,
                source,
                path,
                config.variants,
                config.limit,
                config.seed,
                config.threads,
                False,
                metric_jobs,
            )
            if again or missing_metrics(store.cell(cell.key), metric_jobs):
                work.append(job)
        if work:
            _check_same_data(folder, source.open(), work)
        for job in work:
            forget(store.cell(job.cell.key), again)
        return _work(folder, cells, config, work, metric_jobs, chosen, observer)


def _here(backend: Any) -> Any:
    return "processes" if backend == "dask" else backend


def _check_same_data(folder: Path, dataset: Dataset, work: Iterable[CellJob]) -> None:
    for job in work:
        if job.cell.dataset_digest != dataset.digest:
            raise StoreError(
                f"data set {dataset.id} is not the one that {folder} was run on: its digest is {dataset.digest[:12]}…, not "
                f"{job.cell.dataset_digest[:12]}…. Its files, or the code that reads them, have changed: restore them, or run "
                "again"
            )


def read_run(folder: Path) -> tuple[RunConfig, tuple[Cell, ...]]:
    """Settings and plan of a run folder; a :class:`~benchmark.errors.StoreError` if it is none."""
    if not (folder / CONFIG).is_file():
        raise StoreError(f"{folder} is not a run folder: it has no {CONFIG}")
    config = _settings(folder).model_copy(update={"out": folder})
    try:
        cells = read_plan(read_json(folder / PLAN))
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise StoreError(f"{folder / PLAN} is not a plan of this version ({error}): run again") from error
    return config, cells


def make_metric_jobs(chosen: Iterable[MetricChoice], registry: Registry) -> tuple[MetricJob, ...]:
    """What workers need to compute the chosen metrics."""
    scoring = scoring_digest()
    return tuple(MetricJob.of(choice, scoring, _packed(registry, choice.name)) for choice in chosen)


def directions(chosen: Iterable[MetricChoice]) -> dict[str, tuple[str, float | None]]:
    """Direction and target of each metric."""
    return {choice.name: (choice.info.direction, choice.info.target) for choice in chosen if choice.info is not None}


def _packed(registry: Registry, name: str) -> bytes | None:
    """A class that workers cannot import, as bytes; ``None`` for all others."""
    try:
        value = registry.entry(name).value
    except (RegistryError, UnknownNameError):
        return None
    return None if value is None or importable(value) else pack(value)


def _same_split(path: Path, split: Split) -> bool:
    try:
        return Split.from_json(path).digest == split.digest
    except DataError:
        return False


def _check_folder(folder: Path, config: RunConfig) -> None:
    """Refuse a folder that is something else, or a run of another data set, task or split."""
    if not folder.exists():
        return
    if not folder.is_dir():
        raise StoreError(f"{folder} is a file: choose another folder with --out")
    if not (folder / CONFIG).is_file():
        own = {LOCK, SHARDS, "cells", *(split_path(folder, config.tasks, task).name for task in config.tasks)}
        if RunStore(folder).cells.is_dir():  # a run whose settings were lost
            own |= {
                ESTIMATE,
                PLAN,
                ENVIRONMENT,
                RESULTS,
                LEADERBOARD,
                MARK,
                "probes",
                "report",
                "figures",
                "tables",
                "stats",
            }
        found = {path.name for path in folder.iterdir() if not path.name.endswith(".part")}
        others = sorted(found - own)
        if others:
            raise StoreError(
                f"{folder} holds other things ({others[0]} …) and is no run folder: choose another with --out"
            )
        return
    before = _settings(folder)
    for name, old, new in zip(IDENTITY, identity(before), identity(config), strict=True):
        if old != new:
            raise StoreError(f"{folder} is a run with {name} {old}, not {new}: choose another folder with --out")


def _settings(folder: Path) -> RunConfig:
    try:
        return read_config(folder / CONFIG)
    except ConfigError as error:
        raise StoreError(
            f"the settings of the run {folder} cannot be read: {error}. Mend {folder / CONFIG}, or remove it and give the "
            "whole command of the run again: finished cells are kept"
        ) from error


def identity(config: RunConfig) -> tuple[str, str, str]:
    """What makes a run folder what it is, as texts: :data:`IDENTITY`. Where the files lie is no part of it."""
    named = config.dataset
    options = f" {canonical_json(named.options)}" if named.options else ""
    return f"{named.name}{options}", ", ".join(config.tasks), canonical_json(config.split.model_dump(mode="json"))
