"""The two half-steps of iterative motion warping, beside the published dense solution and beside DTW libraries; and how
both grow."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from timing import Job, collect, interleaved, rows

from benchmark.motion.dtw import dtw
from methods.hsu.space_warp import dense_matrix, difference_bands, frame_sums, space_warp
from methods.hsu.time_warp import Corridor, path_cost, time_warp

CHANNELS = 60
SMOOTH, RIDGE = 10.0, 1e-6
#: Frames of the one channel solved by both, and repeats.
DENSE = {2000: 3}
#: Frames at which the growth of the space warp is measured, ten channels each, and repeats.
GROWTH = {1_000: 25, 3_000: 15, 10_000: 9, 30_000: 5, 100_000: 5}
GROWTH_CHANNELS = 10
#: Frames aligned without a band beside libraries, and repeats.
FULL = {300: 15, 1000: 9}
#: Frames aligned within a band of so many frames on either side, and repeats.
BANDED = {1_000: 15, 3_000: 9, 10_000: 5, 30_000: 3}
REACH = 100


class Space:
    """A smooth performance, an affine image of it at an uneven pace, and the path between the two."""

    def __init__(self, frames: int, channels: int) -> None:
        rng = np.random.default_rng(frames)
        self.u = np.cumsum(rng.normal(0.0, 0.1, (frames, channels)), axis=0)
        path = np.sort(rng.integers(0, frames, frames))
        path[0], path[-1] = 0, frames - 1
        self.path = path
        self.v = 1.2 * self.u[path] + 0.3 + rng.normal(0.0, 0.02, (frames, channels))

    def banded(self) -> Any:
        return space_warp(self.u, self.v, self.path, smooth_scale=SMOOTH, smooth_offset=SMOOTH, ridge=RIDGE)

    def check(self, scale: Any, offset: Any) -> None:
        """Hold another solution to the banded one."""
        expected = self.banded()
        if not (np.allclose(scale, expected[0], atol=1e-8) and np.allclose(offset, expected[1], atol=1e-8)):
            raise ValueError("its scales and offsets differ from ours")


def _dense_lu(case: Space) -> Job:
    def job() -> Any:
        return space_warp(
            case.u, case.v, case.path, smooth_scale=SMOOTH, smooth_offset=SMOOTH, ridge=RIDGE, solver="dense"
        )

    case.check(*job())
    return job


def _dense_cholesky(case: Space) -> Job:
    """The best a dense solver can do: half the arithmetic, by symmetry."""
    from scipy.linalg import cho_factor, cho_solve

    frames = len(case.u)

    def job() -> Any:
        count = np.bincount(case.path, minlength=frames).astype(np.float64)
        bands = SMOOTH * difference_bands(frames, 1)
        u, sums = case.u[:, 0], frame_sums(case.v, case.path, frames)[:, 0]
        matrix = dense_matrix(u, count, bands, bands, RIDGE)
        right = np.concatenate([u * sums + RIDGE, sums])
        solution = cho_solve(cho_factor(matrix, overwrite_a=True, check_finite=False), right, check_finite=False)
        return solution[:frames, np.newaxis], solution[frames:, np.newaxis]

    case.check(*job())
    return job


class Time:
    """A smooth walk through pose space and a noisy performance of it at another pace."""

    def __init__(self, frames: int, band: float | None, max_skip: int) -> None:
        rng = np.random.default_rng(frames)
        self.x = np.cumsum(rng.normal(0.0, 0.05, (frames, CHANNELS)), axis=0)
        pace = np.linspace(0.0, 2.0 * np.pi, frames)
        wander = 0.3 * (frames if band is None else band * frames) * np.sin(pace)
        pick = np.clip(np.arange(frames) + wander.astype(np.int64), 0, frames - 1)
        self.v = self.x[np.maximum.accumulate(pick)] + rng.normal(0.0, 0.02, (frames, CHANNELS))
        self.max_skip = max_skip
        self.band = band
        self.corridor = Corridor.between(frames, frames, band=band, max_skip=max_skip)

    def ours(self) -> Any:
        return time_warp(self.x, self.v, self.corridor)

    def check(self, cost: float) -> None:
        """Hold a library to the same total of squared distances."""
        expected = path_cost(self.x, self.v, self.ours())
        if not np.isclose(cost, expected, rtol=1e-8):
            raise ValueError(f"its cost is {cost:.10g}, not {expected:.10g}")


def _librosa(case: Time) -> Job:
    sequence = importlib.import_module("librosa.sequence")
    steps = np.array([[1, k] for k in range(case.max_skip + 1)])

    def job() -> Any:
        return sequence.dtw(
            case.v.T,
            case.x.T,
            metric="sqeuclidean",
            step_sizes_sigma=steps,
            weights_add=np.zeros(len(steps)),
            weights_mul=np.ones(len(steps)),
        )

    case.check(job()[0][-1, -1])
    return job


def _dtw_python(case: Time) -> Job:
    # Its `asymmetric` pattern advances by 0, 1 or 2.
    library = importlib.import_module("dtw")

    def job() -> Any:
        return library.dtw(case.v, case.x, dist_method="sqeuclidean", step_pattern="asymmetric")

    case.check(job().distance)
    return job


PEERS = {"librosa": _librosa, "dtw-python": _dtw_python}


def exponent(work: list[float], seconds: list[float]) -> float:
    """Slope of a line through the points in double logarithmic coordinates."""
    return float(np.polyfit(np.log(work), np.log(seconds), 1)[0])


def _growth(task: str, value: float) -> dict[str, Any]:
    return {"task": task, "what": "ours", "value": value, "unit": "exponent", "ratio": None}


def run(
    console: Any,
    *,
    dense: dict[int, int] | None = None,
    growth: dict[int, int] | None = None,
    full: dict[int, int] | None = None,
    banded: dict[int, int] | None = None,
    reach: int = REACH,
) -> list[dict[str, Any]]:
    """Time both half-steps; each argument but ``reach`` maps lengths to repeats."""
    result = []
    for frames, repeats in (DENSE if dense is None else dense).items():
        space = Space(frames, 1)
        jobs, missing = collect({"dense LU": _dense_lu, "dense Cholesky": _dense_cholesky}, space, console=console)
        seconds = interleaved({"ours": space.banded, **jobs}, repeats=repeats, limit=30.0)
        result += rows(f"Space warp, {frames} frames, 1 channel", seconds, missing)

    lengths = GROWTH if growth is None else growth
    taken = []
    for frames, repeats in lengths.items():
        space = Space(frames, GROWTH_CHANNELS)
        seconds = interleaved({"ours": space.banded}, repeats=repeats)
        taken.append(seconds["ours"])
        result += rows(f"Space warp alone, {frames} frames, {GROWTH_CHANNELS} channels", seconds, {})
    if len(taken) > 1:
        task = f"Space warp growth, {min(lengths)} to {max(lengths)} frames"
        result.append(_growth(task, exponent([float(frames) for frames in lengths], taken)))

    for frames, repeats in (FULL if full is None else full).items():
        case = Time(frames, None, 2)
        jobs, missing = collect(PEERS, case, console=console)
        seconds = interleaved({"ours": case.ours, **jobs}, repeats=repeats)
        result += rows(f"Time warp, {frames} frames, steps 0 to 2", seconds, missing)

    taken, cells = [], []
    for frames, repeats in (BANDED if banded is None else banded).items():
        case = Time(frames, reach / frames, 3)
        # Other steps, hence another problem; the yardstick for what a band costs.
        classic: dict[str, Job] = {}
        if frames <= 3000:
            classic = {"classic steps": lambda case=case: dtw(case.x, case.v, band=case.band)}
        seconds = interleaved({"ours": case.ours, **classic}, repeats=repeats)
        taken.append(seconds["ours"])
        cells.append(float(case.corridor.cells))
        result += rows(f"Time warp in a band, {frames} frames, {reach} either side", seconds, {})
    if len(taken) > 1:
        result.append(_growth("Time warp growth, frames times band", exponent(cells, taken)))
    return result
