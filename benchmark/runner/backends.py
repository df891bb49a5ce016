"""Where cells run: each in a process of its own, or all in this one for a debugger.

A process of its own can be ended when it outruns its time limit, may crash without harm to the others, and has a peak of memory
that is the cell's. The processes are forked from a server that has imported the light part of the suite once, so that one
costs tens of milliseconds. Probes and scores come from a second server, which has imported what metrics need as well: a method
must not find that in its memory, which is measured.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection, wait
from typing import Any, Protocol, Self

from benchmark.errors import ConfigError
from benchmark.runner import worker
from benchmark.runner.job import CellJob, Unit
from benchmark.runner.output import Output
from benchmark.runner.probes import ProbeJob
from benchmark.runner.score import missing_metrics
from benchmark.runner.store import RunStore

#: What the fork server imports once for all cells: what every cell needs, and nothing that starts threads.
PRELOADED = (
    "benchmark.runner.adopt",
    "benchmark.runner.worker",
    "benchmark.motion.bvh",
    "benchmark.motion.footlock",
    "threadpoolctl",
    "pyarrow.json",
    "pyarrow.parquet",
)


#: What the server of probes and scores imports besides: the heavy libraries of metrics, as far as they start no threads.
PRELOADED_TO_SCORE = (*PRELOADED, "scipy.signal", "scipy.fft", "torch")


#: Seconds between tries to start a process, while a fork server ends.
_PAUSES = (0.0, 0.02, 0.1, 0.3, 1.0, 3.0)

#: What a backend can run.
Job = CellJob | ProbeJob


class Observer(Protocol):
    """Told what happens, in this process."""

    def cell_started(self, cell: Unit) -> None:
        """A cell's process has started."""

    def cell_progress(self, cell: Unit, stage: str, fraction: float, message: str) -> None:
        """What the cell does now."""

    def cell_finished(self, cell: Unit, state: str, reason: str, seconds: float) -> None:
        """The cell ended as ``ok``, ``skipped`` or ``failed``."""


class Backend(Protocol):
    """Runs cells and leaves what becomes of them in the run folder; a context that holds what it needs for that."""

    def __enter__(self) -> Self: ...

    def __exit__(self, *error: object) -> None: ...

    def run(self, jobs: Sequence[Job], observer: Observer) -> None:
        """Run every job."""


class StoppedError(Exception):
    """The run was ended from elsewhere."""


#: Memory in bytes that is reckoned with for each cell at work.
MEMORY_PER_JOB = 2 << 30


