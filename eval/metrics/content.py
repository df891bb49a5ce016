"""How much of what the source does is still done."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from benchmark.api import Metric, MetricInfo, NotApplicableError, Sample
from benchmark.motion import quat
from benchmark.motion.canonical import heading
from benchmark.motion.clip import MotionClip
from benchmark.motion.dtw import dtw_from_costs
from benchmark.motion.pose import heading_rotations
from benchmark.motion.retarget import retarget
from benchmark.motion.skeleton import Skeleton
from eval.metrics.poses import aligned_distance
from eval.metrics.shared import per_clip, stride

_PHASES = 101

#: Standard deviation in seconds of the smoothing of headings: shorter than a turn, longer than the jitter of a sensor.
_HEADING_SIGMA = 0.1


def compared_joints(skeleton: Skeleton) -> list[int]:
    """Joints with a role whose rotation moves something: a child joint, or a tip at a distance."""
    moving = {int(parent) for parent in skeleton.parents[1:]}
    moving |= {end.parent for end in skeleton.end_sites if np.linalg.norm(end.offset) > 0.0}
    return sorted(moving & set(skeleton.roles.values()))


def facing_rotations(clip: MotionClip, joints: list[int]) -> NDArray[np.float64]:
    """(T, K, 4) local rotations of ``joints``, the root's without the heading, one frame in each fixed time step."""
    rotations = np.array(clip.rotations)
    rotations[:, 0] = quat.inv_mul(heading_rotations(clip), rotations[:, 0])
    return rotations[:: stride(clip.fps), joints]


def aligned_angle(clip: MotionClip, source: MotionClip) -> float:
    """Mean geodesic joint angle along the dynamic time warping path in degrees; ``source`` is put on the clip's skeleton."""
    ours, theirs = _compared_rotations(clip, source)
    costs = np.zeros((len(ours), len(theirs)))
    for joint in range(ours.shape[1]):
        dots = np.abs(ours[:, joint] @ theirs[:, joint].T)
        costs += np.arccos(np.minimum(dots, 1.0, out=dots), out=dots)
    path = dtw_from_costs(costs).path
    return float(np.degrees(quat.angle(ours[path[:, 0]], theirs[path[:, 1]]).mean()))


