"""Time warp: for every output frame one input frame, in order, by dynamic programming.

The warp matrix ``W`` of iterative motion warping has exactly one 1 per row: output frame ``t`` shows input frame ``path[t]``.
From one output frame to the next the input advances by ``k`` frames, ``k`` from 0 to ``max_skip``: 0 repeats a frame, 1 is the
normal pace, 2 and more delete ``k - 1`` input frames. Both ends are pinned. The cheapest path obeys ::

    D[t, i] = cost[t, i] + min over k of (D[t - 1, i - k] + penalties[k])

Dong et al. (2018) speak of repetition and deletion without saying how a deletion enters the objective; with this reading
every output frame is compared with exactly one input frame, and the sum along the path is the data term of the objective
itself. Hsu et al. (2005) only repeat: that is ``max_skip=1``, under which every input frame is used at least once, and which
therefore needs an output at least as long as the input (``np.repeat(v, s, axis=0)`` lengthens a shorter one).

A row depends on the row before and nothing within itself, so a row is a few vector operations. Only cells that lie on some
admissible path are visited (:class:`Corridor`). Local costs are computed for a few dozen rows at a time as one matrix product.
Accumulated costs are kept for the way back while they fit :data:`KEPT_CELLS`; beyond, only every block's first row is kept
and the blocks are swept again on the way back: twice the time, for memory that grows with the width of the band times the
square root of the number of frames.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import ContractError

DISTANCES = ("squared", "l2")

#: Accumulated costs kept for the way back before blocks are swept twice instead (8 bytes each).
KEPT_CELLS = 1 << 23

#: Fewest output frames swept in one block.
_ROWS = 32


@dataclass(frozen=True, eq=False)
class Corridor:
    """Input frames that each output frame may show: every one of them lies on a path that is allowed throughout.

    Attributes
    ----------
    start, stop
        (T',) first allowed input frame and one past the last, both non-decreasing.
    frames
        Number of input frames T.
    max_skip
        Largest advance of the input from one output frame to the next.
    """

    start: NDArray[np.int64]
    stop: NDArray[np.int64]
    frames: int
    max_skip: int

    @classmethod
    def between(cls, frames_in: int, frames_out: int, *, band: float | None, max_skip: int) -> Corridor:
        """Cells that can be reached from the first pair of frames and can reach the last one.

        Parameters
        ----------
        frames_in, frames_out
            T and T'.
        band
            Allowed distance from the line ``i = t (T - 1) / (T' - 1)``, as a fraction of T; ``None`` for no limit.
        max_skip
            Largest advance of the input per output frame.

        Raises
        ------
        ContractError
            If no path exists.
        """
        t = np.arange(frames_out)
        last = frames_in - 1
        low, high = np.zeros(frames_out, dtype=np.int64), np.full(frames_out, last)
        if band is not None:
            line, reach = t * (last / max(frames_out - 1, 1)), band * frames_in
            # The allowance keeps a frame that lies exactly on the edge of the band.
            slack = 1e-9 * frames_in
            low = np.maximum(low, np.ceil(line - reach - slack).astype(np.int64))
            high = np.minimum(high, np.floor(line + reach + slack).astype(np.int64))
        # Steps from 0 to max_skip make the reachable frames of a row an interval: the running maximum of the lower ends, and
        # the upper ends limited by how far the rows before allow; the same from the last cell backwards.
        climb = max_skip * t
        high[0] = 0
        high = np.minimum.accumulate(high - climb) + climb
        high = np.minimum.accumulate(high[::-1])[::-1]
        low[-1] = last
        low = np.maximum.accumulate(low)
        low = np.maximum.accumulate((low - climb)[::-1])[::-1] + climb
        if (low > high).any() or low[0] != 0 or high[-1] != last:
            within = "" if band is None else f" within a band of {band:g}"
            raise ContractError(
                f"no time warp leads from {frames_in} input to {frames_out} output frames in steps of at most "
                f"max_skip = {max_skip}{within}: raise max_skip{'' if band is None else ' or widen the band'}, or lengthen "
                "the output by repeating its frames"
            )
        return cls(low, high + 1, frames_in, max_skip)

    def __len__(self) -> int:
        return len(self.start)

    @property
    def cells(self) -> int:
        """How many pairs of frames are compared."""
        return int((self.stop - self.start).sum())

    def blocks(self) -> list[tuple[int, int]]:
        """Runs of output frames, first and one past the last, that are swept together.

        A block is a rectangle over all its rows' cells. The rows are few beside the width, so that little of it is idle, but
        at least the square root of their number.
        """
        widest = int((self.stop - self.start).max())
        rows = max(_ROWS, min(widest // 4, math.isqrt(len(self))))
        return [(first, min(first + rows, len(self))) for first in range(0, len(self), rows)]


def time_warp(
    x: NDArray[np.float64],
    v: NDArray[np.float64],
    corridor: Corridor,
    *,
    penalties: NDArray[np.float64] | None = None,
    distance: str = "squared",
) -> NDArray[np.int64]:
    """The cheapest admissible path.

    Parameters
    ----------
    x
        (T, d) input frames, scaled and offset already.
    v
        (T', d) output frames.
    corridor
        Allowed cells, made for these lengths.
    penalties
        (max_skip + 1,) cost of each advance, at least 0; none by default.
    distance
        ``squared`` sums squared Euclidean distances, as the objective does. ``l2`` sums plain ones, as Dong et al. (2018)
        print: the path then minimises something else than the objective, which may rise.

    Returns
    -------
    numpy.ndarray
        (T',) int64, non-decreasing from 0 to T - 1. Of equally cheap steps the normal pace goes first, then the smallest.
    """
    steps = corridor.max_skip + 1
    cost_of = np.zeros(steps) if penalties is None else penalties
    costs = _costs(x, v, distance)
    blocks = corridor.blocks()
    keep = corridor.cells <= KEPT_CELLS
    kept: list[NDArray[np.float64] | None] = []
    heads: list[NDArray[np.float64]] = []
    head = np.empty(0)
    for first, end in blocks:
        heads.append(head)
        swept = _sweep(costs, corridor, cost_of, head, first, end)
        origin = int(corridor.start[first]) - corridor.max_skip
        head = swept[-1, corridor.start[end - 1] - origin : corridor.stop[end - 1] - origin].copy()
        kept.append(swept if keep else None)
    path = np.empty(len(corridor), dtype=np.int64)
    path[-1] = corridor.frames - 1
    for number in range(len(blocks) - 1, -1, -1):
        first, end = blocks[number]
        stored = kept.pop()
        swept = _sweep(costs, corridor, cost_of, heads[number], first, end) if stored is None else stored
        _trace(swept, path, first, end, int(corridor.start[first]) - corridor.max_skip, cost_of)
    return path


def path_cost(
    x: NDArray[np.float64],
    v: NDArray[np.float64],
    path: NDArray[np.int64],
    *,
    penalties: NDArray[np.float64] | None = None,
    distance: str = "squared",
) -> float:
    """What :func:`time_warp` minimises, summed from the differences themselves."""
    difference = x[path] - v
    squared = np.einsum("ij,ij->i", difference, difference)
    local = float((np.sqrt(squared) if distance == "l2" else squared).sum())
    return local if penalties is None else local + float(penalties[np.diff(path)].sum())


def _costs(
    x: NDArray[np.float64], v: NDArray[np.float64], distance: str
) -> Callable[[int, int, int, int, NDArray[np.float64]], None]:
    """A function that fills a rectangle of local costs: output frames from, to, input frames from, to.

    ``|v|^2 + |x|^2 - 2 v x`` is one product of widened frames, centred so that little cancels.
    """
    width = x.shape[1]
    centre = (x.sum(axis=0) + v.sum(axis=0)) / (len(x) + len(v))
    left, right = np.ones((len(v), width + 2)), np.ones((len(x), width + 2))
    v = np.subtract(v, centre, out=left[:, :width])
    x = np.subtract(x, centre, out=right[:, :width])
    np.einsum("ij,ij->i", v, v, out=left[:, width])
    np.einsum("ij,ij->i", x, x, out=right[:, width + 1])
    v *= -2.0

    def fill(first: int, end: int, low: int, high: int, out: NDArray[np.float64]) -> None:
        np.matmul(left[first:end], right[low:high].T, out=out)
        np.maximum(out, 0.0, out=out)
        if distance == "l2":
            np.sqrt(out, out=out)

    return fill


def _sweep(
    costs: Callable[[int, int, int, int, NDArray[np.float64]], None],
    corridor: Corridor,
    penalties: NDArray[np.float64],
    head: NDArray[np.float64],
    first: int,
    end: int,
) -> NDArray[np.float64]:
    """Accumulated costs (1 + rows, max_skip + width) of a block; row 0 is the row before it.

    Column ``max_skip + j`` is input frame ``start[first] + j``; what lies outside the corridor is infinite. The row before
    reaches this block's cells from at most ``max_skip`` columns further left.
    """
    skip = corridor.max_skip
    low, high = int(corridor.start[first]), int(corridor.stop[end - 1])
    block = np.empty((1 + end - first, skip + high - low))
    block[:, :skip] = np.inf
    before = block[0]
    before.fill(np.inf)
    if first == 0:
        # A normal step from one column left of the first frame.
        before[skip - 1] = -penalties[1]
    else:
        start = int(corridor.start[first - 1])
        # `head` begins at the row before's own first cell, which no more than `skip` columns lie left of this block's.
        before[start - low + skip : start - low + skip + len(head)] = head
    inner = block[1:, skip:]
    costs(first, end, low, high, inner)
    limits = zip((corridor.start[first:end] - low).tolist(), (corridor.stop[first:end] - low).tolist(), strict=True)
    for row, (left, right) in zip(inner, limits, strict=True):
        row[:left] = np.inf
        row[right:] = np.inf
    minimum, add = np.minimum, np.add
    width = high - low
    total, candidate = np.empty(width), np.empty(width)
    # Views of the row before, shifted by each step, and what that step costs; the normal pace starts the comparison.
    shifted = [block[:-1, skip - k : skip - k + width] for k in range(skip + 1)]
    others = [k for k in range(skip + 1) if k != 1]
    if not penalties.any():
        for here, normal, *rest in zip(inner, shifted[1], *(shifted[k] for k in others), strict=True):
            minimum(normal, rest[0], out=total)
            for view in rest[1:]:
                minimum(total, view, out=total)
            add(here, total, out=here)
        return block
    prices = [float(penalties[k]) for k in others]
    for here, normal, *rest in zip(inner, shifted[1], *(shifted[k] for k in others), strict=True):
        add(normal, penalties[1], out=total)
        for view, price in zip(rest, prices, strict=True):
            add(view, price, out=candidate)
            minimum(total, candidate, out=total)
        add(here, total, out=here)
    return block


def _trace(
    block: NDArray[np.float64],
    path: NDArray[np.int64],
    first: int,
    end: int,
    origin: int,
    penalties: NDArray[np.float64],
) -> None:
    """Fill the path of a block's rows from the one that is known: its last.

    Rows are looked up one before the other, so that ``path[first - 1]`` is found as well.
    """
    # Single elements of a memoryview are read at half the cost of those of an array.
    total = block.data
    steps = [1, 0, *range(2, len(penalties))]
    prices = [(k, float(penalties[k])) for k in steps]
    column = int(path[end - 1]) - origin
    for row in range(end - 1, max(first, 1) - 1, -1):
        before = row - first
        best, chosen = math.inf, 1
        for k, price in prices:
            value = total[before, column - k] + price
            if value < best:
                best, chosen = value, k
        column -= chosen
        path[row - 1] = column + origin
