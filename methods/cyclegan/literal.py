"""The generator written down plainly with ``torch.nn`` modules: what the fast one must equal.

Grouped convolutions in torch's own layout, nothing shared and nothing fused. It defines what is computed; tests hold
:class:`~methods.cyclegan.generator.JointTrunk` to it, and the speed bench trains it as the baseline.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from methods.cyclegan.generator import SPAN, JointConv, JointTrunk


class LiteralTrunk(nn.Module):
    """A copy of a :class:`~methods.cyclegan.generator.JointTrunk` in ``Conv1d(groups=J)`` or ``Conv2d(groups=J)``.

    Parameters
    ----------
    fast
        The trunk to copy, weights included. Parameters are in the same order.
    """

    def __init__(self, fast: JointTrunk) -> None:
        super().__init__()
        if fast.mix is not None:
            raise ValueError("the literal generator is strictly joint-wise")
        self.plane = fast.last.plane
        self.enter = nn.Sequential(*(_layer(conv) for conv in fast.enter))
        self.blocks = nn.ModuleList(
            nn.Sequential(_layer(fast.blocks[k]), _layer(fast.blocks[k + 1])) for k in range(0, len(fast.blocks), 2)
        )
        self.leave = nn.Sequential(*(_layer(conv) for conv in fast.leave))
        self.last = _layer(fast.last)

    def forward(self, x: Tensor) -> Tensor:
        """(B, J 4, T), or (B, J, T, 4) for kernels over time and quaternion, to the same."""
        x = self.enter(x)
        for block in self.blocks:
            x = x + block(x)
        return self.last(self.leave(x))


def to_literal(x: Tensor, *, plane: bool) -> Tensor:
    """(J, 4, T, B) in the layout of :class:`LiteralTrunk`."""
    return x.permute(3, 0, 2, 1) if plane else x.permute(3, 0, 1, 2).flatten(1, 2)


def from_literal(x: Tensor, *, plane: bool) -> Tensor:
    """The inverse of :func:`to_literal`."""
    return x.permute(1, 3, 2, 0) if plane else x.unflatten(1, (-1, SPAN)).permute(1, 2, 3, 0)


def _layer(conv: nn.Module) -> nn.Sequential:
    """The textbook modules with the weights of a :class:`~methods.cyclegan.generator.JointConv`."""
    assert isinstance(conv, JointConv)
    groups, outputs, inputs = conv.weight.shape[-3:]
    layer, plane, biased = conv.layer, conv.plane, not conv.layer.norm
    taps = layer.taps
    weight = conv.weight.movedim((-3, -2, -1), (0, 1, 2))
    kinds: tuple[Any, Any, Any] = (nn.Conv1d, nn.ConvTranspose1d, nn.InstanceNorm1d)
    if plane:
        kinds = nn.Conv2d, nn.ConvTranspose2d, nn.InstanceNorm2d
    layers: list[nn.Module] = []
    main: Any
    if layer.upsample:
        up = kinds[1](
            groups * inputs,
            groups * outputs,
            taps,
            stride=(2, 1) if plane else 2,
            padding=1,
            output_padding=(1, 0) if plane else 1,
            groups=groups,
            bias=biased,
            dtype=conv.weight.dtype,
        )
        with torch.no_grad():
            up.weight.copy_(weight.transpose(1, 2).flatten(0, 1))
        layers.append(up)
        main = up
    else:
        if layer.padding == "reflect":
            layers.append((nn.ReflectionPad2d if plane else nn.ReflectionPad1d)(layer.pad))
        straight = kinds[0](
            groups * inputs,
            groups * outputs,
            taps,
            stride=(layer.stride, 1) if plane else layer.stride,
            padding=0 if layer.padding == "reflect" else layer.pad,
            groups=groups,
            bias=biased,
            dtype=conv.weight.dtype,
        )
        with torch.no_grad():
            straight.weight.copy_(weight.flatten(0, 1))
        layers.append(straight)
        main = straight
    if biased:
        with torch.no_grad():
            main.bias.copy_(conv.bias.flatten())
    else:
        norm = kinds[2](groups * outputs, affine=True, dtype=conv.weight.dtype)
        with torch.no_grad():
            norm.weight.copy_(conv.gain.flatten())
            norm.bias.copy_(conv.shift.flatten())
        layers.append(norm)
    if layer.slope != 1.0:
        layers.append(nn.ReLU() if layer.slope == 0.0 else nn.LeakyReLU(layer.slope))
    return nn.Sequential(*layers)
