"""Ratings and tables made of them to CSV; what simulated observers answered says so."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from eval.ratings.reading import PEOPLE

if TYPE_CHECKING:
    import pandas as pd


def write_ratings(path: Path, ratings: pd.DataFrame, *, kind: str, remarks: tuple[str, ...] = ()) -> None:
    """Write a ratings file that :func:`eval.ratings.reading.read_ratings` reads; one not of people begins by saying so.

    Parameters
    ----------
    path
        The file.
    ratings
        With the columns of the format.
    kind
        Whose answers they are.
    remarks
        Lines to put before the header.
    """
    lines = [] if kind == PEOPLE else [kind]
    head = "".join(f"# {' '.join(line.split())}\n".replace('"', "'") for line in (*lines, *remarks))
    table = ratings.assign(kind=kind)
    path.write_text(head + table.to_csv(index=False, lineterminator="\n"), encoding="utf-8")


def write_table(path: Path, table: pd.DataFrame, *, kind: str) -> None:
    """Write a table made of ratings, with whose they are in a column ``kind`` of every row."""
    table.assign(kind=kind).to_csv(path, index=False, lineterminator="\n")
