"""Which conditions differ: Tukey between and within subjects, and Holm-corrected paired contrasts."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from eval.stats.correction import holm, shaffer
from eval.stats.effects import d_av, dz
from eval.stats.frames import codes_of, numeric, require_columns, select_pairs, to_wide

if TYPE_CHECKING:
    import pandas as pd


@lru_cache(maxsize=64)
def studentized_range_quantile(probability: float, k: int, df: float) -> float:
    """Quantile of the studentised range of ``k`` means with ``df`` (possibly infinite) degrees of freedom."""
    from scipy.stats import studentized_range

    return float(studentized_range.ppf(probability, k, df))


def studentized_range_p(q: NDArray[np.float64], k: int, df: float) -> NDArray[np.float64]:
    """Upper tail of the studentised range; 0 for infinite and NaN for undefined ``q``."""
    from scipy.stats import studentized_range

    result = np.full(q.shape, np.nan)
    finite = np.isfinite(q)
    result[np.isposinf(q)] = 0.0
    # The integral's rounding can leave [0, 1] by an ulp.
    result[finite] = np.clip(studentized_range.sf(q[finite], k, df), 0.0, 1.0)
    return result


def tukey_hsd_between(df: pd.DataFrame, *, group: str, value: str, alpha: float = 0.05) -> pd.DataFrame:
    """Tukey's honestly significant differences between independent groups (Tukey-Kramer for unequal sizes).

    Parameters
    ----------
    df
        One row for each observation; rows without a value are left out.
    group, value
        Names of columns.
    alpha
        Familywise error.

    Returns
    -------
    DataFrame
        One row for each pair: ``a, b, diff (mean a - mean b), p, low, high, reject, n``; intervals are simultaneous.

    Raises
    ------
    ValueError
        With fewer than two groups or no error degrees of freedom.

    Notes
    -----
    For repeated measures this is the wrong error term: it counts the subjects' differences as error and so hardly ever
    rejects. It is here for independent groups and to show what a naive analysis of paired ratings would say.
    """
    import pandas as pd
    from statsmodels.stats.multicomp import MultiComparison

    require_columns(df, group, value)
    values = numeric(df, value)
    there = np.isfinite(values)
    codes, levels = codes_of(df.loc[there, group])
    if len(levels) < 2 or there.sum() <= len(levels):
        raise ValueError(
            f"needs at least 2 groups and more observations than groups, got {len(levels)} and {there.sum()}"
        )
    # Without any variance statistics are 0 / 0, which is no evidence.
    with np.errstate(divide="ignore", invalid="ignore"):
        found = MultiComparison(values[there], codes).tukeyhsd(alpha=alpha)
    first, second = np.triu_indices(len(levels), 1)
    # statsmodels reports b - a.
    return pd.DataFrame(
        {
            "a": [levels[index] for index in first],
            "b": [levels[index] for index in second],
            "diff": -found.meandiffs,
            "p": np.clip(found.pvalues, 0.0, 1.0),
            "low": -found.confint[:, 1],
            "high": -found.confint[:, 0],
            "reject": found.reject,
            "n": int(there.sum()),
        }
    )


def error_mean_square(values: NDArray[np.float64]) -> float:
    """Mean square of subject by condition, the error term of a one-way repeated-measures design (n, k)."""
    n, k = values.shape
    residual = values - values.mean(axis=1, keepdims=True) - values.mean(axis=0) + values.mean()
    return float((residual**2).sum() / ((n - 1) * (k - 1)))


def tukey_hsd_within(
    df: pd.DataFrame,
    *,
    subject: str,
    within: str,
    value: str,
    alpha: float = 0.05,
    missing: str = "error",
    aggregate: str | None = None,
) -> pd.DataFrame:
    """Tukey's honestly significant differences with the within-subject error term.

    Parameters
    ----------
    df, subject, within, value, missing, aggregate
        As in :func:`eval.stats.anova.rm_anova`, with one within-subject factor.
    alpha
        Familywise error.

    Returns
    -------
    DataFrame
        One row for each pair: ``a, b, diff (mean a - mean b), q, df, p, low, high, reject, n, n_dropped``; intervals are
        simultaneous.

    Notes
    -----
    ``q = |diff| / sqrt(MS_err / n)`` against the studentised range of k means on (k - 1)(n - 1) degrees of freedom,
    MS_err being that of subject by condition (Winer, *Statistical Principles in Experimental Design*; Maxwell & Delaney,
    section 11). Valid only under sphericity; otherwise it rejects too often, and :func:`holm_paired` is the one to use.
    """
    import pandas as pd

    wide = to_wide(df, subject=subject, within=within, value=value, missing=missing, aggregate=aggregate)
    y, levels = wide.values, wide.levels[0]
    n, k = y.shape
    free = (n - 1) * (k - 1)
    se = np.sqrt(error_mean_square(y) / n)
    first, second = np.triu_indices(k, 1)
    means = (y - y.mean()).mean(axis=0)
    diff = means[first] - means[second]
    q = np.full(len(diff), np.nan)
    np.divide(np.abs(diff), se, out=q, where=se > 0)
    q[(se <= 0) & (diff != 0)] = np.inf
    half = studentized_range_quantile(1.0 - alpha, k, free) * se
    p = studentized_range_p(q, k, free)
    return pd.DataFrame(
        {
            "a": [levels[index] for index in first],
            "b": [levels[index] for index in second],
            "diff": diff,
            "q": q,
            "df": free,
            "p": p,
            "low": diff - half,
            "high": diff + half,
            "reject": p <= alpha,
            "n": n,
            "n_dropped": len(wide.dropped),
        }
    )


#: The tails a one- or two-sided test may take, for the difference a - b.
ALTERNATIVES = ("two-sided", "greater", "less")


def t_test_p(t: NDArray[np.float64], df: float, alternative: str = "two-sided") -> NDArray[np.float64]:
    """Tail probabilities of t statistics; ``"greater"`` looks for a positive mean.

    Raises
    ------
    ValueError
        For an unknown alternative.
    """
    from scipy.special import stdtr

    if alternative not in ALTERNATIVES:
        raise ValueError(f"alternative must be one of {', '.join(ALTERNATIVES)}, not {alternative!r}")
    if alternative == "two-sided":
        return np.asarray(2.0 * stdtr(df, -np.abs(t)))
    return np.asarray(stdtr(df, -t if alternative == "greater" else t))


def paired_t(difference: NDArray[np.float64]) -> NDArray[np.float64]:
    """Student's t of the columns of paired differences (n, m): infinite without variance, NaN if all are 0."""
    mean = difference.mean(axis=0)
    se = difference.std(axis=0, ddof=1) / np.sqrt(len(difference))
    # A spread at rounding level is none.
    se = np.where(se <= 1e-14 * np.abs(difference).max(axis=0), 0.0, se)
    t = np.full(mean.shape, np.nan)
    np.divide(mean, se, out=t, where=se > 0)
    flat = (se == 0) & (mean != 0)
    t[flat] = np.copysign(np.inf, mean[flat])
    return t


