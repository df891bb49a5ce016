from __future__ import annotations

import gc
import weakref

import numpy as np
import pytest

from benchmark.api import NotApplicableError, Sample, StyleTask
from benchmark.commands.conformance.figures import figure, perform, walk, wave
from benchmark.motion import quat
from benchmark.motion.clip import MotionClip
from benchmark.motion.contacts import GRAVITY
from benchmark.motion.resample import resample
from eval.metrics.shared import STEP, difference, over_references, per_clip
from eval.metrics.smoothness import JerkRatio, mean_jerk
from eval.metrics.style import (
    RangeOfMotionDifference,
    RangeOfMotionRatio,
    ReferenceDistance,
    SpeedDifference,
    SpeedRatio,
    mean_speed,
    ranges_of_motion,
)

BODY = figure(0.8)


def sample(clip: MotionClip, *references: MotionClip) -> Sample:
    return Sample(clip, clip, references, None, StyleTask("adult", "child"))


def rocking(amplitude: float, hertz: float, *, seconds: float = 4.0, fps: float = 60.0, skeleton=BODY) -> MotionClip:
    """A stiff figure carried to and fro."""
    t = np.arange(round(seconds * fps)) / fps
    root = np.stack([0.0 * t, np.ones_like(t), amplitude * np.sin(2.0 * np.pi * hertz * t)], axis=1)
    return MotionClip(skeleton, quat.identity(len(t), len(skeleton)), root, fps)


def bending(degrees: float, role: str = "left_elbow", *, start: float = 0.0, skeleton=BODY) -> MotionClip:
    """One joint that swings ``degrees`` to either side of ``start`` in the plane of the T, four times."""
    phase = np.linspace(0.0, 8.0 * np.pi, 241)
    rotations = quat.identity(len(phase), len(skeleton))
    angle = np.radians(start + degrees * np.sin(phase))
    rotations[:, skeleton.joint(role)] = quat.from_axis_angle(np.array([0.0, 0.0, 1.0]), angle)
    return MotionClip(skeleton, rotations, np.tile([0.0, 1.0, 0.0], (len(phase), 1)), 60.0)


@pytest.mark.parametrize("fps", [30.0, 60.0, 120.0])
def test_jerk_of_a_sinusoid(fps: float) -> None:
    hertz, amplitude = 1.0, 0.2
    omega = 2.0 * np.pi * hertz
    # A third difference over h multiplies a sinusoid by (2 sin(omega h / 2) / h)^3, which tends to omega^3.
    gain = (2.0 * np.sin(0.5 * omega * STEP) / STEP) ** 3
    expected = amplitude * gain * 2.0 / np.pi / BODY.leg_length
    assert mean_jerk(rocking(amplitude, hertz, fps=fps)) == pytest.approx(expected, rel=0.02)
    assert gain == pytest.approx(omega**3, rel=0.01)


def test_constant_acceleration_has_no_jerk() -> None:
    t = np.arange(100) / 60.0
    root = np.stack([t, 1.0 + 3.0 * t - 0.5 * GRAVITY * t**2, -(t**2)], axis=1)
    assert mean_jerk(MotionClip(BODY, quat.identity(100, len(BODY)), root, 60.0)) < 1e-6


def test_jerk_ratio_of_twice_the_amplitude_is_two() -> None:
    assert JerkRatio().compute(sample(rocking(0.2, 1.0), rocking(0.1, 1.0))) == pytest.approx(2.0)


def test_jerk_ratio_of_twice_the_tempo_is_eight() -> None:
    ratio = JerkRatio().compute(sample(rocking(0.1, 1.0), rocking(0.1, 0.5)))
    assert ratio == pytest.approx(8.0, rel=0.02)


def test_jerk_ratio_is_one_beside_itself_and_sees_smoothing_and_noise(rng: np.random.Generator) -> None:
    clip = walk(BODY)
    assert JerkRatio().compute(sample(clip, clip)) == 1.0
    noisy = clip.replace(root=clip.root + 0.005 * rng.standard_normal(clip.root.shape))
    assert JerkRatio().compute(sample(noisy, clip)) > 1.3
    still = clip.replace(
        rotations=quat.identity(len(clip), len(BODY)), root=np.repeat(clip.root[:1], len(clip), axis=0)
    )
    assert JerkRatio().compute(sample(still, clip)) < 1e-9


