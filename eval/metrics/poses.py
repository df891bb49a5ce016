"""How far apart the poses of two performances are, apart from where, when, how large and which way they face."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from benchmark.motion.clip import MotionClip
from benchmark.motion.dtw import dtw_from_costs
from benchmark.motion.pose import pose_positions
from benchmark.motion.retarget import retarget
from benchmark.motion.skeleton import Skeleton
from eval.metrics.shared import per_clip, stride


def aligned_distance(clip: MotionClip, other: MotionClip) -> float:
    """Mean joint distance along the dynamic time warping path, leg lengths.

    ``mean_{(t,s) in path} mean_j |p_j(t) - p'_j(s)|`` of the core joints, seen from the hips' point on the floor, facing
    forward, in leg lengths (:func:`~benchmark.motion.pose.pose_positions`); the path minimises the same cost. ``other`` is put
    on the skeleton of ``clip`` first, so that proportions do not count.
    """
    ours, theirs, path = aligned_poses(clip, other)
    return float(np.linalg.norm(ours[path[:, 0]] - theirs[path[:, 1]], axis=-1).mean())


def aligned_poses(
    clip: MotionClip, other: MotionClip
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Poses (T, R, 3) of ``clip``, (S, R, 3) of ``other`` on its skeleton, and the path (K, 2) that pairs their rows.

    Rows are :data:`~eval.metrics.shared.STEP` seconds apart, or as near to it as whole frames come.
    """
    ours, theirs = _poses(clip), _poses_on(other, clip.skeleton)
    costs = np.zeros((len(ours), len(theirs)))
    for joint in range(ours.shape[1]):
        one, two = ours[:, joint], theirs[:, joint]
        squared = np.sum(one**2, axis=1)[:, None] + np.sum(two**2, axis=1) - 2.0 * one @ two.T
        costs += np.sqrt(np.maximum(squared, 0.0, out=squared), out=squared)
    return ours, theirs, dtw_from_costs(costs).path


@per_clip
def _poses(clip: MotionClip) -> NDArray[np.float64]:
    return pose_positions(clip)[:: stride(clip.fps)]


def _poses_on(clip: MotionClip, skeleton: Skeleton) -> NDArray[np.float64]:
    """Poses of ``clip`` on ``skeleton``; the last one asked for is kept, since all results of a task are on one skeleton."""
    if clip.skeleton == skeleton:
        return _poses(clip)
    known = _placed.get(clip)
    if known is None or known[0] != skeleton:
        known = (skeleton, _poses(retarget(clip, skeleton)))
        _placed[clip] = known
    return known[1]


_placed: WeakKeyDictionary[MotionClip, tuple[Skeleton, NDArray[np.float64]]] = WeakKeyDictionary()
