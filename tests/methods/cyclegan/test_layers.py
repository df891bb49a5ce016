"""The fast generator computes what the plain one does: values and gradients."""

from __future__ import annotations

import pytest
import torch
from torch.nn import functional

from methods.cyclegan.generator import JointTrunk, make_generator
from methods.cyclegan.layers import grouped_conv, grouped_upsample, norm_act
from methods.cyclegan.literal import LiteralTrunk, from_literal, to_literal


def drawn(*shape: int, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(shape, generator=generator, dtype=torch.float64).requires_grad_()


def agree(ours, theirs, inputs, *, tolerance=1e-10):
    """Values, and the gradients of a random functional of them."""
    torch.testing.assert_close(ours, theirs, rtol=tolerance, atol=tolerance)
    weight = drawn(*ours.shape, seed=9).detach()
    for one, two in zip(
        torch.autograd.grad(ours, inputs, weight), torch.autograd.grad(theirs, inputs, weight), strict=True
    ):
        torch.testing.assert_close(one, two, rtol=tolerance, atol=tolerance)


@pytest.mark.parametrize("frames", [7, 8, 15, 60])
@pytest.mark.parametrize(
    ("taps", "stride", "pad", "padding"),
    [
        (7, 1, 3, "reflect"),
        (3, 2, 1, "zero"),
        (3, 1, 1, "reflect"),
        (3, 2, 1, "reflect"),
        (4, 2, 1, "zero"),
        (4, 1, 1, "zero"),
        (1, 1, 0, "zero"),
    ],
)
def test_grouped_convolution_is_that_of_torch(frames, taps, stride, pad, padding):
    groups, inputs, outputs, words = 3, 4, 5, 2
    x, weight = drawn(groups, inputs, frames, words), drawn(groups, outputs, inputs, taps, seed=1)
    plain = x.permute(3, 0, 1, 2).flatten(1, 2)
    plain = functional.pad(plain, (pad, pad), mode="reflect" if padding == "reflect" else "constant")
    theirs = functional.conv1d(plain, weight.flatten(0, 1), stride=stride, groups=groups)
    ours = grouped_conv(x, weight, stride=stride, pad=pad, padding=padding)
    agree(ours, theirs.unflatten(1, (groups, outputs)).permute(1, 2, 3, 0), (x, weight))


def test_upsampling_is_the_transposed_convolution_of_torch():
    groups, inputs, outputs, words = 3, 4, 5, 2
    x, weight = drawn(groups, inputs, 6, words), drawn(groups, outputs, inputs, 3, seed=1)
    theirs = functional.conv_transpose1d(
        x.permute(3, 0, 1, 2).flatten(1, 2),
        weight.transpose(1, 2).flatten(0, 1),
        stride=2,
        padding=1,
        output_padding=1,
        groups=groups,
    )
    agree(grouped_upsample(x, weight), theirs.unflatten(1, (groups, outputs)).permute(1, 2, 3, 0), (x, weight))


@pytest.mark.parametrize("slope", [0.0, 0.2, 1.0])
@pytest.mark.parametrize("share", [1, 2])
def test_fused_norm_is_instance_norm_and_rectifier(slope, share):
    groups, channels, frames, words = 2, 4, 6, 3
    x = drawn(groups, channels, frames, words)
    gain, shift = drawn(groups, channels // share, seed=1), drawn(groups, channels // share, seed=2)
    plain = x.permute(3, 0, 1, 2).reshape(words, groups * channels // share, share * frames)
    theirs = functional.leaky_relu(
        functional.instance_norm(plain, weight=gain.flatten(), bias=shift.flatten(), eps=1e-5), slope
    )
    theirs = theirs.reshape(words, groups, channels, frames).permute(1, 2, 3, 0)
    agree(norm_act(x, gain, shift, slope=slope, share=share), theirs, (x, gain, shift))


@pytest.mark.parametrize("convolution", ["joint", "joint2d"])
@pytest.mark.parametrize("norm", ["instance", "none"])
@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 1e-10), (torch.float32, 1e-5)])
def test_fast_generator_equals_the_literal_one(convolution, norm, dtype, tolerance):
    """The whole network: outputs, input gradient and every parameter's gradient, against Conv1d or Conv2d with groups."""
    joints, words = 4, 3
    fast = make_generator(joints, convolution=convolution, width=4, blocks=2, norm=norm).to(dtype)
    fast.reset(torch.Generator().manual_seed(1))
    trunk = fast.trunk
    assert isinstance(trunk, JointTrunk)
    with torch.no_grad():
        for index, parameter in enumerate(trunk.parameters()):
            if parameter.ndim == 2:  # biases, gains and shifts, which all start alike
                parameter.add_(0.3 * drawn(*parameter.shape, seed=index).to(dtype))
    literal = LiteralTrunk(trunk)
    plane = convolution == "joint2d"
    x = drawn(joints, 4, 60, words).detach().to(dtype).requires_grad_()
    ours, theirs = trunk(x), from_literal(literal(to_literal(x, plane=plane)), plane=plane)
    torch.testing.assert_close(ours, theirs, rtol=tolerance, atol=tolerance)
    weight = drawn(*ours.shape, seed=9).detach().to(dtype)
    mine = torch.autograd.grad(ours, [x, *trunk.parameters()], weight)
    other = torch.autograd.grad(theirs, [x, *literal.parameters()], weight)
    # Transposed convolutions of torch keep their input channels first.
    turned = {
        id(module.weight)
        for module in literal.modules()
        if isinstance(module, torch.nn.ConvTranspose1d | torch.nn.ConvTranspose2d)
    }
    assert len(turned) == 2
    for one, two, parameter in zip(mine, other, [x, *literal.parameters()], strict=True):
        if id(parameter) in turned:
            two = two.unflatten(0, (joints, -1)).transpose(1, 2)
        two = two.reshape(one.shape)
        size = float(two.abs().max())
        torch.testing.assert_close(one / size, two / size, rtol=0, atol=tolerance)
