"""Simulated observers: a documented model of how a person might rate motion, driven by objective scores.

They rehearse a study, its analysis and its figures before people are asked. They say what the metrics would mean to such
observers, and nothing about people: every answer carries :data:`eval.ratings.reading.SIMULATED`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from eval.ratings.reading import HIGHEST, LOWEST, SIMULATED

if TYPE_CHECKING:
    import pandas as pd

#: Scores of how likely a stimulus is of the target style, in [0, 1]; the mean of those that are there, on the probit scale.
RECOGNITION = ("recognition/p-target-temporal", "recognition/p-target-kinematic")

#: Ratios to real target motion whose logarithm tells source from target where no recognition score is there.
LIVELINESS = ("style/speed-ratio", "style/range-of-motion-ratio")

#: Log ratio of the source style's median to the target below which a ratio does not tell the two apart.
_APART = 0.05

#: Probabilities are kept this far from 0 and 1: no clip is beyond all doubt to a person.
_SURE = 0.02


@dataclass(frozen=True)
class Flaw:
    """How a plausibility metric takes naturalness away.

    Attributes
    ----------
    metric
        Name of the score.
    unit
        How far outside the range of real motion costs ``weight``; in doublings for a ratio.
    weight
        Loss for one unit, in standard deviations of a single judgement.
    ratio
        Whether the score is a ratio, whose excess counts both ways; of others only too much is a flaw.
    band
        Range taken as real where no real motion is among the stimuli.
    """

    metric: str
    unit: float
    weight: float
    ratio: bool
    band: tuple[float, float]


@dataclass(frozen=True)
class ObserverModel:
    """An observer's parameters.

    Defaults that no source is named for are assumptions, chosen for plausible spread and not fitted to any person; a study
    with people replaces them.

    Attributes
    ----------
    sensitivity
        How much of a classifier's evidence reaches the observer, on the probit scale (signal detection: Green and Swets
        1966, with unit noise of a single judgement). Below 1: a classifier is trained on the data set, a person sees each
        figure once. Assumed.
    bias_sd
        Spread over observers of the readiness to say "child". Assumed.
    clip_sd
        Spread over source clips of how childlike a performance looks in every condition. Clips differ as raters do (Clark
        1973); assumed as large as the raters' spread.
    stimulus_sd
        Spread over single stimuli around what their scores say, the part of an observer's evidence that no metric has.
        This is why results of an analysis that takes clips as fixed do not carry over to other clips. Assumed.
    lapse
        Share of answers given without looking; Wichmann and Hill (2001) hold it within 0 to 0.06, and this is the middle.
    flaws
        What makes motion unnatural.
    thresholds
        Six cuts of the latent naturalness, standard normal noise, between the answers 1 to 7 (cumulative probit, McKelvey and
        Zavoina 1975): motion without a flaw gets 5 to 6 on average. Assumed.
    worst
        Largest loss through one flaw, so that one broken number does not decide everything.
    leniency_sd
        Spread over observers of the latent naturalness. Assumed.
    confusion
        Probability of naming another action. Assumed.
    careless
        Observers who answer at random, for each attentive one: five of 41 in Dong et al. (2020) failed the check.
    """

    sensitivity: float = 0.7
    bias_sd: float = 0.35
    clip_sd: float = 0.35
    stimulus_sd: float = 0.2
    lapse: float = 0.03
    flaws: tuple[Flaw, ...] = (
        Flaw("physics/jerk-ratio", 1.0, 0.9, ratio=True, band=(0.5, 2.0)),
        Flaw("physics/foot-skate-ratio", 0.1, 0.5, ratio=False, band=(0.0, 0.1)),
        Flaw("physics/floor-penetration", 0.02, 0.4, ratio=False, band=(0.0, 0.02)),
    )
    thresholds: tuple[float, ...] = (-2.6, -1.9, -1.3, -0.7, 0.0, 0.9)
    worst: float = 2.5
    leniency_sd: float = 0.5
    confusion: float = 0.08
    careless: float = 5 / 36

    def __post_init__(self) -> None:
        if len(self.thresholds) != HIGHEST - LOWEST or any(np.diff(self.thresholds) <= 0):
            raise ValueError(f"thresholds are {HIGHEST - LOWEST} rising numbers, not {self.thresholds}")
        for name in ("lapse", "confusion"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} is a probability, not {getattr(self, name)}")
        for name in ("sensitivity", "bias_sd", "clip_sd", "stimulus_sd", "leniency_sd", "careless", "worst"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name} is 0 or more, not {getattr(self, name)}")


@dataclass(frozen=True)
class Observed:
    """What simulated observers answered.

    Attributes
    ----------
    ratings
        In the format of a ratings file, ``kind`` included.
    evidence
        One row a stimulus: ``stimulus, condition, p_target, flaw_loss``, which the answers were drawn from.
    notes
        Where the evidence came from.
    """

    ratings: pd.DataFrame
    evidence: pd.DataFrame
    notes: tuple[str, ...]


def observe(
    stimuli: pd.DataFrame,
    scores: pd.DataFrame,
    *,
    rng: np.random.Generator,
    raters: int = 36,
    model: ObserverModel | None = None,
    styles: tuple[str, str] = ("adult", "child"),
    real: tuple[str, str] = ("adult", "child"),
) -> Observed:
    """Let simulated observers rate stimuli.

    Parameters
    ----------
    stimuli
        As :func:`eval.ratings.reading.read_stimuli` gives it.
    scores
        A column ``stimulus`` and one for each metric; NaN where a metric has no value.
    rng
        Every draw comes from it.
    raters
        Attentive observers. Careless ones come on top, ``model.careless`` for each, rounded.
    model
        Parameters.
    styles
        The two answers to the first question: source and target style.
    real
        Conditions that show real motion of the source and of the target style; they set the scale where there is no
        recognition score, and what counts as natural. Conditions that do not occur are passed over.

    Returns
    -------
    Observed
        Raters ``o01``, ``o02`` …, careless ones among them at random places, each with an order of their own.

    Raises
    ------
    ValueError
        For fewer than two raters, or stimuli without scores.

    Notes
    -----
    Observer r says "target" to stimulus s of clip i with probability ``l/2 + (1-l) Phi(a z_s + b_r + u_i + v_s)``, ``z_s``
    the probit of P(target); latent naturalness is ``-sum(losses) + lenience_r + v'_s + noise``, cut by the thresholds; the
    action is named right with probability ``1 - confusion``. On a lapse (probability l), and always for a careless
    observer, each of the three answers is a uniform guess.
    """
    import pandas as pd
    from scipy.special import ndtr

    model = ObserverModel() if model is None else model
    if raters < 2:
        raise ValueError(f"an analysis of raters needs two or more, not {raters}")
    table = stimuli.merge(scores, on="stimulus", how="left", validate="one_to_one")
    lacking = sorted(set(stimuli["stimulus"]) - set(scores["stimulus"]))
    if lacking:
        raise ValueError(f"no scores for the stimuli {', '.join(lacking[:5])}")
    z, evidence_note = target_evidence(table, real)
    loss, flaw_note = flaw_losses(table, real, model)
    total, n = raters + round(raters * model.careless), len(table)
    careless = np.zeros(total, dtype=bool)
    careless[rng.choice(total, total - raters, replace=False)] = True

    clips = table["clip_id"].to_numpy()
    of_clip = dict(zip(sorted(set(clips)), rng.normal(0.0, model.clip_sd, len(set(clips))), strict=True))
    clip_effect = np.array([of_clip[clip] for clip in clips])
    own = rng.normal(0.0, model.stimulus_sd, (2, n))
    bias = rng.normal(0.0, model.bias_sd, total)
    lenience = rng.normal(0.0, model.leniency_sd, total)

    says_target = rng.random((total, n)) < ndtr(model.sensitivity * z + clip_effect + own[0] + bias[:, None])
    latent = -loss + own[1] + lenience[:, None] + rng.standard_normal((total, n))
    natural = LOWEST + np.searchsorted(model.thresholds, latent)
    actions = sorted({text.split("|")[0] for text in table["expected"]})
    right = np.array([actions.index(text.split("|")[0]) for text in table["expected"]])
    # A step of 1 .. K-1 from the right one is uniform over the wrong ones; with one action only there is no wrong one.
    steps = rng.integers(1, max(2, len(actions)), (total, n)) * (rng.random((total, n)) < model.confusion)
    named = (right + steps) % len(actions)

    guesses = careless[:, None] | (rng.random((total, n)) < model.lapse)
    says_target = np.where(guesses, rng.random((total, n)) < 0.5, says_target)
    natural = np.where(guesses, rng.integers(LOWEST, HIGHEST + 1, (total, n)), natural)
    named = np.where(guesses, rng.integers(0, len(actions), (total, n)), named)

    width = max(2, len(str(total)))
    parts = []
    for index in range(total):
        order = rng.permutation(n)
        parts.append(
            pd.DataFrame(
                {
                    "rater": f"o{index + 1:0{width}d}",
                    "stimulus": table["stimulus"].to_numpy()[order],
                    "style": np.where(says_target[index], styles[1], styles[0])[order],
                    "naturalness": natural[index][order],
                    "action": np.array(actions, dtype=object)[named[index]][order],
                    "order": np.arange(1, n + 1),
                    "kind": SIMULATED,
                }
            )
        )
    known = pd.DataFrame(
        {
            "stimulus": table["stimulus"],
            "condition": table["condition"],
            "p_target": ndtr(z),
            "flaw_loss": loss,
            "kind": SIMULATED,
        }
    )
    head = f"{raters} attentive and {total - raters} careless observers were simulated: {SIMULATED}."
    return Observed(pd.concat(parts, ignore_index=True), known, (head, evidence_note, flaw_note))


def target_evidence(table: pd.DataFrame, real: tuple[str, str]) -> tuple[NDArray[np.float64], str]:
    """Probit of P(target) of each stimulus, and where it comes from.

    Parameters
    ----------
    table
        Stimuli with their scores.
    real
        The conditions of real source and real target motion.

    Returns
    -------
    (N,) float64
        From the recognition scores where there are any. Otherwise from :data:`LIVELINESS`: each log ratio is placed on the
        line from the source condition's median (0) to real target motion, whose ratio is 1 (1); ``P = 1 / (1 + exp(-4 (t -
        1/2)))`` for the mean place t, which is 0.12 at the source and 0.88 at the target. Without either, 1/2.
    str
        A sentence.
    """
    from scipy.special import expit, ndtri

    n = len(table)
    found = [name for name in RECOGNITION if name in table and table[name].notna().any()]
    if found:
        values = np.clip(table[found].to_numpy(dtype=np.float64), _SURE, 1.0 - _SURE)
        z = _row_means(ndtri(values))
        gaps = int(np.isnan(z).sum())
        rest = f" ({gaps} stimuli without one are taken as undecided)" if gaps else ""
        return np.nan_to_num(z, nan=0.0), f"Evidence of the style: P(target) by {', '.join(found)}{rest}."
    places, used = [], []
    source = table["condition"] == real[0]
    for name in LIVELINESS:
        if name not in table or not source.any():
            continue
        logs = _log(table[name].to_numpy(dtype=np.float64))
        of_source = logs[source.to_numpy()]
        start = float(np.median(of_source[np.isfinite(of_source)])) if np.isfinite(of_source).any() else 0.0
        if abs(start) >= _APART:
            places.append((logs - start) / -start)
            used.append(name)
    if not places:
        return np.zeros(n), (
            "Evidence of the style: none of the scores tells the two styles apart, so that every stimulus is undecided."
        )
    place = np.nan_to_num(_row_means(np.stack(places, axis=1)), nan=0.5)
    chance = np.clip(expit(4.0 * (place - 0.5)), _SURE, 1.0 - _SURE)
    return ndtri(chance), (
        f"Evidence of the style: no recognition score was there; a substitute places each stimulus between real source and "
        f"real target motion by {', '.join(used)}."
    )


def flaw_losses(table: pd.DataFrame, real: tuple[str, str], model: ObserverModel) -> tuple[NDArray[np.float64], str]:
    """Loss of latent naturalness of each stimulus (N,), in standard deviations of a judgement, and where it comes from.

    What real performers of either style do among the stimuli is natural: a flaw is what lies outside their 5 to 95 % range.
    """
    total = np.zeros(len(table))
    is_real = table["condition"].isin(list(real)).to_numpy()
    used = []
    for flaw in model.flaws:
        if flaw.metric not in table or not table[flaw.metric].notna().any():
            continue
        values = table[flaw.metric].to_numpy(dtype=np.float64)
        band = np.array(flaw.band)
        if flaw.ratio:
            values, band = _log(values) / math.log(2.0), np.log2(band)
        natural = values[is_real & np.isfinite(values)]
        low, high = np.percentile(natural, [5.0, 95.0]) if natural.size else band
        outside = np.maximum(values - high, low - values if flaw.ratio else -math.inf)
        loss = flaw.weight * np.maximum(outside, 0.0) / flaw.unit
        total += np.minimum(np.nan_to_num(loss, nan=0.0), model.worst)
        used.append(flaw.metric)
    listed = ", ".join(used) if used else "no score, so that nothing looks unnatural"
    return total, f"Evidence of naturalness: {listed}; what real performers do counts as natural."


def _log(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Natural logarithm; NaN where a value is not positive."""
    return np.log(np.where(values > 0, values, np.nan))


def _row_means(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean over columns of what is there; NaN where a row has nothing."""
    there = np.isfinite(values)
    sums = np.where(there, values, 0.0).sum(axis=1)
    counts = there.sum(axis=1)
    return np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)
