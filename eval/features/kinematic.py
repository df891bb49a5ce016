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

Array = NDArray[np.float64]

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

#: Where the segments begin that are looked at: trunk and upper limbs, and the lower limbs; and how they hang at rest.
_SWINGING = ("hips", *(f"{side}_{_JOINTS[limb][0]}" for side, limb in _LIMBS))
_BENDING = tuple(f"{side}_{_JOINTS[limb][1]}" for side, limb in _LIMBS)
_RESTING = np.array([[0.0, 1.0, 0.0], *[[0.0, -1.0, 0.0]] * len(_LIMBS)])[:, None, None]
_UPPER_LENGTHS, _LOWER_LENGTHS = (
    np.array([_LENGTHS[limb][part] for _, limb in _LIMBS])[:, None, None, None] for part in (0, 1)
)

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
def kinematic_features(clip: MotionClip) -> Array:
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
    features = _describe(np.stack([sequence[span] for span in window_spans(len(sequence))]))
    features.flags.writeable = False
    return features


def stabilised(features: Array) -> Array:
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


def _describe(sequences: Array) -> Array:
    """(W, D) the features of windows (W, T, channels)."""
    segments = len(SEGMENTS)
    windows, frames = sequences.shape[:2]
    directions = sequences[..., : 3 * segments].reshape(windows, frames, segments, 3)
    lines = sequences[..., 3 * segments : 3 * segments + 6].reshape(windows, frames, 2, 3)
    travel, yaw_rate = sequences[..., -4:-1], sequences[..., -1]

    # Parts of the body come first: (trunk and 4 upper limbs | 4 limbs, W, T, 3).
    swinging = np.stack([directions[:, :, _INDEX[joint]] for joint in _SWINGING])
    upper = swinging[1:]
    lower = np.stack([directions[:, :, _INDEX[joint]] for joint in _BENDING])
    reach = _UPPER_LENGTHS * upper + _LOWER_LENGTHS * lower
    velocity, trunk_velocity = _rate(reach), _rate(swinging[0])
    speed = np.linalg.norm(velocity, axis=-1)
    floor_speed = np.linalg.norm(travel[..., [0, 2]], axis=-1)
    bend = _angle(upper, lower)
    arms, legs = velocity[:2], velocity[2:]

    values = [
        *np.stack([speed.mean(axis=-1), speed.std(axis=-1)], axis=1).reshape(-1, windows),
        np.linalg.norm(trunk_velocity, axis=-1).mean(axis=-1),
        floor_speed.mean(axis=-1),
        floor_speed.std(axis=-1),
        _rms(travel[..., 1]),
        _rms(yaw_rate),
        *_swing(swinging),
        *np.ptp(bend, axis=-1),
        *_angle(swinging, _RESTING).mean(axis=-1),
        *bend.mean(axis=-1),
        _rms(_angle(lines[:, :, 0], lines[:, :, 1])),
        *(_centroid(parts) for parts in (arms, legs, trunk_velocity[None])),
        _synchrony(arms[:1], arms[1:]),
        _synchrony(legs[:1], legs[1:]),
        _synchrony(arms, legs),
        *(_log_jerk(parts) for parts in (reach[:2], reach[2:])),
    ]
    return np.stack(values, axis=1)


def _rate(values: Array) -> Array:
    """(..., T, C) change in a unit of time."""
    return np.moveaxis(rate(np.moveaxis(values, -2, 0), RATE), 0, -2) * TIME_UNIT


def _rms(values: Array) -> Array:
    """(W,) of (W, T)."""
    return np.sqrt(np.mean(values**2, axis=-1))


def _angle(a: Array, b: Array) -> Array:
    """(...,) angles between unit vectors (..., 3) in radians, exact near 0 and pi too."""
    return 2.0 * np.arctan2(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1))


def _swing(directions: Array) -> Array:
    """(...,) largest angle between any two of (..., T, 3) unit vectors, radians."""
    return np.arccos(np.clip((directions @ directions.swapaxes(-1, -2)).min(axis=(-2, -1)), -1.0, 1.0))


def _centroid(velocity: Array) -> Array:
    """(W,) power-weighted mean frequency in Hz of (parts, W, T, 3) velocities, without their mean, under a Hann taper."""
    _, windows, frames, _ = velocity.shape
    centred = (velocity - velocity.mean(axis=2, keepdims=True)) * np.hanning(frames + 2)[1:-1, None]
    power = (np.abs(np.fft.rfft(centred, axis=2)) ** 2).sum(axis=(0, 3))
    power[:, 0] = 0.0
    frequencies = np.fft.rfftfreq(frames, 1.0 / RATE)
    floor = _STILL * (centred.size // windows) * frames
    return (power * frequencies).sum(axis=1) / (power.sum(axis=1) + floor)


def _synchrony(one: Array, two: Array) -> Array:
    """(W,) correlation of the fore-aft components of pairs of (pairs, W, T, 3) velocities, taken together, in [-1, 1]."""
    one, two = (values[..., 2] - values[..., 2].mean(axis=-1, keepdims=True) for values in (one, two))
    floor = _STILL * one.shape[0] * one.shape[2]
    both = np.sqrt((one**2).sum(axis=(0, 2)) * (two**2).sum(axis=(0, 2)))
    return (one * two).sum(axis=(0, 2)) / (both + floor)


def _log_jerk(reaches: Array) -> Array:
    """(W,) decimal logarithm of the mean over limbs and frames of the dimensionless jerk of (limbs, W, T, 3)."""
    jerk = np.linalg.norm(np.diff(reaches, n=3, axis=2), axis=-1).mean(axis=(0, 2)) * (RATE * TIME_UNIT) ** 3
    return np.log10(jerk + _JERK_FLOOR)
