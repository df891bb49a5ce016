"""Who may write to a run folder: one run, or the shards of one run side by side.

A whole run holds ``.lock`` alone. A shard holds ``.lock`` together with other shards, and ``.shards/K-of-N``
alone. The operating system drops both with the process that held them, so a dead run never blocks the next; where a
file system has no locks, what the holder wrote into the file decides instead: it counts as long as its process lives.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import shlex
import socket
import sys
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import IO

from benchmark.errors import ConfigError, StoreError

LOCK = ".lock"

#: Folder of the locks of shards.
SHARDS = ".shards"

#: What a file system without locks says when it is asked for one.
_NO_LOCKS = {errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP}


@contextlib.contextmanager
def held(folder: Path, shard: tuple[int, int] | None = None) -> Iterator[None]:
    """Hold a run folder.

    Parameters
    ----------
    folder
        Made if it is not there.
    shard
        ``(k, n)`` for the k-th of n shards, counted from 1; ``None`` for the whole run.

    Raises
    ------
    StoreError
        If another run or the same shard holds the folder, or a shard of another division; the message says which process,
        where, since when and by which command. Or if the folder cannot be written to.
    """
    with contextlib.ExitStack() as stack:
        if shard is None:
            whole = stack.enter_context(_open(folder, LOCK))
            _take(stack, folder, whole, shared=False)
        else:
            k, n = shard
            if not 1 <= k <= n:
                raise ConfigError(f"shard {k}/{n}: the first number counts from 1 to the second")
            whole = stack.enter_context(_open(folder, LOCK))
            _take(stack, folder, whole, shared=True)
            # First take, then look: of two that start at once under different divisions, at least one sees the other.
            own = stack.enter_context(_open(folder, f"{SHARDS}/{k}-of-{n}"))
            _take(stack, folder, own, shared=False, what=f"shard {k}/{n} of {folder}")
            for path in _shards(folder):
                if not path.name.endswith(f"-of-{n}") and (holder := _living(path)):
                    raise StoreError(
                        f"{folder} is at work in other parts ({path.name}) by {holder}: divide it by the same number"
                    )
        yield


def _open(folder: Path, name: str) -> IO[str]:
    try:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        return (folder / name).open("a+", encoding="utf-8")
    except OSError as error:
        raise StoreError(
            f"cannot write to the run folder {folder} ({error.strerror}): choose another with --out"
        ) from error


def _shards(folder: Path) -> list[Path]:
    return sorted((folder / SHARDS).glob("*-of-*"))


def _take(stack: contextlib.ExitStack, folder: Path, file: IO[str], *, shared: bool, what: str = "") -> None:
    """Take one lock, to be dropped with ``stack``, and sign it; shards leave signing to the files that are theirs alone."""
    path = Path(file.name)
    taken = try_lock(file, shared=shared)
    if taken is None:
        taken = not alive(_signature(path))
    if not taken:
        holders = [_shown(_signature(path))] if _signature(path) else []
        shards = [f"shard {other.name} ({who})" for other in _shards(folder) if not what and (who := _living(other))]
        raise StoreError(
            f"{what or folder} is in use by {'; '.join(shards or holders) or 'another process'}: wait for it, or "
            + ("give each part to one process" if what else "choose another folder with --out")
        )
    stack.callback(unlock, file)
    if shared:
        return
    try:
        _sign(file, _own_signature())
    except OSError as error:
        raise StoreError(
            f"cannot write to the run folder {folder} ({error.strerror}): free some space, or choose another with --out"
        ) from error
    stack.callback(_sign, file, None)


def _own_signature() -> dict[str, object]:
    import psutil

    return {
        "pid": os.getpid(),
        "host": socket.gethostname(),
        "since": datetime.now(UTC).isoformat(timespec="seconds"),
        "started": psutil.Process().create_time(),
        "command": shlex.join(sys.argv),
    }


def _sign(file: IO[str], signature: dict[str, object] | None) -> None:
    # Past the buffer of the file, which would try again, and fail again, when it is closed on a full disk.
    os.ftruncate(file.fileno(), 0)
    if signature is not None:
        os.write(file.fileno(), json.dumps(signature).encode())


def _signature(path: Path) -> dict[str, object]:
    """Who signed the file; empty if nobody did, or it is unreadable."""
    try:
        found = json.loads(path.read_bytes())
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def _shown(signature: dict[str, object]) -> str:
    since = f" since {signature['since']}" if signature.get("since") else ""
    command = f" ({signature['command']})" if signature.get("command") else ""
    return f"process {signature.get('pid', '?')} on {signature.get('host', '?')}{since}{command}"


def is_held(path: Path) -> bool:
    """Whether a process holds a lock file."""
    return bool(_living(path))


def _living(path: Path) -> str:
    """Who holds the file, in words; empty if nobody does."""
    try:
        with path.open("a+", encoding="utf-8") as file:
            free = try_lock(file, shared=False)
            if free:
                unlock(file)
    except OSError:
        return ""
    signature = _signature(path)
    if free is None:
        free = not alive(signature)
    return "" if free else _shown(signature) if signature else "another process"


def alive(signature: dict[str, object]) -> bool:
    """Whether the process that signed a lock lives, as far as can be told from here: on another host it is taken to."""
    import psutil

    pid = signature.get("pid")
    if not isinstance(pid, int):
        return False
    if signature.get("host") != socket.gethostname():
        return True
    try:
        return abs(psutil.Process(pid).create_time() - float(str(signature.get("started", 0.0)))) < 2.0
    except (psutil.Error, ValueError):
        return False


def try_lock(file: IO[str], *, shared: bool) -> bool | None:
    """Take the operating system's lock on an open file; ``None`` where its file system has none."""
    try:
        import fcntl
    except ImportError:  # Windows, whose locks cannot be shared: shards have files of their own
        import msvcrt

        if shared:
            return True
        try:
            file.seek(1 << 20)
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined,unused-ignore]
        except OSError:
            return False
        return True
    try:
        fcntl.flock(file.fileno(), (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:
        if error.errno in _NO_LOCKS:
            return None
        raise
    return True


def unlock(file: IO[str]) -> None:
    """Drop the lock."""
    try:
        import fcntl
    except ImportError:  # Windows
        import msvcrt

        with contextlib.suppress(OSError):
            file.seek(1 << 20)
            msvcrt.locking(file.fileno(), msvcrt.LK_UNLCK, 1)  # type: ignore[attr-defined,unused-ignore]
        return
    with contextlib.suppress(OSError):
        fcntl.flock(file.fileno(), fcntl.LOCK_UN)
