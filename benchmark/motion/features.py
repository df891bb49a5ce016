"""Clips as arrays for methods that learn: named codecs, quaternion signs, and normalisers fitted on training clips only.

Lengths are in leg lengths and facing is taken out, so arrays hold no cue of body size, place or direction, and decoding onto
another skeleton scales the path with the leg.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmark.errors import ConfigError, ContractError, MotionFileError, UnknownNameError
from benchmark.motion import quat
from benchmark.motion.clip import ClipMeta, MotionClip
from benchmark.motion.root import RootTrack, compose, from_features, join, split
from benchmark.motion.skeleton import Skeleton

Array = NDArray[np.float64]

_ROOT = {"root_velocity": slice(0, 2), "yaw_rate": slice(2, 3), "height": slice(3, 4)}


class Codec(ABC):
    """A two-way map between clips on one skeleton and (T, D) arrays.

    The first four columns are the root: velocity to the left and forward (leg lengths per second), yaw rate (radians per
    second), height (leg lengths). The rest is the pose, joint by joint, with the heading taken out.

    Parameters
    ----------
    skeleton
        J joints with the leg roles and the hips as joint 0.
    """

    name: ClassVar[str]
    pose_width: ClassVar[int]

    def __init__(self, skeleton: Skeleton) -> None:
        self.skeleton = skeleton

    @property
    def pose_joints(self) -> int:
        """Number of joints in the pose part."""
        return len(self.skeleton)

    @property
    def dim(self) -> int:
        """D, the number of columns."""
        return 4 + self.pose_width * self.pose_joints

    @property
    def groups(self) -> dict[str, slice]:
        """Columns that belong together, by name: ``root_velocity``, ``yaw_rate``, ``height``, ``pose``."""
        return {**_ROOT, "pose": slice(4, self.dim)}

    def encode(self, clip: MotionClip) -> Array:
        """The clip as (T, D); T >= 2. Its joints must be those of the codec's skeleton, its proportions need not."""
        if not clip.skeleton.same_topology(self.skeleton):
            raise ContractError(
                f"codec {self.name!r} was made for other joints than those of clip {clip.meta.clip_id!r}"
            )
        track, rotations = split(clip)
        root = track.features
        root[:, [0, 1, 3]] /= clip.skeleton.leg_length
        return np.concatenate([root, self._pose(clip, rotations).reshape(len(clip), -1)], axis=1)

    def decode(
        self,
        array: ArrayLike,
        fps: float,
        *,
        start: ArrayLike = (0.0, 0.0),
        start_yaw: float = 0.0,
        meta: ClipMeta | None = None,
    ) -> MotionClip:
        """A clip on the codec's skeleton from (T, D); pose parts need not be exactly valid rotations.

        Parameters
        ----------
        array
            (T, D) as from :meth:`encode`, or as a model made it.
        fps
            Frames per second.
        start, start_yaw
            Place (x, z) in metres and yaw in radians of the first frame. Canonical clips start at zero.
        meta
            For the clip.

        Raises
        ------
        ContractError
            If the array has another width, or is not finite.
        """
        array = np.asarray(array, dtype=np.float64)
        if array.ndim != 2 or array.shape[1] != self.dim:
            raise ContractError(f"codec {self.name!r} decodes arrays of shape (T, {self.dim}), not {array.shape}")
        if not np.all(np.isfinite(array)):
            raise ContractError(f"cannot decode: frame {int(np.argwhere(~np.isfinite(array))[0, 0])} is not finite")
        root = array[:, :4].copy()
        root[:, [0, 1, 3]] *= self.skeleton.leg_length
        track = from_features(root, fps, start=start, start_yaw=start_yaw)
        pose = array[:, 4:].reshape(len(array), self.pose_joints, self.pose_width)
        return self._clip(pose, track, meta or ClipMeta())

    @abstractmethod
    def _pose(self, clip: MotionClip, rotations: Array) -> Array:
        """Pose part (T, P, width); ``rotations`` (T, J, 4) are the clip's with the heading taken out."""

    @abstractmethod
    def _clip(self, pose: Array, track: RootTrack, meta: ClipMeta) -> MotionClip: ...


class Quaternions(Codec):
    """Local rotations as unit quaternions, sign-continuous.

    Parameters
    ----------
    skeleton
        J joints.
    reference
        (J, 4) from :func:`sign_reference` over the training clips, so that the same pose has the same sign in every clip.
    """

    name = "quaternions"
    pose_width = 4

    def __init__(self, skeleton: Skeleton, *, reference: ArrayLike | None = None) -> None:
        super().__init__(skeleton)
        self.reference = None if reference is None else np.asarray(reference, dtype=np.float64)

    def _pose(self, clip: MotionClip, rotations: Array) -> Array:
        return fix_signs(rotations, self.reference)

    def _clip(self, pose: Array, track: RootTrack, meta: ClipMeta) -> MotionClip:
        rotations, root = join(track, quat.normalize(pose))
        return MotionClip(self.skeleton, quat.unroll(rotations), root, track.fps, meta)


