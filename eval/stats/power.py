"""Power of the planned tests, and how many raters they need. Nothing here looks at data."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd

#: Raters beyond which a search is given up: no study of this kind is larger.
MOST_RATERS = 100_000


def power_rm(*, n: int, k: int, f: float, rho: float = 0.5, eps: float = 1.0, alpha: float = 0.05) -> float:
    """Power of the repeated-measures F test of one within-subject factor.

    Parameters
    ----------
    n, k
        Raters and conditions.
    f
        Cohen's f: standard deviation of the condition means over that of one observation within a condition.
    rho
        Correlation between conditions.
    eps
        Greenhouse-Geisser epsilon, from 1 / (k - 1) to 1.
    alpha
        Level of the test.

    Returns
    -------
    float
        ``P(F' > F_crit)`` with noncentrality ``n k f^2 eps / (1 - rho)`` on ``eps (k - 1)`` and
        ``eps (k - 1)(n - 1)`` degrees of freedom (Cohen 1988; Muller & Barton, JASA 84, 1989; as G*Power 3 computes it
        with the effect size "as in G*Power").

    Raises
    ------
    ValueError
        For a value out of its range.
    """
    from scipy.stats import f as f_law
    from scipy.stats import ncf

    if n < 2 or k < 2 or f < 0 or not -1.0 / (k - 1) <= rho < 1.0 or not 0 < alpha < 1:
        raise ValueError(f"needs n, k >= 2, f >= 0, rho in [-1/(k-1), 1), alpha in (0, 1); got {(n, k, f, rho, alpha)}")
    if not 1.0 / (k - 1) - 1e-12 <= eps <= 1.0:
        raise ValueError(f"eps must lie in [{1.0 / (k - 1):.4g}, 1] for {k} conditions, got {eps}")
    df1, df2 = eps * (k - 1), eps * (k - 1) * (n - 1)
    critical = f_law.isf(alpha, df1, df2)
    noncentrality = n * k * f * f * eps / (1.0 - rho)
    if noncentrality == 0.0:
        return alpha
    return float(ncf.sf(critical, df1, df2, noncentrality))


def _fewest(power_of: Callable[[int], float], power: float) -> int:
    """The least n from 2 on with at least this power, for a power that grows with n."""
    high = 2
    while power_of(high) < power:
        high *= 2
        if high > MOST_RATERS:
            raise ValueError(f"more than {MOST_RATERS} raters would be needed for power {power}")
    low = high // 2
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if power_of(middle) >= power else (middle, high)
    return high


def raters_needed(
    *, k: int, f: float, rho: float = 0.5, eps: float = 1.0, alpha: float = 0.05, power: float = 0.8
) -> int:
    """The fewest raters with which :func:`power_rm` reaches ``power``.

    Raises
    ------
    ValueError
        If no number up to ``MOST_RATERS`` is enough.
    """
    return _fewest(lambda n: power_rm(n=n, k=k, f=f, rho=rho, eps=eps, alpha=alpha), power)


def power_paired(*, n: int, dz: float, alpha: float = 0.05, alternative: str = "two-sided") -> float:
    """Power of the paired t test for a standardised difference ``dz``.

    Parameters
    ----------
    n
        Pairs.
    dz
        Mean of the differences over their standard deviation; positive is the direction of ``"greater"``.
    alpha
        Level of the test; divide it by the number of contrasts for the worst case of Holm's procedure.
    alternative
        ``"two-sided"``, ``"greater"`` or ``"less"``.

    Returns
    -------
    float
        From the noncentral t distribution with noncentrality ``dz sqrt(n)`` on n - 1 degrees of freedom.
    """
    from scipy.special import nctdtr, stdtrit

    if n < 2 or not 0 < alpha < 1:
        raise ValueError(f"needs at least 2 pairs and alpha in (0, 1), got {n} and {alpha}")
    if alternative not in ("two-sided", "greater", "less"):
        raise ValueError(f"alternative must be two-sided, greater or less, not {alternative!r}")
    nc = (abs(dz) if alternative == "two-sided" else dz if alternative == "greater" else -dz) * n**0.5
    critical = float(stdtrit(n - 1, 1.0 - (alpha / 2.0 if alternative == "two-sided" else alpha)))

    def above(noncentrality: float) -> float:
        below = float(nctdtr(n - 1, noncentrality, critical))
        # Far out in either tail, where the distribution function is 0 or 1, it can come out as NaN.
        return 1.0 - below if below == below else float(noncentrality > critical)

    # The other tail is P(T < -c) at nc, which equals P(T > c) at -nc.
    return above(nc) + (above(-nc) if alternative == "two-sided" else 0.0)


def smallest_dz(*, n: int, alpha: float = 0.05, power: float = 0.8, alternative: str = "two-sided") -> float:
    """The smallest (absolute) paired d_z that ``n`` pairs detect with this power."""
    from scipy.optimize import brentq

    sign = -1.0 if alternative == "less" else 1.0
    return float(
        brentq(lambda d: power_paired(n=n, dz=sign * d, alpha=alpha, alternative=alternative) - power, 0.0, 20.0)
    )


def power_table(
    *,
    n: Sequence[int],
    k: int,
    f: Sequence[float] = (0.1, 0.15, 0.2, 0.25, 0.4),
    rho: Sequence[float] = (0.3, 0.5),
    eps: Sequence[float] = (1.0, 0.7),
    alpha: float = 0.05,
) -> pd.DataFrame:
    """Power over a grid, for the planning section of a report.

    Returns
    -------
    DataFrame
        One row for each combination: ``n, k, f, rho, eps, alpha, power, smallest_dz, smallest_dz_bonferroni``. The last two
        are what paired contrasts of n raters detect at 80 %, alone and with alpha over all k (k - 1) / 2 pairs.
    """
    import pandas as pd

    pairs = k * (k - 1) / 2
    rows = []
    for raters in n:
        alone, corrected = (smallest_dz(n=raters, alpha=level) for level in (alpha, alpha / pairs))
        rows += [
            {
                "n": raters,
                "k": k,
                "f": size,
                "rho": correlation,
                "eps": e,
                "alpha": alpha,
                "power": power_rm(n=raters, k=k, f=size, rho=correlation, eps=e, alpha=alpha),
                "smallest_dz": alone,
                "smallest_dz_bonferroni": corrected,
            }
            for size in f
            for correlation in rho
            for e in eps
        ]
    return pd.DataFrame(rows)
