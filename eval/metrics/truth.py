"""Distance to the true target performance of the same content, which only synthetic data has."""

from __future__ import annotations

from benchmark.api import Metric, MetricInfo, NotApplicableError, Sample
from eval.metrics.poses import aligned_distance


class TruthPoseDistance(Metric):
    """Mean joint distance to the true performance along the dynamic time warping path, leg lengths.

    See :func:`eval.metrics.poses.aligned_distance`. The truth is put on the result's skeleton first: a perfect transfer is at
    0, whatever body it was shown on.
    """

    info = MetricInfo(
        name="truth/pose-distance",
        summary="mean joint distance to the true target performance after time alignment",
        unit="leg",
        direction="lower",
        needs="truth",
        code_deps=(
            "benchmark.motion.dtw",
            "benchmark.motion.pose",
            "benchmark.motion.canonical",
            "benchmark.motion.retarget",
            "eval.metrics.poses",
            "eval.metrics.shared",
        ),
    )

    def compute(self, sample: Sample) -> float:
        """The distance in leg lengths; not applicable where the truth is not known."""
        if sample.truth is None:
            raise NotApplicableError("this data set has no truth: no true target performance of the same content")
        return aligned_distance(sample.clip, sample.truth)
