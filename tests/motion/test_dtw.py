"""Dynamic time warping against a direct dynamic programme and against every path there is."""

from __future__ import annotations

import tracemalloc

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


@pytest.mark.parametrize(("n", "m", "band"), [(3, 74, 0.3), (74, 3, 0.3), (2, 75, 0.5), (5, 60, 0.15)])
def test_a_band_across_very_unequal_lengths(rng, n, m, band):
    costs = rng.exponential(size=(n, m))
    assert dtw_from_costs(costs, band=band).cost == pytest.approx(oracle(costs, band), rel=1e-12)


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


@settings(max_examples=60, deadline=None)
@given(
    n=sizes,
    m=sizes,
    seed=seeds,
    band=st.sampled_from([None, None, 0.1, 0.4]),
    diagonals=st.integers(1, 40),
    tile=st.integers(1, 9),
    batch=st.integers(1, 4),
    kept=st.sampled_from([0, 10**9]),
)
def test_the_blocking_does_not_matter(n, m, seed, band, diagonals, tile, batch, kept):
    rng = np.random.default_rng(seed)
    x, y = np.cumsum(rng.normal(size=(n, 4)), axis=0), np.cumsum(rng.normal(size=(m, 4)), axis=0)
    costs = pair_costs(x, y)
    expected = oracle(costs, band)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "_DIAGONALS", (diagonals, diagonals))
        patch.setattr(module, "_TILE", tile)
        patch.setattr(module, "_BATCH", batch)
        patch.setattr(module, "_KEPT", kept)
        for align in (lambda: dtw(x, y, band=band), lambda: dtw_from_costs(costs, band=band)):
            if np.isinf(expected):
                with pytest.raises(ContractError, match="widen"):
                    align()
                continue
            alignment = align()
            check_path(alignment, n, m)
            assert all(in_band(int(i), int(j), n, m, band) for i, j in alignment.path)
            assert alignment.cost == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize(("n", "m"), [(2100, 2000), (2700, 1600), (70, 60_000)])
def test_long_sequences_take_the_path_of_the_kept_matrix(rng, monkeypatch, n, m):
    assert n * m > module._KEPT
    times = np.sort(rng.integers(0, n, m))
    x = np.cumsum(rng.normal(size=(n, 12)), axis=0)
    y = x[times] + 0.1 * rng.normal(size=(m, 12))
    alignment = dtw(x, y)
    check_path(alignment, n, m)
    monkeypatch.setattr(module, "_KEPT", 10**9)
    np.testing.assert_array_equal(alignment.path, dtw(x, y).path)
    # The path is known but for the noise.
    assert np.abs(alignment.swapped.warp() - times).mean() < 1.0


def test_long_sequences_take_a_fraction_of_a_matrix_of_memory(rng):
    x, y = rng.normal(size=(4000, 6)), rng.normal(size=(3000, 6))
    tracemalloc.start()
    try:
        dtw(x, y)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 0.25 * 8 * len(x) * len(y)


@settings(max_examples=60, deadline=None)
@given(
    width=st.integers(1, 200), seed=seeds, scale=st.sampled_from([1e-6, 1.0, 1e6]), offset=st.sampled_from([0.0, 1e3])
)
def test_no_local_cost_is_below_zero(width, seed, scale, offset):
    rng = np.random.default_rng(seed)
    x = scale * (rng.normal(size=(17, width)) + offset)
    left, right = module._widened(x, np.concatenate([x, x * (1.0 + 1e-15)]))
    assert (left @ right.T).min() >= 0.0


@pytest.mark.parametrize("kept", [0, 10**9])
def test_standing_still_is_not_lingered_over(rng, monkeypatch, kept):
    monkeypatch.setattr(module, "_KEPT", kept)
    x = np.repeat(100.0 * rng.normal(size=(6, 20)), 30, axis=0)
    y = x[::-1][::-1].copy()
    np.testing.assert_array_equal(dtw(x, y).path, np.repeat(np.arange(180)[:, None], 2, axis=1))


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


@pytest.mark.parametrize(("n", "m"), [(1, 1), (1, 9), (2, 3), (17, 60), (80, 23), (64, 64)])
def test_where_all_costs_are_equal_the_path_is_as_short_as_can_be(n, m):
    alignment = dtw_from_costs(np.ones((n, m)))
    check_path(alignment, n, m)
    assert len(alignment.path) == max(n, m)


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


@pytest.mark.parametrize(("n", "m", "band"), [(3, 9, 0.0), (2, 40, 0.1), (40, 2, 0.1)])
def test_a_band_without_a_path_is_refused(rng, n, m, band):
    with pytest.raises(ContractError, match=rf"band of {band:g} between {n} and {m} frames"):
        dtw(rng.normal(size=(n, 2)), rng.normal(size=(m, 2)), band=band)


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


def test_distances_that_overflow_are_refused():
    with pytest.raises(ContractError, match="overflow"):
        dtw(np.array([[1e200], [0.0]]), np.array([[-1e200], [0.0]]))
    with pytest.raises(ContractError, match="more than a number can hold"):
        dtw_from_costs(np.full((3, 3), 1e308))
