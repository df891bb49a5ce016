"""BVH files: strict reading, lossless writing.

Conventions of the format as read here:

* Rotation channels are listed from the outermost: ``Zrotation Xrotation Yrotation`` is ``R = Rz Rx Ry`` on column vectors.
  A joint may have from none to three of them; an absent one is zero.
* Position channels *replace* the joint's OFFSET, on the root and on every other joint; axes without a channel keep it.
* One root; joint names are unique; one row a line.

A file that departs from this raises :class:`~benchmark.errors.MotionFileError` with the line and what was expected there.
"""

from __future__ import annotations

import math
import re
import stat
from collections.abc import Mapping
from decimal import Decimal
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import ConfigError, MotionFileError, SkeletonError
from benchmark.motion._atomic import atomic_write
from benchmark.motion._bvh_channels import ChannelLayout, rest_offsets
from benchmark.motion._bvh_hierarchy import Hierarchy, name_fault, parse, render
from benchmark.motion._bvh_numbers import LARGEST, PADDING, number_in, read_values
from benchmark.motion._bvh_table import tabulate
from benchmark.motion._bvh_text import format_rows
from benchmark.motion.clip import ClipMeta, MotionClip, SourceChannels
from benchmark.motion.roles import apply_role_map, find_roles
from benchmark.motion.skeleton import EndSite, Skeleton
from benchmark.motion.units import UNITS, guess_unit

Array = NDArray[np.float64]

#: Largest file read unless told otherwise.
MAX_BYTES = 1 << 30

#: Bytes that the arrays made of a file may take per byte of the largest file read. Values of four characters and more stay
#: below; rows of single digits, and joints without channels, which take no room in the file, do not.
_EXPANSION = 4

#: The hierarchy must end within this many bytes (some twenty thousand joints).
MAX_HEADER_BYTES = 1 << 22

_TYPICAL_CHAIN = 1.1
_MOTION = re.compile(rb"^[ \t]*MOTION[ \t\r]*$", re.IGNORECASE | re.MULTILINE)
_FRAMES = re.compile(rb"\s*frames\s*:?\s*(\S*)\s*", re.IGNORECASE)
_FRAME_TIME = re.compile(rb"\s*frame[ \t]*time\s*:?\s*(\S*)\s*", re.IGNORECASE)


def load(
    path: Path | str,
    *,
    unit: str | float = "auto",
    role_map: Mapping[str, str] | None = None,
    max_bytes: int = MAX_BYTES,
) -> MotionClip:
    """Read a BVH file.

    Parameters
    ----------
    path
        A regular file; pipes and devices are refused.
    unit
        Metres per file unit, a name in :data:`~benchmark.motion.units.UNITS`, or ``"auto"``: from
        the leg length where the legs are recognised,
        else the unit of :data:`UNITS` in which the longest chain from the root to a tip comes closest, as a ratio, to
        1.1 m.
    role_map
        Role to joint name, over those that the joints' names tell.
    max_bytes
        Larger files are refused before they are read, and files whose arrays would take more than four times as much (of
        this or of :data:`MAX_BYTES`, whichever is larger) before those are made.

    Returns
    -------
    MotionClip
        Metres and quaternions. ``source`` holds the channels as read. ``translations`` is set only where a joint other
        than the root *moves* in its parent's frame; position channels that are constant in time go into the skeleton's
        offsets. ``fps`` is the whole number that the printed frame time is a rounding of, where there is exactly one,
        else its inverse.

    Raises
    ------
    MotionFileError
        Names the file, the line and what was expected.
    ConfigError, UnknownNameError
        If ``unit`` or ``role_map`` is not understood.
    """
    path = Path(path)
    metres = _named_unit(unit)
    text, size = _read_bytes(path, max_bytes)
    hierarchy, frames, frame_time, start, line, frames_line = _read_head(path, text, size)
    layout = ChannelLayout([node.channels or () for node in hierarchy.nodes])
    memory = _EXPANSION * max(max_bytes, MAX_BYTES)
    values = _read_motion(path, text, start, size, hierarchy, layout, frames, line, frames_line, memory)
    del text
    offsets = np.array([node.offset for node in hierarchy.nodes], dtype=np.float64)
    rest, moving = rest_offsets(layout, values, offsets)
    skeleton = _skeleton(hierarchy, layout, rest, role_map)
    if metres is None:
        metres = _guess_unit(path, skeleton)
    source = SourceChannels(
        channels=tuple(node.channels or () for node in hierarchy.nodes),
        values=values,
        unit=metres,
        offsets=offsets,
        frame_time=frame_time,
        end_sites=tuple(offset for _, offset in hierarchy.end_sites),
    )
    values.flags.writeable = offsets.flags.writeable = False
    return MotionClip(
        skeleton=skeleton.scaled(metres),
        rotations=layout.rotations(values),
        root=layout.joint_positions(values, 0, offsets[0]) * metres,
        fps=_rate(frame_time),
        meta=ClipMeta(source=str(path)),
        translations=_translations(layout, values, rest, moving, metres),
        source=source,
    )


