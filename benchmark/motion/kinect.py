"""Kinder-Gator: Kinect v1 joint positions in CSV files (Aloba et al. 2018), as clips on a rigid skeleton.

A file holds one row a frame: a time stamp in milliseconds, X, Y and Z in metres of 20 joints, the actor's number, the
action and a trailing comma. The sensor looks along its own +Z at an actor who faces it, Y is up and the frame is
right-handed, so half a turn about Y makes the actor face +Z; ``Left`` is the actor's own left and comes to lie at +X.
(Right-handers draw and throw with the joints called ``Right``, the one left-handed adult with those called ``Left``.)

Lengths of measured bones breathe by some percent and differ between actors. Clips of one actor share one rigid skeleton,
:func:`measure_skeleton`, and all skeletons share their rest directions, so that local rotations of different actors can be
compared. The distance to the measured joints is kept in :attr:`MotionClip.residual`.
"""

from __future__ import annotations

import math
import re
import stat
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import ConfigError, MotionFileError
from benchmark.motion.clip import ClipMeta, MotionClip
from benchmark.motion.ik import rotations_from_positions
from benchmark.motion.skeleton import Skeleton

Array = NDArray[np.float64]

#: The joints, in file order. A parent comes before its children, so this is the order of the skeleton too.
JOINTS: tuple[str, ...] = (
    "HipCenter",
    "Spine",
    "ShoulderCenter",
    "Head",
    *(f"{part}{side}" for side in ("Left", "Right") for part in ("Shoulder", "Elbow", "Wrist", "Hand")),
    *(f"{part}{side}" for side in ("Left", "Right") for part in ("Hip", "Knee", "Ankle", "Foot")),
)

_PARENTS = np.array([-1, 0, 1, 2, 2, 4, 5, 6, 2, 8, 9, 10, 0, 12, 13, 14, 0, 16, 17, 18])

_HEADER = ("Timestamp", *(f"{joint}{axis}" for joint in JOINTS for axis in "XYZ"), "User-ID", "Action", "")

#: Column of the actor's number; the time stamp and the coordinates lie before it.
_USER = 61

_ROLES = {
    "hips": "HipCenter",
    "spine": "Spine",
    "chest": "ShoulderCenter",
    "head": "Head",
    **{
        f"{side.lower()}_{role}": f"{joint}{side}"
        for side in ("Left", "Right")
        for role, joint in (
            ("shoulder", "Shoulder"),
            ("elbow", "Elbow"),
            ("wrist", "Wrist"),
            ("hand", "Hand"),
            ("hip", "Hip"),
            ("knee", "Knee"),
            ("ankle", "Ankle"),
            ("toe", "Foot"),
        )
    },
}

#: Rest direction of the bone that ends in each joint, left side, actor facing +Z: a T-pose whose trunk and feet point as
#: the sensor's own body model does on average over actors (hips 45 degrees below their centre, ``Spine`` behind it).
_REST = {
    "Spine": (0.0, 0.84, -0.54),
    "ShoulderCenter": (0.0, 0.991, 0.13),
    "Head": (0.0, 0.97, 0.25),
    "Shoulder": (0.83, -0.555, -0.05),
    "Elbow": (1.0, 0.0, 0.0),
    "Wrist": (1.0, 0.0, 0.0),
    "Hand": (1.0, 0.0, 0.0),
    "Hip": (0.707, -0.707, 0.018),
    "Knee": (0.0, -1.0, 0.0),
    "Ankle": (0.0, -1.0, 0.0),
    "Foot": (0.0, -0.79, 0.61),
}

#: Half a turn about Y, from the sensor's frame to the actor's.
_TO_ACTOR = np.array([-1.0, 1.0, -1.0])

#: The largest file read, in bytes. A minute of motion is under 2 MB.
MAX_BYTES = 64 * 2**20

#: The fewest frames a clip can be made of.
MIN_FRAMES = 4

#: Metres from the sensor beyond which a coordinate cannot be a measurement; the sensor sees about 4.
MAX_REACH = 20.0

#: Seconds without a frame that are still bridged by interpolation.
MAX_GAP = 0.5

#: Seconds by which a stamp may lie before the one above it and still be a frame delivered out of order.
MAX_SWAP = 0.1

_FILE_NAME = re.compile(r"POSE-p(?P<actor>\d+)_(?P<order>\d+)-(?P<action>.+)-(?P<unix>\d+)\.csv")

_STYLES = {"adults": "adult", "children": "child"}


