"""The user's own motion files: a folder, a pattern or an index, and a few settings."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from benchmark.data.base import ClipRecord
from benchmark.data.cache import file_digests
from benchmark.data.cards import Card, load_card
from benchmark.data.files import FileDataset, kinect_skeleton, kinect_skeleton_key, unique
from benchmark.data.index import Scan, compile_pattern, read_index, scan
from benchmark.data.locate import data_root
from benchmark.digest import digest as json_digest
from benchmark.errors import ConfigError, DataError, UnknownNameError
from benchmark.motion.clip import MotionClip
from benchmark.motion.skeleton import CORE_ROLES, Skeleton
from benchmark.toml import parse_toml

SETTINGS = "dataset.toml"


class FolderSettings(BaseModel):
    """What a ``dataset.toml`` in the folder may say; options given by name come before it.

    Attributes
    ----------
    pattern, index
        How files become clips: see :func:`benchmark.data.index.compile_pattern`, or a CSV file in the folder.
    unit
        ``auto``, ``cm``, ``m``, ``cmu``, or metres per file unit.
    fps
        Working frame rate; the lowest of the files' where it is not given.
    trim
        Whether a T-pose prefix is cut.
    retarget
        Whether clips whose joints differ from the first clip's are brought onto its joints, at their own size.
    role_map
        A TOML file with a table ``[roles]``, relative to the folder.
    roles
        The same table, in the settings themselves.
    styles
        Other names for styles as they are found, for example ``neutral = "adult"``.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
    pattern: str | None = None
    index: str | None = None
    unit: Literal["auto", "cm", "m", "cmu"] | float = "auto"
    fps: float | None = Field(default=None, gt=0.0, le=1000.0)
    trim: bool = True
    retarget: bool = False
    role_map: str | None = None
    roles: dict[str, str] = {}
    styles: dict[str, str] = {}


@dataclass(frozen=True)
class Outline:
    """What the head of a BVH file says; ``fps`` is rounded to a whole number where it is within 0.1 % of one."""

    names: tuple[str, ...]
    parents: tuple[int, ...]
    fps: float


