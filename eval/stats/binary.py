"""Yes-or-no answers of raters about clips: marginal logistic models."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from eval.stats.frames import binary, codes_of, listing, require_columns

if TYPE_CHECKING:
    import pandas as pd


def gee_logit(
    df: pd.DataFrame,
    *,
    subject: str,
    condition: str,
    answer: str,
    clip: str | None = None,
    reference: Any = None,
    covariance: str = "bias_reduced",
    level: float = 0.95,
) -> pd.DataFrame:
    """Odds ratios of a yes under each condition against a reference, marginal over raters.

    Parameters
    ----------
    df
        One row for each answer.
    subject, condition, answer
        Names of columns; answers are 0 or 1.
    clip
        Without it answers are clustered by rater only, and the result speaks about these very clips. With it they are
        clustered by rater and by clip.
    reference
        The level compared with; the first one by default.
    covariance
        Without ``clip``: ``"bias_reduced"`` (Mancl & DeRouen, Biometrics 57, 2001; for few raters) or ``"robust"``.
    level
        Of the intervals.

    Returns
    -------
    DataFrame
        One row for each other level: ``a, b (the reference), proportion_a, proportion_b, log_odds_ratio, se, z, p,
        odds_ratio, low, high, n_subjects, n_clips, note``; ``low`` and ``high`` bound the odds ratio. A level that everyone or
        no one answered with yes has an odds ratio of infinity or 0, no interval, and a note.

    Raises
    ------
    ValueError
        If the reference itself has only yes or only no, there are fewer than two raters (or clips), or answers are not 0
        or 1.

    Notes
    -----
    Generalised estimating equations with an exchangeable working correlation within raters (Liang & Zeger, Biometrika
    73, 1986). With ``clip``: working independence and the two-way clustered covariance ``V_rater + V_clip - V_cell`` of
    Cameron, Gelbach & Miller (Journal of Business & Economic Statistics 29, 2011), each part times G / (G - 1), negative
    eigenvalues set to 0, and t with the smaller number of clusters minus 1 in place of the normal law.
    """
    require_columns(df, subject, condition, answer, *([] if clip is None else [clip]))
    if covariance not in ("bias_reduced", "robust"):
        raise ValueError(f'covariance must be "bias_reduced" or "robust", not {covariance!r}')
    yes = binary(df, answer)
    codes, levels = codes_of(df[condition])
    raters, rater_labels = codes_of(df[subject])
    clips, clip_labels = codes_of(df[clip]) if clip is not None else (None, [])
    if len(rater_labels) < 2 or (clip is not None and len(clip_labels) < 2) or len(levels) < 2:
        raise ValueError("needs at least 2 conditions, 2 subjects and, where clips are given, 2 clips")
    chosen = levels[0] if reference is None else reference
    if chosen not in levels:
        raise ValueError(f"no level {chosen} to compare with; there are {listing(levels)}")
    base = levels.index(chosen)
    share = np.bincount(codes, weights=yes) / np.bincount(codes)
    mixed = (share > 0.0) & (share < 1.0)
    if not mixed[base]:
        raise ValueError(
            f"every answer to {chosen} is the same, so odds ratios against it do not exist; choose another"
        )
    kept = [index for index in range(len(levels)) if mixed[index] and index != base]
    use = np.isin(codes, [base, *kept])
    design = np.column_stack([np.ones(int(use.sum())), *((codes[use] == index).astype(float) for index in kept)])
    degrees = float("inf")
    if not kept:
        beta, cov = np.zeros(1), np.zeros((1, 1))
    elif clips is None:
        beta, cov = _exchangeable(yes[use], design, raters[use], covariance)
    else:
        beta, cov = _two_way(yes[use], design, raters[use], clips[use])
        degrees = float(min(len(np.unique(raters[use])), len(np.unique(clips[use]))) - 1)
    counts = {"n_subjects": len(rater_labels), "n_clips": len(clip_labels)}
    return _odds_table(levels, base, share, kept, beta, cov, degrees, level, counts)


def _odds_table(
    levels: list[Any],
    base: int,
    share: NDArray[np.float64],
    kept: list[int],
    beta: NDArray[np.float64],
    cov: NDArray[np.float64],
    degrees: float,
    level: float,
    counts: dict[str, int],
) -> pd.DataFrame:
    import pandas as pd
    from scipy.stats import norm, t

    law = norm if np.isinf(degrees) else t(degrees)
    width = float(law.isf(0.5 * (1.0 - level)))
    nan = float("nan")
    rows = []
    for index, label in enumerate(levels):
        if index == base:
            continue
        row = {"a": label, "b": levels[base], "proportion_a": share[index], "proportion_b": share[base]}
        if index in kept:
            at = kept.index(index) + 1
            b, se = float(beta[at]), float(np.sqrt(max(cov[at, at], 0.0)))
            z = b / se if se > 0 else nan
            row |= {"log_odds_ratio": b, "se": se, "z": z, "p": float(2.0 * law.sf(abs(z))), "odds_ratio": np.exp(b)}
            row |= {"low": np.exp(b - width * se), "high": np.exp(b + width * se), **counts, "note": ""}
        else:
            bound = float("inf") if share[index] == 1.0 else 0.0
            row |= {"log_odds_ratio": float("inf") if bound else -float("inf"), "se": nan, "z": nan, "p": nan}
            note = f"every answer is {'yes' if bound else 'no'}: no finite estimate; see the bootstrap of proportions"
            row |= {"odds_ratio": bound, "low": nan, "high": nan, **counts, "note": note}
        rows.append(row)
    return pd.DataFrame(rows)


def _exchangeable(
    yes: NDArray[np.float64], design: NDArray[np.float64], raters: NDArray[np.intp], covariance: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    import statsmodels.api as sm

    order = np.argsort(raters, kind="stable")
    model = sm.GEE(
        yes[order],
        design[order],
        groups=raters[order],
        family=sm.families.Binomial(),
        cov_struct=sm.cov_struct.Exchangeable(),
    )
    result = model.fit(cov_type=covariance)
    return np.asarray(result.params), np.asarray(result.cov_params())


def _two_way(
    yes: NDArray[np.float64], design: NDArray[np.float64], raters: NDArray[np.intp], clips: NDArray[np.intp]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Working independence: the estimates are logits of the proportions; clustering enters the covariance alone."""
    reference = design[:, 1:].sum(axis=1) == 0
    logits = [_logit(yes[reference].mean()), *(_logit(yes[column == 1].mean()) for column in design[:, 1:].T)]
    beta = np.asarray([logits[0], *(value - logits[0] for value in logits[1:])])
    fitted = 1.0 / (1.0 + np.exp(-design @ beta))
    score = design * (yes - fitted)[:, None]
    bread = np.linalg.inv(design.T @ (design * (fitted * (1.0 - fitted))[:, None]))
    cells = np.unique(raters * (int(clips.max()) + 1) + clips, return_inverse=True)[1]
    meat = _clustered(score, raters) + _clustered(score, clips) - _clustered(score, cells)
    root, vectors = np.linalg.eigh(bread @ meat @ bread)
    return beta, (vectors * np.maximum(root, 0.0)) @ vectors.T


def _logit(share: float) -> float:
    return float(np.log(share / (1.0 - share)))


def _clustered(score: NDArray[np.float64], labels: NDArray[np.intp]) -> NDArray[np.float64]:
    codes = np.unique(labels, return_inverse=True)[1]
    count = int(codes.max()) + 1
    sums = np.zeros((count, score.shape[1]))
    np.add.at(sums, codes, score)
    return sums.T @ sums * count / (count - 1)
