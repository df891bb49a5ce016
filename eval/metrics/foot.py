"""Feet on the floor: whether those in contact stay where they are, and whether any go below it.

What a contact is is defined once, in :mod:`benchmark.motion.contacts`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmark.api import Metric, MetricInfo, NotApplicableError, Sample
from benchmark.motion.canonical import foot_points
from benchmark.motion.clip import MotionClip
from benchmark.motion.contacts import GRAVITY, detect
from benchmark.motion.skeleton import SIDES
from eval.metrics.shared import per_clip, speed_unit, stride

#: A foot in contact skates above this times ``sqrt(g * leg)``: 0.5 m/s for the leg of 0.826 m of the CMU skeleton, the
#: threshold that guided motion diffusion (Karunratanakul et al. 2023) and its successors use without scaling.
SKATE_SPEED = 0.5 / float(np.sqrt(GRAVITY * 0.826))

#: Height in leg lengths over which the sliding factor fades: 33 mm for the same leg.
SLIDE_HEIGHT = 0.033 / 0.826


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
