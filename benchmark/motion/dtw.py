"""Exact dynamic time warping with its path.

The steps are (1, 0), (0, 1) and (1, 1), all of weight one (Sakoe & Chiba, 1978, "Dynamic programming algorithm optimization
for spoken word recognition", symmetric form without slope weights): the path minimises the plain sum of local costs over its
cells, from the first pair of frames to the last.

The recurrence has a dependence inside every row but none inside an anti-diagonal, so it is swept by anti-diagonals. Local
costs come from one matrix product on centred data. A few dozen diagonals at a time are sheared into contiguous rows, because
walking down a diagonal of a large matrix touches one cache line per cell; the accumulated costs overwrite the local ones, and
the path is read back from them. Memory is one float64 matrix of n x m.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmark.errors import ContractError

#: Diagonals sheared at a time, and cells of the cost matrix computed at a time: both keep the work in cache.
_DIAGONALS = 32
_STRIP = 200_000


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
    flat, costs = _padded(len(x), len(y))
    _squared_distances(x, y, costs)
    path = _solve(flat, costs, band)
    difference = x[path[:, 0]] - y[path[:, 1]]
    return Alignment(float(np.einsum("ij,ij->", difference, difference)), path)


def dtw_from_costs(costs: ArrayLike, *, band: float | None = None) -> Alignment:
    """Align two sequences by a matrix (n, m) of finite local costs, which is left as it is.

    ``band`` and the errors are those of :func:`dtw`.
    """
    given = _frames("costs", costs)
    flat, work = _padded(*given.shape)
    work[...] = given
    path = _solve(flat, work, band)
    return Alignment(float(given[path[:, 0], path[:, 1]].sum()), path)


def _frames(name: str, values: ArrayLike) -> NDArray[np.float64]:
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != 2 or array.size == 0:
        raise ContractError(f"{name} must be a two-dimensional array that is not empty, not one of shape {array.shape}")
    if not np.isfinite(array).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise ContractError(f"{name} holds {array[where]} at index {where}: time warping needs finite values")
    return array


def _padded(n: int, m: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A buffer for an (n, m) matrix with infinite cells around it, flat, and the matrix in it.

    Above it lies one row; between its rows lie as many columns as diagonals are swept at a time, which serve as the right
    margin of one row and the left margin of the next.
    """
    flat = np.empty((n + 1) * (m + _DIAGONALS))
    whole = flat.reshape(n + 1, m + _DIAGONALS)
    whole[0], whole[:, m:] = np.inf, np.inf
    return flat, whole[1:, :m]


