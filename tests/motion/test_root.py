from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.errors import ContractError
from benchmark.motion import quat
from benchmark.motion.canonical import heading
from benchmark.motion.root import compose, decompose, from_features, join, split, turn_frames


@settings(max_examples=40, deadline=None)
@given(st.integers(2, 60), st.floats(1.0, 240.0), st.floats(0.0, 30.0), st.integers(0, 2**32 - 1))
def test_round_trip_of_any_path(frames, fps, reach, seed):
    rng = np.random.default_rng(seed)
    root, yaw = reach * rng.normal(size=(frames, 3)), np.cumsum(rng.uniform(-3, 3, size=frames))
    back, angles = compose(decompose(root, yaw, fps))
    np.testing.assert_allclose(back, root, atol=1e-9)
    np.testing.assert_allclose(angles, yaw, atol=1e-9)


def test_wrapped_yaw_gives_the_same_track():
    yaw = np.linspace(0, 12, 50)
    root = np.random.default_rng(0).normal(size=(50, 3))
    a, b = decompose(root, yaw, 30.0), decompose(root, np.angle(np.exp(1j * yaw)), 30.0)
    np.testing.assert_allclose(a.features, b.features, atol=1e-9)


def test_walking_a_circle_is_constant():
    """Radius 2 m at 0.5 rad/s, facing along the path: straight ahead at almost 1 m/s (the chord of each step)."""
    fps, time = 60.0, np.arange(200) / 60.0
    yaw = 0.5 * time
    root = np.stack([2 * (1 - np.cos(yaw)), np.full(200, 0.9), 2 * np.sin(yaw)], axis=-1)
    track = decompose(root, yaw, fps)
    chord = 4 * np.sin(0.25 / fps) * fps
    np.testing.assert_allclose(track.velocity, np.tile([0.0, chord], (200, 1)), atol=1e-9)
    np.testing.assert_allclose(track.yaw_rate, 0.5, atol=1e-9)


def test_facing_left_while_moving_forward():
    """Facing +X and moving towards +X is straight ahead; moving towards +Z is then to the right, which is negative x."""
    root = np.arange(5)[:, None] * np.array([[1.0, 0.0, 0.0]])
    np.testing.assert_allclose(decompose(root, np.full(5, np.pi / 2), 1.0).velocity, [[0.0, 1.0]] * 5, atol=1e-12)
    root = np.arange(5)[:, None] * np.array([[0.0, 0.0, 1.0]])
    np.testing.assert_allclose(decompose(root, np.full(5, np.pi / 2), 1.0).velocity, [[-1.0, 0.0]] * 5, atol=1e-12)


def test_start_and_facing_do_not_show_in_the_features(rng):
    root, yaw = rng.normal(size=(30, 3)), np.cumsum(rng.normal(size=30))
    turn = quat.from_axis_angle([0.0, 1.0, 0.0], 1.1)
    moved = quat.rotate(turn, root) + [3.0, 0.0, -7.0]
    np.testing.assert_allclose(
        decompose(root, yaw, 30.0).features, decompose(moved, yaw + 1.1, 30.0).features, atol=1e-9
    )


def test_features_make_the_track_again(rng):
    track = decompose(rng.normal(size=(9, 3)), rng.normal(size=9), 30.0)
    again = from_features(track.features, 30.0, start=track.start, start_yaw=track.start_yaw)
    np.testing.assert_array_equal(compose(again)[0], compose(track)[0])


def test_a_clip_is_split_and_joined_exactly(wild, rng):
    clip = wild(rng, 90)
    track, rotations = split(clip)
    back, root = join(track, rotations)
    np.testing.assert_allclose(root, clip.root, atol=1e-10)
    assert quat.angle(back, clip.rotations).max() < 1e-10
    # Played back without its heading the figure faces ahead.
    still = clip.replace(rotations=split(clip, sigma=0.0)[1])
    np.testing.assert_allclose(heading(still), 0.0, atol=1e-9)


def test_turned_frames_have_the_world_of_their_rotations(wild, rng):
    clip = wild(rng)
    yaw = rng.uniform(-3.0, 3.0, len(clip))
    unknown = turn_frames(clip, yaw)
    assert "world" not in unknown.__dict__
    assert clip.positions.shape == unknown.rotations.shape[:2] + (3,)
    known = turn_frames(clip, yaw)
    assert "world" in known.__dict__
    np.testing.assert_array_equal(known.rotations, unknown.rotations)
    np.testing.assert_allclose(known.positions, unknown.positions, atol=1e-12)
    np.testing.assert_allclose(known.world[0], unknown.world[0], atol=1e-12)


def test_bad_shapes_are_refused():
    with pytest.raises(ContractError, match="two frames"):
        decompose(np.zeros((1, 3)), np.zeros(1), 30.0)
    with pytest.raises(ContractError, match="shapes"):
        decompose(np.zeros((4, 2)), np.zeros(4), 30.0)
    with pytest.raises(ContractError, match="root features"):
        from_features(np.zeros((4, 3)), 30.0)
