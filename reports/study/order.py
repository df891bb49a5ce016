"""The order in which each rater sees the stimuli: random, and balanced over conditions by a Williams design.

A session is a row of blocks. A block shows every condition once, each with another clip, in the order of one row of a Williams
square (E. J. Williams, Australian Journal of Scientific Research A 2, 1949), in which every condition follows every other
equally often. Over each full group of raters every condition then stands at every place of every block equally often, so that
neither practice nor fatigue nor what was seen just before can favour one. Which clip a condition shows when is random.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

#: Draws after which an order with the same clip or condition twice in a row is taken as it is.
_TRIES = 400


def williams(k: int) -> NDArray[np.int64]:
    """The Williams design of ``k`` conditions.

    Parameters
    ----------
    k
        Conditions, 2 or more.

    Returns
    -------
    (R, k) int64
        R = k rows for even k, 2 k for odd. Each condition is at each place R / k times, and follows each other R / k times.

    Raises
    ------
    ValueError
        For fewer than two conditions.
    """
    if k < 2:
        raise ValueError(f"an order balances two conditions or more, not {k}")
    # 0, 1, k - 1, 2, k - 2, ...: neighbours differ by each of 1 .. k - 1 once.
    first = [(step + 1) // 2 if step % 2 else (k - step // 2) % k for step in range(k)]
    square = (np.array(first) + np.arange(k)[:, None]) % k
    return square if k % 2 == 0 else np.concatenate([square, square[:, ::-1]])


def make_orders(
    cells: Mapping[tuple[str, str], str], *, extra: Sequence[str] = (), raters: int, rng: np.random.Generator
) -> list[list[str]]:
    """An order for each rater, in full groups, so that there may be some more orders than raters.

    Parameters
    ----------
    cells
        Stimulus by (condition, clip); every condition has every clip.
    extra
        Further stimuli, such as catch trials, put at random places of each session, never first.
    raters
        Orders asked for.
    rng
        Every draw.

    Raises
    ------
    ValueError
        If a condition lacks a clip.
    """
    conditions, clips = (list(dict.fromkeys(pair[axis] for pair in cells)) for axis in (0, 1))
    lacking = [(a, b) for a in conditions for b in clips if (a, b) not in cells]
    if lacking:
        raise ValueError(f"every condition needs every clip, and there is no stimulus for {lacking[0]}")
    square = williams(len(conditions))
    orders: list[list[str]] = []
    while len(orders) < raters:
        names = [conditions[index] for index in rng.permutation(len(conditions))]
        shifts = _shifts(square, len(clips), rng)
        for rater in rng.permutation(len(square)):
            rows = [square[(rater + shift) % len(square)] for shift in shifts]
            shown = _with_clips(rows, len(clips), rng)
            order = [cells[names[condition], clips[clip]] for condition, clip in shown]
            for stimulus in extra:
                order.insert(int(rng.integers(1, len(order) + 1)), stimulus)
            orders.append(order)
    return orders


def _shifts(square: NDArray[np.int64], blocks: int, rng: np.random.Generator) -> list[int]:
    """How far each block moves on in the square, so that no session shows a condition twice in a row, where that can be."""
    rows = len(square)
    shifts = [int(rng.integers(rows))]
    while len(shifts) < blocks:
        # Whether rater r repeats a condition at the border depends on the two rows that meet there.
        good = [
            shift
            for shift in range(rows)
            if not np.any(np.roll(square, -shifts[-1], axis=0)[:, -1] == np.roll(square, -shift, axis=0)[:, 0])
        ]
        shifts.append(int(rng.choice(good)) if good else int(rng.integers(rows)))
    return shifts


def _with_clips(rows: Sequence[NDArray[np.int64]], clips: int, rng: np.random.Generator) -> list[tuple[int, int]]:
    """(condition, clip) of each page: every condition meets every clip once, and a clip does not follow itself if possible."""
    k = len(rows[0])
    best: list[tuple[int, int]] = []
    fewest = -1
    for _ in range(_TRIES):
        # A cyclic Latin square with its rows, columns and symbols shuffled; beyond k = clips its rows come again.
        offsets = np.concatenate([rng.permutation(clips) for _ in range(-(-k // clips))])[:k]
        names, turns = rng.permutation(clips), rng.permutation(clips)
        pages = [
            (int(condition), int(names[(turns[block] + offsets[condition]) % clips]))
            for block, row in enumerate(rows)
            for condition in row
        ]
        repeats = sum(a[1] == b[1] for a, b in pairwise(pages))
        if fewest < 0 or repeats < fewest:
            best, fewest = pages, repeats
        if not repeats:
            break
    return best
