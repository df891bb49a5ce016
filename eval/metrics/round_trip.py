"""What is left of a clip that a method took to the target style and back."""

from __future__ import annotations

from benchmark.api import Metric, MetricInfo, NotApplicableError, Sample
from eval.metrics.smoothness import mean_jerk

#: Jerk in leg/s^3 below which the source stands still.
_STILL = 1e-6


class RoundTripJerkRatio(Metric):
    """Mean jerk of the clip taken to the target style and back, over that of the source; best at 1.

    See :func:`eval.metrics.smoothness.mean_jerk`. The 2020 paper (section 5.5) finds its double translations a bit jittery:
    above 1.
    """

    info = MetricInfo(
        name="content/round-trip-jerk-ratio",
        summary="mean jerk of the clip taken there and back over that of the source",
        unit="1",
        direction="target",
        target=1.0,
        citation="Dong, Aristidou, Shamir, Mahler & Jain 2020",
        code_deps=("eval.metrics.shared",),
    )

    def compute(self, sample: Sample) -> float:
        """The ratio; not applicable where the method has no way back or the source stands still."""
        if sample.round_trip is None:
            raise NotApplicableError("the method did not translate the result back")
        source = mean_jerk(sample.source)
        if source <= _STILL:
            raise NotApplicableError("the source does not move")
        return mean_jerk(sample.round_trip) / source
