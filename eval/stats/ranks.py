"""Rank tests of repeated measures: Friedman with Nemenyi's critical difference, and Wilcoxon with Holm."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from eval.stats.correction import holm
from eval.stats.frames import select_pairs, to_wide
from eval.stats.posthoc import ALTERNATIVES, studentized_range_p, studentized_range_quantile

if TYPE_CHECKING:
    import pandas as pd


def row_ranks(values: NDArray[np.float64], *, best: str = "low") -> NDArray[np.float64]:
    """Ranks 1 … k within each row of ``values`` (…, n, k), ties averaged; rank 1 is the lowest or the highest value.

    Raises
    ------
    ValueError
        If ``best`` is neither ``"low"`` nor ``"high"``.
    """
    from scipy.stats import rankdata

    if best not in ("low", "high"):
        raise ValueError(f'best must be "low" or "high", not {best!r}')
    return np.asarray(rankdata(values if best == "low" else -values, axis=-1), dtype=np.float64)


def friedman_statistic(ranks: NDArray[np.float64]) -> tuple[float, float]:
    """Friedman's chi-squared with the correction for ties, and Kendall's W, of ranks (n, k); NaN if all rows are tied."""
    n, k = ranks.shape
    mean = 0.5 * (k + 1)
    spread = float(((ranks - mean) ** 2).sum())
    if spread <= 0.0:
        return float("nan"), float("nan")
    chi2 = (k - 1) * float(((ranks.sum(axis=0) - n * mean) ** 2).sum()) / spread
    return chi2, chi2 / (n * (k - 1))


def critical_difference(n: int, k: int, *, alpha: float = 0.05) -> float:
    """Nemenyi's critical difference of mean ranks: ``q_alpha sqrt(k (k + 1) / (6 n))``.

    ``q_alpha`` is the quantile of the studentised range of k means with infinitely many degrees of freedom over sqrt(2)
    (Demsar, Journal of Machine Learning Research 7, 2006, equation for CD).
    """
    return studentized_range_quantile(1.0 - alpha, k, float("inf")) / np.sqrt(2.0) * np.sqrt(k * (k + 1) / (6.0 * n))


def rank_groups(mean_rank: ArrayLike, cd: float) -> list[list[int]]:
    """Maximal sets of two or more levels whose mean ranks all lie within ``cd``: the bars of a diagram.

    Parameters
    ----------
    mean_rank
        (k,) mean ranks.
    cd
        Critical difference; levels that differ by less are not told apart.

    Returns
    -------
    list of list of int
        Positions in ``mean_rank``, best first; bars ordered by their best member. None contains another.
    """
    ranks = np.asarray(mean_rank, dtype=np.float64)
    order = np.argsort(ranks, kind="stable")
    bars: list[list[int]] = []
    reached = 0
    for start in range(len(order)):
        stop = start + 1
        while stop < len(order) and ranks[order[stop]] - ranks[order[start]] < cd:
            stop += 1
        # A run that ends no later than an earlier one lies inside it.
        if stop - start > 1 and stop > reached:
            bars.append([int(index) for index in order[start:stop]])
            reached = stop
    return bars


def friedman(
    df: pd.DataFrame,
    *,
    subject: str,
    within: str,
    value: str,
    missing: str = "error",
    aggregate: str | None = None,
) -> pd.DataFrame:
    """Friedman's test of repeated measures by ranks.

    Parameters
    ----------
    df, subject, within, value, missing, aggregate
        As in :func:`eval.stats.anova.rm_anova`, with one within-subject factor.

    Returns
    -------
    DataFrame
        One row: ``effect, chi2, df, p, F, df1, df2, p_F, W, n, k, n_dropped``. ``chi2`` is corrected for ties; ``F`` is the
        less conservative form of Iman & Davenport (1980); ``W`` is Kendall's concordance. All NaN where every subject
        gives the same value to all conditions.
    """
    import pandas as pd
    from scipy.special import chdtrc, fdtrc

    wide = to_wide(df, subject=subject, within=within, value=value, missing=missing, aggregate=aggregate)
    n, k = wide.values.shape
    chi2, concordance = friedman_statistic(row_ranks(wide.values))
    room = n * (k - 1) - chi2
    F = (n - 1) * chi2 / room if room > 1e-12 * n else float("inf")
    df2 = (k - 1) * (n - 1)
    p_F = float("nan") if np.isnan(chi2) else 0.0 if np.isinf(F) else float(fdtrc(k - 1, df2, F))
    row = {
        "effect": within,
        "chi2": chi2,
        "df": k - 1,
        "p": float(chdtrc(k - 1, chi2)),
        "F": float("nan") if np.isnan(chi2) else F,
        "df1": k - 1,
        "df2": df2,
        "p_F": p_F,
        "W": concordance,
        "n": n,
        "k": k,
        "n_dropped": len(wide.dropped),
    }
    return pd.DataFrame([row])


def mean_ranks(
    df: pd.DataFrame,
    *,
    subject: str,
    within: str,
    value: str,
    best: str = "high",
    alpha: float = 0.05,
    missing: str = "error",
    aggregate: str | None = None,
) -> pd.DataFrame:
    """Mean ranks and the groups that Nemenyi's test cannot tell apart: what a critical-difference diagram draws.

    Parameters
    ----------
    df, subject, within, value, missing, aggregate
        As in :func:`eval.stats.anova.rm_anova`, with one within-subject factor.
    best
        Whether the ``"high"`` or the ``"low"`` value has rank 1.
    alpha
        Familywise error.

    Returns
    -------
    DataFrame
        One row for each level, best first: ``level, mean_rank, groups, cd, n, k, n_dropped``. ``groups`` is a tuple of the
        numbers of the bars the level belongs to, empty where it differs from every other.
    """
    import pandas as pd

    wide = to_wide(df, subject=subject, within=within, value=value, missing=missing, aggregate=aggregate)
    n, k = wide.values.shape
    ranks = row_ranks(wide.values, best=best).mean(axis=0)
    cd = critical_difference(n, k, alpha=alpha)
    bars = rank_groups(ranks, cd)
    order = np.argsort(ranks, kind="stable")
    return pd.DataFrame(
        {
            "level": [wide.levels[0][index] for index in order],
            "mean_rank": ranks[order],
            "groups": [tuple(number for number, bar in enumerate(bars) if index in bar) for index in order],
            "cd": cd,
            "n": n,
            "k": k,
            "n_dropped": len(wide.dropped),
        }
    )


def friedman_nemenyi(
    df: pd.DataFrame,
    *,
    subject: str,
    within: str,
    value: str,
    best: str = "high",
    alpha: float = 0.05,
    missing: str = "error",
    aggregate: str | None = None,
) -> pd.DataFrame:
    """All pairs of levels by Nemenyi's test of mean ranks, with Friedman's test beside them.

    Parameters
    ----------
    df, subject, within, value, best, alpha, missing, aggregate
        As in :func:`mean_ranks`.

    Returns
    -------
    DataFrame
        One row for each pair: ``a, b, mean_rank_a, mean_rank_b, diff (a - b), q, p, cd, reject, chi2, df, p_friedman, n, k,
        n_dropped``; the last columns are the same in every row.

    Notes
    -----
    ``q = |diff| / sqrt(k (k + 1) / (6 n))``, compared with the studentised range over sqrt(2) (Nemenyi 1963; Demsar 2006).
    A pair is rejected where ``|diff| >= cd``.
    """
    import pandas as pd
    from scipy.special import chdtrc

    wide = to_wide(df, subject=subject, within=within, value=value, missing=missing, aggregate=aggregate)
    levels = wide.levels[0]
    n, k = wide.values.shape
    ranks = row_ranks(wide.values, best=best)
    chi2, _ = friedman_statistic(ranks)
    rank = ranks.mean(axis=0)
    first, second = np.triu_indices(k, 1)
    diff = rank[first] - rank[second]
    q = np.abs(diff) / np.sqrt(k * (k + 1) / (6.0 * n))
    cd = critical_difference(n, k, alpha=alpha)
    return pd.DataFrame(
        {
            "a": [levels[index] for index in first],
            "b": [levels[index] for index in second],
            "mean_rank_a": rank[first],
            "mean_rank_b": rank[second],
            "diff": diff,
            "q": q,
            "p": studentized_range_p(q * np.sqrt(2.0), k, float("inf")),
            "cd": cd,
            "reject": np.abs(diff) >= cd,
            "chi2": chi2,
            "df": k - 1,
            "p_friedman": float(chdtrc(k - 1, chi2)),
            "n": n,
            "k": k,
            "n_dropped": len(wide.dropped),
        }
    )


def wilcoxon_holm(
    df: pd.DataFrame,
    *,
    subject: str,
    within: str,
    value: str,
    pairs: Sequence[tuple[Any, Any]] | None = None,
    alternative: str = "two-sided",
    alpha: float = 0.05,
    missing: str = "error",
    aggregate: str | None = None,
) -> pd.DataFrame:
    """Wilcoxon's signed-rank test of each pair, corrected by Holm.

    Parameters
    ----------
    df, subject, within, value, pairs, alternative, alpha, missing, aggregate
        As in :func:`eval.stats.posthoc.holm_paired`.

    Returns
    -------
    DataFrame
        One row for each pair: ``a, b, median_diff, W_plus, W_minus, p, p_holm, reject, r, n, n_zero, n_dropped``. ``r`` is the
        matched-pairs rank-biserial correlation ``(W_plus - W_minus) / (W_plus + W_minus)``.

    Notes
    -----
    Zero differences are ranked and then left out (Pratt 1959), because ratings on a short scale tie often. Where all
    are zero p is 1. Exact for up to 50 subjects without ties or zeros, by all sign patterns for up to 13 with them, else the
    normal approximation corrected for ties. Rank-biserial: Kerby, Comprehensive Psychology 3 (2014).
    """
    import pandas as pd
    from scipy.stats import rankdata, wilcoxon

    if alternative not in ALTERNATIVES:
        raise ValueError(f"alternative must be one of {', '.join(ALTERNATIVES)}, not {alternative!r}")
    wide = to_wide(df, subject=subject, within=within, value=value, missing=missing, aggregate=aggregate)
    levels = wide.levels[0]
    rows = []
    for i, j in select_pairs(levels, pairs):
        d = wide.values[:, i] - wide.values[:, j]
        ranks = rankdata(np.abs(d))
        plus, minus = float(ranks[d > 0].sum()), float(ranks[d < 0].sum())
        moved = bool(np.any(d != 0))
        test: Any = wilcoxon(d, zero_method="pratt", alternative=alternative) if moved else None  # type: ignore[call-overload]
        rows.append(
            {
                "a": levels[i],
                "b": levels[j],
                "median_diff": float(np.median(d)),
                "W_plus": plus,
                "W_minus": minus,
                "p": float(test.pvalue) if moved else 1.0,
                "r": (plus - minus) / (plus + minus) if moved else 0.0,
                "n": len(d),
                "n_zero": int((d == 0).sum()),
                "n_dropped": len(wide.dropped),
            }
        )
    table = pd.DataFrame(rows)
    adjusted = holm(table["p"].to_numpy())
    table.insert(6, "p_holm", adjusted)
    table.insert(7, "reject", adjusted <= alpha)
    return table
