"""Fetching public data sets: download with resume, or a local archive; verify, unpack, and keep a note of the licence.

The digest of an archive that a forge makes on demand is not fixed, only those of the files in it are; so an archive is
judged by its files. Downloads use the standard library: pooch, which the field uses for this, starts an interrupted download
from the beginning and needs the archive's digest to be of use.
"""

from __future__ import annotations

import datetime as dt
import errno
import http.client
import json
import re
import shutil
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from dataclasses import dataclass
from email.message import Message
from pathlib import Path
from urllib.parse import urlsplit

from benchmark.data.archive import Receipt, Report, read_receipt, silent, store, unpack_cached, upstream
from benchmark.data.cache import atomic_path, cache_root, locked
from benchmark.data.cards import Card
from benchmark.data.locate import archive_in, data_root, fetched
from benchmark.errors import DataError

_CHUNK = 1 << 17
_MAX_TRIES = 50


@dataclass(frozen=True)
class Fetched:
    """A data set that is ready to open.

    ``missing`` counts upstream's motion files that the archive did not hold: more than none for a subset.
    """

    folder: Path
    receipt: Receipt
    missing: int


def fetch(
    card: Card,
    *,
    archive: Path | None = None,
    url: str | None = None,
    report: Report = silent,
    again: bool = False,
    attempts: int = 5,
    timeout: float = 30.0,
    sleep: Callable[[float], None] = time.sleep,
) -> Fetched:
    """Put a public data set into the cache; its licence counts as accepted.

    The archive is ``archive``, else one found in ``BENCHMARK_DATA``, else it is downloaded. Processes that fetch the same data
    set wait for each other.

    Parameters
    ----------
    archive
        A local archive, whole or with a part of the files, or a folder that holds one.
    url
        Where to download from instead of upstream.
    again
        Fetch even if it is there.
    attempts, timeout, sleep
        Failures in a row before giving up, seconds without a byte, and how to wait between attempts.

    Raises
    ------
    DataError
        With the thing that went wrong and what to do; no half-written data set is left.
    """
    source, _ = upstream(card)
    local = archive
    if archive is not None and archive.is_dir():
        local = archive_in(card, archive)
        if local is None:
            raise DataError(f"there is no archive {source.folder}.zip or {card.id}*.zip in {archive}")
    if not again and local is None and url is None:
        present = _present(card)
        if present is not None:
            return present
    if local is None and url is None:
        named = data_root()
        local = archive_in(card, named) if named is not None and named.is_dir() else None
    if local is not None:
        folder, receipt = unpack_cached(card, local, report=report)
    else:
        address = url or source.url
        downloads = cache_root() / "downloads"
        try:
            # Another process may be downloading the same archive; what it leaves is then found unpacked.
            with locked(downloads / f"{card.id}.lock", waiting=lambda: report(0, None, "waiting for another fetch")):
                present = None if again or url is not None else _present(card)
                if present is not None:
                    return present
                path = downloads / f"{source.folder}.zip"
                download(address, path, report=report, attempts=attempts, timeout=timeout, sleep=sleep)
                try:
                    folder, receipt = unpack_cached(card, path, origin=address, report=report)
                finally:
                    path.unlink(missing_ok=True)
        except OSError as error:
            raise _cannot_write(error, downloads) from error
    note = {
        "folder": folder.name,
        "licence": card.licence.name,
        "licence_accepted": dt.datetime.now(dt.UTC).isoformat(timespec="seconds"),
    }
    with atomic_path(store(card) / "current.json") as temporary:
        temporary.write_text(json.dumps(note, indent=2), encoding="utf-8")
    return Fetched(folder, receipt, len(card.digests()) - receipt.files)


def _present(card: Card) -> Fetched | None:
    try:
        folder = fetched(card)
    except DataError:
        return None  # incomplete: fetching it again is the remedy
    receipt = None if folder is None else read_receipt(folder.with_suffix(".json"))
    if folder is None or receipt is None:
        return None
    return Fetched(folder, receipt, len(card.digests()) - receipt.files)


class _InterruptedDownload(Exception):
    """A failure that another attempt may mend; ``wait`` is how long the server asked to wait."""

    def __init__(self, message: str, wait: float = 0.0) -> None:
        super().__init__(message)
        self.wait = wait


