"""The triangular factor of a tall matrix that is never held as a whole."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class TriangularFactor:
    """``R`` of the QR factorisation of rows that arrive in batches; ``Q`` is not formed.

    Each batch is stacked below the factor so far and factored by Householder reflections (sequential QR, as in SLICOT's
    IB01MD): as accurate as one factorisation of everything, in memory of a few times ``width^2``.

    Parameters
    ----------
    width
        Number of columns.
    """

    def __init__(self, width: int) -> None:
        self.width = width
        self.rows = 0
        self._factor = np.zeros((0, width))
        self._waiting: list[Array] = []
        self._held = 0

    @property
    def batch(self) -> int:
        """Rows from which on waiting rows are worked in: enough that the old factor on top costs little."""
        return max(4 * self.width, 2048)

    def add(self, rows: Array) -> None:
        """Work in (k, width) more rows."""
        self.rows += len(rows)
        for begin in range(0, len(rows), self.batch):
            part = rows[begin : begin + self.batch]
            self._waiting.append(part)
            self._held += len(part)
            if self._held >= self.batch:
                self._reduce()

    def factor(self) -> Array:
        """(width, width) upper triangular factor of all rows so far; zero rows where there were fewer than ``width``."""
        if self._waiting:
            self._reduce()
        result = np.zeros((self.width, self.width))
        result[: len(self._factor)] = self._factor
        return result

    def _reduce(self) -> None:
        from scipy.linalg import lapack

        stacked = np.empty((len(self._factor) + self._held, self.width), order="F")
        stacked[: len(self._factor)] = self._factor
        begin = len(self._factor)
        for part in self._waiting:
            stacked[begin : begin + len(part)] = part
            begin += len(part)
        self._waiting, self._held = [], 0
        if not self.width or not len(stacked):
            return
        # 32 is a block size good for any width here; asking LAPACK would cost a call.
        factored, _, _, _ = lapack.dgeqrf(stacked, lwork=32 * self.width, overwrite_a=1)
        self._factor = np.triu(factored[: self.width])
