"""From long tables to arrays: what every analysis checks before it computes."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pandas as pd

#: Labels that an error message lists before it only counts the rest.
LISTED = 8


def listing(labels: Sequence[Any]) -> str:
    """Labels as a message names them: the first few, then how many more there are."""
    shown = ", ".join(str(label) for label in labels[:LISTED])
    return shown if len(labels) <= LISTED else f"{shown} and {len(labels) - LISTED} more"


def require_columns(df: pd.DataFrame, *names: str) -> None:
    """Refuse a table that lacks a column or has no rows.

    Raises
    ------
    ValueError
        Naming the missing columns and those there are.
    """
    absent = [name for name in names if name not in df.columns]
    if absent:
        raise ValueError(f"no column {listing(absent)}; the table has {listing(list(df.columns))}")
    if len(df) == 0:
        raise ValueError("the table has no rows")


def numeric(df: pd.DataFrame, name: str) -> NDArray[np.float64]:
    """A column as float64; missing values become NaN.

    Raises
    ------
    ValueError
        If it holds words or infinite numbers.
    """
    try:
        values = df[name].to_numpy(dtype=np.float64, na_value=np.nan)
    except (TypeError, ValueError) as error:
        raise ValueError(f"column {name} must hold numbers: {error}") from error
    if np.isinf(values).any():
        raise ValueError(f"column {name} holds infinite values in {int(np.isinf(values).sum())} rows")
    return values


def binary(df: pd.DataFrame, name: str) -> NDArray[np.float64]:
    """A column of 0 and 1 (or false and true) as float64.

    Raises
    ------
    ValueError
        If it holds anything else or lacks values.
    """
    values = numeric(df, name)
    wrong = ~np.isin(values, (0.0, 1.0))
    if wrong.any():
        found = listing(list(np.unique(values[wrong])))
        raise ValueError(f"column {name} must be 0 or 1 in every row; {int(wrong.sum())} rows hold {found}")
    return values


def levels_of(column: pd.Series) -> list[Any]:
    """The levels of a column: in the order of the categories of a categorical, else sorted.

    Missing labels are refused with a ValueError.
    """
    import pandas as pd

    if column.isna().any():
        raise ValueError(f"column {column.name} has {int(column.isna().sum())} rows without a label")
    if isinstance(column.dtype, pd.CategoricalDtype):
        present = set(column.unique())
        return [level for level in column.cat.categories if level in present]
    found = list(column.unique())
    try:
        return sorted(found)
    except TypeError:
        return sorted(found, key=str)


def codes_of(column: pd.Series) -> tuple[NDArray[np.intp], list[Any]]:
    """Positions of a column's entries in :func:`levels_of`, and those levels."""
    levels = levels_of(column)
    place = {level: index for index, level in enumerate(levels)}
    return np.asarray([place[label] for label in column.tolist()], dtype=np.intp), levels


@dataclass(frozen=True)
class Wide:
    """Repeated measures as a matrix.

    Attributes
    ----------
    values
        (n, k): a row for each subject, a column for each cell of the within-subject design, finite.
    subjects
        n labels.
    levels
        For each within-subject factor its levels; the columns of ``values`` are their product, last factor fastest.
    dropped
        Subjects left out because a cell was missing.
    """

    values: NDArray[np.float64]
    subjects: list[Any]
    levels: list[list[Any]]
    dropped: list[Any]


def to_wide(
    df: pd.DataFrame,
    *,
    subject: str,
    within: str | Sequence[str],
    value: str,
    missing: str = "error",
    aggregate: str | None = None,
) -> Wide:
    """Arrange a long table as one row a subject and one column a cell.

    Parameters
    ----------
    df
        One row for each observation.
    subject, within, value
        Names of columns; ``within`` may be several factors.
    missing
        ``"error"`` refuses subjects that lack a cell; ``"drop"`` leaves them out (list-wise) and lists them in
        ``dropped``. A NaN value is a missing cell.
    aggregate
        ``None`` refuses several values in one cell; ``"mean"`` averages them.

    Raises
    ------
    ValueError
        On missing or duplicate cells that were not allowed for, fewer than two subjects or two cells.
    """
    factors = [within] if isinstance(within, str) else list(within)
    if missing not in ("error", "drop"):
        raise ValueError(f'missing must be "error" or "drop", not {missing!r}')
    if aggregate not in (None, "mean"):
        raise ValueError(f'aggregate must be None or "mean", not {aggregate!r}')
    require_columns(df, subject, *factors, value)
    values = numeric(df, value)
    row, subjects = codes_of(df[subject])
    column = np.zeros(len(df), dtype=np.intp)
    levels = []
    for factor in factors:
        code, found = codes_of(df[factor])
        column = column * len(found) + code
        levels.append(found)
    cells = [cell if len(factors) > 1 else cell[0] for cell in product(*levels)]
    there = np.isfinite(values)
    sums, counts = np.zeros((len(subjects), len(cells))), np.zeros((len(subjects), len(cells)))
    np.add.at(sums, (row[there], column[there]), values[there])
    np.add.at(counts, (row[there], column[there]), 1.0)
    if aggregate is None and (counts > 1).any():
        who, what = np.argwhere(counts > 1)[0]
        raise ValueError(
            f"{int((counts > 1).sum())} cells have several values, the first is subject {subjects[who]} in "
            f'{cells[what]}; average them with aggregate="mean" or remove the duplicates'
        )
    complete = np.asarray((counts > 0).all(axis=1))
    dropped = [label for label, whole in zip(subjects, complete, strict=True) if not whole]
    if dropped and missing == "error":
        raise ValueError(
            f"{len(dropped)} of {len(subjects)} subjects lack a value in some cell: {listing(dropped)}; "
            'complete the data or leave these subjects out with missing="drop"'
        )
    if complete.sum() < 2 or len(cells) < 2:
        raise ValueError(
            f"needs at least 2 complete subjects and 2 conditions, got {int(complete.sum())} and {len(cells)}"
        )
    kept = [label for label, whole in zip(subjects, complete, strict=True) if whole]
    return Wide(sums[complete] / counts[complete], kept, levels, dropped)


def select_pairs(levels: Sequence[Any], pairs: Sequence[tuple[Any, Any]] | None) -> list[tuple[int, int]]:
    """Positions of the declared pairs of levels, or of all pairs in order.

    Raises
    ------
    ValueError
        If a pair names an unknown level or the same one twice.
    """
    if pairs is None:
        return [(i, j) for i in range(len(levels)) for j in range(i + 1, len(levels))]
    place: dict[Hashable, int] = {level: index for index, level in enumerate(levels)}
    chosen = []
    for a, b in pairs:
        unknown = [label for label in (a, b) if label not in place]
        if unknown or a == b:
            raise ValueError(f"({a}, {b}) is no pair of two levels; there are {listing(list(levels))}")
        chosen.append((place[a], place[b]))
    return chosen
