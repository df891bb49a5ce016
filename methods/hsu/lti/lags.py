"""Recordings reduced to the triangular factor of their lagged inputs and their outputs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from methods.hsu.lti.records import Records
from methods.hsu.lti.triangular import TriangularFactor

Array = NDArray[np.float64]

#: Rows of a batch of regressors.
_BATCH = 4096


def lag_factor(records: Records, taps: int) -> Array:
    """(m taps + l, m taps + l) triangular factor of (inputs ``u[t], u[t-1], …``, outputs); frames before a recording are zero.

    Everything that a least-squares fit of a response of that length can ask of a record. With as many taps as the longest
    recording has frames, that is any response.
    """
    from numpy.lib.stride_tricks import sliding_window_view

    m, p = records.channels
    factor = TriangularFactor(m * taps + p)
    for u, y in zip(records.inputs, records.outputs, strict=True):
        padded = np.concatenate([np.zeros((taps - 1, m)), u])
        windows = sliding_window_view(padded, taps, axis=0)[:, :, ::-1].transpose(0, 2, 1)
        for begin in range(0, len(u), _BATCH):
            part = windows[begin : begin + _BATCH].reshape(-1, m * taps)
            factor.add(np.concatenate([part, y[begin : begin + _BATCH]], axis=1))
    return factor.factor()
