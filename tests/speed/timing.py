"""What the benches share: jobs that take turns, and rows of one shape."""

from __future__ import annotations

import gc
import random
import statistics
import time
from collections.abc import Callable, Mapping
from importlib import metadata
from typing import Any

Job = Callable[[], object]

#: Distribution names of the libraries whose import or display name is another.
DISTRIBUTIONS = {"pymotion": "upc-pymotion", "bvhTools": "bvhtools"}


def version(name: str) -> str:
    """Installed version of the library that a row is named after, or an empty string.

    Only the first word counts: ``pymotion fk_quat`` is a row of pymotion.
    """
    first = name.split(",")[0].split()[0]
    try:
        return metadata.version(DISTRIBUTIONS.get(first, first))
    except metadata.PackageNotFoundError:
        return ""


def interleaved(
    jobs: Mapping[str, Job], *, repeats: int, limit: float = 15.0, clock: Callable[[], float] = time.perf_counter
) -> dict[str, float]:
    """Median seconds by ``clock`` of each job after one untimed call.

    The jobs take turns, so that a slow moment of the machine hits all of them, and in another order each round, so that
    none always inherits the caches and the heap that a certain other one leaves behind. A job that has used ``limit``
    seconds sits out the remaining rounds.
    """
    for job in jobs.values():
        job()
    order = random.Random(11)
    taken: dict[str, list[float]] = {name: [] for name in jobs}
    for _ in range(repeats):
        for name in order.sample(list(jobs), len(jobs)):
            if sum(taken[name]) < limit:
                gc.collect()
                started = clock()
                jobs[name]()
                taken[name].append(clock() - started)
    return {name: statistics.median(seconds) for name, seconds in taken.items()}


def copy_floor(*arrays: Any) -> Job:
    """A job that moves as many bytes as reading and writing these arrays does, at the pace of the memory."""
    import numpy as np

    source = np.concatenate([np.ravel(array) for array in arrays])
    target = np.empty_like(source)
    half = len(source) // 2
    return lambda: np.copyto(target[:half], source[:half])  # a copy reads half of the bytes and writes the other


def rows(
    task: str, seconds: Mapping[str, float], missing: Mapping[str, str], *, work: float | None = None, unit: str = "ms"
) -> list[dict[str, Any]]:
    """Rows of ``work`` per second in ``unit``, or of milliseconds; ``ratio`` is the best peer's time over the row's.

    The rows of ``missing`` hold their reason.
    """
    peers = [value for name, value in seconds.items() if not name.startswith(("ours", "floor"))]
    best = min(peers, default=None)
    timed = [
        {
            "task": task,
            "what": name,
            "value": 1e3 * value if work is None else work / value,
            "unit": unit,
            "ratio": None if best is None else best / value,
        }
        for name, value in seconds.items()
    ]
    absent = [
        {"task": task, "what": name, "value": None, "unit": unit, "ratio": None, "note": reason}
        for name, reason in missing.items()
    ]
    return timed + absent


def collect(
    builders: Mapping[str, Callable[..., Job]], *arguments: Any, console: Any
) -> tuple[dict[str, Job], dict[str, str]]:
    """Make the jobs of the libraries that are installed and work; name the others with the reason."""
    jobs: dict[str, Job] = {}
    missing: dict[str, str] = {}
    for name, build in builders.items():
        try:
            job = build(*arguments)
            job()
        except ImportError:
            missing[name] = "not installed"
        except Exception as error:  # a peer's fault must not end the comparison
            missing[name] = f"fails: {type(error).__name__}: {error}"
            console.print(f"{name} {missing[name]}")
        else:
            jobs[name] = job
    return jobs, missing
