"""Data set cards: what a set is, whose it is, under which licence, and the digest of every file of it.

Cards are TOML files beside this module, read strictly: an unknown key is a fault of the card.
"""

from __future__ import annotations

import gzip
import json
from fnmatch import fnmatchcase
from functools import cache
from importlib import resources
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from benchmark.errors import DataError, UnknownNameError
from benchmark.toml import parse_toml

Protocol = Literal["paper", "actors-kfold", "take-block", "action", "auto"]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class Licence(_Strict):
    """What one may do with a data set; ``None`` for ``commercial`` means that nobody says."""

    name: str
    url: str = ""
    redistribution: str
    commercial: bool | None = None
    notes: str = ""


class Citation(_Strict):
    """How to cite a data set."""

    text: str
    bibtex: str = ""


class Source(_Strict):
    """A public repository at one commit."""

    repository: str = Field(pattern=r"^[\w.-]+/[\w.-]+$")
    commit: str = Field(pattern=r"^[0-9a-f]{40}$")

    @property
    def url(self) -> str:
        """Address of the zip archive of that commit."""
        return f"https://github.com/{self.repository}/archive/{self.commit}.zip"

    @property
    def folder(self) -> str:
        """Name of the archive's only top folder."""
        return f"{self.repository.split('/')[1]}-{self.commit}"


class Layout(_Strict):
    """What lies in the archive, below its top folder.

    ``data`` are the patterns of motion files, ``keep`` those of texts worth unpacking beside them; everything else is left
    packed. ``table`` names the table of digests, ``marker`` a folder by which an unpacked copy is recognised.
    """

    data: tuple[str, ...]
    keep: tuple[str, ...] = ()
    table: str
    marker: str
    max_bytes: int = 4 * 1024**3

    def is_data(self, name: str) -> bool:
        """Whether ``name`` (relative, with forward slashes) is a motion file of the set."""
        return any(fnmatchcase(name, pattern) for pattern in self.data)

    def is_wanted(self, name: str) -> bool:
        """Whether ``name`` is a motion file or a text to keep."""
        return self.is_data(name) or any(fnmatchcase(name, pattern) for pattern in self.keep)


class Actor(_Strict):
    """What is known of a performer; ``age`` in years."""

    style: str
    sex: Literal["F", "M", ""] = ""
    age: int | None = None
    handedness: Literal["L", "R", "B", ""] = ""
    notes: str = ""


class Card(_Strict):
    """A data set's card.

    ``fps`` is the rate of capture and ``working_fps`` that of the clips handed out (``None`` for both: as found);
    ``pattern`` is the layout of a set that is a folder of files; ``traps`` are what a reader must know.
    """

    id: str
    title: str
    version: str
    summary: str
    kind: Literal["generated", "download", "own-copy"]
    licence: Licence
    citation: Citation
    source: Source | None = None
    layout: Layout | None = None
    pattern: str = ""
    capture: str = ""
    joints: int | None = None
    fps: float | None = None
    working_fps: float | None = None
    default_protocol: Protocol = "paper"
    styles: dict[str, str] = {}
    actions: tuple[str, ...] = ()
    actors: dict[str, Actor] = {}
    traps: tuple[str, ...] = ()
    how_to_get: str = ""

    def digests(self) -> dict[str, str]:
        """SHA-256 of every motion file of the upstream archive by relative path; empty where nobody published them."""
        return {} if self.layout is None else dict(_table(self.layout.table))


@cache
def _table(name: str) -> dict[str, str]:
    packed = (resources.files("benchmark.data") / "cards" / name).read_bytes()
    rows = (line.split(maxsplit=1) for line in gzip.decompress(packed).decode().splitlines() if line.strip())
    return {path.removeprefix("*"): digest for digest, path in rows}


@cache
def card_ids() -> tuple[str, ...]:
    """The ids of all cards, sorted."""
    folder = resources.files("benchmark.data") / "cards"
    return tuple(sorted(entry.name[:-5] for entry in folder.iterdir() if entry.name.endswith(".toml")))


@cache
def load_card(card_id: str) -> Card:
    """The card of that id; an :class:`~benchmark.errors.UnknownNameError` suggests the nearest."""
    if card_id not in card_ids():
        raise UnknownNameError("data set", card_id, card_ids())
    return parse_card((resources.files("benchmark.data") / "cards" / f"{card_id}.toml").read_bytes(), f"{card_id}.toml")


def parse_card(content: bytes, name: str) -> Card:
    """The card in the TOML text ``content`` of file ``name``; a :class:`~benchmark.errors.DataError` names file and field."""
    try:
        fields = parse_toml(content.decode("utf-8"))
        # TOML has lists where the card has tuples: JSON-mode validation is strict about everything else.
        return Card.model_validate_json(json.dumps(fields))
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise DataError(f"{name}: {where}: {first['msg']}") from error
    except (ValueError, TypeError, RecursionError) as error:  # not UTF-8, not TOML, or a date
        raise DataError(f"{name} is no card: {error}") from error


def list_cards() -> list[Card]:
    """Every card, sorted by id."""
    return [load_card(card_id) for card_id in card_ids()]
