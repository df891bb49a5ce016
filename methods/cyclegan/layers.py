"""Temporal convolutions and instance norm for many small groups at once, on tensors (G, C, T, B).

A group is a joint (or the whole body), C its channels, T frames, B words. Grouped convolutions of a handful of channels are
slow in their usual layout: each group is a product too small to be worth its set-up. With the words innermost, one tap of a
convolution is one batched matrix product over all joints, ``(C', C) @ (C, T B)``, whose right side is a shifted *view* of the
padded input: nothing is unfolded or copied, and normalising over time adds rows of B numbers. The arithmetic is that of
``torch.nn.Conv1d(groups=G)``, to which the tests hold it.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable
from torch.nn import functional

PADDINGS = ("zero", "reflect")


def _phases(x: Tensor, stride: int) -> list[Tensor]:
    """The frames of ``x`` (G, C, T, B) by remainder modulo ``stride``, each contiguous and flat, (G, C, T_p B)."""
    if stride == 1:
        return [x.contiguous().flatten(2)]
    return [x[:, :, p::stride].contiguous().flatten(2) for p in range(stride)]


def _padded(x: Tensor, pad: int, padding: str) -> Tensor:
    if pad == 0:
        return x
    frames = x.shape[2]
    # Written in place: flips and concatenations cost several times as much.
    out = x.new_empty(*x.shape[:2], frames + 2 * pad, x.shape[3])
    out[:, :, pad : pad + frames] = x
    for k in range(pad):
        if padding == "zero":
            out[:, :, k] = 0.0
            out[:, :, pad + frames + k] = 0.0
        else:
            out[:, :, k] = x[:, :, pad - k]
            out[:, :, pad + frames + k] = x[:, :, frames - 2 - k]
    return out


def _unpadded(grad: Tensor, pad: int, padding: str) -> Tensor:
    """The adjoint of :func:`_padded`."""
    if pad == 0:
        return grad
    frames = grad.shape[2] - 2 * pad
    inner = grad[:, :, pad : pad + frames]
    if padding == "zero":
        return inner
    inner = inner.contiguous()
    for k in range(pad):
        inner[:, :, pad - k] += grad[:, :, k]
        inner[:, :, frames - 2 - k] += grad[:, :, pad + frames + k]
    return inner


class _GroupedConv(Function):
    """Cross-correlation along time; see :func:`grouped_conv`."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, stride: int, pad: int, padding: str) -> Tensor:
        taps, words = weight.shape[3], x.shape[3]
        padded = _padded(x, pad, padding)
        frames = (padded.shape[2] - taps) // stride + 1
        phases = _phases(padded, stride)
        # Taps first: a (C', C) slice with unit stride is what matrix products take without a copy.
        tap = weight.permute(3, 0, 1, 2).contiguous()
        out: Tensor | None = None
        for k in range(taps):
            first = (k // stride) * words
            piece = phases[k % stride][:, :, first : first + frames * words]
            out = torch.bmm(tap[k], piece) if out is None else out.baddbmm_(tap[k], piece)
        assert out is not None
        ctx.save_for_backward(tap, *phases)
        ctx.geometry = (stride, pad, padding, padded.shape[2], frames, words)
        return out.unflatten(2, (frames, words))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        tap, *phases = ctx.saved_tensors
        stride, pad, padding, length, frames, words = ctx.geometry
        taps, groups, _, inputs = tap.shape
        flat = grad.contiguous().flatten(2)
        grad_weight = grad_x = None
        if ctx.needs_input_grad[1]:
            parts = []
            for k in range(taps):
                first = (k // stride) * words
                piece = phases[k % stride][:, :, first : first + frames * words]
                parts.append(torch.bmm(flat, piece.transpose(1, 2)))
            grad_weight = torch.stack(parts, dim=3)
        if ctx.needs_input_grad[0]:
            reach = (taps - 1) // stride
            around = _padded(flat.unflatten(2, (frames, words)), reach, "zero").flatten(2)
            grad_padded = grad.new_empty(0) if stride == 1 else grad.new_zeros(groups, inputs, length, words)
            for phase in range(min(stride, taps)):
                rows = len(range(phase, length, stride))
                # Frames past the last tap of the last output got no gradient.
                used = min(rows, frames + (taps - 1 - phase) // stride)
                total: Tensor | None = None
                for k in range(phase, taps, stride):
                    first = (reach - k // stride) * words
                    piece = around[:, :, first : first + used * words]
                    back = tap[k].transpose(1, 2)
                    total = torch.bmm(back, piece) if total is None else total.baddbmm_(back, piece)
                assert total is not None
                if stride == 1:
                    grad_padded = total.unflatten(2, (used, words))
                else:
                    grad_padded[:, :, phase : phase + used * stride : stride] = total.unflatten(2, (used, words))
            grad_x = _unpadded(grad_padded, pad, padding)
        return grad_x, grad_weight, None, None, None


def grouped_conv(x: Tensor, weight: Tensor, *, stride: int = 1, pad: int = 0, padding: str = "zero") -> Tensor:
    """Convolve every group along time with its own kernel.

    Parameters
    ----------
    x
        (G, C, T, B).
    weight
        (G, C', C, K).
    stride, pad, padding
        As in ``torch.nn.Conv1d``; ``padding`` is ``zero`` or ``reflect``.

    Returns
    -------
    Tensor
        (G, C', T', B), ``T' = (T + 2 pad - K) // stride + 1``. First derivatives only.
    """
    return _GroupedConv.apply(x, weight, stride, pad, padding)


def grouped_upsample(x: Tensor, weight: Tensor) -> Tensor:
    """Transposed convolution with kernel 3, stride 2, padding 1 and output padding 1: (G, C, T, B) to (G, C', 2 T, B).

    ``y[2t] = W_1 x[t]`` and ``y[2t+1] = W_2 x[t] + W_0 x[t+1]`` with ``x[T] = 0``. ``weight`` is (G, C', C, 3), output
    channels first, unlike in ``torch.nn.ConvTranspose1d``.
    """
    following = functional.pad(x[:, :, 1:], (0, 0, 0, 1))
    even = grouped_conv(x, weight[..., 1:2])
    odd = grouped_conv(torch.cat((x, following), dim=1), torch.cat((weight[..., 2:3], weight[..., 0:1]), dim=2))
    return torch.stack((even, odd), dim=3).flatten(2, 3)


class _NormAct(Function):
    """Instance norm over time, gain, shift and rectifier in one node; see :func:`norm_act`."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, gain: Tensor, shift: Tensor, slope: float, eps: float, share: int) -> Tensor:
        shape = x.shape
        # (G, C, share * T, B): channels that share their statistics are further rows to add up.
        rows = x.contiguous().view(shape[0], shape[1] // share, share * shape[2], shape[3])
        # torch.var over a middle axis is a hundred times slower than two means.
        centred = rows - rows.mean(2, keepdim=True)
        scale = torch.rsqrt((centred * centred).mean(2, keepdim=True) + eps)
        unit = centred.mul_(scale)
        # Two steps: torch's kernels for two operands are vectorised under broadcasting, those for three are not.
        out = (unit * gain[..., None, None]).add_(shift[..., None, None])
        if slope == 0.0:
            out.relu_()
        elif slope != 1.0:
            functional.leaky_relu_(out, slope)
        ctx.save_for_backward(unit, scale, gain, out)
        ctx.slope = slope
        return out.view(shape)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        unit, scale, gain, out = ctx.saved_tensors
        rows = grad.contiguous().view(unit.shape)
        if ctx.slope == 0.0:
            rows = torch.ops.aten.threshold_backward(rows, out, 0.0)
        elif ctx.slope != 1.0:
            rows = torch.ops.aten.leaky_relu_backward(rows, out, ctx.slope, True)
        along = (rows * unit).mean(2, keepdim=True)
        mean = rows.mean(2, keepdim=True)
        count = unit.shape[2]
        grad_gain = along.sum(dim=(2, 3)) * count
        grad_shift = mean.sum(dim=(2, 3)) * count
        grad_x = (unit * along).neg_().add_(rows).sub_(mean).mul_(scale * gain[..., None, None])
        return grad_x.view(grad.shape), grad_gain, grad_shift, None, None, None


def norm_act(
    x: Tensor, gain: Tensor, shift: Tensor, *, slope: float = 0.0, eps: float = 1e-5, share: int = 1
) -> Tensor:
    """``act(gain (x - mean) / sqrt(var + eps) + shift)``, with the moments of each channel of each word over time.

    Parameters
    ----------
    x
        (G, C, T, B).
    gain, shift
        (G, C / share).
    slope
        Slope of the rectifier below zero; 1 leaves it out.
    eps
        Added to the variance, as in ``torch.nn.InstanceNorm1d``.
    share
        So many neighbouring channels are normalised together, as the places along the second axis of a two-dimensional
        convolution are.
    """
    return _NormAct.apply(x, gain, shift, slope, eps, share)


def bias_act(x: Tensor, bias: Tensor, *, slope: float = 0.0, share: int = 1) -> Tensor:
    """``act(x + bias)``, where there is no norm; ``bias`` is (G, C / share)."""
    out = x + bias.repeat_interleave(share, dim=1)[..., None, None]
    if slope == 0.0:
        return functional.relu(out)
    return out if slope == 1.0 else functional.leaky_relu(out, slope)
