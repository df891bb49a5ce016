"""Stick bodies: which segments a skeleton has, and where they fall on the page."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from benchmark.motion.skeleton import Skeleton
from reports.figures.style import LEFT, RIGHT, TRUNK

if TYPE_CHECKING:
    from matplotlib.axes import Axes


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


def draw_body(
    axes: Axes, skeleton: Skeleton, pose: NDArray[np.float64], *, at: float, turn: float, tilt: float
) -> None:
    """Draw one pose (J, 3), in metres, with its hips above ``at`` on the page: left blue, right orange, far limbs first."""
    from matplotlib.collections import LineCollection

    # The hips are brought to the page's origin, so that how far the figure has walked does not move it up or down.
    page = project(pose - pose[skeleton.roles.get("hips", 0)] * [1.0, 0.0, 1.0], turn=turn, tilt=tilt)
    page[:, 0] += at
    bones = sorted(segments(skeleton), key=lambda bone: page[bone[0], 2] + page[bone[1], 2])
    colours = {"left": LEFT, "right": RIGHT, "trunk": TRUNK}
    lines = [page[[parent, child], :2] for parent, child, _ in bones]
    axes.add_collection(
        LineCollection(lines, colors=[colours[side] for *_, side in bones], linewidths=1.5, capstyle="round")
    )
    if skeleton.has("head"):
        # Heads vary less with age than legs do, but a fixed share of the leg is near enough for a stick body.
        radius = 0.13 * skeleton.leg_length
        axes.add_patch(_circle(page[skeleton.joint("head"), :2], radius))


def _circle(centre: NDArray[np.float64], radius: float):
    from matplotlib.patches import Circle

    return Circle(
        (float(centre[0]), float(centre[1])), radius, facecolor="white", edgecolor=TRUNK, linewidth=1.1, zorder=3
    )
