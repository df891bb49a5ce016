from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.errors import ContractError
from methods.hsu.space_warp import dense_matrix, difference_bands, frame_sums, roughness, space_warp

SETTINGS = {"smooth_scale": 10.0, "smooth_offset": 4.0, "ridge": 1e-6}


def random_path(rng, frames_in: int, frames_out: int) -> np.ndarray:
    return np.sort(rng.integers(0, frames_in, frames_out))


def objective(u, v, path, scale, offset, *, smooth_scale, smooth_offset, ridge, order=1) -> float:
    """The objective as written, with the warp and difference matrices spelled out."""
    warp = np.eye(len(u))[path]
    differences = np.diff(np.eye(len(u)), n=order, axis=0)
    return float(
        ((warp @ (u * scale + offset) - v) ** 2).sum()
        + smooth_scale * ((differences @ scale) ** 2).sum()
        + smooth_offset * ((differences @ offset) ** 2).sum()
        + ridge * (((scale - 1.0) ** 2).sum() + (offset**2).sum())
    )


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("frames", [1, 2, 3, 4, 9])
def test_difference_bands_are_those_of_the_product(order: int, frames: int) -> None:
    operator = np.diff(np.eye(frames), n=order, axis=0)
    product = operator.T @ operator
    bands = difference_bands(frames, order)
    for k in range(order + 1):
        np.testing.assert_array_equal(bands[k, : max(frames - k, 0)], np.diagonal(product, -k))
        assert not bands[k, max(frames - k, 0) :].any()
    values = np.arange(frames, dtype=float)[:, np.newaxis] ** 3
    assert roughness(values, order) == pytest.approx(float(((operator @ values) ** 2).sum()))


def test_frame_sums_are_the_transposed_warp(rng) -> None:
    values, path = rng.normal(size=(30, 4)), random_path(rng, 12, 30)
    np.testing.assert_allclose(frame_sums(values, path, 12), np.eye(12)[path].T @ values, atol=1e-13)


@settings(max_examples=60, deadline=None)
@given(
    frames_in=st.integers(1, 40),
    frames_out=st.integers(1, 50),
    channels=st.integers(1, 5),
    order=st.integers(1, 3),
    smooth=st.sampled_from([0.0, 0.1, 10.0, 1000.0]),
    seed=st.integers(0, 2**32 - 1),
)
def test_banded_is_dense(frames_in, frames_out, channels, order, smooth, seed) -> None:
    rng = np.random.default_rng(seed)
    u, v = rng.normal(size=(frames_in, channels)), rng.normal(size=(frames_out, channels))
    path = random_path(rng, frames_in, frames_out)
    weights = {"smooth_scale": smooth, "smooth_offset": 0.5 * smooth, "ridge": 1e-3}
    banded = space_warp(u, v, path, **weights, difference_order=order)
    dense = space_warp(u, v, path, **weights, difference_order=order, solver="dense")
    # Two right solvers may differ by the rounding of the matrix itself, which its condition magnifies: at the third differences
    # with a weight of 1000 that is 6e7, and both are some 1e-9 from the solution in 40 digits.
    bands = smooth * difference_bands(frames_in, order)
    count = np.bincount(path, minlength=frames_in).astype(float)
    condition = max(np.linalg.cond(dense_matrix(channel, count, bands, 0.5 * bands, 1e-3)) for channel in u.T)
    np.testing.assert_allclose(banded, dense, rtol=1e-9, atol=max(1e-9, 30.0 * np.finfo(float).eps * condition))


