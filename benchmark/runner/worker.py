"""What runs inside a cell's process."""

from __future__ import annotations

import contextlib
import ctypes
import faulthandler
import multiprocessing
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Iterator
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path

from benchmark.runner.containment import restored
from benchmark.runner.execute import describe, execute_cell
from benchmark.runner.job import CellJob, Report
from benchmark.runner.probes import ProbeJob, fit_probe
from benchmark.runner.score import score_cell
from benchmark.runner.store import RunStore, printable

#: Environment variables by which numerical libraries take their number of threads.
THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)

_PR_SET_PDEATHSIG = 1


def work(job: CellJob | ProbeJob, report: Report) -> None:
    """Fit the probe; or execute the cell if asked to, then score what is stored."""
    # A method may change the working directory.
    job = replace(
        job, folder=job.folder.absolute(), split_file=job.split_file.absolute(), dataset=job.dataset.absolute()
    )
    if isinstance(job, ProbeJob):
        with _ended_well(job), restored():
            fit_probe(job, report)
        return
    if job.execute:
        report("execute", 0.0, "")
        with _ended_well(job), restored():
            execute_cell(job, report)
    if (job.folder / "cells" / job.cell.key / "items.json").exists():
        report("score", 0.0, "")
        score_cell(job, report)


@contextlib.contextmanager
def _ended_well(job: CellJob | ProbeJob) -> Iterator[None]:
    """Store as failed a cell whose method raised what is meant to end a process, as ``sys.exit`` does."""
    try:
        yield
    except BaseException as error:
        # In the user's own process Ctrl-C is the user's; in a worker it is switched off, and can only be the method's.
        ours = isinstance(error, KeyboardInterrupt) and multiprocessing.parent_process() is None
        if ours or isinstance(error, Exception):
            raise
        RunStore(job.folder).commit_failure(job.cell.key, describe(error), traceback.format_exc())


def main(connection: Connection, job: CellJob | ProbeJob, output: Connection | Path) -> None:
    """Body of a worker process: everything printed goes to ``output``, everything reported to ``connection``."""
    _die_with_parent(connection)
    _first_out_of_memory()
    with output.open("wb", buffering=0) if isinstance(output, Path) else output as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    faulthandler.enable(2)
    with limited_threads(job.threads):
        work(job, Reporter(connection))
    connection.send(("done", 1.0, ""))


class Reporter:
    """Sends reports through a pipe; changes of stage and metric at once, the rest at most ten times a second."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._stage, self._last = "", 0.0

    def __call__(self, stage: str, fraction: float, message: str) -> None:
        """Send one report, or drop it."""
        now = time.monotonic()
        if stage in ("execute", "metric") or stage != self._stage or now - self._last >= 0.1:
            self._stage, self._last = stage, now
            # Without its parent a worker has nobody to report to, and is about to be ended.
            with contextlib.suppress(BrokenPipeError, ConnectionResetError):
                self._connection.send((stage, float(fraction), printable(str(message))))


@contextlib.contextmanager
def limited_threads(threads: int) -> Iterator[None]:
    """Cap the threads of BLAS, OpenMP and torch, those loaded and those yet to be loaded."""
    from threadpoolctl import threadpool_limits

    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, str(threads)))
    torch = sys.modules.get("torch")
    if torch is not None:
        torch.set_num_threads(threads)
    try:
        with threadpool_limits(threads):
            yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _first_out_of_memory() -> None:
    """Where memory runs out, let the system end this process, and not the run or somebody else's."""
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("1000")


def _die_with_parent(connection: Connection) -> None:
    """Lead a process group of its own, leave Ctrl-C to the parent, and end when the parent does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # the fork server's is its own
    if hasattr(os, "setpgrp"):
        os.setpgrp()
    if sys.platform == "linux":
        # Reaches even a method that is stuck in C code. The fork server, this process's parent, ends with the run: it is told
        # so by the system (benchmark.runner.adopt).
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)

    def watch() -> None:
        try:
            connection.recv()
        except (EOFError, OSError):
            os.kill(os.getpid(), getattr(signal, "SIGKILL", signal.SIGTERM))

    threading.Thread(target=watch, name="parent-watch", daemon=True).start()
