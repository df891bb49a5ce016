from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmark.errors import UnknownNameError
from benchmark.motion import quat, rotations

ORDERS = rotations.EULER_ORDERS
AXES = {"X": [1.0, 0, 0], "Y": [0, 1.0, 0], "Z": [0, 0, 1.0]}


def to_scipy(q: np.ndarray) -> Rotation:
    return Rotation.from_quat(np.asarray(q)[..., [1, 2, 3, 0]])


def from_scipy(rotation: Rotation) -> np.ndarray:
    return rotation.as_quat()[..., [3, 0, 1, 2]]


def apart(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.max(quat.angle(a, b)))


def test_there_are_six_orders() -> None:
    assert sorted(ORDERS) == sorted({a + b + c for a in "XYZ" for b in "XYZ" for c in "XYZ" if len({a, b, c}) == 3})


@pytest.mark.parametrize("order", ORDERS)
def test_from_euler_is_the_product_in_the_written_order(order: str, rng: np.random.Generator) -> None:
    angles = rng.uniform(-7.0, 7.0, (5, 40, 3))
    parts = [quat.from_axis_angle(AXES[axis], angles[..., slot]) for slot, axis in enumerate(order)]
    np.testing.assert_allclose(
        rotations.from_euler(angles, order), quat.mul(quat.mul(parts[0], parts[1]), parts[2]), atol=1e-15
    )
    expected = Rotation.from_euler(order, angles.reshape(-1, 3)).as_matrix()
    np.testing.assert_allclose(
        to_scipy(rotations.from_euler(angles, order).reshape(-1, 4)).as_matrix(), expected, atol=1e-14
    )


@pytest.mark.parametrize("order", ORDERS)
def test_to_euler_agrees_with_scipy(order: str, rng: np.random.Generator) -> None:
    q = quat.normalize(rng.normal(size=(500, 4)))
    np.testing.assert_allclose(rotations.to_euler(q, order), to_scipy(q).as_euler(order), atol=1e-12)
    np.testing.assert_allclose(rotations.to_euler(-q, order), rotations.to_euler(q, order), atol=1e-12)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("gap", [0.0, 1e-15, 1e-12, 1e-10, 1e-8, 1e-7, 1e-5])
def test_the_rotation_survives_gimbal_lock(order: str, side: float, gap: float, rng: np.random.Generator) -> None:
    angles = rng.uniform(-np.pi, np.pi, (200, 3))
    angles[:, 1] = side * (np.pi / 2 - gap)
    q = rotations.from_euler(angles, order)
    back = rotations.to_euler(q, order)
    assert np.all(np.isfinite(back))
    assert apart(rotations.from_euler(back, order), q) < 1e-11
    if gap == 0.0:
        np.testing.assert_allclose(np.abs(back[:, 1]), np.pi / 2, atol=1e-7)


@pytest.mark.parametrize("order", ORDERS)
def test_quarter_turns_of_every_kind(order: str) -> None:
    grid = np.stack(np.meshgrid(*[np.arange(-4, 5) * np.pi / 2] * 3), axis=-1).reshape(-1, 3)
    q = rotations.from_euler(grid, order)
    assert apart(rotations.from_euler(rotations.to_euler(q, order), order), q) < 1e-11


def test_angles_stay_in_their_ranges(rng: np.random.Generator) -> None:
    q = quat.normalize(rng.normal(size=(3000, 4)))
    for order in ORDERS:
        angles = rotations.to_euler(q, order)
        assert np.abs(angles[:, [0, 2]]).max() <= np.pi
        assert np.abs(angles[:, 1]).max() <= np.pi / 2


def test_lock_puts_zero_last() -> None:
    q = rotations.from_euler([0.3, np.pi / 2, 0.2], "XYZ")
    np.testing.assert_allclose(rotations.to_euler(q, "XYZ"), [0.5, np.pi / 2, 0.0], atol=1e-7)


