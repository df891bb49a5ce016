"""Dynamic time warping against a direct dynamic programme and against every path there is."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.errors import ContractError
from benchmark.motion import dtw as module
from benchmark.motion.dtw import Alignment, dtw, dtw_from_costs


def in_band(i: int, j: int, n: int, m: int, band: float | None) -> bool:
    if band is None or n == 1 or m == 1:
        return True
    along = abs(i * (m - 1) / (n - 1) - j) if m >= n else abs(j * (n - 1) / (m - 1) - i)
    return along <= band * max(n, m) + 1e-9


def oracle(costs: np.ndarray, band: float | None = None) -> float:
    """Cheapest total cost by the textbook recurrence, cell by cell."""
    n, m = costs.shape
    total = np.full((n + 1, m + 1), np.inf)
    total[0, 0] = 0.0
    for i in range(n):
        for j in range(m):
            if in_band(i, j, n, m, band):
                total[i + 1, j + 1] = costs[i, j] + min(total[i, j], total[i, j + 1], total[i + 1, j])
    return float(total[n, m])


def all_paths(n: int, m: int):
    """Every monotone path, by recursion."""
    if n == 1 and m == 1:
        yield [(0, 0)]
        return
    for a, b in ((n - 1, m - 1), (n - 1, m), (n, m - 1)):
        if a >= 1 and b >= 1:
            for path in all_paths(a, b):
                yield [*path, (n - 1, m - 1)]


def pair_costs(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return ((x[:, None] - y[None]) ** 2).sum(axis=-1)


def check_path(alignment: Alignment, n: int, m: int) -> None:
    path = alignment.path
    assert path.dtype == np.int64
    assert path[0].tolist() == [0, 0]
    assert path[-1].tolist() == [n - 1, m - 1]
    steps = {tuple(step) for step in np.diff(path, axis=0).tolist()}
    assert steps <= {(1, 0), (0, 1), (1, 1)}


sizes = st.integers(1, 75)
seeds = st.integers(0, 2**32 - 1)


@settings(max_examples=80, deadline=None)
@given(n=sizes, m=sizes, seed=seeds)
def test_total_is_that_of_the_direct_recurrence_for_any_size(n, m, seed):
    costs = np.random.default_rng(seed).exponential(size=(n, m))
    before = costs.copy()
    alignment = dtw_from_costs(costs)
    check_path(alignment, n, m)
    np.testing.assert_array_equal(costs, before)
    assert alignment.cost == pytest.approx(oracle(costs), rel=1e-12)
    assert alignment.cost == pytest.approx(sum(costs[i, j] for i, j in alignment.path), rel=1e-12)


@settings(max_examples=60, deadline=None)
@given(n=sizes, m=sizes, seed=seeds, band=st.sampled_from([0.0, 0.02, 0.05, 0.1, 0.3, 0.7, 1.0]))
def test_banded_total_is_that_of_the_direct_recurrence(n, m, seed, band):
    costs = np.random.default_rng(seed).exponential(size=(n, m))
    expected = oracle(costs, band)
    if np.isinf(expected):
        with pytest.raises(ContractError, match="widen"):
            dtw_from_costs(costs, band=band)
        return
    alignment = dtw_from_costs(costs, band=band)
    check_path(alignment, n, m)
    assert all(in_band(int(i), int(j), n, m, band) for i, j in alignment.path)
    assert alignment.cost == pytest.approx(expected, rel=1e-12)


@settings(max_examples=30, deadline=None)
@given(n=st.integers(1, 5), m=st.integers(1, 5), seed=seeds)
def test_no_path_at_all_is_cheaper(n, m, seed):
    costs = np.random.default_rng(seed).normal(size=(n, m))
    cheapest = min(sum(costs[i, j] for i, j in path) for path in all_paths(n, m))
    assert dtw_from_costs(costs).cost == pytest.approx(cheapest, abs=1e-12)


@settings(max_examples=40, deadline=None)
@given(n=sizes, m=sizes, d=st.integers(1, 7), seed=seeds, offset=st.sampled_from([0.0, 1e4]))
def test_squared_euclidean_frames(n, m, d, seed, offset):
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=(n, d)) + offset, rng.normal(size=(m, d)) + offset
    alignment = dtw(x, y)
    check_path(alignment, n, m)
    costs = pair_costs(x, y)
    assert alignment.cost == pytest.approx(oracle(costs), rel=1e-10)
    assert alignment.cost == pytest.approx(costs[tuple(alignment.path.T)].sum(), rel=1e-12)
    assert alignment.mean_cost == pytest.approx(costs[tuple(alignment.path.T)].mean(), rel=1e-12)


@pytest.mark.parametrize("diagonals", [1, 2, 7, 400])
def test_the_blocking_does_not_matter(rng, monkeypatch, diagonals):
    costs = rng.exponential(size=(90, 61))
    expected = dtw_from_costs(costs)
    monkeypatch.setattr(module, "_DIAGONALS", diagonals)
    monkeypatch.setattr(module, "_STRIP", 64)
    np.testing.assert_array_equal(dtw_from_costs(costs).path, expected.path)


def test_the_cost_matrix_is_the_same_in_strips(rng, monkeypatch):
    x, y = rng.normal(size=(200, 5)), rng.normal(size=(150, 5))
    monkeypatch.setattr(module, "_STRIP", 1)
    assert dtw(x, y).cost == pytest.approx(oracle(pair_costs(x, y)), rel=1e-12)


def test_a_sequence_matches_itself_frame_by_frame_at_no_cost(rng):
    x = np.cumsum(rng.normal(size=(130, 6)), axis=0) + 50.0
    alignment = dtw(x, x)
    assert alignment.cost == 0.0
    np.testing.assert_array_equal(alignment.path, np.repeat(np.arange(130)[:, None], 2, axis=1))
    np.testing.assert_array_equal(alignment.warp(), np.arange(130))


def test_constant_sequences_take_the_shortest_path():
    alignment = dtw(np.full((40, 3), 2.5), np.full((25, 3), 2.5))
    assert alignment.cost == 0.0
    assert len(alignment.path) == 40
    check_path(alignment, 40, 25)


def test_exchanging_the_sequences_keeps_the_cost(rng):
    x, y = rng.normal(size=(70, 4)), rng.normal(size=(55, 4))
    there, back = dtw(x, y), dtw(y, x)
    assert there.cost == pytest.approx(back.cost, rel=1e-12)
    np.testing.assert_array_equal(there.swapped.path, back.path)


def test_a_band_as_wide_as_the_sequences_changes_nothing(rng):
    x, y = rng.normal(size=(60, 4)), rng.normal(size=(47, 4))
    np.testing.assert_array_equal(dtw(x, y, band=1.0).path, dtw(x, y).path)


def test_a_zero_band_on_equal_lengths_is_the_diagonal(rng):
    x, y = rng.normal(size=(33, 2)), rng.normal(size=(33, 2))
    alignment = dtw(x, y, band=0.0)
    np.testing.assert_array_equal(alignment.path, np.repeat(np.arange(33)[:, None], 2, axis=1))
    assert alignment.cost == pytest.approx(((x - y) ** 2).sum())


def test_a_band_without_a_path_is_refused(rng):
    with pytest.raises(ContractError, match=r"band of 0 between 3 and 9 frames"):
        dtw(rng.normal(size=(3, 2)), rng.normal(size=(9, 2)), band=0.0)


def test_warp_recovers_a_known_time_map(rng):
    x = np.cumsum(rng.normal(size=(80, 8)), axis=0)
    times = np.sort(np.concatenate([np.arange(80), rng.integers(0, 80, 40)]))
    alignment = dtw(x[times], x)
    assert alignment.cost == 0.0
    np.testing.assert_array_equal(alignment.warp(), times)
    # Each frame of x is matched by all its repetitions: their mean index.
    np.testing.assert_allclose(alignment.swapped.warp(), [np.flatnonzero(times == i).mean() for i in range(80)])


def test_the_path_is_read_only(rng):
    with pytest.raises(ValueError, match="read-only"):
        dtw(rng.normal(size=(4, 1)), rng.normal(size=(4, 1))).path[0] = 3


@pytest.mark.parametrize(
    ("x", "y", "message"),
    [
        (np.zeros((0, 3)), np.zeros((4, 3)), "x must be"),
        (np.zeros((4, 3)), np.zeros((4, 0)), "y must be"),
        (np.zeros(4), np.zeros((4, 1)), "x must be"),
        (np.zeros((4, 3)), np.zeros((4, 2)), "3 values and those of y 2"),
        (np.array([[0.0], [np.nan]]), np.zeros((2, 1)), r"x holds nan at index \(1, 0\)"),
        (np.zeros((2, 1)), np.array([[np.inf], [1.0]]), r"y holds inf at index \(0, 0\)"),
    ],
)
def test_unusable_input_is_named(x, y, message):
    with pytest.raises(ContractError, match=message):
        dtw(x, y)


def test_costs_that_are_not_finite_are_refused():
    with pytest.raises(ContractError, match="costs holds nan"):
        dtw_from_costs(np.array([[0.0, np.nan]]))


@pytest.mark.parametrize("band", [-0.1, np.nan, np.inf])
def test_a_senseless_band_is_refused(band):
    with pytest.raises(ContractError, match="band must be"):
        dtw(np.zeros((3, 1)), np.zeros((3, 1)), band=band)