class FolderDataset(FileDataset):
    """A folder of BVH files, or of CSV files in Kinder-Gator's columns.

    Styles and actions are taken in lower case. All clips must have the same joints (see ``retarget``), among them the core
    roles.

    Parameters
    ----------
    path
        The folder.
    options
        Settings of :class:`FolderSettings` that come before those in the folder's ``dataset.toml``.

    Raises
    ------
    DataError
        No file fits, two files are one clip, or files differ in their joints; files are named.
    ConfigError
        A setting is unknown or wrong.
    """

    def __init__(
        self,
        path: Path,
        *,
        pattern: str | None = None,
        index: str | None = None,
        unit: str | float | None = None,
        fps: float | None = None,
        trim: bool | None = None,
        retarget: bool | None = None,
        role_map: str | None = None,
        styles: Mapping[str, str] | None = None,
    ) -> None:
        self.folder = Path(path).expanduser().absolute()  # a method may change the working directory
        if not self.folder.is_dir():
            raise DataError(f"there is no folder {self.folder}")
        given = {
            "pattern": pattern,
            "index": index,
            "unit": unit,
            "fps": fps,
            "trim": trim,
            "retarget": retarget,
            "role_map": role_map,
            "styles": None if styles is None else dict(styles),
        }
        self.settings = _settings(self.folder, {key: value for key, value in given.items() if value is not None})
        self._require_usable()

    @property
    def id(self) -> str:
        """``folder:NAME``: results do not depend on where the folder lies."""
        return f"folder:{self.folder.resolve().name}"

    @property
    def card(self) -> Card:
        """The card of all folders."""
        return load_card("folder")

    @property
    def options(self) -> Mapping[str, Any]:
        """The settings that change what a clip looks like."""
        settings = self.settings
        return {"unit": settings.unit, "trim": settings.trim, "retarget": settings.retarget, "roles": self._roles}

    @cached_property
    def scan(self) -> Scan:
        """The files that are clips, and those that are not."""
        if self.settings.index is not None:
            return read_index(self.folder / self.settings.index, self.folder)
        return scan(self.folder, self.settings.pattern or self.card.pattern)

    @cached_property
    def records(self) -> tuple[ClipRecord, ...]:
        """Every clip."""
        entries = self.scan.entries
        memo = f"folder-{json_digest(str(self.folder.resolve()))[:12]}"
        digests = file_digests([entry.path for entry in entries], memo=memo)
        return unique(
            (
                ClipRecord.of(
                    actor=entry.actor,
                    style=self._style(entry.style),
                    action=entry.action.lower(),
                    take=entry.take,
                    path=entry.path,
                    sha256=digests[entry.path],
                )
                for entry in entries
            ),
            self.id,
        )

    def _style(self, found: str) -> str:
        names = {key.lower(): value for key, value in self.settings.styles.items()}
        return names.get(found.lower(), found).lower()

    @cached_property
    def fps(self) -> float:
        """The working rate that was set, or the lowest of the files'."""
        if self.settings.fps is not None:
            return float(self.settings.fps)
        rates = [outline.fps for outline in self._outlines.values() if outline is not None]
        return min(rates) if rates else 30.0

    @cached_property
    def _roles(self) -> dict[str, str]:
        from benchmark.motion.roles import load_role_map

        if self.settings.role_map is None:
            return dict(self.settings.roles)
        return {**load_role_map(self.folder / self.settings.role_map), **self.settings.roles}

    @cached_property
    def _outlines(self) -> dict[str, Outline | None]:
        return {record.clip_id: outline(record.path) for record in self.records if record.path is not None}

    def _require_usable(self) -> None:
        """Find files with other joints, or without the joints that every method needs, before anything is computed."""
        from benchmark.motion.roles import find_roles

        first: tuple[ClipRecord, Outline] | None = None
        seen: set[tuple[str, ...]] = set()
        for record in self.records:
            found = self._outlines[record.clip_id]
            if found is None:
                continue
            if found.names not in seen:
                seen.add(found.names)
                roles = set(find_roles(found.names, found.parents))
                mapped = {role for role, joint in self._roles.items() if joint in found.names}
                lacking = [role for role in CORE_ROLES if role not in roles | mapped]
                if lacking:
                    raise DataError(
                        f"{record.path}: no joint is known to be the {', '.join(lacking)} (joints: {', '.join(found.names)}); "
                        f'name them in {self.folder / SETTINGS} under [roles], for example {lacking[0]} = "{found.names[0]}"'
                    )
            if first is None:
                first = record, found
            elif (found.names, found.parents) != (first[1].names, first[1].parents) and not self.settings.retarget:
                differing = sorted(set(found.names) ^ set(first[1].names))
                what = f"joints {', '.join(differing[:6])}" if differing else "the order or the parents of the joints"
                raise DataError(
                    f"{record.path} and {first[0].path} differ in {what}: methods need the same joints in every clip. Set "
                    f"retarget = true in {self.folder / SETTINGS} to bring all clips onto the joints of the first"
                )

    def reading(self, record: ClipRecord) -> Mapping[str, Any]:
        """The options, and the clip whose joints the others are brought onto."""
        return {
            **self.options,
            "onto": self.records[0].sha256 if self.settings.retarget else "",
            "measured": kinect_skeleton_key(self._captures_of(record)) if _is_capture(record) else "",
        }

    def read(self, record: ClipRecord) -> MotionClip:
        """Read one file."""
        clip = self._canonical(record)
        if self.settings.retarget and not clip.skeleton.same_topology(self._joints):
            from benchmark.motion.retarget import retarget

            own_size = self._joints.scaled(clip.skeleton.leg_length / self._joints.leg_length)
            clip = retarget(clip, own_size)
        return clip

    def _captures_of(self, record: ClipRecord) -> list[ClipRecord]:
        """The position captures of the same actor, or this one alone where the actor is not known."""
        if not record.actor:
            return [record]
        return [other for other in self.records if other.actor == record.actor and _is_capture(other)]

    @cached_property
    def _measured(self) -> dict[str, Skeleton]:
        return {}

    @cached_property
    def _joints(self) -> Skeleton:
        return self._canonical(self.records[0]).skeleton

    def _canonical(self, record: ClipRecord) -> MotionClip:
        from benchmark.motion.canonical import canonicalise
        from benchmark.motion.roles import apply_role_map

        assert record.path is not None
        if _is_capture(record):
            from benchmark.motion import kinect

            actor = record.actor or record.clip_id
            if actor not in self._measured:
                self._measured[actor] = kinect_skeleton(self._captures_of(record))
            clip = kinect.load(record.path, skeleton=self._measured[actor], fps=self.fps)
            if self._roles:
                clip = clip.replace(skeleton=apply_role_map(clip.skeleton, self._roles))
        else:
            from benchmark.motion import bvh

            unit = self.settings.unit
            clip = bvh.load(record.path, unit=unit, role_map=self._roles or None)
        return canonicalise(clip, fps=self.fps, trim=self.settings.trim)


