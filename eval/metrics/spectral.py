"""What the spectrum of a motion says: how smooth its speed is, and how its power is spread over frequencies."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmark.api import Metric, MetricInfo, NotApplicableError, Sample
from benchmark.motion.clip import MotionClip
from benchmark.motion.pose import SEGMENTS, segment_directions
from benchmark.motion.skeleton import SIDES
from eval.metrics.shared import difference, over_references, per_clip, references, speed_unit, stride
from eval.metrics.windowed import windows

#: Of the arc length (Balasubramanian et al. 2015): highest frequency in Hz, share of the spectrum's maximum that ends it, and
#: by which power of two the transform is longer than the window.
_HIGHEST, _SHARE, _PADDING = 10.0, 0.05, 4

#: Seconds of a window: two or more steps, one gesture.
_WINDOW = 2.0

#: Mean speed in sqrt(g leg) below which a joint rests in a window, and shortest window in seconds.
_RESTING, _SHORTEST = 0.01, 0.5

#: Where smoothness is measured: the ends of the limbs and the head.
_ENDS = ("head", *(f"{side}_{part}" for side in SIDES for part in ("wrist", "ankle")))

#: Spectra are compared from 0 to 15 Hz in this many steps; variance of directions below which a window stands still.
_NYQUIST, _BINS, _STILL = 15.0, 61, 1e-8


def spectral_arc_length(speed: NDArray[np.float64], rate: float) -> NDArray[np.float64]:
    """(...,) arc length of the normalised spectra of speed profiles (..., n), negative; nearer to 0 is smoother.

    ``-int_0^wc sqrt((1 / wc)^2 + (dV/dw)^2) dw`` with ``V = |FFT(speed)|`` over its value at 0, up to the last frequency below
    10 Hz at which V reaches 0.05 (Balasubramanian et al. 2015, equation 11).
    """
    length = 2 ** (int(np.ceil(np.log2(speed.shape[-1]))) + _PADDING)
    spectrum = np.abs(np.fft.rfft(speed, length))
    frequency = np.fft.rfftfreq(length, 1.0 / rate)
    spectrum = spectrum[..., frequency <= _HIGHEST] / spectrum.max(axis=-1, keepdims=True)
    frequency = frequency[frequency <= _HIGHEST]
    counts = np.arange(1, len(frequency))
    last = np.where(spectrum[..., 1:] >= _SHARE, counts, 0).max(axis=-1, keepdims=True)
    step = np.diff(frequency) / np.maximum(frequency[last], frequency[1])
    arcs = np.sqrt(step**2 + np.diff(spectrum) ** 2)
    return -np.sum(arcs, axis=-1, where=counts <= last)


@per_clip
def mean_arc_length(clip: MotionClip) -> float:
    """Mean spectral arc length of head, wrists and ankles over windows of 2 s; joints at rest do not count."""
    step = stride(clip.fps)
    rate = clip.fps / step
    joints = clip.skeleton.joints(*(role for role in _ENDS if clip.skeleton.has(role)))
    if len(clip) < max(_SHORTEST * clip.fps, 2 * step + 1):
        raise NotApplicableError(f"spectral arc length needs {_SHORTEST:g} s, and the clip lasts {clip.duration:.2g} s")
    speed = np.linalg.norm(difference(clip.positions[:, joints], clip.fps), axis=-1)[::step] / speed_unit(clip)
    profiles = np.concatenate([speed[start:stop].T for start, stop in windows(len(speed), rate, _WINDOW)])
    moving = profiles[profiles.mean(axis=1) > _RESTING]
    if not len(moving):
        raise NotApplicableError("head, hands and feet rest in this clip")
    return float(spectral_arc_length(moving, rate).mean())


class SpectralArcLength(Metric):
    """Spectral arc length of the result minus the median of real target clips of the same action; best at 0.

    See :func:`mean_arc_length`. Below 0 the result is less smooth than people are, above 0 smoother. Amplitude does not
    enter, and unlike jerk it weighs no frequency above another.
    """

    info = MetricInfo(
        name="physics/spectral-arc-length",
        summary="spectral arc length of limb speeds minus that of real target motion",
        unit="1",
        direction="target",
        target=0.0,
        needs="reference",
        citation="Balasubramanian, Melendez-Calderon, Roby-Brami & Burdet 2015",
        code_deps=("eval.metrics.shared", "eval.metrics.windowed"),
    )

    def compute(self, sample: Sample) -> float:
        """The difference; not applicable where either side rests or is too short."""
        return mean_arc_length(sample.clip) - over_references(sample, mean_arc_length)


@per_clip
def power_spectra(clip: MotionClip) -> NDArray[np.float64]:
    """(F, D) power of each component of the limbs' directions at F frequencies from 0 to 15 Hz, mean over windows of 2 s.

    Directions face forward (:func:`benchmark.motion.pose.segment_directions`), so neither body nor place nor facing enters;
    each window's mean posture is taken off.
    """
    step = stride(clip.fps)
    rate = clip.fps / step
    directions = segment_directions(clip)[::step].reshape(-1, 3 * len(SEGMENTS))
    if len(directions) < _SHORTEST * rate:
        raise NotApplicableError(f"a power spectrum needs {_SHORTEST:g} s, and the clip lasts {clip.duration:.2g} s")
    length = round(_WINDOW * rate) + 1
    grid = np.linspace(0.0, _NYQUIST, _BINS)
    parts = np.stack([directions[start:stop] for start, stop in windows(len(directions), rate, _WINDOW)])
    parts = (parts - parts.mean(axis=1, keepdims=True)) * np.hanning(parts.shape[1] + 2)[1:-1, None]
    spectrum = (np.abs(np.fft.rfft(parts, 2 * length, axis=1)) ** 2).mean(axis=0) / parts.shape[1]
    frequency = np.fft.rfftfreq(2 * length, 1.0 / rate)
    return np.stack([np.interp(grid, frequency, column, right=0.0) for column in spectrum.T], axis=1)


def power_spectrum_distance(ours: NDArray[np.float64], theirs: NDArray[np.float64]) -> float:
    """Earth mover's distance between normalised spectra (F, D), mean over D weighted by the power of ``theirs``, in Hz."""
    weights = theirs.sum(axis=0)
    if weights.sum() < _STILL:
        raise NotApplicableError("the real target clip stands still, so it has no spectrum")

    def cumulated(power: NDArray[np.float64]) -> NDArray[np.float64]:
        whole = power.sum(axis=0)
        # A component without power is all at 0 Hz: what does not move does so infinitely slowly.
        return np.where(whole > _STILL, np.cumsum(power, axis=0) / np.maximum(whole, _STILL), 1.0)

    step = _NYQUIST / (_BINS - 1)
    distances = np.abs(cumulated(ours) - cumulated(theirs)).sum(axis=0) * step
    return float(np.average(distances, weights=weights))


