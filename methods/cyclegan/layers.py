"""Temporal convolutions of many small groups at once, with norm, rectifier and residual, on tensors (G, C, T, B).

A group is a joint (or the whole body), C its channels, T frames, B words. Grouped convolutions of a handful of channels are
slow in their usual layout: each group is a product too small to be worth its set-up. With the words innermost, one tap of a
convolution is one batched matrix product over all joints, ``(C', C) @ (C, T B)``, whose right side is a shifted *view* of the
padded input: nothing is unfolded or copied, and normalising over time adds rows of B numbers.

What is left to save is traffic of memory, which costs more than the products. So a whole :func:`chain` of layers is one node of
the graph with a backward pass of its own. Each layer writes its result once, to where the next one reads it: between that
one's padding, and by even and odd frames where that one has stride 2. And as groups know nothing of each other, they go
through all layers a few at a time, as many as fit the processor's cache.

The arithmetic is that of ``torch.nn.Conv1d(groups=G)`` and ``torch.nn.InstanceNorm1d``, to which the tests hold it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable
from torch.nn import functional

PADDINGS = ("zero", "reflect")

#: Added to variances, as in ``torch.nn.InstanceNorm1d``.
EPS = 1e-5

#: Numbers in the largest activation of the groups that go through a chain together on a CPU; a few such arrays fit its cache.
AT_ONCE = 200_000


@dataclass(frozen=True)
class Layer:
    """What a layer does with its weight (K, G, C', C), taps first.

    Attributes
    ----------
    taps
        K.
    stride, pad, padding
        As in ``torch.nn.Conv1d``; ``padding`` is ``zero`` or ``reflect``.
    upsample
        The transposed convolution with kernel 3, stride 2, padding 1 and output padding 1, ``y[2t] = W_1 x[t]`` and ``y[2t+1] =
        W_2 x[t] + W_0 x[t+1]`` with ``x[T] = 0``, in place of the above.
    norm
        Instance norm with gain and shift (G, C' / share) after it: moments of each channel of each word over time. Without, a
        bias (G, C' / share) is added.
    slope
        Of the rectifier below zero at the end; 1 for none.
    share
        So many neighbouring channels are normalised together, as the places along the second axis of a two-dimensional
        convolution are.
    residual
        Add, at the end, the input of the layer so many places earlier in the chain; 0 for none.
    """

    taps: int
    stride: int = 1
    pad: int = 0
    padding: str = "zero"
    upsample: bool = False
    norm: bool = False
    slope: float = 1.0
    share: int = 1
    residual: int = 0

    def __post_init__(self) -> None:
        if self.padding not in PADDINGS or (self.upsample and self.taps != 3) or (self.residual and self.slope != 1.0):
            raise ValueError(f"there is no such layer: {self}")

    @property
    def products(self) -> int:
        """Matrix products that a result is the sum of."""
        return 2 if self.upsample else self.taps

    @property
    def before(self) -> int:
        """Frames of padding in front of the input."""
        return 0 if self.upsample else self.pad

    @property
    def after(self) -> int:
        """Frames of padding behind the input."""
        return 1 if self.upsample else self.pad

    @property
    def phases(self) -> int:
        """Input frames are held apart by their remainder modulo so many."""
        return 1 if self.upsample else self.stride

    @property
    def pieces(self) -> int:
        """Output frames come apart by their remainder modulo so many."""
        return 2 if self.upsample else 1

    def rows(self, frames: int) -> int:
        """Frames of each piece of the output for so many input frames."""
        return frames if self.upsample else (frames + 2 * self.pad - self.taps) // self.stride + 1


#: Where a chain's result goes: read as it is.
_END = Layer(1)


class _Frames:
    """Frames (G, C, T, B) with the padding of the layer that reads them, apart by phase."""

    def __init__(self, layer: Layer, frames: int, held: Sequence[Tensor]) -> None:
        self.layer, self.frames, self.held = layer, frames, held

    @classmethod
    def empty(cls, layer: Layer, like: Tensor, groups: int, channels: int, frames: int) -> _Frames:
        whole = frames + layer.before + layer.after
        rows = [len(range(phase, whole, layer.phases)) for phase in range(layer.phases)]
        return cls(layer, frames, [like.new_empty(groups, channels, count, like.shape[3]) for count in rows])

    def every(self, first: int, step: int) -> Tensor:
        """The frames ``first``, ``first + step`` …, a view; ``step`` is a multiple of the number of phases."""
        place, phases = first + self.layer.before, self.layer.phases
        count = len(range(first, self.frames, step))
        held = self.held[place % phases]
        if step == phases:
            return held.narrow(2, place // phases, count)
        return held[:, :, place // phases :: step // phases][:, :, :count]

    def one(self, frame: int) -> Tensor:
        """(G, C, B) a frame, counted from the first that is not padding; a view."""
        place, phases = frame + self.layer.before, self.layer.phases
        return self.held[place % phases].select(2, place // phases)

    def reflections(self) -> Iterator[tuple[Tensor, Tensor]]:
        """Frames of padding, each with the one that it repeats."""
        for k in range(self.layer.pad):
            yield self.one(-1 - k), self.one(1 + k)
            yield self.one(self.frames + k), self.one(self.frames - 2 - k)

    def pad(self) -> None:
        """Fill the padding in."""
        if self.layer.padding == "reflect":
            for padding, inner in self.reflections():
                padding.copy_(inner)
            return
        for k in range(self.layer.before):
            self.one(-1 - k).zero_()
        for k in range(self.layer.after):
            self.one(self.frames + k).zero_()

    def fold(self) -> None:
        """The adjoint of :meth:`pad`."""
        if self.layer.padding == "reflect":
            for padding, inner in self.reflections():
                inner.add_(padding)


def _split(rows: Tensor, pieces: int, steps: int) -> list[Tensor]:
    """Frames (G, C, T, B) that come in ``pieces`` to every ``steps``-th of them from the first, from the second and so on."""
    if pieces == 1:
        return [rows] if steps == 1 else [rows[:, :, first::steps] for first in range(steps)]
    count = rows.shape[2] // pieces
    return [rows.narrow(2, piece * count, count) for piece in range(pieces)]


def _steps(layer: Layer, reader: Layer) -> int:
    return max(layer.pieces, reader.phases)


def _wide(values: Tensor, share: int) -> Tensor:
    """(G, C / share) to (G, C, 1, 1)."""
    return (values if share == 1 else values.repeat_interleave(share, dim=1))[..., None, None]


@dataclass
class _Kept:
    """What the backward pass of a layer needs of the forward pass.

    Of the norm: results of the convolution less their means, and one over their standard deviations.
    """

    given: _Frames
    centred: Tensor | None = None
    scale: Tensor | None = None


def _stacked(layer: Layer, weight: Tensor) -> Tensor:
    """The weight (K, G, C' P, C) of the products whose sum holds all P pieces of a layer's output, channel by channel.

    The two pieces of an upsampling layer, even and odd frames, are further channels of a convolution of x[t] and x[t+1], for
    the price of a product with zeros.
    """
    if not layer.upsample:
        return weight
    following, even, odd = weight.unbind(0)
    now = torch.stack((even, odd), dim=2)
    then = torch.stack((torch.zeros_like(following), following), dim=2)
    return torch.stack((now, then)).flatten(2, 3)


def _forward_layer(
    layer: Layer, tensors: Sequence[Tensor], given: _Frames, result: _Frames, added: _Frames | None
) -> _Kept:
    """Fill ``result`` in, without its padding."""
    weight, *rest = tensors
    _, groups, outputs, _ = weight.shape
    words, rows = given.held[0].shape[3], layer.rows(given.frames)
    flats = [held.flatten(2) for held in given.held]
    out = weight.new_empty(groups, outputs, rows * words)
    for tap in range(layer.products):
        source = flats[tap % layer.phases].narrow(2, tap // layer.phases * words, rows * words)
        if tap == 0:
            torch.bmm(weight[tap], source, out=out)
        else:
            out.baddbmm_(weight[tap], source)
    frames = layer.pieces * rows
    out = out.view(groups, outputs // layer.pieces, frames, words)
    kept = _Kept(given)
    if layer.norm:
        # Channels that share their moments are further rows to add up.
        centred = out.view(groups, -1, layer.share * frames, words)
        part = 1.0 / centred.shape[2]
        # torch.var over a middle axis is a hundred times slower than two sums.
        centred.sub_(centred.sum(2, keepdim=True).mul_(part))
        scale = (centred * centred).sum(2, keepdim=True).mul_(part).add_(EPS).rsqrt_()
        kept.centred, kept.scale = centred, scale
        factor = scale * rest[0][..., None, None]
        if layer.share > 1:
            factor = factor.repeat_interleave(layer.share, dim=1)
    shift = _wide(rest[-1], layer.share)
    steps = _steps(layer, result.layer)
    for first, source in enumerate(_split(out, layer.pieces, steps)):
        place = result.every(first, steps)
        if layer.norm:
            # Two steps: torch's kernels for two operands are vectorised under broadcasting, those for three are not.
            torch.mul(source, factor, out=place)
            place.add_(shift)
        else:
            torch.add(source, shift, out=place)
        if added is not None:
            place.add_(added.every(first, steps))
        if layer.slope == 0.0:
            place.relu_()
        elif layer.slope != 1.0:
            functional.leaky_relu_(place, layer.slope)
    return kept


def _backward_norm(kept: _Kept, grad: Tensor, gain: Tensor, grads: Sequence[Tensor | None], place: Tensor) -> None:
    """From the gradient after gain and shift to that before the norm, into ``place``; and those of gain and shift."""
    centred, scale = kept.centred, kept.scale
    assert centred is not None and scale is not None
    rows = grad.reshape(centred.shape)
    part = 1.0 / centred.shape[2]
    out = rows * centred
    along, total = out.sum(2, keepdim=True).mul_(scale), rows.sum(2, keepdim=True)
    for found, sums in zip(grads, (along, total), strict=True):
        if found is not None:
            torch.sum(sums, dim=(2, 3), out=found)
    torch.mul(centred, along.mul_(scale).mul_(part), out=out)
    torch.sub(rows, out, out=out)
    out.sub_(total.mul_(part))
    factor = scale * gain[..., None, None]
    if out.shape == place.shape:
        torch.mul(out, factor, out=place)
    else:
        place.copy_(out.mul_(factor).view(place.shape))


def _backward_layer(
    layer: Layer,
    tensors: Sequence[Tensor],
    kept: _Kept,
    grad: Tensor,
    grads: Sequence[Tensor | None],
    *,
    further: bool,
) -> _Frames | None:
    """From the gradient of a layer before its rectifier to that of its padded input; fills in those of its weights."""
    weight, *rest = tensors
    given = kept.given
    words, rows = grad.shape[3], layer.rows(given.frames)
    # Between frames of zeros, as far as the products below reach.
    reach = (layer.products - 1) // layer.phases
    longest = max(held.shape[2] for held in given.held)
    around = grad.new_empty(grad.shape[0], weight.shape[2], reach + max(longest, rows), words)
    around[:, :, :reach].zero_()
    around[:, :, reach + rows :].zero_()
    inner = around.narrow(2, reach, rows)
    if layer.norm:
        _backward_norm(kept, grad, rest[0], grads[1:], inner)
    else:
        inner.copy_(grad.reshape(inner.shape))
        if grads[1] is not None:
            sums = grad.sum(dim=(2, 3))
            grads[1].copy_(sums if layer.share == 1 else sums.unflatten(1, (-1, layer.share)).sum(2))
    if grads[0] is not None:
        flat = inner.flatten(2)
        sources = [held.flatten(2) for held in given.held]
        for tap in range(layer.products):
            source = sources[tap % layer.phases].narrow(2, tap // layer.phases * words, rows * words)
            torch.bmm(flat, source.transpose(1, 2), out=grads[0][tap])
    if not further:
        return None
    found = _Frames(layer, given.frames, [torch.empty_like(held) for held in given.held])
    flat = around.flatten(2)
    for phase, held in enumerate(found.held):
        place = held.flatten(2)
        for tap in range(phase, layer.products, layer.phases):
            source = flat.narrow(2, (reach - tap // layer.phases) * words, place.shape[2])
            if tap == phase:
                torch.bmm(weight[tap].transpose(1, 2), source, out=place)
            else:
                place.baddbmm_(weight[tap].transpose(1, 2), source)
        if phase >= layer.products:
            held.zero_()
    found.fold()
    return found


def _before_rectifier(layer: Layer, grads: _Frames, results: _Frames) -> Tensor:
    """The gradient of a layer's result before its rectifier, frames in the order of the layer's pieces.

    A view of ``grads`` where nothing is to be done: not to be written to.
    """
    steps = _steps(layer, grads.layer)
    views = [grads.every(first, steps) for first in range(steps)]
    if steps == 1 and layer.slope == 1.0:
        return views[0]
    groups, channels, _, words = views[0].shape
    out = views[0].new_empty(groups, channels, grads.frames, words)
    for first, (view, place) in enumerate(zip(views, _split(out, layer.pieces, steps), strict=True)):
        if layer.slope == 1.0:
            place.copy_(view)
        elif layer.slope == 0.0:
            torch.ops.aten.threshold_backward.grad_input(view, results.every(first, steps), 0.0, grad_input=place)
        else:
            torch.ops.aten.leaky_relu_backward.grad_input(
                view, results.every(first, steps), layer.slope, True, grad_input=place
            )
    return out


def _forward(
    layers: Sequence[Layer], tensors: Sequence[Sequence[Tensor]], x: Tensor, out: Tensor, *, keep: bool
) -> list[_Kept]:
    """A chain on some groups: (G, C, T, B) into ``out``."""
    given = _Frames.empty(layers[0], x, x.shape[0], x.shape[1], x.shape[2])
    for first in range(layers[0].phases):
        given.every(first, layers[0].phases).copy_(x[:, :, first :: layers[0].phases])
    kept: list[_Kept] = []
    reach = max(layer.residual for layer in layers)
    for number, (layer, own) in enumerate(zip(layers, tensors, strict=True)):
        given.pad()
        if number == len(layers) - 1:
            result = _Frames(_END, out.shape[2], [out])
        else:
            frames = layer.pieces * layer.rows(given.frames)
            result = _Frames.empty(layers[number + 1], x, x.shape[0], own[0].shape[2] // layer.pieces, frames)
        added = kept[number - layer.residual].given if layer.residual else None
        kept.append(_forward_layer(layer, own, given, result, added))
        if not keep and number >= reach:
            # Memory that is given back at once is still in the cache when the next layer asks for some.
            kept[-1].centred = None
            kept[number - reach].given.held = ()
        given = result
    return kept


def _backward(
    layers: Sequence[Layer],
    tensors: Sequence[Sequence[Tensor]],
    kept: Sequence[_Kept],
    out: Tensor | None,
    grad: Tensor,
    grads: Sequence[Sequence[Tensor | None]],
    grad_x: Tensor | None,
) -> None:
    """The backward pass of a chain on some groups; fills in ``grads`` and ``grad_x``."""
    found: _Frames | None = _Frames(_END, grad.shape[2], [grad])
    later: dict[int, tuple[Tensor, int]] = {}
    for number in reversed(range(len(layers))):
        layer = layers[number]
        if number + 1 < len(layers):
            results = kept[number + 1].given
        else:
            results = _Frames(_END, grad.shape[2], [grad if out is None else out])
        assert found is not None
        before = _before_rectifier(layer, found, results)
        if layer.residual:
            later[number - layer.residual] = before, layer.pieces
        further = number > 0 or grad_x is not None
        found = _backward_layer(layer, tensors[number], kept[number], before, grads[number], further=further)
        if found is not None and number in later:
            around, pieces = later.pop(number)
            steps = max(pieces, layer.phases)
            for first, source in enumerate(_split(around, pieces, steps)):
                found.every(first, steps).add_(source)
    if grad_x is not None:
        assert found is not None
        steps = layers[0].phases
        for first in range(steps):
            grad_x[:, :, first::steps] = found.every(first, steps)


def _by_layer(layers: Sequence[Layer], flat: Sequence[Any]) -> list[list[Any]]:
    """Entries for all tensors of all layers, layer by layer."""
    entries = iter(flat)
    return [[next(entries) for _ in range(3 if layer.norm else 2)] for layer in layers]


def _of_groups(rows: Sequence[Sequence[Any]], groups: slice) -> list[list[Any]]:
    """The part of some groups of all tensors of all layers, as views."""

    def part(tensor: Tensor | None) -> Tensor | None:
        if tensor is None:
            return None
        return tensor[:, groups] if tensor.ndim == 4 else tensor[groups]

    return [[part(tensor) for tensor in row] for row in rows]


def _parts(layers: Sequence[Layer], tensors: Sequence[Sequence[Tensor]], x: Tensor) -> list[slice]:
    """Which groups go through a chain together."""
    groups, channels, frames, words = x.shape
    if x.device.type != "cpu":
        return [slice(0, groups)]
    largest = channels * frames
    for layer, (weight, *_) in zip(layers, tensors, strict=True):
        frames = layer.pieces * layer.rows(frames)
        largest = max(largest, weight.shape[2] // layer.pieces * frames)
    count = -(-groups // max(1, AT_ONCE // (largest * words)))
    size = -(-groups // min(count, groups))
    return [slice(first, min(first + size, groups)) for first in range(0, groups, size)]


def _run(
    layers: Sequence[Layer],
    tensors: Sequence[Sequence[Tensor]],
    x: Tensor,
    each: Callable[[slice, list[_Kept]], None] | None = None,
) -> Tensor:
    frames = x.shape[2]
    for layer in layers:
        frames = layer.pieces * layer.rows(frames)
    out = x.new_empty(x.shape[0], tensors[-1][0].shape[2] // layers[-1].pieces, frames, x.shape[3])
    for part in _parts(layers, tensors, x):
        kept = _forward(layers, _of_groups(tensors, part), x[part], out[part], keep=each is not None)
        if each is not None:
            each(part, kept)
    return out


class _Chain(Function):
    """See :func:`chain`."""

    @staticmethod
    def forward(ctx: Any, layers: Sequence[Layer], x: Tensor, *flat: Tensor) -> Tensor:
        ctx.layers, ctx.shape, ctx.kept = layers, x.shape, []
        out = _run(layers, _by_layer(layers, flat), x, lambda part, kept: ctx.kept.append((part, kept)))
        # Of the last layer nothing but its result says where its rectifier was open.
        last = () if layers[-1].slope == 1.0 else (out,)
        ctx.save_for_backward(*flat, *last)
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Any, ...]:
        if not ctx.kept:
            raise RuntimeError("a chain can be walked back through only once")
        layers, (_, need_x, *needed) = ctx.layers, ctx.needs_input_grad
        flat, out = ctx.saved_tensors, None
        if layers[-1].slope != 1.0:
            *flat, out = flat
        tensors = _by_layer(layers, flat)
        found = [torch.empty_like(tensor) if need else None for tensor, need in zip(flat, needed, strict=True)]
        grads = _by_layer(layers, found)
        grad = grad.contiguous()
        grad_x = grad.new_empty(ctx.shape) if need_x else None
        while ctx.kept:
            part, kept = ctx.kept.pop()
            _backward(
                layers,
                _of_groups(tensors, part),
                kept,
                None if out is None else out[part],
                grad[part],
                _of_groups(grads, part),
                None if grad_x is None else grad_x[part],
            )
        return None, grad_x, *found


def chain(x: Tensor, layers: Sequence[Layer], tensors: Sequence[Sequence[Tensor]]) -> Tensor:
    """Take every group through layers of its own.

    Parameters
    ----------
    x
        (G, C, T, B).
    layers
        What each layer does.
    tensors
        For each layer its weight (K, G, C', C), then gain and shift if it has a norm, else the bias.

    Returns
    -------
    Tensor
        (G, C', T', B). Can be differentiated once, and walked back through once.
    """
    tensors = [[_stacked(layer, weight), *rest] for layer, (weight, *rest) in zip(layers, tensors, strict=True)]
    if not torch.is_grad_enabled():
        return _run(layers, tensors, x)
    return _Chain.apply(layers, x, *(tensor for row in tensors for tensor in row))
