"""Holm's and Shaffer's corrections: by hand, from their definitions, within families."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import stdtr

from eval.stats import holm, holm_within, shaffer
from eval.stats.correction import equal_pairs


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


def blocks(labels):
    """All ways of splitting labels into blocks."""
    if not labels:
        yield []
        return
    first, *rest = labels
    for split in blocks(rest):
        for index in range(len(split)):
            yield [*split[:index], [first, *split[index]], *split[index + 1 :]]
        yield [[first], *split]


@pytest.mark.parametrize("k", range(1, 8))
def test_numbers_of_pairs_that_can_be_equal_are_those_of_all_partitions(k):
    counted = {sum(len(block) * (len(block) - 1) // 2 for block in split) for split in blocks(list(range(k)))}
    assert set(equal_pairs(k)) == counted


def test_shaffer_by_hand():
    # Three conditions: the first test pays for 3 pairs; after one rejection only one pair can be equal.
    assert shaffer([0.012, 0.03, 0.02]) == pytest.approx([0.036, 0.036, 0.036])
    assert shaffer([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.04, 0.03])
    # Five conditions pay 10, 6, 6, 6, 6, 4, 4, 3, 2, 1 (Shaffer 1986; Garcia & Herrera 2008).
    steps = np.array([10, 6, 6, 6, 6, 4, 4, 3, 2, 1])
    p = 3.0 ** -np.arange(14.0, 4.0, -1.0)
    assert shaffer(p) == pytest.approx(np.maximum.accumulate(p * steps))


@settings(max_examples=40, deadline=None)
@given(st.lists(st.floats(0, 1), min_size=6, max_size=6), st.integers(0, 5))
def test_shaffer_is_order_free_and_between_no_correction_and_holm(p, missing):
    adjusted = shaffer(p)
    assert shaffer(p[::-1])[::-1] == pytest.approx(adjusted)
    assert (adjusted >= np.asarray(p)).all() and (adjusted <= holm(p) + 1e-15).all()
    holes = np.array(p)
    holes[missing] = np.nan
    assert np.isnan(shaffer(holes)).sum() == 1
    assert (shaffer(holes)[~np.isnan(holes)] <= holm(holes)[~np.isnan(holes)] + 1e-15).all()


def test_shaffer_holds_the_familywise_error_where_blocks_are_equal():
    # Two blocks of equal means far apart: what Shaffer counts on. Any rejection within a block is an error.
    rng = np.random.default_rng(4)
    first, second = np.triu_indices(4, 1)
    null = (first // 2) == (second // 2)
    wrong = {"shaffer": 0, "holm": 0}
    for _ in range(400):
        y = rng.normal(size=(20, 4)) + np.array([0.0, 0.0, 5.0, 5.0])
        d = y[:, first] - y[:, second]
        t = d.mean(axis=0) / (d.std(axis=0, ddof=1) / np.sqrt(20))
        p = 2.0 * stdtr(19, -np.abs(t))
        wrong["shaffer"] += bool((shaffer(p)[null] <= 0.05).any())
        wrong["holm"] += bool((holm(p)[null] <= 0.05).any())
    # Four pairs are rejected at once; then both procedures pay for the two left.
    assert wrong["shaffer"] == wrong["holm"]
    assert 400 * 0.02 <= wrong["shaffer"] <= 400 * 0.0875


def test_shaffer_is_for_all_pairs():
    with pytest.raises(ValueError, match="4 tests are no such family"):
        shaffer([0.1] * 4)
    with pytest.raises(ValueError, match=r"lie in \[0, 1\]"):
        shaffer([0.1, 0.2, 2.0])
