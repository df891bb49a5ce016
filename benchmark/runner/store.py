"""The run folder on disk: cells that are whole or absent, a lock, and atomic files.

A cell is written beside its place and renamed into it, ``status.json`` last: it lists size, modification time and SHA-256 of
every other file. Whatever moment a run is killed at, a cell is either complete or will be made again.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmark.digest import digest, file_digest
from benchmark.errors import ConfigError, StoreError
from benchmark.runner.locking import held, is_held, try_lock, unlock

STATUS = "status.json"

#: Files of a cell that scoring adds later; they carry their own marker.
SCORES = "metrics.parquet"
SCORES_MARK = "metrics.json"
_LATER = {STATUS, SCORES, SCORES_MARK}

#: How a cell can have ended.
ENDS = ("ok", "skipped", "failed")

#: Name under which facts carry the digest of all others.
SEAL = "seal"


@dataclass(frozen=True)
class CellStatus:
    """What is known of a stored cell.

    Attributes
    ----------
    state
        ``ok``, ``skipped``, ``failed``, ``missing`` or ``damaged``.
    reason
        Why, for all but ``ok``.
    facts
        The rest of ``status.json``.
    """

    state: str
    reason: str = ""
    facts: Mapping[str, Any] = field(default_factory=dict)


class RunStore:
    """A run folder.

    Parameters
    ----------
    folder
        Made if it is not there.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.cells = folder / "cells"

    def cell(self, key: str) -> Path:
        """The folder of a cell, whether it exists or not."""
        return self.cells / key

    def work(self, key: str) -> Path:
        """Where a method may keep checkpoints while it fits; survives interruption, removed when the cell is stored."""
        return self.cells / f".work-{key}"

    def status(self, key: str, *, thorough: bool = False) -> CellStatus:
        """The state of a cell, after comparing its files with its marker.

        A file is compared by size and modification time, and by SHA-256 where the time has moved (as it does when a folder is
        copied) or ``thorough`` is set.
        """
        folder = self.cell(key)
        if not folder.is_dir():
            return CellStatus("missing", "not run yet")
        try:
            facts = unsealed(json.loads((folder / STATUS).read_bytes()))
            files: dict[str, list] = facts.pop("files")
            present = {
                path.relative_to(folder).as_posix(): path
                for path in folder.rglob("*")
                if path.is_file()
                and not path.name.startswith(".")
                and path.relative_to(folder).as_posix() not in _LATER
            }
            problem = _compare(files, present, thorough)
            if problem is None and facts["key"] != key:
                problem = f"{STATUS} is of another cell"
            state, reason = facts["state"], facts["reason"]
            if state not in ENDS or not isinstance(reason, str):
                raise ValueError(f"the state is {state!r}")
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            return CellStatus("damaged", f"{STATUS} cannot be read ({error})")
        if problem is not None:
            return CellStatus("damaged", problem)
        return CellStatus(state, reason, facts)

    @contextlib.contextmanager
    def writing(self, key: str) -> Iterator[Path]:
        """A temporary folder for a cell's files; removed unless :meth:`commit` took it."""
        self.cells.mkdir(parents=True, exist_ok=True)
        folder = self.cells / f".tmp-{key}-{os.getpid()}"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def commit(
        self, key: str, folder: Path, state: str, reason: str = "", facts: Mapping[str, Any] | None = None
    ) -> None:
        """Mark ``folder`` as complete and move it into the place of the cell, replacing what was there."""
        reason = printable(reason)
        files = {}
        for path in sorted(folder.rglob("*")):
            if path.is_file() and not path.name.startswith("."):
                stat = path.stat()
                files[path.relative_to(folder).as_posix()] = [stat.st_size, stat.st_mtime_ns, file_digest(path)]
        status = {**(facts or {}), "key": key, "state": state, "reason": reason, "files": files}
        write_json(folder / STATUS, sealed(status))
        self._place(key, folder)
        if state != "failed":
            shutil.rmtree(self.work(key), ignore_errors=True)
        elif self.work(key).is_dir() and not any(self.work(key).iterdir()):
            self.work(key).rmdir()

    def adopt(self, key: str, folder: Path) -> CellStatus:
        """Take a cell that another machine or run made: compare every file with its digest, then move it into its place.

        Parameters
        ----------
        key
            Which cell it must be.
        folder
            Its files, on this store's disk and in a folder ``cells`` of its own; gone afterwards.

        Raises
        ------
        StoreError
            If the cell is not whole, or is another one.
        """
        found = RunStore(folder.parents[1]).status(key, thorough=True)
        if folder.name != key or found.state not in ("ok", "skipped", "failed"):
            raise StoreError(f"cell {key[:12]} came damaged: {found.reason or 'it is another one'}")
        for name, (_, mtime, _) in json.loads((folder / STATUS).read_bytes())["files"].items():
            os.utime(folder / name, ns=(mtime, mtime))  # unchanged times spare later looks the digests
        self._place(key, folder)
        return found

    def _place(self, key: str, folder: Path) -> None:
        """Move a complete folder into the place of the cell, replacing what was there."""
        place = self.cell(key)
        old = self.cells / f".old-{key}-{os.getpid()}"
        if place.exists():
            shutil.rmtree(old, ignore_errors=True)
            place.rename(old)
        folder.rename(place)
        shutil.rmtree(old, ignore_errors=True)

    def commit_failure(self, key: str, reason: str, traceback: str, log: str = "") -> None:
        """Store a failed cell: the reason and the traceback."""
        try:
            with self.writing(key) as folder:
                (folder / "traceback.txt").write_text(traceback, encoding="utf-8", errors="backslashreplace")
                if log:
                    (folder / "log.jsonl").write_text(log, encoding="utf-8", errors="backslashreplace")
                self.commit(key, folder, "failed", reason)
        except OSError as error:
            raise unwritable(self.cell(key), error) from error

    def sweep(self, key: str = "") -> None:
        """Remove what killed processes left half written, of one cell or of all. Only under the lock.

        Of all cells, those are left alone that a process holds: a worker may outlive the run that gave it the cell.
        """
        held: set[str] = set()
        if not key:
            held = {path.name for path in self.cells.glob(".locks/*") if self._held(path.name)}
        for pattern in (f".tmp-{key}*", f".old-{key}*"):
            for path in self.cells.glob(pattern):
                if not any(name in path.name for name in held):
                    shutil.rmtree(path) if path.is_dir() else path.unlink()
        # Of one cell, only what is its own: other shards may be writing the files of the run at this moment.
        tops = [] if key else [*self.folder.glob(".coordinator-*"), *self.folder.glob(".*.part")]
        for path in [*tops, *self.cells.glob(f"{key or '*'}/.*.part")]:
            if path.parent.name not in held:
                path.unlink(missing_ok=True)

    @contextlib.contextmanager
    def holding(self, key: str, *, poll: float = 0.1) -> Iterator[None]:
        """Hold one cell against other processes, on other machines too, that may make it at the same time; waits for them.

        The file stays: one that is removed while another process waits for it would let two in.
        """
        self._lock_file(key).parent.mkdir(parents=True, exist_ok=True)
        with self._lock_file(key).open("a+", encoding="utf-8") as file:
            while not try_lock(file, shared=False):
                time.sleep(poll)
            try:
                yield
            finally:
                unlock(file)

    def _lock_file(self, key: str) -> Path:
        return self.cells / ".locks" / key

    def _held(self, key: str) -> bool:
        """Whether a process holds a cell."""
        return self._lock_file(key).is_file() and is_held(self._lock_file(key))

    @contextlib.contextmanager
    def lock_shard(self, shard: str) -> Iterator[None]:
        """Hold one part ``k/n`` of the run: other parts may be at work beside it; see :mod:`benchmark.runner.locking`."""
        part, _, parts = shard.partition("/")
        with held(self.folder, (int(part), int(parts))):
            yield

    @contextlib.contextmanager
    def lock(self) -> Iterator[None]:
        """Hold the run folder against other runs and shards; see :mod:`benchmark.runner.locking`."""
        with held(self.folder):
            yield


