"""The losses of Wang et al. 2021, with what the printed equations leave open settled. Importing this imports torch.

Every loss is a mean over frames that count and, by its units, of the order of 1 for a motion that has nothing of what is
asked for; so weights near 1 mean something, whatever the skeleton and the frame rate.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from methods.holden.channels import Layout, Scaling
from methods.holden.descent import Constraints

GANS = ("log", "lsgan")
SMOOTH = ("match", "abs")

#: Names of the kinematic terms, in the order in which they are reported.
TERMS = ("smooth", "bone", "traj", "foot")


def judge_loss(real: Tensor, fake: Tensor, kind: str) -> Tensor:
    """What the discriminator lowers, of logits (N,): equation 7 negated, or least squares."""
    if kind == "lsgan":
        return 0.5 * ((real - 1.0).square().mean() + fake.square().mean())
    return functional.softplus(-real).mean() + functional.softplus(fake).mean()


def generator_loss(fake: Tensor, kind: str) -> Tensor:
    """What the generator lowers: ``-log D(GM)``, or least squares.

    Equation 7 as printed has the generator lower ``log(1 - D(GM))``, which is flat where the discriminator is sure.
    """
    if kind == "lsgan":
        return 0.5 * (fake - 1.0).square().mean()
    return functional.softplus(-fake).mean()


def style_loss(gram: Tensor, wanted: Tensor) -> Tensor:
    """Squared distance of Gram matrices (N, F, F) over the squared norm of those wanted, mean over N.

    Equation 6 prints an undefined R and compares the style with itself; this compares the style with the generated motion.
    """
    return ((gram - wanted).square().sum(dim=(1, 2)) / wanted.square().sum(dim=(1, 2))).mean()


def cycle_loss(back: Tensor, x: Tensor, valid: Tensor) -> Tensor:
    """Equation 9: mean squared difference of normalised channels (N, D, T)."""
    return _mean((back - x).square().mean(dim=1), valid)


@dataclass(frozen=True, eq=False)
class Kinematics:
    """Equations 10 to 13, of normalised channels (N, D, T) against those of the content.

    Attributes
    ----------
    parents
        (J,) parent of each joint, -1 for the root.
    lengths
        (J,) bone lengths in leg lengths: the content's, on the common body.
    feet
        (F,) joints with contacts.
    offset, scale
        (D, 1) of the normalisation.
    acceleration
        Mean squared change of joint velocities from frame to frame in the training clips: the unit of ``smooth``.
    fps
        Frames per second.
    mode
        One of :data:`SMOOTH`.
    weights
        Of :data:`TERMS`.
    """

    parents: Tensor
    lengths: Tensor
    feet: Tensor
    offset: Tensor
    scale: Tensor
    acceleration: float
    fps: float
    mode: str
    weights: tuple[float, float, float, float]

    @classmethod
    def of(
        cls,
        layout: Layout,
        scaling: Scaling,
        *,
        acceleration: float,
        fps: float,
        mode: str,
        weights: tuple[float, float, float, float],
        device: torch.device | str = "cpu",
        dtype: torch.dtype = torch.float32,
    ) -> Self:
        """For clips of a layout."""

        def tensor(array: NDArray[np.float64]) -> Tensor:
            return torch.as_tensor(array, dtype=dtype, device=device)

        skeleton = layout.skeleton
        return cls(
            torch.as_tensor(np.array(skeleton.parents), device=device),
            tensor(skeleton.bone_lengths / skeleton.leg_length),
            torch.as_tensor(layout.feet, device=device),
            tensor(scaling.offset[:, None]),
            tensor(scaling.scale[:, None]),
            acceleration,
            fps,
            mode,
            weights,
        )

    @property
    def _velocity(self) -> slice:
        return slice(3 * len(self.parents), 3 * len(self.parents) + 3)

    def _positions(self, x: Tensor) -> Tensor:
        """(N, J, 3, T) leg lengths, of positions alone."""
        count = 3 * len(self.parents)
        values = x[:, :count] * self.scale[:count] + self.offset[:count]
        return values.unflatten(1, (len(self.parents), 3))

    def smooth(self, x: Tensor, content: Tensor, valid: Tensor) -> Tensor:
        """Equation 10 with j read as the frame: mean squared difference of the joints' accelerations, 0 where they agree.

        As printed, a difference of squared norms has no lower bound; with the mode ``abs`` it is its magnitude. Velocities are
        those seen from the walker: the root's own are in :meth:`trajectory`.
        """
        inner = valid[:, :-2] & valid[:, 1:-1] & valid[:, 2:]
        if self.mode == "match":
            # Linear in the positions: one difference of differences.
            change = (self._positions(x) - self._positions(content)).diff(dim=-1).diff(dim=-1)
            error = change.square().sum(dim=2)
        else:
            mine, theirs = (
                self._positions(each).diff(dim=-1).diff(dim=-1).square().sum(dim=2) for each in (x, content)
            )
            error = (mine - theirs).abs()
        return _mean(error.mean(dim=1), inner) / self.acceleration

    def bone_lengths(self, x: Tensor) -> Tensor:
        """(N, B, T) lengths of all bones in leg lengths."""
        p, kept = self._positions(x), torch.nonzero(self.parents >= 0)[:, 0]
        # Not `vector_norm`, which is several times slower over an inner axis.
        return (p[:, kept] - p[:, self.parents[kept]]).square().sum(dim=2).add(1e-12).sqrt()

    def bone(self, x: Tensor, valid: Tensor) -> Tensor:
        """Equation 11: mean squared error of bone lengths, over the square of the deviation that positions share."""
        error = self.bone_lengths(x) - self.lengths[self.parents >= 0, None]
        return _mean(error.square().mean(dim=1), valid) / self.scale[0, 0].square()

    def bone_error(self, x: Tensor, valid: Tensor) -> Tensor:
        """Mean error of bone lengths as a share of the bone's; bones without length do not count."""
        wanted = self.lengths[self.parents >= 0]
        long = wanted > 1e-6
        share = (self.bone_lengths(x)[:, long] - wanted[long, None]).abs() / wanted[long, None]
        return _mean(share.mean(dim=1), valid)

    def trajectory(self, x: Tensor, content: Tensor, valid: Tensor) -> Tensor:
        """Equation 12: squared differences of the root's velocity and yaw rate from the content's, in normalised channels."""
        return _mean((x - content)[:, self._velocity].square().sum(dim=1), valid)

    def foot(self, x: Tensor, content: Tensor, valid: Tensor) -> Tensor:
        """Mean squared speed, in leg lengths per second, of the feet that stand in the content; not in the paper."""
        at = self._velocity.stop
        contacts = (content[:, at : at + len(self.feet)] > 0).to(x.dtype)
        values = x * self.scale + self.offset
        motion = Constraints(self.parents, self.lengths, self.feet, contacts, values[:, self._velocity], self.fps)
        standing = contacts[..., :-1] * contacts[..., 1:]
        slid = (motion.foot_steps(values).square().sum(dim=2) * standing).mean(dim=1)
        return _mean(slid, valid[:, :-1] & valid[:, 1:]) * self.fps**2

    def terms(self, x: Tensor, content: Tensor, valid: Tensor) -> dict[str, Tensor]:
        """The terms that have a weight, by their names in :data:`TERMS`."""
        on = dict(zip(TERMS, self.weights, strict=True))
        found = {}
        if on["smooth"]:
            found["smooth"] = self.smooth(x, content, valid)
        if on["bone"]:
            found["bone"] = self.bone(x, valid)
        if on["traj"]:
            found["traj"] = self.trajectory(x, content, valid)
        if on["foot"]:
            found["foot"] = self.foot(x, content, valid)
        return found

    def total(self, x: Tensor, content: Tensor, valid: Tensor) -> Tensor:
        """Equation 13: the weighted sum."""
        on = dict(zip(TERMS, self.weights, strict=True))
        return sum((on[name] * value for name, value in self.terms(x, content, valid).items()), x.new_zeros(()))


def mean_squared_acceleration(layout: Layout, arrays: list[NDArray[np.float64]]) -> float:
    """Of all joints of clips in units (T_i, D): the squared second difference, leg lengths, mean over frames and joints."""
    squares = [
        np.square(np.diff(array[:, layout.positions], n=2, axis=0)).reshape(-1, len(layout.skeleton), 3).sum(-1).ravel()
        for array in arrays
        if len(array) > 2
    ]
    return max(float(np.mean(np.concatenate(squares))), 1e-12) if squares else 1.0


def _mean(values: Tensor, valid: Tensor) -> Tensor:
    """Of (N, T) over the frames that count; 0 where none do."""
    return (values * valid).sum() / valid.sum().clamp(min=1)
