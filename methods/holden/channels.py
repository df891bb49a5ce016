"""Clips as the channels that the autoencoder sees, and back.

Per frame: the position of every joint seen from the point on the floor below the hips, facing forward, in leg lengths (its
height above the floor is kept); the root's velocity to the left and forward and its yaw rate; and which foot joints are on
the floor. On the 22 points of the paper's skeleton these are its 73 channels: 66, 3 and 4.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from benchmark.motion import quat
from benchmark.motion.canonical import HEADING_SIGMA, heading
from benchmark.motion.clip import MotionClip
from benchmark.motion.contacts import detect
from benchmark.motion.root import RootTrack, compose, decompose
from benchmark.motion.skeleton import SIDES, Skeleton
from methods.hsu.track import pose

Array = NDArray[np.float64]

#: Share by which the deviation of foot positions is made smaller, so that their errors count for more (released code).
FOOT_SCALE = 0.9


@dataclass(frozen=True, eq=False)
class Layout:
    """Which column is what, for clips on one skeleton.

    Attributes
    ----------
    skeleton
        J joints.
    feet
        (F,) the joints with a contact channel.
    """

    skeleton: Skeleton
    feet: NDArray[np.int64]

    @classmethod
    def of(cls, skeleton: Skeleton) -> Self:
        """The layout for a skeleton: ankles, and toes where it has them, are the feet."""
        roles = [f"{side}_{part}" for side in SIDES for part in ("ankle", "toe") if skeleton.has(f"{side}_{part}")]
        return cls(skeleton, np.array([skeleton.joint(role) for role in roles], dtype=np.int64))

    @property
    def positions(self) -> slice:
        """Columns of joint positions."""
        return slice(0, 3 * len(self.skeleton))

    @property
    def velocity(self) -> slice:
        """Columns of the root's velocity: left and forward, leg lengths per second, and yaw rate, radians per second."""
        return slice(3 * len(self.skeleton), 3 * len(self.skeleton) + 3)

    @property
    def contacts(self) -> slice:
        """Columns of the foot contacts, 0 or 1."""
        return slice(3 * len(self.skeleton) + 3, self.dim)

    @property
    def dim(self) -> int:
        """D."""
        return 3 * len(self.skeleton) + 3 + len(self.feet)

    def encode(self, clip: MotionClip, *, contacts: bool = True) -> Array:
        """(T, D) of a clip on this skeleton, T >= 2.

        Without ``contacts`` their columns, which :meth:`decode` does not read, are 0.
        """
        leg = self.skeleton.leg_length
        yaw = heading(clip, sigma=HEADING_SIGMA)
        track = decompose(clip.root, yaw, clip.fps)
        values = np.zeros((len(clip), self.dim))
        local = quat.rotate_y(-yaw, clip.positions - clip.root[:, None] * [1.0, 0.0, 1.0])
        values[:, self.positions] = local.reshape(len(clip), -1) / leg
        values[:, self.velocity] = np.column_stack([track.velocity / leg, track.yaw_rate])
        if contacts:
            found = detect(clip)
            values[:, self.contacts] = found.flags[:, [list(found.joints).index(joint) for joint in self.feet]]
        return values

    def decode(self, values: Array, base: MotionClip) -> MotionClip:
        """The clip that ``values`` (T, D) describe.

        Positions leave the twist of limbs and the joints at the ends of chains open; these, and the direction faced, are those
        of ``base`` (T frames on this skeleton). The root moves with the velocities in ``values`` through that direction. Bone
        lengths are the skeleton's, and feet meet the floor where those of ``base`` do.
        """
        leg = self.skeleton.leg_length
        yaw = heading(base, sigma=HEADING_SIGMA)
        given = decompose(base.root, yaw, base.fps)
        velocity = values[:, self.velocity][:, :2] * leg
        track = RootTrack(velocity, given.yaw_rate, given.height, base.fps, given.start, given.start_yaw)
        root = compose(track)[0]
        local = values[:, self.positions].reshape(len(values), -1, 3)
        from_hips = local - local[:, :1]
        from_hips[:, 0, 1] = local[:, 0, 1]
        return pose(base.with_root(root), from_hips, coordinates="hips", unit=leg, yaw=yaw)


@dataclass(frozen=True, eq=False)
class Scaling:
    """``(x - offset) / scale`` as in the released code, from training clips alone.

    Positions have their own means and share one deviation, which keeps relative amplitudes; feet get :data:`FOOT_SCALE` of
    it. Velocities have mean 0 and one deviation for the two velocities and one for the yaw rate. Contacts become -1 and 1.
    """

    offset: Array
    scale: Array

    @classmethod
    def fit(cls, layout: Layout, arrays: list[Array]) -> Self:
        """From the training clips' channels (T_i, D)."""
        frames = np.concatenate(arrays)
        offset, scale = frames.mean(axis=0), np.ones(layout.dim)
        spread = frames.std(axis=0)[layout.positions]
        scale[layout.positions] = max(float(np.sqrt(np.mean(spread**2))), 1e-3)
        for joint in layout.feet:
            scale[3 * joint : 3 * joint + 3] *= FOOT_SCALE
        start = layout.velocity.start
        for columns in (slice(start, start + 2), slice(start + 2, start + 3)):
            offset[columns] = 0.0
            scale[columns] = max(float(np.sqrt(np.mean(frames[:, columns] ** 2))), 1e-3)
        offset[layout.contacts], scale[layout.contacts] = 0.5, 0.5
        return cls(offset, scale)

    def apply(self, values: Array) -> Array:
        """Normalised."""
        return (values - self.offset) / self.scale

    def invert(self, values: Array) -> Array:
        """Back in units."""
        return values * self.scale + self.offset
