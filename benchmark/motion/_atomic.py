"""Writing a file whole or not at all."""

from __future__ import annotations

import contextlib
import os
import secrets
from collections.abc import Iterable
from pathlib import Path

from benchmark.errors import MotionFileError


def atomic_write(path: Path, chunks: Iterable[bytes]) -> None:
    """Write ``chunks`` to ``path``: to a new file beside it that then takes its name, so no reader sees half of it.

    Raises
    ------
    MotionFileError
        If the folder does not exist or cannot be written, or ``path`` is a folder.
    """
    target = Path(os.path.realpath(path))
    if target.is_dir():
        raise MotionFileError(path, "a folder; expected the name of a file to write")
    aside = target.with_name(f".{target.name[:200]}.{secrets.token_hex(6)}")
    try:
        try:
            with aside.open("xb") as file:
                file.writelines(chunks)
            aside.replace(target)
        finally:
            with contextlib.suppress(FileNotFoundError):
                aside.unlink()
    except OSError as error:
        reason = "its folder does not exist" if not target.parent.is_dir() else (error.strerror or str(error))
        raise MotionFileError(path, f"cannot be written ({reason})") from error
