"""The losses of Adult2child, eqs. 1 to 10, with what the printed equations leave out restored.

Words are (J, 4, T, B). Every loss is a mean, over words, frames and components alike.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

#: ``absolute``: the paper's total variation, least for a frozen pose; ``excess``: only what exceeds the source's own motion;
#: ``second``: of second differences.
COHERENCES = ("absolute", "excess", "second")


def discriminator_loss(real: Tensor, fake: Tensor) -> Tensor:
    """Least squares, eqs. 1 and 2: ``0.5 mean (D(real) - 1)^2 + 0.5 mean D(fake)^2``.

    The squares, missing in print, are those of Mao et al. 2017; without them the loss has no lower bound.
    """
    return 0.5 * ((real - 1.0).square().mean() + fake.square().mean())


def generator_loss(fake: Tensor) -> Tensor:
    """Least squares, eqs. 3 and 4: ``0.5 mean (D(fake) - 1)^2``."""
    return 0.5 * (fake - 1.0).square().mean()


def cycle_loss(back: Tensor, word: Tensor) -> Tensor:
    """Eqs. 5 and 6: mean absolute difference between a word and what comes back from the other domain."""
    return (back - word).abs().mean()


def coherence_loss(word: Tensor, source: Tensor | None = None, *, mode: str = "absolute") -> Tensor:
    """Eqs. 7 and 8: mean absolute change from frame to frame.

    The sum of the paper would exceed every other term by three orders of magnitude, hence the mean.

    Parameters
    ----------
    word
        (J, 4, T, B) generated.
    source
        What it was generated from, for ``mode="excess"``.
    mode
        One of :data:`COHERENCES`.
    """
    change = word.diff(dim=2)
    if mode == "excess":
        if source is None:
            raise ValueError("the coherence loss of mode 'excess' needs the source word")
        return functional.relu(change.abs() - source.diff(dim=2).abs()).mean()
    if mode == "second":
        change = change.diff(dim=2)
    return change.abs().mean()


def transition_loss(earlier: Tensor, later: Tensor, *, hop: int, yaw: Tensor | None = None) -> Tensor:
    """Eq. 10 with ranges that fit: words that start ``hop`` frames apart differ on the frames that both show.

    ``mean |y_i[hop:] - y_{i+1}[:T - hop]|``. As printed, ``y_i(t_overlap:end)`` and ``y_{i+1}(0:t_overlap)`` are of one length
    only where words overlap by half; with 60 frames and a hop of 20 it is [20:60] against [0:40].

    Parameters
    ----------
    earlier, later
        (J, 4, T, B) unit quaternions.
    hop
        Frames between their starts.
    yaw
        (B,) radians by which the later word's heading is turned against the earlier's; both words have theirs taken out, so
        joint 0 of the later one is turned back by it before they are compared.
    """
    frames = earlier.shape[2]
    one, two = earlier[:, :, hop:], later[:, :, : frames - hop]
    if yaw is not None:
        cos, sin = torch.cos(0.5 * yaw), torch.sin(0.5 * yaw)
        w, x, y, z = two[0].unbind(0)
        turned = torch.stack((cos * w - sin * y, cos * x + sin * z, cos * y + sin * w, cos * z - sin * x))
        two = torch.cat((turned[None], two[1:]))
    # A quaternion and its negative are the same rotation.
    side = torch.where((one * two).sum(1, keepdim=True) < 0, -1.0, 1.0)
    return (one - side * two).abs().mean()
