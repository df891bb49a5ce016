"""The PatchGAN discriminator of motion words, all joints together."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from methods.cyclegan.generator import JointConv, Whitening, convolve
from methods.cyclegan.layers import Workspaces


class Discriminator(nn.Module):
    """Zhu's ``NLayerDiscriminator`` along time: four feature layers and one output layer, k4, on all J x 4 channels at once.

    Strides 2, 2, 2, 1, 1; 60 frames give five verdicts, each of which sees the whole word. No norm in the first layer,
    LeakyReLU 0.2, no sigmoid.

    Parameters
    ----------
    joints
        J.
    widths
        Channels of the feature layers.
    norm
        ``instance`` or ``none``. Instance norm takes the mean of what the second layer sees out of the word, and with it
        most of the posture.
    whiten
        Standardise words first, see :class:`~methods.cyclegan.generator.Whitening`.
    """

    def __init__(
        self,
        joints: int,
        *,
        widths: Sequence[int] = (64, 128, 256, 512),
        norm: str = "instance",
        whiten: bool = False,
    ) -> None:
        super().__init__()
        self.whitening = Whitening(joints) if whiten else None
        layers = []
        inputs = 4 * joints
        for index, outputs in enumerate(widths):
            layers.append(
                JointConv(
                    1,
                    inputs,
                    outputs,
                    4,
                    stride=1 if index == len(widths) - 1 else 2,
                    pad=1,
                    norm="none" if index == 0 else norm,
                    slope=0.2,
                )
            )
            inputs = outputs
        layers.append(JointConv(1, inputs, 1, 4, pad=1, slope=1.0))
        self.layers = nn.ModuleList(layers)
        self.spaces = Workspaces()

    def reset(self, generator: torch.Generator) -> None:
        """Draw all weights."""
        for layer in self.layers:
            assert isinstance(layer, JointConv)
            layer.reset(generator)

    def forward(self, x: Tensor) -> Tensor:
        """(J, 4, T, B) to verdicts (P, B): 1 for real, 0 for generated."""
        if self.whitening is not None:
            x = self.whitening(x)
        x = x.reshape(1, -1, *x.shape[2:])
        return convolve(x, self.layers, self.spaces)[0, 0]
