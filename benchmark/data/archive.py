"""Unpacking the archive of a public data set: safely, verified file by file, and whole or not at all."""

from __future__ import annotations

import errno
import hashlib
import json
import secrets
import shutil
import stat
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path, PurePosixPath

from benchmark.data.cache import atomic_path, cache_root, file_digests, locked
from benchmark.data.cards import Card, Layout, Source
from benchmark.digest import file_digest
from benchmark.errors import DataError

#: ``report(done, total, what)``, in bytes; ``total`` is ``None`` where it is not known.
Report = Callable[[int, int | None, str], None]

MAX_ENTRIES = 50_000
MAX_RATIO = 200
_CHUNK = 1 << 18


def silent(done: int, total: int | None, what: str) -> None:
    """A :data:`Report` that says nothing."""


@dataclass(frozen=True)
class Receipt:
    """What was unpacked from where; lies beside the unpacked folder.

    ``files`` counts motion files, ``left_packed`` names those of the archive that have no known digest.
    """

    card: str
    version: str
    origin: str
    archive_sha256: str
    files: int
    left_packed: tuple[str, ...] = ()


def upstream(card: Card) -> tuple[Source, Layout]:
    """Where a downloadable data set comes from and how it is laid out; a :class:`DataError` for any other."""
    if card.source is None or card.layout is None:
        raise DataError(f"data set {card.id} has no public archive. {card.how_to_get}")
    return card.source, card.layout


def store(card: Card) -> Path:
    """The folder of the cache that holds the unpacked copies of a data set."""
    return cache_root() / "datasets" / card.id


def unpack_cached(
    card: Card, archive: Path, *, origin: str = "", report: Report = silent, trusted: bool = False
) -> tuple[Path, Receipt]:
    """The unpacked copy of ``archive`` in the cache, made if it is not there.

    Parameters
    ----------
    origin
        Where the archive came from; its own path if empty.
    trusted
        Whether the archive's digest may be taken from the memo of files that did not change, instead of from its bytes.

    Raises
    ------
    DataError
        The archive is damaged, unsafe, of something else, or holds an altered file. Nothing is left behind.
    """
    _, layout = upstream(card)
    if not archive.is_file():
        raise DataError(f"there is no archive {archive}")
    digest = file_digests([archive], memo=f"archive-{card.id}")[archive] if trusted else file_digest(archive)
    target = store(card) / f"{card.version}-{digest[:12]}"
    note = target.with_suffix(".json")
    try:
        receipt = _complete(target, note, layout)
        if receipt is None:
            with locked(store(card) / ".lock"):
                receipt = _complete(target, note, layout)
                if receipt is None:
                    if target.exists():
                        shutil.rmtree(target)
                    files, left = unpack(card, archive, target, report=report)
                    receipt = Receipt(card.id, card.version, origin or str(archive.absolute()), digest, files, left)
                    with atomic_path(note) as temporary:
                        temporary.write_text(json.dumps(asdict(receipt), indent=2), encoding="utf-8")
    except OSError as error:
        raise _storage_error(error, target) from error
    return target, receipt


def read_receipt(note: Path) -> Receipt | None:
    """The receipt written beside an unpacked folder, or ``None``."""
    try:
        content = json.loads(note.read_text(encoding="utf-8"))
        return Receipt(**{**content, "left_packed": tuple(content["left_packed"])})
    except (OSError, ValueError, TypeError, KeyError):
        return None


def data_files(folder: Path, layout: Layout) -> dict[str, Path]:
    """The motion files below ``folder`` by relative name, sorted."""
    found = {}
    for pattern in layout.data:
        for path in folder.glob(pattern):
            if path.is_file() and not path.name.startswith("."):
                found[path.relative_to(folder).as_posix()] = path
    return dict(sorted(found.items()))


def _complete(target: Path, note: Path, layout: Layout) -> Receipt | None:
    receipt = read_receipt(note) if target.is_dir() else None
    if receipt is None or len(data_files(target, layout)) != receipt.files:
        return None
    return receipt


