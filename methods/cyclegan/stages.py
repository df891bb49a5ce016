"""One layer of a chain on some groups, forward and backward by hand, in memory that is laid out once.

Tensors are (G, C, T, B) wherever they are written about. In memory the words are innermost, or the channels, where there are
enough of them (:data:`INNER`): a sum over frames then runs along rows of B C numbers in place of B, and a product is as fast.

At this size a call of torch costs about as much as its arithmetic, and so do making views and asking for memory. So a
:class:`Stage` makes all its buffers and views when it is built, and a pass is nothing but calls on them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

PADDINGS = ("zero", "reflect")

#: Added to variances, as in ``torch.nn.InstanceNorm1d``.
EPS = 1e-5

#: So many channels or more are innermost in memory. BLAS is slow at products with fewer columns.
INNER = 16


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


#: What reads a chain's result: as it is.
END = Layer(1)


class Memory:
    """Buffers of one device and type, the same one for the same name and size."""

    def __init__(self, like: Tensor) -> None:
        self._like, self._held = like.new_empty(0), dict[Any, Tensor]()

    def take(self, name: object, shape: tuple[int, int, int, int], *, inner: bool, zero: bool = False) -> Tensor:
        """(G, C, T, B), channels innermost if ``inner``; zeros at first if ``zero``."""
        key = name, shape, inner
        if key not in self._held:
            groups, channels, frames, words = shape
            order = (groups, frames, words, channels) if inner else shape
            held = self._like.new_zeros(order) if zero else self._like.new_empty(order)
            self._held[key] = held.permute(0, 3, 1, 2) if inner else held
        return self._held[key]


class Frames:
    """Frames (G, C, T, B) with the padding of the layer that reads them, apart by phase."""

    def __init__(self, layer: Layer, frames: int, held: Sequence[Tensor], *, inner: bool = False) -> None:
        self.layer, self.frames, self.held, self.inner = layer, frames, held, inner
        self._every: dict[tuple[int, int], Tensor] = {}
        self._reflections: list[tuple[Tensor, Tensor]] | None = None

    @classmethod
    def empty(
        cls, memory: Memory, name: object, layer: Layer, shape: tuple[int, int, int, int], *, inner: bool
    ) -> Frames:
        """Room for frames of a shape. Padding of zeros is there for good: nothing writes to it."""
        groups, channels, frames, words = shape
        whole = frames + layer.before + layer.after
        held = []
        for phase in range(layer.phases):
            key = name, layer.before, layer.after, layer.padding, phase
            rows = len(range(phase, whole, layer.phases))
            held.append(memory.take(key, (groups, channels, rows, words), inner=inner, zero=True))
        return cls(layer, frames, held, inner=inner)

    def every(self, first: int, step: int) -> Tensor:
        """The frames ``first``, ``first + step`` …, a view; ``step`` is a multiple of the number of phases."""
        if (first, step) not in self._every:
            place, phases = first + self.layer.before, self.layer.phases
            count = len(range(first, self.frames, step))
            held = self.held[place % phases]
            self._every[first, step] = held[:, :, place // phases :: step // phases][:, :, :count]
        return self._every[first, step]

    def flat(self, first: int, count: int) -> Tensor:
        """(G, C, count B) rows of frames that are held together, from the one in place ``first``, padding included; a view."""
        held = self.held[first % self.layer.phases]
        words, start = held.shape[3], first // self.layer.phases
        return flattened(held).narrow(2, start * words, count * words)

    def reflections(self) -> list[tuple[Tensor, Tensor]]:
        """Frames of padding, each with the one that it repeats."""
        if self._reflections is None:
            pairs = [(-1 - k, 1 + k) for k in range(self.layer.pad)]
            pairs += [(self.frames + k, self.frames - 2 - k) for k in range(self.layer.pad)]
            self._reflections = [(self._one(to), self._one(of)) for to, of in pairs]
        return self._reflections

    def pad(self) -> None:
        """Fill reflections in."""
        if self.layer.padding == "reflect":
            for padding, within in self.reflections():
                padding.copy_(within)

    def fold(self) -> None:
        """The adjoint of :meth:`pad`."""
        if self.layer.padding == "reflect":
            for padding, within in self.reflections():
                within.add_(padding)

    def _one(self, frame: int) -> Tensor:
        """(G, C, B) a frame, counted from the first that is not padding; a view."""
        place, phases = frame + self.layer.before, self.layer.phases
        return self.held[place % phases].select(2, place // phases)


def flattened(frames: Tensor) -> Tensor:
    """(G, C, T, B) to (G, C, T B), a view."""
    return frames.view(*frames.shape[:2], -1)


def split(rows: Tensor, pieces: int, steps: int) -> list[Tensor]:
    """Frames (G, C, T, B) that come in ``pieces`` to every ``steps``-th of them from the first, from the second and so on."""
    if pieces == 1:
        return [rows] if steps == 1 else [rows[:, :, first::steps] for first in range(steps)]
    count = rows.shape[2] // pieces
    return [rows.narrow(2, piece * count, count) for piece in range(pieces)]


def steps_between(layer: Layer, reader: Layer) -> int:
    """A layer's frames are handed on by their remainder modulo so many."""
    return max(layer.pieces, reader.phases)