def holm_paired(
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
    """Paired t tests, each with its own error term, corrected by Holm: the primary analysis of repeated measures.

    Parameters
    ----------
    df, subject, within, value, missing, aggregate
        As in :func:`eval.stats.anova.rm_anova`, with one within-subject factor.
    pairs
        The declared family of contrasts (a, b); all pairs by default.
    alternative
        ``"two-sided"``, or ``"greater"`` for a > b, or ``"less"``.
    alpha
        Familywise error; intervals have level ``1 - alpha``.

    Returns
    -------
    DataFrame
        One row for each pair: ``a, b, diff (mean a - mean b), t, df, p, p_holm, p_shaffer, reject, low, high,
        low_simultaneous, high_simultaneous, dz, dz_low, dz_high, d_av, d_av_low, d_av_high, n, n_dropped``. ``reject`` is
        Holm's decision; ``p_shaffer`` stands beside it, and is NaN where the family is not that of all pairs. ``low`` and
        ``high`` are the interval of that pair alone, the simultaneous ones Bonferroni's; both are two-sided. Where a pair
        does not differ for any subject t is NaN and p is 1.

    Notes
    -----
    Holm (1979) over paired t tests holds the familywise error without sphericity. ``d_z`` and ``d_av``: see
    :mod:`eval.stats.effects`.
    """
    import pandas as pd
    from scipy.special import stdtrit

    wide = to_wide(df, subject=subject, within=within, value=value, missing=missing, aggregate=aggregate)
    y, levels = wide.values, wide.levels[0]
    n = len(y)
    chosen = select_pairs(levels, pairs)
    first, second = (np.asarray([pair[side] for pair in chosen], dtype=np.intp) for side in (0, 1))
    difference = y[:, first] - y[:, second]
    t = paired_t(difference)
    p = np.where(np.isnan(t), 1.0, t_test_p(t, n - 1, alternative))
    adjusted = holm(p)
    # One-sided nulls, a <= b, do not carry over as equalities do.
    all_pairs = pairs is None and alternative == "two-sided"
    mean = difference.mean(axis=0)
    se = difference.std(axis=0, ddof=1) / np.sqrt(n)
    one = float(stdtrit(n - 1, 1.0 - alpha / 2.0)) * se
    joint = float(stdtrit(n - 1, 1.0 - alpha / (2.0 * len(chosen)))) * se
    sizes = [dz(column, level=1.0 - alpha) for column in difference.T]
    averages = [d_av(y[:, i], y[:, j], level=1.0 - alpha) for i, j in chosen]
    return pd.DataFrame(
        {
            "a": [levels[index] for index in first],
            "b": [levels[index] for index in second],
            "diff": mean,
            "t": t,
            "df": n - 1,
            "p": p,
            "p_holm": adjusted,
            "p_shaffer": shaffer(p) if all_pairs else np.full(len(p), np.nan),
            "reject": adjusted <= alpha,
            "low": mean - one,
            "high": mean + one,
            "low_simultaneous": mean - joint,
            "high_simultaneous": mean + joint,
            "dz": [size.estimate for size in sizes],
            "dz_low": [size.low for size in sizes],
            "dz_high": [size.high for size in sizes],
            "d_av": [size.estimate for size in averages],
            "d_av_low": [size.low for size in averages],
            "d_av_high": [size.high for size in averages],
            "n": n,
            "n_dropped": len(wide.dropped),
        }
    )
