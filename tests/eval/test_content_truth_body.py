from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmark.api import NotApplicableError, Sample, StyleTask
from benchmark.commands.conformance.figures import ADULT, CHILD, figure, perform, walk, wave
from benchmark.motion import quat
from benchmark.motion.clip import MotionClip
from benchmark.motion.resample import resample, sample_at
from benchmark.motion.retarget import retarget
from eval.metrics.body import BoneLengthError
from eval.metrics.content import PoseDistance, TrajectoryDeviation, compared_joints
from eval.metrics.truth import TruthPoseDistance

BODY = figure(0.8)
UP = np.array([0.0, 1.0, 0.0])


def sample(clip: MotionClip, source: MotionClip, *, truth: MotionClip | None = None, **changes) -> Sample:
    return Sample(clip, source, (), truth, StyleTask("adult", "child", changes.pop("skeleton", None)), **changes)


def turned(clip: MotionClip, angle: float, by=(2.0, 0.0, -3.0)) -> MotionClip:
    turn = quat.from_axis_angle(UP, np.array(angle))
    rotations = clip.rotations.copy()
    rotations[:, 0] = quat.normalize(quat.mul(turn, rotations[:, 0]))
    return clip.replace(rotations=rotations, root=quat.rotate(turn, clip.root) + np.array(by))


def warped(clip: MotionClip, power: float = 1.3) -> tuple[MotionClip, np.ndarray]:
    times = clip.duration * np.linspace(0.0, 1.0, 2 * len(clip)) ** power
    return sample_at(clip, times, fps=clip.fps), times


@pytest.mark.parametrize("metric", [PoseDistance, TrajectoryDeviation])
def test_a_copy_is_at_no_distance(metric) -> None:
    clip = walk(BODY)
    assert metric().compute(sample(clip, clip)) == pytest.approx(0.0, abs=1e-12)
    assert metric().compute(sample(turned(clip, 2.5), clip)) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("metric", [PoseDistance, TrajectoryDeviation])
def test_a_retargeted_clip_is_at_no_distance(metric) -> None:
    source = walk(BODY)
    clip = retarget(source, perform("walk", CHILD, 1).skeleton)
    assert metric().compute(sample(clip, source)) == pytest.approx(0.0, abs=1e-5)


@pytest.mark.parametrize("degrees", [1.0, 20.0, 170.0])
def test_one_joint_turned_is_its_angle_over_the_joints(degrees: float) -> None:
    source = wave(BODY)
    rotations = source.rotations.copy()
    joint = BODY.joint("left_knee")
    rotations[:, joint] = quat.mul(
        rotations[:, joint], quat.from_axis_angle(np.array([0.6, 0.0, 0.8]), np.radians(degrees))
    )
    value = PoseDistance().compute(sample(source.replace(rotations=rotations), source))
    assert value == pytest.approx(degrees / len(compared_joints(BODY)), rel=1e-6)


def test_joints_that_move_nothing_do_not_count() -> None:
    bare = figure(0.8)
    skeleton = bare.with_offsets(bare.offsets, ())
    leaves = {bare.joint(role) for role in ("head", "left_hand", "right_hand", "left_toe", "right_toe")}
    assert set(compared_joints(bare)) - set(compared_joints(skeleton)) == leaves


def test_the_root_counts_but_not_its_heading() -> None:
    source = wave(BODY)
    bent = source.rotations.copy()
    bent[:, 0] = quat.mul(quat.from_axis_angle(np.array([1.0, 0.0, 0.0]), np.radians(30.0)), bent[:, 0])
    value = PoseDistance().compute(sample(source.replace(rotations=bent), source))
    assert value == pytest.approx(30.0 / len(compared_joints(BODY)), rel=1e-6)


def test_timing_does_not_count_as_content() -> None:
    source = wave(BODY, tempo=1.0)
    clip, _ = warped(source)
    straight = PoseDistance().compute(sample(wave(BODY, tempo=1.0, swing=0.9), source))
    assert PoseDistance().compute(sample(clip, source)) < 0.15 * straight


def test_pose_distance_grows_with_the_difference() -> None:
    source = wave(BODY)
    values = [PoseDistance().compute(sample(wave(BODY, swing=s), source)) for s in (0.5, 0.6, 0.8, 1.2)]
    assert values == sorted(values)
    assert values[0] == 0.0


def test_pose_distance_does_not_depend_on_the_frame_rate() -> None:
    source, clip = perform("walk", ADULT, 1), perform("walk", ADULT, 2)
    fine = PoseDistance().compute(sample(clip, source))
    coarse = PoseDistance().compute(sample(resample(clip, 30.0, lowpass=False), resample(source, 30.0, lowpass=False)))
    assert coarse == pytest.approx(fine, rel=0.02)


