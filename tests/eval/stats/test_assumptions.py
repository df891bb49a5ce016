"""Each check speaks up for planted trouble, and stays quiet without."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from eval.stats import check_groups, check_rm

RM = {"subject": "rater", "within": "method", "value": "score"}


def verdicts(table: pd.DataFrame) -> dict[str, str]:
    assert table["sentence"].str.endswith(".").all()
    return dict(zip(table["check"], table["severity"], strict=True))


def test_a_clean_design_is_quiet(long):
    rng = np.random.default_rng(1)
    table = check_rm(long(rng.normal(size=(36, 5))), **RM, bounds=(-10.0, 10.0))
    assert set(verdicts(table).values()) == {"ok"}
    assert list(verdicts(table)) == [
        "balance",
        "sample size",
        "normality",
        "spread",
        "sphericity",
        "outliers",
        "ceiling",
        "floor",
    ]


def test_missing_and_duplicate_cells(ratings):
    table = check_rm(ratings.drop(index=7), **RM).set_index("check")
    assert table.loc["balance", "severity"] == "warning"
    assert "1 subjects lack a condition (r001)" in table.loc["balance", "sentence"]
    assert verdicts(check_rm(pd.concat([ratings, ratings.iloc[:2]]), **RM))["balance"] == "note"


def test_violated_sphericity_and_unequal_spread(rng, long):
    y = rng.normal(size=(36, 5)) * np.array([1, 1, 1, 1, 6])
    found = check_rm(long(y), **RM).set_index("check")
    assert found.loc["sphericity", "severity"] == "warning"
    assert found.loc["sphericity", "p"] < 1e-6
    assert found.loc["spread", "severity"] == "warning"
    assert "e spreads" in found.loc["spread", "sentence"]
    assert verdicts(check_rm(long(y[:, :2]), **RM))["sphericity"] == "ok"
    assert verdicts(check_rm(long(y[:4]), **RM))["sphericity"] == "note"


def test_skewed_residuals_outliers_and_small_samples(rng, long):
    y = rng.exponential(size=(36, 4)) ** 2
    assert verdicts(check_rm(long(y), **RM))["normality"] == "note"
    y = rng.normal(size=(12, 4))
    y[5, 2] = 40.0
    table = check_rm(long(y), **RM).set_index("check")
    assert table.loc["outliers", "severity"] == "note"
    assert "r005" in table.loc["outliers", "sentence"]
    assert table.loc["sample size", "severity"] == "warning"


def test_ceiling_and_floor_name_the_condition(rng, long):
    y = rng.integers(2, 9, size=(30, 3)) / 10.0
    y[:6, 1] = 1.0
    y[:9, 2] = 0.0
    table = check_rm(long(y), **RM, bounds=(0.0, 1.0)).set_index("check")
    assert table.loc["ceiling", "severity"] == "warning"
    assert "b (20%)" in table.loc["ceiling", "sentence"]
    assert "c (30%)" in table.loc["floor", "sentence"]
    assert "ceiling" not in set(check_rm(long(y), **RM)["check"])


def test_constant_data_break_nothing(long):
    assert "warning" not in set(check_rm(long(np.ones((25, 3))), **RM)["severity"])


def test_groups(rng):
    from scipy.stats import levene

    a, b = rng.normal(size=40), 5.0 * rng.normal(size=40)
    df = pd.DataFrame({"g": ["a"] * 40 + ["b"] * 40, "v": np.r_[a, b]})
    table = check_groups(df, group="g", value="v").set_index("check")
    assert table.loc["spread", "severity"] == "warning"
    assert table.loc["spread", "p"] == pytest.approx(levene(a, b, center="median").pvalue)
    assert check_groups(df.assign(v=np.r_[a, b / 5]), group="g", value="v")["severity"].tolist() == ["ok"] * 3
    flat = pd.DataFrame({"g": list("aabb"), "v": [1.0, 1.0, 2.0, 2.0]})
    assert check_groups(flat, group="g", value="v").set_index("check").loc["spread", "p"] == 1.0
    with pytest.raises(ValueError, match="2 groups with 2 values"):
        check_groups(df.iloc[:40], group="g", value="v")
