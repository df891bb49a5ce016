"""Sphericity corrections against definitions and bounds."""

from __future__ import annotations

import numpy as np
import pytest

from eval.stats import mauchly
from eval.stats.sphericity import helmert


@pytest.mark.parametrize("k", [2, 3, 7])
def test_contrasts_are_orthonormal_and_orthogonal_to_the_mean(k):
    matrix = helmert(k)
    assert matrix.T @ matrix == pytest.approx(np.eye(k - 1))
    assert matrix.sum(axis=0) == pytest.approx(np.zeros(k - 1))


def test_epsilon_agrees_with_the_double_centred_covariance(rng):
    y = rng.normal(size=(20, 5)) * np.array([1, 1, 2, 3, 1])
    s = np.cov(y.T)
    centre = np.eye(5) - 0.2
    double = centre @ s @ centre
    # Box's form: no contrasts at all.
    assert mauchly(y).eps_gg == pytest.approx(np.trace(double) ** 2 / (4 * np.sum(double**2)))


def test_bounds(rng):
    shape = mauchly(rng.normal(size=(2000, 4)))
    assert 0.99 < shape.eps_gg <= shape.eps_hf <= 1.0
    assert shape.p > 0.01
    # One condition alone varies: one direction carries all the variance, the worst case.
    y = np.zeros((30, 4)) + rng.normal(size=(30, 1))
    y[:, 0] += rng.normal(size=30)
    worst = mauchly(y + 1e-9 * rng.normal(size=y.shape))
    assert worst.eps_gg == pytest.approx(1 / 3, abs=1e-6)
    assert worst.eps_hf == pytest.approx(1 / 3, abs=1e-6)
    assert worst.p < 1e-12


def test_mauchly_has_its_nominal_size_under_sphericity(rng):
    p = np.array([mauchly(rng.normal(size=(36, 5))).p for _ in range(600)])
    assert 0.03 < np.mean(p < 0.05) < 0.075
    assert 0.44 < p.mean() < 0.56


def test_undefined_with_fewer_subjects_than_contrasts(rng):
    shape = mauchly(rng.normal(size=(4, 6)))
    assert np.isnan(shape.W)
    assert np.isnan(shape.p)
    assert 0.2 <= shape.eps_gg <= 1.0


def test_refusals(rng):
    with pytest.raises(ValueError, match="at least 2 conditions"):
        mauchly(np.ones((5, 1)))
    with pytest.raises(ValueError, match="finite"):
        mauchly([[1.0, np.nan], [1.0, 2.0]])
    with pytest.raises(ValueError, match="3 group labels for 5 subjects"):
        mauchly(rng.normal(size=(5, 3)), groups=[0, 0, 1])
    with pytest.raises(ValueError, match="no error term"):
        mauchly(rng.normal(size=(2, 3)), groups=[0, 1])
