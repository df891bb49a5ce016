"""The transfer operator between hidden units, the generator around it, and the discriminator. Importing this imports torch."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from methods._torch.device import dropout
from methods.holden.network import Autoencoder, unpool

OPERATORS = ("adain", "wct", "transport", "unrolled")
HEADS = ("mean", "patch")

#: Share of the mean variance of the style's units that is added to every variance. A unit that hardly stirs in the content
#: would otherwise be blown up to the style's deviation, noise and all; equal statistics still give exactly the identity.
_FLOOR = 0.05


class Style(NamedTuple):
    """What is taken from a motion's hidden units: their mean (N, F) and covariance (N, F, F) over time."""

    mean: Tensor
    covariance: Tensor

    @property
    def variance(self) -> Tensor:
        """(N, F) of each unit."""
        return self.covariance.diagonal(dim1=-2, dim2=-1)

    @property
    def gram(self) -> Tensor:
        """(N, F, F) mean over time of the products of units."""
        return self.covariance + self.mean[:, :, None] * self.mean[:, None, :]

    def averaged(self) -> Style:
        """(1, ...) over N."""
        return Style(self.mean.mean(dim=0, keepdim=True), self.covariance.mean(dim=0, keepdim=True))


def halved(valid: Tensor) -> Tensor:
    """(N, T / 2) which hidden frames count, 1 or 0, where (N, T) says it of frames: pairs of which one does."""
    return (valid[:, 0::2] | valid[:, 1::2]).float()


def statistics(hidden: Tensor, valid: Tensor) -> Style:
    """Of hidden units (N, F, T) over the frames that count (N, T), 1 or 0. Sums are divided by the number of frames."""
    share = (valid / valid.sum(dim=1, keepdim=True).clamp(min=1.0))[:, None].to(hidden.dtype)
    mean = (hidden * share).sum(dim=-1)
    centred = hidden - mean[:, :, None]
    return Style(mean, (centred * share) @ centred.transpose(1, 2))


def adain(hidden: Tensor, own: Style, style: Style) -> Tensor:
    """Every unit with the mean and deviation that it has in the style (Huang & Belongie 2017, equation 8)."""
    floor = _FLOOR * style.variance.mean(dim=1, keepdim=True)
    gain = ((style.variance + floor) / (own.variance + floor)).sqrt()
    return (hidden - own.mean[:, :, None]) * gain[:, :, None] + style.mean[:, :, None]


def recoloured(hidden: Tensor, own: Style, style: Style, *, nearest: bool) -> Tensor:
    """Units with the mean and covariance that they have in the style.

    Of the matrices that take one covariance to the other, whitening and colouring (Li et al. 2017) gives ``S^1/2 C^-1/2``;
    the one that changes the content least is the optimal transport between normal distributions (Lu et al. 2019),
    ``C^-1/2 (C^1/2 S C^1/2)^1/2 C^-1/2``. No gradient passes through it: that of an eigenvector has no bound where two
    eigenvalues meet.

    Parameters
    ----------
    hidden
        (N, F, T).
    own, style
        Of the content, N of them, and of the style, N or 1.
    nearest
        Whether to take the second.
    """
    count = hidden.shape[1]
    with torch.no_grad():
        identity = torch.eye(count, dtype=hidden.dtype, device=hidden.device)
        floor = _FLOOR * style.variance.mean(dim=1)[:, None, None] * identity
        wanted = style.covariance + floor
        root, inverse = _roots(own.covariance + floor)
        if nearest:
            matrix = inverse @ _roots(root @ wanted @ root)[0] @ inverse
        else:
            matrix = _roots(wanted)[0] @ inverse
    return matrix @ (hidden - own.mean[:, :, None]) + style.mean[:, :, None]


def unrolled(hidden: Tensor, valid: Tensor, style: Style, *, strength: float, steps: int) -> Tensor:
    """``steps`` steps of gradient descent on the objective of Holden et al. 2016, which gradients pass through.

    Descends ``s n ||G(H) - G||^2 / (4 tr G) + c ||H - H_C||^2 / 2`` with ``s = strength``, ``c = 1 - s``, n frames and steps of
    length 1; divided by the trace, so that the steps are stable whatever the scale of the units.
    """
    size = style.variance.sum(dim=1) + style.mean.square().sum(dim=1)
    moved = hidden
    for _ in range(steps):
        pull = (statistics(moved, valid).gram - style.gram) @ moved / size[:, None, None]
        moved = moved - strength * pull - (1.0 - strength) * (moved - hidden)
    return moved


def _roots(matrices: Tensor) -> tuple[Tensor, Tensor]:
    """Square roots of symmetric positive matrices (N, F, F), and their inverses."""
    values, vectors = torch.linalg.eigh(matrices)
    roots = values.clamp(min=1e-12).sqrt()[:, None, :]
    return (vectors * roots) @ vectors.transpose(1, 2), (vectors / roots) @ vectors.transpose(1, 2)


