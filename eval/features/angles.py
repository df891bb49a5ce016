"""Joint angles that mean the same on every skeleton, whatever its joint axes and rest pose."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmark.motion.clip import MotionClip
from benchmark.motion.pose import SEGMENTS
from benchmark.motion.skeleton import SIDES
from eval.features.sequence import RATE, pose_sequence

Array = NDArray[np.float64]

_INDEX = {start: index for index, (start, _) in enumerate(SEGMENTS)}
_AXES = ("outwards", "up", "forward")

#: The angles of :func:`joint_angles`, in order; each of a left and a right joint.
ANGLE_NAMES: tuple[str, ...] = (
    *(f"{joint}-to-{axis}" for joint in ("shoulder", "hip") for axis in _AXES),
    "elbow-bend",
    "knee-bend",
    "knee-forward",
    "trunk-twist",
)


def joint_angles(clip: MotionClip) -> Array:
    """Angles of limbs against the trunk and of limbs' halves against each other, at 30 frames a second.

    They are taken from joint positions: the twist of a limb about itself, which position captures do not hold, is left out.

    - ``shoulder-to-…``, ``hip-to-…``: angle of upper arm or thigh to three axes of the trunk: outwards on its own side, up
      along hips to head, and forward. The outward axis is the line across shoulders or hips, made square with the trunk.
    - ``elbow-bend``, ``knee-bend``: angle between the halves of the limb, 0 when straight.
    - ``knee-forward``: angle by which the shank is bent forward of the thigh, about the line across the hips; a knee bends
      backward, so it is negative but for a slight overextension.
    - ``trunk-twist``: angle from the line across the hips to that across the shoulders, about the trunk; to the own side is
      positive.

    Parameters
    ----------
    clip
        A clip on a skeleton with the core roles.

    Returns
    -------
    angles
        (T, 2, A) radians, left then right, in the order of :data:`ANGLE_NAMES`. A right angle is mirrored: a figure and its
        mirror image have the same angles with the sides exchanged.
    """
    sequence = pose_sequence(clip, RATE)
    segments = len(SEGMENTS)
    directions = sequence[:, : 3 * segments].reshape(-1, segments, 3)
    lines = sequence[:, 3 * segments : 3 * segments + 6].reshape(-1, 2, 3)
    up = directions[:, _INDEX["hips"]]
    left = {joint: _square(lines[:, index], up) for index, joint in enumerate(("hip", "shoulder"))}
    sides = []
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        upper = {joint: directions[:, _INDEX[f"{side}_{joint}"]] for joint in ("shoulder", "hip")}
        lower = {joint: directions[:, _INDEX[f"{side}_{joint}"]] for joint in ("elbow", "knee")}
        columns = []
        for joint in ("shoulder", "hip"):
            forward = np.cross(left[joint], up)
            columns += [_angle(upper[joint], axis) for axis in (sign * left[joint], up, forward)]
        columns += [_angle(upper["shoulder"], lower["elbow"]), _angle(upper["hip"], lower["knee"])]
        ahead = _unit(np.cross(upper["hip"], left["hip"]))
        columns.append(np.arcsin(np.clip(_dot(lower["knee"], ahead), -1.0, 1.0)))
        turned = np.arctan2(_dot(np.cross(left["hip"], left["shoulder"]), up), _dot(left["hip"], left["shoulder"]))
        columns.append(sign * turned)
        sides.append(np.stack(columns, axis=-1))
    return np.stack(sides, axis=1)


def _dot(a: Array, b: Array) -> Array:
    return np.einsum("ti,ti->t", a, b)


def _unit(vectors: Array) -> Array:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9)


def _square(line: Array, up: Array) -> Array:
    """(T, 3) the part of ``line`` that is square to ``up``, of length 1."""
    return _unit(line - _dot(line, up)[:, None] * up)


def _angle(a: Array, b: Array) -> Array:
    return 2.0 * np.arctan2(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1))
