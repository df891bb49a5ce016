"""Cells on the workers of a Dask cluster: one that is there, or one of this machine's processes.

Dask moves the errands and notices lost workers; what a worker does with a cell is in :mod:`benchmark.runner.remote`. This
process hands out a few errands more than there are workers, takes news and answers, and leaves every finished cell in the run
folder, so that it can be ended and started again at any moment.
"""

from __future__ import annotations

import contextlib
import logging
import queue
import secrets
import time
import traceback
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from benchmark.errors import BenchmarkError, ConfigError, StoreError
from benchmark.runner import provenance, remote
from benchmark.runner.backends import MEMORY_PER_JOB, Job, Observer
from benchmark.runner.execute import describe
from benchmark.runner.job import CellJob
from benchmark.runner.parcel import pack, unpack
from benchmark.runner.probes import ProbeJob, probe_store
from benchmark.runner.remote import Answer, Errand, Luggage
from benchmark.runner.store import RunStore

if TYPE_CHECKING:
    from distributed import Client, Future

_log = logging.getLogger(__name__)

INSTALL = "pip install -c constraints.txt -e '.[dask]'"

#: Resources that workers may declare: a cell that wants a GPU asks for one, and every cell for memory where any is declared.
GPU, MEMORY = "GPU", "MEMORY"

#: How often a cell may lose its worker before it is given up, beside the times that Dask itself tries again.
TRIES = 3
#: The same for Dask's own tries in a cluster of this machine.
DASK_TRIES = 10
#: Errands on their way for each that can be done at a time: workers need not wait for this process, and few are lost with it.
AHEAD = 2