class Adult2Child(FolderDataset):
    """The optical capture of the Adult2child paper (Dong et al. 2020), from the user's own copy.

    Parameters
    ----------
    root
        The folder; ``adult2child`` in the folder named by ``BENCHMARK_DATA`` where it is not given.
    options
        As for :class:`FolderDataset`; clips work at the paper's 60 frames per second unless told otherwise.
    """

    def __init__(self, root: Path | None = None, **options: Any) -> None:
        card = load_card("adult2child")
        if root is None:
            named = data_root()
            root = None if named is None else named / card.id
            if root is None or not root.is_dir():
                raise DataError(f"there is no copy of data set {card.id}. {card.how_to_get}")
        elif (root / card.id).is_dir():
            root = root / card.id
        options.setdefault("styles", {"adults": "adult", "children": "child", "kid": "child", "kids": "child"})
        super().__init__(root, **options)

    @property
    def id(self) -> str:
        """``adult2child``."""
        return "adult2child"

    @property
    def card(self) -> Card:
        """Licence, citation and traps."""
        return load_card("adult2child")

    @cached_property
    def fps(self) -> float:
        """The paper's 60 unless set."""
        return float(self.settings.fps or self.card.working_fps or 60.0)


def _is_capture(record: ClipRecord) -> bool:
    return record.path is not None and record.path.suffix.lower() == ".csv"


def _settings(folder: Path, given: Mapping[str, Any]) -> FolderSettings:
    path = folder / SETTINGS
    written: dict[str, Any] = {}
    if path.is_file():
        try:
            written = parse_toml(path.read_text(encoding="utf-8-sig"))
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise ConfigError(f"{path}: is not TOML: {error}") from error
    known = FolderSettings.model_fields
    for key in written:
        if key not in known:
            raise ConfigError(f"{path}: {UnknownNameError('setting', key, known)}")
    if "pattern" in given:
        written.pop("index", None)
    try:
        settings = FolderSettings.model_validate({**written, **given})
    except ValidationError as error:
        first = error.errors()[0]
        raise ConfigError(
            f"{path if first['loc'][0] not in given else 'option'}: {first['loc'][0]}: {first['msg']}"
        ) from error

    def where(key: str) -> str:
        return "" if key in given else f"{path}: "

    if isinstance(settings.unit, float) and not 0.0 < settings.unit < float("inf"):
        raise ConfigError(
            f"{where('unit')}unit must be auto, cm, m, cmu or metres per file unit above 0, not {settings.unit}"
        )
    if settings.pattern:
        try:
            compile_pattern(settings.pattern)
        except ConfigError as error:
            raise ConfigError(f"{where('pattern')}{error}") from error
    return settings


#: A BVH hierarchy of a thousand joints takes less; a file without MOTION in its first part is no BVH.
_HEAD = 1 << 20
_LINE = re.compile(rb"^\s*(?:(ROOT|JOINT)\s+(.+?)|(End\s+Site).*?|([{}]))\s*$", re.IGNORECASE | re.MULTILINE)
_RATE = re.compile(rb"Frame\s+Time\s*:\s*([-+.\deE]+)", re.IGNORECASE)


def outline(path: Path) -> Outline | None:
    """Joints, parents and rate from the head of a BVH file; ``None`` for a file that is not one, which reading will explain."""
    if path.suffix.lower() != ".bvh":
        return None
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD)
    except OSError as error:
        raise DataError(f"cannot read {path} ({error.strerror})") from error
    hierarchy, motion, rest = head.partition(b"MOTION")
    rate = _RATE.search(rest)
    if not motion or rate is None:
        return None
    names: list[str] = []
    parents: list[int] = []
    stack: list[int] = []
    current = -1
    for keyword, name, end, brace in _LINE.findall(hierarchy):
        if keyword:
            parents.append(stack[-1] if stack else -1)
            names.append(name.decode("utf-8", "replace"))
            current = len(names) - 1
        elif end:
            current = -2
        elif brace == b"{":
            stack.append(current)
        elif stack:
            stack.pop()
    try:
        fps = 1.0 / float(rate[1])
    except (ValueError, ZeroDivisionError):
        return None
    if not names or not 0.0 < fps < float("inf"):
        return None
    return Outline(tuple(names), tuple(parents), float(round(fps)) if abs(fps - round(fps)) < 1e-3 * fps else fps)
