from __future__ import annotations

import numpy as np
import pytest

from benchmark.api import FitContext, StyleTask
from benchmark.commands.conformance.figures import SmallView, figure, perform, walk, wave
from benchmark.errors import ConfigError
from benchmark.motion import quat
from benchmark.motion.clip import MotionClip
from benchmark.motion.contacts import GRAVITY, detect
from benchmark.motion.resample import resample
from eval.metrics.foot import FootSkateRatio
from eval.metrics.style import mean_speed
from methods.dynamic_scaling import DynamicScaling, size_ratio
from methods.identity import Identity

ADULT = figure(0.8)


def scale(clip: MotionClip, skeleton, **params) -> tuple[MotionClip, np.ndarray | None]:
    method = DynamicScaling(**params)
    rng = np.random.default_rng(0)
    task = StyleTask("adult", "child", skeleton)
    method.fit(SmallView(()), task, rng=rng, ctx=FitContext())
    result = method.transfer(clip, task, rng=rng)
    return result.clip, result.time_map


def throw(skeleton, seconds: float = 1.5, fps: float = 60.0) -> MotionClip:
    """A body thrown up and forward: free flight for the whole clip."""
    t = np.arange(round(seconds * fps) + 1) / fps
    root = np.stack([0.3 * t, 1.2 + 6.0 * t - 0.5 * GRAVITY * t**2, 2.0 * t], axis=1)
    return MotionClip(skeleton, quat.identity(len(t), len(skeleton)), root, fps)


@pytest.mark.parametrize("size", [0.5, 0.7, 0.91, 1.3])
def test_free_flight_keeps_its_gravity(size: float) -> None:
    clip, _ = scale(throw(ADULT), ADULT.scaled(size))
    acceleration = np.diff(clip.root, n=2, axis=0) * clip.fps**2
    # The last frame may lie up to half a frame past the source's end, where the source's last frame is held.
    assert acceleration[:-1, 1] == pytest.approx(-GRAVITY, abs=1e-6)
    assert acceleration[:-1, [0, 2]] == pytest.approx(0.0, abs=1e-6)


def test_velocity_scales_with_the_root_of_the_length() -> None:
    source = throw(ADULT)
    clip, _ = scale(source, ADULT.scaled(0.64))
    ours, theirs = np.diff(clip.root[:10, 2]) * clip.fps, np.diff(source.root[:10, 2]) * source.fps
    assert ours == pytest.approx(0.8 * theirs, rel=1e-9)


def test_the_froude_number_is_kept() -> None:
    source = walk(ADULT, seconds=4.0)
    clip, _ = scale(source, ADULT.scaled(0.64))
    assert mean_speed(clip) == pytest.approx(mean_speed(source), rel=0.01)


def test_a_body_of_the_same_size_is_the_identity() -> None:
    source = walk(ADULT)
    for params in ({}, {"scale": "time"}, {"ratio": "height"}, {"ratio": "limb"}):
        clip, _ = scale(source, ADULT, **params)
        assert len(clip) == len(source)
        assert np.max(quat.angle(clip.rotations, source.rotations)) < 1e-9
        assert np.max(np.abs(clip.root - source.root)) < 1e-9


def test_without_a_target_skeleton_the_source_comes_back() -> None:
    source = walk(ADULT)
    clip, time_map = scale(source, None)
    assert clip is source
    assert time_map is None


def test_two_scalings_are_one_scaling_by_the_product() -> None:
    source = throw(ADULT, seconds=2.0)
    half, _ = scale(source, ADULT.scaled(0.64))
    twice, _ = scale(half, ADULT.scaled(0.64 * 0.5625))
    once, _ = scale(source, ADULT.scaled(0.36))
    assert abs(len(twice) - len(once)) <= 1
    shared = min(len(twice), len(once)) - 2
    assert np.max(np.abs(twice.root[:shared] - once.root[:shared])) < 1e-6


def test_two_scalings_of_a_gesture_are_one_scaling_by_the_product() -> None:
    # Slow for its frame rate, so that the filter and slerp leave it alone to a tenth of a degree.
    source = wave(ADULT, seconds=4.0, fps=120.0, tempo=0.5)
    half, _ = scale(source, ADULT.scaled(0.64))
    twice, _ = scale(half, ADULT.scaled(0.36))
    once, _ = scale(source, ADULT.scaled(0.36))
    shared = min(len(twice), len(once)) - 2
    assert np.max(np.degrees(quat.angle(twice.rotations[:shared], once.rotations[:shared]))) < 0.1


@pytest.mark.parametrize("size", [0.5, 0.73, 1.21])
@pytest.mark.parametrize("frames", [2, 3, 59, 181])
def test_duration(size: float, frames: int) -> None:
    clip, time_map = scale(walk(ADULT, seconds=4.0).frames(0, frames), ADULT.scaled(size))
    assert len(clip) == round(np.sqrt(size) * (frames - 1)) + 1
    assert time_map is not None
    assert time_map[0] == 0.0
    assert np.all(np.diff(time_map) >= 0.0)
    assert np.diff(time_map)[:-1] == pytest.approx(1.0 / (60.0 * np.sqrt(size)))


