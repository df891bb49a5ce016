"""Forward kinematics against the plain quaternion loop and against chains of 4x4 matrices."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from benchmark.errors import ContractError
from benchmark.motion import kinematics, quat
from benchmark.motion.skeleton import EndSite, Skeleton


def make_skeleton(joints: int, rng: np.random.Generator) -> Skeleton:
    parents = np.array([-1, *(rng.integers(0, joint) for joint in range(1, joints))])
    ends = tuple(EndSite(int(rng.integers(joints)), tuple(rng.normal(size=3))) for _ in range(3))
    return Skeleton(tuple(f"j{i}" for i in range(joints)), parents, rng.normal(size=(joints, 3)), ends)


def unit(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return quat.normalize(rng.normal(size=(*shape, 4)))


def plain(skeleton, rotations, root, translations=None):
    """Joint by joint with the quaternion functions."""
    world, positions = np.empty_like(rotations), np.empty((*rotations.shape[:-1], 3))
    world[..., 0, :], positions[..., 0, :] = rotations[..., 0, :], root
    for joint in range(1, len(skeleton)):
        parent = skeleton.parents[joint]
        offset = skeleton.offsets[joint] if translations is None else translations[..., joint, :]
        world[..., joint, :] = quat.mul(world[..., parent, :], rotations[..., joint, :])
        positions[..., joint, :] = positions[..., parent, :] + quat.rotate(world[..., parent, :], offset)
    return world, positions


def by_matrices(skeleton, rotations, root):
    """World 4x4 matrices (T, J, 4, 4) as products down the chain."""
    frames, joints = rotations.shape[:2]
    local = np.zeros((frames, joints, 4, 4))
    matrices = Rotation.from_quat(rotations.reshape(-1, 4)[:, [1, 2, 3, 0]]).as_matrix()
    local[..., :3, :3] = matrices.reshape(frames, joints, 3, 3)
    local[..., :3, 3] = skeleton.offsets
    local[:, 0, :3, 3] = root
    local[..., 3, 3] = 1.0
    world = local.copy()
    for joint in range(1, joints):
        world[:, joint] = world[:, skeleton.parents[joint]] @ local[:, joint]
    return world


@settings(max_examples=40, deadline=None)
@given(joints=st.integers(1, 40), frames=st.integers(1, 90), seed=st.integers(0, 2**32 - 1), moving=st.booleans())
def test_agrees_with_the_plain_loop(joints, frames, seed, moving):
    rng = np.random.default_rng(seed)
    skeleton, rotations, root = make_skeleton(joints, rng), unit(rng, frames, joints), rng.normal(size=(frames, 3))
    translations = rng.normal(size=(frames, joints, 3)) if moving else None
    got = kinematics.fk(skeleton, rotations, root, translations=translations)
    for ours, reference in zip(got, plain(skeleton, rotations, root, translations), strict=True):
        np.testing.assert_allclose(ours, reference, rtol=0, atol=1e-12)


@settings(max_examples=20, deadline=None)
@given(joints=st.integers(1, 30), seed=st.integers(0, 2**32 - 1))
def test_agrees_with_chains_of_matrices(joints, seed):
    rng = np.random.default_rng(seed)
    skeleton, rotations, root = make_skeleton(joints, rng), unit(rng, 7, joints), rng.normal(size=(7, 3))
    world, positions = kinematics.fk(skeleton, rotations, root)
    expected = by_matrices(skeleton, rotations, root)
    np.testing.assert_allclose(positions, expected[..., :3, 3], rtol=0, atol=1e-12)
    turned = Rotation.from_quat(world.reshape(-1, 4)[:, [1, 2, 3, 0]]).as_matrix()
    np.testing.assert_allclose(turned.reshape(7, joints, 3, 3), expected[..., :3, :3], rtol=0, atol=1e-12)


@pytest.mark.parametrize("frames", [1, 31, 32, 33, 100, 1371])
def test_blocks_of_frames_join_without_a_seam(rng, frames):
    skeleton, rotations, root = make_skeleton(24, rng), unit(rng, frames, 24), rng.normal(size=(frames, 3))
    expected = plain(skeleton, rotations, root)
    for ours, reference in zip(kinematics.fk(skeleton, rotations, root), expected, strict=True):
        np.testing.assert_allclose(ours, reference, rtol=0, atol=1e-12)


@pytest.mark.parametrize("lead", [(), (3,), (2, 4), (2, 0, 3)])
def test_any_leading_axes(rng, lead):
    skeleton, rotations, root = make_skeleton(9, rng), unit(rng, *lead, 9), rng.normal(size=(*lead, 3))
    translations = rng.normal(size=(*lead, 9, 3))
    for moved in (None, translations):
        got = kinematics.fk(skeleton, rotations, root, translations=moved)
        assert got[0].shape == (*lead, 9, 4)
        assert got[1].shape == (*lead, 9, 3)
        for ours, reference in zip(got, plain(skeleton, rotations, root, moved), strict=True):
            np.testing.assert_allclose(ours, reference, rtol=0, atol=1e-12)


def test_input_is_left_alone_and_may_lie_anyhow_in_memory(rng):
    skeleton = make_skeleton(11, rng)
    rotations, root = np.asfortranarray(unit(rng, 20, 11)), rng.normal(size=(40, 3))[::2]
    rotations.flags.writeable = root.flags.writeable = False
    before = rotations.copy(), root.copy()
    world, positions = kinematics.fk(skeleton, rotations, root)
    np.testing.assert_array_equal(rotations, before[0])
    np.testing.assert_array_equal(root, before[1])
    assert world.flags.writeable
    assert positions.flags.writeable
    assert not np.shares_memory(world, rotations)
    np.testing.assert_allclose(positions, plain(skeleton, *before)[1], rtol=0, atol=1e-12)
    single = kinematics.fk(skeleton, rotations.astype(np.float32), root)
    assert single[0].dtype == np.float64
    np.testing.assert_allclose(single[1], positions, atol=1e-5)


def test_bones_keep_their_length(rng):
    skeleton = make_skeleton(15, rng)
    positions = kinematics.fk(skeleton, unit(rng, 50, 15), rng.normal(size=(50, 3)))[1]
    lengths = np.linalg.norm(positions[:, 1:] - positions[:, skeleton.parents[1:]], axis=-1)
    np.testing.assert_allclose(lengths, np.broadcast_to(skeleton.bone_lengths[1:], lengths.shape), atol=1e-12)


def test_a_quarter_turn_worked_by_hand():
    skeleton = Skeleton(("a", "b", "c"), np.array([-1, 0, 1]), np.array([[9.0, 9, 9], [0, 1, 0], [2, 0, 0]]))
    quarter = quat.from_axis_angle([0.0, 0.0, 1.0], np.pi / 2)
    rotations = np.stack([quarter, quarter, quat.identity()])[None]
    world, positions = kinematics.fk(skeleton, rotations, np.array([[5.0, 0, 0]]))
    np.testing.assert_allclose(positions[0], [[5, 0, 0], [4, 0, 0], [2, 0, 0]], atol=1e-14)
    np.testing.assert_allclose(world[0, 2], [0, 0, 0, 1], atol=1e-14)


@pytest.mark.parametrize(
    ("rotations", "root", "translations", "message"),
    [
        ((5, 3, 4), (5, 3), None, r"rotations must have shape \(\.\.\., 4, 4\)"),
        ((4,), (3,), None, "rotations must have shape"),
        ((5, 4, 4), (6, 3), None, r"root must have shape \(5, 3\)"),
        ((5, 4, 4), (5, 3), (5, 3, 3), r"translations must have shape \(5, 4, 3\)"),
    ],
)
def test_shapes_that_do_not_fit_are_named(rng, rotations, root, translations, message):
    skeleton = make_skeleton(4, rng)
    moved = None if translations is None else np.zeros(translations)
    with pytest.raises(ContractError, match=message):
        kinematics.fk(skeleton, np.zeros(rotations), np.zeros(root), translations=moved)


def test_local_rotations_come_back_from_world_ones(rng):
    skeleton, rotations = make_skeleton(17, rng), unit(rng, 6, 17)
    world = kinematics.fk(skeleton, rotations, np.zeros((6, 3)))[0]
    np.testing.assert_allclose(kinematics.local_from_world(skeleton, world), rotations, atol=1e-12)


def test_end_sites_hang_on_their_joints(rng):
    skeleton, rotations, root = make_skeleton(8, rng), unit(rng, 6, 8), rng.normal(size=(6, 3))
    world, positions = kinematics.fk(skeleton, rotations, root)
    tips = kinematics.end_site_positions(skeleton, world, positions)
    matrices = by_matrices(skeleton, rotations, root)
    for index, end in enumerate(skeleton.end_sites):
        expected = matrices[:, end.parent] @ np.array([*end.offset, 1.0])
        np.testing.assert_allclose(tips[:, index], expected[:, :3], atol=1e-12)
    bare = Skeleton(("a",), np.array([-1]), np.zeros((1, 3)))
    assert kinematics.end_site_positions(bare, np.ones((2, 1, 4)), np.zeros((2, 1, 3))).shape == (2, 0, 3)


def test_velocity_of_a_parabola_is_exact():
    time = np.arange(12) / 30.0
    path = np.stack([3.0 * time, 4.0 * time**2], axis=-1)
    np.testing.assert_allclose(
        kinematics.velocities(path, 30.0), np.stack([np.full(12, 3.0), 8.0 * time], axis=-1), atol=1e-12
    )


def test_velocity_of_very_short_sequences():
    np.testing.assert_allclose(kinematics.velocities([[1.0], [3.0]], 10.0), [[20.0], [20.0]])
    np.testing.assert_array_equal(kinematics.velocities([[1.0, 2.0]], 10.0), [[0.0, 0.0]])
