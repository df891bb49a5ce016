"""Dynamic time warping with its path, 60 channels, side by side at three lengths."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import psutil
from numpy.typing import ArrayLike, NDArray
from timing import Job, collect, interleaved, rows

from benchmark.motion.dtw import dtw, dtw_from_costs

CHANNELS = 60
SIZES = {300: 21, 1000: 11, 5000: 5}
#: Costs, accumulated costs, steps and what an update of one matrix by another leaves behind, in bytes a cell.
PEAK = 64


class Case:
    """A smooth walk through pose space and a noisy performance of it at another, uneven pace."""

    def __init__(self, frames: int) -> None:
        rng = np.random.default_rng(frames)
        self.x = np.cumsum(rng.normal(0.0, 0.05, (frames, CHANNELS)), axis=0)
        self.y = self.x[np.sort(rng.integers(0, frames, frames))] + rng.normal(0.0, 0.02, (frames, CHANNELS))
        self.cost = dtw(self.x, self.y).cost

    @cached_property
    def plain_cost(self) -> float:
        """The optimum for distances that are not squared."""
        return dtw_from_costs(np.sqrt(squared_distances(self.x, self.y))).cost

    def check(self, cost: float, path: ArrayLike | None = None) -> None:
        """Hold an exact peer to the optimum: the total that it says, and the total of squared distances along its path."""
        if not np.isclose(cost, self.cost, rtol=1e-8):
            raise ValueError(f"its cost is {cost:.10g}, not {self.cost:.10g}")
        if path is not None:
            found = self.along(path)
            if not np.isclose(found, self.cost, rtol=1e-8):
                raise ValueError(f"the cost along its path is {found:.10g}, not {self.cost:.10g}")

    def excess(self, path: Any) -> float:
        """By which fraction an approximate path costs more than the cheapest, in plain distances."""
        return self.along(path, plain=True) / self.plain_cost - 1.0

    def along(self, path: ArrayLike, *, plain: bool = False) -> float:
        """Total cost along a path, which must be one: from corner to corner by steps of at most one frame."""
        cells = np.asarray(path, dtype=np.int64)
        steps = np.diff(cells, axis=0)
        corners = [[0, 0], [len(self.x) - 1, len(self.y) - 1]]
        if cells[[0, -1]].tolist() != corners or steps.min() < 0 or steps.max() > 1 or not steps.any(axis=1).all():
            raise ValueError("what it gives is no path from corner to corner by single steps")
        squared = ((self.x[cells[:, 0]] - self.y[cells[:, 1]]) ** 2).sum(axis=1)
        return float((np.sqrt(squared) if plain else squared).sum())


def squared_distances(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Local costs by one matrix product, for libraries that take a matrix: the fastest way to make one in numpy."""
    costs = x @ y.T
    costs *= -2.0
    costs += np.einsum("ij,ij->i", x, x)[:, None]
    costs += np.einsum("ij,ij->i", y, y)
    return np.maximum(costs, 0.0, out=costs)


def _dtaidistance(case: Case) -> Job:
    # The documented `dtw_ndim.warping_path` runs pure Python; this is the compiled routine beneath it.
    library = importlib.import_module("dtaidistance.dtw_cc")

    def job() -> Any:
        return library.warping_path_ndim(case.x, case.y, CHANNELS, include_distance=True)

    path, distance = job()
    case.check(distance**2, path)
    return job


def _tslearn(case: Case) -> Job:
    metrics = importlib.import_module("tslearn.metrics")

    def job() -> Any:
        return metrics.dtw_path(case.x, case.y)

    path, distance = job()
    case.check(distance**2, path)
    return job


def _aeon(case: Case) -> Job:
    distances = importlib.import_module("aeon.distances")
    x, y = np.ascontiguousarray(case.x.T), np.ascontiguousarray(case.y.T)

    def job() -> Any:
        return distances.dtw_alignment_path(x, y)

    path, cost = job()
    case.check(cost, path)
    return job


def _sktime(case: Case) -> Job:
    # What `AlignerDtwNumba` calls, without the data frames around it.
    library = importlib.import_module("sktime.dists_kernels._numba_distances")
    x, y = np.ascontiguousarray(case.x.T), np.ascontiguousarray(case.y.T)

    def job() -> Any:
        return library.distance_alignment_path(x, y, metric="dtw")

    path, cost = job()
    case.check(cost, path)
    return job


def _librosa(case: Case) -> Job:
    sequence = importlib.import_module("librosa.sequence")

    def job() -> Any:
        return sequence.dtw(C=squared_distances(case.x, case.y))

    total, path = job()
    case.check(total[-1, -1], path[::-1])
    return job


def _dtw_python(case: Case) -> Job:
    library = importlib.import_module("dtw")

    def job() -> Any:
        return library.dtw(squared_distances(case.x, case.y), step_pattern="symmetric1")

    found = job()
    case.check(found.distance, np.stack((found.index1, found.index2), axis=1))
    return job


def _pyts(case: Case) -> Job:
    metrics = importlib.import_module("pyts.metrics")

    def job() -> Any:
        costs = squared_distances(case.x, case.y)
        return metrics.dtw(dist="precomputed", precomputed_cost=costs, return_path=True)

    cost, path = job()
    case.check(cost, path.T)
    return job


