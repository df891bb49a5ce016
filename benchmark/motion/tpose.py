"""The T-pose at the start of a recording, found by the angle of the arms and cut off."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmark.motion.clip import MotionClip
from benchmark.motion.skeleton import SIDES

Array = NDArray[np.float64]

_GRAVITY = 9.81

#: A T-pose prefix begins with both arms within the first of horizontal and sideways; a T that is held, within the second;
#: it is over when both upper arms hang by the third below horizontal (radians).
_T_BEGIN, _T_HELD, _T_DOWN = np.deg2rad(40.0), np.deg2rad(30.0), np.deg2rad(60.0)
#: An arm that goes up again by this, or up from the T by twice this, has begun to perform (radians).
_T_RISE = np.deg2rad(20.0)
#: Arms put down at leisure sink more slowly than this (radians per second).
_T_SINK = 6.0
#: A T is held, not passed, if the whole body stays in it for this long (s) below this speed, in sqrt(g * leg).
_T_HOLD, _T_STILL = 0.25, 0.08
#: The hips and feet may shift about this fast, in sqrt(g * leg), before the performance has begun: below a walk.
_T_BEGUN = 0.25
#: Speeds of the T-pose test are displacements over this time (s), so that jitter of the capture averages out.
_T_SPAN = 0.2
#: A change of the arms between two frames that no body makes: radians, and radians per second.
_T_JUMP, _T_JUMP_RATE = np.deg2rad(40.0), 20.0


def trim_tpose(clip: MotionClip) -> MotionClip:
    """The clip without the T-pose at its start; see :func:`tpose_frames`."""
    cut = tpose_frames(clip)
    return clip.frames(cut, len(clip)) if cut else clip


def tpose_frames(clip: MotionClip) -> int:
    """How many frames at the start show the T-pose of a capture rather than the performance.

    A prefix begins in a T (upper arms and forearms within 40 degrees of sideways and horizontal, which takes straight elbows)
    and lasts until both upper arms hang 60 degrees below horizontal, or before that until an arm goes up again, or until hips
    and feet set off. It is cut if the T is held (within 30 degrees, the whole body still for 0.25 s), or if the clip starts
    on the way out of it: both arms sink to the sides at leisure (under 6 rad/s) while the body stands still. A lone
    calibration frame in front, left by a jump that no body makes, is cut too.

    A motion that swings through a T, even from its first frame, is not touched; nor is a clip that never leaves its T, or that
    has one later.

    Parameters
    ----------
    clip
        T frames; without the arm roles nothing is ever found.

    Returns
    -------
    int
        In [0, T - 1].
    """
    cut = 0
    # Some actors fidget back into the T: what remains after a prefix may begin with another.
    while step := _tpose_prefix(clip.frames(cut, len(clip))):
        cut += step
    return cut


def _tpose_prefix(clip: MotionClip) -> int:
    """Frames of the first prefix of :func:`tpose_frames`."""
    skeleton = clip.skeleton
    arms = [f"{side}_{part}" for side in SIDES for part in ("shoulder", "elbow", "wrist")]
    if not skeleton.has(*arms, "hips", "left_ankle", "right_ankle") or len(clip) < 2:
        return 0
    lean, drop = _arm_angles(clip)
    if lean[0] > _T_BEGIN:
        return 0
    if lean[0] < _T_HELD and lean[1] - lean[0] > max(_T_JUMP, _T_JUMP_RATE / clip.fps):
        return 1
    span = max(1, round(_T_SPAN * clip.fps))
    limit = np.sqrt(_GRAVITY * skeleton.leg_length)
    body = skeleton.joints("hips", "left_ankle", "right_ankle")
    rising = (drop < np.maximum.accumulate(drop, axis=0) - _T_RISE) | (drop < -2.0 * _T_RISE)
    down = (drop > _T_DOWN).all(axis=1)
    waiting = (_speed(clip, body, span) < _T_BEGUN * limit) & ~rising.any(axis=1) & ~down
    if waiting.all() or not waiting[0]:
        return 0
    prefix = int(np.argmin(waiting))
    still = (lean[:prefix] < _T_HELD) & (
        _speed(clip, [*body, *skeleton.joints(*arms)], span)[:prefix] < _T_STILL * limit
    )
    hold = prefix if still.all() else int(np.argmin(still))
    # A frame that is still looks one span ahead, so the last one of the hold vouches for that long after it.
    held = hold > 0 and hold + span >= _T_HOLD * clip.fps
    sink = drop[np.minimum(np.arange(prefix) + span, len(clip) - 1)] - drop[:prefix]
    lowered = bool(down[prefix]) and sink.max() < _T_SINK * span / clip.fps
    return prefix if held or lowered else 0


def _arm_angles(clip: MotionClip) -> tuple[Array, Array]:
    """How far the arms are from a T, radians.

    Returns
    -------
    lean, drop
        (T,) largest angle of any upper arm or forearm from its horizontal sideways direction, and (T, 2) how far the left and
        the right upper arm point below horizontal.
    """
    skeleton, positions = clip.skeleton, clip.positions
    left, right = skeleton.joints("left_shoulder", "right_shoulder")
    across = (positions[:, left] - positions[:, right]) * [1.0, 0.0, 1.0]
    lean, drop = np.zeros(len(clip)), np.zeros((len(clip), 2))
    for i, side in enumerate(SIDES):
        shoulder, elbow, wrist = skeleton.joints(f"{side}_shoulder", f"{side}_elbow", f"{side}_wrist")
        outward = across if side == "left" else -across
        for start, end in ((shoulder, elbow), (elbow, wrist)):
            bone = positions[:, end] - positions[:, start]
            cross = np.linalg.norm(np.cross(outward, bone), axis=-1)
            lean = np.maximum(lean, np.arctan2(cross, np.sum(outward * bone, axis=-1)))
        upper = positions[:, elbow] - positions[:, shoulder]
        drop[:, i] = -np.arctan2(upper[:, 1], np.linalg.norm(upper[:, [0, 2]], axis=-1))
    return lean, drop


def _speed(clip: MotionClip, joints: list[int], span: int) -> Array:
    """(T,) fastest of ``joints`` over the next ``span`` frames, m/s. Looking ahead only, it is blind to a prefix cut off."""
    positions = clip.positions[:, joints]
    ahead = np.minimum(np.arange(len(clip)) + span, len(clip) - 1)
    steps = np.maximum(ahead - np.arange(len(clip)), 1)
    return np.linalg.norm(positions[ahead] - positions, axis=-1).max(axis=1) * clip.fps / steps
