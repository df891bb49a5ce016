"""Power against published figures and against simulation."""

from __future__ import annotations

import numpy as np
import pytest

from eval.stats import power_paired, power_rm, power_table, raters_needed, smallest_dz


@pytest.mark.parametrize(
    ("f", "rho", "eps", "expected"),
    [(0.15, 0.5, 1, 0.59), (0.2, 0.5, 1, 0.86), (0.25, 0, 1, 0.76), (0.25, 0.3, 1, 0.90), (0.25, 0.5, 1, 0.98)]
    + [(0.25, 0.5, 0.7, 0.93)],
)
def test_power_of_the_design_with_36_raters(f, rho, eps, expected):
    assert power_rm(n=36, k=5, f=f, rho=rho, eps=eps) == pytest.approx(expected, abs=0.0051)


def test_power_is_reached_in_simulation():
    from scipy.special import fdtri

    rng = np.random.default_rng(4)
    n, k, rho, f = 20, 4, 0.4, 0.25
    means = np.array([-1.0, -1.0, 1.0, 1.0]) * f
    critical = fdtri(3, 57, 0.95)
    y = np.sqrt(rho) * rng.normal(size=(4000, n, 1)) + np.sqrt(1 - rho) * rng.normal(size=(4000, n, k)) + means
    residual = y - y.mean(axis=2, keepdims=True) - y.mean(axis=1, keepdims=True) + y.mean(axis=(1, 2), keepdims=True)
    ms = n * y.mean(axis=1).var(axis=1, ddof=1)
    found = (ms / ((residual**2).sum(axis=(1, 2)) / 57) > critical).mean()
    assert found == pytest.approx(power_rm(n=n, k=k, f=f, rho=rho), abs=0.02)


def test_raters_needed_is_the_least():
    n = raters_needed(k=5, f=0.2)
    assert power_rm(n=n, k=5, f=0.2) >= 0.8 > power_rm(n=n - 1, k=5, f=0.2)
    assert raters_needed(k=5, f=0.1) > n
    assert raters_needed(k=5, f=0.2, eps=0.7) > n
    with pytest.raises(ValueError, match="more than"):
        raters_needed(k=5, f=1e-4)


def test_smallest_difference_of_36_raters():
    assert smallest_dz(n=36) == pytest.approx(0.48, abs=0.005)
    assert smallest_dz(n=36, alpha=0.005) == pytest.approx(0.64, abs=0.005)
    for alternative, sign in (("greater", 1), ("less", -1)):
        d = smallest_dz(n=36, alternative=alternative)
        assert d < smallest_dz(n=36)
        assert power_paired(n=36, dz=sign * d, alternative=alternative) == pytest.approx(0.8)


def test_paired_power_agrees_with_statsmodels_and_knows_its_direction():
    from statsmodels.stats.power import TTestPower

    for n, d, alpha in [(10, 0.5, 0.05), (36, 0.3, 0.005), (12, 0.0, 0.05)]:
        expected = TTestPower().power(d, n, alpha)
        assert power_paired(n=n, dz=d, alpha=alpha) == pytest.approx(expected, abs=1e-6)
        assert power_paired(n=n, dz=-d, alpha=alpha) == pytest.approx(expected, abs=1e-6)
    assert power_paired(n=30, dz=1.0, alternative="greater") > 0.99
    assert power_paired(n=30, dz=1.0, alternative="less") < 1e-6


def test_no_effect_has_the_level_as_power():
    assert power_rm(n=10, k=3, f=0.0, alpha=0.05) == 0.05
    assert power_rm(n=10, k=3, f=1e-4) == pytest.approx(0.05, abs=1e-4)


def test_ranges():
    with pytest.raises(ValueError, match="eps must lie in"):
        power_rm(n=10, k=5, f=0.2, eps=0.1)
    with pytest.raises(ValueError, match="rho in"):
        power_rm(n=10, k=5, f=0.2, rho=1.0)


def test_table():
    table = power_table(n=(20, 36), k=5)
    assert len(table) == 2 * 5 * 2 * 2
    row = table[(table["n"] == 36) & (table["f"] == 0.2) & (table["rho"] == 0.5) & (table["eps"] == 1.0)].iloc[0]
    assert row["power"] == power_rm(n=36, k=5, f=0.2)
    assert row["smallest_dz_bonferroni"] == pytest.approx(0.64, abs=0.005)
