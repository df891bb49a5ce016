"""Feet on the floor: whether those in contact stay where they are, and whether any go below it.

What a contact is is defined once, in :mod:`benchmark.motion.contacts`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmark.api import Metric, MetricInfo, NotApplicableError, Sample
from benchmark.motion.canonical import foot_points
from benchmark.motion.clip import MotionClip
from benchmark.motion.contacts import GRAVITY, SPEED, detect
from benchmark.motion.skeleton import SIDES
from eval.metrics.shared import per_clip, speed_unit, stride

#: A foot in contact skates above this times ``sqrt(g * leg)``: 0.5 m/s for the leg of 0.826 m of the CMU skeleton, the
#: threshold that guided motion diffusion (Karunratanakul et al. 2023) and its successors use without scaling.
SKATE_SPEED = 0.5 / float(np.sqrt(GRAVITY * 0.826))

#: Height in leg lengths over which the sliding factor fades: 33 mm for the same leg.
SLIDE_HEIGHT = 0.033 / 0.826

#: The common definition, as it stands in public code: frames a second, metres, metres a second, frames of the mean.
_COMMON_FPS, _COMMON_HEIGHT, _COMMON_SPEED, _COMMON_WINDOW = 20.0, 0.05, 0.50, 5


@per_clip
def _contacts(clip: MotionClip) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    contacts = detect(clip)
    return contacts.flags, contacts.joints


@per_clip
def _speeds_in_contact(clip: MotionClip) -> NDArray[np.float64]:
    """(N,) horizontal speed in m/s of every foot joint in every frame in which it is in contact."""
    flags, joints = _contacts(clip)
    return _horizontal_speed(clip, joints)[flags]


def _horizontal_speed(clip: MotionClip, joints: NDArray[np.int64]) -> NDArray[np.float64]:
    """(T, F) m/s, by central differences over twice the fixed step (shorter at the ends)."""
    path = clip.positions[:, joints][..., [0, 2]]
    frames = np.arange(len(clip))
    half = stride(clip.fps)
    before, after = np.maximum(frames - half, 0), np.minimum(frames + half, len(clip) - 1)
    seconds = np.maximum(after - before, 1) / clip.fps
    return np.linalg.norm(path[after] - path[before], axis=-1) / seconds[:, None]


def _at(paths: NDArray[np.float64], frames: NDArray[np.float64]) -> NDArray[np.float64]:
    """``paths`` (T, F, 3) at fractional frames, linearly between frames."""
    low = np.minimum(frames.astype(np.int64), max(len(paths) - 2, 0))
    high = np.minimum(low + 1, len(paths) - 1)
    share = np.minimum(frames - low, 1.0)[:, None, None]
    return np.asarray((1.0 - share) * paths[low] + share * paths[high])


class FootSkateRatio(Metric):
    """Fraction of foot contacts that skate.

    Over all foot joints and frames in contact, the share whose horizontal speed exceeds ``0.176 sqrt(g leg)``, which is
    the 0.5 m/s of guided motion diffusion (Karunratanakul et al. 2023) at the size of the CMU skeleton. Contacts are scaled
    by leg length likewise, and speeds are taken over a fixed time, so neither body size nor frame rate enters. Real motion
    is not at zero: rolling feet and capture noise count.

    A foot that slides so fast that it is no contact is seen by :class:`FootSlidingFactor`, not here.
    """

    info = MetricInfo(
        name="physics/foot-skate-ratio",
        summary="share of foot contacts in which the foot moves over the floor",
        unit="1",
        direction="lower",
        citation="Karunratanakul et al. 2023",
        code_deps=("benchmark.motion.contacts", "eval.metrics.shared"),
    )

    def compute(self, sample: Sample) -> float:
        """The ratio in [0, 1]; not applicable to a clip without contacts."""
        speeds = _speeds_in_contact(sample.clip)
        if speeds.size == 0:
            raise NotApplicableError("no foot touches the floor in this clip")
        return float(np.mean(speeds > SKATE_SPEED * speed_unit(sample.clip)))


class FootSkateSpeed(Metric):
    """Mean horizontal speed of foot joints in contact, m/s."""

    info = MetricInfo(
        name="physics/foot-skate-speed",
        summary="mean horizontal speed of the feet in contact",
        unit="m/s",
        direction="lower",
        code_deps=("benchmark.motion.contacts", "eval.metrics.shared"),
    )

    def compute(self, sample: Sample) -> float:
        """The speed in m/s; not applicable to a clip without contacts."""
        speeds = _speeds_in_contact(sample.clip)
        if speeds.size == 0:
            raise NotApplicableError("no foot touches the floor in this clip")
        return float(speeds.mean())


class FootSlidingFactor(Metric):
    """Horizontal speed of the feet, weighted by how close they are to the level they stand on.

    ``mean over frames and foot joints of v_xz (2 - 2^(h / H))``, with ``h`` clipped to [0, H] (Zhang et al. 2018, there with
    H = 2.5 cm for a dog; 3.3 cm is used for people). H is 0.04 leg. ``h`` is measured from the 5th percentile of the height
    of the lower one of left and right, per kind of joint, so a joint that rests above the sole needs no correction. No
    contact is decided on: a figure that glides too fast to be in contact is charged in full.
    """

    info = MetricInfo(
        name="physics/foot-sliding-factor",
        summary="horizontal foot speed, weighted by closeness to the floor",
        unit="m/s",
        direction="lower",
        citation="Zhang, Starke, Komura & Saito 2018",
        code_deps=("benchmark.motion.contacts", "eval.metrics.shared"),
    )

    def compute(self, sample: Sample) -> float:
        """The factor in m/s."""
        clip = sample.clip
        skeleton = clip.skeleton
        terms = []
        for part in ("ankle", "toe"):
            roles = [f"{side}_{part}" for side in SIDES]
            if not skeleton.has(*roles):
                continue
            joints = np.array(skeleton.joints(*roles))
            heights = clip.positions[:, joints, 1]
            level = np.percentile(heights.min(axis=1), 5.0)
            rise = np.clip((heights - level) / (SLIDE_HEIGHT * skeleton.leg_length), 0.0, 1.0)
            terms.append(_horizontal_speed(clip, joints) * (2.0 - 2.0**rise))
        if not terms:
            raise NotApplicableError("the skeleton has neither ankles nor toes")
        return float(np.mean(terms))


class FootSkateCommon(Metric):
    """Fraction of frames in which a foot skates, by the definition in common use.

    As in the public code of guided motion diffusion (Karunratanakul et al. 2023), which OmniControl (Xie et al. 2024) and
    others took over: at 20 frames a second (linearly between frames, no filter), a toe joint skates if it is below 0.05 m in a
    frame and the next, moves over the floor faster than 0.50 m/s, and does so in the mean over 5 frames as well; the ratio is
    of frames in which either foot does. Where the skeleton has no toes the ankles are taken.

    Nothing in it is scaled: a child's foot of half the size passes the same metres, a toe joint that rests above 0.05 m is
    never in contact, and one that glides 0.05 m above the floor is not seen. It is here to be comparable with published
    numbers; :class:`FootSkateRatio` is the one to judge by.
    """

    info = MetricInfo(
        name="physics/foot-skate-common",
        summary="share of frames in which a foot slides, by the unscaled definition in common use",
        unit="1",
        direction="lower",
        citation="Karunratanakul et al. 2023; Xie et al. 2024",
    )

    def compute(self, sample: Sample) -> float:
        """The ratio in [0, 1]; not applicable to less than two frames at 20 frames a second."""
        clip, skeleton = sample.clip, sample.clip.skeleton
        toes = [f"{side}_toe" for side in SIDES]
        joints = skeleton.joints(*(toes if skeleton.has(*toes) else [f"{side}_ankle" for side in SIDES]))
        frames = int(np.floor(clip.duration * _COMMON_FPS + 1e-6)) + 1
        if frames < 2:
            raise NotApplicableError("fewer than two frames at 20 frames a second")
        feet = _at(clip.positions[:, joints], np.arange(frames, dtype=np.float64) * (clip.fps / _COMMON_FPS))
        speed = np.linalg.norm(np.diff(feet[..., [0, 2]], axis=0), axis=-1) * _COMMON_FPS
        # Beyond the ends there is no speed: there the mean over the window takes zeros, as the public code does.
        reach = _COMMON_WINDOW // 2
        padded = np.pad(speed, ((reach, reach), (0, 0)))
        mean = np.lib.stride_tricks.sliding_window_view(padded, _COMMON_WINDOW, axis=0).mean(axis=-1)
        low = (feet[:-1, :, 1] < _COMMON_HEIGHT) & (feet[1:, :, 1] < _COMMON_HEIGHT)
        skates = low & (speed > _COMMON_SPEED) & (mean > _COMMON_SPEED)
        return float(skates.any(axis=1).mean())


class Floating(Metric):
    """Height of the lowest foot point above the floor while it stands, ``mean_{t in stance} max(0, min_j y_j(t))``, metres.

    Stance is told by speed alone, for a floating figure has no foot on the floor: frames in which the lowest foot point moves
    slower than ``0.266 sqrt(g leg)``, the speed of a contact, in three dimensions. At the top of a jump that holds for some
    hundredths of a second, which a real jump has too: read it beside real motion. Foot points as in :class:`FloorPenetration`.
    """

    info = MetricInfo(
        name="physics/floating",
        summary="mean height of the lowest foot point above the floor in stance",
        unit="m",
        direction="lower",
        code_deps=("benchmark.motion.canonical", "benchmark.motion.contacts", "eval.metrics.shared"),
    )

    def compute(self, sample: Sample) -> float:
        """The height in metres; not applicable to a clip in which the feet never rest."""
        clip = sample.clip
        points = foot_points(clip)
        frames = np.arange(len(clip))
        lowest = points[..., 1].argmin(axis=1)
        half = stride(clip.fps)
        before, after = np.maximum(frames - half, 0), np.minimum(frames + half, len(clip) - 1)
        seconds = np.maximum(after - before, 1) / clip.fps
        speed = np.linalg.norm(points[after, lowest] - points[before, lowest], axis=-1) / seconds
        heights = points[frames, lowest, 1][speed < SPEED * speed_unit(clip)]
        if heights.size == 0:
            raise NotApplicableError("no foot ever rests in this clip")
        return float(np.maximum(0.0, heights).mean())


class FloorPenetration(Metric):
    """Depth of the deepest foot point below the floor, ``mean_t max_j max(0, -y_j(t))``, metres.

    Foot points are the ankles and whatever hangs below them, tips of chains included
    (:func:`benchmark.motion.canonical.foot_points`, by which the floor of real captures is found too); the floor is ``y = 0``.
    """

    info = MetricInfo(
        name="physics/floor-penetration",
        summary="mean depth of the deepest foot point below the floor",
        unit="m",
        direction="lower",
        code_deps=("benchmark.motion.canonical",),
    )

    def compute(self, sample: Sample) -> float:
        """The depth in metres."""
        lowest = foot_points(sample.clip)[..., 1].min(axis=1)
        return float(np.mean(np.maximum(0.0, -lowest)))
