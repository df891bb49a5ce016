"""A clip as the three channels per joint that the models see, and back.

Joint positions seen from the hips, facing forward ("local coordinates" of the poster): either each bone's vector from its
parent joint, or each joint's position relative to the hips. The hips themselves contribute their height above the floor.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmark.motion import quat
from benchmark.motion.canonical import HEADING_SIGMA, foot_points, heading
from benchmark.motion.clip import MotionClip
from benchmark.motion.ik import aim_bones

Array = NDArray[np.float64]

COORDINATES = ("parent", "hips")
FLOORS = ("follow", "clip")

#: Leg lengths above its median height within which the lowest foot stands, and seconds over which the floor is followed: quick
#: enough for a crouch, too slow for a sensor's glitch at one foot to shake the body.
STANCE_BAND, FLOOR_SIGMA = 0.05, 0.15


def channels(clip: MotionClip, *, coordinates: str = "parent", unit: float = 1.0) -> Array:
    """What the models see of a clip.

    Parameters
    ----------
    clip
        T frames with the hips as joint 0 and the floor at ``y = 0``.
    coordinates
        ``parent``: the vector from each joint's parent to it; ``hips``: its position relative to the hips. Both with the
        facing direction, smoothed over :data:`~benchmark.motion.canonical.HEADING_SIGMA`, taken out.
    unit
        Metres that count as one: the leg length, or 1.

    Returns
    -------
    (T, J, 3). Row 0 of the joints is ``(0, height of the hips, 0)``.
    """
    world = clip.positions
    if coordinates == "parent":
        parents = np.maximum(clip.skeleton.parents, 0)
        spans = world - world[:, parents]
    else:
        spans = world - world[:, :1]
    local = quat.rotate_y(-heading(clip, sigma=HEADING_SIGMA), spans)
    local[:, 0] = 0.0
    local[:, 0, 1] = world[:, 0, 1]
    return local / unit


def pose(
    clip: MotionClip,
    values: Array,
    *,
    coordinates: str = "parent",
    unit: float = 1.0,
    floor: str = "follow",
    yaw: Array | None = None,
) -> MotionClip:
    """The clip whose bones point as ``values`` say; inverse of :func:`channels` up to bone lengths.

    Place and facing on the floor are those of ``clip``, and so is what positions leave open: twists and end joints. The hips'
    height is the one in ``values``, corrected so that the feet meet the floor where those of ``clip`` do: errors of all joints
    of a leg end at the foot, and a child that hovers is no style.

    Parameters
    ----------
    clip
        T frames on the skeleton of the result.
    values
        (T, J, 3) as from :func:`channels`.
    coordinates, unit
        As in :func:`channels`.
    floor
        ``clip``: one constant shift for the whole clip; ``follow``: in addition a slowly varying one, read off the frames in
        which a foot of ``clip`` stands and carried over those in which none does, so that a flight keeps its height.
    yaw
        (T,) the smoothed facing direction of ``clip`` in radians, where it is known already.
    """
    skeleton = clip.skeleton
    if coordinates == "parent":
        positions = np.zeros_like(values)
        for joint in range(1, len(skeleton)):
            positions[:, joint] = positions[:, int(skeleton.parents[joint])] + values[:, joint]
    else:
        positions = values.copy()
        positions[:, 0] = 0.0
    facing = heading(clip, sigma=HEADING_SIGMA) if yaw is None else yaw
    rotations = aim_bones(skeleton, clip.rotations, quat.rotate_y(facing, positions))
    root = clip.root.copy()
    root[:, 1] = values[:, 0, 1] * unit
    posed = clip.replace(rotations=rotations, root=root, translations=None, residual=None, source=None)
    was, now = _lowest_foot(clip), _lowest_foot(posed)
    # More than half the frames of a clip stand on some foot, and a depth camera loses feet downwards too: no lowest quantile.
    standing = was <= np.median(was) + STANCE_BAND * skeleton.leg_length
    shift = np.full(len(clip), np.median((was - now)[standing]))
    if floor == "follow":
        shift = _carried(was - now, standing, FLOOR_SIGMA * clip.fps)
    return posed.with_root(root + shift[:, None] * [0.0, 1.0, 0.0])


def _lowest_foot(clip: MotionClip) -> Array:
    """(T,) height in metres of the lowest point of both feet."""
    return foot_points(clip)[..., 1].min(axis=1)


def _carried(values: Array, known: NDArray[np.bool_], sigma: float) -> Array:
    """``values`` (T,) where ``known``, smoothed by a Gaussian of ``sigma`` frames and carried over the frames between."""
    from scipy.ndimage import gaussian_filter1d

    frames = np.arange(len(values))
    filled = np.interp(frames, frames[known], values[known])
    return gaussian_filter1d(filled, sigma, mode="nearest")
