"""How often each procedure finds something when there is nothing: 36 raters, five methods, seeded."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from eval.stats import holm, holm_paired, rm_anova, tukey_hsd_between, tukey_hsd_within
from eval.stats.posthoc import error_mean_square, paired_t, studentized_range_quantile, t_test_p
from eval.stats.sphericity import mauchly

REPETITIONS, N, K = 500, 36, 5
PAIRS = list(combinations(range(K), 2))
FIRST, SECOND = (np.array([pair[side] for pair in PAIRS]) for side in (0, 1))


def binomial(rng) -> np.ndarray:
    """Shares of ten clips called child; raters differ by one logit."""
    p = 1.0 / (1.0 + np.exp(-rng.normal(size=(N, 1))))
    return rng.binomial(10, np.repeat(p, K, axis=1)) / 10.0


def uneven(spread: float):
    """Normal scores of raters who differ, with one condition that spreads more."""

    def draw(rng) -> np.ndarray:
        return 2.0 * rng.normal(size=(N, 1)) + rng.normal(size=(N, K)) * np.array([1.0, 1.0, 1.0, 1.0, spread])

    return draw


def decisions(y: np.ndarray) -> tuple[bool, bool, bool, bool, bool]:
    """Does anything come out: Tukey between, Tukey within, Holm, F, F with Greenhouse-Geisser."""
    from scipy.special import fdtrc

    means = y.mean(axis=0)
    span = np.ptp(means)
    between = span / np.sqrt(y.var(axis=0, ddof=1).mean() / N) > studentized_range_quantile(0.95, K, K * (N - 1.0))
    error = error_mean_square(y)
    within = span / np.sqrt(error / N) > studentized_range_quantile(0.95, K, (N - 1.0) * (K - 1))
    paired = holm(t_test_p(paired_t(y[:, FIRST] - y[:, SECOND]), N - 1)).min() <= 0.05
    f = N * means.var(ddof=1) / error
    eps = mauchly(y).eps_gg
    df = (K - 1, (K - 1) * (N - 1))
    return between, within, paired, fdtrc(*df, f) <= 0.05, fdtrc(eps * df[0], eps * df[1], f) <= 0.05


def rates(draw, seed: int) -> dict[str, float]:
    rng = np.random.default_rng(seed)
    found = np.mean([decisions(draw(rng)) for _ in range(REPETITIONS)], axis=0)
    return dict(zip(["between", "within", "holm", "F", "F_gg"], found, strict=True))


def test_the_decisions_are_those_of_the_public_functions(long):
    rng = np.random.default_rng(3)
    rm = {"subject": "rater", "within": "method", "value": "score"}
    for shift in (0.0, 0.35, 0.5, 0.9):
        y = binomial(rng) + np.array([0, 0, 0, 0, shift / 3])
        df = long(y)
        anova = rm_anova(df, **rm).iloc[0]
        assert decisions(y) == (
            tukey_hsd_between(df, group="method", value="score")["reject"].any(),
            tukey_hsd_within(df, **rm)["reject"].any(),
            holm_paired(df, **rm)["reject"].any(),
            anova["p"] <= 0.05,
            anova["p_gg"] <= 0.05,
        )


def test_binomial_ratings_under_the_null():
    rate = rates(binomial, 11)
    assert rate["between"] <= 0.01
    for name in ("within", "holm", "F", "F_gg"):
        assert 0.02 <= rate[name] <= 0.08, (name, rate)


def test_mild_departure_from_sphericity():
    rate = rates(uneven(2.0), 12)
    assert rate["between"] <= 0.01
    assert 0.02 <= rate["holm"] <= 0.08
    assert 0.02 <= rate["F_gg"] <= 0.08
    assert rate["within"] > rate["holm"]
    assert rate["F"] >= rate["F_gg"]


def test_strong_departure_breaks_pooled_errors_only():
    rate = rates(uneven(8.0), 13)
    assert 0.015 <= rate["holm"] <= 0.08
    assert 0.02 <= rate["F_gg"] <= 0.08
    assert rate["within"] > 0.08
    assert rate["F"] > 0.08


@pytest.mark.parametrize("effect", [0.2, 0.3])
def test_the_test_between_groups_loses_power_on_paired_ratings(effect):
    rng = np.random.default_rng(14)

    def shifted(rng) -> np.ndarray:
        return uneven(1.0)(rng) + np.array([0, 0, 0, 0, effect * 2.5])

    found = np.mean([decisions(shifted(rng)) for _ in range(200)], axis=0)
    assert found[2] > found[0] + 0.3