def test_jerk_ratio_without_a_moving_reference() -> None:
    still = rocking(0.0, 1.0)
    with pytest.raises(NotApplicableError, match="do not move"):
        JerkRatio().compute(sample(walk(BODY), still))
    # Retargeting and resampling hold a pose only to rounding, which a third difference multiplies.
    noise = 1e-15 * np.random.default_rng(1).standard_normal(still.root.shape)
    held = still.replace(root=still.root + noise)
    assert 0.0 < mean_jerk(held) < 1e-6
    with pytest.raises(NotApplicableError, match="do not move"):
        JerkRatio().compute(sample(walk(BODY), held))
    with pytest.raises(NotApplicableError, match="no real child clip"):
        JerkRatio().compute(sample(walk(BODY)))
    with pytest.raises(NotApplicableError, match="jerk needs 7 frames"):
        JerkRatio().compute(sample(walk(BODY).frames(0, 6), walk(BODY)))


def test_jerk_in_legs_does_not_depend_on_size() -> None:
    clip = walk(BODY)
    small = MotionClip(BODY.scaled(0.6), clip.rotations, 0.6 * clip.root, clip.fps)
    assert mean_jerk(small) == pytest.approx(mean_jerk(clip), rel=1e-9)


def test_jerk_and_speed_do_not_depend_on_the_frame_rate() -> None:
    clip = perform("wave", "adult", 1)
    slower = resample(clip, 30.0, lowpass=False)
    assert mean_jerk(slower) == pytest.approx(mean_jerk(clip), rel=0.03)
    assert mean_speed(slower) == pytest.approx(mean_speed(clip), rel=0.03)


def test_speed_of_a_glide() -> None:
    t = np.arange(60) / 60.0
    clip = MotionClip(BODY, quat.identity(60, len(BODY)), np.stack([3.0 * t, 1.0 + 0.0 * t, 4.0 * t], axis=1), 60.0)
    assert mean_speed(clip) == pytest.approx(5.0 / np.sqrt(GRAVITY * BODY.leg_length))


def test_speed_difference_is_to_the_median_of_the_references() -> None:
    speeds = [mean_speed(rocking(a, 1.0)) for a in (0.1, 0.2, 0.9)]
    clip = rocking(0.3, 1.0)
    value = SpeedDifference().compute(sample(clip, *(rocking(a, 1.0) for a in (0.1, 0.2, 0.9))))
    assert value == pytest.approx(mean_speed(clip) - speeds[1])


def test_speed_of_a_dynamically_scaled_figure_is_the_same() -> None:
    clip = walk(BODY, fps=48.0)
    small = MotionClip(BODY.scaled(0.64), clip.rotations, 0.64 * clip.root, 60.0)
    # The fixed time step is two frames of either clip.
    assert mean_speed(small) == pytest.approx(mean_speed(clip), rel=1e-6)


@pytest.mark.parametrize("degrees", [10.0, 45.0, 80.0])
@pytest.mark.parametrize(
    ("role", "start"), [("left_elbow", 80.0), ("right_knee", 80.0), ("left_shoulder", 0.0), ("right_hip", 0.0)]
)
def test_range_is_twice_the_amplitude(role: str, start: float, degrees: float) -> None:
    ranges = ranges_of_motion(bending(degrees, role, start=start))
    assert ranges.pop(role) == pytest.approx(2.0 * degrees, rel=0.01)
    assert all(angle < 1e-4 for angle in ranges.values())


def test_range_of_the_trunk() -> None:
    assert ranges_of_motion(bending(20.0, "hips"))["trunk"] == pytest.approx(40.0, rel=0.01)


def test_range_does_not_see_the_twist_of_a_limb(rng: np.random.Generator) -> None:
    clip = bending(30.0, start=60.0)
    rotations = clip.rotations.copy()
    upper, lower = BODY.joints("left_shoulder", "left_elbow")
    twist = quat.from_axis_angle(np.array([1.0, 0.0, 0.0]), rng.uniform(-np.pi, np.pi, len(clip)))
    rotations[:, upper] = quat.mul(rotations[:, upper], twist)
    rotations[:, lower] = quat.mul(quat.inverse(twist), rotations[:, lower])
    turned, plain = ranges_of_motion(clip.replace(rotations=rotations)), ranges_of_motion(clip)
    assert turned == pytest.approx(plain, abs=1e-4)


def test_range_of_motion_difference_is_the_mean_over_joints() -> None:
    clip, real = bending(40.0, start=50.0), bending(25.0, start=50.0)
    value = RangeOfMotionDifference().compute(sample(clip, real))
    assert value == pytest.approx(30.0 / 9.0, rel=0.01)