class PowerSpectrumDistance(Metric):
    """Normalised power spectrum similarity: how far power lies from where real motion has it, Hz.

    The earth mover's distance between the normalised power spectra of result and reference, component by component, weighted
    by the reference's power (Gopalakrishnan et al. 2019), median over real target clips of the same action. Here the
    components are directions of trunk and limbs, the spectra means over windows of 2 s, and frequencies in Hz, so neither
    proportions nor clip length nor frame rate enters. It ignores when something happens and sees tempo, jitter and freezing.
    """

    info = MetricInfo(
        name="style/power-spectrum-distance",
        summary="distance of the motion's power spectra to those of real target motion (NPSS)",
        unit="Hz",
        direction="lower",
        needs="reference",
        citation="Gopalakrishnan, Mali, Kifer, Giles & Ororbia 2019",
        code_deps=(
            "benchmark.motion.pose",
            "benchmark.motion.canonical",
            "eval.metrics.shared",
            "eval.metrics.windowed",
        ),
    )

    def compute(self, sample: Sample) -> float:
        """The distance in hertz; not applicable to clips under 0.5 s, or where the real ones stand still."""
        ours = power_spectra(sample.clip)
        values, reason = [], None
        for clip in references(sample):
            try:
                values.append(power_spectrum_distance(ours, power_spectra(clip)))
            except NotApplicableError as error:
                reason = error
        if not values:
            raise NotApplicableError(f"no reference has a spectrum: {reason}")
        return float(np.median(values))
