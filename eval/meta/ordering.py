"""Whether a metric orders the grades of a corruption, in which direction, from which grade on, and by how much."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from benchmark.api import MetricInfo

Array = NDArray[np.float64]

#: ``ordered``: worse with every grade, and beyond doubt at the last; ``seen``: worse beyond doubt at the last, not in order;
#: ``fooled``: better beyond doubt at the last; ``blind``: no difference to be made out; ``no value``: too few clips have one.
Observed = Literal["ordered", "seen", "fooled", "blind", "no value"]

#: Clips below which nothing is said, resamples of the bootstrap, and the tails of its interval in percent.
_FEWEST, _RESAMPLES, _TAILS = 3, 2000, (2.5, 97.5)

#: Share of the clips that must have a value at a grade for the grade to count.
_COVERED = 0.5

#: Changes below this share of the values, or below this number, are rounding (an angle from the arc cosine of a number next to
#: 1 has no more digits); effects below this many standard deviations are no reaction.
_ROUNDING, _LEAST, _NO_EFFECT = 1e-7, 1e-5, 0.05

#: Effects are cut off here: a metric that is the same for all faultless clips has no spread to measure against.
MOST_EFFECT = 9.99


@dataclass(frozen=True)
class Ordering:
    """What one metric makes of one corruption.

    Attributes
    ----------
    observed
        In a word.
    effect
        Change at the last grade in standard deviations between clips (Cohen's d with the mean of both variances); above 0 is
        worse, below 0 better. Where the metric prefers no direction, above 0.
    tau, tau_low, tau_high
        Kendall's tau-b between grade and mean value, with its bootstrap interval, in the direction of ``effect``.
    ordered_share
        Share of the bootstrap samples in which no grade is out of order.
    first_seen
        Smallest grade from which on every grade differs from grade 0 beyond doubt, in one direction; 0 if there is none.
    means
        Mean value at each grade; NaN where too few clips have one.
    lows, highs
        95 % interval of the paired difference of each grade to grade 0.
    clips
        How many clips were used.
    """

    observed: Observed
    effect: float
    tau: float
    tau_low: float
    tau_high: float
    ordered_share: float
    first_seen: int
    means: tuple[float, ...]
    lows: tuple[float, ...]
    highs: tuple[float, ...]
    clips: int


def order_clips(values: Array, info: MetricInfo, *, seed: int = 0) -> Ordering:
    """Judge a metric of a clip.

    Parameters
    ----------
    values
        (N, G) value of each clip at each grade, NaN where there is none. The same clips in every column: differences are
        taken clip by clip, and a bootstrap over clips gives their intervals.
    info
        The metric's, for its direction.
    seed
        Of the bootstrap.
    """
    grades = values.shape[1]
    base = np.isfinite(values[:, 0])
    covered = np.isfinite(values[base]).mean(axis=0) >= _COVERED if base.any() else np.zeros(grades, dtype=bool)
    used = np.flatnonzero(covered)
    rows = values[np.isfinite(values[:, used]).all(axis=1)][:, used] if used.size else values[:0]
    if len(rows) < _FEWEST or used.size < 2 or used[0] != 0:
        return _nothing(grades, len(rows))
    draws = np.random.default_rng(seed).multinomial(len(rows), np.full(len(rows), 1.0 / len(rows)), _RESAMPLES)
    means, boot = rows.mean(axis=0), draws @ rows / len(rows)
    spread = np.sqrt(0.5 * (rows[:, 0].var(ddof=1) + rows[:, -1].var(ddof=1)))
    lows, highs = np.percentile(boot - boot[:, :1], _TAILS, axis=0)
    return _judge(means, boot, lows, highs, float(spread), info, used, grades, len(rows))


def order_sets(whole: Array, without: Array, info: MetricInfo, *, clips: int) -> Ordering:
    """Judge a metric of a set.

    Parameters
    ----------
    whole
        (G,) value of the set at each grade.
    without
        (K, G) values with one group of clips left out: the delete-a-group jackknife gives intervals of the differences to
        grade 0 (Student's t with K - 1 degrees of freedom).
    info
        The metric's, for its direction.
    clips
        How many clips the set has.
    """
    from scipy.stats import t as student

    grades = len(whole)
    usable = np.isfinite(whole) & np.isfinite(without).all(axis=0)
    used, groups = np.flatnonzero(usable), len(without)
    if used.size < 2 or used[0] != 0 or groups < 3:
        return _nothing(grades, clips)
    means, parts = whole[used], without[:, used]

    def error(replicates: Array) -> Array:
        centred = replicates - replicates.mean(axis=0)
        return np.asarray(np.sqrt((groups - 1) / groups * (centred**2).sum(axis=0)))

    half = float(student.ppf(0.5 + 0.005 * (_TAILS[1] - _TAILS[0]), groups - 1)) * error(parts - parts[:, :1])
    # The error of a mean over N clips is their spread over sqrt(N): that turns errors of a set into a spread between clips.
    spread = np.sqrt(0.5 * clips * (error(parts)[0] ** 2 + error(parts)[-1] ** 2))
    difference = means - means[0]
    return _judge(means, parts, difference - half, difference + half, float(spread), info, used, grades, clips)


def _judge(
    means: Array,
    resampled: Array,
    lows: Array,
    highs: Array,
    spread: float,
    info: MetricInfo,
    used: NDArray[np.int64],
    grades: int,
    clips: int,
) -> Ordering:
    noise = max(_ROUNDING * float(np.abs(means).max()), _LEAST)
    change = float(means[-1] - means[0])
    # ``rising`` is the sign of the change that is asked about; ``worse`` whether such a change is one for the worse.
    rising = 1.0 if change >= 0.0 else -1.0
    worse = {
        "lower": change > 0.0,
        "higher": change < 0.0,
        "target": abs(means[-1] - (info.target or 0.0)) > abs(means[0] - (info.target or 0.0)),
        "none": True,
    }[info.direction]
    effect = 0.0 if abs(change) <= noise else min(abs(change) / max(spread, 1e-12 * abs(change)), MOST_EFFECT)
    apart = (lows > noise) | (highs < -noise)
    along = rising * (means - means[0]) > 0.0
    clear = (apart & along)[1:]
    first = 0
    for index in range(len(clear), 0, -1):
        if not clear[index - 1]:
            break
        first = int(used[index])
    seen = bool(clear[-1]) and effect >= _NO_EFFECT
    steps = rising * np.diff(means)
    taus = kendall(resampled, rising, noise)
    in_order = bool((steps >= -noise).all())
    observed: Observed = "blind"
    if seen:
        observed = ("ordered" if in_order else "seen") if worse else "fooled"

    def spread_out(part: Array) -> tuple[float, ...]:
        full = np.full(grades, np.nan)
        full[used] = part
        return tuple(float(value) for value in full)

    return Ordering(
        observed=observed,
        effect=effect if worse else -effect,
        tau=float(kendall(means, rising, noise)),
        tau_low=float(np.percentile(taus, _TAILS[0])),
        tau_high=float(np.percentile(taus, _TAILS[1])),
        ordered_share=float((rising * np.diff(resampled, axis=1) >= -noise).all(axis=1).mean()),
        first_seen=first if seen else 0,
        means=spread_out(means),
        lows=spread_out(lows),
        highs=spread_out(highs),
        clips=clips,
    )


def _nothing(grades: int, clips: int) -> Ordering:
    nan = float("nan")
    empty = (nan,) * grades
    return Ordering("no value", nan, nan, nan, nan, nan, 0, empty, empty, empty, clips)


def kendall(means: Array, rising: float = 1.0, tolerance: float = 0.0) -> Array:
    """Kendall's tau-b between 0, 1, 2 … and ``rising * means`` (..., G); 0 if all tie, up to ``tolerance``."""
    first, second = np.triu_indices(means.shape[-1], 1)
    gaps = rising * (means[..., second] - means[..., first])
    signs = np.where(np.abs(gaps) <= tolerance, 0.0, np.sign(gaps))
    untied = np.count_nonzero(signs, axis=-1)
    return np.asarray(signs.sum(axis=-1) / np.sqrt(np.maximum(len(first) * untied, 1)))


def order_all(
    table: Mapping[tuple[str, str], Mapping[str, Array]], infos: Mapping[str, MetricInfo], *, clips: int, seed: int = 0
) -> dict[tuple[str, str], Ordering]:
    """Judge every (metric, corruption) of :func:`eval.meta.check.table`."""
    found = {}
    for (metric, corruption), rows in table.items():
        info = infos[metric]
        if info.scope == "set":
            without = np.array([row for name, row in rows.items() if name != "set"])
            found[metric, corruption] = order_sets(rows["set"], without, info, clips=clips)
        else:
            found[metric, corruption] = order_clips(np.array(list(rows.values())), info, seed=seed)
    return found
