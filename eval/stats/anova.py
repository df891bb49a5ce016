"""Analyses of variance: one-way between groups, and repeated measures with sphericity corrections."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from eval.stats.effects import eta_p2_interval
from eval.stats.frames import codes_of, listing, numeric, require_columns, to_wide
from eval.stats.sphericity import Sphericity, helmert, pooled_covariance, sphericity_of_contrasts

if TYPE_CHECKING:
    import pandas as pd


def ratio(numerator: float, denominator: float) -> float:
    """A quotient of two sums of squares: infinite without error, NaN for nothing over nothing."""
    if denominator > 0.0:
        return numerator / denominator
    return float("inf") if numerator > 0.0 else float("nan")


def oneway_anova(df: pd.DataFrame, *, group: str, value: str) -> pd.DataFrame:
    """One-way analysis of variance between independent groups, and Welch's for unequal variances beside it.

    Parameters
    ----------
    df
        One row for each observation; rows without a value are left out and counted in ``n_dropped``.
    group, value
        Names of columns.

    Returns
    -------
    DataFrame
        One row: ``effect, SS, df1, MS, SS_err, df2, MS_err, F, p, F_welch, df2_welch, p_welch, eta_p2, eta_p2_low,
        eta_p2_high, omega2, n, n_groups, n_dropped``. ``eta_p2`` has a 90 % interval. Welch's columns are NaN where a
        group has no variance or one observation.

    Raises
    ------
    ValueError
        With fewer than two groups, or no more observations than groups.

    Notes
    -----
    Sums of squares are taken in two passes after a common value has been subtracted, which keeps the digits that
    data with many constant leading digits (NIST StRD "SmLs") would lose. Welch, Biometrika 38 (1951). Omega squared:
    Hays, *Statistics* (1963).
    """
    import pandas as pd
    from scipy.stats import f as f_law

    require_columns(df, group, value)
    values = numeric(df, value)
    there = np.isfinite(values)
    dropped = int((~there).sum())
    codes, levels = codes_of(df.loc[there, group])
    values = values[there]
    count, n = len(levels), len(values)
    if count < 2 or n <= count:
        raise ValueError(f"needs at least 2 groups and more observations than groups, got {count} and {n}")
    values = values - values[0]
    values = values - values.mean()
    sizes = np.bincount(codes).astype(np.float64)
    means = np.bincount(codes, weights=values) / sizes
    residual = values - means[codes]
    # What rounding left in the residuals' means is put right once more.
    slip = np.bincount(codes, weights=residual) / sizes
    means, residual = means + slip, residual - slip[codes]
    grand = float((sizes * means).sum() / n)
    between = float((sizes * (means - grand) ** 2).sum())
    error = float((residual**2).sum())
    df1, df2 = count - 1, n - count
    F = ratio(between / df1, error / df2)
    low, high = eta_p2_interval(F, df1, df2)
    welch = _welch(sizes, means, np.bincount(codes, weights=residual**2))
    row = {
        "effect": group,
        "SS": between,
        "df1": df1,
        "MS": between / df1,
        "SS_err": error,
        "df2": df2,
        "MS_err": error / df2,
        "F": F,
        "p": float(f_law.sf(F, df1, df2)),
        **welch,
        "eta_p2": ratio(between, between + error),
        "eta_p2_low": low,
        "eta_p2_high": high,
        "omega2": ratio(between - df1 * error / df2, between + error + error / df2),
        "n": n,
        "n_groups": count,
        "n_dropped": dropped,
    }
    return pd.DataFrame([row])


def _welch(sizes: NDArray[Any], means: NDArray[Any], squares: NDArray[Any]) -> dict[str, float]:
    from scipy.stats import f as f_law

    if (sizes < 2).any() or (squares <= 0).any():
        return {"F_welch": float("nan"), "df2_welch": float("nan"), "p_welch": float("nan")}
    k = len(sizes)
    weight = sizes * (sizes - 1.0) / squares
    centre = (weight * means).sum() / weight.sum()
    spread = (((1.0 - weight / weight.sum()) ** 2) / (sizes - 1.0)).sum()
    top = (weight * (means - centre) ** 2).sum() / (k - 1)
    F = float(top / (1.0 + 2.0 * (k - 2) / (k * k - 1.0) * spread))
    df2 = float((k * k - 1.0) / (3.0 * spread))
    return {"F_welch": F, "df2_welch": df2, "p_welch": float(f_law.sf(F, k - 1, df2))}


def rm_anova(
    df: pd.DataFrame,
    *,
    subject: str,
    within: str | Sequence[str],
    value: str,
    between: str | None = None,
    missing: str = "error",
    aggregate: str | None = None,
) -> pd.DataFrame:
    """Repeated-measures analysis of variance, univariate, with Greenhouse-Geisser and Huynh-Feldt corrections.

    Parameters
    ----------
    df
        One row for each observation.
    subject, within, value
        Names of columns; several within-subject factors are crossed.
    between
        A factor that is constant within a subject, such as a group of raters.
    missing
        ``"error"`` refuses subjects who lack a cell and names them; ``"drop"`` leaves them out, counts them in
        ``n_dropped`` and lists them in ``attrs["dropped"]``.
    aggregate
        ``"mean"`` averages several values in one cell, which are refused otherwise.

    Returns
    -------
    DataFrame
        One row for each effect (``A``, ``B``, ``A:B`` …; with ``between`` also that factor and its interactions):
        ``effect, SS, df1, MS, SS_err, df2, MS_err, F, p, mauchly_W, mauchly_chi2, mauchly_df, mauchly_p, eps_gg, p_gg,
        eps_hf, p_hf, eps_lb, p_lb, eta_p2, eta_p2_low, eta_p2_high, eta_g2, n, n_dropped``. Rows of the between-subject
        factor have NaN sphericity columns and corrected p values equal to ``p``. Report ``p_gg``; Mauchly's test is
        shown but is no gate.

    Raises
    ------
    ValueError
        On missing or duplicate cells, a between factor that varies within a subject, or too few subjects.

    Notes
    -----
    Each effect is tested with its own error term: with orthonormal contrasts M of the effect (Kronecker products of
    Helmert contrasts and constant vectors) and z = Y M, ``SS = n |mean z|^2``, ``SS_err = sum |z_i - mean z|^2``, on
    p and p (n - groups) degrees of freedom (Maxwell & Delaney, *Designing Experiments and Analyzing Data*, chapters
    11 to 15). Unequal groups: unweighted means (type III). Epsilons: :mod:`eval.stats.sphericity`. ``eta_p2 =
    SS / (SS + SS_err)`` with a 90 % interval; generalised eta squared for manipulated factors, ``SS / (SS + all
    between-subject and within-subject error)``: Olejnik & Algina, Psychological Methods 8 (2003); Bakeman (2005).
    """
    import pandas as pd

    factors = [within] if isinstance(within, str) else list(within)
    wide = to_wide(df, subject=subject, within=factors, value=value, missing=missing, aggregate=aggregate)
    sizes = [len(levels) for levels in wide.levels]
    flat = [factor for factor, size in zip(factors, sizes, strict=True) if size < 2]
    if flat:
        raise ValueError(f"{listing(flat)} has one level only; leave it out of within")
    codes, count = _groups(df, subject, between, wide.subjects)
    n = len(wide.values)
    # A common shift changes no effect and keeps digits.
    values = wide.values - wide.values.mean()
    rows = []
    for effect in [chosen for size in range(len(factors) + 1) for chosen in combinations(range(len(factors)), size)]:
        contrasts = _contrasts(sizes, effect)
        rows += _effect_rows(values @ contrasts, codes, count, [factors[index] for index in effect], between)
    # The error of every stratum, the subjects' own included.
    total_error = sum({row["stratum"]: row["SS_err"] for row in rows}.values())
    table = [row for row in rows if row["effect"]]
    for row in table:
        row["eta_g2"] = ratio(row["SS"], row["SS"] + total_error)
        row["n"], row["n_dropped"] = n, len(wide.dropped)
        del row["stratum"]
    result = pd.DataFrame(table)
    result.attrs["dropped"] = wide.dropped
    return result


def _groups(
    df: pd.DataFrame, subject: str, between: str | None, subjects: Sequence[Any]
) -> tuple[NDArray[np.intp], int]:
    """Group codes (n,) of the subjects, and how many groups there are."""
    if between is None:
        return np.zeros(len(subjects), dtype=np.intp), 1
    require_columns(df, between)
    kept = df[df[subject].isin(subjects)]
    per_subject = kept.groupby(subject, observed=True)[between]
    varying = [label for label, number in per_subject.nunique(dropna=False).items() if number != 1]
    if varying:
        raise ValueError(f"{between} must be constant within a subject; it varies in {listing(varying)}")
    first = per_subject.first()
    codes, levels = codes_of(first.loc[subjects])
    if len(levels) < 2 or len(subjects) <= len(levels):
        raise ValueError(f"{between} needs at least 2 groups and more subjects than groups, got {listing(levels)}")
    return codes, len(levels)


def _contrasts(sizes: Sequence[int], effect: Sequence[int]) -> NDArray[np.float64]:
    matrix: NDArray[np.float64] = np.ones((1, 1))
    for index, size in enumerate(sizes):
        matrix = np.kron(matrix, helmert(size) if index in effect else np.full((size, 1), size**-0.5)).astype(
            np.float64
        )
    return matrix


def _effect_rows(
    z: NDArray[np.float64], codes: NDArray[np.intp], count: int, names: Sequence[str], between: str | None
) -> list[dict[str, Any]]:
    """The tests of one stratum: the within-subject effect itself, and its interaction with the groups."""
    n, p = z.shape
    nu = n - count
    sizes = np.bincount(codes, minlength=count).astype(np.float64)
    means = np.stack([z[codes == group].mean(axis=0) for group in range(count)])
    covariance = pooled_covariance(z, codes)
    error = float(np.trace(covariance)) * nu
    tests: list[tuple[str, float, int]] = []
    own = float((means.mean(axis=0) ** 2).sum() * count**2 / (1.0 / sizes).sum())
    # Without a name this is the grand mean, which is no effect: it only carries the subjects' error.
    tests.append((":".join(names), own, p))
    if between is not None:
        centre = (sizes[:, None] * means).sum(axis=0) / n
        apart = float((sizes[:, None] * (means - centre) ** 2).sum())
        tests.append((":".join([between, *names]), apart, p * (count - 1)))
    shape = sphericity_of_contrasts(covariance, nu) if names else None
    return [{**_test(effect, ss, df1, error, p * nu, shape), "stratum": ":".join(names)} for effect, ss, df1 in tests]


def _test(effect: str, ss: float, df1: int, error: float, df2: int, shape: Sphericity | None) -> dict[str, Any]:
    from scipy.stats import f as f_law

    F = ratio(ss / df1, error / df2)
    low, high = eta_p2_interval(F, df1, df2)
    nan = float("nan")
    eps = (shape.eps_gg, shape.eps_hf, shape.eps_lb) if shape else (1.0, 1.0, 1.0)
    p_gg, p_hf, p_lb = (float(f_law.sf(F, df1 * e, df2 * e)) for e in eps)
    return {
        "effect": effect,
        "SS": ss,
        "df1": df1,
        "MS": ss / df1,
        "SS_err": error,
        "df2": df2,
        "MS_err": error / df2,
        "F": F,
        "p": float(f_law.sf(F, df1, df2)),
        "mauchly_W": shape.W if shape else nan,
        "mauchly_chi2": shape.chi2 if shape else nan,
        "mauchly_df": shape.df if shape else 0,
        "mauchly_p": shape.p if shape else nan,
        "eps_gg": eps[0] if shape else nan,
        "p_gg": p_gg,
        "eps_hf": eps[1] if shape else nan,
        "p_hf": p_hf,
        "eps_lb": eps[2] if shape else nan,
        "p_lb": p_lb,
        "eta_p2": ratio(ss, ss + error),
        "eta_p2_low": low,
        "eta_p2_high": high,
    }
