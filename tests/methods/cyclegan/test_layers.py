"""The fast generator computes what the plain one does: values and gradients."""

from __future__ import annotations

import copy

import pytest
import torch
from torch.nn import functional

from methods.cyclegan import layers as fast
from methods.cyclegan import stages
from methods.cyclegan.generator import JointConv, JointTrunk, make_generator
from methods.cyclegan.layers import Layer, Workspaces, chain
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


def plain_conv(x, weight, bias, layer):
    """What torch makes of one layer without norm and rectifier; weights are taps first."""
    groups, outputs = weight.shape[1:3]
    flat = x.permute(3, 0, 1, 2).flatten(1, 2)
    if layer.upsample:
        kernel = weight.permute(1, 3, 2, 0).flatten(0, 1)
        out = functional.conv_transpose1d(flat, kernel, stride=2, padding=1, output_padding=1, groups=groups)
    else:
        if layer.pad:
            mode = "reflect" if layer.padding == "reflect" else "constant"
            flat = functional.pad(flat, (layer.pad, layer.pad), mode=mode)
        kernel = weight.permute(1, 2, 3, 0).flatten(0, 1)
        out = functional.conv1d(flat, kernel, stride=layer.stride, groups=groups)
    out = out.unflatten(1, (groups, outputs)).permute(1, 2, 3, 0)
    return out if bias is None else out + bias[..., None, None]


def plain_norm(x, gain, shift, layer):
    """Instance norm and rectifier of torch."""
    groups, channels, frames, words = x.shape
    flat = x.permute(3, 0, 1, 2).reshape(words, groups * channels // layer.share, layer.share * frames)
    out = functional.instance_norm(flat, weight=gain.flatten(), bias=shift.flatten(), eps=1e-5)
    return out.reshape(words, groups, channels, frames).permute(1, 2, 3, 0)


def plain_chain(x, layers, tensors):
    """The same layers one by one in torch's own layout."""
    given = [x]
    for number, (layer, (weight, *rest)) in enumerate(zip(layers, tensors, strict=True)):
        bias = None if layer.norm else rest[0].repeat_interleave(layer.share, dim=1)
        out = plain_conv(given[-1], weight, bias, layer)
        if layer.norm:
            out = plain_norm(out, *rest, layer)
        if layer.residual:
            out = out + given[number - layer.residual]
        given.append(functional.leaky_relu(out, layer.slope))
    return given[-1]


def drawn_tensors(layers, channels, *, groups, seed=1):
    """Weights, and gains and shifts or biases, for layers between so many channels."""
    tensors = []
    for number, layer in enumerate(layers):
        inputs, outputs = channels[number : number + 2]
        row = [drawn(layer.taps, groups, outputs, inputs, seed=seed + 10 * number)]
        row += [
            drawn(groups, outputs // layer.share, seed=seed + 10 * number + k) for k in range(1, 3 if layer.norm else 2)
        ]
        tensors.append(row)
    return tensors


def flat(tensors):
    return [tensor for row in tensors for tensor in row]


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
        (5, 3, 2, "reflect"),
        (1, 1, 0, "zero"),
        (1, 2, 0, "zero"),
    ],
)
def test_convolution_is_that_of_torch(frames, taps, stride, pad, padding):
    layers = [Layer(taps, stride, pad, padding)]
    x, tensors = drawn(3, 4, frames, 2), drawn_tensors(layers, (4, 5), groups=3)
    agree(chain(x, layers, tensors), plain_chain(x, layers, tensors), (x, *flat(tensors)))


def test_upsampling_is_the_transposed_convolution_of_torch():
    layers = [Layer(3, upsample=True)]
    x, tensors = drawn(3, 4, 6, 2), drawn_tensors(layers, (4, 5), groups=3)
    agree(chain(x, layers, tensors), plain_chain(x, layers, tensors), (x, *flat(tensors)))


@pytest.mark.parametrize("norm", [True, False])
@pytest.mark.parametrize("upsample", [True, False])
@pytest.mark.parametrize("slope", [0.0, 0.2, 1.0])
@pytest.mark.parametrize("share", [1, 2])
def test_norm_and_rectifier_are_those_of_torch(norm, upsample, slope, share):
    layers = [Layer(3, pad=1, upsample=upsample, norm=norm, slope=slope, share=share)]
    x, tensors = drawn(2, 3, 6, 3), drawn_tensors(layers, (3, 4), groups=2)
    agree(chain(x, layers, tensors), plain_chain(x, layers, tensors), (x, *flat(tensors)))


#: Every way in which one layer hands its frames to the next: by phases, by pieces, padded, reflected, with a residual.
CHAINS = {
    "down and up": ([Layer(3, 2, 1, norm=True, slope=0.0), Layer(3, upsample=True, slope=0.2)], (3, 4, 2)),
    "up and down": ([Layer(3, upsample=True, norm=True, slope=0.0), Layer(4, 2, 1, "reflect")], (3, 4, 2)),
    "up twice": ([Layer(3, upsample=True, slope=0.0), Layer(3, upsample=True, norm=True)], (3, 4, 2)),
    "down twice": ([Layer(3, 2, 1, slope=0.2), Layer(3, 2, 1, "reflect", norm=True), Layer(1)], (3, 4, 2, 2)),
    "block": (
        [
            Layer(3, 1, 1, norm=True, slope=0.0),
            Layer(3, 1, 1, "reflect", norm=True, slope=0.0),
            Layer(3, 1, 1, "reflect", norm=True, residual=1),
            Layer(3, 1, 1, "reflect", slope=0.0),
            Layer(3, 1, 1, "reflect", residual=1),
            Layer(7, 1, 3, "reflect", slope=0.0),
        ],
        (3, 4, 5, 4, 3, 4, 2),
    ),
    "block before a stride": (
        [Layer(3, 1, 1, norm=True), Layer(3, 1, 1), Layer(3, 1, 1, residual=1), Layer(3, 2, 1, "reflect")],
        (3, 4, 5, 4, 2),
    ),
    "longer way around": (
        [Layer(3, 2, 1, slope=0.0), Layer(3, 1, 1), Layer(3, upsample=True, norm=True, residual=2)],
        (4, 3, 2, 4),
    ),
}


