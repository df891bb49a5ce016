"""Maximum mean discrepancy under a Gaussian kernel, and whether it could be chance: a permutation test over clips."""

from __future__ import annotations

from dataclasses import dataclass
from math import comb

import numpy as np
from numpy.typing import NDArray

from eval.metrics.two_sample import Pairs, distances, squared_distance

Array = NDArray[np.float64]

#: Arrangements held in memory at a time.
_BLOCK = 256


def median_bandwidth(x: Array, groups: NDArray) -> float:
    """Median distance between (N, D) rows of different groups: the scale on which a sample varies (Gretton et al. 2012, 8).

    Rows of one group, windows of one clip, are near to one another for a reason that has nothing to do with that scale.
    """
    apart = groups[:, None] != groups
    return float(np.median(distances(x, x)[apart])) if apart.any() else 0.0


def gaussian_kernel(rows: Array, bandwidth: float) -> Array:
    """``exp(-|a - b|^2 / (2 bandwidth^2))`` for all pairs (N, N) of (N, D) rows."""
    return np.exp(-0.5 * (distances(rows, rows) / bandwidth) ** 2)


@dataclass(frozen=True, eq=False)
class TwoSample:
    """Two samples of groups of rows, seen through a kernel.

    Attributes
    ----------
    sums
        (G, G) sums of the kernel over the pairs of rows of two groups, groups of both samples together.
    size
        (G,) rows of each group.
    member
        (G, S) 1 where a group is of a stratum.
    first
        (G,) whether a group is of the first sample.
    """

    sums: Array
    size: Array
    member: Array
    first: NDArray[np.bool_]

    def discrepancy(self, first: NDArray[np.bool_] | None = None) -> Array:
        """Squared discrepancy without bias, for the samples as they are or for other arrangements (P, G) of the groups."""
        one = (self.first if first is None else first)[..., :].astype(np.float64)
        two = 1.0 - one
        across = np.einsum("...g,...g->...", one @ self.sums, two)
        return squared_distance(self._pairs(one), self._pairs(two), across, self._by_stratum(one, two))

    def _pairs(self, of: Array) -> Pairs:
        own = np.diag(self.sums)
        whole = self._by_stratum(of, of)
        total = np.einsum("...g,...g->...", of @ self.sums, of) - of @ own
        return Pairs(
            total,
            whole - of @ (own[:, None] * self.member),
            whole,
            of @ (self.size[:, None] * self.member),
            of @ (self.size[:, None] ** 2 * self.member),
        )

    def _by_stratum(self, one: Array, two: Array) -> Array:
        """(..., S) sums of the kernel over the pairs of a group of ``one`` and a group of ``two`` in the same stratum."""
        parts = []
        for stratum in self.member.T > 0:
            block = self.sums[np.ix_(stratum, stratum)]
            parts.append(np.einsum("...g,...g->...", one[..., stratum] @ block, two[..., stratum]))
        return np.stack(parts, axis=-1)

    def arrangements(self) -> int:
        """In how many ways the groups of each stratum can be dealt out to the two samples, as many to each as now."""
        count = 1
        for stratum in self.member.T > 0:
            count *= comb(int(stratum.sum()), int(self.first[stratum].sum()))
        return count

    def p(self, *, permutations: int, rng: np.random.Generator) -> float:
        """Share of random arrangements, this one counted in, that are at least as far apart (Phipson & Smyth 2010)."""
        observed = float(self.discrepancy())
        # Arrangements that are the same but for rounding count as equal.
        slack = 1e-9 * float(np.abs(self.sums).sum()) / float(self.size.sum()) ** 2
        reached = 0
        for start in range(0, permutations, _BLOCK):
            count = min(_BLOCK, permutations - start)
            dealt = np.tile(self.first, (count, 1))
            for stratum in self.member.T > 0:
                dealt[:, stratum] = rng.permuted(dealt[:, stratum], axis=1)
            reached += int((self.discrepancy(dealt) >= observed - slack).sum())
        return (1 + reached) / (1 + permutations)


def two_sample(
    x: Array,
    y: Array,
    x_groups: NDArray,
    y_groups: NDArray,
    *,
    bandwidth: float,
    x_strata: NDArray | None = None,
    y_strata: NDArray | None = None,
) -> TwoSample:
    """Set up a comparison of (N, D) and (M, D) rows.

    Parameters
    ----------
    x, y
        The rows.
    x_groups, y_groups
        (N,) and (M,) labels of groups, windows of a clip: they depend on one another, so that pairs within a group say nothing,
        and groups, not rows, are what can be exchanged.
    bandwidth
        Of the kernel, above 0.
    x_strata, y_strata
        (N,) and (M,) labels of strata, actions, which hold whole groups: groups are exchanged within a stratum only, and pairs
        are weighted as in :func:`eval.metrics.two_sample.kernel_distance`. ``None`` for a single one.

    Raises
    ------
    ValueError
        For a bandwidth of 0 or less.

    Notes
    -----
    Gretton, Borgwardt, Rasch, Schölkopf & Smola, "A kernel two-sample test", Journal of Machine Learning Research 13 (2012),
    lemma 6 for the estimate without bias, which may be negative.
    """
    if not bandwidth > 0.0:
        raise ValueError(f"the bandwidth of the kernel must be above 0, not {bandwidth}")
    rows = np.concatenate([x, y])
    strata = np.concatenate(
        [np.zeros(len(part)) if labels is None else labels for part, labels in ((x, x_strata), (y, y_strata))]
    )
    _, x_index = np.unique(x_groups, return_inverse=True)
    _, y_index = np.unique(y_groups, return_inverse=True)
    index = np.concatenate([x_index, y_index + int(x_index.max()) + 1])
    groups = int(index.max()) + 1
    _, leaders = np.unique(index, return_index=True)
    names, codes = np.unique(strata[leaders], return_inverse=True)
    of = np.eye(groups)[index]
    kernel = gaussian_kernel(rows, bandwidth)
    return TwoSample(
        of.T @ kernel @ of, of.sum(axis=0), np.eye(len(names))[codes], np.arange(groups) <= int(x_index.max())
    )
