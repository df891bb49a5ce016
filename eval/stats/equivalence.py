"""Equivalence with a reference, by two one-sided tests against a margin declared beforehand."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from eval.stats.correction import holm
from eval.stats.frames import binary, codes_of, listing, require_columns, to_wide
from eval.stats.pigeonhole import pigeonhole_draws, tail_p
from eval.stats.posthoc import t_test_p
from eval.stats.proportions import score_interval, score_z

if TYPE_CHECKING:
    import pandas as pd


def _limits(margin: float | tuple[float, float]) -> tuple[float, float]:
    low, high = (-margin, margin) if isinstance(margin, int | float) else margin
    if not low < 0 < high:
        raise ValueError(f"the margin must be positive, or a pair around 0; got {margin}")
    return float(low), float(high)


def _position(levels: list[Any], reference: Any) -> int:
    if reference not in levels:
        raise ValueError(f"no level {reference} to compare with; there are {listing(levels)}")
    return levels.index(reference)


def _finished(rows: list[dict[str, Any]], alpha: float) -> pd.DataFrame:
    """The table of the two one-sided tests of each level: the larger p decides, Holm over the levels."""
    import pandas as pd

    table = pd.DataFrame(rows)
    p = table[["p_lower", "p_upper"]].max(axis=1).to_numpy()
    adjusted = holm(p)
    at = list(table.columns).index("p_upper") + 1
    for offset, (name, column) in enumerate({"p": p, "p_holm": adjusted, "equivalent": adjusted <= alpha}.items()):
        table.insert(at + offset, name, column)
    return table


def tost_paired(
    df: pd.DataFrame,
    *,
    subject: str,
    within: str,
    value: str,
    reference: Any,
    margin: float | tuple[float, float],
    alpha: float = 0.05,
    missing: str = "error",
    aggregate: str | None = None,
) -> pd.DataFrame:
    """Is each condition equivalent to ``reference`` within the margin? Paired t, two one-sided tests.

    Parameters
    ----------
    df, subject, within, value, missing, aggregate
        As in :func:`eval.stats.anova.rm_anova`, with one within-subject factor.
    reference
        The level compared with, such as the real child.
    margin
        Largest difference that does not matter, in units of ``value``: a positive number, or a pair around 0. To be
        declared before the data are seen.
    alpha
        Level of each one-sided test; the interval shown has level ``1 - 2 alpha``.

    Returns
    -------
    DataFrame
        One row for each other level: ``a, b (the reference), diff (a - b), df, t_lower, t_upper, p_lower, p_upper, p,
        p_holm, equivalent, low, high, margin_low, margin_high, n, n_dropped``. ``p_lower`` tests that the difference is
        above the lower margin, ``p_upper`` that it is below the upper one; ``p`` is the larger. ``equivalent`` is decided
        after Holm over the levels.

    Notes
    -----
    Schuirmann, Journal of Pharmacokinetics and Biopharmaceutics 15 (1987). A difference that is not significant is no
    evidence of equivalence; this is.
    """
    from scipy.special import stdtrit

    margin_low, margin_high = _limits(margin)
    wide = to_wide(df, subject=subject, within=within, value=value, missing=missing, aggregate=aggregate)
    levels = wide.levels[0]
    base = _position(levels, reference)
    n = len(wide.values)
    rows = []
    for index, level in enumerate(levels):
        if index == base:
            continue
        d = wide.values[:, index] - wide.values[:, base]
        mean, se = float(d.mean()), float(d.std(ddof=1) / np.sqrt(n))
        lower, upper = (_t(mean - limit, se) for limit in (margin_low, margin_high))
        half = float(stdtrit(n - 1, 1.0 - alpha)) * se
        rows.append(
            {
                "a": level,
                "b": reference,
                "diff": mean,
                "df": n - 1,
                "t_lower": lower,
                "t_upper": upper,
                "p_lower": float(t_test_p(np.asarray(lower), n - 1, "greater")),
                "p_upper": float(t_test_p(np.asarray(upper), n - 1, "less")),
                "low": mean - half,
                "high": mean + half,
                "margin_low": margin_low,
                "margin_high": margin_high,
                "n": n,
                "n_dropped": len(wide.dropped),
            }
        )
    return _finished(rows, alpha)


def _t(mean: float, se: float) -> float:
    """A t statistic; without variance infinite, and 0 on the margin itself."""
    if se > 0.0:
        return mean / se
    return float(np.sign(mean) * np.inf) if mean != 0.0 else 0.0


def tost_proportions(
    df: pd.DataFrame,
    *,
    condition: str,
    answer: str,
    reference: Any,
    margin: float | tuple[float, float],
    alpha: float = 0.05,
) -> pd.DataFrame:
    """Equivalence of proportions of independent answers with that of ``reference``.

    Parameters
    ----------
    df
        One row for each answer.
    condition, answer
        Names of columns; answers are 0 or 1.
    reference, margin, alpha
        As in :func:`tost_paired`; the margin is a difference of proportions, 0.1 for ten percentage points.

    Returns
    -------
    DataFrame
        One row for each other level: ``a, b, diff, z_lower, z_upper, p_lower, p_upper, p, p_holm, equivalent, low, high,
        margin_low, margin_high, proportion_a, proportion_b, n_a, n_b``.

    Notes
    -----
    Score tests with the proportions estimated under the margin, and the interval that inverts them: see
    :mod:`eval.stats.proportions`. Every answer counts as independent: for raters who judge many clips use
    :func:`tost_pigeonhole`.
    """
    from scipy.special import ndtr

    margin_low, margin_high = _limits(margin)
    if margin_low <= -1.0 or margin_high >= 1.0:
        raise ValueError(f"a margin of proportions lies within (-1, 1), got {margin}")
    require_columns(df, condition, answer)
    yes = binary(df, answer)
    codes, levels = codes_of(df[condition])
    base = _position(levels, reference)
    successes = [int(count) for count in np.bincount(codes, weights=yes)]
    totals = [int(count) for count in np.bincount(codes)]
    rows = []
    for index, level in enumerate(levels):
        if index == base:
            continue
        yes_pair, total_pair = (successes[index], successes[base]), (totals[index], totals[base])
        lower, upper = (score_z(yes_pair, total_pair, limit) for limit in (margin_low, margin_high))
        low, high = score_interval(yes_pair, total_pair, level=1.0 - 2.0 * alpha)
        rows.append(
            {
                "a": level,
                "b": reference,
                "diff": successes[index] / totals[index] - successes[base] / totals[base],
                "z_lower": lower,
                "z_upper": upper,
                "p_lower": float(ndtr(-lower)),
                "p_upper": float(ndtr(upper)),
                "low": low,
                "high": high,
                "margin_low": margin_low,
                "margin_high": margin_high,
                "proportion_a": successes[index] / totals[index],
                "proportion_b": successes[base] / totals[base],
                "n_a": totals[index],
                "n_b": totals[base],
            }
        )
    return _finished(rows, alpha)


def tost_pigeonhole(
    df: pd.DataFrame,
    *,
    rater: str,
    clip: str,
    condition: str,
    answer: str,
    reference: Any,
    margin: float | tuple[float, float],
    scale: bool = False,
    alpha: float = 0.05,
    seed: int = 0,
    resamples: int = 4000,
) -> pd.DataFrame:
    """Equivalence of proportions, or of mean scores, when the same raters judge many clips: raters and clips both vary.

    Parameters
    ----------
    df, rater, clip, condition, answer, seed, resamples
        As in :func:`eval.stats.pigeonhole.pigeonhole_bootstrap`.
    reference, margin, alpha
        As in :func:`tost_proportions`.
    scale
        Whether answers are scores and means are compared; otherwise they are 0 or 1.

    Returns
    -------
    DataFrame
        One row for each other level: ``a, b, diff, p_lower, p_upper, p, p_holm, equivalent, low, high, margin_low,
        margin_high``; p values are the bootstrap's tails beyond the margins, the interval its ``1 - 2 alpha`` percentiles.
    """
    margin_low, margin_high = _limits(margin)
    draws = pigeonhole_draws(
        df,
        rater=rater,
        clip=clip,
        condition=condition,
        answer=answer,
        scale=scale,
        seed=seed,
        resamples=resamples,
    )
    base = _position(draws.levels, reference)
    rows = []
    for index, level in enumerate(draws.levels):
        if index == base:
            continue
        d = draws.resampled[:, index] - draws.resampled[:, base]
        d = d[np.isfinite(d)]
        low, high = np.percentile(d, [100.0 * alpha, 100.0 * (1.0 - alpha)])
        rows.append(
            {
                "a": level,
                "b": reference,
                "diff": float(draws.observed[index] - draws.observed[base]),
                "p_lower": tail_p(d, margin_low, "greater"),
                "p_upper": tail_p(d, margin_high, "less"),
                "low": float(low),
                "high": float(high),
                "margin_low": margin_low,
                "margin_high": margin_high,
            }
        )
    return _finished(rows, alpha)
