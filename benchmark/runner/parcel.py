"""A folder as bytes and back: how a cell travels between machines that share no disk.

A parcel is a zip archive of plain files. What comes back is data from another machine: names are checked, and sizes bounded,
before anything is written.
"""

from __future__ import annotations

import io
import shutil
import stat
import zipfile
import zlib
from pathlib import Path, PurePosixPath

from benchmark.errors import StoreError

#: Bytes of a folder that may travel, packed or not, and how many files.
MAX_BYTES, MAX_FILES = 1 << 30, 20_000

#: Where a folder is too large to travel.
SHARE = "keep the run folder on a disk that all workers share"


def pack(folder: Path) -> bytes:
    """Every file below ``folder`` but the hidden ones.

    Raises
    ------
    StoreError
        If there is too much to send.
    """
    paths = [path for path in sorted(folder.rglob("*")) if path.is_file() and not path.name.startswith(".")]
    total = sum(path.stat().st_size for path in paths)
    if total > MAX_BYTES or len(paths) > MAX_FILES:
        raise StoreError(
            f"{folder.name} has {len(paths)} files of {total / 1e6:.0f} MB, more than the {MAX_FILES} files and "
            f"{MAX_BYTES / 1e6:.0f} MB that are sent between machines: {SHARE}"
        )
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as packed:
        for path in paths:
            # A name alone, without times: a cell's files are vouched for by their digests.
            info = zipfile.ZipInfo(path.relative_to(folder).as_posix())
            info.compress_type = zipfile.ZIP_DEFLATED
            packed.writestr(info, path.read_bytes())
    return buffer.getvalue()


def unpack(parcel: bytes, folder: Path, *, max_bytes: int = MAX_BYTES, max_files: int = MAX_FILES) -> None:
    """Write the files of a parcel below ``folder``, which must not exist.

    Raises
    ------
    StoreError
        For what is no parcel, unsafe names, links, or more than is allowed. Nothing is left behind.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(parcel)) as packed:
            infos = packed.infolist()
            total = sum(info.file_size for info in infos)
            if len(infos) > max_files or total > max_bytes:
                raise StoreError(
                    f"a worker sent {len(infos)} files of {total / 1e6:.0f} MB, more than the {max_files} files and "
                    f"{max_bytes / 1e6:.0f} MB allowed: {SHARE}"
                )
            for info in infos:
                _require_safe(info)
            folder.mkdir(parents=True)
            for info in infos:
                path = folder / info.filename
                path.parent.mkdir(parents=True, exist_ok=True)
                # zipfile reads no more than the size that was counted above, and fails if there is more or less.
                path.write_bytes(packed.read(info))
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, ValueError) as error:
        shutil.rmtree(folder, ignore_errors=True)
        raise StoreError(f"what a worker sent is damaged ({error})") from error
    except StoreError:
        shutil.rmtree(folder, ignore_errors=True)
        raise


def _require_safe(info: zipfile.ZipInfo) -> None:
    raw = info.orig_filename
    unsafe = any(sign in raw for sign in "\\\0:") or any(part in ("", ".", "..") for part in raw.split("/"))
    kind = stat.S_IFMT(info.external_attr >> 16)
    if unsafe or PurePosixPath(raw).is_absolute() or kind not in (0, stat.S_IFREG) or info.flag_bits & 1:
        raise StoreError(f"a worker sent a file that is not taken: {raw!r}")
