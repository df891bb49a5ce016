"""Temporal convolutions of many small groups at once, with norm, rectifier and residual, on tensors (G, C, T, B).

A group is a joint (or the whole body), C its channels, T frames, B words. Grouped convolutions of a handful of channels are
slow in their usual layout: each group is a product too small to be worth its set-up. With frames outside and words inside, one
tap of a convolution is one batched matrix product over all joints, ``(C', C) @ (C, T B)``, whose right side is a shifted *view*
of the padded input: nothing is unfolded or copied, and normalising over time adds rows of B numbers or more.

What is left to save is traffic of memory and calls, which cost more than the products. So a whole :func:`chain` of layers is
one node of the graph with a backward pass of its own. Each layer writes its result once, to where the next one reads it:
between that one's padding, and by even and odd frames where that one has stride 2. As groups know nothing of each other, they
go through all layers a few at a time, as many as fit the processor's cache. And memory and views are made once and used again
(:class:`Workspaces`).

The arithmetic is that of ``torch.nn.Conv1d(groups=G)`` and ``torch.nn.InstanceNorm1d``, to which the tests hold it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Self

import torch
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable

from methods.cyclegan.stages import END, Frames, Layer, Memory, Stage, split, stacked

__all__ = ["AT_ONCE", "Layer", "Workspaces", "chain"]

#: Numbers in the largest activation of the groups that go through a chain together on a CPU; a few such arrays fit its cache.
AT_ONCE = 200_000


class _Walk:
    """A chain on some groups, with all memory for a walk forward and, if ``keep``, back.

    Parameters
    ----------
    layers, tensors
        Of the chain.
    x
        (G, C, T, B) all groups.
    groups
        Those of this walk.
    keep
        Whether there is a way back.
    """

    def __init__(
        self,
        layers: Sequence[Layer],
        tensors: Sequence[Sequence[Tensor]],
        x: Tensor,
        groups: slice,
        *,
        keep: bool,
    ) -> None:
        self.layers = layers
        memory = Memory(x)
        reach = max(layer.residual for layer in layers)
        channels, frames, inner = x.shape[1], x.shape[2], False
        self.stages: list[Stage] = []
        for number, (layer, (weight, *_)) in enumerate(zip(layers, tensors, strict=True)):
            name = "given", number if keep else number % (reach + 2)
            shape = groups.stop - groups.start, channels, frames, x.shape[3]
            given = Frames.empty(memory, name, layer, shape, inner=inner)
            channels = weight.shape[2] // layer.pieces
            stage = Stage(memory, number, layer, groups, given, channels, reach=reach, keep=keep)
            self.stages.append(stage)
            frames, inner = stage.frames, stage.inner

    def forward(self, tensors: Sequence[Sequence[Tensor]], x: Tensor, out: Tensor) -> None:
        """(G, C, T, B) of these groups into ``out``."""
        first = self.stages[0].given
        phases = first.layer.phases
        for phase in range(phases):
            first.every(phase, phases).copy_(x[:, :, phase::phases])
        givens = [stage.given for stage in self.stages]
        results = [*givens[1:], Frames(END, out.shape[2], [out])]
        for number, (stage, own, result) in enumerate(zip(self.stages, tensors, results, strict=True)):
            stage.given.pad()
            residual = stage.layer.residual
            stage.forward(own, result, givens[number - residual] if residual else None)

    def backward(
        self,
        tensors: Sequence[Sequence[Tensor]],
        out: Tensor | None,
        grad: Tensor,
        grads: Sequence[Sequence[Tensor | None]],
        grad_x: Tensor | None,
    ) -> None:
        """Fill in ``grads`` and ``grad_x`` from the gradient of these groups' result."""
        found: Frames | None = Frames(END, grad.shape[2], [grad])
        results = Frames(END, grad.shape[2], [grad if out is None else out])
        later: dict[int, tuple[Tensor, int]] = {}
        for number in reversed(range(len(self.stages))):
            stage, layer = self.stages[number], self.layers[number]
            assert found is not None
            before = stage.before_rectifier(found, results)
            if layer.residual:
                later[number - layer.residual] = before, layer.pieces
            further = number > 0 or grad_x is not None
            found = stage.backward(tensors[number], before, grads[number], further=further)
            if found is not None and number in later:
                around, pieces = later.pop(number)
                steps = max(pieces, layer.phases)
                for first, source in enumerate(split(around, pieces, steps)):
                    found.every(first, steps).add_(source)
            results = stage.given
        if grad_x is not None:
            assert found is not None
            steps = self.layers[0].phases
            for first in range(steps):
                grad_x[:, :, first::steps] = found.every(first, steps)