def test_range_of_motion_of_itself() -> None:
    clip = walk(BODY)
    assert RangeOfMotionDifference().compute(sample(clip, clip)) == 0.0


def test_range_of_motion_without_references() -> None:
    with pytest.raises(NotApplicableError, match="no real child clip"):
        RangeOfMotionDifference().compute(sample(walk(BODY)))


def test_references_without_a_value_do_not_count() -> None:
    def value(clip: MotionClip) -> float:
        if len(clip) < 10:
            raise NotApplicableError("too short")
        return float(len(clip))

    clip = walk(BODY)
    given = sample(clip, clip.frames(0, 5), clip.frames(0, 20), clip.frames(0, 40))
    assert over_references(given, value) == 30.0
    with pytest.raises(NotApplicableError, match="no reference has a value: too short"):
        over_references(sample(clip, clip.frames(0, 5)), value)


def test_values_are_kept_per_clip_and_no_longer_than_it_lives() -> None:
    calls = []

    @per_clip
    def count(clip: MotionClip) -> int:
        calls.append(1)
        return len(calls)

    clip = walk(BODY, seconds=0.5)
    assert (count(clip), count(clip), count(clip.frames(0, 3))) == (1, 1, 2)
    gone = weakref.ref(clip)
    del clip
    gc.collect()
    assert gone() is None


@pytest.mark.parametrize(("order", "expected"), [(1, 2.0), (2, 0.0)])
@pytest.mark.parametrize("fps", [24.0, 30.0, 60.0, 120.0])
def test_differences_are_derivatives(order: int, expected: float, fps: float) -> None:
    values = 2.0 * np.arange(50)[:, None] / fps
    assert difference(values, fps, order) == pytest.approx(expected, abs=1e-9)


def test_wave_is_faster_with_a_larger_swing() -> None:
    assert mean_speed(wave(BODY, swing=0.8)) > mean_speed(wave(BODY, swing=0.4))


def test_ratios_keep_the_sign() -> None:
    slow, fast = rocking(0.1, 1.0), rocking(0.2, 1.0)
    assert SpeedRatio().compute(sample(fast, slow)) == pytest.approx(2.0)
    assert SpeedRatio().compute(sample(slow, fast)) == pytest.approx(0.5)
    small, large = bending(15.0), bending(30.0)
    # Both elbows and shoulders, hips and knees, and the trunk: only one elbow moves.
    assert RangeOfMotionRatio().compute(sample(large, small)) == pytest.approx(2.0, rel=1e-3)
    assert RangeOfMotionRatio().compute(sample(small, large)) == pytest.approx(0.5, rel=1e-3)


def test_ratios_need_a_reference_that_moves() -> None:
    still = rocking(0.0, 1.0)
    for metric in (SpeedRatio(), RangeOfMotionRatio()):
        with pytest.raises(NotApplicableError, match="hardly"):
            metric.compute(sample(still, still))


def test_distance_to_real_clips_is_the_median_and_free_of_size_place_and_tempo() -> None:
    clip = walk(BODY)
    larger = walk(figure(0.9, trunk=0.5625, head=0.28125, arm=0.61875))
    assert ReferenceDistance().compute(sample(clip, clip)) == pytest.approx(0.0, abs=1e-6)
    moved = clip.replace(root=clip.root + [3.0, 0.0, 1.0])
    assert ReferenceDistance().compute(sample(moved, clip)) == pytest.approx(0.0, abs=1e-6)
    assert ReferenceDistance().compute(sample(clip, larger)) < 0.02
    bent, more = bending(15.0), bending(30.0)
    single = ReferenceDistance().compute(sample(bending(0.0), more))
    assert single > ReferenceDistance().compute(sample(bent, more)) > 0.0
    assert ReferenceDistance().compute(sample(bent, bent, more, bent)) == pytest.approx(0.0, abs=1e-6)


def test_a_reference_kept_for_one_skeleton_is_put_on_another_when_asked() -> None:
    reference, small, large = walk(BODY), walk(figure(0.5)), walk(figure(0.9, trunk=0.4))
    fresh = {clip: ReferenceDistance().compute(sample(clip, walk(BODY))) for clip in (small, large)}
    for clip in (small, large, small):
        assert ReferenceDistance().compute(sample(clip, reference)) == fresh[clip]
