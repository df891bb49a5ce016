from __future__ import annotations

import numpy as np
import pytest

from benchmark.commands.conformance.figures import figure, walk, wave
from benchmark.errors import SkeletonError
from benchmark.motion import quat
from benchmark.motion.clip import MotionClip
from benchmark.motion.pose import SEGMENTS, pose_positions, segment_directions
from benchmark.motion.retarget import retarget
from benchmark.motion.skeleton import CORE_ROLES

BODY = figure(0.8)


def turned(clip: MotionClip, angle: float) -> MotionClip:
    turn = quat.from_axis_angle(np.array([0.0, 1.0, 0.0]), np.array(angle))
    rotations = clip.rotations.copy()
    rotations[:, 0] = quat.mul(turn, rotations[:, 0])
    return clip.replace(rotations=rotations, root=quat.rotate(turn, clip.root) + [5.0, 0.0, -2.0])


@pytest.mark.parametrize("angle", [0.0, 1.0, 3.0, -2.0])
def test_poses_do_not_depend_on_place_and_facing(angle: float) -> None:
    clip = walk(BODY)
    for poses in (pose_positions, segment_directions):
        assert np.max(np.abs(poses(turned(clip, angle)) - poses(clip))) < 1e-9


def test_poses_of_a_larger_figure_are_the_same() -> None:
    clip = walk(BODY)
    large = MotionClip(BODY.scaled(1.7), clip.rotations, 1.7 * clip.root, clip.fps)
    assert np.max(np.abs(pose_positions(large) - pose_positions(clip))) < 1e-9


def test_directions_do_not_depend_on_proportions() -> None:
    # Trunks of other lengths lean the line from hips to head by nothing here: the figure stands upright.
    clip = wave(BODY)
    other = retarget(clip, figure(0.5, trunk=0.6, arm=0.3))
    assert np.max(np.abs(segment_directions(other) - segment_directions(clip))) < 1e-6


def test_heights_are_kept_and_in_leg_lengths() -> None:
    clip = wave(BODY)
    raised = clip.replace(root=clip.root + [0.0, 0.4, 0.0])
    gap = pose_positions(raised) - pose_positions(clip)
    assert gap[..., 1] == pytest.approx(0.4 / BODY.leg_length)
    assert gap[..., [0, 2]] == pytest.approx(0.0)


def test_forward_is_z_and_left_is_x() -> None:
    poses = pose_positions(turned(wave(BODY), 2.0), ("left_shoulder", "left_toe"))
    assert np.all(poses[:, 0, 0] > 0.1)
    assert np.all(poses[:, 1, 2] > 0.1)


def test_shapes_and_unit_length() -> None:
    clip = walk(BODY)
    assert pose_positions(clip).shape == (len(clip), len(CORE_ROLES), 3)
    directions = segment_directions(clip)
    assert directions.shape == (len(clip), len(SEGMENTS), 3)
    assert np.linalg.norm(directions, axis=-1) == pytest.approx(1.0)


def test_a_missing_role_is_named() -> None:
    with pytest.raises(SkeletonError, match="left_toe"):
        pose_positions(walk(figure(0.8, roles="core")), ("left_toe",))