def download(
    url: str,
    path: Path,
    *,
    report: Report = silent,
    attempts: int = 5,
    timeout: float = 30.0,
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """Download ``url`` to ``path``, going on where an earlier attempt stopped.

    Bytes collect in ``path.part``. They are kept for the next attempt, or the next call, only if the server gave the file a
    strong validator (a strong ETag or a date of change) that it can be asked to compare; if the file has changed since, or the
    server cannot send a range, the download starts over.

    Raises
    ------
    DataError
        The address is wrong, the server refuses, the disk is full, or ``attempts`` in a row brought no progress.
    """
    if urlsplit(url).scheme not in ("http", "https"):
        raise DataError(f"{url} is not an http or https address")
    path.parent.mkdir(parents=True, exist_ok=True)
    part, state = path.with_name(path.name + ".part"), path.with_name(path.name + ".part.json")
    failures, reason = 0, ""
    for _ in range(_MAX_TRIES):
        before = _size(part)
        try:
            _attempt(url, part, state, report, timeout)
        except _InterruptedDownload as error:
            failures = 1 if _size(part) > before else failures + 1
            reason = str(error)
            if failures >= attempts:
                break
            report(_size(part), None, f"retrying: {reason}")
            sleep(max(error.wait, min(0.5 * 2**failures, 30.0)))
            continue
        part.replace(path)
        state.unlink(missing_ok=True)
        return
    kept = _size(part) if state.exists() else 0
    if not kept:
        part.unlink(missing_ok=True)
    advice = f"run the command again to go on from byte {kept}" if kept else "run the command again"
    raise DataError(
        f"cannot download {url}: {reason}. Check the connection and {advice}, or download it by other means and use --from FILE"
    )


def _attempt(url: str, part: Path, state: Path, report: Report, timeout: float) -> None:
    have, validator, known_total = _resumable(url, part, state)
    headers = {"User-Agent": "motion-style-benchmark", "Accept-Encoding": "identity"}
    if have:
        headers |= {"Range": f"bytes={have}-", "If-Range": validator}
    try:
        response = urllib.request.urlopen(urllib.request.Request(url, headers=headers), timeout=timeout)
    except urllib.error.HTTPError as error:
        with error:
            if error.code == 416:
                if have and _range_total(error.headers) == have:
                    return
                _forget(part, state)
                raise _InterruptedDownload("the server no longer has the range asked for") from None
            if error.code in (408, 425, 429) or error.code >= 500:
                raise _InterruptedDownload(
                    f"the server answered {error.code} {error.reason}", _retry_after(error)
                ) from None
            raise DataError(
                f"cannot download {url}: the server answered {error.code} {error.reason}. If the archive has moved, download "
                "it by other means and use --from FILE"
            ) from None
    except (urllib.error.URLError, http.client.HTTPException, OSError) as error:
        raise _InterruptedDownload(str(getattr(error, "reason", error)) or type(error).__name__) from error
    with response:
        start, total = _placement(response, have)
        if start != have or (start and known_total not in (None, total)):
            if start:
                _forget(part, state)
                raise _InterruptedDownload("the server sent another range than was asked for")
            have = 0
        _note(url, state, response, total)
        _require_room(part, total, have)
        _receive(response, part, have, total, report)


def _receive(response: http.client.HTTPResponse, part: Path, have: int, total: int | None, report: Report) -> None:
    try:
        file = part.open("r+b" if have else "wb")
    except OSError as error:
        raise _cannot_write(error, part.parent) from error
    with file:
        file.seek(have)
        while True:
            report(have, total, "downloading")
            try:
                chunk = response.read1(_CHUNK)  # what is there: a server that stalls must not take it back
            except (http.client.HTTPException, OSError) as error:
                raise _InterruptedDownload(
                    f"the connection broke after {have} bytes ({type(error).__name__})"
                ) from error
            if not chunk:
                break
            try:
                file.write(chunk)
                file.flush()
            except OSError as error:
                file.close()
                part.unlink(missing_ok=True)
                raise _cannot_write(error, part.parent) from error
            have += len(chunk)
    if total is not None and have < total:
        raise _InterruptedDownload(f"the connection closed after {have} of {total} bytes")
    if total is not None and have > total:
        part.unlink(missing_ok=True)
        raise _InterruptedDownload(f"the server sent {have} bytes where it had announced {total}")


def _resumable(url: str, part: Path, state: Path) -> tuple[int, str, int | None]:
    """Bytes that can be kept, the validator to ask with, and the total length; ``(0, "", None)`` to start over."""
    try:
        known = json.loads(state.read_text(encoding="utf-8"))
        if known["url"] == url and known["validator"] and _size(part):
            return _size(part), str(known["validator"]), known["total"]
    except (OSError, ValueError, KeyError, TypeError):
        pass
    return 0, "", None


def _note(url: str, state: Path, response: http.client.HTTPResponse, total: int | None) -> None:
    etag = response.headers.get("ETag", "")
    # If-Range compares strongly (RFC 9110, 13.1.5): a weak ETag would never match.
    validator = etag if etag.startswith('"') else response.headers.get("Last-Modified", "")
    if not validator:
        state.unlink(missing_ok=True)
        return
    with atomic_path(state) as temporary:
        temporary.write_text(json.dumps({"url": url, "validator": validator, "total": total}), encoding="utf-8")


def _placement(response: http.client.HTTPResponse, have: int) -> tuple[int, int | None]:
    """Where the bytes to come belong, and how many there are in all."""
    if response.status == 206:
        match = re.fullmatch(r"bytes (\d+)-\d+/(\d+|\*)", response.headers.get("Content-Range", ""))
        if match is None:
            return -1, None
        return int(match[1]), None if match[2] == "*" else int(match[2])
    length = response.headers.get("Content-Length", "")
    return 0, int(length) if length.isdecimal() else None


def _range_total(headers: Message) -> int | None:
    match = re.fullmatch(r"bytes \*/(\d+)", headers.get("Content-Range", ""))
    return None if match is None else int(match[1])


def _retry_after(error: urllib.error.HTTPError) -> float:
    asked = error.headers.get("Retry-After", "")
    return min(float(asked), 60.0) if asked.isdecimal() else 0.0


def _size(part: Path) -> int:
    try:
        return part.stat().st_size
    except FileNotFoundError:
        return 0


def _forget(part: Path, state: Path) -> None:
    part.unlink(missing_ok=True)
    state.unlink(missing_ok=True)


def _require_room(part: Path, total: int | None, have: int) -> None:
    free = shutil.disk_usage(part.parent).free
    if total is not None and total - have > free:
        raise DataError(
            f"the download needs {(total - have) / 1e6:.0f} MB in {part.parent}, where {free / 1e6:.0f} MB are free: make "
            "room, or set BENCHMARK_CACHE to a folder on another disk"
        )


def _cannot_write(error: OSError, folder: Path) -> DataError:
    if error.errno in (errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC)):
        return DataError(f"the disk is full at {folder}: make room, or set BENCHMARK_CACHE to a folder on another disk")
    return DataError(f"cannot write to {folder} ({error}): set BENCHMARK_CACHE to a folder you may write to")
