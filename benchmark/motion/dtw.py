"""Exact dynamic time warping with its path.

The steps are (1, 0), (0, 1) and (1, 1), all of weight one (Sakoe & Chiba, 1978, "Dynamic programming algorithm optimization
for spoken word recognition", symmetric form without slope weights): the path minimises the plain sum of local costs over its
cells, from the first pair of frames to the last.

The recurrence has a dependence inside every row but none inside an anti-diagonal, so it is swept by anti-diagonals, a run of
them at a time, from both corners towards the middle at once. The local costs of a run are sheared into contiguous rows, one to
a pair of diagonals, because walking down a diagonal of a matrix touches one cache line per cell; the accumulated costs
overwrite them there. Small problems keep every run for the way back. Large ones keep the two last diagonals of each run, and
the way back sweeps those cells of a run again that can lie on the path: that is faster than writing all accumulated costs to
memory, and takes a few runs' memory instead of a matrix's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmark.errors import ContractError

#: Up to so many cells, all local costs are computed at once and all accumulated costs are kept: 16 bytes a cell.
_KEPT = 4_000_000
#: Diagonals of a run, up to that size and beyond.
_DIAGONALS = (128, 256)
#: Beyond, matrix products are of this many frames, so many in a batch: a batch of costs fits the cache.
_TILE = 32
_BATCH = 8

#: Steps between the lanes: rows and columns ahead, diagonals back from the last of one lane and from that of the other.
_STEPS_ACROSS = ((1, 1, 0, 1), (1, 1, 1, 0), (1, 0, 0, 0), (0, 1, 0, 0))

#: ``fill(start, row, out)`` writes the local cost of cell (i, k - i) to ``out[k - start, i - row]``.
_Fill = Callable[[int, int, NDArray[np.float64]], None]


@dataclass(frozen=True, eq=False)
class Alignment:
    """The cheapest monotone path through a matrix of local costs.

    Attributes
    ----------
    cost
        Sum of the local costs along the path.
    path
        (K, 2) matching frames ``(i, j)`` from ``(0, 0)`` to ``(n - 1, m - 1)``, read-only.
    """

    cost: float
    path: NDArray[np.int64]

    @property
    def mean_cost(self) -> float:
        """Mean local cost over the cells of the path."""
        return self.cost / len(self.path)

    @property
    def swapped(self) -> Alignment:
        """The same alignment with the two sequences exchanged."""
        path = self.path[:, ::-1]
        return Alignment(self.cost, path)

    def warp(self) -> NDArray[np.float64]:
        """(n,) for each frame of the first sequence, the mean index of the frames of the second that match it.

        Non-decreasing.
        """
        first, second = self.path.T
        return np.bincount(first, weights=second) / np.bincount(first)


def dtw(x: ArrayLike, y: ArrayLike, *, band: float | None = None) -> Alignment:
    """Align two sequences by the squared Euclidean distance of their frames.

    Parameters
    ----------
    x, y
        (n, d) and (m, d) finite values.
    band
        Half-width of a Sakoe-Chiba band about the straight line between the corners, as a fraction of the longer length,
        measured along the longer sequence; ``None`` for no constraint.

    Returns
    -------
    Alignment
        ``cost`` is in squared units of the input, summed from the differences themselves along the path.

    Raises
    ------
    ContractError
        If an input is empty, not finite or of another width, or if no path fits the band.
    """
    x, y = _frames("x", x), _frames("y", y)
    if x.shape[1] != y.shape[1]:
        raise ContractError(f"frames of x have {x.shape[1]} values and those of y {y.shape[1]}: they must agree")
    left, right = _widened(x, y)
    if len(x) * len(y) <= _KEPT:
        fills = _from_costs(left @ right.T)
    else:
        fills = _from_frames(left, right), _from_frames(left[::-1], right[::-1])
    path = _solve(fills, len(x), len(y), band)
    difference = x.take(path[:, 0], axis=0)
    difference -= y.take(path[:, 1], axis=0)
    return Alignment(float(np.einsum("ij,ij->", difference, difference)), path)


def dtw_from_costs(costs: ArrayLike, *, band: float | None = None) -> Alignment:
    """Align two sequences by a matrix (n, m) of finite local costs, which is left as it is.

    ``band`` and the errors are those of :func:`dtw`.
    """
    given = _frames("costs", costs)
    path = _solve(_from_costs(given), len(given), given.shape[1], band)
    return Alignment(float(given[path[:, 0], path[:, 1]].sum()), path)


def _frames(name: str, values: ArrayLike) -> NDArray[np.float64]:
    array = np.asarray(values, dtype=np.float64, order="C")
    if array.ndim != 2 or array.size == 0:
        raise ContractError(f"{name} must be a two-dimensional array that is not empty, not one of shape {array.shape}")
    if not np.isfinite(array).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise ContractError(f"{name} holds {array[where]} at index {where}: time warping needs finite values")
    return array


def _widened(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Frames widened by two columns, whose products are half the squared distances, centred so that little cancels.

    The products are ``|x_i|^2 / 2 + |y_j|^2 / 2 - x_i y_j``. The squared lengths are swollen by the rounding that a product can
    do (Higham, 2002, "Accuracy and stability of numerical algorithms", section 3.1), so that none is negative: where both
    sequences stand still, costs below zero would reward a path for lingering.
    """
    (n, width), m = x.shape, len(y)
    left, right = np.empty((n, width + 2)), np.empty((m, width + 2))
    with np.errstate(over="ignore", invalid="ignore"):
        centre = (np.ones(n) @ x + np.ones(m) @ y) / (n + m)
        x = np.subtract(centre, x, out=left[:, :width])
        y = np.subtract(y, centre, out=right[:, :width])
        swelling = 0.5 + (1.5 * width + 4.0) * np.finfo(np.float64).eps
        np.multiply(np.einsum("ij,ij->i", x, x), swelling, out=left[:, width])
        np.multiply(np.einsum("ij,ij->i", y, y), swelling, out=right[:, width + 1])
        if not np.isfinite(8.0 * (left[:, width].max() + right[:, width + 1].max())):
            raise ContractError(
                "the frames of x and y lie so far apart that their squared distances overflow: rescale them"
            )
    left[:, width + 1] = right[:, width] = 1.0
    return left, right


