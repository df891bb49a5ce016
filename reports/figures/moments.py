"""Which moments a picture shows: the stretch of a clip with most movement, and the same phase in other clips."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.motion.clip import MotionClip
from benchmark.motion.pose import segment_directions

#: Frames a second of the 2020 paper, in whose frames the distance of poses is given.
PAPER_FPS = 60.0

#: Durations that are tried for a stretch of another performance, as multiples of the input's.
_STRETCHES = np.geomspace(0.6, 1.7, 12)
#: Poses compared to find it.
_COMPARED = 16

#: How a row's moments follow from the input's.
SAME, STATED, ALIKE = "at the input's times", "by the source times it states", "most alike"


@dataclass(frozen=True, eq=False)
class Row:
    """One row of a picture.

    Attributes
    ----------
    label
        What it is called.
    clip
        The motion.
    times
        (N,) seconds of the clip that are shown.
    how
        How they follow from the input's: :data:`SAME`, :data:`STATED` or :data:`ALIKE`.
    """

    label: str
    clip: MotionClip
    times: NDArray[np.float64]
    how: str = SAME


def busiest(clip: MotionClip, seconds: float) -> float:
    """When the stretch of ``seconds`` with most movement of joints about the hips begins; 0 if the clip is no longer."""
    if clip.duration <= seconds:
        return 0.0
    local = clip.positions - clip.positions[:, :1] * [1.0, 0.0, 1.0]
    speed = np.linalg.norm(np.diff(local, axis=0), axis=-1).mean(axis=1)
    # The fastest frames of a depth camera's capture are its misses.
    speed = np.minimum(speed, np.percentile(speed, 95.0))
    travelled = np.concatenate([[0.0], np.cumsum(speed)])
    starts = clip.times[clip.times <= clip.duration - seconds + 1e-9]
    within = np.interp(starts + seconds, clip.times, travelled) - np.interp(starts, clip.times, travelled)
    return float(starts[int(np.argmax(within))])


def stretch(clip: MotionClip, *, step: int, poses: int) -> NDArray[np.float64]:
    """Times of ``poses`` moments ``step`` frames of the paper apart, where most moves; fewer in a shorter clip."""
    gap = step / PAPER_FPS
    count = max(1, min(poses, int(clip.duration / gap + 1e-9) + 1))
    return np.asarray(busiest(clip, (count - 1) * gap) + gap * np.arange(count), dtype=np.float64)


def matching(
    source: MotionClip,
    times: NDArray[np.float64],
    clip: MotionClip,
    *,
    time_map: NDArray[np.float64] | None = None,
    copied: bool = False,
) -> tuple[NDArray[np.float64], str]:
    """Times of ``clip`` that show the phase which ``source`` shows at ``times``, and how they were found.

    Parameters
    ----------
    source
        The input.
    times
        (N,) seconds of it.
    clip
        A result for it, or a real performance of the same action.
    time_map
        (T,) source time of each frame of ``clip``, where it states one.
    copied
        Whether ``clip`` is another performance and so has no frame in common with the source.
    """
    if time_map is not None and len(time_map) == len(clip):
        return np.interp(times, time_map, clip.times), STATED
    if not copied and abs(clip.duration - source.duration) < 1.5 / clip.fps:
        return np.minimum(times, clip.duration), SAME
    return most_alike(source, times, clip), ALIKE


def most_alike(source: MotionClip, times: NDArray[np.float64], clip: MotionClip) -> NDArray[np.float64]:
    """Evenly spaced times of the stretch of ``clip`` whose poses are nearest to those of ``source`` at ``times``.

    Every start and durations from 0.6 to 1.7 of the input's are tried. Poses are compared by the directions of trunk and limbs
    and the height of the hips in leg lengths, facing forward.
    """
    span = float(times[-1] - times[0])
    phases = np.linspace(0.0, 1.0, _COMPARED if span > 0.0 else 1)
    wanted = sample(_features(source), source, times[0] + span * phases)
    features = _features(clip)
    best = (np.inf, 0.0, 0.0)
    for length in np.unique(np.minimum(span * _STRETCHES, clip.duration)):
        starts = clip.times[clip.times <= clip.duration - length + 1e-9]
        found = sample(features, clip, starts[:, None] + length * phases)
        gaps = np.linalg.norm(found - wanted, axis=-1).mean(axis=(1, 2))
        index = int(np.argmin(gaps))
        if gaps[index] < best[0] - 1e-12:
            best = (float(gaps[index]), float(starts[index]), float(length))
    share = (times - times[0]) / span if span > 0.0 else np.zeros(len(times))
    return best[1] + best[2] * share


def _features(clip: MotionClip) -> NDArray[np.float64]:
    """(T, S, 3): directions, and the hips' height as one more."""
    hips = clip.positions[:, clip.skeleton.joint("hips")] * [0.0, 1.0, 0.0] / clip.skeleton.leg_length
    return np.concatenate([segment_directions(clip), hips[:, None]], axis=1)


def sample(values: NDArray[np.float64], clip: MotionClip, times: NDArray[np.float64]) -> NDArray[np.float64]:
    """``values`` (T, …) of a clip at ``times`` (…), linearly between frames."""
    at = np.clip(np.asarray(times) * clip.fps, 0.0, len(clip) - 1)
    low = np.minimum(at.astype(int), max(len(clip) - 2, 0))
    high = np.minimum(low + 1, len(clip) - 1)
    share = (at - low).reshape(*at.shape, *([1] * (values.ndim - 1)))
    return (1.0 - share) * values[low] + share * values[high]
