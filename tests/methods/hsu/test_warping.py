from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.errors import ContractError
from methods.hsu.warping import Warp, iterative_motion_warping


def performance(rng: np.random.Generator, frames: int, channels: int) -> np.ndarray:
    """(frames, channels) smooth standardised motion: six harmonics of about one to six cycles."""
    t = np.linspace(0.0, 1.0, frames)[:, np.newaxis]
    waves = np.zeros((frames, channels))
    for cycles in range(1, 7):
        pace, phase = rng.uniform(0.7, 1.3, channels), rng.uniform(size=channels)
        waves += rng.normal(size=channels) / np.sqrt(cycles) * np.sin(2.0 * np.pi * (cycles * t * pace + phase))
    return (waves - waves.mean(axis=0)) / waves.std(axis=0)


def random_path(rng: np.random.Generator, frames: int, band: float = 0.15) -> np.ndarray:
    """Monotone path in runs of repeated, normal and skipped frames, within a band."""
    while True:
        path, pace = [0], 1
        while path[-1] < frames - 1:
            if rng.random() < 0.5:
                pace = rng.choice([0, 1, 1, 2])
            path.append(min(path[-1] + pace, frames - 1))
        line = np.linspace(0, frames - 1, len(path))
        if np.abs(path - line).max() < band * frames:
            return np.array(path)


def as_a_child(rng: np.random.Generator, u: np.ndarray) -> np.ndarray:
    """Channels scaled and offset, both a little differently over time."""
    channels = u.shape[1]
    t = np.linspace(0.0, 1.0, len(u))[:, np.newaxis]
    scale = 1.0 + 0.3 * rng.normal(size=channels) + 0.2 * np.sin(2.0 * np.pi * (t + rng.uniform(size=channels)))
    offset = 0.3 * rng.normal(size=channels) + 0.3 * np.cos(2.0 * np.pi * (t + rng.uniform(size=channels)))
    return u * scale + offset


def objective(
    u, v, warp: Warp, *, smooth_scale=10.0, smooth_offset=10.0, order=1, ridge=1e-6, step_penalty=0.03
) -> float:
    """The objective as the module's documentation states it."""
    price = step_penalty * ((v - v.mean(axis=0)) ** 2).sum(axis=1).mean()
    return float(
        ((warp.apply(u) - v) ** 2).sum()
        + smooth_scale * (np.diff(warp.scale, n=order, axis=0) ** 2).sum()
        + smooth_offset * (np.diff(warp.offset, n=order, axis=0) ** 2).sum()
        + ridge * (((warp.scale - 1.0) ** 2).sum() + (warp.offset**2).sum())
        + price * np.abs(np.diff(warp.path) - 1).sum()
    )


def assert_never_rises(energy: np.ndarray) -> None:
    # The objective's own rounding is all that is allowed.
    assert (np.diff(energy) <= 1e-12 * energy[0]).all()


@pytest.mark.parametrize("step_penalty", [0.0, 0.03])
@pytest.mark.parametrize("solver", ["banded", "dense"])
def test_equal_performances_need_no_warp(rng, step_penalty: float, solver: str) -> None:
    u = performance(rng, 120, 9)
    warp = iterative_motion_warping(u, u, step_penalty=step_penalty, solver=solver)
    np.testing.assert_array_equal(warp.path, np.arange(120))
    assert (warp.scale == 1.0).all()
    assert (warp.offset == 0.0).all()
    assert not warp.energy.any()
    assert (warp.mean_residual, warp.mean_energy) == (0.0, 0.0)
    assert warp.converged
    assert warp.path.dtype == np.int64
    np.testing.assert_array_equal(warp.apply(u), u)


def test_an_affine_image_is_recovered_when_changes_cost_much(rng) -> None:
    u = performance(rng, 150, 12)
    warp = iterative_motion_warping(u, 2.0 * u + 1.0, smooth_scale=1e4, smooth_offset=1e4)
    assert np.abs(warp.path - np.arange(150)).mean() < 0.1
    np.testing.assert_allclose(warp.scale, 2.0, atol=0.01)
    np.testing.assert_allclose(warp.offset, 1.0, atol=0.01)


@pytest.mark.parametrize("seed", range(4))
def test_a_time_warp_is_recovered(seed: int) -> None:
    rng = np.random.default_rng(seed)
    u = performance(rng, 200, 12)
    path = random_path(rng, 200)
    literal = iterative_motion_warping(u, u[path], step_penalty=0.0)
    np.testing.assert_array_equal(literal.path, path)
    assert literal.energy[-1] == 0.0
    priced = iterative_motion_warping(u, u[path])
    assert np.abs(priced.path - path).mean() < 0.6