@pytest.mark.parametrize("order", [1, 2])
def test_banded_is_dense_with_the_ridge_in_use(rng, order: int) -> None:
    t = np.linspace(0.0, 9.0, 200)[:, np.newaxis]
    u = np.sin(t + rng.uniform(0.0, 6.0, 7))
    path = random_path(rng, 200, 230)
    v = (1.4 * u - 0.2)[path]
    banded = space_warp(u, v, path, **SETTINGS, difference_order=order)
    dense = space_warp(u, v, path, **SETTINGS, difference_order=order, solver="dense")
    np.testing.assert_allclose(banded, dense, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("solver", ["banded", "dense"])
@pytest.mark.parametrize("order", [1, 2])
def test_the_solution_is_the_minimum_of_the_objective(rng, solver: str, order: int) -> None:
    u, v = rng.normal(size=(25, 3)), rng.normal(size=(31, 3))
    path = random_path(rng, 25, 31)
    scale, offset = space_warp(u, v, path, **SETTINGS, difference_order=order, solver=solver)

    def at(x: float, along) -> float:
        return objective(u, v, path, scale + x * along[0], offset + x * along[1], **SETTINGS, order=order)

    least = at(0.0, (0.0, 0.0))
    for _ in range(20):
        along = rng.normal(size=(2, 25, 3))
        # Of a quadratic function central differences are exact.
        slope, curvature = (at(1.0, along) - at(-1.0, along)) / 2.0, at(1.0, along) + at(-1.0, along) - 2.0 * least
        assert curvature > 0.0
        assert abs(slope) < 1e-9 * curvature


def test_the_block_as_printed_would_not_be_the_minimum(rng) -> None:
    u, v = rng.normal(size=(20, 1)), rng.normal(size=(20, 1))
    path = np.arange(20)
    bands = difference_bands(20, 1)
    matrix = dense_matrix(u[:, 0], np.ones(20), 10.0 * bands, 4.0 * bands, 1e-6)
    np.testing.assert_array_equal(matrix, matrix.T)
    right = np.concatenate([u[:, 0] * v[:, 0] + 1e-6, v[:, 0]])
    correct = np.linalg.solve(matrix, right).reshape(2, 20, 1)
    np.testing.assert_allclose(space_warp(u, v, path, **SETTINGS), correct, atol=1e-9)
    matrix[:20, 20:] = np.diag(u[:, 0] ** 2)
    printed = np.linalg.solve(matrix, right).reshape(2, 20, 1)
    assert objective(u, v, path, *printed, **SETTINGS) > 1.05 * objective(u, v, path, *correct, **SETTINGS)


def test_an_equal_output_leaves_exactly_the_identity(rng) -> None:
    u, path = rng.normal(size=(30, 4)), random_path(rng, 30, 44)
    scale, offset = space_warp(u, u[path], path, **SETTINGS)
    assert (scale == 1.0).all()
    assert (offset == 0.0).all()


def test_one_affine_map_is_recovered_when_changes_cost_much(rng) -> None:
    u = rng.normal(size=(80, 3))
    path = random_path(rng, 80, 100)
    truth = np.array([2.0, 0.5, -1.0]), np.array([1.0, -3.0, 0.2])
    scale, offset = space_warp(
        u, (u * truth[0] + truth[1])[path], path, smooth_scale=1e6, smooth_offset=1e6, ridge=1e-6
    )
    np.testing.assert_allclose(scale, np.broadcast_to(truth[0], u.shape), atol=1e-5)
    np.testing.assert_allclose(offset, np.broadcast_to(truth[1], u.shape), atol=1e-5)


@pytest.mark.parametrize("order", [1, 2])
def test_deleted_frames_are_interpolated(rng, order: int) -> None:
    u, v = rng.normal(size=(40, 2)), rng.normal(size=(24, 2))
    path = np.concatenate([np.arange(15), np.arange(31, 40)])
    scale, offset = space_warp(u, v, path, **{**SETTINGS, "ridge": 1e-12}, difference_order=order)
    for values in (scale, offset):
        # Where nothing is observed, differences of twice the order vanish: a straight line, or a cubic.
        gap = values[15 - order : 31 + order]
        assert np.abs(np.diff(gap, n=2 * order, axis=0)).max() < 1e-9
        assert np.ptp(gap, axis=0).min() > 1e-3


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("solver", ["banded", "dense"])
def test_constant_zero_and_tiny_channels(rng, order: int, solver: str) -> None:
    frames = 50
    u = np.stack([np.zeros(frames), np.full(frames, 3.0), 1e-9 * rng.normal(size=frames), rng.normal(size=frames)], 1)
    path = random_path(rng, frames, 60)
    v = u[path] + np.array([0.5, 0.5, 0.0, 0.0])
    scale, offset = space_warp(u, v, path, **SETTINGS, difference_order=order, solver=solver)
    assert np.isfinite(scale).all()
    # A zero channel has no scale; a constant one needs only the sum of both to fit.
    np.testing.assert_allclose(scale[:, 0], 1.0, atol=1e-9)
    np.testing.assert_allclose((u * scale + offset)[:, 0], 0.5, atol=1e-5)
    np.testing.assert_allclose((u * scale + offset)[:, 1], 3.5, atol=1e-5)
    # Channels do not touch each other.
    for k in range(4):
        alone = space_warp(u[:, k : k + 1], v[:, k : k + 1], path, **SETTINGS, difference_order=order, solver=solver)
        np.testing.assert_allclose(alone[0][:, 0], scale[:, k], rtol=1e-9, atol=1e-9)


def test_channels_solved_in_several_calls_are_those_solved_in_one(monkeypatch, rng) -> None:
    u, v = rng.normal(size=(30, 11)), rng.normal(size=(40, 11))
    path = random_path(rng, 30, 40)
    together = space_warp(u, v, path, **SETTINGS)
    monkeypatch.setattr("methods.hsu.space_warp._STACK", 4 * 60)
    np.testing.assert_allclose(space_warp(u, v, path, **SETTINGS), together, rtol=1e-12, atol=1e-12)


def test_a_hopeless_ridge_is_named() -> None:
    u = np.full((200, 2), 1e9)
    with pytest.raises(ContractError, match=r"channel \d is not definite .* ridge of 1e-300"):
        space_warp(u, u, np.arange(200), smooth_scale=1.0, smooth_offset=1.0, ridge=1e-300)


def test_memory_grows_with_the_frames() -> None:
    def peak(frames: int) -> int:
        u = np.sin(np.linspace(0.0, 30.0, frames))[:, np.newaxis]
        tracemalloc.start()
        try:
            space_warp(u, u, np.arange(frames), **SETTINGS)
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    # Of the dense matrix of one channel not even one row in a hundred is held.
    assert peak(4000) < 8 * (2 * 4000) ** 2 / 100
    assert peak(16000) < 5 * peak(4000)
