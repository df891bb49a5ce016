"""Windows of clips for training: every frame is held once, and windows are gathered when they are asked for."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from benchmark.motion.windows import cut


class WordBank:
    """All windows of some clips, as indices into their frames; the same windows as :func:`benchmark.motion.windows.cut`.

    Parameters
    ----------
    arrays
        Per clip (T_i, D), T_i >= 1.
    length, hop
        Frames of a window, and from one window's start to the next.
    dtype, device
        Of the frames held.

    Attributes
    ----------
    clip
        (N,) which clip each window is of.
    starts
        (N,) its first frame there; negative where a clip is shorter than a window and its first frame is held.
    """

    def __init__(
        self,
        arrays: Sequence[ArrayLike],
        length: int,
        hop: int,
        *,
        dtype: torch.dtype = torch.float32,
        device: torch.device | str = "cpu",
    ) -> None:
        self.length = length
        held = [np.asarray(array) for array in arrays]
        starts = [cut(np.empty((len(array), 0)), length, hop).starts for array in held]
        self.clip: NDArray[np.int64] = np.repeat(np.arange(len(held)), [len(each) for each in starts])
        self.starts: NDArray[np.int64] = np.concatenate(starts)
        offsets = np.concatenate([[0], np.cumsum([len(array) for array in held])])
        self.frames: Tensor = torch.empty((int(offsets[-1]), held[0].shape[1]), dtype=dtype, device=device)
        for array, offset in zip(held, offsets[:-1], strict=True):
            self.frames[offset : offset + len(array)] = torch.as_tensor(array, dtype=dtype)
        self._first = torch.as_tensor(offsets[self.clip], device=device)
        self._last = torch.as_tensor(offsets[self.clip + 1] - 1, device=device)
        self._start = self._first + torch.as_tensor(self.starts, device=device)
        self._steps = torch.arange(length, device=device)

    def __len__(self) -> int:
        return len(self.starts)

    def words(self, index: ArrayLike | Tensor) -> Tensor:
        """(B, L, D) the windows numbered ``index`` (B,)."""
        return self.frames[self._rows(index)[0]]

    def mask(self, index: ArrayLike | Tensor) -> Tensor:
        """(B, L) true where a row of a window is a frame of its clip, false where it holds the first or last one."""
        return self._rows(index)[1]

    def _rows(self, index: ArrayLike | Tensor) -> tuple[Tensor, Tensor]:
        chosen = torch.as_tensor(index, device=self.frames.device)
        rows = self._start[chosen, None] + self._steps
        first, last = self._first[chosen, None], self._last[chosen, None]
        return torch.clamp(rows, first, last), (rows >= first) & (rows <= last)
