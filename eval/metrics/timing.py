"""Tempo and duration against real target motion, and the change of timing against the source."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmark.api import Metric, MetricInfo, NotApplicableError, Sample
from benchmark.motion.clip import MotionClip
from benchmark.motion.pose import SEGMENTS, segment_directions
from eval.metrics.poses import aligned_poses
from eval.metrics.shared import STEP, over_references, per_clip, stride

#: Seconds over which limb directions are differenced: long beside the jitter of a depth camera, short beside a cycle.
_SPAN = 4.0 * STEP

#: Autocorrelation that a repetition reaches, or it is none. Single gestures of real captures stay below 0.3, walking and
#: running in place before a depth camera reach 0.4 to 0.75, and before an optical system more.
_CLEAR = 0.4

#: The first maximum that reaches this share of the highest is the period; a later one is a multiple of it.
_KEY = 0.7

#: Longest period in seconds. Laps and rounds that come again are no cycles of movement.
_LONGEST = 2.0


@per_clip
def tempo(clip: MotionClip) -> float:
    """Cycles a second.

    What is watched is how the directions of trunk and limbs change, facing forward (differences over 0.13 s), so neither
    posture nor place nor a slow drift matters. Its normalised autocorrelation
    ``r(tau) = 2 sum x(t) x(t + tau) / sum (|x(t)|^2 + |x(t + tau)|^2)`` is searched, up to 2 s and half the clip, for the
    first maximum behind a zero crossing that reaches 0.7 of the highest one (the key maximum of McLeod and Wyvill 2005); a
    parabola through it gives the period. Taking the whole body rather than one channel's spectrum tells a stride from a
    step: half a stride later the movement is mirrored, not repeated.
    """
    step = stride(clip.fps)
    rate = clip.fps / step
    directions = segment_directions(clip)[::step].reshape(-1, 3 * len(SEGMENTS))
    span = max(1, round(_SPAN * rate))
    correlation = _autocorrelation(directions[span:] - directions[:-span])[: round(_LONGEST * rate) + 2]
    below = np.flatnonzero(correlation < 0.0)
    start = int(below[0]) if below.size else len(correlation)
    peaks = [
        lag
        for lag in range(max(start, 1), len(correlation) - 1)
        if correlation[lag] >= correlation[lag - 1] and correlation[lag] > correlation[lag + 1]
    ]
    highest = max((correlation[lag] for lag in peaks), default=0.0)
    if highest < _CLEAR:
        raise NotApplicableError("the motion does not repeat at least twice, so it has no tempo")
    lag = next(lag for lag in peaks if correlation[lag] >= _KEY * highest)
    left, middle, right = correlation[lag - 1 : lag + 2]
    curvature = left - 2.0 * middle + right
    shift = 0.5 * (left - right) / curvature if curvature < 0.0 else 0.0
    return float(rate / (lag + shift))


def _autocorrelation(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n // 2 + 1,) normalised autocorrelation of the detrended rows (n, d); zeros where nothing moves."""
    count = len(values)
    lags = count // 2 + 1
    if count < 4:
        return np.zeros(lags)
    line = np.stack([np.ones(count), np.linspace(-1.0, 1.0, count)], axis=1)
    values = values - line @ np.linalg.lstsq(line, values, rcond=None)[0]
    spectrum = np.fft.rfft(values, 2 * count, axis=0)
    products = np.fft.irfft((np.abs(spectrum) ** 2).sum(axis=1), 2 * count)[:lags]
    power = np.concatenate([[0.0], np.cumsum(np.sum(values**2, axis=1))])
    lag = np.arange(lags)
    energy = power[count - lag] + power[-1] - power[lag]
    # A figure that stands still to within a micrometre of its leg has no cycle but rounding.
    return np.where(energy > 1e-12 * count, 2.0 * products / np.maximum(energy, 1e-300), 0.0)


class TempoRatio(Metric):
    """Cycles a second of the result over the median of real target clips of the same action; best at 1.

    See :func:`tempo`. Not applicable to actions that do not repeat (a jump, a throw).
    """

    info = MetricInfo(
        name="timing/tempo-ratio",
        summary="cycle frequency over that of real target motion",
        unit="1",
        direction="target",
        target=1.0,
        needs="reference",
        citation="McLeod & Wyvill 2005 (period by key maximum)",
        code_deps=("benchmark.motion.pose", "benchmark.motion.canonical", "eval.metrics.shared"),
    )

    def compute(self, sample: Sample) -> float:
        """The ratio; not applicable where either side does not repeat."""
        return tempo(sample.clip) / over_references(sample, tempo)


class DurationRatio(Metric):
    """Duration of the result over the median of real target clips of the same action; best at 1.

    Telling for actions with a beginning and an end. For cyclic ones it depends on how long the performer was recorded.
    """

    info = MetricInfo(
        name="timing/duration-ratio",
        summary="duration over that of real target motion",
        unit="1",
        direction="target",
        target=1.0,
        needs="reference",
        code_deps=("eval.metrics.shared",),
    )

    def compute(self, sample: Sample) -> float:
        """The ratio; not applicable to a single frame."""
        real = over_references(sample, lambda clip: clip.duration)
        if real <= 0.0 or sample.clip.duration <= 0.0:
            raise NotApplicableError("a single frame has no duration")
        return sample.clip.duration / real


class TempoError(Metric):
    """Size of the relative difference of cadence to real target motion, ``|ln(tempo / real tempo)|``.

    0.1 is 10 % too quick or too slow. Unlike :class:`TempoRatio`, of which too quick and too slow results cancel in a mean,
    it adds them up. Cadence as in :func:`tempo`; the real one is the median over target clips of the same action.
    """

    info = MetricInfo(
        name="timing/tempo-error",
        summary="size of the log ratio of the cycle frequency to that of real target motion",
        unit="1",
        direction="lower",
        needs="reference",
        citation="McLeod & Wyvill 2005 (period by key maximum)",
        code_deps=("benchmark.motion.pose", "benchmark.motion.canonical", "eval.metrics.shared"),
    )

    def compute(self, sample: Sample) -> float:
        """The error; not applicable where either side does not repeat."""
        return float(abs(np.log(tempo(sample.clip) / over_references(sample, tempo))))


class WarpDeviation(Metric):
    """How far the timing departs from the source's: mean of ``|pi(t) - t|`` over the result's frames, seconds.

    ``pi(t)`` is the mean source time that the dynamic time warping path pairs with result time t; poses and cost are those
    of :func:`eval.metrics.poses.aligned_distance`. It describes a change of timing and does not judge it: 0 for any method
    that keeps the source's clock, and ``|1 - 1/s| duration / 2`` for an even stretch by s.
    """

    info = MetricInfo(
        name="timing/warp-deviation",
        summary="mean shift in time between result and source along the alignment",
        unit="s",
        direction="none",
        code_deps=(
            "benchmark.motion.dtw",
            "benchmark.motion.pose",
            "benchmark.motion.canonical",
            "benchmark.motion.retarget",
            "eval.metrics.poses",
            "eval.metrics.shared",
        ),
    )

    def compute(self, sample: Sample) -> float:
        """The deviation in seconds."""
        clip, source = sample.clip, sample.source
        ours, _, path = aligned_poses(clip, source)
        seconds = path * [stride(clip.fps) / clip.fps, stride(source.fps) / source.fps]
        shifts = seconds[:, 1] - seconds[:, 0]
        frames = np.bincount(path[:, 0], minlength=len(ours))
        return float(np.abs(np.bincount(path[:, 0], weights=shifts) / frames).mean())
