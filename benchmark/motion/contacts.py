"""Foot contact: the one definition that every method, metric and clean-up of the suite shares.

A foot joint is in contact while it is both slow and low. The thresholds are those of the exporter of Holden et al. 2016
(0.757 m/s; ankle 0.169 m, toe 0.113 m; 3 frames at 60 fps) for a leg of 0.826 m, made dimensionless by leg length and
gravity: a figure that is ``L`` times as large and moves in ``sqrt(L)`` times the time has the same contacts (equal Froude
number), and one captured at another frame rate has the same contact times.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.motion.clip import MotionClip
from benchmark.motion.skeleton import SIDES

GRAVITY = 9.81
#: Speed below which a contact begins, in sqrt(g * leg).
SPEED = 0.266
#: Height above the floor below which a contact begins, in leg lengths, for ankle and toe.
HEIGHT = {"ankle": 0.205, "toe": 0.137}
#: A contact ends at this many times the thresholds at which it begins.
LEAVE = 1.5
#: Shortest contact and span over which speed is measured, in sqrt(leg / g): 3 and 2 frames at 60 fps for a leg of 0.826 m.
_REFERENCE_TIME = float(np.sqrt(0.826 / GRAVITY))
MIN_DURATION = (3 / 60) / _REFERENCE_TIME
SPEED_SPAN = (2 / 60) / _REFERENCE_TIME


@dataclass(frozen=True, eq=False)
class Contacts:
    """When which foot joint is on the floor.

    Attributes
    ----------
    flags
        (T, F) true in contact.
    joints
        (F,) joint indices.
    roles
        The F roles of those joints, for example ``"left_ankle"``.
    """

    flags: NDArray[np.bool_]
    joints: NDArray[np.int64]
    roles: tuple[str, ...]

    def side(self, side: str) -> NDArray[np.bool_]:
        """(T,) whether any joint of the ``left`` or ``right`` foot is in contact."""
        columns = [i for i, role in enumerate(self.roles) if role.startswith(f"{side}_")]
        return np.asarray(self.flags[:, columns].any(axis=1))


def detect(clip: MotionClip, *, floor: float = 0.0) -> Contacts:
    """Foot contacts of a clip.

    A contact begins when speed < 0.266 sqrt(g leg) and height < 0.205 leg (ankle) or 0.137 leg (toe), lasts until either
    exceeds 1.5 times that, and counts if it lasts 0.172 sqrt(leg / g), which is 0.05 s for a leg of 0.826 m, or if an end of
    the clip cuts it off. Speed is that of the joint in three dimensions, over 0.115 sqrt(leg / g) about the frame.

    Parameters
    ----------
    clip
        T frames of a skeleton with the hip, knee and ankle roles; toes are used where it has them.
    floor
        Height of the floor in metres; 0 in canonical clips.

    Raises
    ------
    SkeletonError
        If a leg role is missing.
    """
    skeleton = clip.skeleton
    leg = skeleton.leg_length
    roles = tuple(
        f"{side}_{part}" for side in SIDES for part in HEIGHT if part == "ankle" or skeleton.has(f"{side}_{part}")
    )
    joints = np.array(skeleton.joints(*roles), dtype=np.int64)
    positions = clip.positions[:, joints]
    unit_time = np.sqrt(leg / GRAVITY)
    speed = _speed(positions, clip.fps, SPEED_SPAN * unit_time) / (SPEED * np.sqrt(GRAVITY * leg))
    limits = leg * np.array([HEIGHT[role.partition("_")[2]] for role in roles])
    height = (positions[..., 1] - floor) / limits
    worst = np.maximum(speed, height)
    flags = hysteresis(worst < 1.0, worst <= LEAVE)
    shortest = int(np.ceil(MIN_DURATION * unit_time * clip.fps - 1e-6))
    return Contacts(_drop_short(flags, shortest), joints, roles)


def hysteresis(enter: NDArray[np.bool_], stay: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """States (T, ...) that begin where ``enter`` and last while ``stay``, along axis 0; ``enter`` implies ``stay``."""
    frame = np.arange(1, len(enter) + 1).reshape(-1, *[1] * (enter.ndim - 1))
    entered = np.maximum.accumulate(np.where(enter, frame, 0), axis=0)
    left = np.maximum.accumulate(np.where(stay, 0, frame), axis=0)
    return entered > left


def runs(flags: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(R, 2) first frame and one past the last of every run of true in (T,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return edges.reshape(-1, 2)


def _drop_short(flags: NDArray[np.bool_], shortest: int) -> NDArray[np.bool_]:
    """Flags (T, F) without runs of fewer frames; those cut off by the clip's ends stay, for nobody knows how long they are."""
    out = flags.copy()
    for column in range(flags.shape[1]):
        for start, stop in runs(flags[:, column]):
            if stop - start < shortest and start > 0 and stop < len(flags):
                out[start:stop, column] = False
    return out


def _speed(positions: NDArray[np.float64], fps: float, span: float) -> NDArray[np.float64]:
    """(T, F) mean speed over ``span`` seconds about each frame, positions (T, F, 3) being joined by straight lines."""
    frames = len(positions)
    if frames == 1:
        return np.zeros(positions.shape[:2])
    centre = np.arange(frames, dtype=np.float64)
    # At least half a frame to either side, and one frame at the ends, where only one side exists.
    half = max(0.5 * span * fps, 0.5)
    early, late = np.clip(centre - half, 0.0, frames - 1), np.clip(centre + half, 0.0, frames - 1)
    moved = _at(positions, late) - _at(positions, early)
    return np.linalg.norm(moved, axis=-1) * (fps / (late - early))[:, None]


def _at(positions: NDArray[np.float64], frame: NDArray[np.float64]) -> NDArray[np.float64]:
    low = np.minimum(frame.astype(np.int64), len(positions) - 2)
    t = (frame - low)[:, None, None]
    return (1.0 - t) * positions[low] + t * positions[low + 1]
