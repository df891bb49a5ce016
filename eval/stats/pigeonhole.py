"""The rater by clip bootstrap: proportions and means, with raters and clips both resampled."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from eval.stats.frames import binary, codes_of, numeric, require_columns, select_pairs

if TYPE_CHECKING:
    import pandas as pd


class Draws(NamedTuple):
    """Proportions of yes, or means: observed (k,), and resampled (resamples, k), NaN where a resample holds no answer.

    ``clips`` counts those of each level; 0 where clips were not resampled.
    """

    levels: list[Any]
    observed: NDArray[np.float64]
    resampled: NDArray[np.float64]
    raters: int
    clips: NDArray[np.int64]


def pigeonhole_draws(
    df: pd.DataFrame,
    *,
    rater: str,
    clip: str | None,
    condition: str,
    answer: str,
    scale: bool = False,
    seed: int = 0,
    resamples: int = 4000,
) -> Draws:
    """Resampled proportions of yes in each condition, or with ``scale`` resampled means; see :func:`pigeonhole_bootstrap`."""
    require_columns(df, rater, condition, answer, *([] if clip is None else [clip]))
    values = _finite(df, answer) if scale else binary(df, answer)
    codes, levels = codes_of(df[condition])
    raters, rater_labels = codes_of(df[rater])
    clips = codes_of(df[clip])[0] if clip is not None else np.zeros(len(df), dtype=np.intp)
    if len(rater_labels) < 2:
        raise ValueError("needs at least 2 raters")
    shape = (len(levels), len(rater_labels), int(clips.max()) + 1)
    sums, counts = np.zeros(shape), np.zeros(shape)
    np.add.at(sums, (codes, raters, clips), values)
    np.add.at(counts, (codes, raters, clips), 1.0)
    rng = np.random.default_rng(seed)
    rater_weight = rng.multinomial(shape[1], np.full(shape[1], 1.0 / shape[1]), size=resamples).astype(np.float64)
    clip_weight = np.ones((resamples, shape[2]))
    shown = counts.sum(axis=1) > 0
    if clip is not None:
        # Clips of one condition are drawn among themselves, those shown in several conditions once for all of these.
        patterns, member = np.unique(shown, axis=1, return_inverse=True)
        for pattern in range(patterns.shape[1]):
            places = np.flatnonzero(member.ravel() == pattern)
            clip_weight[:, places] = rng.multinomial(
                len(places), np.full(len(places), 1.0 / len(places)), size=resamples
            )
    resampled = np.full((resamples, len(levels)), np.nan)
    for index in range(len(levels)):
        top = ((rater_weight @ sums[index]) * clip_weight).sum(axis=1)
        bottom = ((rater_weight @ counts[index]) * clip_weight).sum(axis=1)
        np.divide(top, bottom, out=resampled[:, index], where=bottom > 0)
    observed = sums.sum(axis=(1, 2)) / counts.sum(axis=(1, 2))
    shown_clips = shown.sum(axis=1) if clip is not None else np.zeros(len(levels), dtype=np.int64)
    return Draws(levels, observed, resampled, shape[1], shown_clips)


def tail_p(draws: NDArray[np.float64], at: float, alternative: str = "two-sided") -> float:
    """Bootstrap p value of a difference from ``at``: the share of draws on its wrong side, at least 1 / (draws + 1).

    ``"greater"`` is small where the draws lie above ``at``, ``"less"`` where they lie below; two-sided is twice the
    smaller of both.
    """
    below = (1.0 + float((draws <= at).sum())) / (len(draws) + 1.0)
    above = (1.0 + float((draws >= at).sum())) / (len(draws) + 1.0)
    return {"greater": below, "less": above, "two-sided": min(1.0, 2.0 * min(below, above))}[alternative]


def pigeonhole_bootstrap(
    df: pd.DataFrame,
    *,
    rater: str,
    clip: str | None,
    condition: str,
    answer: str,
    pairs: Sequence[tuple[Any, Any]] | None = None,
    level: float = 0.95,
    seed: int = 0,
    resamples: int = 4000,
) -> pd.DataFrame:
    """Proportions of yes and their differences, with raters and clips both resampled.

    Parameters
    ----------
    df
        One row for each answer.
    rater, clip, condition, answer
        Names of columns; answers are 0 or 1. ``clip=None`` resamples raters only and so speaks about these very clips.
        A clip label that occurs in several conditions counts as one clip shown in each of them, so give the label of
        what was performed where conditions share it and labels of their own where they do not.
    pairs
        Differences to report; all by default.
    level, seed, resamples
        Of the percentile intervals.

    Returns
    -------
    DataFrame
        Rows of two kinds, named by ``quantity``: ``proportion`` (of ``a``) and ``difference`` (``a`` minus ``b``), with
        ``estimate, se, low, high, p, n_raters, n_clips``. ``p`` is two-sided for differences and NaN for proportions.

    Notes
    -----
    Each resample gives every rater and every clip a multinomial weight, and an answer the product of both: the
    pigeonhole bootstrap (McCullagh, Bernoulli 6, 2000; Owen, Annals of Applied Statistics 1, 2007), somewhat
    conservative. Averaging over clips first would treat the clips at hand as all there are (Clark 1973; Judd, Westfall &
    Kenny 2012) and gives intervals that are too narrow where clips differ.
    """
    draws = pigeonhole_draws(
        df, rater=rater, clip=clip, condition=condition, answer=answer, seed=seed, resamples=resamples
    )
    return _table(draws, "proportion", pairs, level)


def pigeonhole_means(
    df: pd.DataFrame,
    *,
    rater: str,
    clip: str | None,
    condition: str,
    value: str,
    pairs: Sequence[tuple[Any, Any]] | None = None,
    level: float = 0.95,
    seed: int = 0,
    resamples: int = 4000,
) -> pd.DataFrame:
    """Mean scores and their differences, with raters and clips both resampled.

    Parameters
    ----------
    df
        One row for each score, all of them finite.
    rater, clip, condition, pairs, level, seed, resamples
        As in :func:`pigeonhole_bootstrap`; the same seed gives the same draws of raters and clips.
    value
        Name of the column of scores, on any scale.

    Returns
    -------
    DataFrame
        As of :func:`pigeonhole_bootstrap`, with ``mean`` in place of ``proportion``. Means are over answers.
    """
    draws = pigeonhole_draws(
        df, rater=rater, clip=clip, condition=condition, answer=value, scale=True, seed=seed, resamples=resamples
    )
    return _table(draws, "mean", pairs, level)


def _finite(df: pd.DataFrame, name: str) -> NDArray[np.float64]:
    values = numeric(df, name)
    if np.isnan(values).any():
        raise ValueError(f"column {name} lacks a value in {int(np.isnan(values).sum())} rows; leave these rows out")
    return values


def _table(draws: Draws, quantity: str, pairs: Sequence[tuple[Any, Any]] | None, level: float) -> pd.DataFrame:
    import pandas as pd

    tail = 50.0 * (1.0 - level)

    def row(kind: str, a: Any, b: Any, estimate: float, drawn: NDArray[np.float64], clips: int) -> dict[str, Any]:
        found = drawn[np.isfinite(drawn)]
        low, high = np.percentile(found, [tail, 100.0 - tail])
        return {
            "quantity": kind,
            "a": a,
            "b": b,
            "estimate": float(estimate),
            "se": float(found.std(ddof=1)),
            "low": float(low),
            "high": float(high),
            "p": tail_p(found, 0.0) if kind == "difference" else float("nan"),
            "n_raters": draws.raters,
            "n_clips": clips,
        }

    names, observed, drawn, clips = draws.levels, draws.observed, draws.resampled, draws.clips
    rows = [row(quantity, name, "", observed[i], drawn[:, i], int(clips[i])) for i, name in enumerate(names)]
    for i, j in select_pairs(names, pairs) if len(names) > 1 else []:
        apart = drawn[:, i] - drawn[:, j]
        rows.append(
            row("difference", names[i], names[j], observed[i] - observed[j], apart, int(min(clips[i], clips[j])))
        )
    return pd.DataFrame(rows)