def _squared_distances(x: NDArray[np.float64], y: NDArray[np.float64], out: NDArray[np.float64]) -> None:
    """``|x_i|^2 + |y_j|^2 - 2 x_i y_j`` as one product of widened frames, centred so that little cancels."""
    n, m, width = len(x), len(y), x.shape[1]
    centre = (x.sum(axis=0) + y.sum(axis=0)) / (n + m)
    left, right = np.ones((n, width + 2)), np.ones((m, width + 2))
    x = np.subtract(x, centre, out=left[:, :width])
    y = np.subtract(y, centre, out=right[:, :width])
    np.einsum("ij,ij->i", x, x, out=left[:, width])
    np.einsum("ij,ij->i", y, y, out=right[:, width + 1])
    x *= -2.0
    rows = max(64, _STRIP // m)
    for start in range(0, n, rows):
        strip = out[start : start + rows]
        np.matmul(left[start : start + rows], right.T, out=strip)
        np.maximum(strip, 0.0, out=strip)


def _solve(flat: NDArray[np.float64], costs: NDArray[np.float64], band: float | None) -> NDArray[np.int64]:
    n, m = costs.shape
    # The cells of diagonal i + j = k have rows from low[k] to high[k].
    k = np.arange(n + m - 1)
    low, high = np.maximum(0, k - m + 1), np.minimum(n - 1, k)
    if band is not None:
        if not (np.isfinite(band) and band >= 0.0):
            raise ContractError(f"band must be a fraction of the longer length, at least 0, not {band}")
        if min(n, m) > 1:
            low, high = _confine(costs, band, low, high)
    _accumulate(flat, n, m, low.tolist(), high.tolist())
    if not np.isfinite(costs[-1, -1]):
        raise ContractError(f"no path fits a band of {band:g} between {n} and {m} frames: widen it")
    return _trace(flat, n, m)


def _confine(
    costs: NDArray[np.float64], band: float, low: NDArray[np.int64], high: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Line the band with infinite costs, as thick as the sweep looks beyond it, and narrow the diagonals to it.

    ``|i (m - 1) - j (n - 1)| <= reach`` says that (i, j) is within the band's half-width of the line between the corners,
    counted along the longer sequence. Diagonals are cut a little wider than the lining, which alone decides.
    """
    n, m = costs.shape
    rows, columns = n - 1, m - 1
    reach = band * max(n, m) * min(rows, columns)
    i = np.arange(n)
    first = np.ceil((i * columns - reach) / rows - 1e-9).astype(np.int64)
    stop = np.floor((i * columns + reach) / rows + 1e-9).astype(np.int64) + 1
    # Along a row, a diagonal and the next differ by one cell, and so do the ends of the diagonals of one sweep.
    lining = _DIAGONALS + 2
    for row, left, right in zip(costs, first.tolist(), stop.tolist(), strict=True):
        row[max(0, left - lining) : max(0, left)] = np.inf
        row[max(0, right) : max(0, right + lining)] = np.inf
    k = np.arange(n + m - 1)
    low = np.maximum(low, np.ceil((k * rows - reach) / (rows + columns) - 1e-6).astype(np.int64))
    high = np.minimum(high, np.floor((k * rows + reach) / (rows + columns) + 1e-6).astype(np.int64))
    return low, high


def _accumulate(flat: NDArray[np.float64], n: int, m: int, low: list[int], high: list[int]) -> None:
    """Replace the local costs between ``low`` and ``high`` by the costs of the cheapest paths that end there.

    With rows of ``m + p`` cells in ``flat`` and one row above, cell (i, k - i) lies at ``m + p + k + i (m + p - 1)``: a run of
    neighbouring diagonals is a view with strides 1 and m + p - 1, copied into contiguous rows and back. All diagonals of a run
    are swept from the first one's ``low`` to the last one's ``high``; the cells that are none of theirs lie in the margin or in
    the lining of the band, are infinite and stay so.
    """
    minimum, add = np.minimum, np.add
    pitch, item = m + _DIAGONALS, flat.itemsize
    # Column i + 1 holds row i. The two leading diagonals are those before the run.
    sheared = np.full((_DIAGONALS + 2, n + 1), np.inf)
    sheared[0, 0] = 0.0
    best = np.empty(n)
    for start in range(0, n + m - 1, _DIAGONALS):
        end = min(start + _DIAGONALS, n + m - 1)
        top, stop = low[start] - 1, high[end - 1] + 1
        width = stop - top
        view: NDArray[np.float64] = np.ndarray(
            (end - start, width),
            np.float64,
            flat,
            (pitch + start + top * (pitch - 1)) * item,
            (item, (pitch - 1) * item),
        )
        run = sheared[2 : 2 + end - start, top + 1 : stop + 1]
        run[...] = view
        window = sheared[: 2 + end - start, top + 1 : stop + 1]
        cheapest = best[: width - 1]
        # `above` holds the cells (i - 1) of a diagonal, `here` its cells i.
        pairs = zip(window[:, :-1], window[:, 1:], strict=True)
        before, _ = next(pairs)
        above, here = next(pairs)
        for upper, cells in pairs:
            minimum(above, here, out=cheapest)
            minimum(cheapest, before, out=cheapest)
            add(cells, cheapest, out=cells)
            before, above, here = above, upper, cells
        view[...] = run
        sheared[:2] = sheared[end - start : end - start + 2]


def _trace(flat: NDArray[np.float64], n: int, m: int) -> NDArray[np.int64]:
    """The path (K, 2) to the last cell; of equally cheap steps the diagonal goes first, then the first sequence's.

    The infinite cells around the matrix turn the path back at its edges.
    """
    pitch = m + _DIAGONALS
    # Single elements of a memoryview are read at half the cost of those of an array.
    total = flat.data
    origin, at = pitch, n * pitch + m - 1
    cells = [at]
    while at != origin:
        both, first, second = total[at - pitch - 1], total[at - pitch], total[at - 1]
        if both <= first and both <= second:
            at -= pitch + 1
        elif first <= second:
            at -= pitch
        else:
            at -= 1
        cells.append(at)
    path = np.stack(np.divmod(np.array(cells[::-1], dtype=np.int64) - origin, pitch), axis=1)
    path.flags.writeable = False
    return path