@pytest.mark.parametrize("smooth", [10.0, 100.0, 1000.0])
@pytest.mark.parametrize("seed", range(4))
def test_a_time_warp_is_recovered_through_the_transform_of_a_child(seed: int, smooth: float) -> None:
    rng = np.random.default_rng(seed)
    u = performance(rng, 200, 12)
    path = random_path(rng, 200)
    v = as_a_child(rng, u)[path]
    warp = iterative_motion_warping(u, v, smooth_scale=smooth, smooth_offset=smooth)
    untouched = np.linspace(0, 199, len(path))
    assert np.abs(warp.path - path).mean() < min(1.5, 0.5 * np.abs(untouched - path).mean())
    assert_never_rises(warp.energy)


def test_few_channels_need_smoothness() -> None:
    # With little of it the space warp imitates what the time warp should do.
    off = {}
    for smooth in (1.0, 100.0):
        errors = []
        for seed in range(4):
            rng = np.random.default_rng(seed)
            u = performance(rng, 200, 3)
            pace = np.linspace(0.0, 1.0, 230) ** 1.4 * 199
            child = as_a_child(rng, u)
            v = np.stack([np.interp(pace, np.arange(200), channel) for channel in child.T], axis=1)
            warp = iterative_motion_warping(u, v, smooth_scale=smooth, smooth_offset=smooth, step_penalty=0.0)
            errors.append(np.abs(warp.path - pace).mean())
        off[smooth] = np.mean(errors)
    assert off[100.0] < 1.0 < off[1.0]


