"""Methods compared on objective metrics: the unit is the clip within its actor, training seeds are a level of their own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from eval.stats.correction import holm_within
from eval.stats.frames import select_pairs
from eval.stats.panel import Panel, Resampler, check_labels, read_panel, resample
from eval.stats.pigeonhole import tail_p
from eval.stats.ranks import critical_difference, friedman_statistic, rank_groups, row_ranks

if TYPE_CHECKING:
    import pandas as pd

#: Actors from which signs are flipped by actor: with fewer, no p value could fall below 5 %.
ENOUGH_ACTORS = 6
#: Units up to which all sign patterns are tried instead of random ones.
EXACT_UNITS = 12
#: Tests permuted at once.
COLUMNS = 64


class Comparison(NamedTuple):
    """The three tables of :func:`compare`."""

    means: pd.DataFrame
    differences: pd.DataFrame
    ranks: pd.DataFrame


def compare(
    df: pd.DataFrame,
    *,
    method: str = "method",
    clip: str = "clip_id",
    actor: str = "actor",
    metric: str = "metric",
    value: str = "value",
    training_seed: str | None = "repetition",
    better: Mapping[Any, str | float] | None = None,
    families: Mapping[str, Sequence[Any]] | None = None,
    pairs: Sequence[tuple[Any, Any]] | None = None,
    unit: str = "auto",
    block: str = "clip",
    level: float = 0.95,
    seed: int = 0,
    resamples: int = 2000,
) -> Comparison:
    """Means, paired differences and ranks of methods on each metric.

    Parameters
    ----------
    df
        One row for each (method, clip, training seed, metric); rows without a value say that the metric does not apply.
    method, clip, actor, metric, value, training_seed
        Names of columns; ``training_seed=None`` if every method was trained once.
    better
        For each metric to be ranked ``"low"``, ``"high"``, or the number that values should come close to.
    families
        Declared families of metrics for Holm's correction, by name. Tests of metrics in no family are exploratory: their
        ``p_holm`` is NaN. Without it all tests of the table are one family.
    pairs
        Pairs of methods to test; all by default.
    unit
        Whose signs the permutation test flips: ``"actor"``, ``"clip"``, or ``"auto"``, which takes actors where there are at
        least six. By clip ``p_flip`` says nothing about other actors, and in no case about other trainings.
    block
        Blocks of the ranking: ``"clip"``, or ``"actor"`` for means over an actor's clips.
    level, seed, resamples
        Of the intervals and of random permutations. A bootstrap p is never below 2 / (resamples + 1): with a family of m
        tests take at least 40 m resamples, or nothing can be rejected at 5 %.

    Returns
    -------
    Comparison
        ``means``: ``metric, method, mean, low, high, n_clips, n_actors, n_seeds``.
        ``differences``: ``metric, a, b, diff (mean a - mean b over the clips both have), low, high, p (bootstrap), p_flip
        (sign flips of ``unit``), unit, n_units, n_clips, family, p_holm, family_size, reject``; Holm corrects ``p``.
        ``ranks``: ``metric, method, mean_rank, groups, cd, chi2, df, p, n, k, n_dropped`` (rank 1 is best, ``n_dropped``
        counts blocks that some method lacks).

    Raises
    ------
    ValueError
        On missing columns, duplicate cells, unknown labels, or a metric of two families.

    Notes
    -----
    Means are over clips, after repetitions of a clip have been averaged. Intervals are percentiles of a hierarchical
    bootstrap: actors, clips within actors, and training seeds crossed with both (Davison & Hinkley 1997, section 3.8;
    Owen 2007 for crossed factors), with one actor and one seed less than there are in each resample, which undoes the bias of
    the bootstrap at levels with few units (Rao & Wu 1988). With one actor or seed that level cannot vary, and intervals say
    nothing about others. Sign flips assume that a difference is symmetric around 0 when methods do not differ
    (Good, *Permutation Tests*), and take the trained models as given: without any difference between methods, but with
    actors and trainings that vary half as much as clips, they come out at 5 % in 20 to 50 % of simulated studies of two to
    eight actors and three seeds, the bootstrap in 6 to 7 %. Ranks: Demsar (2006).
    """
    panel = read_panel(df, method=method, clip=clip, actor=actor, metric=metric, value=value, seed=training_seed)
    for wanted in (better or {}, *(families or {}).values()):
        check_labels(df[metric], list(wanted))
    draws = resample(panel, seed=seed, resamples=resamples)
    scores = panel.per_clip()
    everything = np.arange(len(panel.metrics), dtype=np.intp)
    boot = [draws.means(index, np.isfinite(scores[index]), everything) for index in range(len(panel.methods))]
    return Comparison(
        _means(panel, scores, boot, level),
        _differences(panel, scores, boot, draws, select_pairs(panel.methods, pairs), families, unit, level, seed),
        _ranks(panel, scores, better or {}, block, 1.0 - level),
    )


def _interval(draws: NDArray[np.float64], level: float) -> NDArray[np.float64]:
    """Percentile limits (2, K) of the finite draws (B, K) of each column; NaN where there are none."""
    tail = 50.0 * (1.0 - level)
    whole = np.isfinite(draws).all(axis=0)
    limits = np.full((2, draws.shape[1]), np.nan)
    if whole.any():
        limits[:, whole] = np.percentile(draws[:, whole], [tail, 100.0 - tail], axis=0)
    for column in np.flatnonzero(~whole):
        found = draws[np.isfinite(draws[:, column]), column]
        if len(found):
            limits[:, column] = np.percentile(found, [tail, 100.0 - tail])
    return limits


def _average(scores: NDArray[np.float64], mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    count = mask.sum(axis=0)
    total = np.where(mask, scores, 0.0).sum(axis=0)
    return np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)


def _means(panel: Panel, scores: NDArray[np.float64], boot: list[NDArray[np.float64]], level: float) -> pd.DataFrame:
    import pandas as pd

    rows = []
    for index, name in enumerate(panel.methods):
        there = np.isfinite(scores[index])
        mean = _average(scores[index], there)
        low, high = _interval(boot[index], level)
        seeds = np.isfinite(panel.values[index]).any(axis=0).sum(axis=0)
        rows += [
            {
                "metric": metric,
                "method": name,
                "mean": mean[k],
                "low": low[k],
                "high": high[k],
                "n_clips": int(there[:, k].sum()),
                "n_actors": len(np.unique(panel.actor[there[:, k]])),
                "n_seeds": int(seeds[k]),
            }
            for k, metric in enumerate(panel.metrics)
            if there[:, k].any()
        ]
    return pd.DataFrame(rows).sort_values(["metric"], kind="stable", ignore_index=True, key=_order(panel.metrics))


def _order(labels: Sequence[Any]) -> Any:
    place = {label: index for index, label in enumerate(labels)}
    return lambda column: column.map(place)


def _differences(
    panel: Panel,
    scores: NDArray[np.float64],
    boot: list[NDArray[np.float64]],
    draws: Resampler,
    pairs: list[tuple[int, int]],
    families: Mapping[str, Sequence[Any]] | None,
    unit: str,
    level: float,
    seed: int,
) -> pd.DataFrame:
    import pandas as pd

    if unit not in ("auto", "actor", "clip"):
        raise ValueError(f'unit must be "auto", "actor" or "clip", not {unit!r}')
    by_actor = unit == "actor" or (unit == "auto" and len(panel.actors) >= ENOUGH_ACTORS)
    units = panel.actor if by_actor else np.arange(len(panel.actor))
    family_of = _family_of(families)
    there = np.isfinite(scores)
    rows: list[dict[str, Any]] = []
    columns = []
    for a, b in pairs:
        common = there[a] & there[b]
        apart = boot[a] - boot[b]
        # Where one method lacks a clip both are averaged anew over the clips they share.
        uneven = np.flatnonzero((common != there[a]).any(axis=0) | (common != there[b]).any(axis=0))
        if len(uneven):
            apart[:, uneven] = draws.means(a, common[:, uneven], uneven) - draws.means(b, common[:, uneven], uneven)
        # Rounding is no difference.
        noise = 1e-12 * np.abs(np.nan_to_num(boot[a])).max(axis=0)
        apart[np.abs(apart) <= noise] = 0.0
        paired = np.where(common, scores[a] - scores[b], 0.0)
        low, high = _interval(apart, level)
        count = common.sum(axis=0)
        for k in np.flatnonzero(count):
            found = apart[np.isfinite(apart[:, k]), k]
            columns.append(paired[:, k])
            rows.append(
                {
                    "metric": panel.metrics[k],
                    "a": panel.methods[a],
                    "b": panel.methods[b],
                    "diff": float(paired[:, k].sum() / count[k]),
                    "low": low[k],
                    "high": high[k],
                    "p": tail_p(found, 0.0),
                    "p_flip": float("nan"),
                    "unit": "actor" if by_actor else "clip",
                    "n_units": len(np.unique(units[common[:, k]])),
                    "n_clips": int(count[k]),
                    "family": "all" if families is None else family_of.get(panel.metrics[k], ""),
                }
            )
    if not rows:
        names = ["metric", "a", "b", "diff", "low", "high", "p", "p_flip", "unit", "n_units", "n_clips", "family"]
        return pd.DataFrame(columns=[*names, "p_holm", "family_size", "reject"])
    table = pd.DataFrame(rows)
    table["p_flip"] = sign_flip_p(np.column_stack(columns), units, seed=seed, flips=len(draws.clip_weight))
    table = holm_within(table, family="family", alpha=1.0 - level)
    loose = table["family"] == ""
    table.loc[loose, "p_holm"] = np.nan
    table.loc[loose, ["reject", "family_size"]] = [False, 0]
    return table.sort_values(["metric"], kind="stable", ignore_index=True, key=_order(panel.metrics))


def _family_of(families: Mapping[str, Sequence[Any]] | None) -> dict[Any, str]:
    found: dict[Any, str] = {}
    for name, members in (families or {}).items():
        for member in members:
            if member in found:
                raise ValueError(f"{member} is in two families, {found[member]} and {name}; declare it once")
            found[member] = name
    return found


def sign_flip_p(
    differences: NDArray[np.float64], units: NDArray[np.integer[Any]], *, seed: int = 0, flips: int = 2000
) -> NDArray[np.float64]:
    """Two-sided p values of the mean of paired differences when the signs of whole units are flipped.

    Parameters
    ----------
    differences
        (C, T): differences of C clips in T tests; 0 where a test lacks the clip.
    units
        (C,) labels: clips of one unit change sign together.
    seed, flips
        Of random sign patterns; up to twelve units all patterns are tried.

    Returns
    -------
    ndarray
        (T,): share of sign patterns, the observed one included, with at least the observed size of the sum.
    """
    codes = np.unique(units, return_inverse=True)[1].ravel()
    count = int(codes.max()) + 1
    sums = np.zeros((count, differences.shape[1]))
    np.add.at(sums, codes, differences)
    if count <= EXACT_UNITS:
        # The last sign stays: flipping all of them changes no size.
        patterns = np.arange(2 ** (count - 1))[:, None] >> np.arange(count) & 1
        signs = 1.0 - 2.0 * patterns
    else:
        signs = np.random.default_rng(seed).integers(0, 2, size=(flips, count)) * 2.0 - 1.0
        signs = np.vstack([np.ones(count), signs])
    reached = np.abs(sums.sum(axis=0)) - 1e-12 * np.abs(sums).sum(axis=0)
    p = np.empty(sums.shape[1])
    # In blocks, so that many patterns of many tests stay small in memory.
    for start in range(0, len(p), COLUMNS):
        block = slice(start, start + COLUMNS)
        p[block] = (np.abs(signs @ sums[:, block]) >= reached[block]).mean(axis=0)
    return p


def _ranks(
    panel: Panel, scores: NDArray[np.float64], better: Mapping[Any, str | float], block: str, alpha: float
) -> pd.DataFrame:
    import pandas as pd
    from scipy.special import chdtrc

    if block not in ("clip", "actor"):
        raise ValueError(f'block must be "clip" or "actor", not {block!r}')
    rows: list[dict[str, Any]] = []
    for k, metric in enumerate(panel.metrics):
        if metric not in better:
            continue
        loss = _loss(scores[:, :, k], metric, better[metric])
        methods = np.flatnonzero(np.isfinite(loss).any(axis=1))
        loss = loss[methods].T
        some = np.isfinite(loss).any(axis=1)
        whole = np.isfinite(loss).all(axis=1)
        blocks, actors = loss[whole], panel.actor[whole]
        if block == "actor" and len(blocks):
            blocks = np.stack([blocks[actors == one].mean(axis=0) for one in np.unique(actors)])
        if len(methods) < 2 or len(blocks) < 2:
            continue
        ranks = row_ranks(blocks)
        n, size = ranks.shape
        chi2, _ = friedman_statistic(ranks)
        cd = critical_difference(n, size, alpha=alpha)
        mean = ranks.mean(axis=0)
        bars = rank_groups(mean, cd)
        rows += [
            {
                "metric": metric,
                "method": panel.methods[methods[index]],
                "mean_rank": mean[index],
                "groups": tuple(number for number, bar in enumerate(bars) if index in bar),
                "cd": cd,
                "chi2": chi2,
                "df": size - 1,
                "p": float(chdtrc(size - 1, chi2)),
                "n": n,
                "k": size,
                "n_dropped": int(some.sum() - whole.sum()),
            }
            for index in np.argsort(mean, kind="stable")
        ]
    names = ["metric", "method", "mean_rank", "groups", "cd", "chi2", "df", "p", "n", "k", "n_dropped"]
    return pd.DataFrame(rows, columns=names)


def _loss(values: NDArray[np.float64], metric: Any, goal: str | float) -> NDArray[np.float64]:
    """Values turned so that less is better."""
    if goal == "low":
        return values
    if goal == "high":
        return -values
    if isinstance(goal, str):
        raise ValueError(f'better[{metric!r}] must be "low", "high" or a number, not {goal!r}')
    return np.abs(values - float(goal))
