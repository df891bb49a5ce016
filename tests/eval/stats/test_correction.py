"""Holm's correction: by hand, from its definition, within families."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eval.stats import holm, holm_within


def test_by_hand():
    # 0.01 x 4, then max(0.04, 0.02 x 3), then 0.03 x 2 = 0.06 again, then 0.5.
    assert holm([0.5, 0.01, 0.03, 0.02]) == pytest.approx([0.5, 0.04, 0.06, 0.06])
    assert holm([0.9, 0.8]) == pytest.approx([1.0, 1.0])
    assert holm([]).shape == (0,)


def test_missing_tests_are_not_counted():
    result = holm([0.01, np.nan, 0.04])
    assert result[[0, 2]] == pytest.approx([0.02, 0.04])
    assert np.isnan(result[1])


@settings(max_examples=40, deadline=None)
@given(st.lists(st.floats(0, 1), min_size=1, max_size=12))
def test_agrees_with_its_definition_and_is_order_free(p):
    adjusted = holm(p)
    # By definition: a test is rejected at its adjusted level if those before it are, each at alpha / (tests left).
    for index, alpha in enumerate(adjusted):
        left = sorted(p)[: sorted(p).index(p[index]) + 1]
        assert alpha == pytest.approx(min(1.0, max((len(p) - at) * value for at, value in enumerate(left))))
    assert holm(p[::-1])[::-1] == pytest.approx(adjusted)
    assert (adjusted >= np.asarray(p)).all()
    # Between no correction and Bonferroni.
    assert (adjusted <= np.minimum(1.0, np.asarray(p) * len(p)) + 1e-15).all()


def test_families_are_corrected_apart():
    df = pd.DataFrame({"family": ["x", "y", "x", "y"], "p": [0.02, 0.04, 0.03, np.nan]})
    table = holm_within(df, family="family")
    assert table["p_holm"].tolist()[:3] == pytest.approx([0.04, 0.04, 0.04])
    assert table["family_size"].tolist() == [2, 1, 2, 1]
    assert table["reject"].tolist() == [True, True, True, False]
    assert holm_within(df)["p_holm"].tolist()[:3] == pytest.approx([0.06, 0.06, 0.06])
    assert "p_holm" not in df


def test_what_is_no_p_value_is_refused():
    with pytest.raises(ValueError, match=r"lie in \[0, 1\]"):
        holm([0.5, 1.2])
