"""Generators of motion words: joint by joint (fast), over time and joints (the paper's other variant), and their head.

Words are (J, 4, T, B): joints, quaternion components, frames, words.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Literal, Self

import torch
from torch import Tensor, nn
from torch.nn import functional

from methods.cyclegan.layers import Layer, Workspaces, chain

#: ``joint``: quaternion components are channels; ``joint2d``: they are the second axis of two-dimensional kernels, the
#: literal reading of the paper; ``overall``: kernels over time and joints, shared by all joints, its negative result.
CONVOLUTIONS = ("joint", "joint2d", "overall")
NORMS = ("instance", "none")

#: Places along the quaternion axis.
SPAN = 4

#: Standard deviation of weights at the start (Zhu et al. 2017).
INIT_STD = 0.02

#: A quaternion shorter than this is divided by this instead of its length.
UNIT_EPS = 1e-8

#: Words must be a multiple of so many frames: the trunk runs at a quarter of the rate.
TIME_FACTOR = 4


def _spread(taps: int, padding: str, *, transposed: bool = False) -> Tensor:
    """(K, 4, 4) ones where tap k of a kernel along the quaternion axis carries input place w to output place w'."""
    table = torch.zeros(taps, SPAN, SPAN)
    pad = (taps - 1) // 2
    for out in range(SPAN):
        for k in range(taps):
            place = out + pad - k if transposed else out + k - pad
            if padding == "reflect":
                place = abs(place)
                place = place if place < SPAN else 2 * (SPAN - 1) - place
            if 0 <= place < SPAN:
                table[k, out, place] += 1.0
    return table


class JointConv(nn.Module):
    """The weights of a temporal convolution with its own kernel for each group, with norm and rectifier.

    It is computed by :func:`convolve`, together with its neighbours.

    Parameters
    ----------
    groups, inputs, outputs, taps
        J, C, C', K.
    stride, padding
        Of the time axis; ``zero`` padding or ``reflect``, of ``pad`` frames, by default as many as keep the length.
    upsample
        Transposed convolution that doubles the rate, kernel 3.
    norm, slope
        ``instance`` or ``none``; slope of the rectifier below zero, 1 for none.
    residual
        Add the input of the layer so many places earlier.
    plane
        Kernels are (K, K) over time and the quaternion axis, whose places the channels of the tensors then are, too: ``4 C``
        in all. The kernel is spread into one along time alone, which gives the same sums in far fewer calls.

    Attributes
    ----------
    weight
        (K, J, C', C); (K, K, J, C', C) if ``plane``. A matrix product takes one tap as it lies there.
    """

    spread: Tensor

    def __init__(
        self,
        groups: int,
        inputs: int,
        outputs: int,
        taps: int,
        *,
        stride: int = 1,
        pad: int | None = None,
        padding: str = "zero",
        upsample: bool = False,
        norm: str = "none",
        slope: float = 0.0,
        residual: int = 0,
        plane: bool = False,
    ) -> None:
        super().__init__()
        self.layer = Layer(
            taps,
            stride=stride,
            pad=(taps - 1) // 2 if pad is None else pad,
            padding=padding,
            upsample=upsample,
            norm=norm == "instance",
            slope=slope,
            share=SPAN if plane else 1,
            residual=residual,
        )
        self.weight = nn.Parameter(torch.empty(*([taps] * (2 if plane else 1)), groups, outputs, inputs))
        if norm == "instance":
            self.gain = nn.Parameter(torch.ones(groups, outputs))
            self.shift = nn.Parameter(torch.zeros(groups, outputs))
        else:
            self.bias = nn.Parameter(torch.zeros(groups, outputs))
        if plane:
            self.register_buffer("spread", _spread(taps, padding, transposed=upsample), persistent=False)

    @property
    def plane(self) -> bool:
        """Whether kernels are over time and the quaternion axis."""
        return self.weight.ndim == 5

    def reset(self, generator: torch.Generator) -> None:
        """Draw the weights: N(0, 0.02) under a norm, of unit gain (He et al. 2015) where nothing else sets the scale."""
        groups, outputs, inputs = self.weight.shape[-3:]
        taps = self.weight.shape[:-3]
        std = INIT_STD if self.layer.norm else (2.0 / (inputs * taps.numel())) ** 0.5
        with torch.no_grad():
            drawn = torch.randn((groups, outputs, inputs, taps.numel()), generator=generator) * std
            self.weight.copy_(drawn.permute(3, 0, 1, 2).reshape(self.weight.shape))

    def tensors(self) -> list[Tensor]:
        """Weight (K, J, C', C), and gain and shift or bias, as :func:`~methods.cyclegan.layers.chain` takes them."""
        weight: Tensor = self.weight
        if self.plane:
            taps, _, groups, outputs, inputs = weight.shape
            weight = torch.einsum("tkjoi,kvu->tjoviu", weight, self.spread)
            weight = weight.reshape(taps, groups, outputs * SPAN, inputs * SPAN)
        return [weight, self.gain, self.shift] if self.layer.norm else [weight, self.bias]


