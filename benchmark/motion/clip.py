"""The frozen motion clip: what every reader returns, every method takes and gives back, and every metric measures."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import ContractError
from benchmark.motion.skeleton import Skeleton


@dataclass(frozen=True)
class ClipMeta:
    """Who did what, in which style, and where it was read.

    ``style`` is the domain (``adult``, ``child``, ``normal`` …); ``take`` counts repetitions; ``source`` is the file or
    generator. ``clip_id`` is unique in a data set.
    """

    actor: str = ""
    style: str = ""
    action: str = ""
    take: str = ""
    source: str = ""

    @property
    def clip_id(self) -> str:
        """``style/actor/action_take``, without the parts that are unknown."""
        stem = "_".join(part for part in (self.action, self.take) if part)
        return "/".join(part for part in (self.style, self.actor, stem) if part)


@dataclass(frozen=True, eq=False)
class SourceChannels:
    """The channels of a BVH file as written, so that saving an unchanged clip loses nothing.

    Attributes
    ----------
    channels
        Per joint, its channel names in file order, for example ``("Xposition", …, "Yrotation")``.
    values
        (T, C) channel values in file units and degrees.
    unit
        Metres per file unit.
    offsets
        (J, 3) the OFFSET lines in file units.
    frame_time
        Seconds per frame exactly as written.
    end_sites
        Offsets of the end sites in file units, in file order.
    """

    channels: tuple[tuple[str, ...], ...]
    values: NDArray[np.float64]
    unit: float
    offsets: NDArray[np.float64]
    frame_time: float
    end_sites: tuple[tuple[float, float, float], ...] = ()


@dataclass(frozen=True, eq=False)
class MotionClip:
    """A motion on a skeleton.

    Metres, seconds, radians; Y up. Arrays are float64 and read-only.

    Attributes
    ----------
    skeleton
        The J joints.
    rotations
        (T, J, 4) local unit quaternions, ``w, x, y, z``.
    root
        (T, 3) position of joint 0 in the world.
    fps
        Frames per second.
    meta
        Actor, style, action, take, source.
    translations
        (T, J, 3) local joint positions that *replace* the offsets frame by frame, for files whose bones move; ``None``
        where bones are rigid. Row 0 of each frame is ignored in favour of ``root``.
    residual
        (T, J) distance in metres between a measured joint position and the rigid skeleton fitted to it, for captures
        that hold positions only.
    source
        Raw channels of the file read, if any.
    """

    skeleton: Skeleton
    rotations: NDArray[np.float64]
    root: NDArray[np.float64]
    fps: float
    meta: ClipMeta = field(default_factory=ClipMeta)
    translations: NDArray[np.float64] | None = None
    residual: NDArray[np.float64] | None = None
    source: SourceChannels | None = None

    def __post_init__(self) -> None:
        joints = len(self.skeleton)
        rotations = _frozen(self.rotations)
        root = _frozen(self.root)
        frames = len(rotations)
        if rotations.shape != (frames, joints, 4) or frames == 0:
            raise ContractError(
                f"rotations must have shape (T, {joints}, 4) with T > 0 on this skeleton, not {np.shape(self.rotations)}"
            )
        if root.shape != (frames, 3):
            raise ContractError(f"root must have shape ({frames}, 3), not {root.shape}")
        if not (np.isfinite(self.fps) and self.fps > 0):
            raise ContractError(f"fps must be positive, not {self.fps}")
        length = np.einsum("tji,tji->tj", rotations, rotations)
        # Where a number is not finite, neither is the length.
        unit = bool(np.max(np.abs(length - 1.0)) <= 1e-6)
        for name, array, checked in (("rotations", rotations, unit), ("root", root, False)):
            if not checked and not np.all(np.isfinite(array)):
                where = np.argwhere(~np.isfinite(array))[0]
                raise ContractError(f"{name} holds {array[tuple(where)]} at index {tuple(int(i) for i in where)}")
        if not unit:
            t, j = np.unravel_index(int(np.argmax(np.abs(length - 1.0))), length.shape)
            raise ContractError(
                f"rotation of joint {self.skeleton.names[j]!r} at frame {t} has length {np.sqrt(length[t, j]):.6g}, "
                "not 1: normalise quaternions before making a clip"
            )
        object.__setattr__(self, "rotations", rotations)
        object.__setattr__(self, "root", root)
        object.__setattr__(self, "fps", float(self.fps))
        for name, shape in (("translations", (frames, joints, 3)), ("residual", (frames, joints))):
            value = getattr(self, name)
            if value is not None:
                value = _frozen(value)
                if value.shape != shape or not np.all(np.isfinite(value)):
                    raise ContractError(f"{name} must be finite and of shape {shape}, not {value.shape}")
                object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return len(self.rotations)

    @property
    def duration(self) -> float:
        """Seconds from the first frame to the last."""
        return (len(self) - 1) / self.fps

    @property
    def times(self) -> NDArray[np.float64]:
        """(T,) time of each frame in seconds, from 0."""
        return np.arange(len(self)) / self.fps

    @cached_property
    def world(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """World rotations (T, J, 4) and positions (T, J, 3), computed once."""
        from benchmark.motion.kinematics import fk

        rotations, positions = fk(self.skeleton, self.rotations, self.root, translations=self.translations)
        rotations.flags.writeable = positions.flags.writeable = False
        return rotations, positions

    @property
    def positions(self) -> NDArray[np.float64]:
        """(T, J, 3) world positions, computed once."""
        return self.world[1]

    def replace(self, **changes: Any) -> MotionClip:
        """A copy with some fields changed; ``rotations``, ``root`` … as in the class."""
        return replace(self, **changes)

    def with_root(self, root: NDArray[np.float64]) -> MotionClip:
        """The clip on another path of joint 0, (T, 3); without raw channels, which say where it was.

        World positions that are known already are moved along instead of being computed again.
        """
        moved = replace(self, root=root, source=None)
        if "world" in self.__dict__:
            rotations, positions = self.world
            positions = positions + (moved.root - self.root)[:, None]
            positions.flags.writeable = False
            moved.__dict__["world"] = rotations, positions
        return moved

    def frames(self, start: int, stop: int) -> MotionClip:
        """The frames ``start`` to ``stop`` (exclusive)."""

        def cut(array: NDArray | None) -> NDArray | None:
            return None if array is None else array[start:stop]

        source = None if self.source is None else replace(self.source, values=self.source.values[start:stop])
        return replace(
            self,
            rotations=self.rotations[start:stop],
            root=self.root[start:stop],
            translations=cut(self.translations),
            residual=cut(self.residual),
            source=source,
        )


def _frozen(array: Any) -> NDArray[np.float64]:
    view = np.ascontiguousarray(array, dtype=np.float64).view()
    view.flags.writeable = False
    return view
