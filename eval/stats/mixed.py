"""A linear mixed model of answers by raters about clips: both are random, as are their reactions to a condition."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from eval.stats.frames import codes_of, listing, numeric, require_columns

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]

#: Ratio of a component's standard deviation to the residual one below which its variance counts as 0.
_ZERO = 1e-4


class Components(NamedTuple):
    """A model fitted by restricted maximum likelihood.

    Attributes
    ----------
    beta, covariance
        (P,) fixed effects and their (P, P) covariance.
    variances
        Variance of each random component, in order.
    residual
        Variance of a single answer.
    converged
        Whether the optimiser came to an end.
    message
        What it said.
    """

    beta: Array
    covariance: Array
    variances: Array
    residual: float
    converged: bool
    message: str


def fit_components(y: Array, design: Array, labels: list[NDArray[np.intp]]) -> Components:
    """Fit ``y = X b + sum_j Z_j u_j + e`` with independent normal ``u_j``, by restricted maximum likelihood.

    Parameters
    ----------
    y
        (N,) answers.
    design
        (N, P) of full rank.
    labels
        For each random component (N,) numbers from 0: which of its effects an answer has.

    Notes
    -----
    The deviance is profiled over everything but the ratios of standard deviations to the residual one (Bates, Maechler, Bolker
    & Walker, "Fitting linear mixed-effects models using lme4", Journal of Statistical Software 67, 2015, section 3). The cross
    products are taken once, so that one evaluation is a Cholesky factor of as many rows as there are random effects: seconds
    become milliseconds where statsmodels' MixedLM, which inverts anew for every answer, takes minutes, and its gradient
    search often ends without having converged.
    """
    from scipy.linalg import cholesky, solve_triangular
    from scipy.optimize import minimize

    n, p = design.shape
    sizes = [int(codes.max()) + 1 for codes in labels]
    z = np.zeros((n, sum(sizes)))
    start = 0
    for codes, size in zip(labels, sizes, strict=True):
        z[np.arange(n), start + codes] = 1.0
        start += size
    # A common shift and scale keep the sums of squares small; both are undone below.
    shift, scale = float(y.mean()), float(y.std()) or 1.0
    target = (y - shift) / scale
    zz, zx, zy = z.T @ z, z.T @ design, z.T @ target
    xx, xy, yy = design.T @ design, design.T @ target, float(target @ target)

    def solved(theta: Array) -> tuple[Array, Array, Array, float]:
        lam = np.repeat(theta, sizes)
        factor = cholesky(lam[:, None] * zz * lam + np.eye(len(lam)), lower=True)
        both = solve_triangular(factor, lam[:, None] * np.column_stack([zx, zy]), lower=True)
        rzx, cu = both[:, :p], both[:, p]
        rx = cholesky(xx - rzx.T @ rzx)
        cb = solve_triangular(rx, xy - rzx.T @ cu, trans="T")
        return factor, rx, cb, max(yy - float(cu @ cu) - float(cb @ cb), 1e-12)

    def deviance(theta: Array) -> float:
        factor, rx, _, rest = solved(theta)
        free = n - p
        logs = 2.0 * float(np.log(np.diag(factor)).sum() + np.log(np.abs(np.diag(rx))).sum())
        return logs + free * (1.0 + float(np.log(2.0 * np.pi * rest / free)))

    found = minimize(
        deviance,
        np.full(len(labels), 0.3),
        method="L-BFGS-B",
        bounds=[(0.0, None)] * len(labels),
        options={"ftol": 1e-12, "gtol": 1e-6, "maxiter": 500},
    )
    _, rx, cb, rest = solved(found.x)
    residual = rest / (n - p)
    inverse = solve_triangular(rx, np.eye(p))
    theta = np.where(found.x < _ZERO, 0.0, found.x)
    beta = scale * (inverse @ cb)
    # The constant is in the span of the design.
    beta += np.linalg.lstsq(design, np.full(n, shift), rcond=None)[0]
    return Components(
        beta,
        scale**2 * residual * (inverse @ inverse.T),
        scale**2 * residual * theta**2,
        scale**2 * residual,
        bool(found.success),
        str(found.message),
    )


def mixed_model(
    df: pd.DataFrame,
    *,
    rater: str,
    clip: str,
    condition: str,
    value: str,
    reference: Any = None,
    level: float = 0.95,
) -> pd.DataFrame:
    """Differences of every condition from a reference, with raters and clips as crossed random effects.

    Parameters
    ----------
    df
        One row for each answer; rows without a value are left out.
    rater, clip, condition, value
        Names of columns. A clip label that occurs in several conditions is one performance shown in each. Values are scores,
        or 0 and 1: then it is a linear probability model, whose differences are differences of shares.
    reference
        The level compared with; the first one by default.
    level
        Of the intervals.

    Returns
    -------
    DataFrame
        One row for each other level: ``a, b (the reference), diff, se, df, t, p, low, high, var_rater, var_clip,
        var_rater_condition, var_stimulus, var_residual, n_answers, n_raters, n_clips, converged, note``. A variance is NaN
        where the design cannot tell it from another one. ``note`` says in words what did not go well: an optimiser that did
        not converge, whose row is to be disregarded, and variances that came out as 0.

    Raises
    ------
    ValueError
        With fewer than two conditions, raters or clips, no spread, or as many effects as answers.

    Notes
    -----
    ``value = condition + rater + clip + rater:condition + clip:condition + residual``: raters and clips are both samples
    (Clark 1973; Judd, Westfall & Kenny, Journal of Personality and Social Psychology 103, 2012). Without the interactions the
    interval of a difference would be that of the clips and raters at hand. ``clip:condition`` is a stimulus. Degrees of freedom
    are the smaller of raters and clips minus 1, which is on the safe side.
    """
    import pandas as pd
    from scipy.special import stdtr, stdtrit

    require_columns(df, rater, clip, condition, value)
    scores = numeric(df, value)
    there = np.isfinite(scores)
    rows, y = df[there], scores[there]
    codes, levels = codes_of(rows[condition])
    raters, rater_labels = codes_of(rows[rater])
    clips, clip_labels = codes_of(rows[clip])
    if min(len(levels), len(rater_labels), len(clip_labels)) < 2:
        raise ValueError("needs at least 2 conditions, 2 raters and 2 clips")
    chosen = levels[0] if reference is None else reference
    if chosen not in levels:
        raise ValueError(f"no level {chosen} to compare with; there are {listing(levels)}")
    if np.ptp(y) == 0.0:
        raise ValueError("all answers are the same, so there is no variance to divide up")
    base = levels.index(chosen)
    others = [index for index in range(len(levels)) if index != base]
    design = np.column_stack([np.ones(len(y)), *((codes == index).astype(np.float64) for index in others)])
    parts = _components(raters, clips, codes)
    if len(y) <= len(levels) + 1 or not parts:
        raise ValueError(f"{len(y)} answers are too few for a model of {len(levels)} conditions")
    fitted = fit_components(y, design, list(parts.values()))
    variances = dict.fromkeys(("rater", "clip", "rater_condition", "stimulus"), float("nan"))
    variances |= dict(zip(parts, fitted.variances.tolist(), strict=True))
    free = min(len(rater_labels), len(clip_labels)) - 1
    width = float(stdtrit(free, 0.5 * (1.0 + level)))
    note = _note(fitted, variances)
    table = []
    for place, index in enumerate(others, start=1):
        diff, se = float(fitted.beta[place]), float(np.sqrt(fitted.covariance[place, place]))
        table.append(
            {
                "a": levels[index],
                "b": chosen,
                "diff": diff,
                "se": se,
                "df": free,
                "t": diff / se,
                "p": float(2.0 * stdtr(free, -abs(diff / se))),
                "low": diff - width * se,
                "high": diff + width * se,
                **{f"var_{name}": variance for name, variance in variances.items()},
                "var_residual": fitted.residual,
                "n_answers": len(y),
                "n_raters": len(rater_labels),
                "n_clips": len(clip_labels),
                "converged": fitted.converged,
                "note": note,
            }
        )
    return pd.DataFrame(table)


def _components(
    raters: NDArray[np.intp], clips: NDArray[np.intp], codes: NDArray[np.intp]
) -> dict[str, NDArray[np.intp]]:
    """The random effects that the design can tell apart: each must group answers, and otherwise than those before it."""
    conditions = int(codes.max()) + 1
    wanted = {
        "rater": raters,
        "clip": clips,
        "rater_condition": raters * conditions + codes,
        "stimulus": clips * conditions + codes,
    }
    kept: dict[str, NDArray[np.intp]] = {}
    for name, labels in wanted.items():
        _, renumbered = np.unique(labels, return_inverse=True)
        count = int(renumbered.max()) + 1
        same = any(
            count == int(other.max()) + 1 == len(np.unique(renumbered * count + other)) for other in kept.values()
        )
        if 1 < count < len(codes) and not same:
            kept[name] = renumbered.astype(np.intp)
    return kept


_WORDS = {
    "rater": "raters",
    "clip": "clips",
    "rater_condition": "raters' reactions to a condition",
    "stimulus": "single stimuli",
}


def _note(fitted: Components, variances: dict[str, float]) -> str:
    notes = []
    if not fitted.converged:
        notes.append(f"the fit did not converge ({fitted.message.strip().rstrip('.')}): disregard this row")
    none = [_WORDS[name] for name, variance in variances.items() if variance == 0.0]
    if none:
        notes.append(f"the variance between {' and between '.join(none)} is estimated as 0")
    return "; ".join(notes)
