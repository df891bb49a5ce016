"""Far out in the tails scipy's noncentral distributions give NaN; effect sizes, intervals and power must not."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from eval.stats import dz, eta_p2_interval, smallest_dz, tukey_hsd_between


@pytest.mark.parametrize(("F", "df1", "df2"), [(50.9, 8, 304), (80.0, 8, 304), (6873.3, 3, 441), (1e5, 4, 140)])
def test_the_interval_of_a_large_effect_holds_its_estimate(F, df1, df2):
    low, high = eta_p2_interval(F, df1, df2)
    assert 0.0 < low < F * df1 / (F * df1 + df2) < high < 1.0


def test_the_smallest_effect_found_falls_with_the_raters_for_any_number_of_contrasts():
    for contrasts in (1, 10, 36):
        found = [smallest_dz(n=n, alpha=0.05 / contrasts) for n in range(3, 40)]
        assert np.isfinite(found).all() and (np.diff(found) < 0).all()


@pytest.mark.parametrize("mean", [1.0, 10.0, 100.0])
@pytest.mark.parametrize("n", [3, 12, 36])
def test_the_interval_of_a_large_difference_holds_its_estimate(mean, n):
    low, high = (size := dz(np.random.default_rng(n).normal(mean, 1.0, n))).low, size.high
    assert low < size.estimate < high


def test_without_any_variance_tukey_rejects_nothing_and_does_not_warn():
    table = tukey_hsd_between(pd.DataFrame({"g": list("aabbcc"), "v": [4.0] * 6}), group="g", value="v")
    assert not table["reject"].any() and (table["diff"] == 0).all()
