from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmark.api import FitContext, NotApplicableError, Sample, StyleTask
from benchmark.commands.conformance.figures import MEASURED_ACTIONS, SmallView, figure, perform, walk
from benchmark.errors import ContractError, StoreError
from benchmark.motion import quat
from benchmark.motion.clip import MotionClip
from benchmark.motion.resample import resample
from benchmark.motion.retarget import retarget
from eval.features.angles import ANGLE_NAMES, joint_angles
from eval.metrics.joints import JointLimitViolation, PoseJump
from eval.probes.limits import JointLimits

BODY = figure(0.8)
X, Y, Z = np.eye(3)
TASK = StyleTask("adult", "child")
CLIPS = tuple(
    perform(action, style, take) for action in MEASURED_ACTIONS for style in ("adult", "child") for take in range(1, 5)
)


def fitted(clips: tuple[MotionClip, ...] = CLIPS) -> JointLimits:
    return JointLimits().fit(SmallView(clips), TASK, rng=np.random.default_rng(0), ctx=FitContext())


@pytest.fixture(scope="module")
def limits() -> JointLimits:
    return fitted()


def sample(clip: MotionClip, limits: JointLimits | None = None) -> Sample:
    probes = {} if limits is None else {"joint-limits": limits}
    return Sample(clip, clip, (), None, TASK, probes=probes)


def violation(clip: MotionClip, limits: JointLimits) -> float:
    return JointLimitViolation().compute(sample(clip, limits))


def bent(clip: MotionClip, role: str, axis: np.ndarray, angle: float) -> MotionClip:
    rotations = np.array(clip.rotations)
    joint = clip.skeleton.joint(role)
    rotations[:, joint] = quat.mul(rotations[:, joint], quat.from_axis_angle(axis, np.full(len(clip), angle)))
    return clip.replace(rotations=rotations)


def test_bounds_are_the_percentiles_of_both_sides_and_styles(limits: JointLimits) -> None:
    angles = np.concatenate([joint_angles(clip) for clip in CLIPS])
    for index in range(len(ANGLE_NAMES)):
        both = np.concatenate([angles[:, 0, index], angles[:, 1, index]])
        np.testing.assert_allclose(limits.bounds_[:, index], np.percentile(both, [0.5, 99.5]))
    assert np.all(limits.bounds_[0] <= limits.bounds_[1])


def test_training_motion_is_outside_by_one_percent_at_most(limits: JointLimits) -> None:
    frames = np.concatenate([limits.violations(clip) for clip in CLIPS])
    assert 0.0 < frames.mean() <= 0.0101
    assert violation(perform("walk", "child", 6), limits) < 0.05