@pytest.mark.parametrize("inner", [1, 4, 16])
@pytest.mark.parametrize("at_once", [1, 10**9])
@pytest.mark.parametrize("name", CHAINS)
def test_a_chain_is_its_layers_one_by_one(name, at_once, inner, monkeypatch):
    """All groups at once, and one by one; with channels innermost in memory everywhere, here and there, and nowhere."""
    monkeypatch.setattr(fast, "AT_ONCE", at_once)
    monkeypatch.setattr(stages, "INNER", inner)
    layers, channels = CHAINS[name]
    x, tensors = drawn(3, channels[0], 12, 2), drawn_tensors(layers, channels, groups=3)
    theirs = plain_chain(x, layers, tensors)
    agree(chain(x, layers, tensors), theirs, (x, *flat(tensors)))
    with torch.no_grad():
        torch.testing.assert_close(chain(x, layers, tensors), theirs.detach(), rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("name", CHAINS)
def test_memory_is_used_again_but_by_one_walk_at_a_time(name):
    """Two walks forward before either goes back, and then again with other weights in the same place."""
    layers, channels = CHAINS[name]
    tensors, spaces = drawn_tensors(layers, channels, groups=3), Workspaces()
    xs = [drawn(3, channels[0], 12, 2, seed=seed) for seed in (5, 6)]
    for _ in range(3):
        ours = sum(chain(x, layers, tensors, spaces).square().sum() for x in xs)
        theirs = sum(plain_chain(x, layers, tensors).square().sum() for x in xs)
        found, wanted = (torch.autograd.grad(loss, [*xs, *flat(tensors)]) for loss in (ours, theirs))
        for one, two in zip(found, wanted, strict=True):
            torch.testing.assert_close(one, two, rtol=1e-9, atol=1e-9)
        assert [len(free) for free in spaces._free.values()] == [2]
        with torch.no_grad():
            for tensor in flat(tensors):
                tensor.mul_(1.1)
    assert copy.deepcopy(spaces)._free == {}
    spaces.clear()
    assert not spaces._free


def test_only_what_is_asked_for_gets_a_gradient():
    layers, channels = CHAINS["block"]
    x, tensors = drawn(3, channels[0], 12, 2), drawn_tensors(layers, channels, groups=3)
    whole = torch.autograd.grad(chain(x, layers, tensors).sum(), [x, *flat(tensors)])
    frozen = [[tensor.detach() for tensor in row] for row in tensors]
    (only_x,) = torch.autograd.grad(chain(x, layers, frozen).sum(), x)
    assert torch.equal(only_x, whole[0])
    given = x.detach()
    for one, two in zip(
        torch.autograd.grad(chain(given, layers, tensors).sum(), flat(tensors)), whole[1:], strict=True
    ):
        assert torch.equal(one, two)
    frozen[2][1] = tensors[2][1]
    (only_gain,) = torch.autograd.grad(chain(given, layers, frozen).sum(), tensors[2][1])
    assert torch.equal(only_gain, whole[1 + 3 * 2 + 1])


def test_gradients_handed_in_stay_as_they_are():
    """Autograd may hand the same array to several nodes."""
    layers, channels = CHAINS["block"]
    x, tensors = drawn(3, channels[0], 12, 2), drawn_tensors(layers, channels, groups=3)
    for last in (Layer(3, 1, 1), Layer(3, 1, 1, "reflect", norm=True)):
        rows = drawn_tensors([last], (channels[-1], channels[-1]), groups=3, seed=99)
        out = chain(x, [*layers, last], [*tensors, *rows])
        grad = drawn(*out.shape, seed=5).detach()
        before = grad.clone()
        torch.autograd.grad(out, x, grad)
        assert torch.equal(grad, before)


def test_a_second_walk_back_is_refused():
    layers, channels = CHAINS["block"]
    x, tensors = drawn(3, channels[0], 12, 2), drawn_tensors(layers, channels, groups=3)
    loss = chain(x, layers, tensors).sum()
    torch.autograd.grad(loss, x, retain_graph=True)
    with pytest.raises(RuntimeError, match="only once"):
        torch.autograd.grad(loss, x)


@pytest.mark.parametrize("odd", [{"padding": "circular"}, {"upsample": True}, {"residual": 1, "slope": 0.0}])
def test_layers_that_there_are_not_are_refused(odd):
    with pytest.raises(ValueError, match="no such layer"):
        Layer(4, **odd)


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
    convs = {id(module.weight): module for module in trunk.modules() if isinstance(module, JointConv)}
    for one, two, parameter in zip(mine, other, [x, *trunk.parameters()], strict=True):
        conv = convs.get(id(parameter))
        if conv is not None and conv.layer.upsample:
            # Transposed convolutions of torch keep their input channels first.
            two = two.unflatten(0, (joints, -1)).transpose(1, 2).flatten(0, 1)
        if conv is not None:
            # Ours have taps first.
            one = one.movedim((-3, -2, -1), (0, 1, 2))
        two = two.reshape(one.shape)
        size = float(two.abs().max())
        torch.testing.assert_close(one / size, two / size, rtol=0, atol=tolerance)