def _named_unit(unit: str | float) -> float | None:
    if unit == "auto":
        return None
    value = UNITS.get(unit) if isinstance(unit, str) else float(unit)
    if value is None or not (np.isfinite(value) and value > 0.0):
        raise ConfigError(f"unit must be 'auto', metres per file unit, or one of {', '.join(UNITS)}; not {unit!r}")
    return value


def _read_bytes(path: Path, max_bytes: int) -> tuple[bytearray, int]:
    """The file with a newline at its end and padding behind, and its size with that newline."""
    try:
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            raise MotionFileError(path, "a folder; expected a BVH file")
        if not stat.S_ISREG(status.st_mode):
            raise MotionFileError(path, "a pipe or device; expected a regular file")
        if status.st_size > max_bytes:
            raise MotionFileError(path, f"{status.st_size} bytes; the limit is {max_bytes} (max_bytes)")
        text = bytearray(status.st_size + 1 + PADDING)
        with path.open("rb") as file:
            size = file.readinto(memoryview(text)[: status.st_size])
    except FileNotFoundError:
        raise MotionFileError(path, "no such file") from None
    except (OSError, ValueError) as error:
        raise MotionFileError(path, f"cannot be read ({error})") from error
    if size == 0:
        raise MotionFileError(path, "an empty file; expected HIERARCHY", line=1)
    if text.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise MotionFileError(path, "UTF-16 text; save the file as UTF-8", line=1)
    if b"\r" in text[:4096] and b"\n" not in text[:4096]:
        text = text.replace(b"\r", b"\n")  # line ends of old Macintosh files
    if not text.endswith(b"\n", 0, size):
        text[size] = ord("\n")
        size += 1
    return text, size


