"""The body that is drawn: tapered capsules between joints, with radii in shares of the stature, and the same for everybody."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.motion import quat
from benchmark.motion.clip import MotionClip
from benchmark.motion.skeleton import CORE_ROLES, SIDES, Skeleton

Array = NDArray[np.float64]

TRUNK, LEFT, RIGHT = 0, 1, 2

#: Radii at both ends of the limbs' segments, from the body down. These and what follows are shares of :func:`leg_of`.
_ARM = (("shoulder", "elbow", 0.065, 0.048), ("elbow", "wrist", 0.05, 0.036))
_LEG = (("hip", "knee", 0.102, 0.068), ("knee", "ankle", 0.068, 0.043))
_WRIST, _KNUCKLE = 0.036, 0.041
_ANKLE, _HEEL, _BALL, _TOE = 0.044, 0.042, 0.04, 0.03
_PELVIS, _WAIST, _CHEST, _SHOULDER = 0.108, 0.1, 0.112, 0.065
_NECK, _CHIN, _HEAD, _NOSE = 0.058, 0.088, 0.118, 0.024

#: From the middle of the trunk to the axes of its two halves, at the waist and at the chest; from the ankle to the
#: heel below and behind it.
_WAIST_HALF, _CHEST_HALF, _HEEL_REACH = 0.045, 0.075, 0.06

#: Stature, as :func:`stature` has it, in leg lengths.
_STATURE = 1.75

#: Radius of a bone of a skeleton whose joints are not known, in heights of the figure.
_UNKNOWN = 0.02


@dataclass(frozen=True)
class Body:
    """Capsules of a clip in metres.

    Attributes
    ----------
    starts, ends
        (T, K, 3) centres of both ends.
    radii
        (K, 2) radius at both ends.
    sides
        (K,) ``TRUNK``, ``LEFT`` or ``RIGHT``.
    path
        (T, 3) what the camera may follow: the hips.
    sole
        Metres from the centre of a toe to its sole: the ground is drawn this much below y = 0, at which the joints stand.
    """

    starts: Array
    ends: Array
    radii: Array
    sides: NDArray[np.int64]
    path: Array
    sole: float


def make_body(clip: MotionClip, *, scale: float = 1.0) -> Body:
    """The capsules of every frame of a clip, ``scale`` times as large as life (about the origin of the world)."""
    skeleton = clip.skeleton
    known = skeleton.has(*CORE_ROLES)
    parts = _known(clip) if known else _unknown(clip)
    starts = scale * np.stack([part[0] for part in parts], axis=1)
    ends = scale * np.stack([part[1] for part in parts], axis=1)
    radii = scale * np.array([part[2:4] for part in parts])
    sides = np.array([part[4] for part in parts])
    path = scale * clip.positions[:, skeleton.roles.get("hips", 0)]
    return Body(starts, ends, radii, sides, path, scale * _TOE * leg_of(skeleton) if known else float(radii.min()))


def stature(skeleton: Skeleton) -> float:
    """Height along the bones in metres: legs, and the hips to the head; needs the core roles."""
    trunk = skeleton.chain(skeleton.joint("hips"), skeleton.joint("head"))[1:]
    return skeleton.leg_length + float(skeleton.bone_lengths[trunk].sum())


def leg_of(skeleton: Skeleton) -> float:
    """The leg of a figure of this stature and usual proportions, metres.

    Radii are shares of it and not of the skeleton's own legs, because captures place the joint of the hip differently.
    """
    return stature(skeleton) / _STATURE


_Part = tuple[Array, Array, float, float, int]


def _known(clip: MotionClip) -> list[_Part]:
    skeleton, positions = clip.skeleton, clip.positions
    leg = leg_of(skeleton)

    def at(role: str) -> Array:
        return positions[:, skeleton.joint(role)]

    parts: list[_Part] = []

    def add(start: Array, end: Array, first: float, last: float, side: int) -> None:
        parts.append((start, end, first * leg, last * leg, side))

    for side, code in zip(SIDES, (LEFT, RIGHT), strict=True):
        for limb in (_ARM, _LEG):
            for upper, lower, first, last in limb:
                add(at(f"{side}_{upper}"), at(f"{side}_{lower}"), first, last, code)
        wrist = at(f"{side}_wrist")
        if skeleton.has(f"{side}_hand"):
            add(wrist, wrist + 1.35 * (at(f"{side}_hand") - wrist), _WRIST, _KNUCKLE, code)
        knee, ankle = at(f"{side}_knee"), at(f"{side}_ankle")
        if skeleton.has(f"{side}_toe"):
            toe, tip = at(f"{side}_toe"), _tip(clip, f"{side}_toe")
            forward, down = _unit(toe - ankle), _unit(ankle - knee)
            # Square to the foot; shrinks to nothing where the foot points as the shank does and has no below.
            heel = ankle + _HEEL_REACH * leg * (down - (down * forward).sum(axis=-1, keepdims=True) * forward)
            add(ankle, heel, _ANKLE, _HEEL, code)
            add(heel, toe, _HEEL, _TOE if tip is None else _BALL, code)
            if tip is not None:
                add(toe, tip, _BALL, _TOE, code)
    for part in _trunk(clip):
        add(*part, TRUNK)
    return parts


def _trunk(clip: MotionClip) -> list[tuple[Array, Array, float, float]]:
    """Starts, ends and radii (in :func:`leg_of`) of trunk, neck and head. The trunk bends at the middle of the spine."""
    skeleton, positions = clip.skeleton, clip.positions
    leg = leg_of(skeleton)
    hips, hip_l, hip_r, arm_l, arm_r, head = (
        positions[:, skeleton.joint(role)]
        for role in ("hips", "left_hip", "right_hip", "left_shoulder", "right_shoulder", "head")
    )
    pelvis, girdle = 0.5 * (hip_l + hip_r), 0.5 * (arm_l + arm_r)
    top = next(role for role in ("chest", "neck", "head") if skeleton.has(role))
    column = skeleton.chain(skeleton.joint("hips"), skeleton.joint(top))
    spine = positions[:, column[len(column) // 2]] if len(column) > 2 else 0.5 * (hips + girdle)
    chest = 0.75 * girdle + 0.25 * spine
    parts = [
        (0.9 * hip_l + 0.1 * hip_r, 0.9 * hip_r + 0.1 * hip_l, _PELVIS, _PELVIS),
        (arm_l, arm_r, _SHOULDER, _SHOULDER),
        (pelvis, spine, _PELVIS, _WAIST),
        (spine, 0.9 * girdle + 0.1 * spine, _WAIST, _CHEST * 0.9),
    ]
    across_low, across_high = _unit(hip_l - hip_r) * leg, _unit(arm_l - arm_r) * leg
    for sign in (1.0, -1.0):
        low = pelvis + sign * _WAIST_HALF * across_low
        waist = spine + sign * _WAIST_HALF * _unit(across_low + across_high) * leg
        high = chest + sign * _CHEST_HALF * across_high
        parts += [(low, waist, _PELVIS, _WAIST), (waist, high, _WAIST, _CHEST)]
    tip = _tip(clip, "head")
    if tip is None:
        # The head's joint is its centre, as depth cameras have it.
        up = _unit(head - girdle) * leg
        low, high = head - 0.06 * up, head + 0.04 * up
    else:
        up = _unit(tip - head) * leg
        high = tip - _HEAD * up
        low = np.where(_longer(high - head, up, 0.1), high - 0.1 * up, head)
    # Without a nose one cannot tell front from back.
    face = 0.5 * (low + high) + 0.105 * leg * _face(clip, up)
    return [*parts, (girdle, low, _NECK, _NECK), (low, high, _CHIN, _HEAD), (face, face - 0.02 * up, _NOSE, _NOSE)]


def _face(clip: MotionClip, up: Array) -> Array:
    """(T, 3) unit vectors to where the head faces: on average where hips and shoulders do, else turned with its joint.

    The rest pose does not tell: in some files it is no standing figure. ``up`` (T, 3) points along the head.
    """
    positions, skeleton = clip.positions, clip.skeleton
    hip_l, hip_r, arm_l, arm_r = (
        positions[:, joint] for joint in skeleton.joints("left_hip", "right_hip", "left_shoulder", "right_shoulder")
    )
    forward = _unit(np.cross(hip_l - hip_r + arm_l - arm_r, arm_l + arm_r - hip_l - hip_r))
    turn = clip.world[0][:, skeleton.joint("head")]
    forward = quat.rotate(turn, quat.inv_rotate(turn, forward).mean(axis=0))
    up = _unit(up)
    return _unit(forward - (forward * up).sum(axis=-1, keepdims=True) * up)


def _longer(vector: Array, unit: Array, share: float) -> NDArray[np.bool_]:
    return (vector * unit).sum(axis=-1, keepdims=True) > share * (unit * unit).sum(axis=-1, keepdims=True)


def _unit(vector: Array) -> Array:
    return vector / np.maximum(np.linalg.norm(vector, axis=-1, keepdims=True), 1e-9)


def _tip(clip: MotionClip, role: str) -> Array | None:
    """(T, 3) end of the chain below a role's joint: its only child or its end site; ``None`` if there is neither."""
    skeleton = clip.skeleton
    if not skeleton.has(role):
        return None
    joint = skeleton.joint(role)
    ends = [end for end in skeleton.end_sites if end.parent == joint and np.linalg.norm(end.offset) > 1e-6]
    if len(ends) != 1:
        return None
    return clip.positions[:, joint] + quat.rotate(clip.world[0][:, joint], np.array(ends[0].offset))


def _unknown(clip: MotionClip) -> list[_Part]:
    """Every bone as it is: a skeleton whose joints' meaning is not known."""
    skeleton, positions = clip.skeleton, clip.positions
    height = float(np.ptp(positions[0], axis=0).max()) or 1.0
    radius = _UNKNOWN * height
    bones = [j for j in range(1, len(skeleton)) if skeleton.bone_lengths[j] > 1e-6]
    if not bones:
        return [(positions[:, 0], positions[:, 0], radius, radius, TRUNK)]
    return [(positions[:, skeleton.parents[j]], positions[:, j], radius, radius, TRUNK) for j in bones]
