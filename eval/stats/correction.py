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
    there = np.isfinite(values)
    given = values[there]
    if ((given < 0) | (given > 1)).any():
        raise ValueError(f"p values lie in [0, 1]; got {given.min()} to {given.max()}")
    order = np.argsort(given, kind="stable")
    steps = len(given) - np.arange(len(given))
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
