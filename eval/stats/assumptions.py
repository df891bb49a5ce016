"""What the analyses assume, checked and said in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from eval.stats.anova import oneway_anova
from eval.stats.frames import codes_of, listing, numeric, require_columns, to_wide
from eval.stats.sphericity import mauchly

if TYPE_CHECKING:
    import pandas as pd

#: Share of subjects at an end of the scale from which a condition counts as bounded (McHorney & Tarlov 1995).
AT_BOUND = 0.15
#: Subjects below which the central limit theorem is no comfort.
FEW_SUBJECTS = 20
#: Ratio of the largest to the smallest standard deviation from which conditions count as unequally spread.
UNEQUAL_SPREAD = 2.0
#: Largest sample for which the p value of the Shapiro-Wilk test is reliable.
SHAPIRO_MOST = 5000

_COLUMNS = ["check", "severity", "statistic", "p", "sentence"]


def _row(check: str, severity: str, sentence: str, statistic: float = np.nan, p: float = np.nan) -> dict[str, Any]:
    return {"check": check, "severity": severity, "statistic": statistic, "p": p, "sentence": sentence}


def check_rm(
    df: pd.DataFrame,
    *,
    subject: str,
    within: str,
    value: str,
    bounds: tuple[float, float] | None = None,
    alpha: float = 0.05,
) -> pd.DataFrame:
    """Check a one-way repeated-measures design before it is analysed.

    Parameters
    ----------
    df, subject, within, value
        As in :func:`eval.stats.anova.rm_anova`.
    bounds
        Ends of the scale, such as (0, 1) or (1, 7), to look for floor and ceiling effects.
    alpha
        Level from which a departure is mentioned.

    Returns
    -------
    DataFrame
        One row for each of ``balance``, ``sample size``, ``normality``, ``spread``, ``sphericity``, ``outliers`` and, with
        ``bounds``, ``ceiling`` and ``floor``: ``check, severity ("ok", "note" or "warning"), statistic, p, sentence``.
        Checks after the first use complete subjects and means of duplicate cells.
    """
    import pandas as pd

    require_columns(df, subject, within, value)
    wide = to_wide(df, subject=subject, within=within, value=value, missing="drop", aggregate="mean")
    y, levels = wide.values, wide.levels[0]
    residual = y - y.mean(axis=1, keepdims=True) - y.mean(axis=0) + y.mean()
    rows = [
        _balance(df, subject, within, value, wide.dropped),
        _size(len(y)),
        _normality(residual.ravel(), alpha),
        _spread(y, levels),
        _sphericity(y, alpha),
        _outliers(residual, wide.subjects),
    ]
    if bounds is not None:
        rows += [_bound("ceiling", y >= bounds[1], levels), _bound("floor", y <= bounds[0], levels)]
    return pd.DataFrame(rows, columns=_COLUMNS)


def check_groups(df: pd.DataFrame, *, group: str, value: str, alpha: float = 0.05) -> pd.DataFrame:
    """Check a one-way design of independent groups; rows as in :func:`check_rm`, for size, normality and spread.

    Spread: Brown & Forsythe (JASA 69, 1974), the analysis of variance of distances from the group medians.
    """
    import pandas as pd

    require_columns(df, group, value)
    values = numeric(df, value)
    there = np.isfinite(values)
    codes, levels = codes_of(df.loc[there, group])
    parts = [values[there][codes == index] for index in range(len(levels))]
    least = min(len(part) for part in parts)
    if len(parts) < 2 or least < 2:
        raise ValueError(
            f"needs at least 2 groups with 2 values each, got {len(parts)} groups, the smallest of {least}"
        )
    residual = np.concatenate([part - part.mean() for part in parts])
    distance = [np.abs(part - np.median(part)) for part in parts]
    frame = pd.DataFrame(
        {"group": np.repeat(np.arange(len(parts)), [len(part) for part in parts]), "distance": np.concatenate(distance)}
    )
    test = oneway_anova(frame, group="group", value="distance").iloc[0]
    # Undefined where all distances are equal: nothing differs then.
    statistic, p = (0.0, 1.0) if np.isnan(test["F"]) else (float(test["F"]), float(test["p"]))
    unequal = p < alpha
    words = (
        f"Variances differ between groups (Brown-Forsythe F = {statistic:.2f}, p = {p:.3g}): read Welch's columns."
        if unequal
        else f"No sign of unequal variances (Brown-Forsythe F = {statistic:.2f}, p = {p:.3g})."
    )
    rows = [
        _size(least, "observations in the smallest group"),
        _normality(residual, alpha),
        _row("spread", "warning" if unequal else "ok", words, statistic, p),
    ]
    return pd.DataFrame(rows, columns=_COLUMNS)


def _balance(df: pd.DataFrame, subject: str, within: str, value: str, dropped: Sequence[Any]) -> dict[str, Any]:
    there = df[np.isfinite(numeric(df, value))]
    doubles = int(there.duplicated([subject, within]).sum())
    if dropped:
        words = f"{len(dropped)} subjects lack a condition ({listing(dropped)}); they are left out of paired analyses."
        return _row("balance", "warning", words, float(len(dropped)))
    if doubles:
        words = f"{doubles} answers repeat a subject and condition; they are averaged within the cell."
        return _row("balance", "note", words, float(doubles))
    return _row("balance", "ok", "Every subject has one value in every condition.", 0.0)


def _size(n: int, what: str = "subjects") -> dict[str, Any]:
    if n < FEW_SUBJECTS:
        words = f"Only {n} {what}: p values lean on normal residuals; look at the rank tests as well."
        return _row("sample size", "warning", words, float(n))
    return _row("sample size", "ok", f"{n} {what}.", float(n))


def _normality(residual: NDArray[np.float64], alpha: float) -> dict[str, Any]:
    from scipy.stats import shapiro

    if len(residual) < 3 or np.ptp(residual) <= 1e-12 * max(1.0, float(np.abs(residual).max())):
        return _row("normality", "note", "Residuals do not vary, so their shape cannot be checked.")
    if len(residual) > SHAPIRO_MOST:
        words = f"{len(residual)} residuals are too many for the Shapiro-Wilk test; means are safe at this size."
        return _row("normality", "note", words)
    statistic, p = (float(number) for number in shapiro(residual))
    figures = f"Shapiro-Wilk W = {statistic:.3f}, p = {p:.3g}"
    if p < alpha:
        words = f"Residuals are not normal ({figures}): trust ranks, bootstrap or the logistic model over F in small samples."
        return _row("normality", "note", words, statistic, p)
    return _row("normality", "ok", f"No sign against normal residuals ({figures}).", statistic, p)


def _spread(y: NDArray[np.float64], levels: Sequence[Any]) -> dict[str, Any]:
    sd = y.std(axis=0, ddof=1)
    widest, tightest = levels[int(sd.argmax())], levels[int(sd.argmin())]
    ratio = float(sd.max() / sd.min()) if sd.min() > 0 else float("inf") if sd.max() > 0 else 1.0
    if ratio > UNEQUAL_SPREAD:
        words = (
            f"{widest} spreads {ratio:.1f} times as much as {tightest}: pooled errors mislead, use paired contrasts."
        )
        return _row("spread", "warning", words, ratio)
    return _row("spread", "ok", f"Standard deviations differ at most by a factor of {ratio:.2f}.", ratio)


def _sphericity(y: NDArray[np.float64], alpha: float) -> dict[str, Any]:
    if y.shape[1] == 2:
        return _row("sphericity", "ok", "Two conditions: sphericity holds trivially.", 1.0)
    shape = mauchly(y)
    figures = f"epsilon GG {shape.eps_gg:.2f}, HF {shape.eps_hf:.2f}"
    if np.isnan(shape.p):
        words = f"Mauchly's test is undefined here ({figures}): report the Greenhouse-Geisser p."
        return _row("sphericity", "note", words, shape.W)
    figures = f"Mauchly W = {shape.W:.3f}, p = {shape.p:.3g}; {figures}"
    if shape.p < alpha:
        words = f"Sphericity is violated ({figures}): report the Greenhouse-Geisser p, and not Tukey's test."
        return _row("sphericity", "warning", words, shape.W, shape.p)
    words = f"No sign against sphericity ({figures}); the Greenhouse-Geisser p is reported in any case."
    return _row("sphericity", "ok", words, shape.W, shape.p)


def _outliers(residual: NDArray[np.float64], subjects: Sequence[Any]) -> dict[str, Any]:
    centre = np.median(residual)
    scale = 1.4826 * float(np.median(np.abs(residual - centre)))
    if scale <= 0.0:
        return _row("outliers", "note", "Most residuals are equal, so outliers cannot be told.")
    far = np.asarray((np.abs(residual - centre) > 4.0 * scale).any(axis=1))
    who = [label for label, out in zip(subjects, far, strict=True) if out]
    if who:
        words = f"{len(who)} subjects have a residual beyond 4 robust standard deviations: {listing(who)}."
        return _row("outliers", "note", words, float(len(who)))
    return _row("outliers", "ok", "No residual beyond 4 robust standard deviations.", 0.0)


def _bound(check: str, at_bound: NDArray[np.bool_], levels: Sequence[Any]) -> dict[str, Any]:
    share = at_bound.mean(axis=0)
    hit = [f"{level} ({part:.0%})" for level, part in zip(levels, share, strict=True) if part >= AT_BOUND]
    most = float(share.max())
    if hit:
        words = f"Many subjects are at the {check} in {listing(hit)}: differences there are understated, use the logit model."
        return _row(check, "warning", words, most)
    return _row(check, "ok", f"At most {most:.0%} of subjects are at the {check} of any condition.", most)