def _dtwalign(case: Case) -> Job:
    library = importlib.import_module("dtwalign")

    def job() -> Any:
        return library.dtw_from_distance_matrix(squared_distances(case.x, case.y), step_pattern="symmetric1")

    found = job()
    case.check(found.distance, found.path)
    return job


def _synctoolbox(case: Case) -> Job:
    core = importlib.import_module("synctoolbox.dtw.core")

    def job() -> Any:
        return core.compute_warping_path(squared_distances(case.x, case.y))

    total, _, path = job()
    case.check(total[-1, -1], path.T)
    return job


def _libfmp(case: Case) -> Job:
    library = importlib.import_module("libfmp.c3")

    def job() -> Any:
        total = library.compute_accumulated_cost_matrix(squared_distances(case.x, case.y))
        return total[-1, -1], library.compute_optimal_warping_path(total)

    case.check(*job())
    return job


def _similaritymeasures(case: Case) -> Job:
    library = importlib.import_module("similaritymeasures")

    def job() -> Any:
        cost, total = library.dtw(case.x, case.y, metric="sqeuclidean")
        return cost, library.dtw_path(total)

    case.check(*job())
    return job


def _single(case: Case) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """What linmdtw computes with."""
    return case.x.astype(np.float32), case.y.astype(np.float32)


def _linmdtw(case: Case) -> Job:
    library = importlib.import_module("linmdtw")
    x, y = _single(case)

    def job() -> Any:
        return library.dtw_brute_backtrace(x, y)[1]

    if not np.isclose(case.along(job(), plain=True), case.plain_cost, rtol=1e-5):
        raise ValueError("its path is not the cheapest in plain distances")
    return job


def _fastdtw(case: Case) -> Job:
    library = importlib.import_module("fastdtw")

    def job() -> Any:
        return library.fastdtw(case.x, case.y, radius=1, dist=2)[1]

    case.excess(job())
    return job


def _linmdtw_fast(case: Case) -> Job:
    library = importlib.import_module("linmdtw")
    x, y = _single(case)

    def job() -> Any:
        # At radius 1 its recursion does not end.
        return library.fastdtw(x, y, radius=2)[1]

    case.excess(job())
    return job


@dataclass(frozen=True)
class Peer:
    """A library, how it is called, and what keeps it from a run.

    ``apart`` says what keeps it out of the extra; ``most`` is the length beyond which a call takes minutes. An approximate one
    gives a path that is cheap in plain distances, and its row says by how much the optimum is cheaper.
    """

    build: Callable[[Case], Job]
    apart: str = ""
    most: int | None = None
    approximate: bool = False


PEERS: Mapping[str, Peer] = {
    "dtaidistance": Peer(_dtaidistance),
    "tslearn": Peer(_tslearn),
    "librosa": Peer(_librosa),
    "pyts": Peer(_pyts),
    "dtwalign": Peer(_dtwalign),
    "dtw-python": Peer(_dtw_python),
    "similaritymeasures": Peer(_similaritymeasures, most=1000),
    "aeon": Peer(_aeon, apart="needs an older pandas and numba"),
    "sktime": Peer(_sktime, apart="needs an older pandas"),
    "synctoolbox": Peer(_synctoolbox, apart="needs an older pandas and numba"),
    "libfmp": Peer(_libfmp, apart="needs an older pandas"),
    "linmdtw": Peer(_linmdtw, apart="builds only with `--no-build-isolation`"),
    "fastdtw": Peer(_fastdtw, approximate=True),
    "linmdtw fastdtw": Peer(_linmdtw_fast, apart="builds only with `--no-build-isolation`", approximate=True),
}


def run(
    console: Any, *, sizes: Mapping[int, int] | None = None, peers: Mapping[str, Peer] | None = None
) -> list[dict[str, Any]]:
    """Time the alignment with its path; ``sizes`` maps lengths to repeats."""
    result = []
    peers = PEERS if peers is None else peers
    for frames, repeats in (SIZES if sizes is None else sizes).items():
        case = Case(frames)
        builders, missing = {}, {}
        for name, peer in peers.items():
            if peer.most is not None and frames > peer.most:
                missing[name] = f"loops in Python: up to {peer.most} frames"
            elif PEAK * frames**2 > psutil.virtual_memory().available:
                missing[name] = f"may need {PEAK * frames**2 / 1e9:.1f} GB of memory"
            else:
                builders[name] = peer.build
        jobs, absent = collect(builders, case, console=console)
        for name, reason in absent.items():
            apart = peers[name].apart
            missing[name] = apart if apart and reason == "not installed" else reason
        named: dict[str, Job] = {"ours": lambda case=case: dtw(case.x, case.y)}
        for name, job in jobs.items():
            if peers[name].approximate:
                named[f"{name}, approximate: {max(case.excess(job()), 0.0):.2%} above"] = job
            else:
                named[name] = job
        seconds = interleaved(named, repeats=repeats)
        result += rows(f"DTW, {frames} frames", seconds, missing, work=frames**2 / 1e6, unit="M cells/s")
    return result
