"""From BVH channels to local rotations and positions, and back."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from benchmark.motion.rotations import LOCKED, compose_half_angles, euler_halves, order_axes, wrap

Array = NDArray[np.float64]

#: A rotation is kept as the file had it where no quaternion component differs by more than this (1e-9 rad).
SAME_ROTATION = 2.5e-10

_PRINTED = 1e-5

# Frames converted at a time, so that temporaries stay in a core's own cache.
_BLOCK = 256


class ChannelLayout:
    """Which column of a row is which channel of which joint.

    Parameters
    ----------
    channels
        Per joint, its channel names in file order.

    Attributes
    ----------
    columns
        Values in a row.
    orders
        Per joint, the full rotation order: the axes it has, in file order, then those it lacks.
    rotation_axes
        Per joint, how many rotation channels it has.
    positions
        Joints with at least one position channel, each with its (axis, column) pairs.
    """

    def __init__(self, channels: Sequence[Sequence[str]]) -> None:
        self.columns = sum(len(names) for names in channels)
        self.orders: list[str] = []
        self.rotation_axes: list[int] = []
        self.positions: dict[int, list[tuple[int, int]]] = {}
        self.rotation_columns: list[list[int]] = []
        column = 0
        for joint, names in enumerate(channels):
            axes, columns = "", []
            for name in names:
                if name.endswith("rotation"):
                    axes += name[0]
                    columns.append(column)
                else:
                    self.positions.setdefault(joint, []).append(("XYZ".index(name[0]), column))
                column += 1
            missing = "".join(axis for axis in "ZXY" if axis not in axes)
            self.orders.append(axes + missing)
            self.rotation_axes.append(len(axes))
            self.rotation_columns.append(columns)
        groups: dict[tuple[str, int], list[int]] = {}
        for joint, key in enumerate(zip(self.orders, self.rotation_axes, strict=True)):
            groups.setdefault(key, []).append(joint)
        #: (order, axes present) to the joints that share it.
        self.groups = groups

    def rotations(self, values: Array) -> Array:
        """(T, J, 4) local rotations of (T, C) channel values in degrees."""
        out = np.empty((len(values), len(self.orders), 4))
        for at in range(0, len(values), _BLOCK):
            part, target = values[at : at + _BLOCK], out[at : at + _BLOCK]
            for (order, count), joints in self.groups.items():
                whole = len(joints) == len(self.orders)
                quats = target if whole else np.empty((len(part), len(joints), 4))
                self._compose(part, order, count, joints, quats)
                if not whole:
                    target[:, joints] = quats
        return out

    def _compose(self, values: Array, order: str, count: int, joints: list[int], out: Array) -> None:
        one, zero = np.ones((1, 1)), np.zeros((1, 1))
        cosines, sines = [one, one, one], [zero, zero, zero]
        for slot in range(count):
            half = _columns(values, [self.rotation_columns[joint][slot] for joint in joints]) * (np.pi / 360.0)
            cosines[slot], sines[slot] = np.cos(half), np.sin(half)
        if count == 0:
            out[...] = (1.0, 0.0, 0.0, 0.0)
        else:
            compose_half_angles(tuple(cosines), tuple(sines), order, out)

    def joint_positions(self, values: Array, joint: int, rest: Array) -> Array:
        """(T, 3) local positions of ``joint`` in file units; ``rest`` (3,) where it has no channel."""
        out = np.tile(np.asarray(rest, dtype=np.float64), (len(values), 1))
        for axis, column in self.positions.get(joint, ()):
            out[:, axis] = values[:, column]
        return out


def rest_offsets(layout: ChannelLayout, values: Array, offsets: Array) -> tuple[Array, list[int]]:
    """Rest offsets (J, 3) in file units, and the joints other than the root that move in their parent's frame.

    A joint whose position channels stand still rests where they say, unless that is its OFFSET up to printing.
    """
    rest = offsets.copy()
    tolerance = position_tolerance(offsets)
    moving = []
    for joint in layout.positions:
        if joint == 0:
            continue
        places = layout.joint_positions(values, joint, offsets[joint])
        if np.all(np.abs(places - offsets[joint]) <= tolerance):
            continue
        if np.all(np.ptp(places, axis=0) <= tolerance):
            rest[joint] = places[0]
        else:
            moving.append(joint)
    return rest, moving


def position_tolerance(offsets: Array) -> float:
    """How far a position may be from a rest position and still be that position, given OFFSETs (J, 3) in file units.

    Files print about six digits, so this is a small fraction of the median bone.
    """
    lengths = np.linalg.norm(offsets[1:], axis=-1)
    lengths = lengths[lengths > 0.0]
    return _PRINTED * float(np.median(lengths)) if len(lengths) else _PRINTED


def _columns(values: Array, columns: list[int]) -> Array:
    """The named columns; a view where they are evenly spaced, as they are in nearly every file."""
    steps = np.diff(columns)
    if len(columns) > 1 and steps[0] > 0 and np.all(steps == steps[0]):
        return values[:, columns[0] : columns[-1] + 1 : int(steps[0])]
    return values[:, columns]


def euler_curves(
    rotations: Array, order: str, known: Array | None = None, keep: NDArray[np.bool_] | None = None
) -> Array:
    """Euler angles that run on from frame to frame.

    Each rotation has two triples of angles, ``(a, b, c)`` and ``(a + pi, pi - b, c + pi)``, up to whole turns. Of these
    the one closest to the frame before is taken. Whether to change over between two frames does not depend on which
    triple the first of them has, so all changes are decided at once and added up.

    Parameters
    ----------
    rotations
        (T, 4) unit quaternions.
    order
        One of the six rotation orders.
    known
        (T, 3) angles in radians that hold where ``keep`` is set; the curve starts afresh from them.
    keep
        (T,) frames at which ``known`` is right.

    Returns
    -------
    Array
        (T, 3) radians.
    """
    frames = len(rotations)
    parity = order_axes(order)[3]
    total, difference, middle, plus, minus = euler_halves(rotations, order)
    total, difference = _carried(total, plus), _carried(difference, minus)
    first = np.stack([wrap(total + difference), middle, wrap(parity * (total - difference))], axis=-1)
    second = np.stack([first[:, 0] + np.pi, np.pi - middle, first[:, 2] + np.pi], axis=-1)
    stay = np.abs(wrap(first[1:] - first[:-1])).sum(axis=-1)
    change = np.abs(wrap(second[1:] - first[:-1])).sum(axis=-1)
    changes = np.concatenate([[False], np.logical_xor.accumulate(change < stay)]) if frames > 1 else np.zeros(1, bool)
    anchors = np.full(frames, -1)
    if keep is not None and known is not None and keep.any():
        anchors = np.maximum.accumulate(np.where(keep, np.arange(frames), -1))
        mirrored = np.abs(wrap(second - known)).sum(axis=-1) < np.abs(wrap(first - known)).sum(axis=-1)
        anchored = anchors >= 0
        anchor = np.maximum(anchors, 0)
        changes ^= np.where(anchored, changes[anchor] ^ mirrored[anchor], False)
    curve = np.unwrap(np.where(changes[:, None], second, first), axis=0)
    if np.any(anchors >= 0) and known is not None:
        turns = np.round((known - curve) / (2.0 * np.pi)) * (2.0 * np.pi)
        curve += np.where((anchors >= 0)[:, None], turns[np.maximum(anchors, 0)], 0.0)
    else:
        curve += np.round((first[0] - curve[0]) / (2.0 * np.pi)) * (2.0 * np.pi)
    return curve


def _carried(angle: Array, length: Array) -> Array:
    """``angle`` (T,), with the frames at which it is undefined taking the value before (or the first after)."""
    usable = length > LOCKED
    if usable.all() or not usable.any():
        return angle if usable.any() else np.zeros_like(angle)
    last = np.maximum.accumulate(np.where(usable, np.arange(len(angle)), -1))
    return angle[np.where(last < 0, int(np.argmax(usable)), last)]