def test_every_angle_of_every_frame_counts_once(limits: JointLimits) -> None:
    clip = perform("walk", "adult", 2)
    before = violation(clip, limits)
    broken = bent(clip, "left_knee", X, -2.5)
    share = 1.0 / (2 * len(ANGLE_NAMES))
    # The bend and the direction of one knee of two.
    assert violation(broken, limits) - before == pytest.approx(2 * share, abs=0.02)
    half = broken.replace(
        rotations=np.concatenate([clip.rotations[: len(clip) // 2], broken.rotations[len(clip) // 2 :]])
    )
    assert violation(half, limits) - before == pytest.approx(share, abs=0.02)


@pytest.mark.parametrize(
    ("role", "axis", "angle"),
    [
        ("right_knee", X, -0.9),
        ("left_elbow", Z, 2.9),
        ("right_shoulder", Z, -1.5),
        ("left_hip", Z, 1.2),
        ("spine", Y, 1.2),
    ],
)
def test_impossible_poses_are_seen(limits: JointLimits, role: str, axis: np.ndarray, angle: float) -> None:
    clip = perform("walk", "adult", 2)
    assert violation(bent(clip, role, axis, angle), limits) > violation(clip, limits) + 0.02


def test_a_mirrored_figure_violates_as_much(limits: JointLimits) -> None:
    clip = perform("walk", "adult", 2)
    left, right = (bent(clip, f"{side}_knee", X, -2.5) for side in ("left", "right"))
    assert violation(left, limits) == pytest.approx(violation(right, limits), abs=0.01)


def test_limits_do_not_depend_on_place_size_signs_and_frame_rate(limits: JointLimits) -> None:
    clip = bent(perform("jump", "adult", 2), "right_knee", X, -0.6)
    value = violation(clip, limits)
    assert value > 0.0
    small = MotionClip(clip.skeleton.scaled(0.6), clip.rotations, 0.6 * clip.root, clip.fps)
    turn = quat.from_axis_angle(Y, np.array(-0.7))
    rotations = -np.array(clip.rotations)
    rotations[:, 0] = quat.mul(turn, rotations[:, 0])
    turned = clip.replace(rotations=rotations, root=quat.rotate(turn, clip.root) + [1.0, 0.0, 2.0])
    for other in (small, turned, resample(clip, 30.0)):
        assert violation(other, limits) == pytest.approx(value, abs=0.004)
    assert violation(retarget(clip, figure(0.5, arm=0.3)), limits) == pytest.approx(value, abs=0.03)


def test_the_share_outside_of_planted_bounds(rng: np.random.Generator) -> None:
    """A knee bent by every angle from 0 to 100 degrees equally often: bounds 1.5 degrees in, half a degree of margin."""
    frames = 2001
    rotations = quat.identity(frames, len(BODY))
    for side in ("left", "right"):
        angles = np.radians(rng.permutation(np.linspace(0.0, 100.0, frames)))
        rotations[:, BODY.joint(f"{side}_knee")] = quat.from_axis_angle(X, angles)
    clip = MotionClip(BODY, rotations, np.tile([0.0, 1.0, 0.0], (frames, 1)), 30.0)
    probe = JointLimits()
    probe.bounds_ = np.percentile(joint_angles(clip).reshape(-1, len(ANGLE_NAMES)), [1.5, 98.5], axis=0)
    knee = probe.violations(clip)[..., ANGLE_NAMES.index("knee-bend")]
    assert knee.mean() == pytest.approx(0.02, abs=0.002)


def test_saved_and_loaded_limits_are_the_same(limits: JointLimits, tmp_path) -> None:
    limits.save(tmp_path / "probe")
    np.testing.assert_array_equal(JointLimits.load(tmp_path / "probe").bounds_, limits.bounds_)
    with pytest.raises(StoreError, match="no probe"):
        JointLimits.load(tmp_path)
    np.testing.assert_array_equal(fitted().bounds_, limits.bounds_)


def test_what_limits_need() -> None:
    with pytest.raises(NotApplicableError, match="no training motion"):
        fitted(())
    with pytest.raises(ContractError, match="not JointLimits"):
        JointLimitViolation().compute(replace(sample(walk(BODY)), probes={"joint-limits": object()}))


@pytest.mark.parametrize("degrees", [5.0, 45.0, 170.0])
@pytest.mark.parametrize("fps", [30.0, 60.0])
def test_a_planted_jump_is_found(degrees: float, fps: float) -> None:
    frames = 60
    rotations = quat.identity(frames, len(BODY))
    joint = BODY.joint("left_elbow")
    rotations[30:, joint] = -quat.from_axis_angle(X, np.radians(degrees))
    clip = MotionClip(BODY, rotations, np.tile([0.0, 1.0, 0.0], (frames, 1)), fps)
    assert PoseJump().compute(sample(clip)) == pytest.approx(degrees)


@pytest.mark.parametrize("fps", [30.0, 60.0, 120.0])
def test_a_steady_turn_has_the_same_step_at_any_frame_rate(fps: float) -> None:
    t = np.arange(round(2.0 * fps)) / fps
    rotations = quat.identity(len(t), len(BODY))
    rotations[:, 0] = quat.from_axis_angle(Y, np.radians(90.0) * t)
    clip = MotionClip(BODY, rotations, np.tile([0.0, 1.0, 0.0], (len(t), 1)), fps)
    assert PoseJump().compute(sample(clip)) == pytest.approx(3.0)


def test_joints_that_move_nothing_do_not_count() -> None:
    skeleton = figure(0.8)
    bare = type(skeleton)(skeleton.names, skeleton.parents, skeleton.offsets, (), roles=dict(skeleton.roles))
    rotations = quat.identity(20, len(bare))
    rotations[10:, bare.joint("left_hand")] = quat.from_axis_angle(X, 2.0)
    clip = MotionClip(bare, rotations, np.tile([0.0, 1.0, 0.0], (20, 1)), 30.0)
    assert PoseJump().compute(sample(clip)) == pytest.approx(0.0, abs=1e-6)


def test_a_single_frame_has_no_jump() -> None:
    clip = walk(BODY)
    assert PoseJump().compute(sample(clip.frames(0, 3))) > 0.0
    with pytest.raises(NotApplicableError, match="too few"):
        PoseJump().compute(sample(clip.frames(0, 2)))