@pytest.mark.parametrize("order", ["zxy", "XYX", "XY", "", "XYZW"])
def test_other_orders_are_refused_by_name(order: str) -> None:
    with pytest.raises(UnknownNameError, match="rotation order"):
        rotations.from_euler(np.zeros(3), order)
    with pytest.raises(UnknownNameError, match="XYZ"):
        rotations.to_euler(quat.identity(), order)


def test_matrices_are_scipys(rng: np.random.Generator) -> None:
    q = quat.normalize(rng.normal(size=(4, 60, 4)))
    matrices = to_scipy(q.reshape(-1, 4)).as_matrix().reshape(4, 60, 3, 3)
    np.testing.assert_allclose(rotations.to_matrix(q), matrices, atol=1e-14)
    assert apart(rotations.from_matrix(matrices), q) < 1e-14
    assert np.all(rotations.from_matrix(matrices)[..., 0] >= 0.0)


def test_matrices_of_half_turns_and_near_them(rng: np.random.Generator) -> None:
    axes = np.vstack([np.eye(3), rng.normal(size=(50, 3))])
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    for angle in (0.0, 1e-9, np.pi - 1e-9, np.pi):
        q = quat.from_axis_angle(axes, np.full(len(axes), angle))
        assert apart(rotations.from_matrix(rotations.to_matrix(q)), q) < 1e-14


def test_sixd_is_two_columns(rng: np.random.Generator) -> None:
    q = quat.normalize(rng.normal(size=(30, 4)))
    matrix = rotations.to_matrix(q)
    np.testing.assert_array_equal(rotations.to_sixd(q), np.concatenate([matrix[..., 0], matrix[..., 1]], axis=-1))
    assert apart(rotations.from_sixd(rotations.to_sixd(q)), q) < 1e-14


def test_sixd_of_any_length_and_angle_becomes_a_rotation(rng: np.random.Generator) -> None:
    raw = rng.normal(size=(200, 6)) * 10.0 ** rng.uniform(-6, 6, (200, 1))
    matrix = rotations.to_matrix(rotations.from_sixd(raw))
    first = raw[:, :3] / np.linalg.norm(raw[:, :3], axis=-1, keepdims=True)
    np.testing.assert_allclose(matrix[..., 0], first, atol=1e-12)
    in_plane = np.einsum("ni,ni->n", matrix[..., 2], raw[:, 3:] / np.linalg.norm(raw[:, 3:], axis=-1, keepdims=True))
    np.testing.assert_allclose(in_plane, 0.0, atol=1e-12)
    assert np.all(np.einsum("ni,ni->n", matrix[..., 1], raw[:, 3:]) > 0.0)


@pytest.mark.parametrize(
    "sixd", [[0.0] * 6, [1.0, 0, 0, 0, 0, 0], [0, 0, 0, 0, 1.0, 0], [1.0, 2, 3, 2, 4, 6], [1.0, 2, 3, -1, -2, -3]]
)
def test_degenerate_sixd_still_gives_a_rotation(sixd: list[float]) -> None:
    q = rotations.from_sixd(sixd)
    np.testing.assert_allclose(np.linalg.norm(q), 1.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(rotations.to_matrix(q)), 1.0, atol=1e-12)


def test_nearly_parallel_columns_still_give_a_rotation(rng: np.random.Generator) -> None:
    first = rng.normal(size=(50, 3))
    sixd = np.concatenate([first, first + 1e-9 * rng.normal(size=(50, 3))], axis=-1)
    matrix = rotations.to_matrix(rotations.from_sixd(sixd))
    np.testing.assert_allclose(matrix @ matrix.swapaxes(-1, -2), np.broadcast_to(np.eye(3), (50, 3, 3)), atol=1e-12)
    np.testing.assert_allclose(matrix[..., 0], first / np.linalg.norm(first, axis=-1, keepdims=True), atol=1e-12)


def test_wrap_keeps_what_is_in_range_to_the_bit() -> None:
    angles = np.array([-np.pi, -1.0, 0.0, 1e-300, np.pi])
    np.testing.assert_array_equal(rotations.wrap(angles), angles)
    np.testing.assert_allclose(rotations.wrap([2 * np.pi + 0.5, -7.0]), [0.5, 2 * np.pi - 7.0], atol=1e-15)
