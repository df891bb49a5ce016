"""Training the denoising autoencoder of the motion encoder. Importing this imports torch."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

#: Windows in an optimiser step, frames of a window, and the highest learning rate.
BATCH, FRAMES, RATE = 32, 60, 1e-3

#: Standard deviation of the noise on standardised channels, and share of channels that are hidden from the encoder.
NOISE, HIDDEN_SHARE = 0.2, 0.1


class Autoencoder(nn.Module):
    """Two convolutions, each rectified and max-pooled by 2, and two back.

    Parameters
    ----------
    channels
        D of the (N, D, T) input.
    units
        Hidden units of both layers.
    widths
        Frames that the filters of the two layers span, odd.
    generator
        Of the initial weights.
    """

    def __init__(self, channels: int, units: int, widths: tuple[int, int], generator: torch.Generator) -> None:
        super().__init__()
        first, second = widths
        self.first = nn.Conv1d(channels, units, first, padding=first // 2)
        self.second = nn.Conv1d(units, units, second, padding=second // 2)
        self.back = nn.Conv1d(units, units, second, padding=second // 2)
        self.out = nn.Conv1d(units, channels, first, padding=first // 2)
        for layer in (self.first, self.second, self.back, self.out):
            nn.init.xavier_uniform_(layer.weight, generator=generator)
            nn.init.zeros_(layer.bias)  # type: ignore[arg-type]

    def forward(self, x: Tensor) -> Tensor:
        """(N, D, T) of (N, D, T); T a multiple of 4."""
        hidden = functional.max_pool1d(functional.relu(self.first(x)), 2)
        hidden = functional.max_pool1d(functional.relu(self.second(hidden)), 2)
        hidden = functional.relu(self.back(functional.interpolate(hidden, scale_factor=2.0)))
        return self.out(functional.interpolate(hidden, scale_factor=2.0))


def train(
    sequences: Sequence[NDArray[np.float32]],
    *,
    units: int,
    widths: tuple[int, int],
    steps: int,
    rng: np.random.Generator,
    report: Callable[[float, str], None],
) -> dict[str, NDArray[np.float32]]:
    """Learn to reconstruct windows of standardised sequences from noisy and incomplete ones.

    Windows are drawn at any offset, from a sequence in proportion to how many it has. Sequences shorter than a window are
    followed by zeros, the mean, which do not count in the loss. One thread computes, so that the weights do not depend on how
    many there are.

    Parameters
    ----------
    sequences
        (T, D) each.
    units, widths
        See :class:`Autoencoder`.
    steps
        Optimiser steps.
    rng
        Of weights, windows and noise.
    report
        ``report(fraction, message)``.

    Returns
    -------
    weights
        ``first/weight`` (units, D, width), ``first/bias`` (units,), and those of ``second``: the encoder.
    """
    generator = torch.Generator().manual_seed(int(rng.integers(2**63)))
    padded = [np.pad(each, ((0, max(0, FRAMES - len(each))), (0, 0))) for each in sequences]
    valid = [np.arange(len(long)) < len(short) for long, short in zip(padded, sequences, strict=True)]
    starts = np.array([len(each) - FRAMES + 1 for each in padded])
    share = starts / starts.sum()
    with _one_thread():
        network = Autoencoder(padded[0].shape[1], units, widths, generator)
        optimiser = torch.optim.Adam(network.parameters(), lr=RATE)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
        for step in range(steps):
            chosen = rng.choice(len(padded), BATCH, p=share)
            offsets = rng.integers(starts[chosen])
            spans = [(clip, slice(at, at + FRAMES)) for clip, at in zip(chosen, offsets, strict=True)]
            clean = torch.from_numpy(np.stack([padded[clip][span].T for clip, span in spans]))
            counts = torch.from_numpy(np.stack([valid[clip][span] for clip, span in spans])).float()
            noisy = clean + NOISE * torch.randn(clean.shape, generator=generator)
            shown = torch.rand(clean.shape[:2], generator=generator) >= HIDDEN_SHARE
            error = (network(noisy * shown[..., None]) - clean).square().mean(dim=1)
            loss = (error * counts).sum() / counts.sum()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
            report((step + 1) / steps, f"motion encoder: error {loss.item():.3f}")
    layers = {"first": network.first, "second": network.second}
    return {
        f"{name}/{kind}": tensor.detach().numpy().copy()
        for name, layer in layers.items()
        for kind, tensor in layer.named_parameters()
    }


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
