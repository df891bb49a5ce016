"""Effect sizes and their intervals."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from eval.stats.frames import to_wide

if TYPE_CHECKING:
    import pandas as pd


class Effect(NamedTuple):
    """A standardised difference and its interval."""

    estimate: float
    low: float
    high: float


def _noncentrality(cdf: object, observed: float, probability: float, low: float, high: float) -> float:
    """The noncentrality at which ``observed`` is the ``probability`` quantile; ``cdf(x, nc)`` falls with ``nc``."""
    from scipy.optimize import brentq

    def excess(nc: float) -> float:
        return float(cdf(observed, nc)) - probability  # type: ignore[operator]

    if excess(low) <= 0.0:
        return low
    return float(brentq(excess, low, high, xtol=1e-9))


def eta_p2_interval(F: float, df1: float, df2: float, *, level: float = 0.90) -> tuple[float, float]:
    """Interval of partial eta squared from the noncentral F distribution.

    Parameters
    ----------
    F, df1, df2
        The test.
    level
        90 % by convention: its lower end is above 0 exactly where the F test is significant at 5 %.

    Returns
    -------
    tuple
        ``low, high``; NaN if F is not finite.

    Notes
    -----
    Steiger, Psychological Methods 9 (2004): limits of the noncentrality ``lambda`` by inverting the distribution,
    turned into ``lambda / (lambda + df1 + df2 + 1)``. Uncorrected degrees of freedom: exact under sphericity only.
    """
    if not np.isfinite(F):
        return float("nan"), float("nan")
    from scipy.special import ncfdtr

    def cdf(x: float, nc: float) -> float:
        value = float(ncfdtr(df1, df2, nc, x))
        # Far out in the lower tail, where the distribution function is 0, it comes out as NaN.
        return 0.0 if np.isnan(value) and nc > x * df1 else value

    tail = 0.5 * (1.0 - level)
    ceiling = 10.0 * (F * df1 + df1 + 50.0)
    limits = [_noncentrality(cdf, F, probability, 0.0, ceiling) for probability in (1.0 - tail, tail)]
    low, high = (nc / (nc + df1 + df2 + 1.0) for nc in limits)
    return low, high


def dz(difference: ArrayLike, *, level: float = 0.95) -> Effect:
    """Cohen's d_z of paired differences: their mean over their standard deviation.

    Parameters
    ----------
    difference
        (n,) differences of pairs, n >= 2.

    Returns
    -------
    Effect
        NaN where the differences do not vary. The interval inverts the noncentral t distribution (Cumming & Finch,
        Educational and Psychological Measurement 61, 2001) and so agrees with the paired t test.
    """
    d = np.asarray(difference, dtype=np.float64)
    spread = float(d.std(ddof=1))
    if not spread > 1e-14 * max(1.0, float(np.abs(d).max())):
        return Effect(float("nan"), float("nan"), float("nan"))
    from scipy.special import nctdtr

    n = len(d)
    estimate = float(d.mean()) / spread
    # By symmetry the limits are found for a positive effect, where the distribution function is well behaved.
    size = abs(estimate)
    t = size * np.sqrt(n)
    tail = 0.5 * (1.0 - level)
    reach = 12.0 + 4.0 * t

    def cdf(x: float, nc: float) -> float:
        value = float(nctdtr(n - 1, nc, x))
        # Far out in either tail, where it is 0 or 1, it can come out as NaN.
        return float(nc < x) if np.isnan(value) else value

    low, high = (_noncentrality(cdf, t, q, -reach, reach) / np.sqrt(n) for q in (1.0 - tail, tail))
    return Effect(estimate, float(low), float(high)) if estimate >= 0 else Effect(estimate, float(-high), float(-low))


def d_av(a: ArrayLike, b: ArrayLike, *, level: float = 0.95) -> Effect:
    """Standardised difference of two paired conditions by their own spread, so comparable with unpaired designs.

    Parameters
    ----------
    a, b
        (n,) values of the same subjects, n >= 2.

    Returns
    -------
    Effect
        ``(mean a - mean b) / sqrt((var a + var b) / 2)``; NaN where neither varies.

    Notes
    -----
    Cumming, *Understanding the New Statistics* (2012); the large-sample interval of Bonett, Psychological Methods 13
    (2008), for two dependent means.
    """
    from scipy.special import ndtri

    x, y = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    df = len(x) - 1
    va, vb = float(x.var(ddof=1)), float(y.var(ddof=1))
    pooled = 0.5 * (va + vb)
    if not pooled > 1e-28 * max(1.0, float(np.abs(x).max()), float(np.abs(y).max())) ** 2:
        return Effect(float("nan"), float("nan"), float("nan"))
    cov = float(((x - x.mean()) * (y - y.mean())).sum() / df)
    estimate = float(x.mean() - y.mean()) / np.sqrt(pooled)
    variance = estimate**2 * (va**2 + vb**2 + 2.0 * cov**2) / (8.0 * df * pooled**2)
    variance += (va + vb - 2.0 * cov) / (df * pooled)
    half = float(ndtri(0.5 + 0.5 * level)) * np.sqrt(variance)
    return Effect(float(estimate), float(estimate - half), float(estimate + half))


def cousineau_morey(
    df: pd.DataFrame,
    *,
    subject: str,
    within: str,
    value: str,
    level: float = 0.95,
    missing: str = "error",
    aggregate: str | None = None,
) -> pd.DataFrame:
    """Within-subject intervals of condition means, for figures.

    Parameters
    ----------
    df, subject, within, value, missing, aggregate
        As in :func:`eval.stats.anova.rm_anova`, with one within-subject factor.
    level
        Of the interval.

    Returns
    -------
    DataFrame
        One row for each condition: ``level, mean, sd, low, high, n, n_dropped``; ``sd`` is that between subjects.

    Notes
    -----
    Each subject's mean is replaced by the grand mean (Cousineau 2005) and the variance is multiplied by k / (k - 1)
    (Morey, Tutorials in Quantitative Methods for Psychology 4, 2008). Such intervals show differences within subjects
    and say nothing about where a mean lies in the population.
    """
    import pandas as pd
    from scipy.special import stdtrit

    wide = to_wide(df, subject=subject, within=within, value=value, missing=missing, aggregate=aggregate)
    y = wide.values
    n, k = y.shape
    centred = y - y.mean(axis=1, keepdims=True) + y.mean()
    se = np.sqrt(centred.var(axis=0, ddof=1) * k / (k - 1) / n)
    half = float(stdtrit(n - 1, 0.5 + 0.5 * level)) * se
    means = y.mean(axis=0)
    return pd.DataFrame(
        {
            "level": wide.levels[0],
            "mean": means,
            "sd": y.std(axis=0, ddof=1),
            "low": means - half,
            "high": means + half,
            "n": n,
            "n_dropped": len(wide.dropped),
        }
    )
