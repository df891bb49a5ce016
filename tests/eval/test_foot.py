from __future__ import annotations

import numpy as np
import pytest

from benchmark.api import NotApplicableError, Sample, StyleTask
from benchmark.commands.conformance.figures import figure, perform, walk, wave
from benchmark.motion import quat
from benchmark.motion.clip import MotionClip
from benchmark.motion.contacts import GRAVITY
from benchmark.motion.resample import resample
from eval.metrics.foot import SKATE_SPEED, FloorPenetration, FootSkateRatio, FootSkateSpeed, FootSlidingFactor

BODY = figure(0.8)
LIMIT = SKATE_SPEED * np.sqrt(GRAVITY * BODY.leg_length)


def sample(clip: MotionClip) -> Sample:
    return Sample(clip, clip, (), None, StyleTask("adult", "child"))


def value(metric, clip: MotionClip) -> float:
    return metric().compute(sample(clip))


def sliding(speed: float, *, fps: float = 60.0, lift: float = 0.0, skeleton=BODY) -> MotionClip:
    """A figure that stands still and glides forward at ``speed``."""
    still = wave(skeleton, seconds=2.0, fps=fps)
    root = still.root + np.arange(len(still))[:, None] * [0.6 * speed / fps, 0.0, 0.8 * speed / fps]
    return still.replace(root=root + [0.0, lift, 0.0])


def test_the_skate_threshold_is_half_a_metre_a_second_for_an_adult() -> None:
    assert SKATE_SPEED * np.sqrt(GRAVITY * 0.826) == pytest.approx(0.5)


def test_planted_feet_do_not_skate() -> None:
    clip = wave(BODY)
    for metric in (FootSkateRatio, FootSkateSpeed, FootSlidingFactor, FloorPenetration):
        assert value(metric, clip) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("speed", [0.05, 0.3, 0.6])
def test_a_slide_has_the_speed_it_was_made_with(speed: float) -> None:
    clip = sliding(speed)
    assert value(FootSkateSpeed, clip) == pytest.approx(speed, rel=1e-9)
    assert value(FootSlidingFactor, clip) == pytest.approx(speed, rel=1e-9)
    assert value(FootSkateRatio, clip) == (1.0 if speed > LIMIT else 0.0)


def test_half_a_slide_gives_half_the_ratio() -> None:
    slow, fast = sliding(0.0), sliding(0.65)
    root = np.concatenate([slow.root, fast.root])
    clip = slow.replace(rotations=np.concatenate([slow.rotations, fast.rotations]), root=root)
    assert value(FootSkateRatio, clip) == pytest.approx(0.5, abs=0.02)
    assert value(FootSkateSpeed, clip) == pytest.approx(0.325, abs=0.01)


def test_a_slide_too_fast_for_a_contact_is_charged_by_the_sliding_factor() -> None:
    clip = sliding(4.0)
    assert value(FootSlidingFactor, clip) == pytest.approx(4.0, rel=1e-9)
    with pytest.raises(NotApplicableError, match="no foot touches"):
        value(FootSkateRatio, clip)
    with pytest.raises(NotApplicableError, match="no foot touches"):
        value(FootSkateSpeed, clip)


def test_the_sliding_factor_fades_with_height_as_published() -> None:
    height = 0.033 * BODY.leg_length / 0.826
    low, high = sliding(0.4, lift=0.0), sliding(0.4, lift=0.5 * height)
    # Down long enough for the 5th percentile to be the floor, then half of H above it.
    clip = low.replace(
        rotations=np.concatenate([low.rotations] * 2),
        root=np.concatenate([low.root, high.root + low.root[-1] * [1, 0, 1]]),
    )
    assert value(FootSlidingFactor, clip) == pytest.approx(0.4 * 0.5 * (1.0 + 2.0 - 2.0**0.5), rel=0.01)


def test_feet_in_the_air_are_free() -> None:
    low, high = sliding(0.0), sliding(3.0, lift=0.2)
    root = np.concatenate([low.root, high.root])
    clip = low.replace(rotations=np.concatenate([low.rotations] * 2), root=root)
    # Only the one step between standing and gliding is seen, by the central difference across it.
    assert value(FootSlidingFactor, clip) < 0.02


@pytest.mark.parametrize("depth", [0.01, 0.04])
def test_penetration_is_the_depth_of_the_soles(depth: float) -> None:
    clip = wave(BODY)
    sunk = clip.replace(root=clip.root - [0.0, depth, 0.0])
    assert value(FloorPenetration, sunk) == pytest.approx(depth, abs=1e-9)
    assert value(FloorPenetration, clip.replace(root=clip.root + [0.0, depth, 0.0])) == 0.0


def test_penetration_sees_the_tips_of_chains() -> None:
    clip = wave(BODY)
    rotations = clip.rotations.copy()
    toe = BODY.joint("left_toe")
    rotations[:, toe] = quat.from_axis_angle(np.array([1.0, 0.0, 0.0]), np.array(np.pi / 2))
    (length,) = {np.linalg.norm(end.offset) for end in BODY.end_sites if end.parent == toe}
    assert value(FloorPenetration, clip.replace(rotations=rotations)) == pytest.approx(length, abs=1e-9)


def test_a_jump_has_no_contact() -> None:
    still = wave(BODY)
    with pytest.raises(NotApplicableError):
        value(FootSkateRatio, still.replace(root=still.root + [0.0, 1.0, 0.0]))


@pytest.mark.parametrize("metric", [FootSkateRatio, FootSkateSpeed, FootSlidingFactor])
def test_the_frame_rate_does_not_matter(metric) -> None:
    clip = perform("walk", "adult", 1)
    slower = resample(clip, 30.0, lowpass=False)
    assert value(metric, slower) == pytest.approx(value(metric, clip), rel=0.1, abs=0.03)


@pytest.mark.parametrize("metric", [FootSkateRatio, FootSkateSpeed, FootSlidingFactor])
def test_size_does_not_matter(metric) -> None:
    """A figure 0.64 times as large that takes 0.8 times as long has the same ratio, and speeds of the same Froude number."""
    clip = walk(BODY, seconds=2.0, fps=48.0)
    small = MotionClip(BODY.scaled(0.64), clip.rotations, 0.64 * clip.root, 60.0)
    ratio = value(metric, small) / value(metric, clip)
    assert ratio == pytest.approx(1.0 if metric is FootSkateRatio else 0.8, rel=0.08)
