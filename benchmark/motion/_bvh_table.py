"""What goes into a BVH file: which channels, and their values."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.motion._bvh_channels import SAME_ROTATION, ChannelLayout, euler_curves, position_tolerance, rest_offsets
from benchmark.motion._bvh_hierarchy import CHANNELS, Hierarchy, Node
from benchmark.motion._bvh_text import DECIMALS
from benchmark.motion.clip import MotionClip, SourceChannels
from benchmark.motion.skeleton import Skeleton

Array = NDArray[np.float64]
Triple = tuple[float, float, float]

_CENTIMETRE = 0.01
_POSITIONS = CHANNELS[:3]
# Relative difference up to which a length is the one that the file had, converted to metres and back.
_SAME_LENGTH = 1e-9
# An angle in degrees that its lack of a channel leaves at zero.
_SAME_DEGREES = 1e-8


@dataclass
class Table:
    """A hierarchy in depth-first order, its (T, C) channel values, and the frame time of the source, if any."""

    hierarchy: Hierarchy
    values: Array
    frame_time: float | None


def tabulate(clip: MotionClip) -> Table:
    """Lay ``clip`` out as channels; see :func:`benchmark.motion.bvh.save` for the rules."""
    source = clip.source if clip.source is not None and _fits(clip.skeleton, clip.source) else None
    unit = _CENTIMETRE if source is None else source.unit
    given = _default_channels(clip) if source is None else list(source.channels)
    old = ChannelLayout(given)
    raw = None
    if source is not None and np.shape(source.values) == (len(clip), old.columns):
        raw = np.asarray(source.values, dtype=np.float64)

    angles = _changed_rotations(clip, old, raw)
    places = _changed_positions(clip, old, raw, unit, source)
    channels = [
        _needed(names, order, angles.get(joint), places.get(joint), None if source is None else source.offsets[joint])
        for joint, (names, order) in enumerate(zip(given, clip.skeleton.orders, strict=True))
    ]
    new = ChannelLayout(channels)
    values = _carried_over(given, channels, raw, len(clip), new.columns)
    for joint, triple in angles.items():
        columns = new.rotation_columns[joint]
        values[:, columns] = triple[:, : len(columns)]
    for joint, place in places.items():
        for axis, column in new.positions.get(joint, ()):
            values[:, column] = place[:, axis]

    joints = _depth_first(clip.skeleton.parents)
    if joints != list(range(len(joints))):
        first = np.cumsum([0, *map(len, channels)])
        values = values[:, [c for joint in joints for c in range(first[joint], first[joint + 1])]]
    hierarchy = _hierarchy(clip.skeleton, joints, channels, source, raw, unit)
    return Table(hierarchy, values, None if source is None else source.frame_time)


def _fits(skeleton: Skeleton, source: SourceChannels) -> bool:
    """Whether the channels of ``source`` are those of ``skeleton``."""
    return len(source.channels) == len(skeleton) and ChannelLayout(source.channels).orders == list(skeleton.orders)


def _default_channels(clip: MotionClip) -> list[tuple[str, ...]]:
    return [
        (*(_POSITIONS if joint == 0 or clip.translations is not None else ()), *_rotation_names(order))
        for joint, order in enumerate(clip.skeleton.orders)
    ]


def _rotation_names(order: str) -> tuple[str, ...]:
    return tuple(f"{axis}rotation" for axis in order)


def _changed_rotations(clip: MotionClip, layout: ChannelLayout, raw: Array | None) -> dict[int, Array]:
    """Joint to (T, 3) degrees for every joint whose rotation the raw channels do not give at every frame."""
    joints = range(len(clip.skeleton))
    if raw is None:
        return {
            joint: _rounded(np.degrees(euler_curves(clip.rotations[:, joint], clip.skeleton.orders[joint])))
            for joint in joints
        }
    said = layout.rotations(raw)
    if np.array_equal(said, clip.rotations):
        return {}
    apart = np.minimum(
        np.abs(said - clip.rotations).max(axis=-1),
        np.abs(said + clip.rotations).max(axis=-1),
    )
    keep = apart <= SAME_ROTATION
    changed = {}
    for joint in np.flatnonzero(~keep.all(axis=0)).tolist():
        known = np.zeros((len(clip), 3))
        known[:, : layout.rotation_axes[joint]] = raw[:, layout.rotation_columns[joint]]
        kept = keep[:, joint]
        curve = euler_curves(clip.rotations[:, joint], clip.skeleton.orders[joint], np.radians(known), kept)
        changed[joint] = np.where(kept[:, None], known, _rounded(np.degrees(curve)))
    return changed


def _rounded(values: Array) -> Array:
    return np.round(values, DECIMALS)


def _changed_positions(
    clip: MotionClip, layout: ChannelLayout, raw: Array | None, unit: float, source: SourceChannels | None
) -> dict[int, Array]:
    """Joint to (T, 3) local positions in file units, for every joint whose positions the raw channels do not give."""
    changed = {}
    moving: list[int] = []
    tolerance = 0.0
    if raw is not None and source is not None:
        moving = rest_offsets(layout, raw, source.offsets)[1]
        tolerance = 2.0 * position_tolerance(source.offsets)
    for joint in range(len(clip.skeleton)):
        if joint == 0:
            wanted = clip.root / unit
        elif clip.translations is not None:
            wanted = clip.translations[:, joint] / unit
        elif joint in layout.positions:
            wanted = np.tile(clip.skeleton.offsets[joint] / unit, (len(clip), 1))
        else:
            continue
        if joint not in layout.positions and np.all(_same_length(wanted, clip.skeleton.offsets[joint] / unit)):
            continue
        if raw is None or source is None:
            changed[joint] = _rounded(wanted)
            continue
        said = layout.joint_positions(raw, joint, source.offsets[joint])
        if joint == 0 or joint in moving:
            same = _same_length(wanted, said)
        else:
            same = np.abs(wanted - said) <= tolerance
        if not same.all():
            changed[joint] = np.where(same, said, _rounded(wanted))
    return changed


def _same_length(a: Array, b: Array) -> NDArray[np.bool_]:
    return np.abs(a - b) <= _SAME_LENGTH * (1.0 + np.abs(b))


def _needed(
    names: tuple[str, ...], order: str, angles: Array | None, places: Array | None, offset: Array | None
) -> tuple[str, ...]:
    """``names``, with all three rotations or positions where fewer cannot hold the motion."""
    rotations = tuple(name for name in names if name.endswith("rotation"))
    positions = tuple(name for name in names if name.endswith("position"))
    enough = True
    if angles is not None and np.any(np.abs(angles[:, len(rotations) :]) > _SAME_DEGREES):
        rotations, enough = _rotation_names(order), False
    if places is not None:
        fixed = [axis for axis in range(3) if _POSITIONS[axis] not in positions]
        if offset is None or not np.all(_same_length(places[:, fixed], offset[fixed])):
            positions, enough = _POSITIONS, enough and not fixed
    return names if enough else (*positions, *rotations)


def _carried_over(
    given: list[tuple[str, ...]], channels: list[tuple[str, ...]], raw: Array | None, frames: int, columns: int
) -> Array:
    """The raw values in the columns of ``channels``; zero where there were none."""
    if raw is not None and given == channels:
        return raw.copy()
    values = np.zeros((frames, columns))
    if raw is not None:
        old = {key: at for at, key in enumerate((j, name) for j, names in enumerate(given) for name in names)}
        for at, key in enumerate((j, name) for j, names in enumerate(channels) for name in names):
            if key in old:
                values[:, at] = raw[:, old[key]]
    return values


def _depth_first(parents: NDArray[np.int64]) -> list[int]:
    children: dict[int, list[int]] = {}
    for joint, parent in enumerate(parents.tolist()):
        children.setdefault(parent, []).append(joint)
    out, stack = [], [0]
    while stack:
        joint = stack.pop()
        out.append(joint)
        stack.extend(reversed(children.get(joint, [])))
    return out


def _hierarchy(
    skeleton: Skeleton,
    joints: list[int],
    channels: list[tuple[str, ...]],
    source: SourceChannels | None,
    raw: Array | None,
    unit: float,
) -> Hierarchy:
    offsets = _rounded(skeleton.offsets / unit)
    ends = [_rounded(np.array(end.offset) / unit) for end in skeleton.end_sites]
    if source is not None:
        written = np.asarray(source.offsets, dtype=np.float64)
        rest = written if raw is None else rest_offsets(ChannelLayout(source.channels), raw, written)[0]
        exact = skeleton.offsets / unit
        keep = np.all(_same_length(exact, written) | _same_length(exact, rest), axis=-1)
        keep[0] = True  # the root's position channels, or the clip's root, say where it is
        offsets[keep] = written[keep]
        if len(source.end_sites) == len(ends):
            for at, (end, before) in enumerate(zip(skeleton.end_sites, source.end_sites, strict=True)):
                if np.all(_same_length(np.array(end.offset) / unit, np.array(before))):
                    ends[at] = np.array(before)
    index = {joint: at for at, joint in enumerate(joints)}
    hierarchy = Hierarchy()
    for joint in joints:
        parent = index.get(int(skeleton.parents[joint]), -1)
        hierarchy.nodes.append(Node(skeleton.names[joint], parent, 0, _triple(offsets[joint]), channels[joint]))
    hierarchy.end_sites = [
        (index[end.parent], _triple(offset)) for end, offset in zip(skeleton.end_sites, ends, strict=True)
    ]
    return hierarchy


def _triple(values: Array) -> Triple:
    x, y, z = values.tolist()
    return x, y, z