class Generator(nn.Module):
    """``G(C, S) = Dec(T(E(C), E(S)))``: Wang et al. 2021, equation 5; both directions of the cycle are this one network.

    ``T`` is one of :data:`OPERATORS`, followed by a convolution whose output is added. Its weights begin at zero, so that
    ``G(C, C)`` begins as what the autoencoder makes of C.

    Parameters
    ----------
    autoencoder
        E and Dec.
    operator
        One of :data:`OPERATORS`.
    strength
        How far T goes from the content's units, at 0, to the style's statistics, at 1.
    steps
        Of the operator ``unrolled``.
    mixing
        Hidden frames that the added convolution spans, odd; 0 for no such convolution.
    residual
        Whether to add what T changes to C itself, so that C's detail does not pass through the autoencoder.
    """

    def __init__(
        self,
        autoencoder: Autoencoder,
        *,
        operator: str = "adain",
        strength: float = 1.0,
        steps: int = 8,
        mixing: int = 5,
        residual: bool = False,
    ) -> None:
        super().__init__()
        self.autoencoder = autoencoder
        self.operator, self.strength, self.steps, self.residual = operator, strength, steps, residual
        self.mixer: nn.Conv1d | None = None
        if mixing:
            filters = autoencoder.encoder.out_channels
            self.mixer = nn.Conv1d(filters, filters, mixing, padding=mixing // 2)
            nn.init.zeros_(self.mixer.weight)
            nn.init.zeros_(self.mixer.bias)  # type: ignore[arg-type]

    def encode(self, x: Tensor) -> Tensor:
        """(N, F, T / 2) hidden units of (N, D, T)."""
        return self.autoencoder.encode(x)

    def stylise(self, hidden: Tensor, valid: Tensor, own: Style, style: Style) -> Tensor:
        """T: hidden units (N, F, T / 2) with statistics ``own``, and which count (N, T / 2), in the style (N or 1 of them)."""
        if self.operator == "unrolled":
            moved = unrolled(hidden, valid, style, strength=self.strength, steps=self.steps)
        else:
            if self.operator == "adain":
                full = adain(hidden, own, style)
            else:
                full = recoloured(hidden, own, style, nearest=self.operator == "transport")
            moved = torch.lerp(hidden, full, self.strength)
        return moved if self.mixer is None else moved + self.mixer(functional.relu(moved))

    def decode(self, hidden: Tensor, x: Tensor, before: Tensor) -> Tensor:
        """(N, D, T) of hidden units, for a content ``x`` (N, D, T) whose own were ``before``."""
        if not self.residual:
            return self.autoencoder.decode(hidden)
        # The decoder is linear but for its bias, so the difference of two decodings is one.
        layer = self.autoencoder.decoder
        return x + functional.conv1d(unpool(hidden - before), layer.weight, padding=layer.padding)

    def forward(self, x: Tensor, valid: Tensor, style: Style) -> Tensor:
        """(N, D, T) the motions ``x`` with frames ``valid`` (N, T) in the style."""
        hidden, counted = self.encode(x), halved(valid)
        return self.decode(self.stylise(hidden, counted, statistics(hidden, counted), style), x, hidden)


class Discriminator(nn.Module):
    """Dropout, the encoder's layer, and a head: whether this is a real motion of the style.

    The paper's has no head; this adds one linear unit, on the mean over time (``mean``) or on each hidden frame (``patch``). It
    begins as the encoder it is given, as a copy of its own, so that no generator can please it by changing the encoder;
    ``share`` is the literal reading, in which it *is* the generator's encoder.

    Parameters
    ----------
    autoencoder
        Whose encoder to begin as.
    seen
        (D,) 1 for channels that it sees. Those of contacts are 0 or 1 in real motions alone, which is no style.
    head
        One of :data:`HEADS`.
    share
        Whether to use the encoder itself.
    """

    def __init__(self, autoencoder: Autoencoder, seen: Sequence[float], *, head: str, share: bool) -> None:
        super().__init__()
        self.head = head
        self.shared: tuple[nn.Module, ...] = ()
        # A tuple hides a shared encoder from `parameters`: it is saved and counted once, as the generator's.
        if share:
            self.shared = (autoencoder.encoder,)
        else:
            self.trunk = deepcopy(autoencoder.encoder)
        self.unit = nn.Linear(autoencoder.encoder.out_channels, 1)
        self.register_buffer("seen", torch.tensor(seen, dtype=torch.float32)[:, None])

    def forward(self, x: Tensor, valid: Tensor, share: float, generator: torch.Generator) -> Tensor:
        """(N, T / 2) a logit for each hidden frame, or (N, 1) for each motion, of (N, D, T) with frames ``valid`` (N, T)."""
        seen: Tensor = self.seen  # type: ignore[assignment]
        layer = self.shared[0] if self.shared else self.trunk
        hidden = functional.max_pool1d(functional.relu(layer(dropout(x * seen, share, generator))), 2)
        if self.head == "mean":
            counted = halved(valid)[:, None]
            hidden = (hidden * counted).sum(dim=2, keepdim=True) / counted.sum(dim=2, keepdim=True)
        logits: Tensor = self.unit(hidden.transpose(1, 2))[..., 0]
        return logits
