"""What a worker of a cluster does with one cell: check that it may, run it in a process of its own, and store or send it.

The worker keeps the cell in the run folder itself where it sees that folder (the run's marker lies in it). Where it does not,
it gets what the cell needs with the errand, works in a folder of its own, and sends the cell back as a parcel.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from benchmark.digest import source_digest
from benchmark.errors import ConfigError
from benchmark.runner import provenance
from benchmark.runner.backends import Job, Processes
from benchmark.runner.job import CellJob, Unit
from benchmark.runner.parcel import pack, unpack
from benchmark.runner.probes import PROBES, ProbeJob, probe_store
from benchmark.runner.score import missing_metrics
from benchmark.runner.selection import class_digest
from benchmark.runner.store import STATUS, RunStore

#: Packages of the suite whose code must be the same everywhere: keys are made from it where the run is planned.
SUITE = ("benchmark", "methods", "eval")

#: ``send(kind, key, stage, fraction, message)``: news of a cell for the coordinator.
Send = Callable[[str, str, str, float, str], None]


@dataclass(frozen=True)
class Luggage:
    """What a worker needs that does not see the run folder.

    Attributes
    ----------
    split
        The split's file.
    probes
        Parcels of the probes that the metrics look through, by key.
    cell
        Parcel of the stored cell, where it is only to be scored.
    """

    split: bytes
    probes: Mapping[str, bytes] = field(default_factory=dict)
    cell: bytes | None = None


@dataclass(frozen=True)
class Errand:
    """One job on its way to a worker.

    Attributes
    ----------
    job
        The job; its paths are absolute.
    run, token
        The run folder, and the run's marker in it.
    time_limit
        As of :class:`~benchmark.runner.backends.Processes`.
    dataset_digest, suite, versions
        Data, code and packages that the worker must have as well.
    before
        The cell's ``status.json`` when the errand was given, or nothing.
    luggage
        What comes along; ``None`` as long as the run folder is taken to be shared.
    """

    job: Job
    run: Path
    token: str
    time_limit: float | None
    dataset_digest: str
    suite: str
    versions: Mapping[str, str]
    before: bytes = b""
    luggage: Luggage | None = None


@dataclass(frozen=True)
class Answer:
    """How an errand ended: the cell's state, and its parcel where the worker could not store it.

    A state of ``unseen`` says that the worker does not see the run folder and had no luggage.
    """

    state: str
    reason: str = ""
    seconds: float = 0.0
    parcel: bytes | None = None


def marker(run: Path, token: str) -> Path:
    """The file by which a worker knows that it sees the coordinator's run folder, and not another one of that name."""
    return run / f".coordinator-{token}"


def status_bytes(store: RunStore, key: str) -> bytes:
    """``status.json`` of a cell as it is; empty if there is none."""
    try:
        return (store.cell(key) / STATUS).read_bytes()
    except OSError:
        return b""


_stopped: set[str] = set()


def stop(token: str) -> None:
    """End what this process does for a run: called on every worker when the run is interrupted."""
    _stopped.add(token)


def do(errand: Errand, send: Send, scratch: Path | None = None) -> Answer:
    """Do one errand.

    Parameters
    ----------
    errand
        What to do.
    send
        Called with news.
    scratch
        Where a worker that does not see the run folder works; the system's temporary folder if ``None``.

    Raises
    ------
    ConfigError
        If this worker must not do it: it has other code, packages or data.
    """
    require_same(errand)
    start = time.monotonic()
    job, luggage = errand.job, errand.luggage
    shared = marker(errand.run, errand.token).is_file()
    if not shared:
        if luggage is None:
            return Answer("unseen")
        job = _unpacked(errand, luggage, scratch)
    store, key = RunStore(job.folder), job.cell.key
    try:
        with store.holding(key):
            if shared and job.execute and status_bytes(store, key) != errand.before:
                # A worker that outlived an earlier coordinator, or was taken for lost, has finished it meanwhile.
                job = replace(job, execute=store.status(key).state not in ("ok", "skipped"))
            if job.execute or missing_metrics(store.cell(key), job.metrics):
                processes = Processes(1, errand.time_limit, stop=lambda: errand.token in _stopped)
                with _may_have_children():
                    processes.run([job], _Forward(send))
            status = store.status(key)
            parcel = None if shared else pack(store.cell(key))
    finally:
        if not shared:
            shutil.rmtree(store.cell(key), ignore_errors=True)
    return Answer(status.state, status.reason, time.monotonic() - start, parcel)


