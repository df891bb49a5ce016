"""A fitted generator on one clip: transfer, then descent of its hidden units on the kinematic terms. Imports torch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from methods.cyclegan_kc.losses import Kinematics
from methods.cyclegan_kc.network import Generator, Style, halved, statistics
from methods.holden.descent import descend

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Drawn:
    """What came out: normalised channels (T, D), the kinematic loss before and after refinement, and how bones fare."""

    channels: Array
    before: float
    after: float
    bone_error: float


class Padded:
    """A clip of T frames for filters that reach beyond its ends: first and last frame held, an even number of frames.

    Parameters
    ----------
    channels
        (T, D) normalised.
    margin
        Frames on either side, even.
    """

    def __init__(self, channels: Array | NDArray[np.float32], margin: int) -> None:
        frames = len(channels)
        held = np.pad(channels, ((margin, margin + frames % 2), (0, 0)), mode="edge")
        self.x = torch.as_tensor(held.T[None].copy(), dtype=torch.float32)
        self.inner = slice(margin, margin + frames)
        self.valid = torch.zeros((1, len(held)), dtype=torch.bool)
        self.valid[:, self.inner] = True

    def style(self, generator: Generator) -> Style:
        """What a generator takes from this clip."""
        return statistics(generator.encode(self.x), halved(self.valid))


def draw(
    generator: Generator,
    clip: Padded,
    styles: Sequence[Style],
    kinematics: Kinematics,
    *,
    iterations: int,
    step: float,
) -> Drawn:
    """The clip in the mean of the styles; then the hidden units with the lowest kinematic loss that Adam met (equation 13).

    Parameters
    ----------
    generator
        Without gradients.
    clip
        Content.
    styles
        One or more.
    kinematics
        What is lowered, on the clip's own frames.
    iterations, step
        Of the descent, and Adam's learning rate; 0 iterations keep what the generator gave.
    """
    style = Style(*(torch.cat(parts) for parts in zip(*styles, strict=True))).averaged()
    with torch.no_grad():
        content = generator.encode(clip.x)
        counted = halved(clip.valid)
        hidden = generator.stylise(content, counted, statistics(content, counted), style)

    def loss(moved: Tensor) -> Tensor:
        return kinematics.total(generator.decode(moved, clip.x, content), clip.x, clip.valid)

    with torch.no_grad():
        before = float(loss(hidden))
    # Without a kinematic term there is nothing to descend, and no gradient.
    if iterations and any(kinematics.weights):
        hidden = descend(loss, hidden, iterations=iterations, step=step)
    with torch.no_grad():
        made = generator.decode(hidden, clip.x, content)
        after, bones = float(loss(hidden)), float(kinematics.bone_error(made, clip.valid))
    return Drawn(made[0, :, clip.inner].T.numpy().astype(np.float64), before, after, bones)