def connect(scheduler: str, *, timeout: float = 30.0) -> Client:
    """A client of a running scheduler.

    Raises
    ------
    ConfigError
        If Dask is not installed or nobody answers.
    """
    distributed = _distributed()
    try:
        client: Client = distributed.Client(scheduler, timeout=timeout, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise ConfigError(
            f"no scheduler answers at {scheduler!r} ({' '.join(str(error).split())}): start one with `dask scheduler`, which "
            "prints its address"
        ) from error
    return client


def has_gpu(scheduler: str | None) -> bool:
    """Whether a worker of the cluster has a GPU for cells; of this machine where no scheduler is named."""
    if scheduler is None:
        return provenance.gpu_usable()
    with connect(scheduler) as client:
        return any(worker["resources"].get(GPU, 0) > 0 for worker in _workers(client).values())


def _distributed() -> Any:
    try:
        import distributed
    except ImportError as error:
        raise ConfigError(f"backend 'dask' needs the package distributed: {INSTALL}") from error
    return distributed


def _workers(client: Client) -> dict[str, Any]:
    workers: dict[str, Any] = client.scheduler_info(n_workers=-1)["workers"]
    return workers


class Dask:
    """Cells as tasks of Dask.

    Parameters
    ----------
    jobs
        Workers of a cluster on this machine, where no scheduler is named.
    time_limit
        As of :class:`~benchmark.runner.backends.Processes`.
    scheduler
        Address of a running scheduler, whose workers decide how many cells there are at a time.
    """

    def __init__(self, jobs: int, time_limit: float | None, scheduler: str | None = None) -> None:
        _distributed()
        self.jobs, self.time_limit, self.scheduler = jobs, time_limit, scheduler
        self._token = secrets.token_hex(8)
        self._news: queue.SimpleQueue[tuple[str, Any]] = queue.SimpleQueue()
        self._held = contextlib.ExitStack()
        #: Whether a worker was met that does not see the run folder.
        self._apart = False
        self._parcels: dict[str, bytes] = {}

    def __enter__(self) -> Self:
        with contextlib.ExitStack() as stack:
            self.client = stack.enter_context(connect(self.scheduler) if self.scheduler else self._local(stack))
            self.client.subscribe_topic(self._topic, lambda event: self._news.put(("news", event[1])))
            self._held = stack.pop_all()
        return self

    def __exit__(self, *error: object) -> None:
        with self._held:
            if error[0] is not None:
                # Cells that nobody waits for are not worth a cluster's time.
                with contextlib.suppress(Exception):
                    self.client.run(remote.stop, self._token)

    @property
    def _topic(self) -> str:
        return f"benchmark-{self._token}"

    def _local(self, stack: contextlib.ExitStack) -> Client:
        """A cluster of this machine: ``jobs`` workers that each do one cell at a time."""
        import dask

        distributed = _distributed()
        stack.enter_context(dask.config.set({"distributed.scheduler.allowed-failures": DASK_TRIES}))
        cluster = distributed.LocalCluster(
            n_workers=self.jobs,
            threads_per_worker=1,
            processes=True,
            dashboard_address=":0",
            memory_limit=0,  # cells run in processes of their own, whose memory Dask does not see
            silence_logs=logging.CRITICAL,
        )
        stack.enter_context(cluster)
        client: Client = distributed.Client(cluster, set_as_default=False)
        return client

    def run(self, jobs: Sequence[Job], observer: Observer) -> None:
        """Run every job."""
        if not jobs:
            return
        run = _run_folder(jobs[0])
        with _marked(run, self._token):
            _Shift(self, run, jobs, observer).work()


class _Shift:
    """The jobs of one call of :meth:`Dask.run`: those that wait, and those that are with a worker."""

    def __init__(self, dask: Dask, run: Path, jobs: Sequence[Job], observer: Observer) -> None:
        self.dask, self.client, self.folder, self.observer = dask, dask.client, run, observer
        self.waiting = deque(jobs)
        self.out: dict[str, tuple[Future, Job]] = {}
        self.cells = {job.cell.key: job.cell for job in jobs}
        self.lost: Counter[str] = Counter()
        self.began: set[str] = set()
        self._looked = 0.0
        self._room, self._memory = 0, 0.0

    def work(self) -> None:
        """Until every job has its answer."""
        try:
            while self.waiting or self.out:
                self._hand_out()
                try:
                    kind, value = self.dask._news.get(timeout=0.5)
                except queue.Empty:
                    self._look_after_client()
                    continue
                if kind == "news":
                    self._tell(*value)
                elif value in self.out:
                    self._take(value)
        finally:
            for future, _ in self.out.values():
                future.release()

    def _hand_out(self) -> None:
        self._look_at_cluster()
        while len(self.out) < AHEAD * self._room + 2:
            # Nobody declares the GPU of this machine: cells take turns, as they would have to share its memory.
            busy = self.dask.scheduler is None and any(_wants_gpu(job) for _, job in self.out.values())
            job = next((job for job in self.waiting if not (busy and _wants_gpu(job))), None)
            if job is None:
                return
            self.waiting.remove(job)
            self._submit(job)

    def _look_at_cluster(self) -> None:
        now = time.monotonic()
        if self._looked and now - self._looked < 5.0:
            return
        self._looked = now
        workers = _workers(self.client)
        if not workers:
            _log.warning("the scheduler at %s has no workers yet: waiting", self.dask.scheduler)
        self._room = sum(worker["nthreads"] for worker in workers.values())
        declared = [worker["resources"][MEMORY] for worker in workers.values() if MEMORY in worker["resources"]]
        self._memory = min([MEMORY_PER_JOB, *declared]) if declared else 0.0
        gpus = any(worker["resources"].get(GPU, 0) > 0 for worker in workers.values())
        if workers and self.dask.scheduler is not None and not gpus and any(_wants_gpu(job) for job in self.waiting):
            raise ConfigError(
                f"a cell needs a GPU, and no worker of {self.dask.scheduler} declares one: start workers with "
                f"`dask worker {self.dask.scheduler} --resources GPU=1`, or give --device cpu"
            )

    def _submit(self, job: Job) -> None:
        store, key = RunStore(job.folder), job.cell.key
        errand = Errand(
            _absolute(job),
            self.folder.resolve(),
            self.dask._token,
            self.dask.time_limit,
            job.dataset_digest if isinstance(job, ProbeJob) else job.cell.dataset_digest,
            remote.suite_digest(),
            remote.package_versions(),
            remote.status_bytes(store, key),
            self._luggage(job) if self.dask._apart else None,
        )
        resources: dict[str, float] = {}
        if _wants_gpu(job) and self.dask.scheduler is not None:
            resources[GPU] = 1
        if self._memory:
            resources[MEMORY] = self._memory
        future = self.client.submit(
            _task,
            errand,
            self.dask._topic,
            key=f"{key}-{secrets.token_hex(4)}",
            resources=resources or None,
            pure=False,
        )
        self.out[key] = future, job
        future.add_done_callback(lambda _: self.dask._news.put(("done", key)))

    def _luggage(self, job: Job) -> Luggage:
        """What a worker needs that does not see the run folder."""
        split = job.split_file.read_bytes()
        if isinstance(job, ProbeJob):
            return Luggage(split)
        probes = {}
        for place in job.probes.values():
            store = probe_store(job.folder)
            if store.cell(place.key).is_dir():
                if place.key not in self.dask._parcels:
                    self.dask._parcels[place.key] = pack(store.cell(place.key))
                probes[place.key] = self.dask._parcels[place.key]
        cell = None if job.execute else pack(RunStore(job.folder).cell(job.cell.key))
        return Luggage(split, probes, cell)

    def _tell(self, kind: str, key: str, stage: str, fraction: float, message: str) -> None:
        """Pass on a worker's news; a cell that a lost worker had begun begins once."""
        if key not in self.out:
            return
        if key not in self.began:
            self.began.add(key)
            self.observer.cell_started(self.cells[key])
        if kind == "progress":
            self.observer.cell_progress(self.cells[key], stage, fraction, message)

    def _take(self, key: str) -> None:
        future, job = self.out[key]
        if not future.done():  # the callback of one that was given back and handed out again
            return
        del self.out[key]
        store = RunStore(job.folder)
        try:
            answer: Answer = future.result()
        except BenchmarkError:
            raise
        except Exception as error:
            self._failed(store, job, future, error)
            return
        finally:
            future.release()
        if answer.state == "unseen":
            self.dask._apart = True
            self.waiting.appendleft(job)
            return
        if answer.parcel is not None:
            try:
                with store.writing(key) as folder:
                    unpack(answer.parcel, folder / "cells" / key)
                    store.adopt(key, folder / "cells" / key)
            except StoreError as error:
                self._give_up(store, key, str(error), traceback.format_exc())
                return
        else:
            _wait_for(store, key)
        if key not in self.began:
            self.observer.cell_started(self.cells[key])
        self.observer.cell_finished(self.cells[key], answer.state, answer.reason, answer.seconds)

    def _failed(self, store: RunStore, job: Job, future: Future, error: Exception) -> None:
        """An errand without an answer: handed out again where the worker was lost, recorded as failed else."""
        from distributed import KilledWorker
        from distributed.client import FutureCancelledError

        key = job.cell.key
        gone = isinstance(error, KilledWorker | FutureCancelledError)
        self._look_after_client()
        self.lost[key] += gone
        if gone and self.lost[key] < TRIES:
            self.waiting.append(job)
            return
        reason = "it lost its worker again and again (out of memory?)" if gone else f"the worker: {describe(error)}"
        self._give_up(store, key, reason, "".join(traceback.format_exception(error)))

    def _give_up(self, store: RunStore, key: str, reason: str, text: str) -> None:
        store.commit_failure(key, reason, text)
        self.observer.cell_finished(self.cells[key], "failed", reason, 0.0)

    def _look_after_client(self) -> None:
        if self.client.status not in ("running", "connecting"):
            raise StoreError(
                f"the scheduler {self.dask.scheduler or 'of this run'} is gone; finished cells are kept: start it again and "
                "give the same command"
            )


def _task(errand: Errand, topic: str) -> Answer:
    """What Dask calls on a worker."""
    from distributed import get_worker

    worker = get_worker()

    def send(kind: str, key: str, stage: str, fraction: float, message: str) -> None:
        worker.log_event(topic, [kind, key, stage, float(fraction), message])

    try:
        return remote.do(errand, send, Path(worker.local_directory))
    except BenchmarkError as error:
        raise ConfigError(f"worker {worker.address}: {error}") from error


def _wants_gpu(job: Job) -> bool:
    return job.cell.device == "cuda" and job.execute


def _run_folder(job: Job) -> Path:
    return job.folder if isinstance(job, CellJob) else job.folder.parent


def _absolute(job: Job) -> Job:
    """The job with paths that mean the same in another working folder."""
    source = job.dataset
    if source.root is not None:
        source = replace(source, root=source.root.absolute())
    elif source.name.startswith("folder:"):
        source = replace(source, root=Path.cwd())
    return replace(job, folder=job.folder.resolve(), split_file=job.split_file.resolve(), dataset=source)


@contextlib.contextmanager
def _marked(run: Path, token: str) -> Iterator[None]:
    """The marker in the run folder, by which workers know it."""
    path = remote.marker(run, token)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("Workers that see this file keep their results in this folder.\n", encoding="utf-8")
    try:
        yield
    finally:
        path.unlink(missing_ok=True)


def _wait_for(store: RunStore, key: str, *, seconds: float = 60.0) -> None:
    """Wait until a cell that a worker has stored is seen here: network disks may show it late."""
    limit = time.monotonic() + seconds
    while store.status(key).state == "missing" and time.monotonic() < limit:
        time.sleep(0.1)
