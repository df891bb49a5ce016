"""Foot skate removed: planted feet are held still and the legs follow by two-bone inverse kinematics."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmark.errors import ContractError
from benchmark.motion import quat
from benchmark.motion.clip import MotionClip
from benchmark.motion.contacts import Contacts, detect, runs
from benchmark.motion.skeleton import SIDES

Array = NDArray[np.float64]

#: Seconds over which a correction fades in before and out after a contact.
BLEND = 0.15

#: A leg is stretched freely to this part of its length and, ever more softly, never beyond the second.
_SOFT, _HARD = 0.97, 0.9995

#: While both joints of a foot are in contact the pivot passes to the other one if that is slower by this much, in leg lengths
#: per second: well above the jitter of captures, well below a step.
_PIVOT_MARGIN = 0.1

#: Weight of the usual knee axis against the plane of the leg in one frame: it takes over below about 3 degrees of flexion.
_AXIS_WEIGHT = 0.05


def two_bone(
    hip: ArrayLike, knee: ArrayLike, ankle: ArrayLike, target: ArrayLike, axis: ArrayLike
) -> tuple[Array, Array]:
    """Turns of thigh and shank that bring the ankle to a target.

    The knee bends about the axis of its own plane until the leg spans the right distance, the ankle staying on its line from
    the hip; then the whole leg swings about the hip by the shortest arc. Knee plane and bone lengths are kept. Targets out of
    reach are approached softly: the leg is never straightened past 0.9995 of its length, or past what it already is.

    Parameters
    ----------
    hip, knee, ankle
        (..., 3) present positions.
    target
        (..., 3) where the ankle should be. At ``target == ankle`` both turns are the identity.
    axis
        (..., 3) unit axis about which this knee usually bends, positive flexion. It decides where the leg is straight
        and the plane undefined.

    Returns
    -------
    thigh, shank
        (..., 4) world rotations to apply from the left to what hangs on the hip and on the knee. The ankle ends at
        ``hip + thigh (knee - hip) + shank (ankle - knee)``.
    """
    hip, knee, ankle, target, axis = (np.asarray(x, dtype=np.float64) for x in (hip, knee, ankle, target, axis))
    upper, lower = knee - hip, ankle - knee
    l1, l2 = _norm(upper), _norm(lower)
    present = _norm(ankle - hip)
    wanted = _soft_reach(_norm(target - hip), present, l1, l2)

    plane = np.cross(upper, lower) / np.maximum(l1 * l2, 1e-12)[..., None]
    # A knee that measures as bent slightly backwards still has its hinge on the usual side.
    plane = np.where(_dot(plane, axis)[..., None] < 0, -plane, plane)
    hinge = plane + _AXIS_WEIGHT * axis
    hinge = hinge / np.maximum(_norm(hinge), 1e-12)[..., None]

    # |upper + R(hinge, phi) lower|^2 = l1^2 + l2^2 + 2 (a cos phi + b sin phi + c)
    c = _dot(upper, hinge) * _dot(lower, hinge)
    a = _dot(upper, lower) - c
    b = _dot(upper, np.cross(hinge, lower))
    amplitude = np.maximum(np.hypot(a, b), 1e-12)
    flexion = -np.arctan2(b, a)

    def flexed_for(distance: Array) -> Array:
        return np.arccos(np.clip((0.5 * (distance**2 - l1**2 - l2**2) - c) / amplitude, -1.0, 1.0))

    size, needed = np.abs(flexion), flexed_for(wanted)
    # A knee bent backwards (jitter of position captures) passes through straight instead of snapping to the other side;
    # there the target is missed by the square of a small angle.
    backward = np.where(needed <= size, -needed, np.minimum(needed, 2.0 * needed - 3.0 * size))
    bend = quat.from_axis_angle(hinge, np.where(flexion >= 0, needed, backward) - flexion)
    reached = upper + quat.rotate(bend, lower)
    # First back onto the old line from hip to ankle, within the plane of the leg; then the swing carries that plane along.
    thigh = quat.mul(quat.between(ankle - hip, target - hip), quat.between(reached, ankle - hip))
    return thigh, quat.mul(thigh, bend)


def lock_feet(clip: MotionClip, contacts: Contacts | None = None, *, blend: float = BLEND) -> MotionClip:
    """The clip with its feet held still while they are in contact.

    During a contact of a foot the joint that it pivots on (the one in contact or, of two, the slower) stays at one place on the
    floor, where the foot is on average over the contact; heights are kept, so a foot may roll from heel to toe and lift.
    Corrections fade in before and out after each contact. Feet keep their orientation in the world, bones their lengths; the
    rest of the body, and a foot that does not slide, are unchanged. Where a leg is too short to follow, some slide remains.

    Parameters
    ----------
    clip
        T frames of a skeleton with the leg roles.
    contacts
        Contacts to hold; ``None`` finds them with :func:`benchmark.motion.contacts.detect`.
    blend
        Seconds of fading; shortened where contacts follow each other faster.

    Returns
    -------
    MotionClip
        Same skeleton, root and length.

    Raises
    ------
    ContractError
        If ``contacts`` has another number of frames than the clip.
    """
    contacts = detect(clip) if contacts is None else contacts
    if len(contacts.flags) != len(clip):
        raise ContractError(f"contacts of {len(contacts.flags)} frames do not fit a clip of {len(clip)}")
    rotations = None
    for side in SIDES:
        shift = _foot_shift(clip, contacts, side, blend)
        moved = np.flatnonzero(np.linalg.norm(shift, axis=-1) > 1e-9)
        if len(moved):
            rotations = clip.rotations.copy() if rotations is None else rotations
            _move_foot(clip, rotations, side, shift, moved)
    return clip if rotations is None else clip.replace(rotations=rotations, source=None)


def _foot_shift(clip: MotionClip, contacts: Contacts, side: str, blend: float) -> Array:
    """(T, 3) how far the foot has to move over the floor, continuous in time."""
    columns = [i for i, role in enumerate(contacts.roles) if role.startswith(f"{side}_")]
    flags = contacts.flags[:, columns]
    positions = clip.positions[:, contacts.joints[columns]]
    shift = np.zeros((len(clip), 3))
    spans = runs(np.asarray(flags.any(axis=1)))
    for start, stop in spans:
        pivot = _pivots(positions[start:stop], flags[start:stop], clip.fps, clip.skeleton.leg_length)
        steps = np.diff(positions[start:stop], axis=0)[np.arange(stop - start - 1), pivot[1:]]
        # Skate is along the floor. Holding a heel or toe down as it lifts would only stretch the leg until it snaps.
        steps[:, 1] = 0.0
        held = np.concatenate([np.zeros((1, 3)), -np.cumsum(steps, axis=0)])
        shift[start:stop] = held - held.mean(axis=0)
    # Between contacts: fade out from the one before, fade in to the one after, both within the gap.
    for (_, left), (right, _) in zip([(0, 0), *spans], [*spans, (len(clip), 0)], strict=True):
        gap = np.arange(left, right)
        width = min(max(blend * clip.fps, 1.0), len(gap) + 1.0)
        if left > 0:
            shift[gap] += _ease(1.0 - (gap - left + 1) / width)[:, None] * shift[left - 1]
        if right < len(clip):
            shift[gap] += _ease(1.0 - (right - gap) / width)[:, None] * shift[right]
    return shift


def _pivots(positions: Array, flags: NDArray[np.bool_], fps: float, leg: float) -> NDArray[np.int64]:
    """(T,) which of one or two foot joints (T, F, 3) the foot pivots on; it changes only when the other is clearly slower."""
    frames = len(positions)
    if flags.shape[1] == 1:
        return np.zeros(frames, dtype=np.int64)
    half = max(1, round(0.05 * fps))
    early = np.maximum(np.arange(frames) - half, 0)
    late = np.minimum(np.arange(frames) + half, frames - 1)
    speed = np.linalg.norm(positions[late] - positions[early], axis=-1) * (fps / np.maximum(late - early, 1))[:, None]
    lead = speed[:, 0] - speed[:, 1]
    clear = np.where(lead > _PIVOT_MARGIN * leg, 1, np.where(lead < -_PIVOT_MARGIN * leg, 0, -1))
    clear = np.where(flags[:, 0] & ~flags[:, 1], 0, np.where(flags[:, 1] & ~flags[:, 0], 1, clear))
    known = np.flatnonzero(clear >= 0)
    if len(known) == 0:
        return np.full(frames, int(speed[:, 1].mean() <= speed[:, 0].mean()), dtype=np.int64)
    before = np.searchsorted(known, np.arange(frames), side="right") - 1
    return clear[known[np.maximum(before, 0)]]


def _move_foot(clip: MotionClip, rotations: Array, side: str, shift: Array, frames: NDArray[np.int64]) -> None:
    """Write into ``rotations`` (T, J, 4) the leg that carries the foot by ``shift`` (T, 3) at ``frames``."""
    skeleton = clip.skeleton
    world, positions = clip.world
    hip, knee, ankle = skeleton.joints(f"{side}_hip", f"{side}_knee", f"{side}_ankle")
    before_knee, before_ankle = int(skeleton.parents[knee]), int(skeleton.parents[ankle])

    axis = _knee_axis(clip, hip, knee, ankle)[frames]
    a, b, c = positions[frames, hip], positions[frames, knee], positions[frames, ankle]
    thigh, shank = two_bone(a, b, c, c + shift[frames], axis)

    above_hip = quat.inv_mul(world[frames, hip], quat.mul(thigh, world[frames, hip]))
    above_knee = quat.mul(thigh, world[frames, before_knee])
    above_ankle = quat.mul(shank, world[frames, before_ankle])
    for joint, value in (
        (hip, quat.mul(clip.rotations[frames, hip], above_hip)),
        (knee, quat.inv_mul(above_knee, quat.mul(shank, world[frames, knee]))),
        (ankle, quat.inv_mul(above_ankle, world[frames, ankle])),
    ):
        rotations[frames, joint] = quat.align(quat.normalize(value), clip.rotations[frames, joint])


def _knee_axis(clip: MotionClip, hip: int, knee: int, ankle: int) -> Array:
    """(T, 3) world axis of positive knee flexion: fixed in the thigh, the mean over the clip of what the bent leg shows.

    A leg that is straight throughout bends about the axis through the hips, so that the knee goes forward.
    """
    world, positions = clip.world
    upper, lower = positions[:, knee] - positions[:, hip], positions[:, ankle] - positions[:, knee]
    lengths = np.maximum(_norm(upper) * _norm(lower), 1e-12)
    mean = quat.inv_rotate(world[:, hip], np.cross(upper, lower) / lengths[:, None]).mean(axis=0)
    right = positions[:, clip.skeleton.joint("right_hip")] - positions[:, clip.skeleton.joint("left_hip")]
    right = right / np.maximum(_norm(right), 1e-12)[:, None]
    usual = -quat.inv_rotate(world[:, hip], right).mean(axis=0)
    mean = mean + 0.02 * usual
    return quat.rotate(world[:, hip], mean / max(float(np.linalg.norm(mean)), 1e-12))


def _soft_reach(wanted: Array, present: Array, l1: Array, l2: Array) -> Array:
    """Distances from hip to ankle that the leg can take, equal to those wanted up to a soft limit."""
    length = l1 + l2
    soft = np.maximum(_SOFT * length, present)
    hard = np.maximum(_HARD * length, present)
    room = np.maximum(hard - soft, 1e-12)
    eased = soft + room * (1.0 - np.exp(-np.maximum(wanted - soft, 0.0) / room))
    return np.maximum(np.where(wanted > soft, eased, wanted), np.abs(l1 - l2) + 1e-6 * length)


def _ease(x: Array) -> Array:
    """Smooth step: 0 below 0, 1 above 1, without kinks."""
    x = np.clip(x, 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)


def _dot(a: Array, b: Array) -> Array:
    return np.sum(a * b, axis=-1)


def _norm(v: Array) -> Array:
    return np.asarray(np.linalg.norm(v, axis=-1))
