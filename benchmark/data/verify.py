"""Comparing a copy of a public data set with upstream's digests."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from benchmark.data.archive import data_files, upstream
from benchmark.data.cards import Card
from benchmark.digest import file_digest


@dataclass(frozen=True)
class Verification:
    """What a copy has and lacks; relative names, sorted.

    Attributes
    ----------
    sound
        Files that are upstream's, bit for bit.
    missing
        Files that upstream has and the copy does not: expected of a subset.
    altered
        Files whose content is not upstream's, or that cannot be read.
    extra
        Motion files that upstream does not have.
    """

    folder: Path
    sound: tuple[str, ...]
    missing: tuple[str, ...]
    altered: tuple[str, ...]
    extra: tuple[str, ...]

    def ok(self, *, complete: bool = False) -> bool:
        """Whether nothing is altered or extra, and, if ``complete``, nothing missing."""
        return not self.altered and not self.extra and not (complete and self.missing)


def verify(card: Card, folder: Path, *, report: Callable[[int, int], None] = lambda done, total: None) -> Verification:
    """Read every motion file of ``folder`` and compare it with the card's table of digests."""
    _, layout = upstream(card)
    table = card.digests()
    present = data_files(folder, layout)
    sound: list[str] = []
    altered: list[str] = []
    known = [name for name in present if name in table]
    for count, name in enumerate(known, start=1):
        try:
            same = file_digest(present[name]) == table[name]
        except OSError:
            same = False
        (sound if same else altered).append(name)
        report(count, len(known))
    return Verification(
        folder,
        tuple(sound),
        tuple(sorted(table.keys() - present.keys())),
        tuple(altered),
        tuple(name for name in present if name not in table),
    )
