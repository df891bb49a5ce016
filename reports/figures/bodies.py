"""Stick bodies: which segments a skeleton has, and where they fall on the page."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmark.motion.skeleton import Skeleton


def segments(skeleton: Skeleton) -> list[tuple[int, int, str]]:
    """Parent joint, child joint and side (``left``, ``right`` or ``trunk``) of every bone.

    A bone takes the side of the nearest role at or below its child, else the one above it.
    """
    side_of = ["trunk"] * len(skeleton)
    named = {joint: role for role, joint in skeleton.roles.items()}
    for joint in range(len(skeleton)):
        role = named.get(joint, "")
        if role.startswith(("left_", "right_")):
            side_of[joint] = role.split("_")[0]
        elif joint and side_of[skeleton.parents[joint]] != "trunk":
            side_of[joint] = side_of[skeleton.parents[joint]]
    return [(int(skeleton.parents[j]), j, side_of[j]) for j in range(1, len(skeleton))]


def project(points: NDArray[np.float64], *, turn: float, tilt: float) -> NDArray[np.float64]:
    """Points (..., 3) seen from ``turn`` radians to the figure's left of its front and ``tilt`` above: page x, y and depth."""
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    across = np.cos(turn) * x - np.sin(turn) * z
    away = np.sin(turn) * x + np.cos(turn) * z
    return np.stack([across, np.cos(tilt) * y - np.sin(tilt) * away, np.sin(tilt) * y + np.cos(tilt) * away], axis=-1)