def convolve(x: Tensor, convs: Iterable[nn.Module], spaces: Workspaces | None = None) -> Tensor:
    """(J, C, T, B) through some :class:`JointConv`, one after another, in memory from ``spaces``."""
    layers, tensors = [], []
    for conv in convs:
        assert isinstance(conv, JointConv)
        layers.append(conv.layer)
        tensors.append(conv.tensors())
    return chain(x, layers, tensors, spaces)


class CrossJoint(nn.Module):
    """Mixes the channels of all joints frame by frame, added to what came in: an ablation of strict joint-wise convolution."""

    def __init__(self, joints: int, channels: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(joints * channels, joints * channels))
        self.channels = channels

    def reset(self, generator: torch.Generator) -> None:
        """Draw the weights so that the sum over all joints has a tenth of the size of what it is added to."""
        with torch.no_grad():
            std = 0.1 / len(self.weight) ** 0.5
            self.weight.copy_(torch.randn(self.weight.shape, generator=generator) * std)

    def forward(self, x: Tensor) -> Tensor:
        """(J, C, T, B), unchanged in shape; places along a quaternion axis are not mixed."""
        flat = x.reshape(len(self.weight), -1)
        return torch.addmm(flat, self.weight, flat).view(x.shape)


class JointTrunk(nn.Module):
    """Zhu's residual generator along time, one for each joint and none knowing of another.

    k7; two k3 of stride 2; ``blocks`` residual blocks of two k3; two transposed k3 of stride 2; k7. Reflection padding
    where Zhu has it, instance norm with gain and shift, no biases under a norm.
    """

    def __init__(
        self,
        joints: int,
        *,
        widths: Sequence[int] = (8, 16, 32),
        blocks: int = 9,
        norm: str = "instance",
        plane: bool = False,
        cross_joint: bool = False,
    ) -> None:
        super().__init__()
        first, second, third = widths
        ends = 1 if plane else SPAN

        def conv(inputs: int, outputs: int, taps: int, **rest: object) -> JointConv:
            options = {"norm": norm, "plane": plane, **rest}
            return JointConv(joints, inputs, outputs, taps, **options)  # type: ignore[arg-type]

        self.enter = nn.ModuleList(
            [
                conv(ends, first, 7, padding="reflect"),
                conv(first, second, 3, stride=2),
                conv(second, third, 3, stride=2),
            ]
        )
        self.mix = CrossJoint(joints, third) if cross_joint else None
        self.blocks = nn.ModuleList(
            layer
            for _ in range(blocks)
            for layer in (
                conv(third, third, 3, padding="reflect"),
                conv(third, third, 3, padding="reflect", slope=1.0, residual=1),
            )
        )
        self.leave = nn.ModuleList([conv(third, second, 3, upsample=True), conv(second, first, 3, upsample=True)])
        self.last = conv(first, ends, 7, padding="reflect", norm="none", slope=1.0)
        self.spaces = Workspaces()

    def train(self, mode: bool = True) -> Self:
        """As in torch; memory for training is given back when it is over."""
        if not mode:
            self.spaces.clear()
        return super().train(mode)

    def forward(self, x: Tensor) -> Tensor:
        """(J, 4, T, B) to (J, 4, T, B)."""
        rest = [*self.blocks, *self.leave, self.last]
        if self.mix is None:
            return convolve(x, [*self.enter, *rest], self.spaces)
        x = convolve(x, self.enter, self.spaces)
        places = x.shape[1] // self.mix.channels
        x = self.mix(x.view(x.shape[0], self.mix.channels, places * x.shape[2], x.shape[3])).view(x.shape)
        return convolve(x, rest, self.spaces)


