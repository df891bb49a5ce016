"""From a folder of motion files to a list of clips: by a pattern in the files' names, or by a CSV index."""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from benchmark.errors import ConfigError, DataError

FIELDS = ("style", "actor", "action", "take")
REQUIRED = ("style", "action")
COLUMNS = ("path", *FIELDS)

#: Fields and stars of a pattern: more are never needed, and take endless to match.
MOST_WILDCARDS = 12

#: What a field may hold: an action may contain what separates the fields, a take may not, the others end as soon as they can.
_SHAPES = {"style": "[^/]+?", "actor": "[^/]+?", "action": "[^/]+", "take": "[^/_]+"}


@dataclass(frozen=True)
class Entry:
    """A motion file and what its name or the index says of it."""

    path: Path
    style: str
    actor: str
    action: str
    take: str


@dataclass(frozen=True)
class Scan:
    """What a folder holds: the files that are clips, and those that the pattern passes over."""

    entries: tuple[Entry, ...]
    unmatched: tuple[Path, ...] = ()


def compile_pattern(pattern: str) -> re.Pattern[str]:
    """A regular expression for a pattern such as ``{style}/{actor}/{action}_{take}.bvh``.

    ``{style}``, ``{actor}``, ``{action}`` and ``{take}`` stand for a part of a name, ``*`` for anything within one name and
    ``**`` for any folders. Upper and lower case are the same. An action may contain underscores, a take may not.

    Raises
    ------
    ConfigError
        An unknown or repeated field, or none for the style or the action.
    """
    # Stars in a row mean no more than two, and would be tried in every combination.
    plain = re.sub(r"(?:\*\*/){2,}", "**/", re.sub(r"\*{3,}", "**", pattern.replace("\\", "/").removeprefix("./")))
    parts = re.split(r"(\{[^{}]*\}|\*\*/?|\*)", plain)
    if len(parts) > 2 * MOST_WILDCARDS:
        raise ConfigError(f"pattern {pattern[:80]!r} has more than {MOST_WILDCARDS} fields and stars")
    expression, seen = "", []
    for part in parts:
        if part.startswith("{"):
            name = part[1:-1]
            if name not in FIELDS:
                raise ConfigError(
                    f"pattern {pattern!r} has the field {part}; the fields are {', '.join(f'{{{f}}}' for f in FIELDS)}"
                )
            if name in seen:
                raise ConfigError(f"pattern {pattern!r} has the field {part} twice")
            seen.append(name)
            expression += f"(?P<{name}>{_SHAPES[name]})"
        elif part.startswith("**"):
            expression += "(?:.*/)?" if part.endswith("/") else ".*"
        elif part == "*":
            expression += "[^/]*"
        else:
            expression += re.escape(part)
    for name in REQUIRED:
        if name not in seen:
            raise ConfigError(
                f"pattern {pattern!r} needs the field {{{name}}}: without it nobody knows the {name} of a clip"
            )
    return re.compile(expression, re.IGNORECASE)


def walk(folder: Path) -> Iterator[Path]:
    """The files below ``folder``, sorted; hidden ones are left out, links are followed, and a link to a folder above ends."""
    seen: set[tuple[int, int]] = set()
    for parent, folders, files in os.walk(folder, followlinks=True):
        status = Path(parent).stat()
        if (status.st_dev, status.st_ino) in seen:
            folders.clear()
            continue
        seen.add((status.st_dev, status.st_ino))
        folders[:] = sorted(name for name in folders if not name.startswith((".", "__MACOSX")))
        for name in sorted(files):
            if not name.startswith("."):
                yield Path(parent) / name


def scan(folder: Path, pattern: str) -> Scan:
    """The clips of a folder by pattern.

    Raises
    ------
    DataError
        There is no such folder, or no file in it fits; the message shows what is there.
    """
    if not folder.is_dir():
        raise DataError(f"there is no folder {folder}")
    expression = compile_pattern(pattern)
    suffix = Path(pattern).suffix.lower()
    entries, unmatched = [], []
    for path in walk(folder):
        name = path.relative_to(folder).as_posix()
        match = expression.fullmatch(name)
        if match is None:
            if path.suffix.lower() == suffix:
                unmatched.append(path)
            continue
        found = match.groupdict(default="")
        entries.append(Entry(path, *(found.get(field, "") for field in FIELDS)))
    if not entries:
        others = unmatched or list(walk(folder))
        shown = ", ".join(path.relative_to(folder).as_posix() for path in others[:3])
        there = f"it holds {len(others)} files such as {shown}" if others else "it is empty"
        raise DataError(
            f"no file in {folder} fits the pattern {pattern!r}; {there}. Give a pattern that fits (pattern = ... in "
            f"{folder / 'dataset.toml'}), or a CSV index with the columns {', '.join(COLUMNS)}"
        )
    return Scan(tuple(entries), tuple(unmatched))


def read_index(index: Path, folder: Path) -> Scan:
    """The clips that a CSV file lists in the columns path, style, actor, action and take (actor and take may be left out).

    Raises
    ------
    DataError
        Naming the file and line: a missing column or value, or a path that is absent or outside ``folder``.
    """
    try:
        with index.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file)
            columns = [(name or "").strip().lower() for name in reader.fieldnames or ()]
            reader.fieldnames = columns
            rows = [(reader.line_num, row) for row in reader]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise DataError(f"cannot read the index {index}: {error}") from error
    for column in ("path", *REQUIRED):
        if column not in columns:
            raise DataError(
                f"the index {index} has no column {column!r}; it needs {', '.join(COLUMNS)} (actor and take may be missing)"
            )
    entries = []
    for line, row in rows:
        values = {column: (row.get(column) or "").strip() for column in COLUMNS}
        for column in ("path", *REQUIRED):
            if not values[column]:
                raise DataError(f"{index}, line {line}: the column {column!r} is empty")
        path = folder / values["path"].replace("\\", "/")
        try:
            inside, there = path.resolve().is_relative_to(folder.resolve()), path.is_file()
        except (OSError, ValueError, RuntimeError) as error:  # a name that no file system takes, or links in a circle
            raise DataError(f"{index}, line {line}: {values['path'][:80]!r} is no path ({error})") from error
        if not inside:
            raise DataError(f"{index}, line {line}: {values['path']} lies outside {folder}")
        if not there:
            raise DataError(f"{index}, line {line}: there is no file {path}")
        entries.append(Entry(path, *(values[field] for field in FIELDS)))
    if not entries:
        raise DataError(f"the index {index} lists no clip")
    return Scan(tuple(entries))
