from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmark.api import NotApplicableError
from benchmark.commands.conformance.figures import figure, perform, walk
from benchmark.motion import quat
from benchmark.motion.clip import MotionClip
from benchmark.motion.resample import resample
from benchmark.motion.retarget import retarget
from eval.features.angles import ANGLE_NAMES, joint_angles
from eval.features.kinematic import KINEMATIC_NAMES, STEADY, kinematic_features, stabilised, window_spans
from eval.features.sequence import NOMINAL_LEG, SEQUENCE_NAMES, TIME_UNIT, pose_sequence

BODY = figure(0.8)
X, Y, Z = np.eye(3)


def still(seconds: float = 2.0, fps: float = 30.0) -> MotionClip:
    frames = round(seconds * fps)
    return MotionClip(BODY, quat.identity(frames, len(BODY)), np.tile([0.0, 1.0, 0.0], (frames, 1)), fps)


def turned(clip: MotionClip, role: str, axis: NDArray, angle: NDArray) -> MotionClip:
    """One joint turned about an axis by (T,) radians."""
    rotations = np.array(clip.rotations)
    joint = clip.skeleton.joint(role)
    rotations[:, joint] = quat.mul(rotations[:, joint], quat.from_axis_angle(axis, angle))
    return clip.replace(rotations=rotations)


def value(clip: MotionClip, name: str) -> float:
    features = kinematic_features(clip)
    assert len(features) == 1
    return float(features[0, KINEMATIC_NAMES.index(name)])


def channel(clip: MotionClip, name: str) -> NDArray:
    return pose_sequence(clip)[:, SEQUENCE_NAMES.index(name)]


def placed(clip: MotionClip) -> MotionClip:
    turn = quat.from_axis_angle(Y, np.array(2.1))
    rotations = np.array(clip.rotations)
    rotations[:, 0] = quat.mul(turn, rotations[:, 0])
    return clip.replace(rotations=rotations, root=quat.rotate(turn, clip.root) + [3.0, 0.0, -1.5])


def flipped(clip: MotionClip) -> MotionClip:
    sign = np.where(np.random.default_rng(6).random(clip.rotations.shape[:2]) < 0.5, -1.0, 1.0)
    return clip.replace(rotations=clip.rotations * sign[..., None])


def shrunk(clip: MotionClip) -> MotionClip:
    return MotionClip(clip.skeleton.scaled(0.7), clip.rotations, 0.7 * clip.root, clip.fps)


