"""Post hoc tests against references, closed forms and other implementations; each tail the right way round."""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from eval.stats import holm_paired, tukey_hsd_between, tukey_hsd_within
from eval.stats.posthoc import studentized_range_p, studentized_range_quantile

RM = {"subject": "rater", "within": "method", "value": "score"}
REFERENCE = Path(str(find_spec("scipy").origin)).parent / "stats/tests/data/studentized_range_mpmath_ref.json"


@pytest.mark.skipif(not REFERENCE.exists(), reason="this build of SciPy comes without its reference values")
def test_studentised_range_against_high_precision_values():
    cases = json.loads(REFERENCE.read_text())["cdf_data"]
    assert len(cases) > 20
    for case in cases:
        at = case["src_case"]
        p = studentized_range_p(np.array([at["q"]]), at["k"], at["v"])[0]
        assert 1.0 - p == pytest.approx(case["mp_result"], rel=max(at["expected_rtol"], 1e-9), abs=1e-9)
    assert studentized_range_p(np.array([np.inf, np.nan]), 3, 10)[0] == 0.0


def test_quantiles_of_printed_tables():
    # Any table of the studentised range at 5 %.
    for k, df, printed in [(3, 10, 3.88), (5, 60, 3.98), (4, 20, 3.96), (5, np.inf, 3.86)]:
        assert studentized_range_quantile(0.95, k, df) == pytest.approx(printed, abs=0.005)


def test_between_agrees_with_scipy(rng):
    from scipy.stats import tukey_hsd

    groups = [rng.normal(m, 1, size=n) for m, n in [(0, 12), (0.8, 15), (2, 9)]]
    df = pd.DataFrame([(name, v) for name, g in zip("xyz", groups, strict=True) for v in g], columns=["g", "v"])
    df.loc[len(df)] = ["x", np.nan]
    table = tukey_hsd_between(df, group="g", value="v")
    oracle = tukey_hsd(*groups)
    interval = oracle.confidence_interval(0.95)
    for row in table.to_dict("records"):
        i, j = "xyz".index(row["a"]), "xyz".index(row["b"])
        assert row["diff"] == pytest.approx(groups[i].mean() - groups[j].mean())
        assert row["p"] == pytest.approx(oracle.pvalue[i, j], abs=1e-4)
        assert (row["low"], row["high"]) == pytest.approx((interval.low[i, j], interval.high[i, j]), abs=1e-3)
        assert row["reject"] == (row["p"] <= 0.05)


def test_within_uses_the_error_of_subject_by_condition(ratings):
    table = tukey_hsd_within(ratings, **RM)
    y = ratings.pivot_table(index="rater", columns="method", values="score")
    residual = y.sub(y.mean(axis=1), axis=0).sub(y.mean(axis=0), axis=1) + y.to_numpy().mean()
    mse = (residual.to_numpy() ** 2).sum() / (35 * 4)
    row = table[(table["a"] == "a") & (table["b"] == "e")].iloc[0]
    assert row["diff"] == pytest.approx(y["a"].mean() - y["e"].mean())
    assert row["q"] == pytest.approx(abs(row["diff"]) / np.sqrt(mse / 36))
    assert row["df"] == 140
    assert row["p"] == pytest.approx(studentized_range_p(np.array([row["q"]]), 5, 140)[0])
    half = studentized_range_quantile(0.95, 5, 140.0) * np.sqrt(mse / 36)
    assert (row["low"], row["high"]) == pytest.approx((row["diff"] - half, row["diff"] + half))
    # An interval excludes 0 exactly where p is at most alpha.
    assert ((table["low"] > 0) | (table["high"] < 0)).tolist() == table["reject"].tolist()


