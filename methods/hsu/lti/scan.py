"""The linear recurrence ``x[t+1] = A x[t] + v[t]`` for many sequences at once, without a loop over every frame of every one."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Sequences from which on one product per frame keeps the processor busy by itself.
_WIDE = 48


def powers(a: Array, count: int) -> Array:
    """(count, n, n) ``A^0 … A^(count - 1)``, by doubling: ``log2(count)`` batched products."""
    order = len(a)
    result = np.empty((count, order, order))
    if count:
        result[0] = np.eye(order)
    if count > 1:
        result[1] = a
    done = min(2, count)
    while done < count:
        more = min(done - 1, count - done)
        # A^(done - 1) is the highest there is; times A^1 … A^more it gives the next ones.
        result[done : done + more] = result[done - 1] @ result[1 : more + 1]
        done += more
    return result


def propagate(a: Array, drive: Array, start: Array | None = None) -> tuple[Array, Array]:
    """States of ``x[t+1] = A x[t] + v[t]`` for a batch of sequences.

    A narrow batch is cut into blocks of about ``sqrt(T)`` frames. All blocks run from zero in step with each other, the states
    at the seams follow from ``A^L``, and one product adds what each seam contributes to the frames behind it: ``2 sqrt(T)``
    small calls instead of ``T``, with twice the arithmetic. A wide batch goes frame by frame.

    Parameters
    ----------
    a
        (n, n) transition matrix.
    drive
        (S, T, n) what is added to the state after each frame.
    start
        (S, n) state at frame 0; zero if omitted.

    Returns
    -------
    tuple of arrays
        (S, T, n) states, the first of which is ``start``, and (S, n) the state after the last frame.
    """
    count, frames, order = drive.shape
    first = np.zeros((count, order)) if start is None else np.asarray(start, dtype=np.float64)
    states = np.empty((count, frames, order))
    if not order or not frames:
        return states, first.copy()
    transposed = np.ascontiguousarray(a.T)
    if count >= _WIDE or frames < 8:
        current = first
        for frame in range(frames):
            states[:, frame] = current
            current = current @ transposed + drive[:, frame]
        return states, current

    length = max(2, round(math.sqrt(frames / 2.0)))
    blocks = -(-frames // length)
    padded = np.zeros((count, blocks * length, order))
    padded[:, :frames] = drive
    steps = np.ascontiguousarray(padded.reshape(count * blocks, length, order).transpose(1, 0, 2))
    local = np.zeros((length, count * blocks, order))
    for step in range(1, length):
        np.matmul(local[step - 1], transposed, out=local[step])
        local[step] += steps[step - 1]
    ends = (local[-1] @ transposed + steps[-1]).reshape(count, blocks, order)

    rises = powers(transposed, length + 1)
    seams = np.empty((count, blocks, order))
    current = first
    for block in range(blocks):
        seams[:, block] = current
        current = current @ rises[length] + ends[:, block]
    whole = local.transpose(1, 0, 2).reshape(count * blocks, length * order)
    whole += seams.reshape(count * blocks, order) @ rises[:length].transpose(1, 0, 2).reshape(order, length * order)
    states = whole.reshape(count, blocks * length, order)[:, :frames]
    last = states[:, -1] @ transposed + drive[:, -1]
    return states, last
