"""Clips on another clock: uniform resampling, evaluation at arbitrary times, and the anti-alias filter between.

Rotations are interpolated by slerp on one hemisphere, the root by a cubic spline (so that free flight keeps the acceleration
of gravity), everything else linearly.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmark.errors import ContractError
from benchmark.motion import quat
from benchmark.motion.clip import MotionClip

Array = NDArray[np.float64]

#: The pass band ends here, as a fraction of the new Nyquist frequency: the filter's -6 dB point. With ``_LOBES`` lobes to
#: either side its transition is 0.4 Nyquist wide, so that it is down in the stop band at the Nyquist frequency itself.
_PASS = 0.8
_LOBES = 8

#: Times closer to a frame than this fraction of a frame are that frame: what is left is rounding of ``k / fps``.
_SNAP = 1e-9

#: Frames filtered by one product: as many zeros are multiplied for each.
_BAND = 64


def resample(clip: MotionClip, fps: float, *, lowpass: bool = True) -> MotionClip:
    """The clip at another frame rate.

    Frame 0 stays at time 0 and is exact; the last frame is the last whole frame of the new clock inside the clip, so the
    duration is kept to less than one frame and nothing is extrapolated.

    Parameters
    ----------
    clip
        T frames.
    fps
        Frames per second wanted. The clip itself is returned where it has that rate already.
    lowpass
        Remove what the new rate cannot carry before going down (:func:`low_pass`); without it, fast motion aliases.

    Raises
    ------
    ContractError
        If ``fps`` is not a positive number.
    """
    if not (np.isfinite(fps) and fps > 0):
        raise ContractError(f"cannot resample to {fps} frames per second: give a positive number")
    if fps == clip.fps:
        return clip
    if lowpass and fps < clip.fps:
        clip = low_pass(clip, _PASS * 0.5 * fps)
    frames = int(np.floor(clip.duration * fps + 1e-6)) + 1
    return sample_at(clip, np.arange(frames) / fps, fps=fps)


def sample_at(clip: MotionClip, times: ArrayLike, *, fps: float) -> MotionClip:
    """The clip evaluated at any times of its own clock.

    Rotations come out sign-continuous. No filter is applied: where ``times`` run faster than the clip, so that steps are
    longer than its frames, call :func:`low_pass` first.

    Parameters
    ----------
    clip
        T frames, at ``clip.times``.
    times
        (N,) non-decreasing seconds on the clock of ``clip``; those outside its span show its first or last frame.
    fps
        Frame rate at which the N frames are to be played.

    Returns
    -------
    MotionClip
        N frames, without the raw channels of the source file.

    Raises
    ------
    ContractError
        If ``times`` is empty, not finite, or decreases.
    """
    times = np.asarray(times, dtype=np.float64)
    if times.ndim != 1 or len(times) == 0 or not np.all(np.isfinite(times)):
        raise ContractError(
            f"sample times must be a non-empty list of finite seconds, not an array of shape {times.shape}"
        )
    if np.any(np.diff(times) < 0):
        at = int(np.argmax(np.diff(times) < 0))
        raise ContractError(
            f"sample times must not decrease, but {times[at]:.6g} s is followed by {times[at + 1]:.6g} s"
        )

    position = np.clip(times * clip.fps, 0.0, len(clip) - 1)
    nearest = np.round(position)
    position = np.where(np.abs(position - nearest) < _SNAP * np.maximum(1.0, nearest), nearest, position)
    low = np.minimum(position.astype(np.int64), max(len(clip) - 2, 0))
    high = np.minimum(low + 1, len(clip) - 1)
    t = position - low

    rotations = quat.unroll(clip.rotations)
    at_frame = (t == 0.0) | (t == 1.0)
    inside = ~at_frame
    between = np.empty((len(t), *rotations.shape[1:]))
    between[at_frame] = rotations[np.where(t == 1.0, high, low)[at_frame]]
    between[inside] = quat.slerp(rotations[low[inside]], rotations[high[inside]], t[inside, None])
    return clip.replace(
        rotations=between,
        root=_cubic(clip.root, position),
        fps=fps,
        translations=_linear(clip.translations, low, high, t),
        residual=_linear(clip.residual, low, high, t),
        source=None,
    )


def low_pass(clip: MotionClip, cutoff: float) -> MotionClip:
    """The clip without what moves faster than ``cutoff`` hertz; no phase shift, polynomials up to cubic unchanged.

    A windowed-sinc kernel, made to have zero second moment. Near the ends it narrows until at the first and last frame it
    is the identity, so ends are exact and nothing beyond them is invented; there the filter is correspondingly weaker.
    Quaternions are filtered as sign-continuous components and renormalised.

    Parameters
    ----------
    clip
        T frames.
    cutoff
        -6 dB point in hertz; at or above the Nyquist frequency of the clip nothing is done.

    Raises
    ------
    ContractError
        If ``cutoff`` is not positive.
    """
    if not cutoff > 0:
        raise ContractError(f"a low-pass cutoff must be positive, not {cutoff} Hz")
    if cutoff >= 0.5 * clip.fps:
        return clip
    relative = cutoff / clip.fps
    rotations = quat.normalize(_filter(quat.unroll(clip.rotations), relative))
    return clip.replace(
        rotations=rotations,
        root=_filter(clip.root, relative),
        translations=None if clip.translations is None else _filter(clip.translations, relative),
        source=None,
    )


def _cubic(values: Array, position: Array) -> Array:
    """Not-a-knot cubic spline through ``values`` (T, D) at frame numbers 0, 1 …; exact for cubics, at knots exact."""
    from scipy.interpolate import CubicSpline

    if len(values) == 1:
        return np.repeat(values, len(position), axis=0)
    at_knot = position == np.round(position)
    if at_knot.all():
        return values[position.astype(np.int64)]
    out: Array = CubicSpline(np.arange(len(values)), values, axis=0)(position)
    out[at_knot] = values[position[at_knot].astype(np.int64)]
    return out


def _linear(values: Array | None, low: NDArray[np.int64], high: NDArray[np.int64], t: Array) -> Array | None:
    if values is None:
        return None
    weight = t.reshape(-1, *[1] * (values.ndim - 1))
    return (1.0 - weight) * values[low] + weight * values[high]


@lru_cache(maxsize=512)
def _kernel(relative: float, half: int) -> Array:
    """(2 half + 1,) symmetric low-pass kernel with sum 1 and second moment 0, hence exact for cubics; read-only.

    A filter needs one of every width for the ends, and all clips of a data set need the same.
    """
    k = np.arange(-half, half + 1, dtype=np.float64)
    if half < 2:
        return _constant((k == 0).astype(np.float64))
    window = 0.54 + 0.46 * np.cos(np.pi * k / (half + 1))
    base = window * 2.0 * relative * np.sinc(2.0 * relative * k)
    m0, m2, m4 = (float(np.sum(base * k**p)) for p in (0, 2, 4))
    # The narrowed kernels near the ends are plain bumps; a factor a + b k^2 meets both conditions for any width.
    det = m0 * m4 - m2 * m2
    return _constant(base * (m4 - m2 * k * k) / det)


def _constant(array: Array) -> Array:
    array.flags.writeable = False
    return array


@lru_cache(maxsize=64)
def _inside(relative: float, half: int) -> Array:
    """(B, B + 2 half) what B neighbouring frames become, each from ``half`` frames to either side; read-only."""
    kernel = _kernel(relative, half)
    rows = np.zeros((_BAND, _BAND + 2 * half))
    for row in range(_BAND):
        rows[row, row : row + len(kernel)] = kernel
    return _constant(rows)


@lru_cache(maxsize=64)
def _ends(relative: float, half: int) -> Array:
    """(half + 1, 2 half + 1) what the first frames become, each from as many frames to either side as it has; read-only."""
    rows = np.zeros((half + 1, 2 * half + 1))
    for width in range(half + 1):
        rows[width, : 2 * width + 1] = _kernel(relative, width)
    return _constant(rows)


def _filter(values: Array, relative: float) -> Array:
    """Values (T, ...) filtered along axis 0 at ``relative`` cycles per frame.

    As products with matrices, which for a kernel as long as this take less time than a sum for each of its numbers.
    """
    frames = len(values)
    flat = values.reshape(frames, -1)
    full = int(np.ceil(_LOBES * _PASS * 0.5 / relative))
    half = min(full, (frames - 1) // 2)
    out = np.empty_like(flat)
    rows, reach = _ends(relative, half), 2 * half + 1
    out[: half + 1] = rows @ flat[:reach]
    out[frames - 1 - half :] = rows[::-1, ::-1] @ flat[frames - reach :]
    if frames > 2 * full:
        rows = _inside(relative, full)
        for start in range(full, frames - full, _BAND):
            stop = min(start + _BAND, frames - full)
            count = stop - start
            out[start:stop] = rows[:count, : count + 2 * full] @ flat[start - full : stop + full]
    return out.reshape(values.shape)
