"""Descent on hidden units: towards a style, then onto constraints. Importing this imports torch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

#: As in the released code: larger than Adam's usual 1e-8, so that units without a gradient stay where they are.
_EPS = 1e-5


def gram(hidden: Tensor) -> Tensor:
    """(N, F, F) mean over time of the products of hidden units (N, F, T): ``G = H H^T / T``.

    The released code sums over time, so that a style clip twice as long has a Gram matrix twice as large; the mean is the same
    for any length, and for a clip played twice.
    """
    return hidden @ hidden.transpose(-1, -2) / hidden.shape[-1]


def style_objective(
    hidden: Tensor,
    content: Tensor,
    style: Tensor,
    *,
    style_weight: float,
    content_weight: float,
    inner: slice = slice(None),
) -> Tensor:
    """``s mean (G(H) - G)^2 + c mean (H - H_C)^2`` with ``s + c`` normalised to 1 (Holden et al. 2016, equation 16).

    Parameters
    ----------
    hidden, content
        (N, F, T) the hidden units to judge, and those of the content.
    style
        (N, F, F) or (F, F) Gram matrix of the style.
    style_weight, content_weight
        s and c.
    inner
        The hidden frames that the Gram matrix is over; those of padding say nothing of style.
    """
    style_term = (gram(hidden[..., inner]) - style).square().mean()
    content_term = (hidden - content).square().mean()
    return (style_weight * style_term + content_weight * content_term) / (style_weight + content_weight)


def descend(objective: Callable[[Tensor], Tensor], start: Tensor, *, iterations: int, step: float) -> Tensor:
    """Hidden units at the lowest value of ``objective`` that Adam met on its way from ``start``.

    Never worse than ``start``: the last point of a descent need not be the lowest, and a projection that raises the error it
    is to remove would be none.
    """
    hidden = start.detach().clone().requires_grad_(True)
    optimizer = torch.optim.Adam([hidden], lr=step, betas=(0.9, 0.999), eps=_EPS)
    best, lowest = start.detach(), None
    for _ in range(iterations + 1):
        optimizer.zero_grad()
        value = objective(hidden)
        now = float(value.detach())
        if lowest is None or now < lowest:
            best, lowest = hidden.detach().clone(), now
        value.backward()
        optimizer.step()
    return best


@dataclass(frozen=True, eq=False)
class Constraints:
    """What a motion has to satisfy, as a function of its channels in units (N, D, T); see Holden et al. 2016, section 7.

    Attributes
    ----------
    parents
        (J,) parent of each joint, -1 for the root.
    lengths
        (J,) bone lengths in leg lengths.
    feet
        (F,) joints with contacts.
    contacts
        (N, F, T) which of them stand on the floor, 1 or 0.
    velocity
        (N, 3, T) wanted root velocity and yaw rate, leg lengths and radians per second.
    fps
        Frames per second.
    weights
        Of the three terms: bones, trajectory, feet.
    """

    parents: Tensor
    lengths: Tensor
    feet: Tensor
    contacts: Tensor
    velocity: Tensor
    fps: float
    weights: tuple[float, float, float] = (1.0, 10.0, 10.0)

    def positions(self, values: Tensor) -> Tensor:
        """(N, J, 3, T) joint positions in leg lengths."""
        joints = len(self.parents)
        return values[:, : 3 * joints].unflatten(1, (joints, 3))

    def bones(self, values: Tensor) -> Tensor:
        """Mean squared error of the bone lengths."""
        p = self.positions(values)
        kept = torch.nonzero(self.parents >= 0)[:, 0]
        lengths = torch.linalg.vector_norm(p[:, kept] - p[:, self.parents[kept]], dim=2)
        return (lengths - self.lengths[kept, None]).square().mean()

    def trajectory(self, values: Tensor) -> Tensor:
        """Mean squared error of the root's steps and turns from frame to frame."""
        at = 3 * len(self.parents)
        return ((values[:, at : at + 3] - self.velocity) / self.fps).square().mean()

    def foot_steps(self, values: Tensor) -> Tensor:
        """(N, F, 3, T - 1) how far each foot moves in the world from a frame to the next, seen from the direction halfway.

        ``R(w/2) p(t+1) - R(-w/2) p(t) + v``: exact for the root's motion as :mod:`benchmark.motion.root` integrates it, with
        the wanted velocity, which the result will have.
        """
        p = self.positions(values)[:, self.feet]
        half = 0.5 * self.velocity[:, 2, :-1] / self.fps
        v = self.velocity[:, :2, :-1] / self.fps
        cos, sin = torch.cos(half)[:, None], torch.sin(half)[:, None]
        x0, y0, z0 = p[..., 0, :-1], p[..., 1, :-1], p[..., 2, :-1]
        x1, y1, z1 = p[..., 0, 1:], p[..., 1, 1:], p[..., 2, 1:]
        x = cos * x1 + sin * z1 - (cos * x0 - sin * z0) + v[:, :1]
        z = cos * z1 - sin * x1 - (cos * z0 + sin * x0) + v[:, 1:]
        return torch.stack((x, y1 - y0, z), dim=2)

    def foot_sliding(self, values: Tensor) -> Tensor:
        """Mean squared step of the feet that stand, and mean squared depth of feet below the floor."""
        standing = self.contacts[..., :-1] * self.contacts[..., 1:]
        slid = (self.foot_steps(values).square().sum(dim=2) * standing).mean()
        below = self.positions(values)[:, self.feet, 1].clamp(max=0.0).square().mean()
        return slid + below

    def objective(self, values: Tensor) -> Tensor:
        """The weighted sum of the three."""
        bone, trajectory, foot = self.weights
        return bone * self.bones(values) + trajectory * self.trajectory(values) + foot * self.foot_sliding(values)