@dataclass(frozen=True, eq=False)
class KinectRecord:
    """One file as measured.

    Attributes
    ----------
    path
        The file.
    timestamps
        (N,) seconds on the recorder's clock, as written: jittered, sometimes repeated or backward.
    positions
        (N, 20, 3) joint positions in metres, turned half about Y so that the actor faces +Z; the origin is the sensor.
    names
        The 20 joints.
    actor
        The actor's number.
    style
        ``adult`` or ``child`` from the folder, or nothing.
    action
        The action in lower case with hyphens, for example ``throw-a-ball``.
    """

    path: Path
    timestamps: Array
    positions: Array
    names: tuple[str, ...]
    actor: str
    style: str
    action: str

    @property
    def meta(self) -> ClipMeta:
        """The clip's description. There is one trial of each action, so ``take`` is always 1."""
        return ClipMeta(self.actor, self.style, self.action, "1", f"{self.path.parent.name}/{self.path.name}")

    @property
    def clock(self) -> Clock:
        """When each frame was really taken, and what was wrong with the stamps."""
        return repair_clock(self.timestamps)


@dataclass(frozen=True, eq=False)
class Clock:
    """Time stamps made usable.

    Attributes
    ----------
    order
        (N,) rows in order of time.
    times
        (N,) seconds from 0, strictly increasing, of those rows.
    period
        Median seconds between frames.
    late
        How many frames were delivered late, together with or right before the next one, and have been respaced.
    swapped
        How many stamps lay before the one above them by no more than :data:`MAX_SWAP`.
    resets
        How many times the recorder's clock was set back by more than that.
    longest_gap
        The longest time in seconds without a frame.
    strays
        How many single stamps were off by more than :data:`MAX_SWAP` while those around them were right.
    """

    order: NDArray[np.int64]
    times: Array
    period: float
    late: int
    swapped: int
    resets: int
    longest_gap: float
    strays: int = 0


def read(path: Path | str) -> KinectRecord:
    """Read a file strictly.

    Parameters
    ----------
    path
        ``Adults|Children/POSE-p<actor>_<order>-<action>-<unix ms>.csv``. Under another name, actor and action are taken
        from the file's own columns.

    Raises
    ------
    MotionFileError
        With the line and the field, if the file is not what it should be: not a regular file, too large, another header,
        rows of another length, fewer than :data:`MIN_FRAMES` frames, anything but finite numbers, coordinates beyond
        :data:`MAX_REACH`, several actors or actions, or another actor than the file's name says.
    """
    path = Path(path)
    lines = _lines(path)
    header = tuple(field.strip() for field in lines[0].split(","))
    if header != _HEADER:
        missing = [name for name in _HEADER if name not in header]
        at = next(
            (i for i, (a, b) in enumerate(zip(header, _HEADER, strict=False)) if a != b), min(len(header), len(_HEADER))
        )
        expected = repr(_HEADER[at]) if at < len(_HEADER) else "the end of the line"
        found = repr(header[at]) if at < len(header) else "the end of the line"
        lacking = f"; missing columns: {', '.join(missing[:5])}{' …' if len(missing) > 5 else ''}" if missing else ""
        raise MotionFileError(path, f"column {at + 1} of the header should be {expected}, not {found}{lacking}", line=1)
    rows = [line.split(",") for line in lines[1:]]
    for number, row in enumerate(rows, start=2):
        if len(row) != len(_HEADER) or row[-1].strip():
            raise MotionFileError(
                path, f"expected {len(_HEADER) - 1} fields and a trailing comma, found {len(row)} fields", line=number
            )
    if len(rows) < MIN_FRAMES:
        raise MotionFileError(path, f"holds {len(rows)} frames; a motion needs at least {MIN_FRAMES}")
    values = _numbers(path, rows)
    actor, action = (_constant(path, rows, column) for column in (_USER, _USER + 1))
    named = _FILE_NAME.fullmatch(path.name)
    if named:
        if named["actor"] != actor:
            raise MotionFileError(
                path, f"the file's name says actor {named['actor']}, its column User-ID says {actor}", line=2
            )
        action = named["action"]
    return KinectRecord(
        path=path,
        timestamps=values[:, 0] / 1000.0,
        positions=values[:, 1:].reshape(len(values), len(JOINTS), 3) * _TO_ACTOR,
        names=JOINTS,
        actor=actor,
        style=_STYLES.get(path.parent.name.lower(), ""),
        action=re.sub(r"[^a-z0-9]+", "-", action.lower()).strip("-"),
    )


