"""A fitted generator on one clip: transfer, then descent of its hidden units on the kinematic terms. Imports torch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from benchmark.errors import ContractError
from methods.cyclegan_kc.analytic import KinematicDescent, PairDecoder
from methods.cyclegan_kc.losses import Kinematics
from methods.cyclegan_kc.network import Generator, Style, halved, statistics

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
        count = 2 * margin + frames + frames % 2
        held = np.empty((1, channels.shape[1], count), dtype=np.float32)
        held[0, :, margin : margin + frames] = channels.T
        held[0, :, :margin] = channels[0][:, None]
        held[0, :, margin + frames :] = channels[-1][:, None]
        self.x = torch.from_numpy(held)
        self.inner = slice(margin, margin + frames)
        self.valid = torch.zeros((1, count), dtype=torch.bool)
        self.valid[:, self.inner] = True

    def hidden_frames(self, hidden: NDArray[np.float32], reach: int) -> NDArray[np.float32]:
        """Of all hidden frames (T' / 2, F) those that the clip's own frames depend on, ``reach`` to either side."""
        first, last = self.inner.start // 2 - reach, (self.inner.stop + 1) // 2 + reach
        if first < 0 or last > len(hidden):
            raise ContractError(
                f"a margin of {self.inner.start} frames is too short for filters that reach over {2 * reach}"
            )
        return np.ascontiguousarray(hidden[first:last])

    def style(self, generator: Generator) -> Style:
        """What a generator takes from this clip."""
        return statistics(generator.encode(self.x), halved(self.valid))


def draw(
    generator: Generator,
    decoder: PairDecoder,
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
    decoder
        Its decoder's convolution.
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
    with torch.inference_mode():
        content = generator.encode(clip.x)
        counted = halved(clip.valid)
        hidden = generator.stylise(content, counted, statistics(content, counted), style)
        layer = generator.autoencoder.decoder
        own = clip.x[0, :, clip.inner].T.numpy()
        if generator.residual:
            hidden, base = hidden - content, own
        else:
            assert layer.bias is not None
            base = layer.bias.numpy()
    descent = KinematicDescent(kinematics, decoder, own, base)
    start = clip.hidden_frames(hidden[0].T.numpy(), decoder.reach)
    # Without a kinematic term there is nothing to descend.
    lowest, before, after = descent.lowest(start, iterations=iterations if any(kinematics.weights) else 0, step=step)
    made = descent.channels(lowest)
    return Drawn(made.astype(np.float64), before, after, descent.bone_error(made))
