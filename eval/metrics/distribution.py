"""Whether the results of a method, taken together, are distributed as real motion of the target style is.

Every metric comes in two: over kinematic features, which no training can be fitted to, and over learned ones.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from benchmark.api import MetricInfo, NotApplicableError
from eval.metrics import mmd, two_sample
from eval.metrics.window_sets import (
    DRAWS,
    SEED,
    DistributionMetric,
    Windows,
    capped,
    mean_over_draws,
    neighbours,
)
from eval.probes.encoder import FeatureSet

Array = NDArray[np.float64]

#: Random arrangements for a permutation p value; with the observed one they are 1000.
PERMUTATIONS = 999

#: Fewer ways of exchanging clips cannot give a p value below 0.05.
FEWEST_ARRANGEMENTS = 21


def _info(
    name: str,
    which: FeatureSet,
    summary: str,
    direction: Literal["lower", "higher", "target", "none"],
    citation: str,
    target: float | None = None,
    code_deps: tuple[str, ...] = (),
) -> MetricInfo:
    return MetricInfo(
        name=f"distribution/{name}-{which}",
        summary=f"{summary}, {which} features",
        unit="1",
        direction=direction,
        target=target,
        needs="reference",
        scope="set",
        probe="motion-encoder",
        citation=citation,
        code_deps=(
            "benchmark.motion.canonical",
            "benchmark.motion.pose",
            "benchmark.motion.resample",
            "eval.features",
            "eval.metrics.shared",
            "eval.metrics.two_sample",
            "eval.metrics.window_sets",
            "eval.probes.encoder",
            "eval.probes.projection",
            *code_deps,
        ),
    )


class Frechet(DistributionMetric):
    """Fréchet distance of the Gaussians fitted to windows of results and of real motion.

    See :func:`eval.metrics.two_sample.frechet`. Mean over pairs of subsamples of equal size, in the first ``size / 10``
    principal axes of the training windows: its bias grows with the square of the dimension over the size, and is thus bounded
    and the same for all methods. It is not 0 even for real motion; read it beside the row of real performers.
    """

    info = _info(
        "frechet", "kinematic", "Fréchet distance to real motion at equal sample size", "lower", "Heusel et al. 2017"
    )

    def value(self, real: Windows, ours: Windows, size: int) -> float:
        """The distance; the unit is the mean variance of a training window along an axis."""
        return mean_over_draws(two_sample.frechet, capped(real, size), capped(ours, size), size)


class FrechetLearned(Frechet):
    """As :class:`Frechet`, over learned features."""

    which = "learned"
    info = _info(
        "frechet", "learned", "Fréchet distance to real motion at equal sample size", "lower", "Heusel et al. 2017"
    )


class FrechetLimit(DistributionMetric):
    """The Fréchet distance extrapolated to samples without end, in the same axes.

    See :func:`eval.metrics.two_sample.frechet_limit`. It removes what finite numbers add, not what the dependence of windows
    does. It may be negative.
    """

    info = _info(
        "frechet-limit",
        "kinematic",
        "Fréchet distance to real motion, extrapolated to endless samples",
        "lower",
        "Chong & Forsyth 2020",
    )

    def value(self, real: Windows, ours: Windows, size: int) -> float:
        """The limit; the unit is the mean variance of a training window along an axis."""
        pair = capped(real, size).features, capped(ours, size).features
        return two_sample.frechet_limit(*pair, size, draws=DRAWS, rng=np.random.default_rng(SEED))


class FrechetLimitLearned(FrechetLimit):
    """As :class:`FrechetLimit`, over learned features."""

    which = "learned"
    info = _info(
        "frechet-limit",
        "learned",
        "Fréchet distance to real motion, extrapolated to endless samples",
        "lower",
        "Chong & Forsyth 2020",
    )


class _Kernel(DistributionMetric):
    """What is estimated from all windows: a clip is a group that depends on itself, an action a stratum."""

    def estimate(self, real: Windows, ours: Windows) -> two_sample.Estimate:
        """The kernel distance and its standard error."""
        _several_clips(real, ours)
        return two_sample.kernel_distance(
            real.features,
            ours.features,
            real.clips,
            ours.clips,
            x_strata=real.actions,
            y_strata=ours.actions,
        )


class KernelDistance(_Kernel):
    """Kernel distance (KID) of all windows of results and of real motion, without bias by number or by overlapping windows.

    See :func:`eval.metrics.two_sample.kernel_distance`. In all axes; values around 0, negative ones too, say that nothing
    tells the two apart.
    """

    info = _info("kid", "kinematic", "unbiased kernel distance to real motion", "lower", "Binkowski et al. 2018")

    def value(self, real: Windows, ours: Windows, size: int) -> float:
        """The distance; not applicable to fewer than two clips on either side."""
        return self.estimate(real, ours).value


class KernelDistanceLearned(KernelDistance):
    """As :class:`KernelDistance`, over learned features."""

    which = "learned"
    info = _info("kid", "learned", "unbiased kernel distance to real motion", "lower", "Binkowski et al. 2018")


class KernelDistanceError(_Kernel):
    """Standard error of the kernel distance, by the jackknife that leaves out one clip at a time."""

    info = _info(
        "kid-error", "kinematic", "standard error over clips of the kernel distance", "none", "Binkowski et al. 2018"
    )

    def value(self, real: Windows, ours: Windows, size: int) -> float:
        """The error; not applicable to fewer than three clips on either side."""
        error = self.estimate(real, ours).error
        if not np.isfinite(error):
            raise NotApplicableError("a standard error over clips needs three clips on either side")
        return error


class KernelDistanceErrorLearned(KernelDistanceError):
    """As :class:`KernelDistanceError`, over learned features."""

    which = "learned"
    info = _info(
        "kid-error", "learned", "standard error over clips of the kernel distance", "none", "Binkowski et al. 2018"
    )


class _Gaussian(DistributionMetric):
    """The two sets through a Gaussian kernel, whose bandwidth is the median distance between windows of real clips."""

    def compared(self, real: Windows, ours: Windows) -> mmd.TwoSample:
        """Real motion first; not applicable to fewer than two clips on either side."""
        _several_clips(real, ours)
        bandwidth = mmd.median_bandwidth(real.features, real.clips)
        if bandwidth <= 0.0:
            raise NotApplicableError("all windows of real motion are the same")
        return mmd.two_sample(
            real.features,
            ours.features,
            real.clips,
            ours.clips,
            bandwidth=bandwidth,
            x_strata=real.actions,
            y_strata=ours.actions,
        )


class Discrepancy(_Gaussian):
    """Maximum mean discrepancy, squared, under a Gaussian kernel, without bias by number or by overlapping windows.

    See :func:`eval.metrics.mmd.two_sample`. Unlike :class:`KernelDistance` it sees any difference of distributions, not of the
    first three moments only, and one far-off window cannot decide it: it is 2 at most. Values around 0, negative ones too, say
    that nothing tells the two apart; the scale is that of real motion, so values compare within a task and a feature set only.
    """

    info = _info(
        "mmd",
        "kinematic",
        "maximum mean discrepancy from real motion, Gaussian kernel",
        "lower",
        "Gretton et al. 2012",
        code_deps=("eval.metrics.mmd",),
    )

    def value(self, real: Windows, ours: Windows, size: int) -> float:
        """The discrepancy; not applicable to fewer than two clips on either side."""
        return float(self.compared(real, ours).discrepancy())


class DiscrepancyLearned(Discrepancy):
    """As :class:`Discrepancy`, over learned features."""

    which = "learned"
    info = _info(
        "mmd",
        "learned",
        "maximum mean discrepancy from real motion, Gaussian kernel",
        "lower",
        "Gretton et al. 2012",
        code_deps=("eval.metrics.mmd",),
    )


class DiscrepancyP(_Gaussian):
    """Permutation p value of the maximum mean discrepancy: whether results and real motion could be of one distribution.

    Whole clips are exchanged, and within an action only: windows of a clip belong together, and the two sets need not have the
    same mix of actions. It describes (direction ``none``): a small p says that a difference is beyond chance, a large one does
    not say that there is none, and p compares no two methods. Clips of one performer depend on one another, so that p is too
    small where there are few performers: the row of real performers shows by how much. It cannot be below 0.001.
    """

    info = _info(
        "mmd-p",
        "kinematic",
        "permutation p value of the maximum mean discrepancy",
        "none",
        "Gretton et al. 2012",
        code_deps=("eval.metrics.mmd",),
    )

    def value(self, real: Windows, ours: Windows, size: int) -> float:
        """The p value; not applicable where there are too few ways of dealing out the clips for one below 0.05."""
        compared = self.compared(real, ours)
        ways = compared.arrangements()
        if ways < FEWEST_ARRANGEMENTS:
            raise NotApplicableError(
                f"clips can be exchanged in {ways} ways only; a p value below 0.05 needs {FEWEST_ARRANGEMENTS}"
            )
        return compared.p(permutations=PERMUTATIONS, rng=np.random.default_rng(SEED))


class DiscrepancyPLearned(DiscrepancyP):
    """As :class:`DiscrepancyP`, over learned features."""

    which = "learned"
    info = _info(
        "mmd-p",
        "learned",
        "permutation p value of the maximum mean discrepancy",
        "none",
        "Gretton et al. 2012",
        code_deps=("eval.metrics.mmd",),
    )


class _Neighbourhoods(DistributionMetric):
    """A count of neighbourhoods, averaged over subsamples; k is 5, or less in subsamples of under 40 windows."""

    @abstractmethod
    def count(self, real: Array, ours: Array, k: int) -> float:
        """The count for a pair of subsamples (N, K)."""

    def value(self, real: Windows, ours: Windows, size: int) -> float:
        """Mean count over pairs of subsamples."""
        k = neighbours(size)
        return mean_over_draws(lambda x, y: self.count(x, y, k), real, ours, size)


class Precision(_Neighbourhoods):
    """Share of results in the neighbourhood of real motion: whether it is the like of what real performers do."""

    info = _info(
        "precision", "kinematic", "share of results that are near real motion", "higher", "Kynkäänniemi et al. 2019"
    )

    def count(self, real: Array, ours: Array, k: int) -> float:
        """See :func:`eval.metrics.two_sample.precision`."""
        return two_sample.precision(real, ours, k)


class PrecisionLearned(Precision):
    """As :class:`Precision`, over learned features."""

    which = "learned"
    info = _info(
        "precision", "learned", "share of results that are near real motion", "higher", "Kynkäänniemi et al. 2019"
    )


class Recall(_Neighbourhoods):
    """Share of real motion in the neighbourhood of results: whether all that real performers do is done.

    One stray result has a large neighbourhood: coverage is steadier.
    """

    info = _info(
        "recall", "kinematic", "share of real motion that is near results", "higher", "Kynkäänniemi et al. 2019"
    )

    def count(self, real: Array, ours: Array, k: int) -> float:
        """See :func:`eval.metrics.two_sample.recall`."""
        return two_sample.recall(real, ours, k)


class RecallLearned(Recall):
    """As :class:`Recall`, over learned features."""

    which = "learned"
    info = _info("recall", "learned", "share of real motion that is near results", "higher", "Kynkäänniemi et al. 2019")


class Density(_Neighbourhoods):
    """How many neighbourhoods of real motion hold a result, over k: 1 for real motion, more where results crowd together."""

    info = _info(
        "density", "kinematic", "real neighbourhoods that hold a result, over k", "target", "Naeem et al. 2020", 1.0
    )

    def count(self, real: Array, ours: Array, k: int) -> float:
        """See :func:`eval.metrics.two_sample.density`."""
        return two_sample.density(real, ours, k)


class DensityLearned(Density):
    """As :class:`Density`, over learned features."""

    which = "learned"
    info = _info(
        "density", "learned", "real neighbourhoods that hold a result, over k", "target", "Naeem et al. 2020", 1.0
    )


class Coverage(_Neighbourhoods):
    """Share of real windows that have a result in their neighbourhood."""

    info = _info(
        "coverage", "kinematic", "share of real neighbourhoods that hold a result", "higher", "Naeem et al. 2020"
    )

    def count(self, real: Array, ours: Array, k: int) -> float:
        """See :func:`eval.metrics.two_sample.coverage`."""
        return two_sample.coverage(real, ours, k)


class CoverageLearned(Coverage):
    """As :class:`Coverage`, over learned features."""

    which = "learned"
    info = _info(
        "coverage", "learned", "share of real neighbourhoods that hold a result", "higher", "Naeem et al. 2020"
    )


class DiversityRatio(DistributionMetric):
    """Mean distance of windows of different results, over that of windows of different real clips; best at 1.

    Below 1 the results are more alike than what real performers do, above 1 they scatter.
    """

    info = _info("diversity-ratio", "kinematic", "spread of results over that of real motion", "target", "", 1.0)

    def value(self, real: Windows, ours: Windows, size: int) -> float:
        """The ratio; not applicable to a single clip on either side."""
        _several_clips(real, ours)
        apart = two_sample.spread(real.features, real.clips)
        if apart <= 0.0:
            raise NotApplicableError("all windows of real motion are the same")
        return two_sample.spread(ours.features, ours.clips) / apart


class DiversityRatioLearned(DiversityRatio):
    """As :class:`DiversityRatio`, over learned features."""

    which = "learned"
    info = _info("diversity-ratio", "learned", "spread of results over that of real motion", "target", "", 1.0)


def _several_clips(*sets: Windows) -> None:
    if any(len(np.unique(each.clips)) < 2 for each in sets):
        raise NotApplicableError("windows of different clips are compared, and there is only one clip")
