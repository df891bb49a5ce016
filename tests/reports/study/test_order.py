from __future__ import annotations

from collections import Counter
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reports.study.order import make_orders, williams


@pytest.mark.parametrize("k", range(2, 13))
def test_every_condition_is_at_every_place_and_follows_every_other_equally_often(k):
    square = williams(k)
    assert len(square) == (k if k % 2 == 0 else 2 * k)
    assert all(sorted(row) == list(range(k)) for row in square.tolist())
    each = len(square) // k
    for place in range(k):
        assert Counter(square[:, place].tolist()) == dict.fromkeys(range(k), each)
    follows = Counter(pair for row in square.tolist() for pair in pairwise(row))
    assert follows == {(a, b): each for a in range(k) for b in range(k) if a != b}


def cells_of(k, clips):
    return {(f"c{a}", f"m{b}"): f"{a}-{b}" for a in range(k) for b in range(clips)}


@given(k=st.integers(2, 7), clips=st.integers(1, 6), raters=st.integers(1, 12), seed=st.integers(0, 99))
@settings(max_examples=25, deadline=None)
def test_orders(k, clips, raters, seed):
    cells = cells_of(k, clips)
    orders = make_orders(cells, raters=raters, rng=np.random.default_rng(seed))
    rows = len(williams(k))
    assert len(orders) >= raters and len(orders) % rows == 0
    for order in orders:
        assert sorted(order) == sorted(cells.values())
        for start in range(0, len(order), k):
            block = [name.split("-") for name in order[start : start + k]]
            assert len({condition for condition, _ in block}) == k
            if k <= clips:
                assert len({clip for _, clip in block}) == k
    # Over each full group of raters every condition is at every place of the session equally often.
    for first in range(0, len(orders), rows):
        group = orders[first : first + rows]
        for place in range(k * clips):
            counts = Counter(order[place].split("-")[0] for order in group)
            assert set(counts.values()) == {rows // k}


def test_neither_a_clip_nor_a_condition_comes_twice_in_a_row():
    orders = make_orders(cells_of(5, 10), raters=36, rng=np.random.default_rng(3))
    for order in orders:
        pages = [name.split("-") for name in order]
        assert all(a != b and x != y for (a, x), (b, y) in pairwise(pages))
    assert len({tuple(order) for order in orders}) == len(orders)


def test_catch_trials_are_in_every_session_and_never_first():
    orders = make_orders(cells_of(3, 2), extra=["x", "y"], raters=12, rng=np.random.default_rng(0))
    assert all({"x", "y"} < set(order) and order[0] not in "xy" and len(order) == 8 for order in orders)
    assert len({order.index("x") for order in orders}) > 2


def test_a_hole_in_the_design_is_refused():
    cells = cells_of(2, 2)
    del cells["c1", "m1"]
    with pytest.raises(ValueError, match=r"no stimulus for \('c1', 'm1'\)"):
        make_orders(cells, raters=2, rng=np.random.default_rng(0))
    with pytest.raises(ValueError, match="two conditions or more"):
        williams(1)
