"""The clustered bootstrap against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from eval.stats.bootstrap import clustered_mean


def test_interval_of_independent_observations_matches_the_normal_one(rng):
    values = rng.normal(3.0, 2.0, size=400)
    result = clustered_mean(values, range(400), resamples=4000)
    half = 1.96 * values.std(ddof=1) / np.sqrt(400)
    # One observation a cluster: the second stage adds nothing.
    assert result.mean == pytest.approx(values.mean())
    assert result.high - result.mean == pytest.approx(half, rel=0.1)
    assert result.mean - result.low == pytest.approx(half, rel=0.1)


def test_clusters_widen_the_interval(rng):
    shift = rng.normal(size=8)
    values = np.repeat(shift, 25) + 0.1 * rng.normal(size=200)
    actor = np.repeat(np.arange(8), 25)
    wide = clustered_mean(values, actor)
    narrow = clustered_mean(values, range(200))
    # Variance of the mean is that of 8 draws, not of 200.
    assert (wide.high - wide.low) > 3.0 * (narrow.high - narrow.low)
    assert wide.high - wide.low == pytest.approx(2 * 1.96 * shift.std() / np.sqrt(8), rel=0.2)


def test_coverage_over_actors_is_near_nominal():
    rng = np.random.default_rng(5)
    hits = 0
    for trial in range(150):
        values = np.repeat(rng.normal(size=20), 5) + 0.5 * rng.normal(size=100)
        interval = clustered_mean(values, np.repeat(np.arange(20), 5), seed=trial, resamples=400)
        hits += interval.low <= 0.0 <= interval.high
    assert 0.86 <= hits / 150 <= 0.99


def test_missing_and_single_values():
    assert np.isnan(clustered_mean([np.nan], ["a"]).mean)
    assert clustered_mean([2.0, np.nan], ["a", "b"]) == (2.0, 2.0, 2.0)


def test_seed_decides(rng):
    values, actors = rng.normal(size=30), np.repeat(np.arange(6), 5)
    assert clustered_mean(values, actors, seed=1) == clustered_mean(values, actors, seed=1)
    assert clustered_mean(values, actors, seed=1) != clustered_mean(values, actors, seed=2)