class _Forward:
    """Passes on what happens, little enough for one connection to carry the news of every worker."""

    def __init__(self, send: Send) -> None:
        self._send = send
        self._stage, self._last = "", 0.0

    def cell_started(self, cell: Unit) -> None:
        self._send("started", cell.key, "", 0.0, "")

    def cell_progress(self, cell: Unit, stage: str, fraction: float, message: str) -> None:
        now = time.monotonic()
        if stage != self._stage or now - self._last >= 0.5:
            self._stage, self._last = stage, now
            self._send("progress", cell.key, stage, fraction, message)

    def cell_finished(self, cell: Unit, state: str, reason: str, seconds: float) -> None:
        """Told by the answer."""


def require_same(errand: Errand) -> None:
    """Refuse to make numbers that would not be those of the key."""
    advice = "install the same commit with the same constraints.txt on every worker, and start the workers again"
    if suite_digest() != errand.suite:
        raise ConfigError(f"the worker has other code of the suite than the coordinator: {advice}")
    ours = package_versions()
    other = [name for name in errand.versions if ours.get(name) != errand.versions[name]]
    if other:
        differing = ", ".join(f"{name} {ours.get(name, 'absent')} and not {errand.versions[name]}" for name in other)
        raise ConfigError(f"the worker has {differing}: {advice}")
    job = errand.job
    found = _once(f"data {job.dataset!r}", lambda: job.dataset.open().digest)
    if found != errand.dataset_digest:
        raise ConfigError(
            f"data set {job.dataset.name} of the worker is not the coordinator's: its digest is {found[:12]}…, not "
            f"{errand.dataset_digest[:12]}…"
        )
    if isinstance(job, CellJob) and job.execute and job.method_value is None:
        cls = job.load_method()
        wanted = job.cell.ingredients["method_source"]
        if _once(f"method {job.cell.target}", lambda: class_digest(cls, cls.info.code_deps)) != wanted:
            raise ConfigError(f"the worker has other code of method {job.cell.name!r} than the coordinator: {advice}")


def suite_digest() -> str:
    """Digest of the suite's code, without what only draws and prints."""
    found: str = _once("suite", lambda: source_digest(*SUITE))
    return found


def package_versions() -> dict[str, str]:
    """Versions of the packages that can matter to a number."""
    found: dict[str, str] = _once("versions", provenance.versions)
    return found


_known: dict[str, Any] = {}


def _once(what: str, find: Callable[[], Any]) -> Any:
    """What ``find`` finds, looked for once in the life of a worker: its code and data do not change under it."""
    if what not in _known:
        _known[what] = find()
    return _known[what]


def _unpacked(errand: Errand, luggage: Luggage, scratch: Path | None) -> Job:
    """The job in a run folder of the worker's own, with what came along in its place."""
    job = errand.job
    base = Path(tempfile.gettempdir()) if scratch is None else scratch
    run = base / f"benchmark-{errand.token}" / errand.run.name
    run.mkdir(parents=True, exist_ok=True)
    split = run / job.split_file.name
    if not (split.is_file() and split.read_bytes() == luggage.split):
        split.write_bytes(luggage.split)
    probes = probe_store(run)
    for key, parcel in luggage.probes.items():
        with probes.holding(key):
            if probes.status(key).state == "missing":
                with probes.writing(key) as folder:
                    unpack(parcel, folder / "cells" / key)
                    probes.adopt(key, folder / "cells" / key)
    folder = run / PROBES if isinstance(job, ProbeJob) else run
    store, key = RunStore(folder), job.cell.key
    shutil.rmtree(store.cell(key), ignore_errors=True)
    if luggage.cell is not None:
        with store.writing(key) as temporary:
            unpack(luggage.cell, temporary / "cells" / key)
            store.adopt(key, temporary / "cells" / key)
    return replace(job, folder=folder, split_file=split)


@contextlib.contextmanager
def _may_have_children() -> Iterator[None]:
    """Let a worker that is itself a daemonic process start the cell's.

    multiprocessing forbids it because a daemon's children would be left behind; ours end with their parent.
    """
    settings = getattr(multiprocessing.process.current_process(), "_config", {})
    daemon = settings.pop("daemon", None)
    try:
        yield
    finally:
        if daemon is not None:
            settings["daemon"] = daemon