class SixD(Codec):
    """Local rotations as the first two columns of their matrices (Zhou et al. 2019): continuous, no signs to fix."""

    name = "sixd"
    pose_width = 6

    def _pose(self, clip: MotionClip, rotations: Array) -> Array:
        from benchmark.motion.rotations import to_sixd

        return to_sixd(rotations)

    def _clip(self, pose: Array, track: RootTrack, meta: ClipMeta) -> MotionClip:
        from benchmark.motion.rotations import from_sixd

        rotations, root = join(track, from_sixd(pose))
        return MotionClip(self.skeleton, quat.unroll(quat.normalize(rotations)), root, track.fps, meta)


class Positions(Codec):
    """Joint positions from the root, in the heading frame, in leg lengths.

    Decoding fits rotations on the codec's skeleton by direction matching; bone lengths of the array are not kept and what is
    lost is the clip's ``residual``.
    """

    name = "positions"
    pose_width = 3

    @property
    def pose_joints(self) -> int:
        """Every joint but the root."""
        return len(self.skeleton) - 1

    def _pose(self, clip: MotionClip, rotations: Array) -> Array:
        # The heading-free root rotation times the inverse of the full one is the turn that takes the heading out.
        unturn = quat.mul(rotations[:, 0], quat.inverse(clip.rotations[:, 0]))
        local = clip.positions[:, 1:] - clip.root[:, None]
        return quat.rotate(unturn[:, None], local) / clip.skeleton.leg_length

    def _clip(self, pose: Array, track: RootTrack, meta: ClipMeta) -> MotionClip:
        from benchmark.motion.ik import rotations_from_positions

        root, yaw = compose(track)
        turn = quat.from_axis_angle([0.0, 1.0, 0.0], yaw)
        rest = root[:, None] + quat.rotate(turn[:, None], pose * self.skeleton.leg_length)
        positions = np.concatenate([root[:, None], rest], axis=1)
        rotations, root, residual = rotations_from_positions(self.skeleton, positions)
        return MotionClip(self.skeleton, quat.unroll(rotations), root, track.fps, meta, residual=residual)


CODECS: Mapping[str, type[Codec]] = {codec.name: codec for codec in (Quaternions, SixD, Positions)}


def codec(name: str, skeleton: Skeleton) -> Codec:
    """The codec of that name; an :class:`~benchmark.errors.UnknownNameError` lists them."""
    if name not in CODECS:
        raise UnknownNameError("codec", name, CODECS)
    return CODECS[name](skeleton)


def sign_reference(clips: Iterable[MotionClip | ArrayLike]) -> Array:
    """(J, 4) average rotation per joint over training clips (or arrays (T, J, 4)), ``w >= 0``; see :func:`fix_signs`.

    The leading eigenvector of ``sum q q^T`` over all frames, which does not depend on the signs it is to fix.
    """
    scatter = None
    for item in clips:
        q = _rotations(item)
        part = np.einsum("tji,tjk->jik", q, q)
        scatter = part if scatter is None else scatter + part
    if scatter is None:
        raise ContractError("a sign reference needs at least one training clip")
    return quat.absolute(np.linalg.eigh(scatter)[1][..., -1])


def fix_signs(item: MotionClip | ArrayLike, reference: ArrayLike | None = None) -> Array:
    """Rotations (T, J, 4) with signs fit for learning.

    First continuous in time, then, per joint and for the clip as a whole, on the side of ``reference`` on average. Continuity
    comes first: a joint that turns further than a hemisphere legitimately ends on the other side. Without a reference
    the first frame has ``w >= 0``.

    Parameters
    ----------
    item
        A clip, or rotations (T, J, 4).
    reference
        (J, 4) from :func:`sign_reference` over the *training* clips.
    """
    q = quat.unroll(_rotations(item))
    side = (
        q[0, :, 0] if reference is None else np.sum(q * np.asarray(reference, dtype=np.float64), axis=-1).mean(axis=0)
    )
    return np.where((side < 0)[None, :, None], -q, q)


