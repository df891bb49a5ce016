"""Dynamic time warping with its path, 63 channels, side by side at three lengths."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from typing import Any

import numpy as np
from timing import Job, collect, interleaved, rows

from benchmark.motion.dtw import dtw

CHANNELS = 63
SIZES = {300: 21, 1000: 9, 5000: 3}


class Case:
    """A smooth walk through pose space and a noisy performance of it at another, uneven pace."""

    def __init__(self, frames: int) -> None:
        rng = np.random.default_rng(frames)
        self.x = np.cumsum(rng.normal(0.0, 0.05, (frames, CHANNELS)), axis=0)
        self.y = self.x[np.sort(rng.integers(0, frames, frames))] + rng.normal(0.0, 0.02, (frames, CHANNELS))
        self.cost = dtw(self.x, self.y).cost

    def check(self, cost: float) -> None:
        """Hold an exact peer to the same total of squared distances."""
        if not np.isclose(cost, self.cost, rtol=1e-8):
            raise ValueError(f"its cost is {cost:.10g}, not {self.cost:.10g}")


def _dtaidistance(case: Case) -> Job:
    # The documented `dtw_ndim.warping_path` runs pure Python; this is the compiled routine beneath it.
    library = importlib.import_module("dtaidistance.dtw_cc")

    def job() -> Any:
        return library.warping_path_ndim(case.x, case.y, CHANNELS, include_distance=True)

    case.check(job()[1] ** 2)
    return job


def _tslearn(case: Case) -> Job:
    metrics = importlib.import_module("tslearn.metrics")

    def job() -> Any:
        return metrics.dtw_path(case.x, case.y)

    case.check(job()[1] ** 2)
    return job


def _librosa(case: Case) -> Job:
    sequence = importlib.import_module("librosa.sequence")

    def job() -> Any:
        return sequence.dtw(case.x.T, case.y.T, metric="sqeuclidean")

    case.check(job()[0][-1, -1])
    return job


def _dtw_python(case: Case) -> Job:
    library = importlib.import_module("dtw")

    def job() -> Any:
        return library.dtw(case.x, case.y, dist_method="sqeuclidean", step_pattern="symmetric1")

    case.check(job().distance)
    return job


def _fastdtw(case: Case) -> Job:
    library = importlib.import_module("fastdtw")

    # Approximate, and of plain distances: no cost to compare.
    def job() -> Any:
        return library.fastdtw(case.x, case.y, radius=1, dist=2)

    return job


PEERS = {
    "dtaidistance": _dtaidistance,
    "tslearn": _tslearn,
    "librosa": _librosa,
    "dtw-python": _dtw_python,
    "fastdtw, approximate": _fastdtw,
}


def run(
    console: Any, *, sizes: dict[int, int] | None = None, peers: Sequence[str] = tuple(PEERS)
) -> list[dict[str, Any]]:
    """Time the exact alignment with its path; ``sizes`` maps lengths to repeats."""
    result = []
    for frames, repeats in (SIZES if sizes is None else sizes).items():
        case = Case(frames)
        jobs, missing = collect({name: PEERS[name] for name in peers}, case, console=console)
        ours: dict[str, Job] = {"ours": lambda case=case: dtw(case.x, case.y)}
        seconds = interleaved({**ours, **jobs}, repeats=repeats)
        result += rows(f"DTW, {frames} frames", seconds, missing, work=frames**2 / 1e6, unit="M cells/s")
    return result
