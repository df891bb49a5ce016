"""The autoencoder: one convolution, rectified and max-pooled, and one convolution back. Importing this imports torch."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from methods._torch.device import dropout


class Autoencoder(nn.Module):
    """Holden et al. 2016, section 4: ``encode`` is pool(relu(x * W + b)), ``decode`` is unpool(h) * W' + b'.

    Everything is on (N, channels, frames); the encoder halves the number of frames, which must be even. Convolutions are
    padded with zeros to keep the length: in normalised channels zero is the mean.

    Parameters
    ----------
    channels
        D.
    filters
        Hidden units.
    width
        Frames that a filter spans, odd.
    """

    def __init__(self, channels: int, filters: int, width: int) -> None:
        super().__init__()
        self.encoder = nn.Conv1d(channels, filters, width, padding=width // 2)
        self.decoder = nn.Conv1d(filters, channels, width, padding=width // 2)
        for layer in (self.encoder, self.decoder):
            nn.init.xavier_uniform_(layer.weight)
            nn.init.zeros_(layer.bias)  # type: ignore[arg-type]

    def encode(self, x: Tensor) -> Tensor:
        """(N, filters, T / 2) hidden units of (N, D, T)."""
        return functional.max_pool1d(functional.relu(self.encoder(x)), 2)

    def decode(self, hidden: Tensor) -> Tensor:
        """(N, D, T) of (N, filters, T / 2): what :meth:`decode_noisy` gives on average."""
        return self.decoder(unpool(hidden))

    def decode_noisy(self, hidden: Tensor, share: float, generator: torch.Generator) -> Tensor:
        """The decoder in training: every value goes to one frame of its pair, drawn at random, and ``share`` is dropped."""
        return self.decoder(dropout(random_unpool(hidden, generator), share, generator))

    def loss(self, x: Tensor, valid: Tensor, *, share: float, sparsity: float, generator: torch.Generator) -> Tensor:
        """Mean squared reconstruction error of a noisy pass, and ``sparsity`` times the mean magnitude of the weights.

        Parameters
        ----------
        x
            (N, D, T).
        valid
            (N, T) which frames count.
        share
            Of the inputs, and of the hidden units, that are dropped.
        sparsity
            Weight of ``mean |W| + mean |W'|`` over 2.
        generator
            Of the noise.
        """
        back = self.decode_noisy(self.encode(dropout(x, share, generator)), share, generator)
        error = ((back - x).square().mean(dim=1) * valid).sum() / valid.sum()
        return error + sparsity * 0.5 * (self.encoder.weight.abs().mean() + self.decoder.weight.abs().mean())


def unpool(hidden: Tensor) -> Tensor:
    """(N, F, 2 T) from (N, F, T): each value shared evenly by its two frames."""
    return 0.5 * hidden.repeat_interleave(2, dim=-1)


def random_unpool(hidden: Tensor, generator: torch.Generator) -> Tensor:
    """(N, F, 2 T) from (N, F, T): each value in one of its two frames, drawn at random, and zero in the other."""
    first = torch.rand(hidden.shape, generator=generator, device=hidden.device) < 0.5
    return torch.stack((hidden * first, hidden * ~first), dim=-1).flatten(-2)
