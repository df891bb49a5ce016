"""Bootstrap intervals that respect how observations hang together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike


class Interval(NamedTuple):
    """A mean and its percentile interval."""

    mean: float
    low: float
    high: float


def clustered_mean(
    values: ArrayLike, clusters: Sequence[object], *, seed: int = 0, resamples: int = 2000, level: float = 0.95
) -> Interval:
    """Mean of ``values`` with a two-stage bootstrap interval: clusters are drawn first, then observations within each.

    Of m clusters, m - 1 are drawn: with a handful, a draw of m would show only (m - 1) / m of their variance.

    Parameters
    ----------
    values
        (N,) observations; those that are not finite are left out.
    clusters
        N labels, for example the actor of each clip. With one cluster only the second stage varies, so the interval
        then says nothing about other actors.
    seed, resamples, level
        Of the bootstrap. The mean is over observations, not over cluster means.

    Returns
    -------
    Interval
        All NaN without observations; of zero width with one.

    Notes
    -----
    Davison and Hinkley, *Bootstrap Methods and their Application* (1997), section 3.8, sampling with replacement at
    both stages; Rao and Wu (1988) for m - 1 of m, as in :mod:`eval.stats.panel`.
    """
    array = np.asarray(values, dtype=np.float64)
    labels = np.asarray([str(cluster) for cluster in clusters])
    keep = np.isfinite(array)
    array, labels = array[keep], labels[keep]
    if len(array) == 0:
        return Interval(float("nan"), float("nan"), float("nan"))
    mean = float(array.mean())
    if len(array) == 1:
        return Interval(mean, mean, mean)
    groups = [array[labels == label] for label in np.unique(labels)]
    rng = np.random.default_rng(seed)
    # Sums and counts of one resampled copy of every (draw, slot), gathered by the cluster drawn for that slot.
    drawn = rng.integers(len(groups), size=(resamples, max(1, len(groups) - 1)))
    totals, counts = np.zeros(resamples), np.zeros(resamples)
    for index, group in enumerate(groups):
        rows, _ = np.nonzero(drawn == index)
        picks = rng.integers(len(group), size=(len(rows), len(group)))
        np.add.at(totals, rows, group[picks].sum(axis=1))
        np.add.at(counts, rows, len(group))
    means = totals / counts
    tail = 50.0 * (1.0 - level)
    low, high = np.percentile(means, [tail, 100.0 - tail])
    return Interval(mean, float(low), float(high))