@settings(max_examples=60, deadline=None)
@given(
    frames_in=st.integers(1, 40),
    frames_out=st.integers(1, 50),
    channels=st.integers(1, 4),
    order=st.integers(1, 2),
    smooth_scale=st.sampled_from([0.0, 0.1, 10.0, 1e4]),
    smooth_offset=st.sampled_from([0.0, 1.0, 100.0]),
    step_penalty=st.sampled_from([0.0, 0.01, 0.3]),
    band=st.sampled_from([None, 0.3]),
    size=st.sampled_from([1e-3, 1.0, 100.0]),
    seed=st.integers(0, 2**32 - 1),
)
def test_the_energy_is_the_objective_and_never_rises(
    frames_in, frames_out, channels, order, smooth_scale, smooth_offset, step_penalty, band, size, seed
) -> None:
    rng = np.random.default_rng(seed)
    u = size * rng.normal(size=(frames_in, channels))
    v = size * np.cumsum(rng.normal(size=(frames_out, channels)), axis=0)
    max_skip = max(3, -(-frames_in // max(frames_out - 1, 1)))
    weights = {"smooth_scale": smooth_scale, "smooth_offset": smooth_offset, "step_penalty": step_penalty}
    if frames_out == 1:
        u = u[:1]
    try:
        warp = iterative_motion_warping(u, v, difference_order=order, max_skip=max_skip, band=band, **weights)
    except ContractError as error:
        assert band is not None and "widen the band" in str(error)
        return
    assert_never_rises(warp.energy)
    assert len(warp.energy) in (2 * warp.iterations - 1, 2 * warp.iterations)
    assert warp.energy[-1] == pytest.approx(objective(u, v, warp, order=order, **weights), rel=1e-9, abs=1e-12)
    assert warp.mean_residual == pytest.approx(((warp.apply(u) - v) ** 2).mean(), rel=1e-9, abs=1e-15)
    assert warp.mean_energy == pytest.approx(warp.energy[-1] / v.size)


def test_plain_distances_may_raise_the_energy() -> None:
    highest = {}
    for distance in ("squared", "l2"):
        rises = []
        for seed in (7, 8, 17, 36):
            rng = np.random.default_rng(seed)
            u, v = np.cumsum(rng.normal(size=(60, 3)), axis=0), np.cumsum(rng.normal(size=(70, 3)), axis=0)
            warp = iterative_motion_warping(
                u / u.std(axis=0), v / v.std(axis=0), distance=distance, step_penalty=0.0, iterations=30
            )
            rises.append((np.diff(warp.energy) / warp.energy[0]).max())
        highest[distance] = max(rises)
    assert highest["squared"] <= 1e-12
    assert highest["l2"] > 1e-5


@pytest.mark.parametrize("order", [1, 2])
def test_the_dense_solver_changes_nothing(rng, order: int) -> None:
    u = performance(rng, 60, 3)
    v = as_a_child(rng, u)[random_path(rng, 60)]
    banded = iterative_motion_warping(u, v, difference_order=order, iterations=5)
    dense = iterative_motion_warping(u, v, difference_order=order, iterations=5, solver="dense")
    np.testing.assert_array_equal(banded.path, dense.path)
    np.testing.assert_allclose(banded.scale, dense.scale, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(banded.offset, dense.offset, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(banded.energy, dense.energy, rtol=1e-9)


def test_smoothness_keeps_what_it_weighs_small(rng) -> None:
    u = performance(rng, 90, 6)
    v = as_a_child(rng, u)[random_path(rng, 90)]
    rough = iterative_motion_warping(u, v, smooth_scale=1.0, smooth_offset=1000.0)
    smooth = iterative_motion_warping(u, v, smooth_scale=1000.0, smooth_offset=1.0)
    assert np.abs(np.diff(smooth.scale, axis=0)).sum() < 0.2 * np.abs(np.diff(rough.scale, axis=0)).sum()
    assert np.abs(np.diff(rough.offset, axis=0)).sum() < 0.2 * np.abs(np.diff(smooth.offset, axis=0)).sum()


def test_the_energy_ranks_pairs_by_how_well_they_align(rng) -> None:
    u = performance(rng, 100, 9)
    same = as_a_child(rng, u)[random_path(rng, 100)]
    another = performance(rng, 130, 9)
    alike, unlike = iterative_motion_warping(u, same), iterative_motion_warping(u, another)
    assert alike.mean_energy < 0.5 * unlike.mean_energy
    assert alike.mean_residual < 0.5 * unlike.mean_residual


def test_tolerance_and_limit_end_the_iteration(rng) -> None:
    u = performance(rng, 100, 6)
    v = as_a_child(rng, u)[random_path(rng, 100)]
    full = iterative_motion_warping(u, v, tolerance=0.0)
    short = iterative_motion_warping(u, v, iterations=2, tolerance=0.0)
    loose = iterative_motion_warping(u, v, tolerance=0.05)
    assert full.converged and loose.converged and not short.converged
    assert (short.iterations, len(short.energy)) == (2, 4)
    assert 1 < loose.iterations < full.iterations
    np.testing.assert_array_equal(loose.energy, full.energy[: len(loose.energy)])
    # Another round from where it came to rest: the last value stands twice.
    assert full.energy[-1] == full.energy[-2]


def test_a_skip_of_one_only_repeats(rng) -> None:
    u = performance(rng, 60, 6)
    path = np.sort(np.concatenate([np.arange(60), rng.integers(0, 60, 25)]))
    warp = iterative_motion_warping(u, u[path], max_skip=1, step_penalty=0.0)
    np.testing.assert_array_equal(warp.path, path)
    with pytest.raises(ContractError, match="lengthen the output"):
        iterative_motion_warping(u[path], u, max_skip=1)
    longer = iterative_motion_warping(u[path], np.repeat(u, 2, axis=0), max_skip=1)
    np.testing.assert_array_equal(np.unique(longer.path), np.arange(85))


def test_one_frame_on_one_or_both_sides(rng) -> None:
    one, many = rng.normal(size=(1, 5)), rng.normal(size=(8, 5))
    both = iterative_motion_warping(one, many[:1])
    np.testing.assert_array_equal(both.path, [0])
    assert both.converged
    # One frame has a scale and an offset to itself, and nothing else to fit.
    np.testing.assert_allclose(both.apply(one), many[:1], atol=1e-4)
    repeated = iterative_motion_warping(one, many)
    assert not repeated.path.any()
    np.testing.assert_allclose(repeated.apply(one), np.tile(many.mean(axis=0), (8, 1)), atol=1e-4)
    with pytest.raises(ContractError, match="8 input to 1 output"):
        iterative_motion_warping(many, one)


@pytest.mark.parametrize("order", [1, 2])
def test_constant_and_zero_channels_have_no_say(rng, order: int) -> None:
    u = performance(rng, 80, 6)
    path = random_path(rng, 80)
    v = as_a_child(rng, u)[path]
    alone = iterative_motion_warping(u, v, difference_order=order)
    dull_in, dull_out = np.zeros((80, 2)) + [0.0, 3.0], np.zeros((len(path), 2)) + [0.0, 3.0]
    warp = iterative_motion_warping(np.hstack([u, dull_in]), np.hstack([v, dull_out]), difference_order=order)
    np.testing.assert_array_equal(warp.path, alone.path)
    np.testing.assert_allclose(warp.scale[:, :6], alone.scale, rtol=1e-9, atol=1e-9)
    assert (warp.scale[:, 6:] == 1.0).all()
    assert (warp.offset[:, 6:] == 0.0).all()
    still = iterative_motion_warping(np.zeros((20, 3)), np.zeros((25, 3)))
    assert still.converged
    assert not still.energy.any()


def test_one_channel_may_come_without_its_axis(rng) -> None:
    u = performance(rng, 80, 1)
    v = u[random_path(rng, 80)]
    flat, column = iterative_motion_warping(u[:, 0], v[:, 0]), iterative_motion_warping(u, v)
    np.testing.assert_array_equal(flat.path, column.path)
    assert flat.scale.shape == (80, 1)
    np.testing.assert_array_equal(flat.apply(u[:, 0]), column.apply(u))


def test_a_warp_applies_to_its_input_alone(rng) -> None:
    u = performance(rng, 40, 3)
    path = random_path(rng, 40)
    warp = iterative_motion_warping(u, u[path])
    assert warp.apply(u).shape == (len(path), 3)
    markers = rng.normal(size=(40, 7, 2))
    np.testing.assert_array_equal(warp.time_warped(markers), markers[warp.path])
    for wrong in (u[:-1], np.float64(3.0)):
        with pytest.raises(ContractError, match="40 input frames"):
            warp.time_warped(wrong)
    with pytest.raises(ContractError, match=r"\(40, 3\) frames and channels"):
        warp.apply(u[:, :2])
    with pytest.raises(ValueError, match="read-only"):
        warp.path[0] = 1


def test_the_inputs_are_left_as_they_are(rng) -> None:
    u, v = performance(rng, 30, 2), performance(rng, 35, 2)
    kept = u.copy(), v.copy()
    u.flags.writeable = v.flags.writeable = False
    iterative_motion_warping(u, v)
    np.testing.assert_array_equal(u, kept[0])
    np.testing.assert_array_equal(v, kept[1])
    # Single precision and lists are as good.
    listed = iterative_motion_warping(u.tolist(), v.astype(np.float32))
    assert listed.scale.dtype == np.float64


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"u": np.zeros((0, 3))}, r"u must be a non-empty array .* \(0, 3\)"),
        ({"v": np.zeros((4, 0))}, r"v must be a non-empty array .* \(4, 0\)"),
        ({"u": np.float64(1.0)}, r"u must be .* \(\)"),
        ({"u": np.zeros((4, 3, 2))}, r"u must be .* \(4, 3, 2\)"),
        ({"v": np.zeros((9, 2))}, "u has 3 channels and v 2"),
        ({"v": np.where(np.arange(27).reshape(9, 3) == 5, np.nan, 0.0)}, "v holds nan at frame 1, channel 2"),
        ({"u": np.full((8, 3), np.inf)}, "u holds inf at frame 0, channel 0"),
        ({"v": np.zeros((3, 3)), "max_skip": 2}, "8 input to 3 output .* max_skip = 2 within a band of 0.2"),
        ({"band": 0.001}, "within a band of 0.001: raise max_skip or widen the band"),
        ({"smooth_scale": -1.0}, "smooth_scale must be finite and at least 0"),
        ({"smooth_offset": np.nan}, "smooth_offset must be finite"),
        ({"band": -0.1}, "band must be finite and at least 0"),
        ({"step_penalty": np.inf}, "step_penalty must be finite"),
        ({"tolerance": -1e-3}, "tolerance must be"),
        ({"ridge": 0.0}, "ridge must be finite and above 0"),
        ({"max_skip": 0}, "max_skip must be a whole number of at least 1"),
        ({"difference_order": 1.5}, "difference_order must be a whole number"),
        ({"iterations": 0}, "iterations must be a whole number"),
        ({"distance": "l1"}, "distance must be squared or l2, not 'l1'"),
        ({"solver": "lu"}, "solver must be banded or dense, not 'lu'"),
    ],
)
def test_bad_input_is_named(change: dict, message: str) -> None:
    arguments = {"u": np.zeros((8, 3)), "v": np.zeros((9, 3)), **change}
    with pytest.raises(ContractError, match=message):
        iterative_motion_warping(**arguments)


@pytest.mark.real_data
def test_two_jumps_are_aligned(kinder_gator) -> None:
    from benchmark.data.catalog import open_dataset

    dataset = open_dataset("kinder-gator", root=kinder_gator)
    jumps = [dataset.load(f"{actor}/jump-as-high-as-you-can_1") for actor in ("adult/734", "child/723")]
    u, v = (standardised(clip.positions) for clip in jumps)
    warp = iterative_motion_warping(u, v)
    assert warp.converged
    assert_never_rises(warp.energy)
    assert np.isin(np.diff(warp.path), range(4)).all()
    assert warp.mean_residual < 0.25 * ((u[np.round(np.linspace(0, len(u) - 1, len(v))).astype(int)] - v) ** 2).mean()


def standardised(positions: np.ndarray) -> np.ndarray:
    relative = (positions - positions[:, :1])[:, 1:].reshape(len(positions), -1)
    return (relative - relative.mean(axis=0)) / relative.std(axis=0)