def _from_costs(costs: NDArray[np.float64]) -> tuple[_Fill, _Fill]:
    """Fill a run from the matrix of all local costs, read from its first corner or from its last.

    Cell (i, k - i) lies at ``k + i (m - 1)``: neighbouring diagonals are a view with strides 1 and m - 1. Where k - i is no
    column, the view holds another cell of the matrix; it never leaves the matrix, because i < n and k < n + m - 1.
    """
    pitch, item, end = costs.shape[1] - 1, costs.itemsize, costs.size - 1

    def forward(start: int, row: int, out: NDArray[np.float64]) -> None:
        out[...] = np.ndarray(out.shape, np.float64, costs, (start + row * pitch) * item, (item, pitch * item))

    def backward(start: int, row: int, out: NDArray[np.float64]) -> None:
        offset = end - start - row * pitch
        out[...] = np.ndarray(out.shape, np.float64, costs, offset * item, (-item, -pitch * item))

    return forward, backward


def _from_frames(left: NDArray[np.float64], right: NDArray[np.float64]) -> _Fill:
    """Fill a run from products of widened frames, each of a tile of rows with the columns that the run crosses there.

    The tiles lie in one buffer whose pitch leaves room for the first columns of the next tile: so all their rows, sheared, are
    one view. Zeros around the frames stand in for those outside the matrix.
    """
    (n, width), m, item = left.shape, len(right), left.itemsize
    frame = width * item
    margin = _DIAGONALS[1] + _TILE
    pitch = margin + _TILE
    rows = np.zeros((n + _TILE, width))
    rows[:n] = left
    columns = np.zeros((m + 2 * margin, width))
    columns[margin : margin + m] = right
    buffer = np.empty(_BATCH * _TILE * pitch)

    def fill(start: int, row: int, out: NDArray[np.float64]) -> None:
        diagonals, count = out.shape
        reach = diagonals + _TILE - 1
        for first in range(0, count, _BATCH * _TILE):
            batch = min(_BATCH * _TILE, count - first)
            tiles, at = -(-batch // _TILE), row + first
            column = margin + start - at - (_TILE - 1)
            a: NDArray[np.float64] = np.ndarray((tiles, _TILE, width), np.float64, rows, at * frame)
            b: NDArray[np.float64] = np.ndarray(
                (tiles, width, reach), np.float64, columns, column * frame, (-_TILE * frame, item, frame)
            )
            costs: NDArray[np.float64] = np.ndarray(
                (tiles, _TILE, reach), np.float64, buffer, 0, (_TILE * (pitch - 1) * item, pitch * item, item)
            )
            np.matmul(a, b, out=costs)
            out[:, first : first + batch] = np.ndarray(
                (diagonals, batch), np.float64, buffer, (_TILE - 1) * item, (item, (pitch - 1) * item)
            )

    return fill


def _limits(n: int, m: int, band: float | None) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Lowest and highest row i of every diagonal i + j = k.

    Both grow by zero or one from a diagonal to the next. ``|i (m - 1) - j (n - 1)| <= reach`` says that (i, j) is within the
    band's half-width of the line between the corners, counted along the longer sequence.
    """
    k = np.arange(n + m - 1)
    low, high = np.maximum(0, k - m + 1), np.minimum(n - 1, k)
    if band is not None:
        if not (np.isfinite(band) and band >= 0.0):
            raise ContractError(f"band must be a fraction of the longer length, at least 0, not {band}")
        rows, columns = n - 1, m - 1
        if rows and columns:
            reach = band * max(n, m) * min(rows, columns)
            first, last = (k * rows - reach) / (rows + columns), (k * rows + reach) / (rows + columns)
            low = np.maximum(low, np.ceil(first - 1e-9).astype(np.int64))
            high = np.minimum(high, np.floor(last + 1e-9).astype(np.int64))
    return low, high


@dataclass(frozen=True, eq=False)
class _Run:
    """Costs of the cheapest paths to the cells of neighbouring diagonals.

    ``cells`` (2 + diagonals, lanes, columns) begins with the two diagonals before ``start``; its column c belongs to row
    ``top + c``.
    """

    start: int
    top: int
    cells: NDArray[np.float64]

    @property
    def stop(self) -> int:
        """The diagonal after the last."""
        return self.start + len(self.cells) - 2

    def ends(self) -> _Run:
        """The two last diagonals, as what comes before the next run."""
        return _Run(self.stop, self.top, self.cells[-2:].copy())


def _solve(fills: tuple[_Fill, _Fill], n: int, m: int, band: float | None) -> NDArray[np.int64]:
    """The cheapest path (K, 2) from the first cell to the last.

    Diagonals are swept from both corners towards the middle, side by side in two lanes: what a call of numpy costs is paid
    half as often. The second lane sees the matrix turned by half a circle, in which limits and steps are the same.
    """
    low, high = _limits(n, m, band)
    keep, half = n * m <= _KEPT, (n + m) // 2
    length = _DIAGONALS[0 if keep else 1]
    parts = [slice(start, min(start + length, half)) for start in range(0, half, length)]
    # One block of memory for all runs that are kept: the system hands out a large block in large pages.
    sizes = [2 * _size(low[part], high[part]) for part in parts]
    block = np.empty(sum(sizes) if keep else max(sizes))
    used = 0
    # Two diagonals before the first cell: every path starts at no cost there, in row -1.
    run = before = _Run(0, -1, np.array([[[0.0, np.inf]] * 2, [[np.inf, np.inf]] * 2]))
    kept = []
    for part, size in zip(parts, sizes, strict=True):
        run = _sweep(fills, before, low[part], high[part], block[used:])
        kept.append(run if keep else before)
        before = run if keep else run.ends()
        used += size if keep else 0
    ends = _meet(run, low, high, n, m)
    if ends is None:
        if band is None:
            raise ContractError("the costs along every path add up to more than a number can hold: rescale them")
        raise ContractError(f"no path fits a band of {band:g} between {n} and {m} frames: widen it")
    pieces: list[list[NDArray[np.int64]]] = [[], []]
    for lane, (diagonal, row) in enumerate(ends):
        for run in reversed(kept):
            if diagonal < run.start:
                continue
            if keep:
                piece, diagonal, row = _trace(run, lane, diagonal, row)
            else:
                # The path to this cell rises by at most one row a diagonal.
                here = slice(run.start, diagonal + 1)
                reached = np.arange(row - (diagonal - run.start), row + 1)
                before = _Run(run.start, run.top, run.cells[:, lane : lane + 1])
                limits = np.maximum(low[here], reached), np.minimum(high[here], row)
                swept = _sweep(fills[lane : lane + 1], before, *limits, block)
                piece, diagonal, row = _trace(swept, 0, diagonal, row)
            pieces[lane].append(piece)
    first = [piece[::-1] for piece in reversed(pieces[0])]
    path = np.concatenate(first + [np.array([n - 1, m - 1]) - piece for piece in pieces[1]])
    path.flags.writeable = False
    return path


def _meet(
    run: _Run, low: NDArray[np.int64], high: NDArray[np.int64], n: int, m: int
) -> tuple[tuple[int, int], tuple[int, int]] | None:
    """The cheapest step from the last diagonals of one lane to those of the other: diagonal and row in each lane.

    Of equally cheap steps the one nearest to the straight line between the corners goes first. ``None`` where none is finite.
    """
    last = run.stop - 1
    after = n + m - 3 - last

    def line(lane: int, diagonal: int) -> NDArray[np.float64]:
        """Costs of rows -1 to n of a diagonal."""
        costs = np.full(n + 2, np.inf)
        if diagonal >= 0:
            first, stop = max(low[diagonal], run.top), high[diagonal] + 1
            known = run.cells[diagonal - run.start + 2, lane, first - run.top : stop - run.top]
            costs[first + 1 : stop + 1] = known
        elif diagonal == -2:
            costs[0] = 0.0
        return costs

    leave, leave_before = line(0, last)[:-1], line(0, last - 1)[:-1]
    enter, enter_after = line(1, after)[::-1], line(1, after - 1)[::-1]
    # Steps (1, 1) from the last diagonal and from the one before, (1, 0) and (0, 1); by row of the cell that is left.
    totals = (leave + enter_after[1:], leave_before + enter[1:], leave + enter[1:], leave + enter[:-1])
    best = min(total.min() for total in totals)
    if not np.isfinite(best):
        return None
    ways = []
    for (down, right, back, ahead), total in zip(_STEPS_ACROSS, totals, strict=True):
        for row in (np.flatnonzero(total == best) - 1).tolist():
            aside = (2 * row + down) * (m - 1) - (2 * (last - back - row) + right) * (n - 1)
            ways.append((abs(aside), (last - back, row), (after - ahead, n - 1 - row - down)))
    return min(ways)[1:]


def _columns(low: NDArray[np.int64], high: NDArray[np.int64]) -> int:
    """Columns of a run between these rows, with a margin on either side."""
    return max(int(high[-1]), int(low[0])) - int(low[0]) + 3


def _size(low: NDArray[np.int64], high: NDArray[np.int64]) -> int:
    """Cells of a lane of a run, with the two diagonals before it."""
    return (len(low) + 2) * _columns(low, high)


def _sweep(
    fills: tuple[_Fill, ...], before: _Run, low: NDArray[np.int64], high: NDArray[np.int64], block: NDArray[np.float64]
) -> _Run:
    """Accumulate the costs of the diagonals that follow ``before``, between rows ``low`` and ``high`` of each.

    All diagonals are swept from the lowest row of the first to the highest of the last. A line of infinite costs along
    either end of the diagonals keeps the cells beyond from their neighbours, and one lane from the next. The run lies at the
    beginning of ``block``.
    """
    start, top, count, lanes = before.stop, int(low[0]) - 1, len(low), len(fills)
    columns = _columns(low, high)
    flat = block[: lanes * _size(low, high)].reshape(count + 2, lanes * columns)
    cells = flat.reshape(count + 2, lanes, columns)
    shift = top - before.top
    known = before.cells[-2:, :, shift : shift + columns]
    cells[:2, :, : known.shape[2]] = known
    cells[:2, :, known.shape[2] :] = np.inf
    run = cells[2:]
    for lane, fill in enumerate(fills):
        fill(start, top + 1, run[:, lane, 1:-1])
    run[:, :, 0] = run[:, :, -1] = np.inf
    diagonal = np.arange(count)
    run[diagonal, :, low - 1 - top] = np.inf
    run[diagonal, :, high + 1 - top] = np.inf
    minimum, add = np.minimum, np.add
    cheapest = np.empty(lanes * columns - 2)
    # `upper` holds the cells i - 1 of a diagonal, `own` its cells i.
    pairs = zip(flat[:, :-2], flat[:, 1:-1], strict=True)
    corner, _ = next(pairs)
    above, beside = next(pairs)
    with np.errstate(over="ignore"):
        for upper, own in pairs:
            minimum(above, beside, out=cheapest)
            minimum(cheapest, corner, out=cheapest)
            add(own, cheapest, out=own)
            corner, above, beside = above, upper, own
    return _Run(start, top, cells)


def _trace(run: _Run, lane: int, diagonal: int, row: int) -> tuple[NDArray[np.int64], int, int]:
    """The cells (K, 2) of the path through a run, last first, and the diagonal and row at which it goes on before the run.

    Of equally cheap steps the diagonal goes first, then the first sequence's.
    """
    _, lanes, columns = run.cells.shape
    pitch, offset = lanes * columns, lane * columns - run.top
    # Single elements of a memoryview are read at half the cost of those of an array.
    total = run.cells.reshape(-1).data
    at = (diagonal - run.start + 2) * pitch + row + offset
    own, corner, above = 2 * pitch, 2 * pitch + 1, pitch + 1
    visited = []
    while at >= own:
        visited.append(at)
        both, first, second = total[at - corner], total[at - above], total[at - pitch]
        if both <= first and both <= second:
            at -= corner
        elif first <= second:
            at -= above
        else:
            at -= pitch
    line, column = np.divmod(np.array(visited, dtype=np.int64), pitch)
    rows, origin = column - offset, run.start - 2
    path = np.stack((rows, line + origin - rows), axis=1)
    return path, at // pitch + origin, at % pitch - offset