def _compare(files: Mapping[str, list], present: Mapping[str, Path], thorough: bool) -> str | None:
    for name in files:
        if name not in present:
            return f"{name} is missing"
    for name, path in present.items():
        if name not in files:
            return f"{name} does not belong there"
        size, mtime, sha = files[name]
        stat = path.stat()
        if stat.st_size != size:
            return f"{name} has {stat.st_size} bytes, not {size}"
        if (thorough or stat.st_mtime_ns != mtime) and file_digest(path) != sha:
            return f"{name} was altered"
    return None


def sealed(facts: Mapping[str, Any]) -> dict[str, Any]:
    """Facts with a digest of themselves, so that a flipped bit in one of them is seen."""
    return {**facts, SEAL: digest(facts)}


def unsealed(facts: Any) -> dict[str, Any]:
    """The facts of :func:`sealed`; a ``ValueError`` if they are not those that were sealed. Facts without a seal pass."""
    if not isinstance(facts, dict):
        raise ValueError(f"a table was expected, not {type(facts).__name__}")
    rest = {name: value for name, value in facts.items() if name != SEAL}
    if SEAL in facts:
        try:
            same = digest(rest) == facts[SEAL]
        except ConfigError:  # NaN or infinity, which nobody writes
            same = False
        if not same:
            raise ValueError("its digest is not that of its content")
    return rest


def printable(text: str) -> str:
    """A text that a method gave, for files and terminals: what neither can show is written as an escape."""
    return "".join(
        sign if sign.isprintable() or sign == " " else sign.encode("unicode_escape").decode("ascii") for sign in text
    )


def unwritable(path: Path, error: OSError) -> StoreError:
    """That a file of a run cannot be written, and what to do about it."""
    return StoreError(
        f"cannot write {path} ({error.strerror or error}): make room or mend the folder, and give the same command again; "
        "finished cells are kept"
    )


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A path beside ``path`` to write to; renamed over it when the block ends without an error.

    Raises
    ------
    StoreError
        If the disk is full or the folder cannot be written to; ``path`` is then as it was.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            yield part
            with part.open("rb") as file:
                os.fsync(file.fileno())
            part.replace(path)
        finally:
            with contextlib.suppress(OSError):
                part.unlink(missing_ok=True)
    except OSError as error:
        raise unwritable(path, error) from error


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically; a file that already holds ``text`` is left alone."""
    data = text.encode()
    if path.is_file() and path.read_bytes() == data:
        return
    with replacing(path) as part:
        part.write_bytes(data)


def write_json(path: Path, value: Any) -> None:
    """Write JSON atomically, keys in order."""
    write_text(path, json.dumps(value, indent=1, sort_keys=True, ensure_ascii=False) + "\n")


def read_json(path: Path) -> Any:
    """Read JSON; a :class:`~benchmark.errors.StoreError` names a file that is missing or damaged."""
    try:
        return json.loads(path.read_bytes())
    except FileNotFoundError:
        raise StoreError(
            f"{path} is missing: {path.parent} is not a run folder, or its run did not get that far"
        ) from None
    except (OSError, ValueError, RecursionError) as error:
        raise StoreError(f"{path} is damaged ({error}): run again") from error