def _compared_rotations(clip: MotionClip, source: MotionClip) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(T, K, 4) and (S, K, 4) rotations of both on the skeleton of ``clip``, without heading."""
    return _facing(clip), _facing(_on(source, clip.skeleton))


@per_clip
def _facing(clip: MotionClip) -> NDArray[np.float64]:
    return facing_rotations(clip, compared_joints(clip.skeleton))


def _on(clip: MotionClip, skeleton: Skeleton) -> MotionClip:
    """``clip`` on ``skeleton``; the last one asked for is kept, since all results of a task are on one skeleton."""
    if clip.skeleton == skeleton:
        return clip
    known = _placed.get(clip)
    if known is None or known.skeleton != skeleton:
        known = _placed[clip] = retarget(clip, skeleton, ground=False)
    return known


_placed: WeakKeyDictionary[MotionClip, MotionClip] = WeakKeyDictionary()


class PoseDistance(Metric):
    """Mean geodesic joint angle between result and source along the dynamic time warping path, degrees.

    ``mean_{(t,s) in path} mean_j theta(q_j(t), q'_j(s))`` with ``theta = 2 atan2(|v|, |w|)`` of ``q^-1 q'``; the path
    minimises the same cost. The source is put on the result's skeleton first, so joint axes agree, and the root is compared
    without its heading. 0 for the source itself. It is a cost to weigh against style, not a goal: a real child's own
    performance is at some distance, and is shown beside.
    """

    info = MetricInfo(
        name="content/pose-distance",
        summary="mean joint angle to the source after time alignment",
        unit="deg",
        direction="lower",
        code_deps=(
            "benchmark.motion.dtw",
            "benchmark.motion.retarget",
            "benchmark.motion.pose",
            "benchmark.motion.canonical",
            "eval.metrics.shared",
        ),
    )

    def compute(self, sample: Sample) -> float:
        """The distance in degrees."""
        return aligned_angle(sample.clip, sample.source)


class PhasePoseDistance(Metric):
    """Mean geodesic joint angle between result and source at the same phase, degrees.

    Both clips are laid over the phase [0, 1] and compared at 101 phases, with no other alignment: unlike
    :class:`PoseDistance` it sees that a limb comes late, and a change of timing within the clip; an even change of tempo it
    does not. Rotations as there.
    """

    info = MetricInfo(
        name="content/phase-pose-distance",
        summary="mean joint angle to the source at the same phase of the clip",
        unit="deg",
        direction="lower",
        code_deps=(
            "benchmark.motion.retarget",
            "benchmark.motion.pose",
            "benchmark.motion.canonical",
            "eval.metrics.shared",
        ),
    )

    def compute(self, sample: Sample) -> float:
        """The distance in degrees."""
        ours, theirs = (_at_phases(part) for part in _compared_rotations(sample.clip, sample.source))
        return float(np.degrees(quat.angle(ours, theirs).mean()))


class PositionDistance(Metric):
    """Mean joint distance between result and source along the dynamic time warping path, leg lengths.

    The content consistency of Kim et al. 2024 (mean joint distance to the content clip), with three changes: poses are seen
    from the hips' point on the floor and facing forward, so place and facing do not count (the path over the floor is
    :class:`TrajectoryDeviation`'s); in leg lengths on one skeleton, so size and proportions do not; and paired by time
    warping, so a change of timing does not. See :func:`eval.metrics.poses.aligned_distance`.
    """

    info = MetricInfo(
        name="content/position-distance",
        summary="mean joint distance to the source after time alignment",
        unit="leg",
        direction="lower",
        citation="content consistency as in Kim et al. 2024 (MoST)",
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
        return aligned_distance(sample.clip, sample.source)


class HeadingDeviation(Metric):
    """Mean angle between the heading of result and source at corresponding times, degrees.

    Heading is where hips and shoulders face (:func:`benchmark.motion.canonical.heading`), smoothed over 0.1 s. The circular
    mean of the differences is taken off first, so the facing of the first frame does not count. Frames correspond as in
    :class:`TrajectoryDeviation`.
    """

    info = MetricInfo(
        name="content/heading-deviation",
        summary="mean deviation of the heading from the source's",
        unit="deg",
        direction="lower",
        code_deps=("benchmark.motion.canonical",),
    )

    def compute(self, sample: Sample) -> float:
        """The deviation in degrees."""
        ours, theirs = (heading(clip, sigma=_HEADING_SIGMA)[:, None] for clip in (sample.clip, sample.source))
        ours, theirs = _paired(ours, theirs, sample)
        gap = np.exp(1j * (ours - theirs)[:, 0])
        return float(np.degrees(np.abs(np.angle(gap * np.conj(gap.mean()))).mean()))


class RoundTripError(Metric):
    """Mean geodesic joint angle between the source and the result translated back to its style, degrees.

    What an unpaired method that learns both ways is trained to keep small (cycle consistency, Zhu et al. 2017). Angles and
    time alignment as in :class:`PoseDistance`, on the source's skeleton. Alone it says little: the identity is at 0.
    """

    info = MetricInfo(
        name="content/round-trip-error",
        summary="mean joint angle to the source after translation there and back",
        unit="deg",
        direction="lower",
        citation="Zhu et al. 2017 (cycle consistency)",
        code_deps=(
            "benchmark.motion.dtw",
            "benchmark.motion.retarget",
            "benchmark.motion.pose",
            "benchmark.motion.canonical",
            "eval.metrics.shared",
        ),
    )

    def compute(self, sample: Sample) -> float:
        """The error in degrees; not applicable to methods that translate one way only."""
        if sample.round_trip is None:
            raise NotApplicableError("the method does not translate back")
        return aligned_angle(_on(sample.round_trip, sample.source.skeleton), sample.source)


class TrajectoryDeviation(Metric):
    """Mean distance between the hips' path over the floor and the source's, each in its own leg lengths.

    Both paths start at the origin, and the result's is turned about it to fit best (so the facing of the first frame does
    not count). Points are paired by the result's time map where it has one, frame by frame where both have as many frames,
    and by phase in [0, 1] otherwise. 0 for a copy, and for a figure that is exactly scaled.
    """

    info = MetricInfo(
        name="content/trajectory-deviation",
        summary="mean deviation of the path over the floor from the source's",
        unit="leg",
        direction="lower",
        citation="trajectory similarity as in Zhong et al. 2024, in leg lengths",
    )

    def compute(self, sample: Sample) -> float:
        """The deviation in leg lengths."""
        ours, theirs = _paired(_floor_path(sample.clip), _floor_path(sample.source), sample)
        ours, theirs = ours - ours[0], theirs - theirs[0]
        # The rotation by angle a that minimises the squared distance has tan a = cross / dot.
        cross = np.sum(ours[:, 0] * theirs[:, 1] - ours[:, 1] * theirs[:, 0])
        dot = np.sum(ours * theirs)
        angle = np.arctan2(cross, dot)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        return float(np.linalg.norm(ours @ turn.T - theirs, axis=-1).mean())


def _floor_path(clip: MotionClip) -> NDArray[np.float64]:
    """(T, 2) hips over the floor, leg lengths."""
    return clip.positions[:, clip.skeleton.joint("hips")][:, [0, 2]] / clip.skeleton.leg_length


def _paired(
    ours: NDArray[np.float64], theirs: NDArray[np.float64], sample: Sample
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Values (T, d) of the result and (S, d) of the source at corresponding times.

    By the result's time map where it has one, frame by frame where both have as many frames, and by phase otherwise.
    """
    if sample.time_map is not None:
        if len(sample.time_map) != len(ours):
            raise NotApplicableError("the time map has another number of frames than the result")
        return ours, _sampled(theirs, sample.time_map * sample.source.fps)
    if len(ours) == len(theirs):
        return ours, theirs
    return (
        _sampled(ours, np.linspace(0.0, len(ours) - 1, _PHASES)),
        _sampled(theirs, np.linspace(0.0, len(theirs) - 1, _PHASES)),
    )


def _sampled(path: NDArray[np.float64], at: NDArray[np.float64]) -> NDArray[np.float64]:
    """``path`` at fractional frames ``at``, linearly between frames."""
    frames = np.arange(len(path))
    return np.stack([np.interp(at, frames, column) for column in path.T], axis=-1)


def _at_phases(rotations: NDArray[np.float64]) -> NDArray[np.float64]:
    """(101, K, 4) rotations at evenly spaced phases of the clip."""
    at = np.linspace(0.0, len(rotations) - 1, _PHASES)
    low = np.minimum(at.astype(np.int64), max(len(rotations) - 2, 0))
    high = np.minimum(low + 1, len(rotations) - 1)
    return quat.slerp(rotations[low], rotations[high], (at - low)[:, None])