def line(length: float, frames: int = 61, *, skeleton=BODY, side: float = 0.0) -> MotionClip:
    t = np.linspace(0.0, 1.0, frames)
    root = np.stack([side * np.sin(np.pi * t), np.ones(frames), length * t], axis=1)
    return MotionClip(skeleton, quat.identity(frames, len(skeleton)), root, 60.0)


def test_trajectory_deviation_of_a_longer_line() -> None:
    value = TrajectoryDeviation().compute(sample(line(3.0), line(2.0)))
    assert value == pytest.approx(0.5 / BODY.leg_length)


def test_trajectory_deviation_of_a_scaled_figure_is_zero() -> None:
    small = BODY.scaled(0.5)
    assert TrajectoryDeviation().compute(sample(line(1.0, skeleton=small), line(2.0))) == pytest.approx(0.0, abs=1e-12)


def test_trajectory_deviation_follows_the_time_map() -> None:
    source = line(2.0, side=0.5)
    clip, times = warped(source)
    assert TrajectoryDeviation().compute(sample(clip, source, time_map=times)) < 2e-3
    assert TrajectoryDeviation().compute(sample(clip, source)) > 0.1


def test_trajectory_deviation_by_phase_where_frames_differ() -> None:
    assert TrajectoryDeviation().compute(sample(line(2.0, 31), line(2.0, 61))) == pytest.approx(0.0, abs=1e-9)


def test_trajectory_deviation_with_a_time_map_of_another_clip() -> None:
    with pytest.raises(NotApplicableError, match="time map"):
        TrajectoryDeviation().compute(sample(line(2.0), line(2.0), time_map=np.zeros(3)))


def test_truth_at_no_distance() -> None:
    clip = walk(BODY)
    assert TruthPoseDistance().compute(sample(clip, clip, truth=clip)) == 0.0
    assert TruthPoseDistance().compute(sample(turned(clip, 1.0), clip, truth=clip)) == pytest.approx(0.0, abs=1e-9)


def test_truth_does_not_see_size_or_timing() -> None:
    clip = wave(BODY)
    small = MotionClip(BODY.scaled(0.7), clip.rotations, 0.7 * clip.root, clip.fps)
    assert TruthPoseDistance().compute(sample(small, clip, truth=clip)) == pytest.approx(0.0, abs=1e-9)
    slower, _ = warped(clip)
    different = TruthPoseDistance().compute(sample(wave(BODY, swing=1.0), clip, truth=clip))
    assert TruthPoseDistance().compute(sample(slower, clip, truth=clip)) < 0.2 * different


def test_truth_does_not_see_proportions() -> None:
    clip = wave(BODY)
    other = retarget(clip, figure(0.6, trunk=0.5, arm=0.3))
    assert TruthPoseDistance().compute(sample(other, clip, truth=clip)) == pytest.approx(0.0, abs=1e-6)


def test_truth_of_a_raised_figure_is_the_height_in_legs() -> None:
    clip = wave(BODY)
    raised = clip.replace(root=clip.root + [0.0, 0.2, 0.0])
    assert TruthPoseDistance().compute(sample(raised, clip, truth=clip)) == pytest.approx(0.2 / BODY.leg_length)


def test_truth_unknown() -> None:
    clip = wave(BODY)
    with pytest.raises(NotApplicableError, match="truth"):
        TruthPoseDistance().compute(sample(clip, clip))


def test_bones_of_a_retargeted_clip() -> None:
    target = perform("walk", CHILD, 1).skeleton
    clip = retarget(walk(BODY), target)
    assert BoneLengthError().compute(sample(clip, walk(BODY), skeleton=target)) < 1e-9


def test_bones_of_another_body() -> None:
    clip = walk(BODY.scaled(1.2))
    assert BoneLengthError().compute(sample(clip, clip, skeleton=BODY)) == pytest.approx(0.2)


def test_a_bone_that_stretches_in_one_frame() -> None:
    clip = walk(BODY, seconds=1.0)
    translations = np.repeat(BODY.offsets[None], len(clip), axis=0)
    translations[17, BODY.joint("left_knee")] *= 1.07
    value = BoneLengthError().compute(sample(clip.replace(translations=translations), clip, skeleton=BODY))
    assert value == pytest.approx(0.07)


def test_bones_without_a_target_are_the_sources() -> None:
    clip = walk(BODY)
    assert BoneLengthError().compute(sample(clip, clip)) < 1e-9


def test_bones_of_a_real_performer() -> None:
    clip = walk(BODY.scaled(1.2))
    real = replace(sample(clip, clip, skeleton=BODY), copied_from="child/723/walk_1")
    with pytest.raises(NotApplicableError, match="own body"):
        BoneLengthError().compute(real)


def test_bones_of_other_joints() -> None:
    clip = walk(figure(0.8, roles="core"))
    with pytest.raises(NotApplicableError, match="other joints"):
        BoneLengthError().compute(sample(clip, clip, skeleton=BODY))
