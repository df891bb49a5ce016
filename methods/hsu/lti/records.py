"""The experiments a model is identified from: checked, in units of their own size, split, padded."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmark.errors import ContractError, DataError

Array = NDArray[np.float64]

#: One recording, frames by channels, or several of any lengths.
Recordings = ArrayLike | Sequence[ArrayLike]


class RankDeficientWarning(UserWarning):
    """The record does not determine a model of the order asked for; what is returned is one of many that fit."""


class IdentificationWarning(UserWarning):
    """Something was done otherwise than asked: fewer block rows, a lower order, another method."""


def _listed(values: Recordings, name: str) -> list[Array]:
    many = isinstance(values, (list, tuple)) and bool(values) and np.ndim(values[0]) >= 1 and np.ndim(values[0]) != 0
    if many and all(np.ndim(value) == 1 for value in values):  # type: ignore[union-attr]
        # A nested list of frames, not a list of recordings.
        many = False
    arrays = [np.asarray(value, dtype=np.float64) for value in (values if many else [values])]  # type: ignore[union-attr]
    if isinstance(values, (list, tuple)) and not values:
        raise DataError(f"identification: no {name} at all; give at least one recording")
    for index, array in enumerate(arrays):
        if array.ndim != 2:
            raise ContractError(f"identification: {name} {index} must be (frames, channels), not {array.shape}")
        if not np.isfinite(array).all():
            frame, channel = np.argwhere(~np.isfinite(array))[0]
            raise DataError(
                f"identification: {name} {index} holds {array[frame, channel]} at frame {frame}, channel {channel}; "
                "fill or drop such frames first"
            )
    return arrays


@dataclass(frozen=True)
class Records:
    """Several input-output recordings of one system, each of which starts from rest.

    Attributes
    ----------
    inputs, outputs
        Lists of (T_k, m) and (T_k, l) arrays, none of them empty.
    """

    inputs: list[Array]
    outputs: list[Array]

    @classmethod
    def of(cls, inputs: Recordings, outputs: Recordings) -> Records:
        """Check and pair recordings.

        Raises
        ------
        ContractError
            If shapes, lengths or numbers of recordings do not fit together.
        DataError
            If there is no frame, or a value is not finite.
        """
        first, second = _listed(inputs, "inputs"), _listed(outputs, "outputs")
        if len(first) != len(second):
            raise ContractError(f"identification: {len(first)} recordings of inputs but {len(second)} of outputs")
        for index, (u, y) in enumerate(zip(first, second, strict=True)):
            if len(u) != len(y):
                raise ContractError(f"identification: recording {index} has {len(u)} input but {len(y)} output frames")
            if u.shape[1] != first[0].shape[1] or y.shape[1] != second[0].shape[1]:
                raise ContractError(f"identification: recording {index} has other channels than recording 0")
        if not first[0].shape[1] or not second[0].shape[1]:
            raise ContractError("identification: there must be at least one input and one output channel")
        kept = [index for index, u in enumerate(first) if len(u)]
        if not kept:
            raise DataError("identification: the recordings hold no frame")
        return cls([first[index] for index in kept], [second[index] for index in kept])

    def __len__(self) -> int:
        return len(self.inputs)

    @property
    def channels(self) -> tuple[int, int]:
        """Number of input and of output channels, ``(m, l)``."""
        return self.inputs[0].shape[1], self.outputs[0].shape[1]

    @property
    def lengths(self) -> list[int]:
        """Frames of each recording."""
        return [len(u) for u in self.inputs]

    @property
    def frames(self) -> int:
        """Frames of all recordings together."""
        return sum(self.lengths)

    def scales(self) -> tuple[Array, Array]:
        """(m,) and (l,) root mean squares of the channels; 1 for a channel that is zero throughout."""
        return _size(self.inputs), _size(self.outputs)

    def scaled(self, input_scale: Array, output_scale: Array) -> Records:
        """The recordings with each channel divided by its scale."""
        return Records([u / input_scale for u in self.inputs], [y / output_scale for y in self.outputs])

    def chosen(self, indices: Sequence[int]) -> Records:
        """Some of the recordings."""
        return Records([self.inputs[index] for index in indices], [self.outputs[index] for index in indices])

    def batches(self, room: int) -> Iterator[tuple[Array, Array, NDArray[np.bool_]]]:
        """Recordings padded with zeros to a common length, a few at a time.

        Parameters
        ----------
        room
            Padded frames a batch may hold; a longer recording is a batch of its own.

        Yields
        ------
        tuple of arrays
            (E, T, m) inputs, (E, T, l) outputs and (E, T) which frames are real.
        """
        order = sorted(range(len(self)), key=self.lengths.__getitem__)
        while order:
            batch = [order.pop()]
            longest = len(self.inputs[batch[0]])
            while order and (len(batch) + 1) * longest <= room and 2 * len(self.inputs[order[-1]]) >= longest:
                batch.append(order.pop())
            m, p = self.channels
            u, y = np.zeros((len(batch), longest, m)), np.zeros((len(batch), longest, p))
            real = np.zeros((len(batch), longest), dtype=bool)
            for row, index in enumerate(batch):
                length = len(self.inputs[index])
                u[row, :length], y[row, :length], real[row, :length] = self.inputs[index], self.outputs[index], True
            yield u, y, real


def _size(arrays: list[Array]) -> Array:
    count = sum(len(array) for array in arrays)
    # The largest magnitude goes out first, so that squares neither overflow nor vanish.
    peak = np.max([np.abs(array).max(axis=0) for array in arrays], axis=0)
    safe = np.where(peak > 0.0, peak, 1.0)
    mean = np.sum([np.einsum("tc,tc->c", array / safe, array / safe) for array in arrays], axis=0) / count
    return np.where(peak > 0.0, safe * np.sqrt(mean), 1.0)