def test_angles_are_those_of_the_source_at_the_mapped_time() -> None:
    source = wave(ADULT, seconds=4.0, fps=120.0, tempo=0.5)
    clip, time_map = scale(source, ADULT.scaled(0.7))
    elbow = ADULT.joint("right_elbow")
    assert time_map is not None
    wanted = -0.6 + 0.5 * np.sin(2.0 * np.pi * 0.5 * time_map)
    angle = 2.0 * np.arctan2(clip.rotations[:, elbow, 3], clip.rotations[:, elbow, 0])
    assert (angle + np.pi) % (2.0 * np.pi) - np.pi == pytest.approx(wanted, abs=2e-3)


def test_a_similar_body_keeps_contacts_and_does_not_skate_more() -> None:
    source = walk(ADULT, seconds=4.0)
    clip, time_map = scale(source, ADULT.scaled(0.64))
    assert time_map is not None
    frames = np.round(time_map * source.fps).astype(int)
    agreement = np.mean(detect(clip).flags == detect(source).flags[frames])
    assert agreement > 0.97
    ratio = FootSkateRatio()
    assert ratio.compute(sample(clip)) <= ratio.compute(sample(source)) + 0.02


def sample(clip: MotionClip):
    from benchmark.api import Sample

    return Sample(clip, clip, (), None, StyleTask("adult", "child"))


def test_other_proportions_meet_the_floor() -> None:
    source = walk(ADULT)
    child = perform("walk", "child", 1).skeleton
    for params in ({"scale": name} for name in DynamicScaling.variants()):
        clip, _ = scale(source, child, **params)
        toes = clip.positions[:, child.joints("left_toe", "right_toe"), 1].min(axis=1)
        assert abs(np.median(toes)) < 0.03


def test_length_only_is_what_retargeting_does() -> None:
    source, child = walk(ADULT), perform("walk", "child", 1).skeleton
    clip, time_map = scale(source, child, scale="length")
    same = Identity().transfer(source, StyleTask("adult", "child", child), rng=np.random.default_rng(0)).clip
    assert time_map is None
    assert np.array_equal(clip.root, same.root)
    assert np.array_equal(clip.rotations, same.rotations)


def test_time_only_keeps_the_path_in_metres_and_slides() -> None:
    source = walk(ADULT, seconds=4.0)
    child = ADULT.scaled(0.64)
    both, _ = scale(source, child)
    time, _ = scale(source, child, scale="time")
    assert len(time) == len(both)
    assert np.ptp(time.root[:, 2]) == pytest.approx(np.ptp(source.root[:, 2]), rel=0.01)
    assert np.ptp(both.root[:, 2]) == pytest.approx(0.64 * np.ptp(source.root[:, 2]), rel=0.01)
    assert np.allclose(time.root[:, 1], both.root[:, 1])
    ratio = FootSkateRatio()
    assert ratio.compute(sample(time)) > ratio.compute(sample(both)) + 0.2


def test_height_ratio_scales_the_path_by_height() -> None:
    source = throw(ADULT)
    long_legs = figure(0.6, trunk=0.3)
    length = size_ratio(ADULT, long_legs, "height")
    assert length == pytest.approx((0.6 + 0.3 + 0.1) / (0.8 + 0.5 + 0.1))
    clip, _ = scale(source, long_legs, ratio="height")
    assert clip.root[20, 2] == pytest.approx(length * 2.0 * 20 / 60.0 / np.sqrt(length), rel=1e-6)
    assert np.diff(clip.root[:-1, 1], n=2) * clip.fps**2 == pytest.approx(-GRAVITY, abs=1e-6)


def test_limb_ratio_is_the_mean_over_arms_and_legs() -> None:
    other = figure(0.4, arm=0.44)
    assert size_ratio(ADULT, other, "limb") == pytest.approx((0.5 + 0.8) / 2.0)


def test_noise_beyond_what_the_faster_clock_can_carry_is_removed() -> None:
    t = np.arange(241) / 60.0
    rotations = quat.identity(len(t), len(ADULT))
    # 29 Hz would fold back to 54.8 - 29 = 25.8 Hz on a clock that runs 1 / sqrt(0.3) times as fast.
    root = np.stack([0.0 * t, np.full_like(t, 1.0), 0.01 * np.sin(2.0 * np.pi * 29.0 * t)], axis=1)
    clip, _ = scale(MotionClip(ADULT, rotations, root, 60.0), ADULT.scaled(0.3))
    assert np.max(np.abs(clip.root[20:-20, 2])) < 0.01 * 0.3 * 0.05


def test_the_rate_of_the_source_is_kept() -> None:
    source = resample(walk(ADULT), 30.0)
    clip, _ = scale(source, ADULT.scaled(0.7))
    assert clip.fps == 30.0


@pytest.mark.parametrize("params", [{"scale": "size"}, {"ratio": "weight"}])
def test_settings_that_do_not_exist(params: dict) -> None:
    with pytest.raises(ConfigError, match="dynamic-scaling"):
        scale(walk(ADULT), ADULT, **params)
