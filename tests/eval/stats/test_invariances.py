"""What no analysis may depend on: the order of rows, the names of raters, the origin and unit of the scale."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eval.stats import friedman_nemenyi, holm_paired, rm_anova, tukey_hsd_within, wilcoxon_holm

RM = {"subject": "rater", "within": "method", "value": "score"}
FUNCTIONS = [rm_anova, holm_paired, tukey_hsd_within, friedman_nemenyi, wilcoxon_holm]
#: Columns that carry the unit of the scores, and its square.
UNIT = {"diff", "low", "high", "low_simultaneous", "high_simultaneous", "median_diff"}
SQUARED = {"SS", "MS", "SS_err", "MS_err"}

# Coarse values: ranks must survive a change of scale exactly.
matrices = st.integers(0, 10_000).map(
    lambda seed: np.random.default_rng(seed).integers(0, 1000, size=(14 + seed % 7, 3 + seed % 2)) / 64.0
)


def melt(y, names=None, levels="abcde") -> pd.DataFrame:
    names = [f"r{i:02d}" for i in range(len(y))] if names is None else names
    rows = [(names[i], levels[j], y[i, j]) for i in range(len(y)) for j in range(y.shape[1])]
    return pd.DataFrame(rows, columns=["rater", "method", "score"])


def numbers(table: pd.DataFrame) -> dict[str, np.ndarray]:
    return {name: table[name].to_numpy(dtype=float) for name in table.select_dtypes("number")}


@pytest.mark.parametrize("function", FUNCTIONS, ids=lambda f: f.__name__)
@settings(max_examples=5, deadline=None)
@given(y=matrices, seed=st.integers(0, 100))
def test_row_order_and_names_of_raters(function, y, seed):
    expected = numbers(function(melt(y), **RM))
    shuffled = melt(y).sample(frac=1.0, random_state=seed)
    renamed = melt(y, names=np.random.default_rng(seed).permutation(len(y)).tolist())
    for other in (shuffled, renamed):
        found = numbers(function(other, **RM))
        for name, value in expected.items():
            assert found[name] == pytest.approx(value, rel=1e-6, abs=1e-9, nan_ok=True), name


@pytest.mark.parametrize("function", FUNCTIONS, ids=lambda f: f.__name__)
@settings(max_examples=5, deadline=None)
@given(y=matrices, shift=st.integers(-64, 64), scale=st.sampled_from([0.25, 2.0, 1024.0]))
def test_origin_and_unit_of_the_scale(function, y, shift, scale):
    expected = numbers(function(melt(y), **RM))
    found = numbers(function(melt(scale * y + shift), **RM))
    for name, value in expected.items():
        factor = scale if name in UNIT and "mean_rank_a" not in expected else scale**2 if name in SQUARED else 1.0
        assert found[name] == pytest.approx(value * factor, rel=1e-6, abs=1e-9, nan_ok=True), name


@pytest.mark.parametrize("function", FUNCTIONS[1:], ids=lambda f: f.__name__)
@settings(max_examples=5, deadline=None)
@given(y=matrices)
def test_renaming_conditions_moves_rows_and_nothing_else(function, y):
    k = y.shape[1]
    back = "abcde"[:k][::-1]
    expected = function(melt(y), **RM).set_index(["a", "b"])
    found = function(melt(y, levels=back), **RM).set_index(["a", "b"])
    name = dict(zip("abcde", back, strict=False))
    for (a, b), row in expected.iterrows():
        # Names run backwards, so the pair comes out turned around.
        other = found.loc[(name[b], name[a])]
        assert other["p"] == pytest.approx(row["p"], rel=1e-6, abs=1e-12)
        column = "median_diff" if "median_diff" in expected else "diff"
        assert other[column] == pytest.approx(-row[column], abs=1e-9)
        assert other["reject"] == row["reject"]


@settings(max_examples=10, deadline=None)
@given(y=matrices)
def test_sphericity_bounds_hold(y):
    row = rm_anova(melt(y), **RM).iloc[0]
    assert row["eps_lb"] - 1e-12 <= row["eps_gg"] <= row["eps_hf"] + 1e-12 <= 1.0 + 2e-12
    if row["F"] > 1.5:
        # Fewer degrees of freedom, larger p.
        assert row["p"] <= row["p_hf"] * (1 + 1e-9)
        assert row["p_hf"] <= row["p_gg"] * (1 + 1e-9)
        assert row["p_gg"] <= row["p_lb"] * (1 + 1e-9)
