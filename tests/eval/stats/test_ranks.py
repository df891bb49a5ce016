"""Rank tests against other implementations, printed tables and hand-made diagrams."""

from __future__ import annotations

import numpy as np
import pytest

from eval.stats import critical_difference, friedman, friedman_nemenyi, mean_ranks, rank_groups, wilcoxon_holm

RM = {"subject": "rater", "within": "method", "value": "score"}


def test_critical_difference_of_the_study_and_of_demsars_table():
    assert critical_difference(36, 5) == pytest.approx(1.017, abs=5e-4)
    # Demsar (2006), table 5: q at 5 % and 10 %.
    for k, q05, q10 in [(2, 1.960, 1.645), (3, 2.343, 2.052), (5, 2.728, 2.459), (10, 3.164, 2.920)]:
        scale = np.sqrt(k * (k + 1) / (6 * 30))
        assert critical_difference(30, k) / scale == pytest.approx(q05, abs=1e-3)
        assert critical_difference(30, k, alpha=0.1) / scale == pytest.approx(q10, abs=1e-3)


def test_friedman_agrees_with_scipy_with_and_without_ties(rng, long):
    from scipy.stats import friedmanchisquare

    for y in (rng.normal(size=(20, 4)), rng.integers(1, 8, size=(20, 4)).astype(float)):
        (row,) = friedman(long(y), **RM).to_dict("records")
        oracle = friedmanchisquare(*y.T)
        assert (row["chi2"], row["p"]) == pytest.approx((oracle.statistic, oracle.pvalue))
        assert row["W"] == pytest.approx(row["chi2"] / (20 * 3))
        assert row["F"] == pytest.approx(19 * row["chi2"] / (60 - row["chi2"]))
        assert (row["df"], row["df1"], row["df2"], row["n"], row["k"]) == (3, 3, 57, 20, 4)


def test_perfect_agreement_and_no_preference(long):
    (row,) = friedman(long(np.tile([1.0, 2.0, 3.0], (10, 1))), **RM).to_dict("records")
    assert (row["chi2"], row["W"], row["F"], row["p_F"]) == (pytest.approx(20.0), pytest.approx(1.0), np.inf, 0.0)
    (row,) = friedman(long(np.ones((10, 3))), **RM).to_dict("records")
    assert np.isnan([row["chi2"], row["p"], row["F"], row["p_F"]]).all()


def test_rank_one_is_the_best(long):
    df = long(np.tile([1.0, 5.0, 3.0], (8, 1)))
    assert mean_ranks(df, **RM)["level"].tolist() == ["b", "c", "a"]
    assert mean_ranks(df, **RM, best="low")["level"].tolist() == ["a", "c", "b"]
    assert mean_ranks(df, **RM)["mean_rank"].tolist() == [1.0, 2.0, 3.0]
    with pytest.raises(ValueError, match='"low" or "high"'):
        mean_ranks(df, **RM, best="higher")


def test_nemenyi_by_hand(ratings):
    table = friedman_nemenyi(ratings, **RM)
    ranks = ratings.groupby("rater")["score"].rank(ascending=False).groupby(ratings["method"]).mean()
    row = table[(table["a"] == "a") & (table["b"] == "e")].iloc[0]
    assert row["diff"] == pytest.approx(ranks["a"] - ranks["e"])
    assert row["diff"] > 0
    assert row["q"] == pytest.approx(abs(row["diff"]) / np.sqrt(30 / (6 * 36)))
    assert table["reject"].tolist() == (table["p"] <= 0.05).tolist()
    assert row["p_friedman"] == friedman(ratings, **RM).loc[0, "p"]
    # At the critical difference itself p is alpha.
    from eval.stats.posthoc import studentized_range_p

    q = row["cd"] / np.sqrt(30 / (6 * 36)) * np.sqrt(2)
    assert studentized_range_p(np.array([q]), 5, np.inf)[0] == pytest.approx(0.05, abs=1e-6)


def test_bars_are_maximal():
    assert rank_groups([1.0, 1.5, 2.2, 4.0], 1.0) == [[0, 1], [1, 2]]
    assert rank_groups([4.0, 1.0, 2.2, 1.5], 1.3) == [[1, 3, 2]]
    assert rank_groups([1.0, 3.0], 1.0) == []
    assert rank_groups([2.0, 2.0, 2.0], 0.5) == [[0, 1, 2]]
    # A difference of exactly the critical one counts as told apart.
    assert rank_groups([1.0, 2.0], 1.0) == []


def test_bars_against_brute_force(rng):
    from itertools import combinations

    for _ in range(50):
        ranks, cd = rng.uniform(1, 6, size=6), rng.uniform(0.2, 4)
        alike = [
            set(members)
            for size in range(2, 7)
            for members in combinations(range(6), size)
            if np.ptp(ranks[list(members)]) < cd
        ]
        maximal = {frozenset(s) for s in alike if not any(s < other for other in alike)}
        assert {frozenset(bar) for bar in rank_groups(ranks, cd)} == maximal


def test_wilcoxon_agrees_with_scipy(ratings, rng, long):
    from scipy.stats import wilcoxon

    table = wilcoxon_holm(ratings, **RM)
    y = ratings.pivot_table(index="rater", columns="method", values="score")
    for row in table.to_dict("records"):
        oracle = wilcoxon(y[row["a"]], y[row["b"]])
        assert row["p"] == pytest.approx(oracle.pvalue)
        assert min(row["W_plus"], row["W_minus"]) == pytest.approx(oracle.statistic)
        assert row["W_plus"] + row["W_minus"] == pytest.approx(36 * 37 / 2)
    likert = long(rng.integers(1, 5, size=(30, 2)).astype(float))
    row = wilcoxon_holm(likert, **RM).iloc[0]
    y = likert.pivot_table(index="rater", columns="method", values="score")
    assert row["p"] == pytest.approx(wilcoxon(y["a"], y["b"], zero_method="pratt").pvalue)
    assert row["n_zero"] == (y["a"] == y["b"]).sum()


def test_wilcoxon_tails_and_effect(rng, long):
    df = long(rng.normal(size=(20, 2)) + np.array([4.0, 0.0]))
    up, down = (wilcoxon_holm(df, **RM, alternative=side).iloc[0] for side in ("greater", "less"))
    assert up["p"] < 0.001 < 0.99 < down["p"]
    assert up["r"] == pytest.approx(1.0)
    assert up["median_diff"] > 3.0


def test_wilcoxon_without_any_difference_and_with_one(long):
    same = wilcoxon_holm(long(np.ones((6, 2))), **RM).iloc[0]
    assert (same["p"], same["r"], same["n_zero"]) == (1.0, 0.0, 6)
    one = long([[1.0, 1.0], [1.0, 1.0], [2.0, 1.0]])
    assert 0.05 < wilcoxon_holm(one, **RM).iloc[0]["p"] <= 1.0
