"""Fréchet and kernel distances of two sets of features, side by side."""

from __future__ import annotations

from typing import Any

import numpy as np
from timing import Job, collect, interleaved, rows

from eval.metrics.two_sample import frechet, kernel_distance

ROWS, DIMENSIONS, REPEATS = 2000, 256, 5
#: Windows of one clip, whose pairs ours leaves out; peers know of no clips.
PER_CLIP = 20
#: Rows on which a peer of the kernel distance must agree, each a clip of its own there.
CHECKED = 200


class Case:
    """Two sets of features of (N, D), a little apart."""

    def __init__(self, count: int, dimensions: int) -> None:
        rng = np.random.default_rng(17)
        mixing = rng.normal(size=(dimensions, dimensions)) / np.sqrt(dimensions)
        self.x = rng.normal(size=(count, dimensions)) @ mixing
        self.y = rng.normal(size=(count, dimensions)) @ mixing + 0.1
        self.clips = np.arange(count) // PER_CLIP
        self.frechet = frechet(self.x, self.y)

    @staticmethod
    def check(found: float, expected: float) -> None:
        """Hold a peer to the same distance."""
        if not np.isclose(found, expected, rtol=1e-4, atol=1e-7):
            raise ValueError(f"its distance is {found:.6g}, not {expected:.6g}")


def _sqrtm(case: Case) -> Job:
    """As the published code of the FID does it: the root of the product of the covariances as a matrix."""
    from scipy.linalg import sqrtm

    def job() -> float:
        gap = case.x.mean(axis=0) - case.y.mean(axis=0)
        first, second = np.cov(case.x, rowvar=False), np.cov(case.y, rowvar=False)
        root = sqrtm(first @ second)
        return float(gap @ gap + np.trace(first) + np.trace(second) - 2.0 * np.trace(root.real))

    case.check(job(), case.frechet)
    return job


def _eigenvalues(case: Case) -> Job:
    """The trace of the root from the eigenvalues of the product, which is not symmetric."""

    def job() -> float:
        gap = case.x.mean(axis=0) - case.y.mean(axis=0)
        first, second = np.cov(case.x, rowvar=False), np.cov(case.y, rowvar=False)
        values = np.linalg.eigvals(first @ second)
        return float(gap @ gap + np.trace(first) + np.trace(second) - 2.0 * np.sqrt(values.astype(complex)).real.sum())

    case.check(job(), case.frechet)
    return job


def _sklearn(case: Case) -> Job:
    """The unbiased estimator over scikit-learn's kernel; without the standard error that ours has beside it."""
    from sklearn.metrics.pairwise import polynomial_kernel

    def kernel(a: Any, b: Any) -> Any:
        return polynomial_kernel(a, b, degree=3, gamma=1.0 / a.shape[1], coef0=1.0)

    def distance(x: Any, y: Any) -> float:
        pairs = len(x) * (len(x) - 1)
        own = [(k.sum() - np.trace(k)) / pairs for k in (kernel(x, x), kernel(y, y))]
        return float(sum(own) - 2.0 * kernel(x, y).mean())

    x, y = case.x[:CHECKED], case.y[:CHECKED]
    case.check(distance(x, y), kernel_distance(x, y, np.arange(len(x)), np.arange(len(y))).value)
    return lambda: distance(case.x, case.y)


def run(
    console: Any, *, count: int = ROWS, dimensions: int = DIMENSIONS, repeats: int = REPEATS
) -> list[dict[str, Any]]:
    """Time both distances; the floor is the matrix products that nobody gets around."""
    case = Case(count, dimensions)
    tasks: dict[str, tuple[Job, dict[str, Any], Job]] = {
        "Fréchet distance": (
            lambda: frechet(case.x, case.y),
            {"scipy sqrtm": _sqrtm, "numpy eigvals": _eigenvalues},
            lambda: (case.x.T @ case.x, case.y.T @ case.y),
        ),
        "Kernel distance": (
            lambda: kernel_distance(case.x, case.y, case.clips, case.clips),
            {"scikit-learn polynomial_kernel": _sklearn},
            lambda: (case.x @ case.x.T, case.y @ case.y.T, case.x @ case.y.T),
        ),
    }
    result = []
    for task, (ours, builders, floor) in tasks.items():
        peers, missing = collect(builders, case, console=console)
        jobs = {"ours": ours, **peers, "floor: the products": floor}
        result += rows(f"{task}, {count} x {dimensions}", interleaved(jobs, repeats=repeats), missing)
    return result
