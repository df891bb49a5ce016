from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

from benchmark.motion import quat


def scipy_of(q: np.ndarray) -> Rotation:
    return Rotation.from_quat(np.asarray(q)[..., [1, 2, 3, 0]])


def random_quats(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return quat.normalize(rng.normal(size=(*shape, 4)))


def same_rotation(a: np.ndarray, b: np.ndarray, tolerance: float = 1e-14) -> bool:
    return bool(np.all(np.minimum(np.abs(a - b).max(-1), np.abs(a + b).max(-1)) < tolerance))


vectors = hnp.arrays(np.float64, 3, elements=st.floats(-1.0, 1.0))


def test_product_turns_as_scipy_does(rng: np.random.Generator) -> None:
    a, b, v = random_quats(rng, 50), random_quats(rng, 50), rng.normal(size=(50, 3))
    np.testing.assert_allclose(
        scipy_of(quat.mul(a, b)).as_matrix(), (scipy_of(a) * scipy_of(b)).as_matrix(), atol=1e-14
    )
    np.testing.assert_allclose(quat.rotate(a, v), scipy_of(a).apply(v), atol=1e-14)
    np.testing.assert_allclose(quat.inv_rotate(a, v), scipy_of(a).inv().apply(v), atol=1e-14)


def test_a_turn_about_the_vertical_is_the_quaternion_s(rng: np.random.Generator) -> None:
    yaw = rng.uniform(-4.0, 4.0, 6)
    turn = quat.from_axis_angle([0.0, 1.0, 0.0], yaw)
    for vectors, turns in ((rng.normal(size=(6, 3)), turn), (rng.normal(size=(6, 2, 5, 3)), turn[:, None, None])):
        np.testing.assert_allclose(quat.rotate_y(yaw, vectors), quat.rotate(turns, vectors), atol=1e-14)


def test_product_broadcasts(rng: np.random.Generator) -> None:
    a, b = random_quats(rng, 4, 1), random_quats(rng, 3)
    out = quat.mul(a, b)
    assert out.shape == (4, 3, 4)
    np.testing.assert_array_equal(out[2, 1], quat.mul(a[2, 0], b[1]))


def test_inv_mul_is_what_leads_from_a_to_b(rng: np.random.Generator) -> None:
    a, b = random_quats(rng, 20), random_quats(rng, 20)
    np.testing.assert_allclose(quat.mul(a, quat.inv_mul(a, b)), b, atol=1e-14)


def test_normalize_turns_nothing_into_the_identity() -> None:
    np.testing.assert_array_equal(quat.normalize([[0.0, 0, 0, 0], [0, 0, 3, 0]]), [[1.0, 0, 0, 0], [0, 0, 1, 0]])


@pytest.mark.parametrize("angle", [0.0, 1e-300, 1e-17, 1e-12, 9.9e-10, 1.1e-9, 1e-6, 1.0, np.pi - 1e-9, np.pi])
def test_exp_and_log_hold_from_zero_to_pi(angle: float) -> None:
    axis = np.array([2.0, -3.0, 6.0]) / 7.0
    q = quat.exp(angle * axis)
    np.testing.assert_allclose(q, scipy_of_rotvec(angle * axis), atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(q), 1.0, atol=1e-15)
    back = quat.log(q)
    if angle < 3.14:
        np.testing.assert_allclose(back, angle * axis, rtol=1e-14, atol=1e-300)
    else:
        assert min(np.abs(back - angle * axis).max(), np.abs(back + angle * axis).max()) < 1e-14
    np.testing.assert_allclose(np.abs(quat.log(-q)), np.abs(back), atol=1e-15)


def scipy_of_rotvec(v: np.ndarray) -> np.ndarray:
    return Rotation.from_rotvec(v).as_quat()[[3, 0, 1, 2]]


def test_log_is_never_longer_than_pi(rng: np.random.Generator) -> None:
    q = random_quats(rng, 2000)
    assert np.linalg.norm(quat.log(q), axis=-1).max() <= np.pi
    np.testing.assert_allclose(quat.log(q), scipy_of(q).as_rotvec(), atol=1e-13)


@settings(max_examples=50, deadline=None)
@given(vectors)
def test_exp_of_log_is_the_same_rotation(v: np.ndarray) -> None:
    q = quat.exp(4.0 * v)
    assert same_rotation(quat.exp(quat.log(q)), q)


def test_angle_is_accurate_where_the_arc_cosine_is_not() -> None:
    for size in (0.0, 1e-12, 1e-9, 1e-4, 2.0, np.pi - 1e-9):
        q = quat.from_axis_angle([0.0, 0.0, 1.0], size)
        for sign in (1.0, -1.0):
            np.testing.assert_allclose(quat.angle(quat.identity(), sign * q), size, rtol=1e-12, atol=1e-300)


def test_axis_angle_broadcasts() -> None:
    out = quat.from_axis_angle([0.0, 1.0, 0.0], np.array([0.0, np.pi]))
    np.testing.assert_allclose(out, [[1, 0, 0, 0], [0, 0, 1, 0]], atol=1e-16)


def test_between_turns_one_direction_onto_the_other(rng: np.random.Generator) -> None:
    a, b = rng.normal(size=(40, 3)), rng.normal(size=(40, 3))
    turned = quat.rotate(quat.between(a, b), a / np.linalg.norm(a, axis=-1, keepdims=True))
    np.testing.assert_allclose(turned, b / np.linalg.norm(b, axis=-1, keepdims=True), atol=1e-12)


def test_between_opposite_directions_is_half_a_turn() -> None:
    for a in np.vstack([np.eye(3), [[1.0, 2.0, -3.0]]]):
        q = quat.between(a, -a)
        np.testing.assert_allclose(quat.rotate(q, a), -a, atol=1e-12)
        np.testing.assert_allclose(quat.angle(quat.identity(), q), np.pi)


@pytest.mark.parametrize("off", [1e-3, 1e-5, 1e-6, 1e-7, 1e-9, 1e-12])
def test_between_nearly_opposite_directions_is_exact(rng: np.random.Generator, off: float) -> None:
    a = rng.normal(size=(40, 3))
    a /= np.linalg.norm(a, axis=-1, keepdims=True)
    aside = np.cross(a, rng.normal(size=(40, 3)))
    b = -np.cos(off) * a + np.sin(off) * aside / np.linalg.norm(aside, axis=-1, keepdims=True)
    q = quat.between(a, b)
    np.testing.assert_allclose(quat.rotate(q, a), b, atol=2e-15)
    np.testing.assert_allclose(np.linalg.norm(q, axis=-1), 1.0, atol=1e-15)


def test_between_of_nothing_is_the_identity() -> None:
    np.testing.assert_array_equal(quat.between([0.0, 0, 0], [0.0, 1, 0]), quat.identity())


def test_slerp_runs_evenly_along_the_short_arc(rng: np.random.Generator) -> None:
    a, b = random_quats(rng, 30), random_quats(rng, 30)
    whole = quat.angle(a, b)
    for t in (0.0, 0.25, 0.5, 1.0):
        np.testing.assert_allclose(quat.angle(a, quat.slerp(a, b, t)), t * whole, atol=1e-12)
        assert same_rotation(quat.slerp(a, b, t), quat.slerp(a, -b, t), 1e-12)


def test_slerp_of_nearly_equal_rotations_stays_between_them() -> None:
    a, b = quat.identity(), quat.exp([1e-8, 0.0, 0.0])
    np.testing.assert_allclose(quat.log(quat.slerp(a, b, 0.25)), [2.5e-9, 0, 0], rtol=1e-6)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-8, 3e-8, 1e-7, 1e-6, 1e-4, 0.01, 1.0, 3.0, np.pi - 1e-7])
