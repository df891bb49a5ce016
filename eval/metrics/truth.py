"""Distance to the true target performance of the same content, which only synthetic data has."""

from __future__ import annotations

import numpy as np

from benchmark.api import Metric, MetricInfo, NotApplicableError, Sample
from benchmark.motion.dtw import dtw_from_costs
from benchmark.motion.pose import pose_positions
from benchmark.motion.retarget import retarget
from eval.metrics.shared import stride


class TruthPoseDistance(Metric):
    """Mean joint distance to the true performance along the dynamic time warping path, leg lengths.

    ``mean_{(t,s) in path} mean_j |p_j(t) - p'_j(s)|`` of the core joints, seen from the hips' point on the floor, facing
    forward, in leg lengths (:func:`~benchmark.motion.pose.pose_positions`); the path minimises the same cost. The truth is
    put on the result's skeleton first: a perfect transfer is at 0, whatever body it was shown on.
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
            "eval.metrics.shared",
        ),
    )

    def compute(self, sample: Sample) -> float:
        """The distance in leg lengths; not applicable where the truth is not known."""
        if sample.truth is None:
            raise NotApplicableError("this data set has no truth: no true target performance of the same content")
        truth = sample.truth
        if truth.skeleton != sample.clip.skeleton:
            truth = retarget(truth, sample.clip.skeleton)
        ours = pose_positions(sample.clip)[:: stride(sample.clip.fps)]
        theirs = pose_positions(truth)[:: stride(truth.fps)]
        costs = np.zeros((len(ours), len(theirs)))
        for joint in range(ours.shape[1]):
            one, other = ours[:, joint], theirs[:, joint]
            squared = np.sum(one**2, axis=1)[:, None] + np.sum(other**2, axis=1) - 2.0 * one @ other.T
            costs += np.sqrt(np.maximum(squared, 0.0, out=squared), out=squared)
        path = dtw_from_costs(costs).path
        return float(np.linalg.norm(ours[path[:, 0]] - theirs[path[:, 1]], axis=-1).mean())
