"""Where the files of a public data set are on this machine."""

from __future__ import annotations

import json
import os
from pathlib import Path

from benchmark.data.archive import data_files, read_receipt, store, unpack_cached, upstream
from benchmark.data.cards import Card
from benchmark.errors import DataError


def data_root() -> Path | None:
    """The folder named by the environment variable ``BENCHMARK_DATA``."""
    named = os.environ.get("BENCHMARK_DATA")
    if not named:
        return None
    folder = Path(named).expanduser()
    if not folder.exists():
        raise DataError(f"BENCHMARK_DATA names {folder}, which does not exist: correct it or unset it")
    return folder


def locate(card: Card, root: Path | None = None) -> Path:
    """The unpacked folder of a public data set.

    Looks at ``root`` if it is given, else in ``BENCHMARK_DATA``, else for what ``data fetch`` stored. An archive found on the
    way is unpacked into the cache once.

    Raises
    ------
    DataError
        It is nowhere; the message says where it was looked for and how to get it.
    """
    if root is not None:
        found = find_in(card, root)
        if found is None:
            raise DataError(f"there is no data set {card.id} in {root}: {_expected(card)}")
        return found
    named = data_root()
    found = find_in(card, named) if named is not None else None
    if found is None:
        found = fetched(card)
    if found is None:
        place = f"BENCHMARK_DATA ({named}) does not hold it; " if named is not None else "BENCHMARK_DATA is not set; "
        raise DataError(
            f"data set {card.id} is not on this machine. {place}fetch it with `{card.how_to_get}`, or set BENCHMARK_DATA to a "
            f"folder that holds {_expected(card)}. Licence: {card.licence.name}"
        )
    return found


def _expected(card: Card) -> str:
    source, _ = upstream(card)
    return f"{source.folder}/, {source.folder}.zip or {card.id}.zip"


def find_in(card: Card, place: Path) -> Path | None:
    """The data set in ``place``: the unpacked folder itself, an archive, or a folder that holds either."""
    source, layout = upstream(card)
    if place.is_file():
        return unpack_cached(card, place, trusted=True)[0]
    for folder in (place, place / source.folder, place / card.id, place / card.id / source.folder):
        if (folder / layout.marker).is_dir() and data_files(folder, layout):
            return folder
    archive = archive_in(card, place)
    return None if archive is None else unpack_cached(card, archive, trusted=True)[0]


def archive_in(card: Card, place: Path) -> Path | None:
    """The archive of a data set in a folder: by upstream's names first, then any ``ID*.zip``."""
    source, _ = upstream(card)
    for name in (source.folder, source.commit, card.id):
        if (place / f"{name}.zip").is_file():
            return place / f"{name}.zip"
    return next((path for path in sorted(place.glob(f"{card.id}*.zip")) if path.is_file()), None)


def fetched(card: Card) -> Path | None:
    """What ``data fetch`` stored, or ``None``; a :class:`DataError` if it has lost files since."""
    note = store(card) / "current.json"
    try:
        name = json.loads(note.read_text(encoding="utf-8"))["folder"]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    folder = store(card) / str(name)
    receipt = read_receipt(folder.with_suffix(".json"))
    if receipt is None or not folder.is_dir():
        return None
    files = len(data_files(folder, upstream(card)[1]))
    if files != receipt.files:
        raise DataError(
            f"{folder} holds {files} of the {receipt.files} files that were fetched: "
            f"run `python -m benchmark data fetch {card.id}` again"
        )
    return folder
