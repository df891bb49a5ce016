"""A small temporal convolution network with a head for the style and one for the action. Importing this imports torch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from benchmark.motion.windows import cut
from eval.probes.temporal import Settings

Array = NDArray[np.float64]


class TemporalNetwork(nn.Module):
    """Convolutions over time, the mean and deviation of what they find, and a linear map to each set of scores.

    Frames that only fill up a short clip have no part in mean and deviation.

    Parameters
    ----------
    columns, channels
        D and width.
    styles, actions
        Numbers of scores.
    """

    def __init__(self, columns: int, channels: int, styles: int, actions: int, dropout: float = 0.0) -> None:
        super().__init__()
        self.dropout = dropout
        self.enter = nn.Conv1d(columns, channels, 1)
        self.first = nn.Conv1d(channels, channels, 5, stride=2, padding=2)
        self.second = nn.Conv1d(channels, channels, 5, stride=2, padding=2)
        self.third = nn.Conv1d(channels, channels, 3, padding=2, dilation=2)
        self.norms = nn.ModuleList(nn.LayerNorm(channels) for _ in range(3))
        self.style = nn.Linear(2 * channels, styles)
        self.action = nn.Linear(2 * channels, actions)

    def forward(self, x: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
        """Scores (B, styles) and (B, actions) of windows ``x`` (B, L, D); ``mask`` (B, L) is 0 on frames made up."""
        drop = self.dropout if self.training else 0.0
        h = functional.relu(self.enter(x.transpose(1, 2)))
        h = functional.dropout(self._normed(0, self.first(h)), drop)
        h = functional.dropout(self._normed(1, self.second(h)), drop)
        h = h + self._normed(2, self.third(h))
        kept = mask[:, None, ::4]
        total = kept.sum(-1).clamp_min(1.0)
        mean = (h * kept).sum(-1) / total
        spread = (((h - mean[..., None]) ** 2 * kept).sum(-1) / total + 1e-4).sqrt()
        pooled = functional.dropout(torch.cat((mean, spread), dim=-1), drop)
        return self.style(pooled), self.action(pooled)

    def _normed(self, index: int, h: Tensor) -> Tensor:
        # Over the channels of each moment by itself: over time as well, frames made up would reach all others.
        return functional.relu(self.norms[index](h.transpose(1, 2)).transpose(1, 2))


def train(
    features: Sequence[Array],
    mirrored: Sequence[Array],
    style: NDArray[np.int64],
    action: NDArray[np.int64],
    *,
    shared: NDArray[np.bool_],
    weights: Array,
    actions: int,
    settings: Settings,
    rng: np.random.Generator,
) -> dict[str, NDArray]:
    """Train a network and return its parameters by name.

    Parameters
    ----------
    features
        N sequences (T_i, D), normalised.
    mirrored
        The same with left and right exchanged. Either is shown, by the toss of a coin; as styles have no side, mirrored ones
        teach the style. Actions may have one (a throw with the left arm), so for them they do not count.
    style, action
        (N,) labels.
    shared
        (N,) whether the clip takes part in learning the style.
    weights
        (N,) probabilities with which clips are drawn; of each a random window is taken, never sped up or slowed down.
    actions
        Number of actions.
    settings, rng
        As they say. Torch's own generator is put back as it was.
    """
    sides = [[np.asarray(each, dtype=np.float32) for each in side] for side in (features, mirrored)]
    length, columns = settings.length, features[0].shape[1]
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(int(rng.integers(2**63)))
        network = TemporalNetwork(columns, settings.channels, 2, actions, settings.dropout)
        network.train()
        optimizer = torch.optim.AdamW(network.parameters(), lr=settings.rate, weight_decay=settings.decay)
        schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, settings.rate, total_steps=settings.steps)
        for _ in range(settings.steps):
            chosen = rng.choice(len(features), settings.batch, p=weights)
            turned = rng.random(settings.batch) < 0.5
            drawn = [_window(sides[int(t)][i], length, rng) for i, t in zip(chosen, turned, strict=True)]
            windows, masks = (np.stack(parts) for parts in zip(*drawn, strict=True))
            x = torch.from_numpy(windows)
            x = x + settings.noise * torch.randn(x.shape)
            scores, others = network(x, torch.from_numpy(masks))
            losses = functional.cross_entropy(scores, torch.from_numpy(style[chosen]), reduction="none")
            part = torch.from_numpy(shared[chosen].astype(np.float32))
            loss = (losses * part).sum() / part.sum().clamp_min(1.0)
            if actions > 1:
                losses = functional.cross_entropy(others, torch.from_numpy(action[chosen]), reduction="none")
                part = torch.from_numpy((~turned).astype(np.float32))
                loss = loss + (losses * part).sum() / part.sum().clamp_min(1.0)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
    return {name: value.detach().numpy().copy() for name, value in network.state_dict().items()}


def _window(sequence: NDArray[np.float32], length: int, rng: np.random.Generator) -> tuple[NDArray, NDArray]:
    """``length`` frames from a random one on, and which of them are frames of the sequence."""
    spare = len(sequence) - length
    if spare > 0:
        start = int(rng.integers(spare + 1))
        return sequence[start : start + length], np.ones(length, dtype=np.float32)
    whole = cut(sequence, length, length)
    return whole.array[0], whole.mask[0].astype(np.float32)


def judge(parameters: dict[str, NDArray], features: Array, settings: Settings) -> tuple[Array, Array]:
    """Scores (W, 2) and (W, A) of the windows of a normalised sequence (T, D)."""
    columns, channels = parameters["enter.weight"].shape[1], parameters["enter.weight"].shape[0]
    with torch.random.fork_rng(devices=[]):
        network = TemporalNetwork(columns, channels, 2, len(parameters["action.bias"]))
    network.load_state_dict({name: torch.from_numpy(np.asarray(value)) for name, value in parameters.items()})
    network.eval()
    windows = cut(np.asarray(features, dtype=np.float32), settings.length, settings.hop)
    with torch.inference_mode():
        style, action = network(torch.from_numpy(windows.array), torch.from_numpy(windows.mask.astype(np.float32)))
    return style.numpy().astype(np.float64), action.numpy().astype(np.float64)
