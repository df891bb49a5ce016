from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.errors import ContractError
from methods.hsu import time_warp as module
from methods.hsu.time_warp import Corridor, path_cost, time_warp


def cheapest(x, v, band: float | None, penalties: np.ndarray, distance: str = "squared") -> float:
    """The recurrence, cell by cell over the whole matrix; infinite where there is no path."""
    frames, last = len(x), max(len(v) - 1, 1)
    before = np.full(frames, np.inf)
    for t, target in enumerate(v):
        here = np.full(frames, np.inf)
        for i in range(frames):
            if band is not None and abs(i - t * (frames - 1) / last) > band * frames + 1e-9:
                continue
            if t == 0:
                arrival = 0.0 if i == 0 else np.inf
            else:
                arrival = min(before[i - k] + penalty for k, penalty in enumerate(penalties) if k <= i)
            local = float(((x[i] - target) ** 2).sum())
            here[i] = arrival + (local**0.5 if distance == "l2" else local)
        before = here
    return float(before[-1])


@settings(max_examples=150, deadline=None)
@given(
    frames_in=st.integers(1, 45),
    frames_out=st.integers(1, 45),
    max_skip=st.integers(1, 4),
    band=st.sampled_from([None, 0.0, 0.05, 0.1, 0.2, 0.5]),
    priced=st.booleans(),
    distance=st.sampled_from(["squared", "l2"]),
    seed=st.integers(0, 2**32 - 1),
)
def test_the_path_is_the_cheapest_of_all(frames_in, frames_out, max_skip, band, priced, distance, seed) -> None:
    rng = np.random.default_rng(seed)
    x, v = rng.normal(size=(frames_in, 2)), rng.normal(size=(frames_out, 2))
    penalties = rng.uniform(0.0, 2.0, max_skip + 1) * priced
    expected = cheapest(x, v, band, penalties, distance)
    if not np.isfinite(expected):
        with pytest.raises(ContractError, match="no time warp leads from"):
            Corridor.between(frames_in, frames_out, band=band, max_skip=max_skip)
        return
    corridor = Corridor.between(frames_in, frames_out, band=band, max_skip=max_skip)
    path = time_warp(x, v, corridor, penalties=penalties, distance=distance)
    assert path.dtype == np.int64
    assert (path[0], path[-1], len(path)) == (0, frames_in - 1, frames_out)
    assert np.isin(np.diff(path), np.arange(max_skip + 1)).all()
    if band is not None:
        line = np.linspace(0, frames_in - 1, frames_out) if frames_out > 1 else np.zeros(1)
        assert np.abs(path - line).max() <= band * frames_in + 1e-6
    assert path_cost(x, v, path, penalties=penalties, distance=distance) == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("band", [None, 0.1])
@pytest.mark.parametrize("price", [0.0, 0.3])
def test_sweeping_twice_gives_the_path_that_keeping_the_costs_gives(monkeypatch, rng, band, price) -> None:
    x = np.cumsum(rng.normal(size=(230, 4)), axis=0)
    v = x[np.sort(rng.integers(0, 230, 300))]
    corridor = Corridor.between(230, 300, band=band, max_skip=3)
    assert len(corridor.blocks()) > 3
    penalties = price * np.array([1.0, 0.0, 1.0, 2.0])
    kept = time_warp(x, v, corridor, penalties=penalties)
    monkeypatch.setattr(module, "KEPT_CELLS", 0)
    np.testing.assert_array_equal(time_warp(x, v, corridor, penalties=penalties), kept)


@settings(max_examples=80, deadline=None)
@given(
    frames_in=st.integers(1, 25),
    frames_out=st.integers(1, 25),
    max_skip=st.integers(1, 3),
    band=st.sampled_from([None, 0.05, 0.15, 0.4]),
)
def test_every_cell_of_a_corridor_lies_on_a_path_and_no_other_does(frames_in, frames_out, max_skip, band) -> None:
    last = max(frames_out - 1, 1)
    inside = np.ones((frames_out, frames_in), dtype=bool)
    if band is not None:
        t, i = np.ogrid[:frames_out, :frames_in]
        inside = np.abs(i - t * (frames_in - 1) / last) <= band * frames_in + 1e-9

    def reachable(inside: np.ndarray) -> np.ndarray:
        found = np.zeros_like(inside)
        found[0, 0] = inside[0, 0]
        for t in range(1, frames_out):
            for i in range(frames_in):
                found[t, i] = inside[t, i] and found[t - 1, max(0, i - max_skip) : i + 1].any()
        return found

    on_a_path = reachable(inside) & reachable(inside[::-1, ::-1])[::-1, ::-1]
    if not on_a_path.any():
        with pytest.raises(ContractError):
            Corridor.between(frames_in, frames_out, band=band, max_skip=max_skip)
        return
    corridor = Corridor.between(frames_in, frames_out, band=band, max_skip=max_skip)
    i = np.arange(frames_in)
    marked = (i >= corridor.start[:, np.newaxis]) & (i < corridor.stop[:, np.newaxis])
    np.testing.assert_array_equal(marked, on_a_path)
    assert corridor.cells == on_a_path.sum()