def _lines(path: Path) -> list[str]:
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            raise MotionFileError(path, "is not a regular file")
        if status.st_size > MAX_BYTES:
            raise MotionFileError(path, f"holds {status.st_size} bytes; the limit is {MAX_BYTES}")
        text = path.read_bytes().decode("ascii")
    except OSError as error:
        raise MotionFileError(path, f"cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        raise MotionFileError(path, f"byte 0x{error.object[error.start]:02x} is not plain text", line=line) from error
    lines = text.replace("\r\n", "\n").rstrip("\n").split("\n")
    if not lines[0].strip():
        raise MotionFileError(path, "the file is empty, or its first line is", line=1)
    return lines


def _numbers(path: Path, rows: list[list[str]]) -> Array:
    """(N, 61) time stamps and coordinates."""
    try:
        values = np.array([[float(field) for field in row[:_USER]] for row in rows])
    except ValueError:
        values = np.full((len(rows), _USER), np.nan)
    # float() also takes 1_000, which no recorder writes.
    if not np.all(np.isfinite(values)) or any("_" in field for row in rows for field in row[:_USER]):
        for number, row in enumerate(rows, start=2):
            for name, field in zip(_HEADER, row[:_USER], strict=False):
                if not _is_number(field):
                    raise MotionFileError(path, f"field {name} is {field.strip()!r}, not a finite number", line=number)
    far = np.abs(values[:, 1:]) > MAX_REACH
    if np.any(far):
        frame, column = (int(i) for i in np.argwhere(far)[0])
        raise MotionFileError(
            path,
            f"field {_HEADER[column + 1]} is {values[frame, column + 1]:g} m, beyond what the sensor can see "
            f"({MAX_REACH:g} m); coordinates must be in metres",
            line=frame + 2,
        )
    return values


def _is_number(field: str) -> bool:
    try:
        return "_" not in field and math.isfinite(float(field))
    except ValueError:
        return False


def _constant(path: Path, rows: list[list[str]], column: int) -> str:
    first = rows[0][column].strip()
    if not first:
        raise MotionFileError(path, f"field {_HEADER[column]} is empty", line=2)
    for number, row in enumerate(rows, start=2):
        if row[column].strip() != first:
            raise MotionFileError(
                path, f"field {_HEADER[column]} is {row[column].strip()!r} here and {first!r} on line 2", line=number
            )
    return first


def repair_clock(timestamps: Array) -> Clock:
    """Times at which frames were taken, from the stamps put on them when they arrived.

    The sensor takes frames at a steady rate; the recorder stamps them when they come in. Sometimes it is busy and then
    takes two at once: a long step is followed by one of nothing. Both frames are real (the pose moves on), so none is
    dropped or averaged. The rules, in order:

    1. A stamp up to :data:`MAX_SWAP` seconds before the one above it belongs to a frame delivered out of order: rows are
       sorted by stamp, equal ones keeping their order.
    2. A stamp further back means that the clock was set back: rows keep their order and later stamps move on so that the
       step becomes one median period. Where a single stamp is wrong, those around it being no more than three periods
       apart, it takes the middle between them instead.
    3. A step shorter than half a period cannot be the sensor's. It is spread evenly with the steps before it, as many as
       it takes for their mean to reach three quarters of a period; at the start of the file, where there are none left,
       each becomes one period and the first frames move back.

    Parameters
    ----------
    timestamps
        (N,) seconds, N of at least 2.

    Raises
    ------
    ConfigError
        If no two stamps differ.
    """
    stamps = np.array(timestamps, dtype=np.float64)
    steps = np.diff(stamps)
    if not np.any(steps > 0.0):
        raise ConfigError("the time stamps never advance")
    period = float(np.median(steps[steps > 0.0]))
    backward = steps < 0.0
    resets = np.flatnonzero(steps < -MAX_SWAP)
    strays = 0
    for at in resets:
        for lone in (at, at + 1):
            if 0 < lone < len(stamps) - 1 and 0.0 <= stamps[lone + 1] - stamps[lone - 1] <= 3.0 * period:
                stamps[lone] = 0.5 * (stamps[lone - 1] + stamps[lone + 1])
                strays += 1
                break
        else:
            stamps[at + 1 :] += stamps[at] + period - stamps[at + 1]
    order = np.argsort(stamps, kind="stable")
    steps = np.diff(stamps[order])
    longest_gap = float(steps.max())
    late = steps < 0.5 * period
    for at in np.flatnonzero(late):
        first = at
        while first >= 0 and steps[first : at + 1].mean() < 0.75 * period:
            first -= 1
        if first < 0:
            steps[: at + 1] = period
        else:
            steps[first : at + 1] = steps[first : at + 1].mean()
    times = np.concatenate([[0.0], np.cumsum(steps)])
    swapped = int(backward.sum()) - len(resets)
    return Clock(order, times, period, int(late.sum()), swapped, len(resets) - strays, longest_gap, strays)


def measure_skeleton(paths: Iterable[Path | str]) -> Skeleton:
    """The rigid skeleton of one actor.

    Each bone is as long as its median over all frames of all files, the mean of left and right: people are nearly
    symmetric and the sensor's sides are not. Rest directions are the same for every actor, a T-pose facing +Z with the
    left at +X.

    Parameters
    ----------
    paths
        Files of one actor.

    Returns
    -------
    20 joints with offsets in metres and roles; the root's rest height puts the feet on the floor.

    Raises
    ------
    MotionFileError
        If a file cannot be read or belongs to another actor than the first.
    ConfigError
        If there are no files.
    """
    records = [read(path) for path in paths]
    if not records:
        raise ConfigError("a skeleton cannot be measured from no files")
    for record in records[1:]:
        if record.actor != records[0].actor:
            raise MotionFileError(
                record.path, f"belongs to actor {record.actor}, not {records[0].actor}: measure one actor at a time"
            )
    return _skeleton(np.concatenate([record.positions for record in records]))


def _skeleton(positions: Array) -> Skeleton:
    lengths = np.median(np.linalg.norm(positions[:, 1:] - positions[:, _PARENTS[1:]], axis=-1), axis=0)
    lengths = np.concatenate([[0.0], lengths])
    offsets = np.zeros((len(JOINTS), 3))
    for joint, name in enumerate(JOINTS[1:], start=1):
        part, side = re.fullmatch(r"(\w+?)(Left|Right)?", name).groups()  # type: ignore[union-attr]
        direction = np.array(_REST[part if side else name])
        length = lengths[joint]
        if side:
            twin = JOINTS.index(part + ("Right" if side == "Left" else "Left"))
            length = 0.5 * (lengths[joint] + lengths[twin])
            direction = direction * [1.0 if side == "Left" else -1.0, 1.0, 1.0]
        offsets[joint] = length * direction / np.linalg.norm(direction)
    heights = np.zeros(len(JOINTS))
    for joint in range(1, len(JOINTS)):
        heights[joint] = heights[_PARENTS[joint]] + offsets[joint, 1]
    offsets[0, 1] = -heights.min()
    return Skeleton(JOINTS, _PARENTS, offsets, roles={role: JOINTS.index(name) for role, name in _ROLES.items()})


def load(path: Path | str, *, skeleton: Skeleton | None = None, fps: float = 30.0) -> MotionClip:
    """Read a file as a clip on a rigid skeleton and a uniform clock.

    Frames are put in time by :func:`repair_clock`, joint positions are interpolated by cubic splines at ``1 / fps`` from
    the first frame on (gaps up to :data:`MAX_GAP` included; :attr:`KinectRecord.clock` tells the longest), and rotations
    follow from the positions by :func:`benchmark.motion.ik.rotations_from_positions`.

    Parameters
    ----------
    path
        The file, as for :func:`read`.
    skeleton
        The actor's, from :func:`measure_skeleton`; measured from this file alone where ``None``.
    fps
        Frames per second of the clip.

    Returns
    -------
    A clip in metres, Y up, the actor facing +Z about 3 m in front of the sensor, which is the origin.

    Raises
    ------
    MotionFileError
        As :func:`read`, and if there is a longer gap than :data:`MAX_GAP`.
    ConfigError
        If ``fps`` is not positive or the skeleton has other joints than the sensor's.
    """
    if not (math.isfinite(fps) and fps > 0.0):
        raise ConfigError(f"fps must be positive, not {fps}")
    record = read(path)
    if skeleton is None:
        skeleton = _skeleton(record.positions)
    elif skeleton.names != JOINTS or not np.array_equal(skeleton.parents, _PARENTS):
        raise ConfigError(f"the skeleton's joints are not the sensor's: expected {', '.join(JOINTS)}")
    rotations, root, residual = rotations_from_positions(skeleton, _resampled(record, fps))
    return MotionClip(skeleton, rotations, root, fps, meta=record.meta, residual=residual)


def _resampled(record: KinectRecord, fps: float) -> Array:
    """(T, 20, 3) positions on a uniform clock."""
    from scipy.interpolate import CubicSpline

    try:
        clock = record.clock
    except ConfigError as error:
        raise MotionFileError(record.path, f"column Timestamp: {error}") from error
    if clock.longest_gap > MAX_GAP:
        row = int(np.argmax(np.diff(record.timestamps[clock.order])))
        raise MotionFileError(
            record.path,
            f"no frame for {clock.longest_gap:.2f} s before this one; gaps over {MAX_GAP:g} s cannot be bridged",
            line=int(clock.order[row + 1]) + 2,
        )
    frames = int(np.floor(clock.times[-1] * fps + 1e-6)) + 1
    times = np.minimum(np.arange(frames) / fps, clock.times[-1])
    return CubicSpline(clock.times, record.positions[clock.order], axis=0)(times)
