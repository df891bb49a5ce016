"""Poses without place, facing and size: what is compared when two figures are to be compared."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from benchmark.motion import quat
from benchmark.motion.canonical import heading
from benchmark.motion.clip import MotionClip
from benchmark.motion.skeleton import CORE_ROLES, SIDES

_UP = np.array([0.0, 1.0, 0.0])

#: Limbs and trunk as pairs of core roles, from the joint nearer the hips to the one further out.
SEGMENTS: tuple[tuple[str, str], ...] = (
    ("hips", "head"),
    *(
        (f"{side}_{start}", f"{side}_{end}")
        for side in SIDES
        for start, end in (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"))
    ),
)


def heading_rotations(clip: MotionClip) -> NDArray[np.float64]:
    """(T, 4) rotations about the vertical that turn +Z to where the figure faces."""
    return quat.from_axis_angle(_UP, heading(clip))


def pose_positions(clip: MotionClip, roles: Sequence[str] = CORE_ROLES) -> NDArray[np.float64]:
    """Joint positions seen from the hips' point on the floor, facing forward, in leg lengths.

    The same whatever the figure's place, facing and size; heights above the floor are kept.

    Parameters
    ----------
    clip
        T frames with the floor at ``y = 0``.
    roles
        R joint roles; a :class:`~benchmark.errors.SkeletonError` names one that the skeleton lacks.

    Returns
    -------
    positions
        (T, R, 3), leg lengths.
    """
    world = clip.positions
    hips = world[:, clip.skeleton.joint("hips")]
    centred = world[:, clip.skeleton.joints(*roles)] - (hips * [1.0, 0.0, 1.0])[:, None]
    return quat.rotate_y(-heading(clip), centred) / clip.skeleton.leg_length


def segment_directions(clip: MotionClip) -> NDArray[np.float64]:
    """Directions of trunk and limbs, facing forward: the pose without the body's proportions.

    Parameters
    ----------
    clip
        T frames of a skeleton with the core roles.

    Returns
    -------
    directions
        (T, S, 3) unit vectors in the order of :data:`SEGMENTS`; zero where two joints coincide.
    """
    joint = clip.skeleton.joint
    starts, ends = ([joint(pair[i]) for pair in SEGMENTS] for i in range(2))
    spans = clip.positions[:, ends] - clip.positions[:, starts]
    lengths = np.linalg.norm(spans, axis=-1, keepdims=True)
    return quat.rotate_y(-heading(clip), spans / np.maximum(lengths, 1e-9))