def _read_head(path: Path, text: bytearray, size: int) -> tuple[Hierarchy, int, float, int, int, int]:
    """Everything up to the first row.

    Returns
    -------
    hierarchy, frames, frame_time, start, line, frames_line
        ``start`` is the byte after the frame time's line and ``line`` its 1-based number.
    """
    motion = _MOTION.search(text, 0, min(size, MAX_HEADER_BYTES))
    stop = min(size, MAX_HEADER_BYTES) if motion is None else motion.start()
    head = bytes(text[:stop]).removeprefix(b"\xef\xbb\xbf")
    junk = re.search(rb"[\x00-\x08\x0e-\x1f]", head)
    if junk:
        line = head.count(b"\n", 0, junk.start()) + 1
        raise MotionFileError(path, f"byte 0x{junk.group()[0]:02x} in the hierarchy: not a text file", line=line)
    try:
        decoded = head.decode("utf-8")
    except UnicodeDecodeError:
        decoded = head.decode("latin-1")
    end = f"within its first {MAX_HEADER_BYTES} bytes" if motion is None and size > stop else ""
    hierarchy = parse(path, decoded.removesuffix("\n"), end=end)
    line = text.count(b"\n", 0, stop) + 1
    if motion is None:
        found = f"there is none {end}" if end else "the file ends"
        raise MotionFileError(path, f"expected MOTION after the hierarchy, but {found}", line=max(line - 1, 1))
    content, start, line = _next_line(text, motion.end() + 1, size, line + 1)
    frames_line = line - 1
    match = _FRAMES.fullmatch(content)
    if match is None or not re.fullmatch(rb"\d{1,18}", match[1]):
        raise MotionFileError(path, f"expected 'Frames: N', found {_shown(content)}", line=frames_line)
    frames = int(match[1])
    if frames == 0:
        raise MotionFileError(path, "expected at least one frame, found 'Frames: 0'", line=frames_line)
    content, start, line = _next_line(text, start, size, line)
    match = _FRAME_TIME.fullmatch(content)
    frame_time = None if match is None else number_in(match[1])
    if match is None or frame_time is None:
        raise MotionFileError(path, f"expected 'Frame Time: seconds', found {_shown(content)}", line=line - 1)
    if not 1e-9 <= frame_time <= 1e9:
        raise MotionFileError(path, f"expected a positive frame time, found {_shown(match[1])}", line=line - 1)
    return hierarchy, frames, frame_time, start, line, frames_line


def _next_line(text: bytearray, start: int, size: int, line: int) -> tuple[bytes, int, int]:
    """The next line that is not blank, where the one after it starts, and the number of that one."""
    while start < size:
        end = text.find(b"\n", start, size)
        content = bytes(text[start : min(end, start + 200)])
        start, line = end + 1, line + 1
        if content.strip():
            return content, start, line
    return b"", start, line


def _shown(content: bytes) -> str:
    text = content.strip()[:40].decode("utf-8", "backslashreplace")
    return repr(text) if text else "the end of the file"


def _read_motion(
    path: Path,
    text: bytearray,
    start: int,
    size: int,
    hierarchy: Hierarchy,
    layout: ChannelLayout,
    frames: int,
    line: int,
    frames_line: int,
    memory: int,
) -> Array:
    columns = layout.columns
    if columns == 0:
        raise MotionFileError(path, "no joint has a channel: there is no motion to read", line=frames_line)
    room = (size - start) // (2 * columns)
    if frames > room:
        raise MotionFileError(
            path,
            f"'Frames: {frames}' of {columns} values each, but the {size - start} bytes that follow hold {room} at most: "
            "the file is cut short or the count is wrong",
            line=frames_line,
        )
    joints = len(hierarchy.nodes)
    moving = 3 * joints if layout.positions.keys() - {0} else 0
    needed = 8 * frames * (columns + 4 * joints + moving)
    if needed > memory:
        raise MotionFileError(
            path,
            f"'Frames: {frames}' of {joints} joints would take {needed} bytes of memory; the limit is {memory} "
            f"({_EXPANSION} times max_bytes): split the file, or raise max_bytes",
            line=frames_line,
        )
    values = np.empty((frames, columns))
    rows = read_values(text, start, size, values, path=path, line=line, names=hierarchy.columns)
    if rows != frames:
        raise MotionFileError(
            path,
            f"'Frames: {frames}', but {rows} rows follow: the file is cut short, or the line should be 'Frames: {rows}'",
            line=frames_line,
        )
    return values


def _translations(layout: ChannelLayout, values: Array, rest: Array, moving: list[int], metres: float) -> Array | None:
    if not moving:
        return None
    out = np.empty((len(values), *rest.shape))
    out[...] = rest * metres
    for joint in moving:
        out[:, joint] = layout.joint_positions(values, joint, rest[joint]) * metres
    return out


