"""A training-free description of motion: speeds, ranges, postures, rhythm, coordination and smoothness of short windows.

In the spirit of the kinetic and geometric feature vectors on which motion distributions are compared (Onuma et al.
2008; Müller et al. 2005): readable, the same for every method, and blind to the performer's size, place and facing.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from benchmark.api import NotApplicableError
from benchmark.motion.clip import MotionClip
from benchmark.motion.pose import SEGMENTS
from benchmark.motion.skeleton import SIDES
from eval.features.sequence import RATE, TIME_UNIT, pose_sequence, rate
from eval.metrics.shared import per_clip

#: Seconds of a window, and from one window to the next.
WINDOW, HOP = 2.0, 1.0

#: Frames at :data:`~eval.features.sequence.RATE` that a third difference needs.
SHORTEST = 4

#: Lengths over leg length of upper arm, forearm, thigh and shank of the common body (Winter 2009, figure 4.1: .186, .146,
#: .245 and .246 of stature, the leg .491).
_LENGTHS = {"arm": (0.186 / 0.491, 0.146 / 0.491), "leg": (0.245 / 0.491, 0.246 / 0.491)}
_JOINTS = {"arm": ("shoulder", "elbow"), "leg": ("hip", "knee")}
_LIMBS = tuple((side, limb) for limb in _LENGTHS for side in SIDES)
_INDEX = {start: index for index, (start, _) in enumerate(SEGMENTS)}

#: Dimensionless jerk added before the logarithm: far below that of a person who stands still, far above rounding.
_JERK_FLOOR = 1e-3

#: Power of a rate, dimensionless, per frame and coordinate, below which there is nothing that could have a rhythm.
_STILL = 1e-6

_SWINGS = ("trunk", *(f"{side}-{_JOINTS[limb][0]}" for side, limb in _LIMBS))
_BENDS = tuple(f"{side}-{_JOINTS[limb][1]}" for side, limb in _LIMBS)

#: What each column of :func:`kinematic_features` is.
KINEMATIC_NAMES: tuple[str, ...] = (
    *(f"speed-{what}/{side}-{limb}" for side, limb in _LIMBS for what in ("mean", "sd")),
    "speed-mean/trunk",
    "speed-mean/hips",
    "speed-sd/hips",
    "vertical-speed-rms/hips",
    "yaw-rate-rms/hips",
    *(f"range/{joint}" for joint in (*_SWINGS, *_BENDS)),
    *(f"angle-mean/{joint}" for joint in (*_SWINGS, *_BENDS)),
    "twist-rms/trunk",
    *(f"spectral-centroid/{part}" for part in ("arms", "legs", "trunk")),
    *(f"synchrony/{pair}" for pair in ("arms", "legs", "arm-leg")),
    *(f"log-jerk/{part}" for part in ("arms", "legs")),
)

_RATES = np.array([name.startswith(("speed", "vertical-speed", "yaw-rate")) for name in KINEMATIC_NAMES])

#: Columns that the noise of a capture does not decide: all but jerk and spectral centroids. On Kinder-Gator those two tell who
#: was recorded how: with them, real children low-passed at 6 Hz are a third as far from themselves as adults are, without
#: them a thirtieth.
STEADY: tuple[int, ...] = tuple(
    index for index, name in enumerate(KINEMATIC_NAMES) if not name.startswith(("log-jerk", "spectral-centroid"))
)


@per_clip
def kinematic_features(clip: MotionClip) -> NDArray[np.float64]:
    """Kinematic features of the windows of a clip.

    Everything is computed on :func:`~eval.features.sequence.pose_sequence` at 30 frames a second, so it depends neither on
    frame rate, place, facing and size nor on the signs of quaternions. Limbs are imagined on a body of common proportions: the
    wrist moves about the shoulder, the ankle about the hip. In each window:

    - ``speed-mean``, ``speed-sd`` of a wrist about its shoulder, an ankle about its hip, the tip of the trunk's direction, and
      the hips along the floor, over ``sqrt(g leg)`` of the common body; ``vertical-speed-rms`` and ``yaw-rate-rms`` likewise;
    - ``range``: largest angle between two directions of trunk, upper arm or thigh; range of the bend of elbow or knee; radians;
    - ``angle-mean``: of the trunk to upright, of upper arm and thigh to hanging, bend of elbow and knee; radians;
    - ``twist-rms``: angle between the lines of hips and shoulders, radians;
    - ``spectral-centroid``: mean frequency of movement weighted by the power of its velocity, Hz; 0 where nothing moves;
    - ``synchrony``: cosine of the phase lag between the fore-aft velocities of the two sides (1 together, -1 in alternation,
      0 a quarter cycle apart or unrelated), and between those of arm and leg of the same side, both sides taken together;
    - ``log-jerk``: decimal logarithm of mean jerk of wrists or ankles, dimensionless.

    Parameters
    ----------
    clip
        A clip of at least 4 frames at 30 a second.

    Returns
    -------
    features
        (W, D) in the order of :data:`KINEMATIC_NAMES`, read-only. Windows of 2 s about every second, spread evenly so that
        the last ends with the clip; one for a clip that is no longer than a window.
    """
    sequence = pose_sequence(clip, RATE)
    if len(sequence) < SHORTEST:
        raise NotApplicableError(
            f"{len(sequence)} frames at 30 a second are too few to describe a movement: 4 are needed"
        )
    features = np.stack([_describe(sequence[span]) for span in window_spans(len(sequence))])
    features.flags.writeable = False
    return features


def stabilised(features: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N, D') the :data:`STEADY` of (N, D) kinematic features, with speeds and rates by their square roots.

    A few lively windows have several times the usual speed; where Gaussians are fitted or distances taken, plain speeds let
    them decide. Held out children of Kinder-Gator stand out more clearly from adults in square roots.
    """
    return np.where(_RATES, np.sqrt(np.where(_RATES, features, 0.0)), features)[:, STEADY]