class OverallTrunk(nn.Module):
    """Zhu's residual generator over time and joints, quaternion components as channels, kernels shared by all joints."""

    def __init__(
        self, joints: int, *, widths: Sequence[int] = (64, 128, 256), blocks: int = 9, norm: str = "instance"
    ) -> None:
        super().__init__()
        first, second, third = widths

        def normed(channels: int) -> nn.Module:
            return nn.InstanceNorm2d(channels, affine=True) if norm == "instance" else nn.Identity()

        def conv(inputs: int, outputs: int, taps: int, stride: int = 1) -> list[nn.Module]:
            pad = (taps - 1) // 2
            mode: Literal["zeros", "reflect"] = "zeros" if stride > 1 else "reflect"
            layer = nn.Conv2d(
                inputs, outputs, taps, stride=stride, padding=pad, padding_mode=mode, bias=norm != "instance"
            )
            return [layer, normed(outputs)]

        def up(inputs: int, outputs: int) -> list[nn.Module]:
            layer = nn.ConvTranspose2d(
                inputs, outputs, 3, stride=2, padding=1, output_padding=1, bias=norm != "instance"
            )
            return [layer, normed(outputs), nn.ReLU()]

        self.enter = nn.Sequential(
            *conv(SPAN, first, 7),
            nn.ReLU(),
            *conv(first, second, 3, 2),
            nn.ReLU(),
            *conv(second, third, 3, 2),
            nn.ReLU(),
        )
        self.blocks = nn.ModuleList(
            nn.Sequential(*conv(third, third, 3), nn.ReLU(), *conv(third, third, 3)) for _ in range(blocks)
        )
        self.leave = nn.Sequential(*up(third, second), *up(second, first))
        self.last = nn.Conv2d(first, SPAN, 7, padding=3, padding_mode="reflect")
        self.joints = joints

    def reset(self, generator: torch.Generator) -> None:
        """Draw the weights from N(0, 0.02)."""
        with torch.no_grad():
            for module in self.modules():
                if isinstance(module, nn.Conv2d | nn.ConvTranspose2d):
                    module.weight.copy_(torch.randn(module.weight.shape, generator=generator) * INIT_STD)
                    if module.bias is not None:
                        module.bias.zero_()

    def forward(self, x: Tensor) -> Tensor:
        """(J, 4, T, B) to (J, 4, T, B)."""
        joints = x.shape[0]
        # Reflection in the trunk needs two places at a quarter of the joints.
        extra = max(0, 2 * TIME_FACTOR - joints)
        x = functional.pad(x.permute(3, 1, 2, 0), (0, extra))
        x = self.enter(x)
        for block in self.blocks:
            x = x + block(x)
        x = self.last(self.leave(x))
        return x[..., :joints].permute(3, 1, 2, 0)


