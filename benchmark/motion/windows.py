"""Motion words: clips cut into overlapping windows of one length, and put together again without a trace."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmark.errors import ConfigError, ContractError
from benchmark.motion import quat

#: Names of the weightings of :func:`overlap_add`.
WEIGHTS = ("ones", "hann", "triangular")


@dataclass(frozen=True, eq=False)
class Windows:
    """A clip in windows.

    Attributes
    ----------
    array
        (N, L, ...) the windows.
    starts
        (N,) frame of the clip that row 0 of each window is; negative where a short clip is padded in front.
    mask
        (N, L) true where a row is a frame of the clip, false where it only repeats the first or last one. Leave those
        out of losses and metrics.
    frames
        T, the length of the clip.
    """

    array: NDArray[Any]
    starts: NDArray[np.int64]
    mask: NDArray[np.bool_]
    frames: int

    def __len__(self) -> int:
        return len(self.array)

    def with_array(self, array: ArrayLike) -> Windows:
        """The same cut with other contents (N, L, ...), for example the windows after a network."""
        array = np.asarray(array)
        if array.shape[:2] != self.array.shape[:2]:
            raise ContractError(f"windows of shape {self.array.shape[:2]} cannot hold contents of shape {array.shape}")
        return replace(self, array=array)


def cut(array: ArrayLike, length: int, hop: int) -> Windows:
    """Cut (T, ...) into windows.

    Windows start every ``hop`` frames; the last one ends at the last frame, so every frame is covered and none invented. A
    clip shorter than ``length`` gives one window with the clip in its middle and its first and last frames held.

    Parameters
    ----------
    array
        (T, ...), T >= 1. For quaternions, sign-continuous (:func:`benchmark.motion.quat.unroll`): signs mended after
        cutting would depend on the window.
    length, hop
        Frames, 1 <= hop <= length.

    Raises
    ------
    ConfigError
        If ``length`` or ``hop`` is out of range.
    ContractError
        If the array is empty.
    """
    array = np.asarray(array)
    if not 1 <= hop <= length:
        raise ConfigError(f"windows of {length} frames every {hop} frames leave gaps: choose 1 <= hop <= length")
    if array.ndim == 0 or len(array) == 0:
        raise ContractError("cannot cut an empty array into windows")
    frames = len(array)
    if frames >= length:
        count = -(-(frames - length) // hop) + 1
        starts = np.minimum(np.arange(count) * hop, frames - length)
    else:
        starts = np.array([-((length - frames) // 2)])
    rows = starts[:, None] + np.arange(length)
    mask = (rows >= 0) & (rows < frames)
    return Windows(array[np.clip(rows, 0, frames - 1)], starts.astype(np.int64), mask, frames)


def overlap_add(windows: Windows, *, weights: str = "ones") -> NDArray[np.float64]:
    """Put windows together by weighted average; the inverse of :func:`cut` for windows that agree.

    Each frame is the weighted mean of the rows that show it, whatever their number, so uneven coverage leaves no trace. Held
    rows are left out. Blend root velocities, never root positions, and quaternions with :func:`overlap_add_quat`.

    Parameters
    ----------
    windows
        As cut, with any contents.
    weights
        ``ones`` averages; ``hann`` and ``triangular`` favour the middle of each window and so hide its borders.

    Returns
    -------
    ndarray
        (T, ...).

    Raises
    ------
    ConfigError
        If ``weights`` is not one of :data:`WEIGHTS`.
    """
    array = np.asarray(windows.array, dtype=np.float64)
    weight = _window(weights, array.shape[1]) * windows.mask
    tail = array.shape[2:]
    total, weight_total = np.zeros((windows.frames, *tail)), np.zeros(windows.frames)
    for i, (first, last, at) in enumerate(_spans(windows)):
        total[at : at + last - first] += _spread(weight[i, first:last], array.ndim - 1) * array[i, first:last]
        weight_total[at : at + last - first] += weight[i, first:last]
    return total / _spread(weight_total, total.ndim)


def overlap_add_quat(windows: Windows, *, weights: str = "ones") -> NDArray[np.float64]:
    """Put windows of quaternions (N, L, ..., 4) together.

    Each row is brought to the hemisphere of what earlier windows said of its frame, then rows are averaged and normalised
    (nlerp; its error against slerp is under 0.3 degrees for windows that differ by 60). ``q`` and ``-q`` average to nothing.

    Returns
    -------
    ndarray
        (T, ..., 4) unit quaternions, sign-continuous from the first window's sign.
    """
    array = np.asarray(windows.array, dtype=np.float64)
    weight = _window(weights, array.shape[1])
    total = np.zeros((windows.frames, *array.shape[2:]))
    for i, (first, last, at) in enumerate(_spans(windows)):
        so_far = total[at : at + last - first]
        so_far += _spread(weight[first:last], array.ndim - 1) * quat.align(array[i, first:last], so_far)
    return quat.unroll(quat.normalize(total))


def _spans(windows: Windows) -> list[tuple[int, int, int]]:
    """Per window: first valid row, one past the last, and the frame of the first."""
    spans = []
    for start, valid in zip(windows.starts, windows.mask, strict=True):
        rows = np.flatnonzero(valid)
        spans.append((int(rows[0]), int(rows[-1]) + 1, int(start + rows[0])))
    return spans


def _window(name: str, length: int) -> NDArray[np.float64]:
    """(length,) positive weights: sampled between the zeros of the window, so that no frame is left without any."""
    middle = (np.arange(length) + 0.5) / length
    if name == "ones":
        return np.ones(length)
    if name == "hann":
        return np.sin(np.pi * middle) ** 2
    if name == "triangular":
        return 1.0 - np.abs(2.0 * middle - 1.0) + 1e-12
    raise ConfigError(f"unknown window weights {name!r}: choose from {', '.join(WEIGHTS)}")


def _spread(weight: NDArray[np.float64], ndim: int) -> NDArray[np.float64]:
    return weight.reshape(-1, *[1] * (ndim - 1))
