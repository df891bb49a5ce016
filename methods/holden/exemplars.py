"""Which training clips lend their style: those of the target style and the same action that are nearest in content."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from benchmark.motion.clip import MotionClip

Array = NDArray[np.float64]

#: Frames per second at which contents are compared.
COMPARED_FPS = 10.0

#: Cells of the matrices of costs that are held at once.
_CELLS = 2_000_000


def content(clip: MotionClip) -> Array:
    """(N, 3 S + 1) directions of trunk and limbs and the hips' height, ten times a second: no size, place or facing."""
    from benchmark.motion.pose import segment_directions

    skeleton = clip.skeleton
    every = max(1, round(clip.fps / COMPARED_FPS))
    height = clip.positions[:, skeleton.joint("hips"), 1:2] / skeleton.leg_length
    return np.concatenate([segment_directions(clip).reshape(len(clip), -1), height], axis=1)[::every]


def nearest(query: Array, candidates: Sequence[Array], count: int) -> list[tuple[int, float]]:
    """The ``count`` candidates with the lowest mean cost of a dynamic time warp to ``query``, nearest first; ties by order.

    Candidates are warped in the order of :func:`_least_costs` until none of those that are left can be among the nearest.
    """
    from benchmark.motion.dtw import dtw

    least = _least_costs(query, candidates)
    costs: list[tuple[float, int]] = []
    for number in np.argsort(least, kind="stable"):
        if len(costs) >= count and least[number] > costs[count - 1][0]:
            break
        costs.append((dtw(query, candidates[number]).mean_cost, int(number)))
        costs.sort()
    return [(number, cost) for cost, number in costs[:count]]


def _least_costs(query: Array, candidates: Sequence[Array]) -> Array:
    """What the mean cost of the warp to each candidate is at least, to rounding.

    The total of the cheapest paths over the cells of the longest of them. All candidates are swept at once, diagonal by
    diagonal, which for so few frames takes about as long as three warps of one.
    """
    least = np.empty(len(candidates))
    lengths = np.array([len(candidate) for candidate in candidates])
    order = np.argsort(lengths, kind="stable")
    together = max(1, _CELLS // (len(query) * (len(query) + int(lengths.max()))))
    for start in range(0, len(order), together):
        numbers = order[start : start + together]
        least[numbers] = _swept(query, [candidates[number] for number in numbers])
    return least


def _swept(query: Array, candidates: Sequence[Array]) -> Array:
    """:func:`_least_costs` of B candidates, of nearly the same length.

    One number holds the total of a path and, in its lowest digits and below zero, how many cells it has; so of paths with the
    same total the longest is the least. Costs are whole multiples of a unit far above their rounding: sums are exact, and what
    should tie does.
    """
    count, rows = len(candidates), len(query)
    lengths = np.array([len(candidate) for candidate in candidates])
    frames = np.concatenate(candidates)
    costs = np.einsum("ij,ij->i", query, query)[:, None] + np.einsum("ij,ij->i", frames, frames)
    costs -= 2.0 * (query @ frames.T)
    np.maximum(costs, 0.0, out=costs)
    cells = rows + int(lengths.max())
    digits = cells.bit_length()
    unit = max(float(costs.max()), 1e-300) * 2.0 ** -min(40, 52 - 2 * digits)
    # Cell (i, j) of candidate b is at [i + j + 2, b, i + 1]. Before a candidate's first row and beyond its end is no cell;
    # paths come from two diagonals before the first.
    diagonals = np.full((cells + 1, count, rows + 1), np.inf)
    diagonals[0, :, 0] = 0.0
    flat, slab = diagonals.reshape(cells + 1, -1), count * (rows + 1)
    number = np.repeat(np.arange(count), lengths)
    column = np.arange(len(frames)) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    places = (np.arange(rows) * (slab + 1))[:, None] + ((column + 2) * slab + number * (rows + 1) + 1)
    flat.reshape(-1)[places] = np.rint(costs / unit) * 2.0**digits - 1.0
    cheapest = np.empty(slab - 1)
    corner, beside = flat[0, :-1], flat[1]
    for here in flat[2:]:
        np.minimum(beside[1:], beside[:-1], out=cheapest)
        np.minimum(cheapest, corner, out=cheapest)
        own = here[1:]
        own += cheapest
        corner, beside = beside[:-1], here
    best = diagonals[lengths + rows, np.arange(count), -1]
    totals = np.ceil(best / 2.0**digits)
    # A cell is rounded by half a unit.
    return np.asarray(unit * (totals / (totals * 2.0**digits - best) - 1.0))
