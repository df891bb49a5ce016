"""Which clips are nearest, against warping every one of them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.motion import dtw as warping
from methods.holden import exemplars
from methods.holden.exemplars import nearest


def everyone(query: np.ndarray, candidates: list[np.ndarray], count: int) -> list[tuple[int, float]]:
    costs = [warping.dtw(query, candidate).mean_cost for candidate in candidates]
    return [(int(index), float(costs[index])) for index in np.argsort(costs, kind="stable")[:count]]


def smooth(draws: np.random.Generator, frames: int) -> np.ndarray:
    return np.cumsum(draws.normal(size=(frames, 4)), axis=0)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    frames=st.integers(1, 20),
    count=st.integers(1, 6),
    cells=st.sampled_from([1, 3000, 10**6]),
)
def test_the_nearest_are_those_of_warping_everyone(seed: int, frames: int, count: int, cells: int) -> None:
    draws = np.random.default_rng(seed)
    query = smooth(draws, frames)
    candidates = [smooth(draws, int(draws.integers(1, 25))) for _ in range(int(draws.integers(1, 9)))]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(exemplars, "_CELLS", cells)
        assert nearest(query, candidates, count) == everyone(query, candidates, count)


def test_frames_that_repeat_leave_paths_of_many_lengths() -> None:
    """A figure that stands still: costs tie, and paths of the same total have other lengths."""
    draws = np.random.default_rng(0)
    query = np.repeat(smooth(draws, 4), [5, 1, 7, 2], axis=0)
    candidates = [
        np.repeat(query[[0, 7, 14]] + draws.normal(size=4), draws.integers(1, 9, 3), axis=0) for _ in range(8)
    ]
    candidates += [query, query[::2], candidates[0]]
    assert nearest(query, candidates, 4) == everyone(query, candidates, 4)
    assert nearest(query, candidates, 1) == [(8, 0.0)]
    # Copies tie, and the first of them counts.
    assert [number for number, _ in nearest(query, [candidates[0], candidates[1], candidates[0]], 3)].index(0) < 2


def test_far_candidates_are_not_warped(monkeypatch: pytest.MonkeyPatch) -> None:
    draws = np.random.default_rng(1)
    query = smooth(draws, 15)
    candidates = [query + offset for offset in np.linspace(5.0, 0.1, 10)]
    warped = []
    monkeypatch.setattr(warping, "dtw", lambda x, y, real=warping.dtw: warped.append(y) or real(x, y))
    assert [number for number, _ in nearest(query, candidates, 2)] == [9, 8]
    assert len(warped) == 2
