"""Distances and overlaps of two samples of feature vectors: plain functions of arrays."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def frechet_of_moments(mean: Array, covariance: Array, other_mean: Array, other_covariance: Array) -> float:
    """Fréchet (2-Wasserstein) distance, squared, of two Gaussians (Dowson and Landau 1982; Heusel et al. 2017).

    ``|m - m'|^2 + tr(S + S' - 2 (S^(1/2) S' S^(1/2))^(1/2))``: the product under the root is symmetric, so its eigenvalues are
    real and the trace of the root is the sum of their roots. Negative rounding is cut off.

    Parameters
    ----------
    mean, other_mean
        (D,).
    covariance, other_covariance
        (D, D), symmetric and positive semi-definite.
    """
    values, vectors = np.linalg.eigh(covariance)
    root = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    product = root @ other_covariance @ root
    cross = np.sqrt(np.maximum(np.linalg.eigvalsh(0.5 * (product + product.T)), 0.0)).sum()
    gap = mean - other_mean
    return float(gap @ gap + np.trace(covariance) + np.trace(other_covariance) - 2.0 * cross)


def frechet(x: Array, y: Array) -> float:
    """Fréchet distance, squared, of the Gaussians fitted to (N, D) and (M, D) rows, N and M at least 2.

    Biased upwards for finite samples, for D >= 32 and N = M >= 4 D by about ``0.53 D (D + 1) / N`` where the two are the same:
    compare only values of equal N, or their limits (:func:`frechet_limit`).
    """
    return frechet_of_moments(x.mean(axis=0), _covariance(x), y.mean(axis=0), _covariance(y))


def _covariance(rows: Array) -> Array:
    centred = rows - rows.mean(axis=0)
    return centred.T @ centred / (len(rows) - 1)


def over_draws(
    value: Callable[[Array, Array], float], x: Array, y: Array, size: int, *, draws: int, rng: np.random.Generator
) -> Array:
    """(draws,) values of pairs of subsamples of ``size`` rows each, drawn without replacement."""
    return np.array([value(x[rng.permutation(len(x))[:size]], y[rng.permutation(len(y))[:size]]) for _ in range(draws)])


def frechet_limit(x: Array, y: Array, size: int, *, draws: int, rng: np.random.Generator, sizes: int = 6) -> float:
    """The Fréchet distance for samples without end, extrapolated (Chong and Forsyth 2020).

    Means over ``draws`` pairs of subsamples at ``sizes`` sizes, evenly spaced in 1 / N from ``size / 2`` to ``size``, are
    fitted by a line in 1 / N; its value at 0 is returned. The smaller subsamples of a draw are parts of the larger ones, which
    steadies the slope. Unlike the distance itself it may be negative: do not cut it off, or its mean is biased again.
    """
    counts = np.unique(np.round(1.0 / np.linspace(2.0 / size, 1.0 / size, sizes)).astype(int))
    means = np.zeros(len(counts))
    for _ in range(draws):
        ours, theirs = x[rng.permutation(len(x))[:size]], y[rng.permutation(len(y))[:size]]
        means += [frechet(ours[:count], theirs[:count]) / draws for count in counts]
    return float(np.polyfit(1.0 / counts, means, 1)[1])


class Estimate(NamedTuple):
    """A value and its standard error."""

    value: float
    error: float


def kernel_distance(
    x: Array,
    y: Array,
    x_groups: NDArray,
    y_groups: NDArray,
    *,
    x_strata: NDArray | None = None,
    y_strata: NDArray | None = None,
) -> Estimate:
    """Squared maximum mean discrepancy under the kernel ``(a . b / D + 1)^3`` (Binkowski et al. 2018: KID), without bias.

    Averages of the kernel over pairs within either sample leave out pairs of the same group, as the usual estimator leaves
    out pairs of a row with itself: rows of one group depend on one another, and would make any two samples look apart. Where
    samples are taken stratum by stratum (so many clips of each action) that would leave too few pairs within strata and make
    any two samples look alike: the pairs left within a stratum then stand for all of its pairs. Without strata, and where every
    row is a group of its own, it is the usual estimator. It may be negative.

    Parameters
    ----------
    x, y
        (N, D) and (M, D).
    x_groups, y_groups
        (N,) and (M,) labels of groups.
    x_strata, y_strata
        (N,) and (M,) labels of strata, which hold whole groups; ``None`` for a single one. A stratum of a single group says
        nothing about the pairs within it: those across the two samples stand for them.

    Returns
    -------
    estimate
        The distance, and its standard error by the jackknife that leaves out a block, one group, at a time: not a number
        for fewer than three groups on either side, and up to 1.6 times too large where the two distributions are the same.
    """
    d = x.shape[1]
    strata = [
        np.zeros(len(rows), dtype=np.int64) if labels is None else labels
        for rows, labels in ((x, x_strata), (y, y_strata))
    ]
    names, codes = np.unique(np.concatenate(strata), return_inverse=True)
    one = _Grouped((x @ x.T / d + 1.0) ** 3, x_groups, codes[: len(x)], len(names))
    two = _Grouped((y @ y.T / d + 1.0) ** 3, y_groups, codes[len(x) :], len(names))
    across = one.rows.T @ ((x @ y.T / d + 1.0) ** 3) @ two.rows
    same = np.einsum("gs,gh,hs->s", one.member, across, two.member)
    value = float(squared_distance(one.pairs(), two.pairs(), across.sum(), same))
    if min(across.shape) < 3:
        return Estimate(value, float("nan"))

    variance = 0.0
    for side, other, cross in ((one, two, across), (two, one, across.T)):
        left = squared_distance(
            side.pairs_without_each(),
            other.pairs(),
            across.sum() - cross.sum(axis=1),
            same - side.member * (cross @ other.member),
        )
        variance += (len(left) - 1) / len(left) * float(((left - left.mean()) ** 2).sum())
    return Estimate(value, float(np.sqrt(variance)))


class Pairs(NamedTuple):
    """Sums of the kernel over the pairs of rows within a sample, for one or several versions of it.

    Attributes
    ----------
    total
        (...) over pairs of different groups.
    apart, whole
        (..., S) over pairs of different groups of each stratum, and over all pairs of it.
    size, squares
        (..., S) rows in each stratum, and the sum of the squared sizes of its groups.
    """

    total: Array
    apart: Array
    whole: Array
    size: Array
    squares: Array


class _Grouped:
    """The kernel summed over pairs of groups of one sample.

    Parameters
    ----------
    kernel
        (N, N) of the rows.
    groups
        (N,) labels, G different ones.
    strata
        (N,) numbers from 0.
    count
        S, of strata in all.
    """

    def __init__(self, kernel: Array, groups: NDArray, strata: NDArray, count: int) -> None:
        names, first, index = np.unique(groups, return_index=True, return_inverse=True)
        #: (N, G) 1 where a row is of a group, and (G, S) where a group is of a stratum.
        self.rows, self.member = np.eye(len(names))[index], np.eye(count)[strata[first]]
        self.sums = self.rows.T @ kernel @ self.rows
        self.size = self.rows.sum(axis=0)

    def pairs(self) -> Pairs:
        """The sums over the whole sample."""
        own = np.diag(self.sums)
        whole = np.einsum("gs,gh,hs->s", self.member, self.sums, self.member)
        return Pairs(
            self.sums.sum() - own.sum(),
            whole - own @ self.member,
            whole,
            self.size @ self.member,
            self.size**2 @ self.member,
        )

    def pairs_without_each(self) -> Pairs:
        """The sums (G, ...) over the sample without one group each."""
        pairs, own = self.pairs(), np.diag(self.sums)
        near = np.einsum("gs,gh,hs->g", self.member, self.sums, self.member)
        return Pairs(
            pairs.total - 2.0 * (self.sums.sum(axis=1) - own),
            pairs.apart - 2.0 * self.member * (near - own)[:, None],
            pairs.whole - self.member * (2.0 * near - own)[:, None],
            pairs.size - self.member * self.size[:, None],
            pairs.squares - self.member * (self.size**2)[:, None],
        )


def squared_distance(one: Pairs, two: Pairs, across: Array | float, same: Array) -> Array:
    """(...) squared distances; ``same`` (..., S) are the sums of the kernel across the samples in the same stratum."""
    within = []
    for own, other in ((one, two), (two, one)):
        several, both = own.size**2 > own.squares, own.size * other.size > 0
        ratio = own.size**2 / np.where(several, own.size**2 - own.squares, 1.0)
        borrowed = same * own.size / np.where(both, other.size, 1.0)
        filled = np.where(several, own.apart * ratio, np.where(both, borrowed, own.whole))
        within.append((own.total + (filled - own.apart).sum(axis=-1)) / own.size.sum(axis=-1) ** 2)
    return within[0] + within[1] - 2.0 * across / (one.size.sum(axis=-1) * two.size.sum(axis=-1))


def distances(x: Array, y: Array) -> Array:
    """(N, M) Euclidean distances of (N, D) and (M, D) rows."""
    squared = (x**2).sum(axis=1)[:, None] + (y**2).sum(axis=1) - 2.0 * x @ y.T
    return np.sqrt(np.maximum(squared, 0.0))


def radii(x: Array, k: int) -> Array:
    """(N,) distance of each of (N, D) rows to its k-th nearest other row."""
    apart = distances(x, x)
    np.fill_diagonal(apart, np.inf)
    return np.partition(apart, k - 1, axis=1)[:, k - 1]


def precision(real: Array, ours: Array, k: int) -> float:
    """Share of our rows that are within the k-th neighbour's distance of some real row (Kynkäänniemi et al. 2019)."""
    return float((distances(real, ours) <= radii(real, k)[:, None]).any(axis=0).mean())


def recall(real: Array, ours: Array, k: int) -> float:
    """Share of real rows that are within the k-th neighbour's distance of some row of ours (Kynkäänniemi et al. 2019)."""
    return precision(ours, real, k)


def density(real: Array, ours: Array, k: int) -> float:
    """Mean over our rows of how many real neighbourhoods hold it, over k (Naeem et al. 2020); 1 for one and the same."""
    return float((distances(real, ours) <= radii(real, k)[:, None]).sum(axis=0).mean() / k)


def coverage(real: Array, ours: Array, k: int) -> float:
    """Share of real rows whose neighbourhood holds a row of ours (Naeem et al. 2020); see :func:`expected_coverage`."""
    return float((distances(real, ours) <= radii(real, k)[:, None]).any(axis=1).mean())


def expected_coverage(real: int, ours: int, k: int) -> float:
    """Coverage that N real and M other rows of one distribution have: ``1 - prod_{m<k} (N - 1 - m) / (M + N - 1 - m)``."""
    m = np.arange(k)
    return float(1.0 - np.prod((real - 1 - m) / (ours + real - 1 - m)))


def spread(x: Array, groups: NDArray) -> float:
    """Mean distance of (N, D) rows of different groups, of which there must be two."""
    apart = groups[:, None] != groups
    return float(distances(x, x)[apart].mean())
