"""Space warp: the scale and offset of every input frame that best explain the output, for a given time warp.

With the time warp ``W`` fixed, the objective of iterative motion warping (Hsu, Pulli and Popovic 2005, "Style translation for
human motion"; Dong, Aloba, Anthony and Jain 2018, eq. 1) is quadratic in the scales ``a`` and offsets ``b`` of a channel::

    ||W (U a + b) - v||^2 + ||F a||^2 + ||G b||^2 + ridge (||a - 1||^2 + ||b||^2)

with ``U = diag(u)`` and ``F``, ``G`` finite differences times the square roots of their weights. Its normal equations are ::

    [ U C U + F'F + ridge    U C               ] [a]   [ U W'v + ridge ]
    [ C U                    C + G'G + ridge   ] [b] = [ W'v           ]

where ``C = W'W`` is the diagonal of how often each frame is used. Dong et al. print the upper right block of their eq. 2 as
``U W'W U``; it has to be ``U W'W``, or the matrix is not symmetric and not the gradient of the objective.

Written frame by frame, ``a_1 b_1 a_2 b_2 …``, the matrix is symmetric, positive definite (by the ridge) and, for differences
of a given order, zero beyond twice that many diagonals: a banded Cholesky factorisation solves it in time and memory
proportional to the number of frames. The unknowns solved for are ``a - 1`` and ``b``, whose right-hand side is a sum of plain
differences ``v - u``: an output equal to its input is met exactly.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import ContractError

SOLVERS = ("banded", "dense")

#: Unknowns that go to the banded solver in one call. Channels are stacked up to here: a call costs more than a short channel.
_STACK = 1 << 17


def difference_bands(frames: int, order: int) -> NDArray[np.float64]:
    """Diagonals of ``D'D`` for the finite-difference operator ``D`` of the given order.

    Parameters
    ----------
    frames
        Length of the sequences that ``D`` is applied to. Up to ``order`` frames there are no differences and all is zero.
    order
        1 for first differences, 2 for second, and so on.

    Returns
    -------
    numpy.ndarray
        (order + 1, frames); row ``k`` holds at ``i`` the element ``(i + k, i)``, and zero where that is outside the matrix.
    """
    weights = np.array([1.0])
    for _ in range(order):
        weights = np.convolve(weights, [-1.0, 1.0])
    bands = np.zeros((order + 1, frames))
    count = frames - order
    if count > 0:
        for k in range(order + 1):
            for j in range(order + 1 - k):
                bands[k, j : j + count] += weights[j] * weights[j + k]
    return bands


def roughness(values: NDArray[np.float64], order: int) -> float:
    """Sum of the squared finite differences of the given order along the first axis."""
    difference = np.diff(values, n=order, axis=0)
    return float(np.vdot(difference, difference))


def frame_sums(values: NDArray[np.float64], path: NDArray[np.int64], frames: int) -> NDArray[np.float64]:
    """``W' values``: for each of the ``frames`` input frames the sum of the output rows that use it.

    Parameters
    ----------
    values
        (T', d) rows of output frames.
    path
        (T',) input frame of each, non-decreasing.
    frames
        Number of input frames.

    Returns
    -------
    numpy.ndarray
        (frames, d); zero for frames that are not used.
    """
    starts = np.flatnonzero(np.diff(path, prepend=-1))
    sums = np.zeros((frames, values.shape[1]))
    sums[path[starts]] = np.add.reduceat(values, starts, axis=0)
    return sums


def space_warp(
    u: NDArray[np.float64],
    v: NDArray[np.float64],
    path: NDArray[np.int64],
    *,
    smooth_scale: float,
    smooth_offset: float,
    ridge: float,
    difference_order: int = 1,
    solver: str = "banded",
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Minimise the objective over scales and offsets, each channel on its own.

    Parameters
    ----------
    u
        (T, d) input frames.
    v
        (T', d) output frames.
    path
        (T',) non-decreasing input frame of each output frame.
    smooth_scale, smooth_offset
        Weights of the squared differences of scales and offsets, at least 0.
    ridge
        Weight of the pull towards scale 1 and offset 0, above 0. It decides frames and directions that nothing else does: a
        channel that is constant over the used frames cannot tell a scale from an offset.
    difference_order
        Order of the differences.
    solver
        ``banded``, or ``dense`` for the general LU factorisation of the whole (2T, 2T) matrix of every channel, which is how
        the published equations read: the same result for ``T^3`` time and ``T^2`` memory.

    Returns
    -------
    scale, offset
        (T, d) each. Frames that no output frame uses are interpolated by the smoothness terms.

    Raises
    ------
    ContractError
        If the matrix is not positive definite in float64: the ridge is too small beside the smoothness weights or the
        squared values of a channel.
    """
    solve = {"banded": _solve_banded, "dense": _solve_dense}[solver]
    frames = len(u)
    count = np.bincount(path, minlength=frames).astype(np.float64)
    # The right-hand side for a - 1 and b; the channels come first, so that each is one run of memory.
    miss = np.ascontiguousarray(frame_sums(v - u[path], path, frames).T)
    bands = difference_bands(frames, difference_order)
    scale, offset = solve(np.ascontiguousarray(u.T), miss, count, smooth_scale * bands, smooth_offset * bands, ridge)
    scale += 1.0
    return np.ascontiguousarray(scale.T), np.ascontiguousarray(offset.T)


def _solve_banded(
    u: NDArray[np.float64],
    miss: NDArray[np.float64],
    count: NDArray[np.float64],
    scale_bands: NDArray[np.float64],
    offset_bands: NDArray[np.float64],
    ridge: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Banded Cholesky on channels stacked into one block-diagonal system at a time.

    The lower triangle is kept by columns, and the last columns of a channel reach no further than its own end, which makes the
    stack of the channels' storages the storage of the stack.
    """
    from scipy.linalg.lapack import dpbsv

    channels, frames = u.shape
    order = len(scale_bands) - 1
    width = 2 * order + 1
    solution = np.empty((channels, frames, 2))
    group = max(1, _STACK // (2 * frames))
    for first in range(0, channels, group):
        some = u[first : first + group]
        matrix = np.zeros((len(some), frames, 2, width))
        right = solution[first : first + group]
        used = count * some
        matrix[:, :, 0, 0] = used * some + (scale_bands[0] + ridge)
        matrix[:, :, 1, 0] = count + offset_bands[0] + ridge
        matrix[:, :, 0, 1] = used
        for k in range(1, order + 1):
            matrix[:, :, 0, 2 * k] = scale_bands[k]
            matrix[:, :, 1, 2 * k] = offset_bands[k]
        right[:, :, 1] = miss[first : first + group]
        np.multiply(some, right[:, :, 1], out=right[:, :, 0])
        flat = right.reshape(-1)
        _, _, info = dpbsv(matrix.reshape(-1, width).T, flat, lower=1, overwrite_ab=1, overwrite_b=1)
        if info:
            raise _indefinite(ridge, first + (info - 1) // (2 * frames))
    return solution[:, :, 0], solution[:, :, 1]


def _solve_dense(
    u: NDArray[np.float64],
    miss: NDArray[np.float64],
    count: NDArray[np.float64],
    scale_bands: NDArray[np.float64],
    offset_bands: NDArray[np.float64],
    ridge: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """LU factorisation of the whole matrix, all scales before all offsets, one channel at a time."""
    from scipy.linalg import lu_factor, lu_solve

    channels, frames = u.shape
    solution = np.empty((channels, 2, frames))
    for channel in range(channels):
        factors = lu_factor(
            dense_matrix(u[channel], count, scale_bands, offset_bands, ridge), overwrite_a=True, check_finite=False
        )
        if not np.all(np.diag(factors[0])):
            raise _indefinite(ridge, channel)
        right = np.concatenate([u[channel] * miss[channel], miss[channel]])
        solution[channel] = lu_solve(factors, right, check_finite=False).reshape(2, frames)
    return solution[:, 0], solution[:, 1]


def dense_matrix(
    u: NDArray[np.float64],
    count: NDArray[np.float64],
    scale_bands: NDArray[np.float64],
    offset_bands: NDArray[np.float64],
    ridge: float,
) -> NDArray[np.float64]:
    """The (2T, 2T) matrix of the normal equations of one channel, all scales before all offsets, in Fortran order.

    Parameters
    ----------
    u, count
        (T,) values of the channel and how often each frame is used.
    scale_bands, offset_bands
        (order + 1, T) weighted diagonals of :func:`difference_bands`.
    ridge
        Weight of the pull towards the identity.
    """
    frames = len(u)
    matrix = np.zeros((2 * frames, 2 * frames), order="F")
    diagonal = np.arange(frames)
    for k in range(min(len(scale_bands), frames)):
        here, there = diagonal[: frames - k], diagonal[k:]
        for block, bands in ((0, scale_bands), (frames, offset_bands)):
            matrix[block + there, block + here] = matrix[block + here, block + there] = bands[k, : frames - k]
    matrix[diagonal, diagonal] += count * u * u + ridge
    matrix[frames + diagonal, frames + diagonal] += count + ridge
    matrix[diagonal, frames + diagonal] = matrix[frames + diagonal, diagonal] = count * u
    return matrix


def _indefinite(ridge: float, channel: int) -> ContractError:
    return ContractError(
        f"the space warp of channel {channel} is not definite in double precision: a ridge of {ridge:g} is too small beside "
        "its smoothness weights and squared values; standardise the channels or raise the ridge"
    )
