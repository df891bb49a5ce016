"""Rotations from positions: exact on rigid figures, near on noisy ones, steady everywhere."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.errors import ContractError
from benchmark.motion import ik, quat
from benchmark.motion.ik import FOLD_CONE, aim_bones, match_directions, rotations_from_positions
from benchmark.motion.kinematics import fk
from benchmark.motion.skeleton import Skeleton

FIGURE = Skeleton(
    ("hips", "spine", "chest", "head", "arm", "forearm", "hand", "thigh", "shin", "foot", "thumb"),
    np.array([-1, 0, 1, 2, 2, 4, 5, 0, 7, 8, 5]),
    np.array(
        [
            [0.0, 0.0, 0.0],
            [0.0, 0.1, -0.02],
            [0.0, 0.35, 0.0],
            [0.0, 0.2, 0.05],
            [0.2, -0.05, 0.0],
            [0.28, 0.0, 0.0],
            [0.25, 0.0, 0.0],
            [0.1, -0.08, 0.01],
            [0.0, -0.42, 0.0],
            [0.0, -0.4, 0.0],
            [0.2, 0.05, 0.08],
        ]
    ),
)

ARM = Skeleton(("shoulder", "elbow", "wrist"), np.array([-1, 0, 1]), np.array([[0, 0, 0], [0.3, 0, 0], [0.25, 0, 0]]))


def wandering(rng: np.random.Generator, frames: int, joints: int, size: float) -> np.ndarray:
    """Smooth random local rotations (frames, joints, 4)."""
    time = np.linspace(0.0, 1.0, frames)[:, None, None]
    phase, amplitude = rng.uniform(0, 2 * np.pi, (joints, 3)), rng.normal(scale=size, size=(joints, 3))
    return quat.exp(amplitude * np.sin(2 * np.pi * time + phase))


def test_random_poses_are_met_exactly(rng: np.random.Generator) -> None:
    rotations = quat.normalize(rng.normal(size=(300, len(FIGURE), 4)))
    _, positions = fk(FIGURE, rotations, rng.normal(size=(300, 3)))
    found, root, residual = rotations_from_positions(FIGURE, positions)
    assert residual.max() < 1e-9
    assert np.abs(fk(FIGURE, found, root)[1] - positions).max() < 1e-9
    np.testing.assert_array_equal(root, positions[:, 0])


def test_joints_with_several_children_are_recovered_themselves(rng: np.random.Generator) -> None:
    rotations = quat.normalize(rng.normal(size=(200, len(FIGURE), 4)))
    _, positions = fk(FIGURE, rotations, np.zeros((200, 3)))
    found, _, _ = rotations_from_positions(FIGURE, positions)
    assert quat.angle(found[:, 0], rotations[:, 0]).max() < 1e-7, "the hips' three bones fix their rotation"


def test_rest_pose_gives_identity_rotations() -> None:
    _, positions = fk(FIGURE, quat.identity(3, len(FIGURE)), np.zeros((3, 3)))
    found, _, _ = rotations_from_positions(FIGURE, positions)
    assert quat.angle(found, quat.identity()).max() < 1e-7


def test_result_is_unit_and_continuous(rng: np.random.Generator) -> None:
    rotations = wandering(rng, 240, len(FIGURE), 0.7)
    _, positions = fk(FIGURE, rotations, np.zeros((240, 3)))
    found, _, residual = rotations_from_positions(FIGURE, positions)
    assert residual.max() < 1e-9
    np.testing.assert_allclose(np.linalg.norm(found, axis=-1), 1.0, atol=1e-12)
    assert np.sum(found[1:] * found[:-1], axis=-1).min() > 0.9


def test_noise_of_five_millimetres_leaves_a_residual_of_that_order(rng: np.random.Generator) -> None:
    rotations = wandering(rng, 400, len(FIGURE), 0.5)
    _, positions = fk(FIGURE, rotations, np.zeros((400, 3)))
    noisy = positions + rng.normal(scale=0.005, size=positions.shape)
    _, _, residual = rotations_from_positions(FIGURE, noisy)
    assert 0.002 < np.median(residual[:, 1:]) < 0.02
    assert residual.max() < 0.08


def test_residual_is_the_distance_to_the_measured_joints(rng: np.random.Generator) -> None:
    positions = fk(FIGURE, wandering(rng, 20, len(FIGURE), 0.5), np.zeros((20, 3)))[1] * 1.1
    found, root, residual = rotations_from_positions(FIGURE, positions)
    np.testing.assert_allclose(residual, np.linalg.norm(fk(FIGURE, found, root)[1] - positions, axis=-1), atol=1e-12)
    # Bones 10 % too long: a chain's tip is off by a tenth of its reach, at most.
    assert residual[:, 1] == pytest.approx(0.1 * FIGURE.bone_lengths[1], rel=1e-6)


def test_longer_bones_count_more(rng: np.random.Generator) -> None:
    """Three bones that no rotation fits: the long one is met more nearly than it would be among equals."""
    offsets = np.array([[0, 0, 0], [1.0, 0, 0], [0, 0.1, 0], [0, 0, 0.1]])
    figure = Skeleton(("a", "b", "c", "d"), np.array([-1, 0, 0, 0]), offsets)
    bent = offsets + np.array([[0, 0, 0], [0, 0.3, 0], [0, 0, 0.03], [0, 0.03, 0]])
    found, _, _ = rotations_from_positions(figure, bent[None])
    equal = match_directions(offsets[1:], bent[1:])
    target = bent[1] / np.linalg.norm(bent[1])
    missed = [np.linalg.norm(quat.rotate(q, [1.0, 0.0, 0.0]) - target) for q in (found[0, 0], equal)]
    assert missed[0] < 0.5 * missed[1]


def test_straight_limb_is_exact_and_steady(rng: np.random.Generator) -> None:
    # A straight arm swinging: no bend, so nothing says how it is twisted.
    swing = np.linspace(-1.2, 1.2, 121)
    rotations = quat.identity(121, 3)
    rotations[:, 0] = quat.from_axis_angle([0.0, 0.0, 1.0], swing)
    _, positions = fk(ARM, rotations, np.zeros((121, 3)))
    found, _, residual = rotations_from_positions(ARM, positions + rng.normal(scale=1e-6, size=positions.shape))
    assert residual.max() < 1e-5
    assert quat.angle(found[1:], found[:-1]).max() < np.radians(1.2), "a straight elbow must not spin"
    np.testing.assert_allclose(found[:, 0], rotations[:, 0] * np.sign(rotations[:1, 0, :1]), atol=1e-4)


@pytest.mark.parametrize("miss", [0.0, 1e-9, 1e-3, 0.02, 0.2])
def test_no_flip_when_a_bone_passes_the_opposite_of_its_rest(miss: float) -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 241)
    direction = np.stack([np.cos(angle), np.sin(angle), np.full_like(angle, miss)], axis=-1)
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    positions = np.zeros((241, 3, 3))
    positions[:, 1] = 0.3 * direction
    positions[:, 2] = 0.55 * direction
    found, _, residual = rotations_from_positions(ARM, positions)
    assert residual.max() < 1e-9
    step = quat.angle(found[1:, 0], found[:-1, 0]).max()
    shortest_arc = quat.between([1.0, 0.0, 0.0], direction)
    assert step < np.radians(12.0), np.degrees(step)
    outside = direction[:, 0] > -np.cos(FOLD_CONE)
    assert quat.angle(found[outside, 0], shortest_arc[outside]).max() < 1e-6, "outside the cone the pose alone decides"


def test_flip_test_would_catch_a_plain_shortest_arc() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 241)
    direction = np.stack([np.cos(angle), np.sin(angle), np.full_like(angle, 1e-3)], axis=-1)
    plain = quat.between([1.0, 0.0, 0.0], direction)
    assert quat.angle(plain[1:], plain[:-1]).max() > np.radians(12.0)


@pytest.mark.parametrize("part", ["start", "end", "all"])
def test_folded_bone_at_the_ends_of_a_clip(part: str) -> None:
    ramp = np.linspace(0.0, np.pi - 0.05, 60)
    angle = {"start": ramp[::-1], "end": ramp, "all": np.full(60, np.pi - 0.05)}[part]
    turn = np.linspace(0.0, 4.0, 60)
    direction = np.stack([np.cos(angle), np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn)], axis=-1)
    positions = np.stack([np.zeros((60, 3)), 0.3 * direction, 0.55 * direction], axis=1)
    found, _, residual = rotations_from_positions(ARM, positions)
    assert residual.max() < 1e-9
    inside = angle > np.pi - FOLD_CONE
    both = inside[1:] & inside[:-1]
    moved = np.arccos(np.clip(np.sum(direction[1:] * direction[:-1], axis=-1), -1, 1))
    assert np.all(quat.angle(found[1:, 0], found[:-1, 0])[both] <= moved[both] + 1e-6), (
        "no twist of its own inside the cone"
    )


def test_bone_without_length_leaves_its_joint_at_rest(rng: np.random.Generator) -> None:
    figure = Skeleton(("a", "b", "c"), np.array([-1, 0, 1]), np.array([[0, 0, 0], [0, 0, 0], [0.0, 0.3, 0.0]]))
    rotations = quat.identity(30, 3)
    rotations[:, 1] = quat.normalize(rng.normal(size=(30, 4)))
    _, positions = fk(figure, rotations, np.zeros((30, 3)))
    found, _, residual = rotations_from_positions(figure, positions)
    np.testing.assert_array_equal(found[:, 0], quat.identity(30))
    assert residual.max() < 1e-9


def test_children_along_one_line_are_matched_by_direction(rng: np.random.Generator) -> None:
    figure = Skeleton(("a", "b", "c"), np.array([-1, 0, 0]), np.array([[0, 0, 0], [0.0, 0.3, 0.0], [0.0, -0.2, 0.0]]))
    rotations = quat.identity(50, 3)
    rotations[:, 0] = wandering(rng, 50, 1, 0.6)[:, 0]
    _, positions = fk(figure, rotations, np.zeros((50, 3)))
    _, _, residual = rotations_from_positions(figure, positions)
    assert residual.max() < 1e-9


def test_measured_bones_that_vanish_are_survived() -> None:
    positions = np.zeros((4, 3, 3))
    found, _, residual = rotations_from_positions(ARM, positions)
    assert np.all(np.isfinite(found))
    assert residual[:, 1] == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("positions", "words"),
    [
        (np.zeros((4, 2, 3)), "shape"),
        (np.zeros((0, 3, 3)), "T > 0"),
        (np.zeros((3, 3)), "shape"),
        (np.full((4, 3, 3), np.nan), "nan at index"),
    ],
)
def test_wrong_positions_are_refused(positions: np.ndarray, words: str) -> None:
    with pytest.raises(ContractError, match=words):
        rotations_from_positions(ARM, positions)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(2, 6))
def test_wahba_recovers_the_rotation(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    q = quat.normalize(rng.normal(size=(20, 4)))
    rest = rng.normal(size=(20, count, 3))
    found = match_directions(rest, quat.rotate(q[:, None], rest), weights=rng.uniform(0.1, 1.0, (20, count)))
    unit = rest / np.linalg.norm(rest, axis=-1, keepdims=True)
    assert np.abs(quat.rotate(found[:, None], unit) - quat.rotate(q[:, None], unit)).max() < 1e-7


def test_wahba_is_the_least_squares_optimum(rng: np.random.Generator) -> None:
    rest, target, weights = rng.normal(size=(4, 3)), rng.normal(size=(4, 3)), rng.uniform(0.2, 1.0, 4)
    unit = [v / np.linalg.norm(v, axis=-1, keepdims=True) for v in (rest, target)]

    def loss(q: np.ndarray) -> np.ndarray:
        return np.sum(weights * np.sum((quat.rotate(q[..., None, :], unit[0]) - unit[1]) ** 2, axis=-1), axis=-1)

    best = match_directions(rest, target, weights=weights)
    others = quat.normalize(rng.normal(size=(20000, 4)))
    near = quat.mul(best, quat.exp(rng.normal(scale=0.05, size=(2000, 3))))
    assert loss(best) <= loss(others).min() + 1e-9
    assert loss(best) <= loss(near).min() + 1e-9


def test_wahba_agrees_with_the_singular_value_solution(rng: np.random.Generator) -> None:
    from scipy.spatial.transform import Rotation

    rest, target = rng.normal(size=(5, 3)), rng.normal(size=(5, 3))
    unit = [v / np.linalg.norm(v, axis=-1, keepdims=True) for v in (rest, target)]
    expected = Rotation.align_vectors(unit[1], unit[0])[0].as_quat(scalar_first=True)
    assert quat.angle(match_directions(rest, target), expected) < 1e-7


@pytest.mark.parametrize("noise", [0.0, 0.05, 0.5])
def test_wahba_without_lapack_agrees_with_davenport(noise: float, rng: np.random.Generator) -> None:
    turn = quat.exp(rng.normal(scale=0.5, size=(200, 1, 3)))
    rest = rng.normal(size=(200, 3, 3))
    rest /= np.linalg.norm(rest, axis=-1, keepdims=True)
    target = quat.rotate(turn, rest) + noise * rng.normal(size=rest.shape)
    target /= np.linalg.norm(target, axis=-1, keepdims=True)
    profile = np.einsum("nki,nkj->nij", target, rest) / 3.0
    found, sure = ik._quest(profile)
    assert sure.mean() > 0.5
    assert quat.angle(found, ik._davenport(profile))[sure].max() < 1e-12


def test_wahba_never_reflects(rng: np.random.Generator) -> None:
    rest = np.eye(3)
    found = match_directions(rest, rest * [-1.0, 1.0, 1.0])
    assert np.linalg.norm(found) == pytest.approx(1.0)
    assert np.linalg.det(quat.rotate(found, np.eye(3))) == pytest.approx(1.0)


def test_aiming_at_where_bones_already_point_changes_nothing(rng: np.random.Generator) -> None:
    rotations = wandering(rng, 60, len(FIGURE), 0.6)
    _, positions = fk(FIGURE, rotations, rng.normal(size=(60, 3)))
    # Only directions count: another size and place are the same wish.
    aimed = aim_bones(FIGURE, rotations, 3.0 * positions + [1.0, 2.0, 3.0])
    assert quat.angle(aimed, rotations).max() < 1e-6


def test_aimed_bones_point_where_they_should_and_keep_their_twist(rng: np.random.Generator) -> None:
    start, wish = wandering(rng, 60, len(ARM), 0.5), wandering(rng, 60, len(ARM), 0.5)
    _, positions = fk(ARM, wish, np.zeros((60, 3)))
    aimed = aim_bones(ARM, start, positions)
    _, reached = fk(ARM, aimed, np.zeros((60, 3)))
    assert np.abs(reached - positions).max() < 1e-9
    world, _ = fk(ARM, aimed, np.zeros((60, 3)))
    before, _ = fk(ARM, start, np.zeros((60, 3)))
    bone = quat.rotate(before[:, 0], ARM.offsets[1])
    # The shoulder has turned by the shortest arc: about an axis square to the bone.
    turn = quat.log(quat.mul(world[:, 0], quat.inverse(before[:, 0])))
    assert np.abs(np.einsum("ti,ti->t", turn, bone)).max() < 1e-9
    # Ends of chains keep their own rotation.
    np.testing.assert_allclose(quat.angle(aimed[:, 2], start[:, 2]), 0.0, atol=1e-7)


def test_aiming_at_random_poses_of_a_body_meets_them(rng: np.random.Generator) -> None:
    wish = wandering(rng, 80, len(FIGURE), 0.8)
    _, positions = fk(FIGURE, wish, np.zeros((80, 3)))
    aimed = aim_bones(FIGURE, wandering(rng, 80, len(FIGURE), 0.8), positions)
    assert np.abs(fk(FIGURE, aimed, np.zeros((80, 3)))[1] - positions).max() < 1e-9


def test_bones_of_no_wanted_length_stay_as_they_are(rng: np.random.Generator) -> None:
    start = wandering(rng, 10, len(ARM), 0.5)
    aimed = aim_bones(ARM, start, np.zeros((10, 3, 3)))
    assert quat.angle(aimed, start).max() < 1e-9


def test_aiming_refuses_what_does_not_fit() -> None:
    rotations = quat.identity(4, 3)
    with pytest.raises(ContractError, match=r"positions must have shape \(4, 3, 3\)"):
        aim_bones(ARM, rotations, np.zeros((5, 3, 3)))
    with pytest.raises(ContractError, match="nan at index"):
        aim_bones(ARM, rotations, np.full((4, 3, 3), np.nan))
