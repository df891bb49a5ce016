"""The target style's tempo: one ratio of durations, or a rate that the model reads off the motion.

A linear time-invariant model of frame-aligned data keeps its input's clock, so tempo has to be transferred apart from it
(Hsu et al. 2005 treat it apart too; the poster claims child-like timing and does not say where it comes from).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

TIMINGS = ("none", "ratio", "rate")

#: No moment is sped up or slowed down by more than this factor.
MAX_RATE = 2.0

#: Standard deviation in seconds of the Gaussian that turns the steps of a time warp into a rate.
RATE_SIGMA = 0.2


def duration_ratio(source: Mapping[str, Sequence[float]], target: Mapping[str, Sequence[float]]) -> float:
    """How many times as long as the source style's the target style's performances are.

    The geometric mean over the actions that both have of the ratio of median durations, so that an action that was recorded
    more often counts no more than others.

    Parameters
    ----------
    source, target
        Seconds of every take, by action.
    """
    ratios = [
        np.log(np.median(target[action]) / np.median(source[action]))
        for action in sorted(source)
        if action in target and min(*source[action], *target[action]) > 0
    ]
    return float(np.exp(np.mean(ratios))) if ratios else 1.0


def rate_of(position: Array, frames: int, fps: float) -> Array:
    """How fast the target style's clock runs at each frame of the source: d(target time) / d(source time), as a logarithm.

    Parameters
    ----------
    position
        (T',) non-decreasing: the source frame that each target frame shows, as found by time warping.
    frames
        T, the number of source frames.
    fps
        Frames per second of both.

    Returns
    -------
    (T,) log rate: 0 where both run alike, positive where the target lingers; smoothed over :data:`RATE_SIGMA` and within
    ``log`` :data:`MAX_RATE`.
    """
    from scipy.ndimage import gaussian_filter1d

    # A target frame adds one frame's time at the place it shows; fractions of a frame are shared by the two neighbours.
    low = np.minimum(position.astype(np.int64), frames - 1)
    share = position - low
    time = np.bincount(low, weights=1.0 - share, minlength=frames)
    time += np.bincount(np.minimum(low + 1, frames - 1), weights=share, minlength=frames)
    smooth = gaussian_filter1d(time, RATE_SIGMA * fps, mode="nearest")
    return np.log(np.clip(smooth, 1.0 / MAX_RATE, MAX_RATE))


def cues(values: Array, fps: float) -> Array:
    """What a rate is read off: height of the hips, their vertical speed, and how fast the body moves.

    Parameters
    ----------
    values
        (T, J, 3) standardised channels.
    fps
        Frames per second.

    Returns
    -------
    (T, 3); the speeds are smoothed over :data:`RATE_SIGMA` and compressed, so that a glitch of the sensor is no event.
    """
    from scipy.ndimage import gaussian_filter1d

    speed = np.gradient(values, 1.0 / fps, axis=0) if len(values) > 1 else np.zeros_like(values)
    smooth = gaussian_filter1d(speed, RATE_SIGMA * fps, axis=0, mode="nearest")
    moving = np.sqrt(np.mean(smooth[:, 1:] ** 2, axis=(1, 2)))
    return np.column_stack([values[:, 0, 1], np.arcsinh(smooth[:, 0, 1]), np.log1p(moving)])


def retimed(log_rate: Array, fps: float) -> Array:
    """Source times in seconds of evenly spaced output frames, when source frame i lasts ``exp(log_rate[i])`` frames.

    Parameters
    ----------
    log_rate
        (T,) as from :func:`rate_of`.
    fps
        Frames per second of source and output.

    Returns
    -------
    (T',) non-decreasing, from 0 to the last frame's time.
    """
    rate = np.exp(np.clip(log_rate, -np.log(MAX_RATE), np.log(MAX_RATE)))
    out = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]))]) / fps
    frames = round(out[-1] * fps) + 1
    if frames < 2:
        return np.zeros(1)
    return np.interp(np.linspace(0.0, out[-1], frames), out, np.arange(len(rate)) / fps)