def window_spans(frames: int, length: float = WINDOW, hop: float = HOP) -> list[slice]:
    """The windows of a sequence at :data:`~eval.features.sequence.RATE`, spread evenly from its first frame to its last.

    Parameters
    ----------
    frames
        T.
    length, hop
        Seconds of a window, and at most from one to the next.

    Returns
    -------
    spans
        One for sequences that are no longer than a window.
    """
    return list(_spans(frames, round(length * RATE), round(hop * RATE)))


@lru_cache(maxsize=4096)
def _spans(frames: int, size: int, step: int) -> tuple[slice, ...]:
    # Asked for with every distribution metric and clip, of a few hundred lengths.
    rest = max(0, frames - size)
    count = -(-rest // step) + 1
    return tuple(slice(int(start), int(start) + size) for start in np.round(np.linspace(0, rest, count)))


def _describe(sequence: NDArray[np.float64]) -> NDArray[np.float64]:
    """(D,) the features of one window (T, channels)."""
    segments = len(SEGMENTS)
    directions = sequence[:, : 3 * segments].reshape(-1, segments, 3)
    hip_line, shoulder_line = sequence[:, 3 * segments : 3 * segments + 6].reshape(-1, 2, 3).transpose(1, 0, 2)
    travel, yaw_rate = sequence[:, -4:-1], sequence[:, -1]

    trunk = directions[:, _INDEX["hips"]]
    upper = {key: directions[:, _INDEX[f"{key[0]}_{_JOINTS[key[1]][0]}"]] for key in _LIMBS}
    lower = {key: directions[:, _INDEX[f"{key[0]}_{_JOINTS[key[1]][1]}"]] for key in _LIMBS}
    reach = {key: _LENGTHS[key[1]][0] * upper[key] + _LENGTHS[key[1]][1] * lower[key] for key in _LIMBS}
    velocity = {key: _rate(reach[key]) for key in _LIMBS}
    speed = {key: np.linalg.norm(velocity[key], axis=-1) for key in _LIMBS}
    floor_speed = np.linalg.norm(travel[:, [0, 2]], axis=-1)
    down, up = np.array([0.0, -1.0, 0.0]), np.array([0.0, 1.0, 0.0])
    bend = {key: _angle(upper[key], lower[key]) for key in _LIMBS}

    arms, legs = ([velocity[side, limb] for side in SIDES] for limb in ("arm", "leg"))
    values = [
        *(value for key in _LIMBS for value in (speed[key].mean(), speed[key].std())),
        np.linalg.norm(_rate(trunk), axis=-1).mean(),
        floor_speed.mean(),
        floor_speed.std(),
        _rms(travel[:, 1]),
        _rms(yaw_rate),
        *(_swing(direction) for direction in (trunk, *upper.values())),
        *(np.ptp(bend[key]) for key in _LIMBS),
        _angle(trunk, up).mean(),
        *(_angle(direction, down).mean() for direction in upper.values()),
        *(bend[key].mean() for key in _LIMBS),
        _rms(_angle(hip_line, shoulder_line)),
        *(_centroid(np.concatenate(parts, axis=1)) for parts in (arms, legs, [_rate(trunk)])),
        _synchrony([(arms[0], arms[1])]),
        _synchrony([(legs[0], legs[1])]),
        _synchrony(list(zip(arms, legs, strict=True))),
        *(_log_jerk([reach[side, limb] for side in SIDES]) for limb in ("arm", "leg")),
    ]
    return np.array(values, dtype=np.float64)


def _rate(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return rate(values, RATE) * TIME_UNIT


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _angle(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """(T,) angles between unit vectors in radians, exact near 0 and pi too."""
    return 2.0 * np.arctan2(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1))


def _swing(directions: NDArray[np.float64]) -> float:
    """Largest angle between any two of (T, 3) unit vectors, radians."""
    return float(np.arccos(np.clip((directions @ directions.T).min(), -1.0, 1.0)))


def _centroid(velocity: NDArray[np.float64]) -> float:
    """Power-weighted mean frequency in Hz of (T, C) velocities, without their mean, under a Hann taper."""
    centred = (velocity - velocity.mean(axis=0)) * np.hanning(len(velocity) + 2)[1:-1, None]
    power = (np.abs(np.fft.rfft(centred, axis=0)) ** 2).sum(axis=1)
    power[0] = 0.0
    frequencies = np.fft.rfftfreq(len(velocity), 1.0 / RATE)
    floor = _STILL * centred.size * len(velocity)
    return float((power * frequencies).sum() / (power.sum() + floor))


def _synchrony(pairs: list[tuple[NDArray[np.float64], NDArray[np.float64]]]) -> float:
    """Correlation of the fore-aft components of pairs of (T, 3) velocities, taken together, in [-1, 1]."""
    one, two = (np.stack([pair[i][:, 2] for pair in pairs]) for i in range(2))
    one, two = (values - values.mean(axis=1, keepdims=True) for values in (one, two))
    return float((one * two).sum() / (np.sqrt((one**2).sum() * (two**2).sum()) + _STILL * one.size))


def _log_jerk(reaches: list[NDArray[np.float64]]) -> float:
    """Decimal logarithm of the mean over limbs (T, 3) and frames of dimensionless jerk."""
    jerk = [np.linalg.norm(np.diff(reach, n=3, axis=0), axis=-1).mean() * (RATE * TIME_UNIT) ** 3 for reach in reaches]
    return float(np.log10(np.mean(jerk) + _JERK_FLOOR))
