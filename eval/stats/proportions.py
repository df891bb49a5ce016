"""Score tests of the difference of two independent proportions.

Our own, because the constrained estimate of statsmodels up to 0.15 is not the maximum of the likelihood (its issue 10269).
"""

from __future__ import annotations

import numpy as np

#: How close to -1 and 1 a difference of proportions is looked at.
EDGE = 1e-6


def constrained_shares(yes: tuple[int, int], total: tuple[int, int], difference: float) -> tuple[float, float]:
    """The most likely two proportions that differ by ``difference``, first minus second.

    Parameters
    ----------
    yes, total
        Successes and trials of both samples.
    difference
        In (-1, 1).

    Returns
    -------
    tuple
        ``p_1 = p_2 + difference`` and ``p_2``. The likelihood is concave along that line, so its maximum is where the
        derivative changes sign, or at an end.
    """
    from scipy.optimize import brentq

    low, high = max(0.0, -difference), min(1.0, 1.0 - difference)

    def slope(p: float) -> float:
        return sum(
            x / (p + shift) - (n - x) / (1.0 - p - shift)
            for x, n, shift in ((yes[0], total[0], difference), (yes[1], total[1], 0.0))
        )

    margin = 1e-9 * (high - low)
    if slope(low + margin) <= 0.0:
        second = low
    elif slope(high - margin) >= 0.0:
        second = high
    else:
        second = float(brentq(slope, low + margin, high - margin, xtol=1e-15))
    return float(np.clip(second + difference, 0.0, 1.0)), float(np.clip(second, 0.0, 1.0))


def score_z(yes: tuple[int, int], total: tuple[int, int], difference: float) -> float:
    """Farrington and Manning's z for the hypothesis that the proportions differ by ``difference``.

    ``(p_1 - p_2 - difference) / sqrt(v)`` with the variance at :func:`constrained_shares` (Statistics in Medicine 9, 1990,
    method 3; Miettinen & Nurminen 1985 without their factor n / (n - 1)).
    """
    first, second = constrained_shares(yes, total, difference)
    variance = first * (1.0 - first) / total[0] + second * (1.0 - second) / total[1]
    excess = yes[0] / total[0] - yes[1] / total[1] - difference
    if variance > 0.0:
        return excess / float(np.sqrt(variance))
    return float(np.sign(excess) * np.inf) if excess != 0.0 else 0.0


def score_interval(yes: tuple[int, int], total: tuple[int, int], *, level: float) -> tuple[float, float]:
    """The differences that the two-sided score test at ``1 - level`` does not reject: Mee (Biometrics 40, 1984)."""
    from scipy.optimize import brentq
    from scipy.special import ndtri

    critical = float(ndtri(0.5 + 0.5 * level))
    observed = yes[0] / total[0] - yes[1] / total[1]
    limits = []
    for end, target in ((-1.0 + EDGE, critical), (1.0 - EDGE, -critical)):
        # z falls as the hypothesis rises through the observed difference.
        start = float(np.clip(observed, -1.0 + EDGE, 1.0 - EDGE))
        inside = (score_z(yes, total, end) - target) * (score_z(yes, total, start) - target) < 0.0
        limits.append(
            float(brentq(lambda d, at=target: score_z(yes, total, d) - at, end, start, xtol=1e-12)) if inside else end
        )
    return min(limits[0], observed), max(limits[1], observed)