def test_within_for_two_conditions_is_the_paired_t_test(ratings):
    two = ratings[ratings["method"].isin(["a", "e"])]
    within = tukey_hsd_within(two, **RM).iloc[0]
    paired = holm_paired(two, **RM).iloc[0]
    assert within["p"] == pytest.approx(paired["p"], abs=1e-9)
    assert within["q"] == pytest.approx(np.sqrt(2) * abs(paired["t"]))
    assert (within["low"], within["high"]) == pytest.approx((paired["low"], paired["high"]), rel=1e-6)


def test_subjects_hide_differences_only_from_the_test_between_groups(rng, long):
    y = 3.0 * rng.normal(size=(36, 1)) + 0.3 * rng.normal(size=(36, 3)) + np.array([0.0, 0.3, 0.6])
    assert tukey_hsd_within(long(y), **RM)["reject"].all()
    assert not tukey_hsd_between(long(y), group="method", value="score")["reject"].any()


def test_paired_t_agrees_with_scipy_and_holm_is_stepwise(ratings):
    from scipy.stats import ttest_rel
    from statsmodels.stats.multitest import multipletests

    table = holm_paired(ratings, **RM)
    y = ratings.pivot_table(index="rater", columns="method", values="score")
    for row in table.to_dict("records"):
        oracle = ttest_rel(y[row["a"]], y[row["b"]])
        assert (row["t"], row["p"]) == pytest.approx((oracle.statistic, oracle.pvalue))
        interval = oracle.confidence_interval(0.95)
        assert (row["low"], row["high"]) == pytest.approx((interval.low, interval.high))
        joint = oracle.confidence_interval(1 - 0.05 / 10)
        assert (row["low_simultaneous"], row["high_simultaneous"]) == pytest.approx((joint.low, joint.high))
        assert row["dz"] == pytest.approx(row["t"] / 6.0)
    assert table["p_holm"].to_numpy() == pytest.approx(multipletests(table["p"], method="holm")[1])
    assert table["n"].tolist() == [36] * 10


def test_one_sided_tests_look_at_the_named_side(rng, long):
    # Condition a lies above b by far: "greater" means a > b.
    df = long(rng.normal(size=(20, 2)) + np.array([3.0, 0.0]))
    assert holm_paired(df, **RM, alternative="greater")["p"].iloc[0] < 1e-4
    assert holm_paired(df, **RM, alternative="less")["p"].iloc[0] > 0.999
    assert holm_paired(df, **RM, alternative="greater", pairs=[("b", "a")])["p"].iloc[0] > 0.999
    assert holm_paired(df, **RM, pairs=[("b", "a")])["diff"].iloc[0] < -1.0


def test_a_declared_family_is_smaller_than_all_pairs(ratings):
    all_pairs = holm_paired(ratings, **RM).set_index(["a", "b"])
    family = holm_paired(ratings, **RM, pairs=[("a", "b"), ("a", "e")]).set_index(["a", "b"])
    assert family.loc[("a", "b"), "p"] == all_pairs.loc[("a", "b"), "p"]
    assert family.loc[("a", "b"), "p_holm"] == family.loc[("a", "b"), "p"]
    with pytest.raises(ValueError, match=r"\(a, z\) is no pair"):
        holm_paired(ratings, **RM, pairs=[("a", "z")])
    with pytest.raises(ValueError, match="alternative must be one of"):
        holm_paired(ratings, **RM, alternative="bigger")


def test_equal_and_constantly_shifted_conditions(long):
    y = np.arange(12.0).reshape(6, 2)
    y[:, 1] = y[:, 0]
    same = holm_paired(long(y), **RM).iloc[0]
    assert np.isnan(same["t"])
    assert (same["p"], same["reject"]) == (1.0, False)
    assert np.isnan(same["dz"])
    y[:, 1] += 0.1
    shifted = holm_paired(long(y), **RM).iloc[0]
    assert (shifted["t"], shifted["p"]) == (-np.inf, 0.0)
    flat = tukey_hsd_within(long(np.ones((4, 3))), **RM)
    assert flat["p"].isna().all()
    assert not flat["reject"].any()
