"""Which training clips lend their style: those of the target style and the same action that are nearest in content."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from benchmark.motion.clip import MotionClip

Array = NDArray[np.float64]

#: Frames per second at which contents are compared.
COMPARED_FPS = 10.0


def content(clip: MotionClip) -> Array:
    """(N, 3 S + 1) directions of trunk and limbs and the hips' height, ten times a second: no size, place or facing."""
    from benchmark.motion.pose import segment_directions

    skeleton = clip.skeleton
    every = max(1, round(clip.fps / COMPARED_FPS))
    height = clip.positions[:, skeleton.joint("hips"), 1:2] / skeleton.leg_length
    return np.concatenate([segment_directions(clip).reshape(len(clip), -1), height], axis=1)[::every]


def nearest(query: Array, candidates: Sequence[Array], count: int) -> list[tuple[int, float]]:
    """The ``count`` candidates with the lowest mean cost of a dynamic time warp to ``query``, nearest first; ties by order."""
    from benchmark.motion.dtw import dtw

    costs = [dtw(query, candidate).mean_cost for candidate in candidates]
    order = np.argsort(costs, kind="stable")[:count]
    return [(int(index), float(costs[index])) for index in order]