def unpack(card: Card, archive: Path, target: Path, *, report: Report = silent) -> tuple[int, tuple[str, ...]]:
    """Unpack the motion files and texts of ``archive`` to ``target``, which must not exist.

    Every motion file is compared with the card's table of digests on the way. Files are written to a folder beside
    ``target`` that is renamed at the end.

    Returns
    -------
    files
        How many motion files were unpacked.
    left_packed
        Motion files that the table does not know.
    """
    source, layout = upstream(card)
    table = card.digests()
    temporary = target.with_name(f".{target.name}-{secrets.token_hex(4)}.tmp")
    try:
        with _opened(archive) as packed:
            wanted = {
                name: info for name, info in _members(packed, archive, source, layout).items() if layout.is_wanted(name)
            }
            left = tuple(name for name in wanted if layout.is_data(name) and name not in table)
            chosen = {name: info for name, info in wanted.items() if name not in left}
            if not any(layout.is_data(name) for name in chosen):
                raise DataError(f"{archive} holds no motion file of data set {card.id}")
            total = sum(info.file_size for info in chosen.values())
            done = 0
            temporary.mkdir(parents=True)
            _require_space(temporary, total, f"unpacking {archive.name}")
            for name, info in chosen.items():
                digest = _extract(packed, info, temporary / name, archive)
                if name in table and digest != table[name]:
                    raise DataError(
                        f"{name} in {archive} was altered: its SHA-256 is {digest[:16]}…, upstream's is {table[name][:16]}…; "
                        f"get a fresh archive of commit {source.commit[:12]}"
                    )
                done += info.file_size
                report(done, total, "unpacking and verifying")
        temporary.replace(target)
    except OSError as error:
        raise _storage_error(error, target) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return sum(layout.is_data(name) for name in chosen), left


def _opened(archive: Path) -> zipfile.ZipFile:
    try:
        return zipfile.ZipFile(archive)
    except FileNotFoundError:
        raise DataError(f"there is no archive {archive}") from None
    except (zipfile.BadZipFile, NotImplementedError, ValueError) as error:
        raise DataError(f"{archive} is not a zip archive, or is cut short ({error}): get it again") from error


def _members(packed: zipfile.ZipFile, archive: Path, source: Source, layout: Layout) -> dict[str, zipfile.ZipInfo]:
    """The archive's files by name below its top folder, after checks of *all* entries."""
    infos = packed.infolist()
    if len(infos) > MAX_ENTRIES:
        raise DataError(
            f"{archive} has {len(infos)} entries, more than the {MAX_ENTRIES} a data set may have: not unpacked"
        )
    members: dict[str, zipfile.ZipInfo] = {}
    seen: set[str] = set()
    total = 0
    for info in infos:
        _require_safe(info, archive)
        parts = PurePosixPath(info.filename).parts
        if parts[0] != source.folder:
            raise DataError(
                f"{archive} holds {info.filename!r}, but everything in the archive of {source.repository} at the pinned commit "
                f"lies in {source.folder}/: get {source.url}"
            )
        if info.is_dir():
            continue
        name = "/".join(parts[1:])
        if name.lower() in seen:
            raise DataError(f"{archive} holds {name!r} twice: not unpacked")
        seen.add(name.lower())
        if layout.is_wanted(name):
            total += info.file_size
            growth = info.file_size // max(info.compress_size, 1)
            if info.file_size > 1 << 20 and growth > MAX_RATIO:
                raise DataError(f"{archive}: {name} would grow {growth}-fold: not unpacked")
        members[name] = info
    if total > layout.max_bytes:
        raise DataError(
            f"{archive} would unpack to {total} bytes, more than the {layout.max_bytes} allowed: not unpacked"
        )
    return members


def _require_safe(info: zipfile.ZipInfo, archive: Path) -> None:
    name = info.filename
    parts = name.rstrip("/").split("/")
    # `orig_filename` still has what the zip module quietly cuts off or rewrites: NUL bytes and backslashes.
    raw = info.orig_filename
    if any(sign in raw for sign in "\\\0:") or any(part in ("", ".", "..") for part in parts):
        raise DataError(f"{archive} holds a file with the unsafe name {raw!r}: not unpacked")
    kind = stat.S_IFMT(info.external_attr >> 16)
    if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
        raise DataError(f"{archive} holds {name!r}, which is a link or a device: not unpacked")
    if info.flag_bits & 1:
        raise DataError(f"{archive} holds {name!r} encrypted: not unpacked")


def _extract(packed: zipfile.ZipFile, info: zipfile.ZipInfo, path: Path, archive: Path) -> str:
    path.parent.mkdir(parents=True, exist_ok=True)
    hasher = hashlib.sha256()
    with path.open("xb") as out:
        try:
            with packed.open(info) as member:
                while chunk := member.read(_CHUNK):
                    hasher.update(chunk)
                    out.write(chunk)
        except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError) as error:
            raise DataError(f"{info.filename} in {archive} is damaged ({error}): get the archive again") from error
    return hasher.hexdigest()


def _require_space(folder: Path, needed: int, what: str) -> None:
    free = shutil.disk_usage(folder).free
    if needed > free:
        raise DataError(
            f"{what} needs {needed / 1e6:.0f} MB in {folder.parent}, where {free / 1e6:.0f} MB are free: make room, or set "
            "BENCHMARK_CACHE to a folder on another disk"
        )


def _storage_error(error: OSError, target: Path) -> DataError:
    if error.errno in (errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC)):
        return DataError(
            f"the disk is full at {target.parent}: make room, or set BENCHMARK_CACHE to a folder on another disk"
        )
    return DataError(f"cannot write to {target.parent} ({error}): set BENCHMARK_CACHE to a folder you may write to")