def test_slerp_is_right_to_the_last_digit_at_any_angle(angle: float, rng: np.random.Generator) -> None:
    """Against the formula in extended precision, its angle from the chord; half a turn alone has two short arcs."""
    a = random_quats(rng, 50)
    b = quat.normalize(quat.mul(a, quat.from_axis_angle(quat.normalize(rng.normal(size=(50, 3)), eps=0.0), angle)))
    t = rng.uniform(size=50)
    p, q, share = (np.asarray(each, dtype=np.longdouble) for each in (a, b, t[:, None]))
    p, q = (each / np.sqrt((each * each).sum(axis=1, keepdims=True)) for each in (p, q))
    q = np.where((p * q).sum(axis=1, keepdims=True) < 0, -q, q)
    theta = 2 * np.arcsin(0.5 * np.sqrt(((p - q) ** 2).sum(axis=1, keepdims=True)))
    sin = np.where(theta > 0, np.sin(theta), 1)
    exact = np.where(
        theta > 0, (np.sin((1 - share) * theta) * p + np.sin(share * theta) * q) / sin, (1 - share) * p + share * q
    )
    found = quat.slerp(a, b, t)
    np.testing.assert_allclose(found, exact.astype(float), atol=4e-16, rtol=0)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, atol=1e-15)


def test_unroll_leaves_no_sign_jump(rng: np.random.Generator) -> None:
    path = quat.exp(np.linspace(0, 9, 200)[:, None, None] * random_quats(rng, 5)[:, 1:])
    flipped = path * rng.choice([-1.0, 1.0], size=(200, 5, 1))
    smooth = quat.unroll(flipped)
    assert np.all(np.sum(smooth[1:] * smooth[:-1], axis=-1) > 0.0)
    np.testing.assert_array_equal(smooth[0], flipped[0])
    np.testing.assert_array_equal(np.abs(smooth), np.abs(flipped))
    np.testing.assert_array_equal(quat.unroll(flipped.swapaxes(0, 1), axis=1), smooth.swapaxes(0, 1))


def test_align_and_absolute_choose_the_hemisphere(rng: np.random.Generator) -> None:
    q, reference = random_quats(rng, 100), random_quats(rng, 100)
    assert np.all(np.sum(quat.align(q, reference) * reference, axis=-1) >= 0.0)
    assert np.all(quat.absolute(q)[:, 0] >= 0.0)
    np.testing.assert_array_equal(np.abs(quat.absolute(q)), np.abs(q))


def test_mean_is_scipys_and_blind_to_signs(rng: np.random.Generator) -> None:
    q = quat.mul(random_quats(rng), quat.exp(rng.normal(0.0, 0.5, (30, 3))))
    weights = rng.uniform(0.1, 1.0, 30)
    expected = scipy_of(q).mean(weights).as_quat()[[3, 0, 1, 2]]
    signs = rng.choice([-1.0, 1.0], (30, 1))
    assert same_rotation(quat.mean(q * signs, weights=weights), expected, 1e-12)
    stacked = np.stack([q, q], axis=0)
    np.testing.assert_allclose(
        quat.mean(stacked, axis=1, weights=weights)[1], quat.mean(q, weights=weights), atol=1e-14
    )