class Workspaces:
    """Memory of walks through a chain that are over, for those to come: a training asks for the same sizes all the time.

    It is as much as a walk through all layers and back needs, for as many walks as were under way at once. Copies of it are
    empty.
    """

    def __init__(self) -> None:
        self._free: dict[Any, list[_Walk]] = {}

    def __deepcopy__(self, memo: object) -> Self:
        return type(self)()

    def __reduce__(self) -> Any:
        return type(self), ()

    def clear(self) -> None:
        """Give all of it back."""
        self._free.clear()

    def take(
        self, layers: Sequence[Layer], tensors: Sequence[Sequence[Tensor]], x: Tensor, groups: slice
    ) -> tuple[Any, _Walk]:
        """A walk that nobody else is on, and what it is put back under."""
        shapes = tuple(row[0].shape for row in tensors)
        key = tuple(layers), shapes, x.shape, x.dtype, x.device, groups.start, groups.stop
        free = self._free.setdefault(key, [])
        return key, free.pop() if free else _Walk(layers, tensors, x, groups, keep=True)

    def put(self, key: Any, walk: _Walk) -> None:
        """Done with it."""
        self._free.setdefault(key, []).append(walk)


def _by_layer(layers: Sequence[Layer], flat: Sequence[Any]) -> list[list[Any]]:
    """Entries for all tensors of all layers, layer by layer."""
    entries = iter(flat)
    return [[next(entries) for _ in range(3 if layer.norm else 2)] for layer in layers]


def _of_groups(rows: Sequence[Sequence[Tensor | None]], groups: slice) -> list[list[Tensor | None]]:
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
    walk_for: Callable[[slice], _Walk],
) -> Tensor:
    frames = x.shape[2]
    for layer in layers:
        frames = layer.pieces * layer.rows(frames)
    out = x.new_empty(x.shape[0], tensors[-1][0].shape[2] // layers[-1].pieces, frames, x.shape[3])
    for groups in _parts(layers, tensors, x):
        walk_for(groups).forward(tensors, x[groups], out[groups])
    return out


class _Chain(Function):
    """See :func:`chain`."""

    @staticmethod
    def forward(ctx: Any, layers: Sequence[Layer], spaces: Workspaces, x: Tensor, *flat: Tensor) -> Tensor:
        ctx.layers, ctx.shape, ctx.spaces, ctx.walks = layers, x.shape, spaces, []
        tensors = _by_layer(layers, flat)

        def walk_for(groups: slice) -> _Walk:
            ctx.walks.append((groups, *spaces.take(layers, tensors, x, groups)))
            walk: _Walk = ctx.walks[-1][-1]
            return walk

        out = _run(layers, tensors, x, walk_for)
        # Of the last layer nothing but its result says where its rectifier was open.
        last = () if layers[-1].slope == 1.0 else (out,)
        ctx.save_for_backward(*flat, *last)
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Any, ...]:
        if not ctx.walks:
            raise RuntimeError("a chain can be walked back through only once")
        layers, (_, _, need_x, *needed) = ctx.layers, ctx.needs_input_grad
        flat, out = ctx.saved_tensors, None
        if layers[-1].slope != 1.0:
            *flat, out = flat
        tensors = _by_layer(layers, flat)
        found = [torch.empty_like(tensor) if need else None for tensor, need in zip(flat, needed, strict=True)]
        grads = _by_layer(layers, found)
        grad = grad.contiguous()
        grad_x = grad.new_empty(ctx.shape) if need_x else None
        while ctx.walks:
            groups, key, walk = ctx.walks.pop()
            walk.backward(
                tensors,
                None if out is None else out[groups],
                grad[groups],
                _of_groups(grads, groups),
                None if grad_x is None else grad_x[groups],
            )
            ctx.spaces.put(key, walk)
        return None, None, grad_x, *found


def chain(
    x: Tensor, layers: Sequence[Layer], tensors: Sequence[Sequence[Tensor]], spaces: Workspaces | None = None
) -> Tensor:
    """Take every group through layers of its own.

    Parameters
    ----------
    x
        (G, C, T, B).
    layers
        What each layer does.
    tensors
        For each layer its weight (K, G, C', C), then gain and shift if it has a norm, else the bias.
    spaces
        Memory to use again, of a chain that is walked often.

    Returns
    -------
    Tensor
        (G, C', T', B). Can be differentiated once, and walked back through once.
    """
    tensors = [[stacked(layer, weight), *rest] for layer, (weight, *rest) in zip(layers, tensors, strict=True)]
    if not torch.is_grad_enabled():
        return _run(layers, tensors, x, lambda groups: _Walk(layers, tensors, x, groups, keep=False))
    flat = (tensor for row in tensors for tensor in row)
    return _Chain.apply(layers, Workspaces() if spaces is None else spaces, x, *flat)