def _skeleton(hierarchy: Hierarchy, layout: ChannelLayout, rest: Array, role_map: Mapping[str, str] | None) -> Skeleton:
    """The skeleton in file units, with the roles that its names or the map tell."""
    names = tuple(node.name for node in hierarchy.nodes)
    parents = np.array([node.parent for node in hierarchy.nodes])
    ends = tuple(EndSite(parent, offset) for parent, offset in hierarchy.end_sites)
    skeleton = Skeleton(names, parents, rest, ends, tuple(layout.orders), find_roles(names, parents.tolist()))
    return skeleton if role_map is None else apply_role_map(skeleton, role_map)


def _guess_unit(path: Path, skeleton: Skeleton) -> float:
    legs = [f"{side}_{part}" for side in ("left", "right") for part in ("hip", "knee", "ankle")]
    if skeleton.has(*legs) and skeleton.leg_length > 0.0:
        try:
            return guess_unit(skeleton)
        except SkeletonError as error:
            raise MotionFileError(path, str(error)) from error
    reach = skeleton.bone_lengths.copy()
    for joint in range(1, len(skeleton)):
        reach[joint] += reach[skeleton.parents[joint]]
    tips = [reach[end.parent] + float(np.linalg.norm(end.offset)) for end in skeleton.end_sites]
    longest = max([float(reach.max()), *tips])
    if longest <= 0.0:
        return UNITS["cm"]
    return min(UNITS.values(), key=lambda metres: abs(np.log(longest * metres / _TYPICAL_CHAIN)))


def _rate(frame_time: float) -> float:
    """Frames per second of a printed frame time: 30 for 0.0333333, 29.97… for 0.033367.

    The whole number whose inverse is within one unit of the last printed place, where there is just one such number and
    it is no more than 0.2 % away.
    """
    printed = Decimal(repr(frame_time))
    exponent = printed.as_tuple().exponent
    last_place = Decimal(1).scaleb(exponent if isinstance(exponent, int) else 0)
    if printed > last_place:
        lowest, highest = 1 / (printed + last_place), 1 / (printed - last_place)
        whole = int(highest)
        if whole - 1 < lowest <= whole and abs(whole * frame_time - 1.0) < 2e-3:
            return float(whole)
    return 1.0 / frame_time


def save(clip: MotionClip, path: Path | str) -> None:
    """Write ``clip`` as a BVH file, whole or not at all.

    A clip that came from a BVH file keeps that file's unit, channels, OFFSETs and frame time as far as they still fit its
    skeleton, and every channel value that still says the same (rotations to 1e-9 rad) comes back exactly, jumps over 180
    degrees and choices at gimbal lock included. What has changed is written as continuous curves, to 1e-8 degrees.

    Without such a source the file is in centimetres, with positions and rotations (in the skeleton's orders) on the root
    and rotations on all other joints; positions too where ``translations`` is set. A joint that the source gives too few
    channels for its motion gets all three. ``residual``, ``meta`` and roles are not written.

    Parameters
    ----------
    clip
        Joints are written depth first, which is the order they are read back in.
    path
        Replaced if it exists.

    Raises
    ------
    MotionFileError
        If the clip cannot be written as BVH (a joint name that would not read back) or ``path`` cannot be written.
    """
    path = Path(path)
    for name in clip.skeleton.names:
        fault = name_fault(name)
        if fault:
            raise MotionFileError(path, f"joint name {name!r} cannot be written as BVH: {fault}; rename the joint")
    table = tabulate(clip)
    largest = float(np.abs(table.values).max())
    if largest > LARGEST:
        raise MotionFileError(
            path, f"a position or angle of {largest:g} file units; at most {LARGEST:g} can be read back"
        )
    frame_time = 1.0 / clip.fps
    if table.frame_time is not None and math.isclose(_rate(table.frame_time), clip.fps, rel_tol=1e-12):
        frame_time = table.frame_time
    head = f"{render(table.hierarchy)}MOTION\nFrames: {len(clip)}\nFrame Time: {frame_time!r}\n".encode()
    if len(head) > MAX_HEADER_BYTES:
        raise MotionFileError(path, f"a hierarchy of {len(head)} bytes; at most {MAX_HEADER_BYTES} can be read back")
    atomic_write(path, (head, format_rows(table.values)))
