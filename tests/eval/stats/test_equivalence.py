"""Equivalence tests by hand, against statsmodels, and their error rates at the margin."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from eval.stats import tost_paired, tost_pigeonhole, tost_proportions

RM = {"subject": "rater", "within": "method", "value": "score"}


def test_paired_by_hand(long):
    # Differences 1, 2, 3: mean 2, standard error 1 / sqrt(3); margin 4.
    y = np.array([[0.0, 1.0], [0.0, 2.0], [0.0, 3.0]])
    row = tost_paired(long(y), **RM, reference="a", margin=4.0).iloc[0]
    assert (row["a"], row["b"], row["diff"]) == ("b", "a", pytest.approx(2.0))
    assert row["t_lower"] == pytest.approx(6.0 * np.sqrt(3.0))
    assert row["t_upper"] == pytest.approx(-2.0 * np.sqrt(3.0))
    # With two degrees of freedom the tail of t is (1 - t / sqrt(2 + t^2)) / 2.
    assert row["p_lower"] == pytest.approx(0.5 * (1.0 - np.sqrt(108 / 110)))
    assert row["p_upper"] == pytest.approx(0.5 * (1.0 - np.sqrt(12 / 14)))
    assert row["p"] == row["p_upper"]
    assert bool(row["equivalent"]) is True


def test_agrees_with_statsmodels_and_with_the_interval(ratings):
    from statsmodels.stats.weightstats import ttost_paired

    table = tost_paired(ratings, **RM, reference="a", margin=0.6)
    y = ratings.pivot_table(index="rater", columns="method", values="score")
    for row in table.to_dict("records"):
        p, lower, upper = ttost_paired(y[row["a"]].to_numpy(), y["a"].to_numpy(), -0.6, 0.6)
        assert (row["p"], row["t_lower"], row["t_upper"]) == pytest.approx((p, lower[0], upper[0]))
        assert (row["p"] <= 0.05) == (row["low"] > -0.6 and row["high"] < 0.6)
    far = table.set_index("a").loc["e"]
    # Method e lies above the margin: it fails on the upper side only.
    assert far["p_upper"] > 0.9
    assert far["p_lower"] < 0.01


def test_a_margin_need_not_be_symmetric(long):
    y = np.array([[0.0, 0.9], [0.0, 1.0], [0.0, 1.1], [0.0, 1.0]])
    assert tost_paired(long(y), **RM, reference="a", margin=(-0.1, 2.0))["equivalent"].all()
    assert not tost_paired(long(y), **RM, reference="a", margin=(-2.0, 0.1))["equivalent"].any()
    with pytest.raises(ValueError, match="margin must be positive"):
        tost_paired(long(y), **RM, reference="a", margin=-1.0)
    with pytest.raises(ValueError, match="no level z"):
        tost_paired(long(y), **RM, reference="z", margin=1.0)


def test_no_variance(long):
    y = np.tile([0.0, 1.0], (4, 1))
    assert tost_paired(long(y), **RM, reference="a", margin=1.5).iloc[0]["p"] == 0.0
    assert tost_paired(long(y), **RM, reference="a", margin=0.5).iloc[0]["p"] == 1.0
    # On the margin itself nothing is shown.
    assert tost_paired(long(y), **RM, reference="a", margin=1.0).iloc[0]["p"] == 0.5


def test_size_at_the_margin_is_alpha(long):
    rng = np.random.default_rng(8)
    found = [
        tost_paired(long(rng.normal(size=(30, 2)) + np.array([0, 1.5])), **RM, reference="a", margin=1.5)["equivalent"][
            0
        ]
        for _ in range(400)
    ]
    assert 0.025 <= np.mean(found) <= 0.08


def answers(**counts) -> pd.DataFrame:
    rows = [(name, int(i < yes)) for name, (yes, total) in counts.items() for i in range(total)]
    return pd.DataFrame(rows, columns=["method", "child"])


def test_proportions_use_the_estimates_under_the_margin():
    from scipy.optimize import minimize_scalar

    df = answers(child=(70, 100), ours=(66, 120))
    row = tost_proportions(df, condition="method", answer="child", reference="child", margin=0.2).iloc[0]
    assert row["diff"] == pytest.approx(0.55 - 0.7)

    def score(limit: float) -> float:
        # The most likely pair of proportions that differ by the limit.
        def loss(p: float) -> float:
            a, b = p + limit, p
            return -(66 * np.log(a) + 54 * np.log(1 - a) + 70 * np.log(b) + 30 * np.log(1 - b))

        edge = 1e-6
        p = minimize_scalar(
            loss,
            bounds=(max(0.0, -limit) + edge, min(1.0, 1.0 - limit) - edge),
            method="bounded",
            options={"xatol": 1e-10},
        ).x
        a, b = p + limit, p
        return (0.55 - 0.7 - limit) / np.sqrt(a * (1 - a) / 120 + b * (1 - b) / 100)

    assert row["z_lower"] == pytest.approx(score(-0.2), abs=1e-4)
    assert row["z_upper"] == pytest.approx(score(0.2), abs=1e-4)
    from scipy.stats import norm

    assert row["p"] == pytest.approx(norm.sf(row["z_lower"]))
    # The interval ends where one of both tests is just significant.
    from eval.stats.proportions import score_z

    assert score_z((66, 70), (120, 100), row["low"]) == pytest.approx(1.6448536)
    assert score_z((66, 70), (120, 100), row["high"]) == pytest.approx(-1.6448536)
    assert row["low"] < -0.15 < row["high"]
    assert not row["equivalent"]


def test_constrained_proportions_solve_the_cubic_of_miettinen_and_nurminen():
    from eval.stats.proportions import constrained_shares

    x1, x0, n1, n0 = 66, 70, 120, 100
    for d in (-0.2, 0.05, 0.3):
        first, second = constrained_shares((x1, x0), (n1, n0), d)
        terms = [
            n1 + n0,
            (n1 + 2 * n0) * d - n1 - n0 - x1 - x0,
            (n0 * d - n1 - n0 - 2 * x0) * d + x1 + x0,
            x0 * d * (1 - d),
        ]
        assert np.polyval(terms, second) == pytest.approx(0.0, abs=1e-9)
        assert first - second == pytest.approx(d)


@pytest.mark.parametrize("counts", [((0, 0), (10, 10)), ((10, 10), (10, 10)), ((0, 10), (10, 10)), ((10, 0), (10, 12))])
def test_proportions_at_the_ends(counts):
    from eval.stats.proportions import score_interval, score_z

    (a, b), (n, m) = counts
    low, high = score_interval((a, b), (n, m), level=0.9)
    assert -1.0 <= low <= a / n - b / m <= high <= 1.0
    assert high - low > 0.1
    assert score_z((a, b), (n, m), -0.5) >= score_z((a, b), (n, m), 0.5)


def test_published_interval():
    from eval.stats.proportions import score_interval

    # Fagerland, Lydersen & Laake (2015): 7 of 34 against 1 of 34, Miettinen-Nurminen, 95 %.
    assert score_interval((7, 1), (34, 34), level=0.95) == pytest.approx((0.028, 0.34), abs=5e-3)
    low, high = score_interval((1, 7), (34, 34), level=0.95)
    assert (-high, -low) == pytest.approx(score_interval((7, 1), (34, 34), level=0.95), abs=1e-9)


def test_coverage_of_the_score_interval():
    from scipy.stats import binom

    from eval.stats.proportions import score_z

    # Exact: all tables of 15 and 20 answers with their probabilities.
    p, q = 0.9, 0.75
    covered = sum(
        binom.pmf(i, 15, p) * binom.pmf(j, 20, q)
        for i in range(16)
        for j in range(21)
        if abs(score_z((i, j), (15, 20), p - q)) <= 1.6448536
    )
    assert covered == pytest.approx(0.9, abs=0.025)


def test_proportions_on_either_side():
    df = answers(child=(700, 1000), same=(705, 1000), more=(850, 1000), less=(550, 1000))
    table = tost_proportions(df, condition="method", answer="child", reference="child", margin=0.1).set_index("a")
    assert table["equivalent"].to_dict() == {"less": False, "more": False, "same": True}
    assert table.loc["more", "p_upper"] > 0.9 > 0.01 > table.loc["more", "p_lower"]
    assert table.loc["less", "p_lower"] > 0.9 > 0.01 > table.loc["less", "p_upper"]
    with pytest.raises(ValueError, match="must be 0 or 1"):
        tost_proportions(df.assign(child=2), condition="method", answer="child", reference="child", margin=0.1)


def test_pigeonhole_knows_equal_and_different():
    rng = np.random.default_rng(9)
    shares = {"child": 0.7, "same": 0.7, "adult": 0.2}
    rows = [
        (f"r{r}", f"{name}-{c}", name, int(rng.random() < share))
        for name, share in shares.items()
        for r in range(40)
        for c in range(10)
    ]
    df = pd.DataFrame(rows, columns=["rater", "clip", "method", "child"])
    names = {"rater": "rater", "clip": "clip", "condition": "method", "answer": "child"}
    table = tost_pigeonhole(df, **names, reference="child", margin=0.2).set_index("a")
    assert table["equivalent"].to_dict() == {"adult": False, "same": True}
    assert table.loc["adult", "p_lower"] > 0.9
    assert (table["low"] < table["diff"]).all()
    assert (table["diff"] < table["high"]).all()
