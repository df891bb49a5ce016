"""The cache: where downloaded data sets, canonical clips and digests of files are kept between runs.

Everything in it can be made again, and a damaged entry is. It lies in the user's cache folder, or where the environment
variable ``BENCHMARK_CACHE`` says. Files are written aside and renamed into place, so that processes may share it.
"""

from __future__ import annotations

import json
import logging
import os
import secrets
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

from benchmark.digest import code_digest, file_digest
from benchmark.errors import DataError, MotionFileError
from benchmark.motion import npz
from benchmark.motion.clip import ClipMeta, MotionClip
from benchmark.motion.skeleton import Skeleton

_log = logging.getLogger(__name__)


def cache_root() -> Path:
    """The cache's folder, which need not exist yet."""
    named = os.environ.get("BENCHMARK_CACHE")
    if named:
        return Path(named).expanduser().absolute()
    from platformdirs import user_cache_path

    return user_cache_path("motion-style-benchmark", appauthor=False)


@cache
def canonical_version() -> str:
    """Digest of the code that reads files and makes clips canonical: a change of it makes every cached clip stale."""
    motion = ("bvh", "kinect", "canonical", "retarget", "roles", "units", "npz")
    readers = ("files", "kinder_gator", "bandai_namco", "folder")
    return code_digest(
        (f"benchmark.motion.{module}" for module in motion), (f"benchmark.data.{module}" for module in readers)
    )


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """A temporary path beside ``path`` that takes its place if the block succeeds and vanishes if it fails."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name[:40]}-{os.getpid()}-{secrets.token_hex(4)}.tmp")
    try:
        yield temporary
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def locked(path: Path, *, waiting: Callable[[], None] = lambda: None, poll: float = 0.1) -> Iterator[None]:
    """Hold the lock file ``path``; call ``waiting`` once if another process holds it. Dies with the process that holds it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a+b") as file:
        told = False
        while not _try_lock(file.fileno()):
            if not told:
                waiting()
                told = True
            time.sleep(poll)
        try:
            yield
        finally:
            _unlock(file.fileno())


try:
    import fcntl

    def _try_lock(descriptor: int) -> bool:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True

    def _unlock(descriptor: int) -> None:
        fcntl.flock(descriptor, fcntl.LOCK_UN)

except ImportError:  # Windows
    import msvcrt

    def _try_lock(descriptor: int) -> bool:
        os.lseek(descriptor, 0, os.SEEK_SET)
        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
        except OSError:
            return False
        return True

    def _unlock(descriptor: int) -> None:
        os.lseek(descriptor, 0, os.SEEK_SET)
        msvcrt.locking(descriptor, msvcrt.LK_UNLCK, 1)  # type: ignore[attr-defined]


def cached_clip(key: str, make: Callable[[], MotionClip], meta: ClipMeta) -> MotionClip:
    """The clip stored under ``key``, or the one that ``make`` makes, then stored; ``meta`` is put on it either way.

    A stored clip that is damaged is made again. Where nothing can be written the clip is made every time, with a warning.
    """
    path = cache_root() / "clips" / key[:2] / f"{key}.npz"
    clip = _read(path)
    if clip is None:
        clip = make().replace(source=None)
        try:
            with atomic_path(path) as temporary:
                npz.save(clip, temporary)
        except OSError as error:
            _log.warning("clips are read anew each time: cannot write to the cache %s (%s)", cache_root(), error)
    return clip.replace(meta=meta)


def cached_skeleton(key: str, make: Callable[[], Skeleton]) -> Skeleton:
    """As :func:`cached_clip`, for a skeleton: it is stored as a clip of one frame at rest."""

    def rest() -> MotionClip:
        import numpy as np

        skeleton = make()
        rotations = np.zeros((1, len(skeleton), 4))
        rotations[..., 0] = 1.0
        return MotionClip(skeleton, rotations, np.zeros((1, 3)), 1.0)

    return cached_clip(key, rest, ClipMeta()).skeleton


def _read(path: Path) -> MotionClip | None:
    if not path.exists():
        return None
    try:
        return npz.load(path)
    except MotionFileError as error:
        _log.warning("making a damaged cache entry again: %s", error)
        with suppress(OSError):
            path.unlink()
        return None


#: A file changed this many nanoseconds before its digest was noted may change again within one tick of the clock.
_SETTLED_NS = 2_000_000_000


def file_digests(paths: Iterable[Path], *, memo: str) -> dict[Path, str]:
    """SHA-256 of each file, remembered by size and time of change under the name ``memo``.

    Files changed within the last two seconds are always read. Use :func:`benchmark.digest.file_digest` where a file may have
    been tampered with.
    """
    store = cache_root() / "digests" / f"{memo}.json"
    known = _known_digests(store)
    result: dict[Path, str] = {}
    fresh: dict[str, list] = {}
    for path in paths:
        try:
            status = path.stat()
            stamp = [status.st_size, status.st_mtime_ns, status.st_ino]
            entry = known.get(str(path))
            digest = entry[3] if entry is not None and entry[:3] == stamp else file_digest(path)
        except OSError as error:
            raise DataError(f"cannot read {path} ({error.strerror}): check its permissions, or remove it") from error
        result[path] = digest
        if time.time_ns() - status.st_mtime_ns > _SETTLED_NS:
            fresh[str(path)] = [*stamp, digest]
    if fresh != known:
        try:
            with atomic_path(store) as temporary:
                temporary.write_text(json.dumps(fresh), encoding="utf-8")
        except OSError as error:
            _log.warning("digests are computed anew each time: cannot write to the cache %s (%s)", store.parent, error)
    return result


def _known_digests(store: Path) -> dict[str, list]:
    try:
        known = json.loads(store.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    if not isinstance(known, dict):
        return {}
    return {
        path: entry
        for path, entry in known.items()
        if isinstance(entry, list) and len(entry) == 4 and isinstance(entry[3], str) and len(entry[3]) == 64
    }
