"""The triangular factor of large block Hankel matrices from their covariance, which has few different entries."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from methods.hsu.lti.records import Records

Array = NDArray[np.float64]

#: Reciprocal condition number of the covariance below which the result would not be trusted.
_LEAST_CONDITION = 1e-9


def covariance(records: Records, block_rows: int) -> Array:
    """(2 i, 2 i, m + l, m + l) sums over all Hankel columns of ``z[t + a] z[t + b]^T``, ``z = (u, y)``.

    Along a diagonal neighbouring blocks differ by one frame that enters and one that leaves, so that only the first block row
    is summed over the whole record.
    """
    from numpy.lib.stride_tricks import sliding_window_view

    m, p = records.channels
    width, channels = 2 * block_rows, m + p
    result = np.zeros((width, width, channels, channels))
    for u, y in zip(records.inputs, records.outputs, strict=True):
        count = len(u) - width + 1
        if count < 1:
            continue
        z = np.concatenate([u, y], axis=1)
        head, tail = z[:width], z[count:]
        # All lags of the first block row in one product: (channels, 2 i channels).
        first = np.zeros((channels, width * channels))
        for begin in range(0, count, 4096):
            stop = min(count, begin + 4096)
            windows = sliding_window_view(z[begin : stop + width - 1], width, axis=0).transpose(0, 2, 1)
            first += z[begin:stop].T @ windows.reshape(stop - begin, width * channels)
        lags = first.reshape(channels, width, channels).transpose(1, 0, 2)
        for lag in range(width):
            size = width - lag
            change = np.zeros((size, channels, channels))
            change[1:] = tail[: size - 1, :, None] * tail[lag : width - 1, None, :]
            change[1:] -= head[: size - 1, :, None] * head[lag : width - 1, None, :]
            rows = np.arange(size)
            result[rows, rows + lag] += lags[lag] + np.cumsum(change, axis=0)
    lower, upper = np.tril_indices(width, -1)
    result[lower, upper] = result[upper, lower].transpose(0, 2, 1)
    return result


def covariance_factor(records: Records, block_rows: int) -> Array | None:
    """Triangular factor, rows and columns in the order future inputs, past inputs, past outputs, future outputs.

    SLICOT's IB01MD offers the same choice ("Cholesky algorithm on the correlation matrix"), and falls back in the same way.
    The rows of the future outputs, which nothing needs, are left out.

    Returns
    -------
    array or None
        ``None`` where the covariance is too badly conditioned for a Cholesky factorisation to be as good as reflections; a
        record without noise always is.
    """
    from scipy.linalg import lapack, solve_triangular

    m, p = records.channels
    i = block_rows
    blocks = covariance(records, i)
    u, y = slice(0, m), slice(m, m + p)
    past, future = slice(0, i), slice(i, 2 * i)
    parts = ((future, u), (past, u), (past, y), (future, y))
    gram = np.block(
        [
            [
                blocks[rows, columns, left, right]
                .transpose(0, 2, 1, 3)
                .reshape(i * (left.stop - left.start), i * (right.stop - right.start))
                for columns, right in parts
            ]
            for rows, left in parts[:3]
        ]
    )
    known = i * (2 * m + p)
    leading = np.asfortranarray(gram[:, :known])
    norm = np.abs(leading).sum(axis=0).max(initial=0.0)
    factored, info = lapack.dpotrf(leading, lower=0, clean=1)
    if info or not np.isfinite(norm) or lapack.dpocon(factored, norm)[0] < _LEAST_CONDITION:
        return None
    gram[:, :known] = factored
    gram[:, known:] = solve_triangular(factored, gram[:, known:], trans="T", check_finite=False)
    return gram