def test_deleted_and_repeated_frames_are_found(rng) -> None:
    x = np.cumsum(rng.normal(size=(60, 3)), axis=0)
    path = np.concatenate([np.arange(10), np.arange(12, 30), [30] * 6, np.arange(33, 60)])
    corridor = Corridor.between(60, len(path), band=None, max_skip=3)
    np.testing.assert_array_equal(time_warp(x, x[path], corridor), path)


def test_a_skip_of_one_only_repeats(rng) -> None:
    x, v = rng.normal(size=(20, 3)), rng.normal(size=(33, 3))
    path = time_warp(x, v, Corridor.between(20, 33, band=None, max_skip=1))
    np.testing.assert_array_equal(np.unique(path), np.arange(20))
    with pytest.raises(ContractError, match="lengthen the output"):
        Corridor.between(33, 20, band=None, max_skip=1)


def test_equally_cheap_paths_prefer_the_normal_pace() -> None:
    still = np.ones((12, 2))
    path = time_warp(still, still, Corridor.between(12, 12, band=None, max_skip=3))
    np.testing.assert_array_equal(path, np.arange(12))


def test_a_price_makes_the_path_straighter(rng) -> None:
    x, v = rng.normal(size=(50, 2)), rng.normal(size=(60, 2))
    corridor = Corridor.between(50, 60, band=None, max_skip=3)
    price = np.array([1.0, 0.0, 1.0, 2.0])
    uneven = [
        float(price[np.diff(time_warp(x, v, corridor, penalties=factor * price))].sum()) for factor in (0.0, 1.0, 1e4)
    ]
    assert uneven[0] > uneven[1] > uneven[2]
    # Nothing is left but the ten repetitions that the lengths demand.
    assert uneven[2] == 10.0


def test_plain_distances_take_another_path() -> None:
    x, v = np.array([[1.0], [0.0], [2.0], [2.0]]), np.array([[0.0], [4.0], [0.0], [4.0]])
    corridor = Corridor.between(4, 4, band=None, max_skip=3)
    # Errors 1 2 2 2 beside 1 3 0 2: sums of squares 13 and 14, plain sums 7 and 6.
    squared, plain = time_warp(x, v, corridor), time_warp(x, v, corridor, distance="l2")
    np.testing.assert_array_equal(plain, [0, 0, 1, 3])
    assert (path_cost(x, v, squared), path_cost(x, v, plain)) == (13.0, 14.0)
    assert (path_cost(x, v, squared, distance="l2"), path_cost(x, v, plain, distance="l2")) == (7.0, 6.0)


def peak(frames: int, band: float) -> int:
    t = np.linspace(0.0, 40.0, frames)
    x = np.stack([np.sin(t), np.cos(t)], axis=1)
    tracemalloc.start()
    try:
        time_warp(x, x, Corridor.between(frames, frames, band=band, max_skip=3))
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_memory_grows_with_the_band_and_not_with_the_square() -> None:
    # Costs of all pairs would be 8 bytes for each; not even one byte for each is taken.
    assert peak(4000, 0.02) < 4000 * 4000 / 2
    # The same half-width in frames: twice the length, twice the memory.
    assert peak(8000, 0.01) < 2.5 * peak(4000, 0.02)


def test_long_alignments_are_swept_twice_in_less_memory(monkeypatch) -> None:
    kept = peak(4000, 0.1)
    monkeypatch.setattr(module, "KEPT_CELLS", 100_000)
    assert peak(4000, 0.1) < kept / 5


@pytest.mark.parametrize(
    ("frames_in", "frames_out", "band", "max_skip", "words"),
    [
        (100, 20, None, 3, ["100 input", "20 output", "max_skip = 3", "raise max_skip"]),
        (10, 7, 0.01, 3, ["band of 0.01", "widen the band"]),
        (5, 1, None, 3, ["5 input", "1 output"]),
    ],
)
def test_an_impossible_warp_names_what_stands_in_its_way(frames_in, frames_out, band, max_skip, words) -> None:
    with pytest.raises(ContractError) as caught:
        Corridor.between(frames_in, frames_out, band=band, max_skip=max_skip)
    for word in words:
        assert word in str(caught.value)