def default_jobs(threads: int) -> int:
    """Cells at a time where nobody said: as many as the cores of this process and the free memory allow, at least one."""
    import psutil

    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min(cores // threads, psutil.virtual_memory().available // MEMORY_PER_JOB))


def make_backend(
    name: str, *, jobs: int, time_limit: float | None, memory_limit: int | None = None, scheduler: str | None = None
) -> Backend:
    """The backend called ``processes``, ``serial`` or ``dask``; only the last knows a ``scheduler``."""
    if scheduler is not None and name != "dask":
        raise ConfigError(f"a scheduler ({scheduler}) is for backend 'dask', not {name!r}: add --backend dask")
    if name == "serial":
        if time_limit is not None or memory_limit is not None:
            which = "time" if time_limit is not None else "memory"
            raise ConfigError(
                f"a {which} limit needs backend 'processes': a method cannot be ended inside this process"
            )
        return Serial()
    if name == "dask":
        if memory_limit is not None:
            raise ConfigError("a memory limit needs backend 'processes': workers of Dask have a limit of their own")
        from benchmark.runner.cluster import Dask

        return Dask(jobs, time_limit, scheduler)
    return Processes(jobs, time_limit, memory_limit)


class Serial:
    """One cell after another in this process, for a debugger. A crash ends the run, and peak memory is the run's."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        pass

    def run(self, jobs: Sequence[Job], observer: Observer) -> None:
        """Run every job."""
        for job in jobs:
            observer.cell_started(job.cell)
            start = time.monotonic()

            def report(stage: str, fraction: float, message: str, cell: Unit = job.cell) -> None:
                observer.cell_progress(cell, stage, fraction, message)

            with worker.limited_threads(job.threads):
                worker.work(job, report)
            status = RunStore(job.folder).status(job.cell.key)
            observer.cell_finished(job.cell, status.state, status.reason, time.monotonic() - start)


@dataclass
class _Running:
    job: Job
    process: multiprocessing.process.BaseProcess
    connection: Connection
    output: Output
    began: float = field(default_factory=time.monotonic)
    deadline: float = float("inf")
    stage: str = "start"
    metric: str = ""
    finished: bool = False
    over: str = ""
    looked: float = 0.0
    before: float = 0.0


class Processes:
    """At most ``jobs`` cells at a time, each in its own process.

    Parameters
    ----------
    jobs
        How many at a time. Results do not depend on it.
    time_limit
        Seconds for fitting and transferring, and again for scoring; ``None`` for no limit.
    memory_limit
        Bytes of resident memory for a cell's process and those it starts, looked at twice a second; ``None`` for no limit.
    stop
        Asked several times a second whether to end everything, with a :class:`StoppedError`.
    """

    def __init__(
        self,
        jobs: int = 1,
        time_limit: float | None = None,
        memory_limit: int | None = None,
        *,
        stop: Callable[[], bool] = lambda: False,
    ) -> None:
        self.jobs, self.time_limit, self.memory_limit, self._stop = jobs, time_limit, memory_limit, stop
        methods = multiprocessing.get_all_start_methods()
        self._context = multiprocessing.get_context("forkserver" if "forkserver" in methods else "spawn")
        self._forks = self._context.get_start_method() == "forkserver"
        if self._forks:
            self._context.set_forkserver_preload(list(PRELOADED))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        pass

    def run(self, jobs: Sequence[Job], observer: Observer) -> None:
        """Run every job; whatever ends this, no process is left behind."""
        waiting = deque(jobs)
        running: list[_Running] = []
        #: Seconds spent on cells that have begun and not ended.
        spent: dict[str, float] = {}
        try:
            while waiting or running:
                if self._stop():
                    raise StoppedError
                while len(running) < self.jobs and (job := _next(waiting, running)) is not None:
                    running.append(self._start(job))
                    if job.cell.key not in spent:
                        observer.cell_started(job.cell)
                    running[-1].before = spent.setdefault(job.cell.key, 0.0)
                self._listen(running, observer)
                for one in [one for one in running if one.finished]:
                    running.remove(one)
                    again = self._ended(one, observer)
                    if again is not None:
                        spent[one.job.cell.key] += time.monotonic() - one.began
                        waiting.appendleft(again)
        finally:
            for one in running:
                _kill(one)
                one.output.close()

    def _start(self, job: Job) -> _Running:
        # If the fork server has just been ended (for lack of memory, or by a method) the next one is asked. It takes its place
        # once the system has put the old one away, which on a busy machine comes a while after it stopped listening.
        for pause in _PAUSES:
            with contextlib.suppress(EOFError, ConnectionError):
                return self._start_once(job)
            time.sleep(pause)
        return self._start_once(job)

    def _start_once(self, job: Job) -> _Running:
        cells = RunStore(job.folder).cells
        cells.mkdir(parents=True, exist_ok=True)
        output = Output(self._context, cells / f".tmp-output-{job.cell.key}")
        ours, theirs = self._context.Pipe()
        executes = isinstance(job, CellJob) and job.execute
        # Executing and scoring are two processes, from the two servers.
        part = replace(job, metrics=()) if executes else job
        server = _server_to_score() if self._forks and not executes else nullcontext()
        with _starting, _thread_environment(job.threads), server:
            process = self._context.Process(  # type: ignore[attr-defined]
                target=worker.main, args=(theirs, part, output.sink), name=job.cell.title
            )
            process.start()
        theirs.close()
        output.start()
        running = _Running(job, process, ours, output)
        self._set_deadline(running)
        return running

    def _set_deadline(self, one: _Running) -> None:
        if self.time_limit is not None:
            one.deadline = time.monotonic() + self.time_limit

    def _listen(self, running: list[_Running], observer: Observer) -> None:
        """Wait for something to happen, then take every report there is."""
        pause = max(0.0, min(0.25, min(one.deadline for one in running) - time.monotonic()))
        wait([thing for one in running for thing in (one.connection, one.process.sentinel)], timeout=pause)
        for one in running:
            alive = one.process.is_alive()
            try:
                while one.connection.poll():
                    stage, fraction, message = one.connection.recv()
                    self._take(one, stage, fraction, message, observer)
            except (EOFError, OSError):
                alive = False
            if not alive or one.stage == "done":
                one.finished = True
            elif time.monotonic() > one.deadline:
                one.finished, one.over = True, f"outran its time limit of {self.time_limit:g} s"
            elif self.memory_limit is not None and time.monotonic() - one.looked >= 0.5:
                one.looked = time.monotonic()
                taken = _memory(one)
                if taken > self.memory_limit:
                    limit = f"over its limit of {self.memory_limit / 2**20:.0f} MiB"
                    one.finished, one.over = True, f"took {taken / 2**20:.0f} MiB of memory, {limit}"

    def _take(self, one: _Running, stage: str, fraction: float, message: str, observer: Observer) -> None:
        if stage == "execute" or (stage == "score" and one.stage not in ("score", "metric")):
            self._set_deadline(one)
        one.stage = stage
        if stage == "metric":
            one.metric = message
        if stage not in ("done", "metric"):
            observer.cell_progress(one.job.cell, stage, fraction, message)

    def _ended(self, one: _Running, observer: Observer) -> Job | None:
        """Store how a process ended if it could not do so itself; a job to run again where a metric ended it."""
        store, job = RunStore(one.job.folder), one.job
        if one.stage == "done":
            one.process.join(timeout=5.0)
        cut_off = one.process.is_alive() and not one.over
        if cut_off:
            one.process.join(timeout=1.0)  # its pipe is closed first
            cut_off = one.process.is_alive()
        _kill(one)
        text = one.output.close()
        store.sweep(job.cell.key)
        one.connection.close()
        if one.stage != "done":
            stage = one.stage
            reason = one.over or (
                "closed its connection to the run" if cut_off else _how_it_ended(one.process.exitcode)
            )
            if stage in ("score", "metric"):
                again = _without_metric(one, f"scoring: {reason}")
                if again is not None:
                    return again
            else:
                store.commit_failure(job.cell.key, f"{reason} (stage: {stage})", text[-20000:] or reason)
        status = store.status(job.cell.key)
        if job.execute and status.state == "ok" and missing_metrics(store.cell(job.cell.key), job.metrics):
            return replace(job, execute=False)
        observer.cell_finished(job.cell, status.state, status.reason, one.before + time.monotonic() - one.began)
        return None


_score_server: Any = None

#: Held while a process starts, as that goes through what all threads of this process share.
_starting = threading.Lock()


@contextlib.contextmanager
def _server_to_score() -> Iterator[None]:
    """Processes that start meanwhile come from the server of probes and scores.

    multiprocessing has one fork server; a second of its class is put in that one's place while a process starts.
    """
    global _score_server
    from multiprocessing import forkserver

    if _score_server is None:
        _score_server = forkserver.ForkServer()
        _score_server.set_forkserver_preload(list(PRELOADED_TO_SCORE))
    usual = forkserver.connect_to_new_process
    forkserver.connect_to_new_process = _score_server.connect_to_new_process
    try:
        yield
    finally:
        forkserver.connect_to_new_process = usual


def _next(waiting: deque[Job], running: Sequence[_Running]) -> Job | None:
    """Take the next job that may start now: one at a time on the GPU, whose memory cells would have to share."""
    busy = any(one.job.cell.device == "cuda" and one.job.execute for one in running)
    for job in waiting:
        if not (busy and job.cell.device == "cuda" and job.execute):
            waiting.remove(job)
            return job
    return None


def _without_metric(one: _Running, reason: str) -> Job | None:
    """The job again without the metric that ended it, or without any if none had begun; ``None`` if that was tried."""
    names = [one.metric] if one.metric else [metric.name for metric in one.job.metrics]
    if set(names) <= set(one.job.poisoned):
        return None
    return replace(one.job, execute=False, poisoned={**one.job.poisoned, **dict.fromkeys(names, reason)})


def _how_it_ended(code: int | None) -> str:
    if code is not None and code < 0:
        try:
            name = signal.Signals(-code).name
        except ValueError:
            name = f"signal {-code}"
        hint = " (out of memory?)" if name == "SIGKILL" else ""
        return f"the process was ended by {name}{hint}"
    return f"the process ended with code {code}"


def _memory(one: _Running) -> int:
    """Resident bytes of a worker and of every process below it."""
    import psutil

    taken = 0
    with contextlib.suppress(psutil.Error):
        first = psutil.Process(one.process.pid)
        for process in (first, *first.children(recursive=True)):
            with contextlib.suppress(psutil.Error):
                taken += process.memory_info().rss
    return taken


def _kill(one: _Running) -> None:
    """End a worker and every process it started; what left both its group and its tree ends with the fork server."""
    import psutil

    process, below = one.process, []
    if process.is_alive():
        with contextlib.suppress(psutil.Error):
            below = psutil.Process(process.pid).children(recursive=True)
    if process.pid is not None and hasattr(os, "killpg"):
        # The group has the worker's number, and lives on in the processes that a dead worker left.
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
    for other in below:
        with contextlib.suppress(psutil.Error):
            other.kill()
    if process.is_alive():
        process.kill()
    process.join()


@contextlib.contextmanager
def _thread_environment(threads: int) -> Iterator[None]:
    """The thread caps in this process's environment, for a server or worker that starts now and inherits it."""
    before = {name: os.environ.get(name) for name in worker.THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(worker.THREAD_VARIABLES, str(threads)))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
