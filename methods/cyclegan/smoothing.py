"""What the paper does to the words it gets: blend, remove peaks, low-pass."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import ConfigError
from benchmark.motion import quat

Array = NDArray[np.float64]

#: A median absolute deviation times this is the standard deviation of a normal distribution.
_MAD_TO_STD = 1.4826

#: Deviations below this are rounding, not peaks: a component at rest has a median absolute deviation of zero.
_LEAST = 1e-9


def hampel(values: Array, *, window: int = 7, deviations: float = 3.0) -> Array:
    """Replace peaks by the running median (Hampel 1974).

    A value is a peak if it is further from the median of the ``window`` frames around it than ``deviations`` times their median
    absolute deviation, scaled to a standard deviation. At the ends the window is cut off.

    Parameters
    ----------
    values
        (T, ...), each column by itself.
    window
        Odd number of frames.
    deviations
        The paper does not give its peak filter; 3 is the usual choice.
    """
    if window < 3 or window % 2 == 0:
        raise ConfigError(f"the window of the peak filter must be an odd number of at least 3 frames, not {window}")
    half = window // 2
    flat = np.asarray(values, dtype=np.float64).reshape(len(values), -1)
    padded = np.pad(flat, ((half, half), (0, 0)), constant_values=np.nan)
    around = np.lib.stride_tricks.sliding_window_view(padded, window, axis=0)
    median, spread = np.empty_like(flat), np.empty_like(flat)
    inner = slice(half, max(half, len(flat) - half))
    full = around[inner]
    median[inner] = np.partition(full, half, axis=-1)[..., half]
    spread[inner] = np.partition(np.abs(full - median[inner][..., None]), half, axis=-1)[..., half]
    for t in [*range(min(half, len(flat))), *range(max(half, len(flat) - half), len(flat))]:
        near = flat[max(0, t - half) : t + half + 1]
        median[t] = np.median(near, axis=0)
        spread[t] = np.median(np.abs(near - median[t]), axis=0)
    peak = np.abs(flat - median) > np.maximum(deviations * _MAD_TO_STD * spread, _LEAST)
    return np.where(peak, median, flat).reshape(np.shape(values))


def butterworth(values: Array, fps: float, *, cutoff: float = 7.0, order: int = 2) -> Array:
    """Zero-phase low-pass: a Butterworth filter of ``order`` run forwards and backwards over (T, ...).

    ``cutoff`` in hertz is that of the filter itself, so that both runs together leave half of the amplitude there (-6 dB). The
    paper gives 7 Hz and neither order nor phase. At or above the Nyquist frequency nothing is done.
    """
    from scipy.signal import butter, sosfiltfilt

    values = np.asarray(values, dtype=np.float64)
    if not cutoff > 0:
        raise ConfigError(f"the cutoff of the low-pass filter must be positive, not {cutoff} Hz")
    if cutoff >= 0.5 * fps or len(values) < 2:
        return values
    sos = butter(order, cutoff, fs=fps, output="sos")
    # Long enough for the transient to die down, and no longer than the clip.
    pad = min(len(values) - 1, int(np.ceil(3.0 * fps / cutoff)))
    return np.asarray(sosfiltfilt(sos, values, axis=0, padlen=pad))


def smooth_rotations(
    rotations: Array, fps: float, *, peaks: bool = True, window: int = 7, deviations: float = 3.0, cutoff: float = 7.0
) -> Array:
    """Peak removal and low-pass of (T, J, 4), component by component on continuous signs, normalised afterwards.

    ``cutoff`` 0 leaves the low-pass out.
    """
    out = quat.unroll(rotations)
    if peaks:
        out = quat.unroll(quat.normalize(hampel(out, window=window, deviations=deviations)))
    if cutoff > 0:
        out = butterworth(out, fps, cutoff=cutoff)
    return quat.normalize(out)