class Whitening(nn.Module):
    """Standardises every component of every joint: ``(x - center) / spread``, by numbers that are learned from no gradient.

    Most components move by a few hundredths about a mean far from zero. A first layer can undo that, but takes long to.
    """

    center: Tensor
    spread: Tensor

    def __init__(self, joints: int) -> None:
        super().__init__()
        self.register_buffer("center", torch.zeros(joints, SPAN, 1, 1))
        self.register_buffer("spread", torch.ones(joints, SPAN, 1, 1))

    def fit(self, center: Tensor, spread: Tensor) -> None:
        """Take over mean and standard deviation (J, 4), of training words only, in units of the words."""
        self.center.copy_(center[..., None, None])
        self.spread.copy_(spread[..., None, None])

    def forward(self, x: Tensor) -> Tensor:
        """(J, 4, T, B), unchanged in shape."""
        return (x - self.center) / self.spread


class Generator(nn.Module):
    """Words of one domain to words of the other: a trunk, ``tanh``, and the projection onto unit quaternions.

    The projection happens in the target's own units, before any discriminator or the way back sees the word, so that norm tells
    nobody what is generated: ``y = (u / |u| - offset) / scale`` with ``u = offset + scale tanh(trunk(x))``.

    Parameters
    ----------
    trunk
        (J, 4, T, B) to (J, 4, T, B).
    source, target
        ``(offset, scale)`` of the affine maps from [-1, 1] to quaternion components, of the two domains.
    skip
        The trunk says by how much the source's quaternions change, ``u = q + s trunk(x)``, instead of what they become.
    whitening
        Put before the trunk where words are to be standardised; its spread is the ``s`` of the skip, else 1.
    """

    def __init__(
        self,
        trunk: nn.Module,
        *,
        source: tuple[float, float],
        target: tuple[float, float],
        skip: bool = False,
        whitening: Whitening | None = None,
    ) -> None:
        super().__init__()
        self.trunk = trunk
        self.source, self.target, self.skip = source, target, skip
        self.whitening = whitening

    def reset(self, generator: torch.Generator) -> None:
        """Draw all weights; with the skip the last layer starts at a tenth, so that the way starts near what came in."""
        for module in self.trunk.modules():
            if isinstance(module, JointConv | CrossJoint | OverallTrunk):
                module.reset(generator)
        if self.skip:
            last = self.trunk.last
            assert isinstance(last, nn.Module) and isinstance(last.weight, Tensor)
            with torch.no_grad():
                last.weight.mul_(0.1)

    def forward(self, x: Tensor) -> Tensor:
        """(J, 4, T, B) in units of the source domain to (J, 4, T, B) in units of the target domain, of unit norm there."""
        out = self.trunk(x if self.whitening is None else self.whitening(x))
        if self.skip:
            if self.whitening is not None:
                out = out * self.whitening.spread
            out = (x + out) * self.source[1] + self.source[0]
        else:
            out = torch.tanh(out) * self.target[1] + self.target[0]
        # torch's norm along an outer axis takes as long as a whole layer.
        length = (out * out).sum(1, keepdim=True).clamp_min(UNIT_EPS**2).sqrt()
        return (out / length - self.target[0]) / self.target[1]


def make_generator(
    joints: int,
    *,
    convolution: str = "joint",
    width: int = 8,
    blocks: int = 9,
    norm: str = "instance",
    cross_joint: bool = False,
    skip: bool = False,
    whiten: bool = False,
    source: tuple[float, float] = (0.0, 1.0),
    target: tuple[float, float] = (0.0, 1.0),
) -> Generator:
    """A generator by name; its weights are not drawn yet (:meth:`Generator.reset`).

    ``width`` is the number of channels of the first layer, per joint for the joint-wise ones; it doubles twice.
    """
    widths = (width, 2 * width, 4 * width)
    trunk: nn.Module
    if convolution == "overall":
        trunk = OverallTrunk(joints, widths=widths, blocks=blocks, norm=norm)
    else:
        trunk = JointTrunk(
            joints, widths=widths, blocks=blocks, norm=norm, plane=convolution == "joint2d", cross_joint=cross_joint
        )
    whitening = Whitening(joints) if whiten else None
    return Generator(trunk, source=source, target=target, skip=skip, whitening=whitening)