def _rotations(item: MotionClip | ArrayLike) -> Array:
    return item.rotations if isinstance(item, MotionClip) else np.asarray(item, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Normalizer:
    """``(x - offset) / scale`` with statistics of the training arrays only.

    Never fit it on a test clip: a clip normalised by its own mean and deviation has lost its mean pose and amplitude, which is
    part of its style.

    Attributes
    ----------
    offset, scale
        (D,).
    kind
        How they were found: see :meth:`fit`.
    """

    offset: Array
    scale: Array
    kind: str = field(default="channel")

    KINDS: ClassVar[tuple[str, ...]] = ("channel", "group", "minmax")

    @classmethod
    def fit(
        cls, arrays: Sequence[ArrayLike], *, kind: str = "channel", groups: Mapping[str, slice] | None = None
    ) -> Self:
        """Statistics of training arrays (T_i, D).

        Parameters
        ----------
        arrays
            The training clips' arrays; every frame counts once.
        kind
            ``channel``: mean and standard deviation of each column. ``group``: mean of each column and one deviation per group,
            the root mean square of its columns' (Holden et al. 2016), which keeps relative amplitudes. ``minmax``: one
            minimum and one maximum over everything, mapped to [-1, 1] (Adult2child 2020). Deviations are at least 0.001 of
            the median deviation, so that a column constant in training cannot explode in a test.
        groups
            Columns of each group, for ``group``; see :attr:`Codec.groups`.

        Raises
        ------
        ConfigError
            If ``kind`` is unknown or groups are missing.
        ContractError
            If there are no frames, or values are not finite.
        """
        if kind not in cls.KINDS:
            raise ConfigError(f"unknown normalisation {kind!r}: choose from {', '.join(cls.KINDS)}")
        if len(arrays) == 0:
            raise ContractError("a normaliser needs at least one training array")
        x = np.concatenate([np.asarray(array, dtype=np.float64) for array in arrays])
        if x.ndim != 2 or len(x) == 0 or not np.all(np.isfinite(x)):
            raise ContractError(f"a normaliser needs finite frames of shape (T, D), not {x.shape}")
        width = x.shape[1]
        if kind == "minmax":
            low, high = float(x.min()), float(x.max())
            half = 0.5 * (high - low) or 1.0
            return cls(np.full(width, 0.5 * (low + high)), np.full(width, half), kind)
        deviation = x.std(axis=0)
        if kind == "group":
            if not groups:
                raise ConfigError("normalisation 'group' needs the groups of the columns, for example codec.groups")
            for columns in groups.values():
                deviation[columns] = np.sqrt(np.mean(deviation[columns] ** 2))
        # Constant columns come out of the mean with rounding dust instead of zero; it is no scale to judge others by.
        alive = deviation[deviation > 1e-12 * np.maximum(1.0, np.abs(x).max())]
        floor = 1e-3 * float(np.median(alive)) if alive.size else 1.0
        return cls(x.mean(axis=0), np.maximum(deviation, floor), kind)

    def apply(self, array: ArrayLike) -> Array:
        """Normalised (..., D)."""
        return (np.asarray(array, dtype=np.float64) - self.offset) / self.scale

    def invert(self, array: ArrayLike) -> Array:
        """Back to data units (..., D)."""
        return np.asarray(array, dtype=np.float64) * self.scale + self.offset

    def to_arrays(self) -> dict[str, NDArray]:
        """Plain arrays, for storing beside a model's weights."""
        return {"offset": self.offset, "scale": self.scale, "kind": np.frombuffer(self.kind.encode(), dtype=np.uint8)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> Self:
        """What :meth:`to_arrays` gave; a :class:`~benchmark.errors.ContractError` says what does not fit."""
        missing = {"offset", "scale", "kind"} - set(arrays)
        if missing:
            raise ContractError(f"a stored normaliser lacks {', '.join(sorted(missing))}")
        offset, scale = (np.asarray(arrays[name], dtype=np.float64) for name in ("offset", "scale"))
        kind = np.asarray(arrays["kind"], dtype=np.uint8).tobytes().decode(errors="replace")
        sound = offset.ndim == 1 and offset.shape == scale.shape and np.all(np.isfinite(offset)) and np.all(scale > 0)
        if kind not in cls.KINDS or not sound:
            raise ContractError(
                f"a stored normaliser of kind {kind!r} has no matching finite offset and positive scale"
            )
        return cls(offset, scale, kind)

    def save(self, path: Path | str) -> None:
        """Write an ``.npz``."""
        with Path(path).open("wb") as file:
            np.savez(file, **self.to_arrays())  # type: ignore[arg-type]

    @classmethod
    def load(cls, path: Path | str) -> Self:
        """Read what :meth:`save` wrote; nothing in the file can execute. A damaged one is a ``MotionFileError``."""
        import zipfile

        try:
            with np.load(path, allow_pickle=False) as file:
                return cls.from_arrays({name: file[name] for name in file.files})
        except FileNotFoundError:
            raise MotionFileError(path, "no such file") from None
        except (OSError, ValueError, EOFError, zipfile.BadZipFile, ContractError) as error:
            raise MotionFileError(path, f"not a normaliser written by this suite ({error})") from error