def stacked(layer: Layer, weight: Tensor) -> Tensor:
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


class _Weights:
    """A layer's weights as products and norms take them: taps, each as it is and turned, and gain and shift or bias."""

    def __init__(self, groups: slice, tensors: Sequence[Tensor]) -> None:
        self.pointers = [tensor.data_ptr() for tensor in tensors]
        weight, *rest = (tensor.detach() for tensor in tensors)
        self.taps = weight[:, groups].unbind(0)
        self.turned = [tap.transpose(1, 2) for tap in self.taps]
        self.rest = [tensor[groups, :, None, None] for tensor in rest]

    def hold(self, tensors: Sequence[Tensor]) -> bool:
        """Whether these are views of those tensors; they keep the memory, so that no other tensor gets it."""
        return self.pointers == [tensor.data_ptr() for tensor in tensors]


class Stage:
    """A layer on some groups.

    Parameters
    ----------
    memory
        Of the walk.
    number
        Of the layer in its chain.
    layer
        What it does.
    groups
        Which of all groups these are.
    given
        Its input.
    channels
        C'.
    reach
        Of the longest residual of the chain.
    keep
        Whether there is a way back, for which what it needs is kept. Without, layers share their buffers.
    """

    def __init__(
        self,
        memory: Memory,
        number: int,
        layer: Layer,
        groups: slice,
        given: Frames,
        channels: int,
        *,
        reach: int,
        keep: bool,
    ) -> None:
        self.layer, self.groups, self.given = layer, groups, given
        count, inputs, _, words = given.held[0].shape
        rows, pieces, share = layer.rows(given.frames), layer.pieces, layer.share
        self.frames = pieces * rows
        self.inner = channels >= INNER and share == 1 and pieces == 1
        own = number if keep else None

        def take(name: object, channels: int, frames: int, *, zero: bool = False) -> Tensor:
            return memory.take(name, (count, channels, frames, words), inner=self.inner, zero=zero)

        out = take(("out", own), channels * pieces, rows)
        #: (G, C', T', B) what is handed on.
        self.out = out.view(count, channels, self.frames, words)
        self._product = self._oriented(flattened(out))
        self._sources = [given.flat(tap, rows) for tap in range(layer.products)]
        self._oriented_sources = [self._oriented(source) for source in self._sources]
        self._weights: _Weights | None = None

        # Channels that share their moments are further rows to add up.
        normed = channels // share
        self._shift = take("shift", channels, 1)
        self._by_channel = self._shift.view(count, normed, share, words)
        if layer.norm:
            self.rows = out.view(count, normed, share * self.frames, words)
            self._part = 1.0 / (share * self.frames)
            self._spare = take("spare", normed, share * self.frames)
            self._sums, self._along = take("sums", normed, 1), take("along", normed, 1)
            self._scale, self._factor = take(("scale", own), normed, 1), take(("factor", own), normed, 1)
            self._wide = self._factor if share == 1 else take("wide", channels, 1)
            self._eps = out.new_full((), EPS)
        if not keep:
            return

        # Gradients: of the output between frames of zeros, as far as products reach; and of the padded input.
        reach_back = (layer.products - 1) // layer.phases
        longest = max(held.shape[2] for held in given.held)
        self._before = take(("before", number if layer.residual else None), channels, self.frames)
        name = "around", reach_back, rows
        around = take(name, channels * pieces, reach_back + max(longest, rows), zero=True)
        within = around.narrow(2, reach_back, rows)
        self._within = within.view(count, normed, share, pieces, rows, words)
        flat = flattened(around)
        self._grad_rows = flat.narrow(2, reach_back * words, rows * words)
        self._turned_sources = [source.transpose(1, 2) for source in self._sources]
        self._found = Frames.empty(
            memory,
            ("found", number % (reach + 2)),
            layer,
            (count, inputs, given.frames, words),
            inner=given.inner,
        )
        #: For each phase of the input: where its gradient goes, and the taps and gradients whose products are summed there.
        self._ways_back: list[tuple[Tensor, list[tuple[int, Tensor]]]] = []
        for phase, held in enumerate(self._found.held):
            place, pairs = flattened(held), []
            for tap in range(phase, layer.products, layer.phases):
                source = flat.narrow(2, (reach_back - tap // layer.phases) * words, place.shape[2])
                pairs.append((tap, source.transpose(1, 2) if given.inner else source))
            self._ways_back.append((place.transpose(1, 2) if given.inner else place, pairs))

    def _oriented(self, flat: Tensor) -> Tensor:
        return flat.transpose(1, 2) if self.inner else flat

    def _own(self, tensors: Sequence[Tensor]) -> _Weights:
        if self._weights is None or not self._weights.hold(tensors):
            self._weights = _Weights(self.groups, tensors)
        return self._weights

    def forward(self, tensors: Sequence[Tensor], result: Frames, added: Frames | None) -> None:
        """Fill ``result`` in, without its padding."""
        layer, own, out = self.layer, self._own(tensors), self._product
        for tap, source in enumerate(self._oriented_sources):
            left, right = (source, own.turned[tap]) if self.inner else (own.taps[tap], source)
            if tap == 0:
                torch.bmm(left, right, out=out)
            else:
                out.baddbmm_(left, right)
        self._by_channel.copy_(own.rest[-1])
        if layer.norm:
            self._normalise(own.rest[0])
        steps = steps_between(layer, result.layer)
        for first, source in enumerate(split(self.out, layer.pieces, steps)):
            place = result.every(first, steps)
            if layer.norm:
                torch.addcmul(self._shift, source, self._wide, out=place)
            else:
                torch.add(source, self._shift, out=place)
            if added is not None:
                place.add_(added.every(first, steps))
            if layer.slope == 0.0:
                place.relu_()
            elif layer.slope != 1.0:
                functional.leaky_relu_(place, layer.slope)

    def _normalise(self, gain: Tensor) -> None:
        """Take the means out, and say by what to multiply."""
        rows, sums, scale = self.rows, self._sums, self._scale
        # torch.var over a middle axis is a hundred times slower than two sums.
        torch.sum(rows, 2, keepdim=True, out=sums)
        rows.sub_(sums, alpha=self._part)
        torch.mul(rows, rows, out=self._spare)
        torch.sum(self._spare, 2, keepdim=True, out=sums)
        torch.add(self._eps, sums, alpha=self._part, out=scale)
        scale.rsqrt_()
        torch.mul(scale, gain, out=self._factor)
        if self.layer.share > 1:
            self._wide.view(self._by_channel.shape).copy_(self._factor)

    def before_rectifier(self, grads: Frames, results: Frames) -> Tensor:
        """The gradient of the result before the rectifier, frames in the order of the layer's pieces.

        A view of ``grads`` where nothing is to be done: not to be written to.
        """
        layer, steps = self.layer, steps_between(self.layer, grads.layer)
        if steps == 1 and layer.slope == 1.0:
            return grads.every(0, 1)
        for first, place in enumerate(split(self._before, layer.pieces, steps)):
            view = grads.every(first, steps)
            if layer.slope == 1.0:
                place.copy_(view)
            elif layer.slope == 0.0:
                torch.ops.aten.threshold_backward.grad_input(view, results.every(first, steps), 0.0, grad_input=place)
            else:
                torch.ops.aten.leaky_relu_backward.grad_input(
                    view, results.every(first, steps), layer.slope, True, grad_input=place
                )
        return self._before

    def backward(
        self, tensors: Sequence[Tensor], grad: Tensor, grads: Sequence[Tensor | None], *, further: bool
    ) -> Frames | None:
        """From the gradient before the rectifier to that of the padded input; fills in those of the weights."""
        layer, own = self.layer, self._own(tensors)
        if layer.norm:
            self._backward_norm(grad, grads[1:])
        else:
            self._within.copy_(grad.reshape(self._within.shape))
            if grads[1] is not None:
                sums = grad.sum(dim=(2, 3))
                grads[1].copy_(sums if layer.share == 1 else sums.unflatten(1, (-1, layer.share)).sum(2))
        if grads[0] is not None:
            for place, source in zip(grads[0].unbind(0), self._turned_sources, strict=True):
                torch.bmm(self._grad_rows, source, out=place)
        if not further:
            return None
        for place, pairs in self._ways_back:
            for number, (tap, source) in enumerate(pairs):
                left, right = (source, own.taps[tap]) if self.given.inner else (own.turned[tap], source)
                if number == 0:
                    torch.bmm(left, right, out=place)
                else:
                    place.baddbmm_(left, right)
            if not pairs:
                place.zero_()
        self._found.fold()
        return self._found

    def _backward_norm(self, grad: Tensor, grads: Sequence[Tensor | None]) -> None:
        """From the gradient after gain and shift to that before the norm; and those of gain and shift."""
        centred, scale, factor, spare = self.rows, self._scale, self._factor, self._spare
        along, total = self._along, self._sums
        rows = grad.reshape(centred.shape)
        torch.mul(rows, centred, out=spare)
        torch.sum(spare, 2, keepdim=True, out=along)
        torch.sum(rows, 2, keepdim=True, out=total)
        along.mul_(scale)
        for found, sums in zip(grads, (along, total), strict=True):
            if found is not None:
                torch.sum(sums, dim=(2, 3), out=found)
        along.mul_(scale)
        # factor (grad - total / n - centred along / n)
        torch.addcmul(rows, centred, along, value=-self._part, out=spare)
        total.mul_(factor).mul_(-self._part)
        shape, narrow = self._within.shape, (*factor.shape[:2], 1, 1, 1, factor.shape[3])
        torch.addcmul(total.view(narrow), spare.view(shape), factor.view(narrow), out=self._within)
