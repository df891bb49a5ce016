"""Training the convolutional autoencoder of Holden et al., beside the same network from torch's own modules."""

from __future__ import annotations

from typing import Any

import torch
from timing import Job, collect, interleaved, rows
from torch import nn

from methods.holden.network import Autoencoder

#: The paper's sizes: 73 channels, 256 hidden units, filters of 25 frames, windows of 240.
CHANNELS, FILTERS, WIDTH, FRAMES, BATCH, REPEATS = 73, 256, 25, 240, 8, 5
SHARE = 0.25
#: Side of the matrices whose product is the yardstick.
SQUARE = 1024


class Case:
    """A batch of noise."""

    def __init__(self, channels: int, filters: int, width: int, frames: int, batch: int) -> None:
        self.sizes = channels, filters, width
        self.batch = torch.randn(batch, channels, frames, generator=torch.Generator().manual_seed(3))

    def network(self) -> Autoencoder:
        """Ours, always from the same weights."""
        torch.manual_seed(0)
        return Autoencoder(*self.sizes)

    def ours(self) -> Job:
        network, noise = self.network(), torch.Generator().manual_seed(1)
        optimizer = torch.optim.Adam(network.parameters(), lr=1e-3)
        valid = torch.ones(len(self.batch), self.batch.shape[-1])

        def job() -> float:
            loss = network.loss(self.batch, valid, share=SHARE, sparsity=0.0, generator=noise)
            optimizer.zero_grad(set_to_none=True)
            loss.backward()
            optimizer.step()
            return float(loss.detach())

        return job

    def flops(self) -> float:
        """Arithmetic of the convolutions: one pass forward and two products backward, the first without its input's."""
        channels, filters, width = self.sizes
        count, _, frames = self.batch.shape
        return 2.0 * count * frames * channels * filters * width * 5


def _modules(case: Case) -> Job:
    """The same layers as modules; unpooling shares a value evenly, without the random choice of the paper."""
    channels, filters, width = case.sizes
    network = nn.Sequential(
        nn.Dropout(SHARE),
        nn.Conv1d(channels, filters, width, padding=width // 2),
        nn.ReLU(),
        nn.MaxPool1d(2),
        nn.Upsample(scale_factor=2),
        nn.Dropout(SHARE),
        nn.Conv1d(filters, channels, width, padding=width // 2),
    )
    expected = case.network()
    with torch.no_grad():
        for mine, theirs in ((network[1], expected.encoder), (network[6], expected.decoder)):
            mine.load_state_dict(theirs.state_dict())
        network[6].weight.mul_(0.5)  # Upsample repeats where ours halves
        quiet = network.eval()(case.batch)
        if not torch.allclose(quiet, expected.decode(expected.encode(case.batch)), atol=1e-4):
            raise ValueError("its reconstruction differs from ours")
    network.train()
    optimizer = torch.optim.Adam(network.parameters(), lr=1e-3)

    def job() -> float:
        loss = nn.functional.mse_loss(network(case.batch), case.batch)
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        optimizer.step()
        return float(loss.detach())

    return job


def run(
    console: Any,
    *,
    channels: int = CHANNELS,
    filters: int = FILTERS,
    width: int = WIDTH,
    frames: int = FRAMES,
    batch: int = BATCH,
    repeats: int = REPEATS,
) -> list[dict[str, Any]]:
    """Time updates; the floor is the convolutions' arithmetic at the pace of one large matrix product."""
    case = Case(channels, filters, width, frames, batch)
    side = torch.randn(SQUARE, SQUARE)
    jobs, missing = collect({"torch modules": _modules}, case, console=console)
    taken = interleaved({"ours": case.ours(), **jobs, "product": lambda: side @ side}, repeats=repeats)
    taken["floor: the products"] = case.flops() / (2.0 * SQUARE**3) * taken.pop("product")
    return rows("Autoencoder training", taken, missing, work=float(batch), unit="windows/s")
