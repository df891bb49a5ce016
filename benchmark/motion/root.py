"""The root's path as what a walker feels of it: speed along and across the facing direction, turning rate, height.

Free of where a clip starts and which way it faces, so it can be cut, blended, scaled and learned; integrated back exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmark.errors import ContractError
from benchmark.motion import quat
from benchmark.motion.canonical import HEADING_SIGMA, heading
from benchmark.motion.clip import MotionClip

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RootTrack:
    """A root path in its own heading frame.

    Attributes
    ----------
    velocity
        (T, 2) metres per second to the left (x) and forward (z) of the facing direction halfway through the step from each
        frame to the next. The last row repeats the one before, so that there is a row for every frame.
    yaw_rate
        (T,) radians per second of the same step, positive from +Z towards +X.
    height
        (T,) metres.
    fps
        Frames per second.
    start
        (2,) x and z of the first frame, metres.
    start_yaw
        Yaw of the first frame, radians.
    """

    velocity: Array
    yaw_rate: Array
    height: Array
    fps: float
    start: Array
    start_yaw: float = 0.0

    @property
    def features(self) -> Array:
        """(T, 4) columns: velocity x, velocity z, yaw rate, height."""
        return np.column_stack([self.velocity, self.yaw_rate, self.height])


def from_features(
    features: ArrayLike, fps: float, *, start: ArrayLike = (0.0, 0.0), start_yaw: float = 0.0
) -> RootTrack:
    """The track whose :attr:`RootTrack.features` (T, 4) these are, from the place and direction given."""
    features = np.asarray(features, dtype=np.float64)
    if features.ndim != 2 or features.shape[1] != 4:
        raise ContractError(f"root features must have shape (T, 4), not {features.shape}")
    return RootTrack(
        features[:, :2], features[:, 2], features[:, 3], fps, np.asarray(start, dtype=np.float64), float(start_yaw)
    )


def decompose(root: ArrayLike, yaw: ArrayLike, fps: float) -> RootTrack:
    """The path in its heading frame.

    Each step is seen from the direction halfway between those of its two frames (midpoint rule), which makes a steady turn a
    constant and the inverse exact.

    Parameters
    ----------
    root
        (T, 3) metres, Y up, T >= 2.
    yaw
        (T,) radians, for example from :func:`benchmark.motion.canonical.heading`; wrapped or not.
    fps
        Frames per second.

    Raises
    ------
    ContractError
        If there are fewer than two frames or the shapes disagree.
    """
    root, yaw = np.asarray(root, dtype=np.float64), np.asarray(yaw, dtype=np.float64)
    if root.ndim != 2 or root.shape[1] != 3 or yaw.shape != root.shape[:1]:
        raise ContractError(f"a root path needs shapes (T, 3) and (T,), not {root.shape} and {yaw.shape}")
    if len(root) < 2:
        raise ContractError("a root path of one frame has no velocity: give at least two frames")
    turn = (np.diff(yaw) + np.pi) % (2.0 * np.pi) - np.pi
    step = _turn(np.diff(root[:, [0, 2]], axis=0), -(yaw[:-1] + 0.5 * turn))
    return RootTrack(
        velocity=np.concatenate([step, step[-1:]]) * fps,
        yaw_rate=np.append(turn, turn[-1]) * fps,
        height=root[:, 1].copy(),
        fps=float(fps),
        start=root[0, [0, 2]],
        start_yaw=float(yaw[0]),
    )


def compose(track: RootTrack) -> tuple[Array, Array]:
    """Integrate a track; inverse of :func:`decompose`.

    Returns
    -------
    root, yaw
        (T, 3) metres and (T,) radians, the yaw unwrapped.
    """
    turn = track.yaw_rate[:-1] / track.fps
    yaw = track.start_yaw + np.concatenate([[0.0], np.cumsum(turn)])
    step = _turn(track.velocity[:-1] / track.fps, yaw[:-1] + 0.5 * turn)
    ground = track.start + np.concatenate([np.zeros((1, 2)), np.cumsum(step, axis=0)])
    return np.column_stack([ground[:, 0], track.height, ground[:, 1]]), yaw


def split(clip: MotionClip, *, sigma: float = HEADING_SIGMA) -> tuple[RootTrack, Array]:
    """A clip as its root track and what is left of its rotations when the heading is taken out.

    Parameters
    ----------
    clip
        T >= 2 frames.
    sigma
        Smoothing of the heading in seconds.

    Returns
    -------
    track, rotations
        The track, and (T, J, 4) local rotations in which joint 0 is relative to the heading.
    """
    yaw = heading(clip, sigma=sigma)
    rotations = clip.rotations.copy()
    rotations[:, 0] = quat.mul(_about_y(-yaw), rotations[:, 0])
    return decompose(clip.root, yaw, clip.fps), rotations


def join(track: RootTrack, rotations: ArrayLike) -> tuple[Array, Array]:
    """Rotations (T, J, 4) and root (T, 3) of the clip that :func:`split` was given."""
    root, yaw = compose(track)
    rotations = np.array(rotations, dtype=np.float64)
    rotations[:, 0] = quat.mul(_about_y(yaw), rotations[:, 0])
    return rotations, root


def _about_y(yaw: Array) -> Array:
    return quat.from_axis_angle([0.0, 1.0, 0.0], yaw)


def turn_frames(clip: MotionClip, yaw: ArrayLike) -> MotionClip:
    """The clip, each frame turned by ``yaw`` (T,) radians about the vertical through its root; without raw channels.

    World positions that are known already are turned along instead of being computed again.
    """
    turn = _about_y(np.asarray(yaw, dtype=np.float64))
    rotations = clip.rotations.copy()
    rotations[:, 0] = quat.mul(turn, rotations[:, 0])
    moved = clip.replace(rotations=rotations, source=None)
    if "world" in clip.__dict__:
        known, root = clip.world, clip.root[:, None]
        world = quat.mul(turn[:, None], known[0]), quat.rotate_y(yaw, known[1] - root) + root
        for array in world:
            array.flags.writeable = False
        moved.__dict__["world"] = world
    return moved


def _turn(xz: Array, yaw: Array) -> Array:
    """Ground vectors (T, 2) turned about +Y by ``yaw`` (T,)."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.stack([cos * xz[:, 0] + sin * xz[:, 1], cos * xz[:, 1] - sin * xz[:, 0]], axis=-1)
