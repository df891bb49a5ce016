"""Distances of simple style statistics to real target motion of the same action."""

from __future__ import annotations

import numpy as np

from benchmark.api import Metric, MetricInfo, NotApplicableError, Sample
from benchmark.motion.clip import MotionClip
from benchmark.motion.pose import SEGMENTS, segment_directions
from benchmark.motion.skeleton import CORE_ROLES, SIDES
from eval.metrics.poses import aligned_distance
from eval.metrics.shared import difference, over_references, per_clip, references, speed_unit, stride

#: Dimensionless mean speed, and mean range of motion in degrees, below which a clip is no measure of anything.
_STILL, _RIGID = 1e-3, 1.0

_HINGES = (("shoulder", "elbow"), ("hip", "knee"))

#: What is measured: the swing of trunk, upper arms and thighs, and the bending of elbows and knees.
_SWINGS = {"hips": "trunk", **{f"{side}_{part}": f"{side}_{part}" for side in SIDES for part in ("shoulder", "hip")}}
_BENDS = {f"{side}_{joint}": (f"{side}_{above}", f"{side}_{joint}") for side in SIDES for above, joint in _HINGES}


@per_clip
def mean_speed(clip: MotionClip) -> float:
    """Mean speed of the core joints over ``sqrt(g leg)``; a figure that is dynamically scaled keeps it."""
    if len(clip) <= stride(clip.fps):
        raise NotApplicableError(f"{len(clip)} frames are too few for a speed")
    joints = clip.skeleton.joints(*(role for role in CORE_ROLES if clip.skeleton.has(role)))
    speeds = np.linalg.norm(difference(clip.positions[:, joints], clip.fps), axis=-1)
    return float(speeds.mean() / speed_unit(clip))


@per_clip
def ranges_of_motion(clip: MotionClip) -> dict[str, float]:
    """Angular range of each joint in degrees.

    Shoulders, hips and the trunk: the largest angle between two directions of the limb (trunk), seen facing forward.
    Elbows and knees: the difference between the largest and the smallest angle between the limb's two halves. Directions,
    not joint rotations, are measured: position captures leave the twist of a limb open, and what a fit makes of it is not
    the performer's.
    """
    directions = segment_directions(clip)[:: stride(clip.fps)]
    by_start = {start: directions[:, index] for index, (start, _) in enumerate(SEGMENTS)}
    ranges = {}
    for start, name in _SWINGS.items():
        ranges[name] = float(np.degrees(np.arccos(np.clip((by_start[start] @ by_start[start].T).min(), -1.0, 1.0))))
    for name, (upper, lower) in _BENDS.items():
        bend = np.arccos(np.clip(np.sum(by_start[upper] * by_start[lower], axis=-1), -1.0, 1.0))
        ranges[name] = float(np.degrees(np.ptp(bend)))
    return ranges


class SpeedDifference(Metric):
    """Absolute difference of mean joint speed, over ``sqrt(g leg)``, to the median of real target clips of the same action.

    The mean is over frames and core joints in the world, travel included. Dividing by ``sqrt(g leg)`` takes size out: a small
    body is not credited for being small.
    """

    info = MetricInfo(
        name="style/speed-difference",
        summary="difference of mean dimensionless joint speed to real target motion",
        unit="1",
        direction="lower",
        needs="reference",
        code_deps=("eval.metrics.shared",),
    )

    def compute(self, sample: Sample) -> float:
        """The difference, dimensionless."""
        return abs(mean_speed(sample.clip) - over_references(sample, mean_speed))


class RangeOfMotionDifference(Metric):
    """Mean over joints of the absolute difference of range of motion to real target clips of the same action, degrees.

    See :func:`ranges_of_motion`; each joint is compared with the median over the references.
    """

    info = MetricInfo(
        name="style/range-of-motion-difference",
        summary="mean difference of joint ranges of motion to real target motion",
        unit="deg",
        direction="lower",
        needs="reference",
        code_deps=("benchmark.motion.pose", "benchmark.motion.canonical", "eval.metrics.shared"),
    )

    def compute(self, sample: Sample) -> float:
        """The difference in degrees."""
        ours = ranges_of_motion(sample.clip)
        theirs = [ranges_of_motion(clip) for clip in references(sample)]
        return float(np.mean([abs(ours[name] - np.median([each[name] for each in theirs])) for name in ours]))


class SpeedRatio(Metric):
    """Mean joint speed over ``sqrt(g leg)``, divided by the median of real target clips of the same action.

    Unlike the absolute difference it keeps the sign, so that over many clips the differences between individual performers
    cancel and what is left is the difference between the styles.
    """

    info = MetricInfo(
        name="style/speed-ratio",
        summary="mean dimensionless joint speed over that of real target motion",
        unit="1",
        direction="target",
        target=1.0,
        needs="reference",
        code_deps=("eval.metrics.poses", "eval.metrics.shared"),
    )

    def compute(self, sample: Sample) -> float:
        """The ratio; not applicable where the real clips stand still."""
        theirs = over_references(sample, mean_speed)
        if theirs < _STILL:
            raise NotApplicableError("the real target clips of this action hardly move")
        return mean_speed(sample.clip) / theirs


class RangeOfMotionRatio(Metric):
    """Mean range of motion over the joints, divided by the median of real target clips of the same action.

    See :func:`ranges_of_motion`; keeps the sign, as :class:`SpeedRatio` does.
    """

    info = MetricInfo(
        name="style/range-of-motion-ratio",
        summary="mean joint range of motion over that of real target motion",
        unit="1",
        direction="target",
        target=1.0,
        needs="reference",
        code_deps=("benchmark.motion.pose", "benchmark.motion.canonical", "eval.metrics.poses", "eval.metrics.shared"),
    )

    def compute(self, sample: Sample) -> float:
        """The ratio; not applicable where the real clips stand still."""
        theirs = over_references(sample, _mean_range)
        if theirs < _RIGID:
            raise NotApplicableError("the real target clips of this action hardly bend a joint")
        return _mean_range(sample.clip) / theirs


class ReferenceDistance(Metric):
    """Median over real target clips of the same action of the mean joint distance after time alignment, leg lengths.

    See :func:`eval.metrics.poses.aligned_distance`. Real performers differ from one another, so it is not 0 even for a real
    one: read it beside the row of real performers. It is least for motion in the middle of all performers and grows with
    everything individual, style included: a large value with the right range and speed is a lively child, not a failure.
    """

    info = MetricInfo(
        name="style/pose-distance",
        summary="mean joint distance to real target motion of the same action after time alignment",
        unit="leg",
        direction="lower",
        needs="reference",
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
        """The distance in leg lengths."""
        return float(np.median([aligned_distance(sample.clip, clip) for clip in references(sample)]))


def _mean_range(clip: MotionClip) -> float:
    return float(np.mean(list(ranges_of_motion(clip).values())))
