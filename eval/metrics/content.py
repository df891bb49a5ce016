"""How much of what the source does is still done."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmark.api import Metric, MetricInfo, NotApplicableError, Sample
from benchmark.motion import quat
from benchmark.motion.clip import MotionClip
from benchmark.motion.dtw import dtw_from_costs
from benchmark.motion.pose import heading_rotations
from benchmark.motion.retarget import retarget
from benchmark.motion.skeleton import Skeleton
from eval.metrics.shared import stride

_PHASES = 101


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
        clip, source = sample.clip, sample.source
        if clip.skeleton != source.skeleton:
            source = retarget(source, clip.skeleton, ground=False)
        joints = compared_joints(clip.skeleton)
        ours, theirs = facing_rotations(clip, joints), facing_rotations(source, joints)
        costs = np.zeros((len(ours), len(theirs)))
        for joint in range(len(joints)):
            dots = np.abs(ours[:, joint] @ theirs[:, joint].T)
            costs += np.arccos(np.minimum(dots, 1.0, out=dots), out=dots)
        path = dtw_from_costs(costs).path
        return float(np.degrees(quat.angle(ours[path[:, 0]], theirs[path[:, 1]]).mean()))


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
        ours, theirs = _floor_path(sample.clip), _floor_path(sample.source)
        if sample.time_map is not None:
            if len(sample.time_map) != len(ours):
                raise NotApplicableError("the time map has another number of frames than the result")
            theirs = _sampled(theirs, sample.time_map * sample.source.fps)
        elif len(ours) != len(theirs):
            ours = _sampled(ours, np.linspace(0.0, len(ours) - 1, _PHASES))
            theirs = _sampled(theirs, np.linspace(0.0, len(theirs) - 1, _PHASES))
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


def _sampled(path: NDArray[np.float64], at: NDArray[np.float64]) -> NDArray[np.float64]:
    """``path`` at fractional frames ``at``, linearly between frames."""
    frames = np.arange(len(path))
    return np.stack([np.interp(at, frames, path[:, axis]) for axis in range(2)], axis=-1)
