"""The kinematic loss of a decoded motion, and its gradient by the hidden units, written out. Importing this imports torch.

:meth:`methods.cyclegan_kc.losses.Kinematics.total` of the decoder's output is four short formulas on top of a linear map, and a
clip is so few numbers that automatic differentiation spends most of its time between the operations. Here the gradient is
written down instead, in numpy; the tests hold it to torch's.

Arrays are frames first, (T, D). The decoder, which first repeats every hidden frame, takes hidden frames (n, F) to pairs of
frames (n, 2 D) by a convolution of half as many taps; laid out so, the pairs are the frames (2 n, D).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import nn

from methods.cyclegan_kc.losses import TERMS, Kinematics

Array = NDArray[Any]

#: Under the root of a bone's length, as in :meth:`methods.cyclegan_kc.losses.Kinematics.bone_lengths`.
_TINY = 1e-12

#: Leg lengths above which a bone's length has an error, as in :meth:`methods.cyclegan_kc.losses.Kinematics.bone_error`.
_LONG = 1e-6

#: Of Adam; the last is that of :mod:`methods.holden.descent`.
_BETAS, _EPS = (0.9, 0.999), 1e-5


class PairDecoder:
    """A decoder's convolution of evenly unpooled hidden units, without its bias.

    Parameters
    ----------
    layer
        (D, F, K) taps, K odd, padded to keep the length.
    """

    def __init__(self, layer: nn.Conv1d) -> None:
        weight = layer.weight.detach().cpu().numpy()
        channels, filters, width = weight.shape
        half = width // 2
        self.channels, self.filters = channels, filters
        #: Hidden frames to either side of its own that a pair of frames depends on.
        self.reach = -(-half // 2)
        self.taps = 2 * self.reach + 1
        # Frame 2 k + phase sees frame 2 k + phase + j, which is half of hidden frame k + (phase + j) // 2.
        pairs = np.zeros((self.taps, filters, 2, channels), dtype=weight.dtype)
        for phase in range(2):
            for tap in range(width):
                pairs[self.reach + (phase + tap - half) // 2, :, phase] += 0.5 * weight[:, :, tap].T
        self._forth = pairs.reshape(self.taps * filters, 2 * channels)
        back = pairs[::-1].reshape(self.taps, filters, 2 * channels).transpose(0, 2, 1)
        self._back = np.ascontiguousarray(back).reshape(self.taps * 2 * channels, filters)

    def forth(self, hidden: Array) -> Array:
        """(2 n, D) of hidden frames (n + 2 reach, F)."""
        return (_windows(hidden, self.taps) @ self._forth).reshape(-1, self.channels)

    def back(self, gradient: Array) -> Array:
        """(n + 2 reach, F): the transpose of :meth:`forth`, of (2 n, D)."""
        rows, beyond = gradient.reshape(-1, 2 * self.channels), 2 * self.reach
        pairs = np.zeros((len(rows) + 2 * beyond, 2 * self.channels), dtype=rows.dtype)
        pairs[beyond : beyond + len(rows)] = rows
        product: Array = _windows(pairs, self.taps) @ self._back
        return product


class KinematicDescent:
    """Equation 13 as a function of the hidden units that a clip's own frames depend on.

    Parameters
    ----------
    kinematics
        The terms; what it holds is on the CPU.
    decoder
        Of the generator.
    content
        (T, D) the clip's normalised channels.
    base
        (T, D) or (D,) what is added to the decoder's output.
    """

    def __init__(self, kinematics: Kinematics, decoder: PairDecoder, content: Array, base: Array) -> None:
        self._decoder, self._content, self._base = decoder, content, base
        self._weights = dict(zip(TERMS, kinematics.weights, strict=True))
        self._mode, self._fps = kinematics.mode, kinematics.fps
        frames, joints = len(content), len(kinematics.parents)
        parents = kinematics.parents.numpy()
        kept = np.flatnonzero(parents >= 0)
        self._places, self._velocity = slice(0, 3 * joints), slice(3 * joints, 3 * joints + 3)
        self._scale, self._offset = kinematics.scale.numpy()[:, 0], kinematics.offset.numpy()[:, 0]
        self._lengths = kinematics.lengths.numpy()[kept]
        # From normalised positions to bones, and what the offsets add.
        steps = np.eye(joints, dtype=content.dtype)
        matrix = np.kron((steps[kept] - steps[parents[kept]]).T, np.eye(3, dtype=content.dtype))
        self._to_bones = self._scale[self._places, None] * matrix
        self._rest_bones = self._offset[self._places] @ matrix
        self._by_bone = 2.0 / (max(frames, 1) * max(len(kept), 1) * float(self._scale[0]) ** 2)
        self._by_acceleration = 1.0 / (max(frames - 2, 1) * joints * kinematics.acceleration)
        self._by_frame = 1.0 / max(frames, 1)

        # Horizontal places and velocities as pairs (z, x), which are complex numbers z + i x as they lie there; and heights.
        feet, (across, ahead, around) = kinematics.feet.numpy(), range(self._velocity.start, self._velocity.stop)
        self._ground, self._height = (3 * feet[:, None] + [2, 0]).ravel(), 3 * feet + 1
        self._ground_scale, self._ground_offset = self._scale[self._ground], self._offset[self._ground]
        self._height_scale = self._scale[self._height]
        self._ahead, self._around = np.array([ahead, across]), around
        self._step_scale, self._step_offset = self._scale / self._fps, self._offset / self._fps
        at = self._velocity.stop
        contacts = content[:, at : at + len(feet)] > 0
        self._standing = (contacts[:-1] & contacts[1:]).astype(content.dtype)
        self._by_step = self._fps**2 / (max(frames - 1, 1) * max(len(feet), 1))
        if self._mode != "match":
            self._wanted = self._squares(self._curvature(content[:, self._places]))

    def channels(self, hidden: Array) -> Array:
        """(T, D) that the hidden frames are decoded to."""
        made: Array = self._decoder.forth(hidden)[: len(self._content)]
        made += self._base
        return made

    def value(self, hidden: Array) -> tuple[float, Array]:
        """The loss of hidden frames, and its gradient by them."""
        total, gradient = self._by_channels(hidden)
        return total, self._decoder.back(gradient)

    def _by_channels(self, hidden: Array) -> tuple[float, Array]:
        """The loss of hidden frames, and its gradient (2 n, D) by the channels that they are decoded to."""
        x = self.channels(hidden)
        # One more row where the clip ends within a pair of frames.
        gradient = np.zeros((len(x) + len(x) % 2, x.shape[1]), dtype=x.dtype)
        inner = gradient[: len(x)]
        total = 0.0
        for name in TERMS:
            if self._weights[name]:
                total += self._weights[name] * getattr(self, f"_{name}")(x, inner, self._weights[name])
        return total, gradient

    def lowest(self, start: Array, *, iterations: int, step: float) -> tuple[Array, float, float]:
        """The best hidden frames that Adam meets from ``start``, and the loss there and at ``start``.

        As :func:`methods.holden.descent.descend`.
        """
        hidden, best = start, start
        # Steps that are too long may leave the range of numbers; what they lead to is never the lowest.
        with np.errstate(over="ignore", invalid="ignore"):
            first, by_channels = self._by_channels(hidden)
            lowest = first
            mean, square = np.zeros_like(hidden), np.zeros_like(hidden)
            for turn in range(1, iterations + 1):
                gradient = self._decoder.back(by_channels)
                mean += (1.0 - _BETAS[0]) * (gradient - mean)
                square *= _BETAS[1]
                square += (1.0 - _BETAS[1]) * np.square(gradient)
                spread = np.sqrt(square)
                spread /= (1.0 - _BETAS[1] ** turn) ** 0.5
                spread += _EPS
                hidden = hidden - (step / (1.0 - _BETAS[0] ** turn)) * mean / spread
                value, by_channels = self._by_channels(hidden)
                if value < lowest:
                    best, lowest = hidden, value
        return best, first, lowest

    def _curvature(self, positions: Array) -> Array:
        """(T - 2, 3 J) second differences, in leg lengths, of normalised positions (T, 3 J)."""
        steps = positions[1:] - positions[:-1]
        return (steps[1:] - steps[:-1]) * self._scale[self._places]

    def _squares(self, vectors: Array) -> Array:
        """(T, J) of (T, 3 J)."""
        return np.square(vectors).reshape(len(vectors), -1, 3).sum(axis=2)

    def _smooth(self, x: Array, gradient: Array, weight: float) -> float:
        if self._mode == "match":
            pull = self._curvature(x[:, self._places] - self._content[:, self._places])
            total = float(np.vdot(pull, pull))
        else:
            pull = self._curvature(x[:, self._places])
            surplus = self._squares(pull) - self._wanted
            total = float(np.abs(surplus).sum())
            pull = (pull.reshape(len(pull), -1, 3) * np.sign(surplus)[..., None]).reshape(pull.shape)
        pull *= (2.0 * weight * self._by_acceleration) * self._scale[self._places]
        places = gradient[:, self._places]
        places[2:] += pull
        places[:-2] += pull
        pull *= 2.0
        places[1:-1] -= pull
        return total * self._by_acceleration

    def _bone(self, x: Array, gradient: Array, weight: float) -> float:
        bones = x[:, self._places] @ self._to_bones
        bones += self._rest_bones
        vectors = bones.reshape(len(bones), -1, 3)
        lengths = np.sqrt(np.einsum("tbi,tbi->tb", vectors, vectors) + vectors.dtype.type(_TINY))
        error = lengths - self._lengths
        total = float(np.vdot(error, error))
        error *= weight * self._by_bone
        error /= lengths
        vectors *= error[..., None]
        gradient[:, self._places] += bones @ self._to_bones.T
        return 0.5 * self._by_bone * total

    def _traj(self, x: Array, gradient: Array, weight: float) -> float:
        error = x[:, self._velocity] - self._content[:, self._velocity]
        total = float(np.vdot(error, error))
        error *= 2.0 * weight * self._by_frame
        gradient[:, self._velocity] += error
        return total * self._by_frame

    def _foot(self, x: Array, gradient: Array, weight: float) -> float:
        """Horizontal places as complex numbers ``z + i x``, which a turn by w about the vertical multiplies by ``exp(i w)``."""
        ground = _complex(x[:, self._ground] * self._ground_scale + self._ground_offset)
        height = x[:, self._height] * self._height_scale
        moved = _complex(x[:-1, self._ahead] * self._step_scale[self._ahead] + self._step_offset[self._ahead])
        half = x[:-1, self._around] * (0.5 * self._step_scale[self._around]) + 0.5 * self._step_offset[self._around]
        turn = np.exp(1j * half)[:, None]
        against = turn.conj()
        late, early = turn * ground[1:], against * ground[:-1]
        slip = (late - early + moved) * self._standing
        rise = (height[1:] - height[:-1]) * self._standing
        total = float(np.vdot(slip, slip).real) + float(np.vdot(rise, rise))
        factor = 2.0 * weight * self._by_step
        slip *= factor
        rise *= factor
        pulls = np.zeros_like(ground)
        np.multiply(slip, against, out=pulls[1:])
        pulls[:-1] -= slip * turn
        gradient[:, self._ground] += _pairs(pulls) * self._ground_scale
        climbs = np.zeros_like(height)
        climbs[1:] = rise
        climbs[:-1] -= rise
        gradient[:, self._height] += climbs * self._height_scale
        # d slip / d half = i (late + early).
        late += early
        spin = np.einsum("tf,tf->t", slip.conj(), late).imag
        gradient[:-1, self._ahead] += _pairs(slip.sum(axis=1, keepdims=True)) * self._step_scale[self._ahead]
        gradient[:-1, self._around] -= (0.5 * self._step_scale[self._around]) * spin
        return total * self._by_step

    def bone_error(self, x: Array) -> float:
        """:meth:`methods.cyclegan_kc.losses.Kinematics.bone_error` of channels (T, D)."""
        vectors = (x[:, self._places] @ self._to_bones + self._rest_bones).reshape(len(x), -1, 3)
        lengths = np.sqrt(np.einsum("tbi,tbi->tb", vectors, vectors) + vectors.dtype.type(_TINY))
        long = self._lengths > _LONG
        if not long.any():
            return float("nan")
        return float(np.abs(lengths[:, long] / self._lengths[long] - 1.0).mean(dtype=np.float64))


def _complex(pairs: Array) -> Array:
    """(T, N) complex numbers of (T, 2 N) real and imaginary parts in turn."""
    return np.ascontiguousarray(pairs).view(np.result_type(pairs.dtype, np.complex64))


def _pairs(numbers: Array) -> Array:
    """The inverse of :func:`_complex`."""
    return numbers.view(numbers.real.dtype)


def _windows(values: Array, taps: int) -> Array:
    """(n - taps + 1, taps C) rows of (n, C) with those that follow, copied: products take no overlapping rows."""
    values = np.ascontiguousarray(values)
    count, channels = values.shape
    # What `np.lib.stride_tricks.as_strided` gives, which takes longer than the copy.
    shape, strides = (count - taps + 1, taps * channels), values.strides
    rows: Array = np.ndarray(shape, values.dtype, buffer=values, strides=strides)
    return rows.copy()