CHANGES = {"place and facing": placed, "quaternion signs": flipped, "size": shrunk}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
@pytest.mark.parametrize("action", ["walk", "wave", "jump"])
@pytest.mark.parametrize("describe", [kinematic_features, pose_sequence, joint_angles])
def test_nothing_but_the_motion_is_described(describe, action: str, change) -> None:
    clip = perform(action, "adult", 1)
    np.testing.assert_allclose(describe(change(clip)), describe(clip), rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("action", ["walk", "wave", "jump"])
def test_other_proportions_leave_nearly_the_same_features(action: str) -> None:
    clip = perform(action, "adult", 1)
    other = retarget(clip, figure(0.5, trunk=0.45, head=0.2, arm=0.3))
    ours, theirs = kinematic_features(other), kinematic_features(clip)
    assert np.abs(ours - theirs).max() < 0.02
    assert np.abs(theirs - kinematic_features(perform(action, "child", 1))).max() > 0.1


@pytest.mark.parametrize("action", ["walk", "wave", "jump"])
def test_the_frame_rate_hardly_matters(action: str) -> None:
    slow, fast = (kinematic_features(perform(action, "adult", 1, fps=fps)) for fps in (30.0, 60.0))
    np.testing.assert_allclose(slow, fast, rtol=0.05, atol=0.03)
    clip = perform(action, "adult", 1, fps=60.0)
    np.testing.assert_allclose(kinematic_features(resample(clip, 30.0)), kinematic_features(clip), rtol=1e-9, atol=1e-9)


def test_names_are_those_of_the_columns() -> None:
    clip = walk(BODY)
    assert kinematic_features(clip).shape[1] == len(KINEMATIC_NAMES) == len(set(KINEMATIC_NAMES)) == 40
    assert pose_sequence(clip).shape[1] == len(SEQUENCE_NAMES) == len(set(SEQUENCE_NAMES))
    assert joint_angles(clip).shape[1:] == (2, len(ANGLE_NAMES))


def test_values_are_kept_and_cannot_be_written_to() -> None:
    clip = walk(BODY)
    for describe in (kinematic_features, pose_sequence):
        assert describe(clip) is describe(clip)
        with pytest.raises(ValueError, match="read-only"):
            describe(clip)[0, 0] = 1.0


@pytest.mark.parametrize("fps", [30.0, 60.0])
def test_a_sequence_has_the_rate_asked_for(fps: float) -> None:
    clip = walk(BODY, seconds=3.0, fps=120.0)
    assert len(pose_sequence(clip, fps)) == pytest.approx(clip.duration * fps + 1, abs=1)


@pytest.mark.parametrize(("frames", "starts"), [(1, [0]), (60, [0]), (61, [0, 1]), (90, [0, 30]), (100, [0, 20, 40])])
def test_windows_reach_from_the_first_frame_to_the_last(frames: int, starts: list[int]) -> None:
    spans = window_spans(frames)
    assert [span.start for span in spans] == starts
    assert all(span.stop - span.start == 60 for span in spans)
    assert frames <= spans[-1].stop <= max(frames, 60)
    assert np.diff([0, *starts]).max() <= 30


def test_a_short_clip_is_one_window_and_a_shorter_one_none() -> None:
    clip = walk(BODY, seconds=2.0, fps=30.0)
    assert kinematic_features(clip.frames(0, 4)).shape == (1, 40)
    with pytest.raises(NotApplicableError, match="3 frames"):
        kinematic_features(clip.frames(0, 3))
    assert pose_sequence(clip.frames(0, 1)).shape == (1, len(SEQUENCE_NAMES))


def test_a_figure_that_stands_still() -> None:
    features = dict(zip(KINEMATIC_NAMES, kinematic_features(still())[0], strict=True))
    for name, number in features.items():
        if name.startswith(("speed", "range", "yaw", "vertical", "spectral", "synchrony", "twist")):
            assert number == pytest.approx(0.0, abs=1e-6), name
    assert features["log-jerk/arms"] == pytest.approx(-3.0)
    assert features["angle-mean/left-shoulder"] == pytest.approx(0.5 * np.pi)
    assert features["angle-mean/left-hip"] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("leg", [0.5, 0.9])
def test_speed_of_a_glide_is_in_legs(leg: float) -> None:
    skeleton = BODY.scaled(leg / BODY.leg_length)
    t = np.arange(60) / 30.0
    root = np.stack([0.0 * t, 1.0 + 0.0 * t, 1.5 * leg * t], axis=1)
    clip = MotionClip(skeleton, quat.identity(60, len(skeleton)), root, 30.0)
    assert value(clip, "speed-mean/hips") == pytest.approx(1.5 * TIME_UNIT)
    assert value(clip, "speed-sd/hips") == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(channel(clip, "hips/forward-velocity"), 1.5 * TIME_UNIT)
    np.testing.assert_allclose(channel(clip, "hips/left-velocity"), 0.0, atol=1e-9)
    assert pytest.approx(np.sqrt(NOMINAL_LEG / 9.81)) == TIME_UNIT


def test_turning_on_the_spot() -> None:
    clip = turned(still(), "hips", Y, 0.8 * np.arange(60) / 30.0)
    assert value(clip, "yaw-rate-rms/hips") == pytest.approx(0.8 * TIME_UNIT, rel=1e-6)
    np.testing.assert_allclose(channel(clip, "hips/yaw-rate"), 0.8 * TIME_UNIT, rtol=1e-6)
    assert value(clip, "speed-mean/left-arm") == pytest.approx(0.0, abs=1e-6)


def test_walking_backwards_is_seen() -> None:
    t = np.arange(60) / 30.0
    clip = still().replace(root=np.stack([0.0 * t, 1.0 + 0.0 * t, -t], axis=1))
    assert np.all(channel(placed(clip), "hips/forward-velocity") < 0.0)


@pytest.mark.parametrize("hertz", [1.0, 2.0, 4.0])
def test_a_waving_forearm(hertz: float) -> None:
    t = np.arange(60) / 30.0
    clip = turned(still(), "right_elbow", Z, -1.0 + 0.6 * np.sin(2.0 * np.pi * hertz * t + 0.3))
    # Sampled at 30 frames a second the highest and lowest points fall between frames.
    assert value(clip, "range/right-elbow") == pytest.approx(1.2, rel=0.05)
    assert value(clip, "angle-mean/right-elbow") == pytest.approx(1.0, abs=1e-6)
    assert value(clip, "range/left-elbow") == pytest.approx(0.0, abs=1e-6)
    # The forearm of the common body is 0.297 leg long and turns by 0.6 * 2 pi f * 2 / pi on average.
    gain = np.sin(2.0 * np.pi * hertz / 30.0) / (2.0 * np.pi * hertz / 30.0)
    assert value(clip, "speed-mean/right-arm") == pytest.approx(
        0.146 / 0.491 * 0.6 * 4.0 * hertz * gain * TIME_UNIT, rel=0.05
    )
    # A direction that swings through an angle holds some of twice the frequency too.
    assert hertz <= value(clip, "spectral-centroid/arms") <= 1.35 * hertz


@pytest.mark.parametrize(("lag", "expected"), [(0.0, 1.0), (np.pi, -1.0), (0.5 * np.pi, 0.0)])
def test_synchrony_is_the_cosine_of_the_lag(lag: float, expected: float) -> None:
    phase = 2.0 * np.pi * np.arange(60) / 30.0
    clip = turned(still(), "left_hip", X, 0.4 * np.sin(phase))
    clip = turned(clip, "right_hip", X, 0.4 * np.sin(phase + lag))
    assert value(clip, "synchrony/legs") == pytest.approx(expected, abs=0.03)


def test_arm_and_leg_of_a_side_swing_against_one_another() -> None:
    assert kinematic_features(walk(BODY, arms=1.35))[:, KINEMATIC_NAMES.index("synchrony/legs")].max() < -0.5
    phase = 2.0 * np.pi * np.arange(60) / 30.0
    lowered = turned(turned(still(), "left_shoulder", Z, np.full(60, -1.35)), "left_hip", X, 0.4 * np.sin(phase))
    rotations = np.array(lowered.rotations)
    joint = BODY.joint("left_shoulder")
    rotations[:, joint] = quat.mul(quat.from_axis_angle(X, -0.4 * np.sin(phase)), rotations[:, joint])
    assert value(lowered.replace(rotations=rotations), "synchrony/arm-leg") == pytest.approx(-1.0, abs=0.02)


def test_jerk_rises_with_the_cube_of_the_tempo() -> None:
    t = np.arange(60) / 30.0
    slow, fast = (turned(still(), "left_knee", X, 0.5 + 0.3 * np.sin(2.0 * np.pi * f * t)) for f in (0.5, 1.0))
    rise = value(fast, "log-jerk/legs") - value(slow, "log-jerk/legs")
    assert rise == pytest.approx(3.0 * np.log10(2.0), abs=0.15)


def angle(clip: MotionClip, side: str, name: str) -> float:
    return float(joint_angles(clip)[0, ("left", "right").index(side), ANGLE_NAMES.index(name)])


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_knee_bends_backward(side: str) -> None:
    bent = turned(still(), f"{side}_knee", X, np.full(60, 0.7))
    assert angle(bent, side, "knee-bend") == pytest.approx(0.7)
    assert angle(bent, side, "knee-forward") == pytest.approx(-0.7)
    assert angle(turned(still(), f"{side}_knee", X, np.full(60, -0.2)), side, "knee-forward") == pytest.approx(0.2)
    raised = turned(bent, f"{side}_hip", X, np.full(60, -1.5))
    assert angle(raised, side, "knee-forward") == pytest.approx(-0.7)
    assert angle(raised, side, "hip-to-forward") == pytest.approx(0.5 * np.pi - 1.5)


@pytest.mark.parametrize(("side", "sign"), [("left", 1.0), ("right", -1.0)])
def test_angles_of_shoulder_and_trunk_are_mirrored(side: str, sign: float) -> None:
    clip = turned(still(), f"{side}_shoulder", Z, np.full(60, -0.9 * sign))
    assert angle(clip, side, "shoulder-to-outwards") == pytest.approx(0.9)
    assert angle(clip, side, "shoulder-to-up") == pytest.approx(0.5 * np.pi + 0.9)
    twisted = turned(still(), "spine", Y, np.full(60, 0.4 * sign))
    assert angle(twisted, side, "trunk-twist") == pytest.approx(0.4, abs=1e-6)


def test_square_roots_are_of_speeds_and_rates_alone() -> None:
    features = kinematic_features(walk(BODY))
    names = [KINEMATIC_NAMES[index] for index in STEADY]
    for name, before, after in zip(names, features.T[list(STEADY)], stabilised(features).T, strict=True):
        fast = name.split("/")[0] in ("speed-mean", "speed-sd", "vertical-speed-rms", "yaw-rate-rms")
        np.testing.assert_allclose(after, np.sqrt(before) if fast else before, err_msg=name)


def test_what_is_compared_leaves_out_what_noise_decides() -> None:
    left_out = {name.split("/")[0] for index, name in enumerate(KINEMATIC_NAMES) if index not in STEADY}
    assert left_out == {"log-jerk", "spectral-centroid"}


@pytest.mark.real_data
def test_smoothing_a_capture_hardly_moves_what_is_compared(real_data) -> None:
    from benchmark.data.catalog import open_dataset
    from benchmark.motion.resample import low_pass

    data = open_dataset("kinder-gator", root=real_data)
    clips = {
        style: [data.load(r.clip_id) for r in data.records if r.style == style][::6] for style in ("adult", "child")
    }
    adult, child = (np.concatenate([stabilised(kinematic_features(c)) for c in found]) for found in clips.values())
    smooth = np.concatenate([stabilised(kinematic_features(low_pass(clip, 6.0))) for clip in clips["child"]])
    spread = child.std(axis=0)
    moved = np.abs((smooth - child) / spread).mean()
    apart = np.abs((adult.mean(axis=0) - child.mean(axis=0)) / spread).mean()
    assert moved < 0.25 * apart


@pytest.mark.real_data
def test_a_real_clip_of_a_child_has_finite_features(real_data) -> None:
    from benchmark.data.catalog import open_dataset

    data = open_dataset("kinder-gator", root=real_data)
    clip = data.load(next(record.clip_id for record in data.records if record.style == "child"))
    assert np.all(np.isfinite(kinematic_features(clip)))
    assert np.all(np.isfinite(joint_angles(clip)))
