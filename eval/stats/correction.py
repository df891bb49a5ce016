"""Correction for multiple tests within a declared family."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from eval.stats.frames import numeric, require_columns

if TYPE_CHECKING:
    import pandas as pd


def holm(p: ArrayLike) -> NDArray[np.float64]:
    """Holm's step-down adjusted p values; NaN entries stay NaN and are not counted as tests.

    Parameters
    ----------
    p
        (m,) p values of one family.

    Returns
    -------
    ndarray
        (m,): with the p values in ascending order, ``max_{j <= i} min(1, (m - j + 1) p_(j))``.

    Raises
    ------
    ValueError
        If a value lies outside [0, 1].

    Notes
    -----
    Holm, "A simple sequentially rejective multiple test procedure", Scandinavian Journal of Statistics 6 (1979). It holds
    the familywise error under any dependence and is never less powerful than Bonferroni.
    """
    values = np.asarray(p, dtype=np.float64)
    given = values[np.isfinite(values)]
    _check_range(given)
    return _stepped_down(values, len(given) - np.arange(len(given)))


def shaffer(p: ArrayLike) -> NDArray[np.float64]:
    """Shaffer's adjusted p values of the tests of all pairs of k conditions: Holm's procedure, with fewer tests to pay for.

    Parameters
    ----------
    p
        (k (k - 1) / 2,) p values, one for each pair, in any order; NaN entries, pairs that could not be tested, stay NaN.

    Returns
    -------
    ndarray
        With the p values in ascending order, ``max_{j <= i} min(1, t_j p_(j))``; ``t_j`` is the largest number of pairs that
        can be equal, and not more than are left, given how equality of conditions carries over: see :func:`equal_pairs`.

    Raises
    ------
    ValueError
        If a value lies outside [0, 1], or the number of values is not that of all pairs of some number of conditions.

    Notes
    -----
    Procedure S1 of Shaffer, "Modified sequentially rejective multiple test procedures", Journal of the American Statistical
    Association 81 (1986). It holds the familywise error under any dependence and is never less powerful than Holm's.
    """
    values = np.asarray(p, dtype=np.float64)
    pairs = len(values)
    conditions = round((1.0 + np.sqrt(1.0 + 8.0 * pairs)) / 2.0)
    if conditions * (conditions - 1) // 2 != pairs:
        raise ValueError(f"Shaffer's procedure is for all pairs of k conditions; {pairs} tests are no such family")
    there = np.isfinite(values)
    given = values[there]
    _check_range(given)
    possible = np.asarray(equal_pairs(conditions))
    tested = len(given)
    steps = np.asarray([min(possible[possible <= pairs - j].max(), tested - j) for j in range(tested)])
    return _stepped_down(values, steps)


def equal_pairs(conditions: int) -> tuple[int, ...]:
    """How many of the pairs of ``conditions`` can be equal at once, ascending.

    Equality carries over (a = b and b = c make a = c), so equal conditions form blocks: of three conditions 0, 1 or 3 pairs
    can be equal, never 2.
    """
    found: list[set[int]] = [{0}]
    for total in range(1, conditions + 1):
        # One block of `size` conditions, and any way of splitting the others.
        found.append({size * (size - 1) // 2 + rest for size in range(1, total + 1) for rest in found[total - size]})
    return tuple(sorted(found[conditions]))


def _check_range(given: NDArray[np.float64]) -> None:
    if ((given < 0) | (given > 1)).any():
        raise ValueError(f"p values lie in [0, 1]; got {given.min()} to {given.max()}")


def _stepped_down(values: NDArray[np.float64], steps: NDArray[np.int64]) -> NDArray[np.float64]:
    """The finite ``values``, ascending, times ``steps``, never falling and at most 1; the others stay NaN."""
    there = np.isfinite(values)
    given = values[there]
    order = np.argsort(given, kind="stable")
    stepped = np.minimum(1.0, np.maximum.accumulate(given[order] * steps)) if len(given) else given
    adjusted = np.empty_like(given)
    adjusted[order] = stepped
    result = np.full(values.shape, np.nan)
    result[there] = adjusted
    return result


def holm_within(
    df: pd.DataFrame, *, family: str | Sequence[str] | None = None, p: str = "p", alpha: float = 0.05
) -> pd.DataFrame:
    """Add Holm's correction to a table of tests, family by family.

    Parameters
    ----------
    df
        One row for each test.
    family
        Columns whose values name the family a test belongs to; ``None`` makes the whole table one family. Families are
        to be declared before the data are seen.
    p
        Column of p values.
    alpha
        Familywise error within each family.

    Returns
    -------
    DataFrame
        A copy with columns ``p_holm``, ``family_size`` and ``reject``.
    """
    columns = [] if family is None else [family] if isinstance(family, str) else list(family)
    require_columns(df, p, *columns)
    values = numeric(df, p)
    group = (
        df.groupby(columns, sort=False, dropna=False).ngroup().to_numpy() if columns else np.zeros(len(df), np.int64)
    )
    adjusted, size = np.full(len(df), np.nan), np.zeros(len(df), dtype=np.int64)
    for label in np.unique(group):
        rows = group == label
        adjusted[rows] = holm(values[rows])
        size[rows] = int(np.isfinite(values[rows]).sum())
    return df.assign(p_holm=adjusted, family_size=size, reject=adjusted <= alpha)
