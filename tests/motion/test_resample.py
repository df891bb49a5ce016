from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.errors import ContractError
from benchmark.motion import quat
from benchmark.motion.clip import MotionClip
from benchmark.motion.resample import low_pass, resample, sample_at


def _with_root(biped, root, fps):
    return MotionClip(biped(), quat.identity(len(root), 21), root, fps)


def test_same_rate_is_the_clip_itself(wild, rng):
    clip = wild(rng)
    assert resample(clip, clip.fps) is clip


@pytest.mark.parametrize("fps", [25, 30, 47.3, 60, 120])
@pytest.mark.parametrize("frames", [1, 2, 3, 4, 61])
def test_duration_is_kept_and_the_first_frame_exact(wild, rng, fps, frames):
    clip = wild(rng, frames, 60.0)
    out = resample(clip, fps)
    assert out.fps == fps
    assert out.duration <= clip.duration + 1e-9
    assert clip.duration - out.duration < 1 / fps
    np.testing.assert_allclose(out.root[0], clip.root[0], atol=1e-14)
    np.testing.assert_allclose(out.rotations[0], clip.rotations[0], atol=1e-14)


def test_going_up_and_back_returns_every_frame(wild, rng):
    clip = wild(rng, 50, 30.0)
    back = resample(resample(clip, 120.0), 30.0, lowpass=False)
    assert len(back) == len(clip)
    np.testing.assert_allclose(back.root, clip.root, atol=1e-12)
    assert quat.angle(back.rotations, clip.rotations).max() < 1e-12


def test_steady_rotation_stays_steady(biped):
    time = np.arange(31) / 30
    rotations = quat.identity(31, 21)
    rotations[:, 3] = quat.from_axis_angle([0.6, 0.0, 0.8], 5.0 * time)
    rotations[::2] *= -1.0  # Signs must not matter.
    clip = MotionClip(biped(), rotations, np.zeros((31, 3)), 30.0)
    out = resample(clip, 77.0)
    expected = quat.from_axis_angle([0.6, 0.0, 0.8], 5.0 * out.times)
    assert quat.angle(out.rotations[:, 3], expected).max() < 1e-12
    assert np.sum(out.rotations[1:] * out.rotations[:-1], axis=-1).min() > 0


@pytest.mark.parametrize("lowpass", [True, False])
@pytest.mark.parametrize("fps", [24.0, 31.0, 100.0])
def test_cubic_paths_are_exact(biped, fps, lowpass):
    time = np.arange(90) / 60
    path = np.stack([1 + time - 2 * time**2 + 0.7 * time**3, 1 + 3 * time - 4.905 * time**2, time**3], axis=-1)
    out = resample(_with_root(biped, path, 60.0), fps, lowpass=lowpass)
    t = out.times
    expected = np.stack([1 + t - 2 * t**2 + 0.7 * t**3, 1 + 3 * t - 4.905 * t**2, t**3], axis=-1)
    np.testing.assert_allclose(out.root, expected, atol=1e-10)


@pytest.mark.parametrize("ratio", [0.5, 0.7, 0.83, 1.3])
def test_gravity_survives_dynamic_scaling(biped, ratio):
    """Lengths times L, times times sqrt(L): methods 2.3."""
    time = np.arange(60) / 30
    root = np.stack([0.5 * time, 1 + 9 * time - 0.5 * 9.81 * time**2, time], axis=-1)
    clip = _with_root(biped, root, 30.0)
    new = np.arange(round(np.sqrt(ratio) * 59)) / 30
    out = sample_at(clip, new / np.sqrt(ratio), fps=30.0)
    fall = np.diff(ratio * out.root[:, 1], n=2)[:-2] * 30.0**2
    np.testing.assert_allclose(fall, -9.81, atol=1e-6)


def test_aliases_are_removed_and_slow_motion_kept(biped):
    time = np.arange(481) / 120
    slow, fast = np.sin(2 * np.pi * 2 * time), np.sin(2 * np.pi * 28 * time)  # 28 Hz folds onto 2 Hz at 30 fps.
    zero = np.zeros_like(time)
    clip = _with_root(biped, np.stack([slow, fast, zero], axis=-1), 120.0)
    rotations = clip.rotations.copy()
    rotations[:, 1] = quat.from_axis_angle([0.0, 0.0, 1.0], 0.5 * fast)
    rotations[:, 2] = quat.from_axis_angle([0.0, 0.0, 1.0], 0.5 * slow)
    clip = clip.replace(rotations=rotations)
    out, aliased = resample(clip, 30.0), resample(clip, 30.0, lowpass=False)
    inner = slice(10, -10)
    assert np.abs(aliased.root[inner, 1]).max() > 0.9
    assert np.abs(out.root[inner, 1]).max() < 0.01
    assert quat.angle(out.rotations[inner, 1], quat.identity()).max() < 0.02
    # Zero phase: slow motion is where it was.
    np.testing.assert_allclose(out.root[:, 0], np.sin(2 * np.pi * 2 * out.times), atol=2e-3)
    expected = quat.from_axis_angle([0.0, 0.0, 1.0], 0.5 * np.sin(2 * np.pi * 2 * out.times))
    assert quat.angle(out.rotations[:, 2], expected).max() < 2e-3


def test_filter_does_not_see_signs(wild, rng):
    clip = wild(rng, 100, 120.0)
    flipped = clip.replace(rotations=clip.rotations * rng.choice([-1.0, 1.0], size=(100, 21, 1)))
    a, b = low_pass(clip, 10.0), low_pass(flipped, 10.0)
    assert quat.angle(a.rotations, b.rotations).max() < 1e-7


def test_filter_is_symmetric_in_time(wild, rng):
    clip = wild(rng, 100, 120.0)
    reverse = clip.replace(root=clip.root[::-1])
    np.testing.assert_allclose(low_pass(reverse, 8.0).root[::-1], low_pass(clip, 8.0).root, atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.floats(-1.0, 3.0), min_size=1, max_size=20),
    st.integers(1, 12),
    st.integers(0, 2**32 - 1),
)
def test_any_times_give_valid_frames_inside_the_clip(times, frames, seed):
    from benchmark.motion.skeleton import Skeleton

    rng = np.random.default_rng(seed)
    skeleton = Skeleton(("a", "b"), np.array([-1, 0]), np.ones((2, 3)))
    rotations = quat.normalize(rng.normal(size=(frames, 2, 4)))
    extra = rng.random((frames, 2))
    clip = MotionClip(skeleton, rotations, rng.normal(size=(frames, 3)), 10.0, residual=extra)
    out = sample_at(clip, np.sort(times), fps=30.0)
    assert len(out) == len(times) and out.fps == 30.0
    assert out.residual is not None
    assert out.residual.min() >= extra.min() - 1e-12 and out.residual.max() <= extra.max() + 1e-12
    for i, time in enumerate(np.sort(times)):
        if time <= 0 or time >= clip.duration:
            frame = 0 if time <= 0 else frames - 1
            np.testing.assert_array_equal(out.root[i], clip.root[frame])
            assert quat.angle(out.rotations[i], clip.rotations[frame]).max() < 1e-7


def test_translations_are_interpolated_linearly(biped):
    translations = np.linspace(0, 1, 5)[:, None, None] * np.ones((5, 21, 3))
    clip = MotionClip(biped(), quat.identity(5, 21), np.zeros((5, 3)), 10.0, translations=translations)
    out = sample_at(clip, [0.0, 0.05, 0.4], fps=10.0)
    np.testing.assert_allclose(out.translations[:, 0, 0], [0.0, 0.125, 1.0], atol=1e-12)


@pytest.mark.parametrize("times", [[], [0.2, 0.1], [np.nan], [[0.0]]])
def test_bad_times_are_refused(wild, rng, times):
    with pytest.raises(ContractError, match="sample times"):
        sample_at(wild(rng), times, fps=30.0)


@pytest.mark.parametrize("fps", [0.0, -3.0, np.inf, np.nan])
def test_bad_rates_are_refused(wild, rng, fps):
    with pytest.raises(ContractError, match="frames per second"):
        resample(wild(rng), fps)


def test_bad_cutoff_is_refused(wild, rng):
    with pytest.raises(ContractError, match="cutoff"):
        low_pass(wild(rng), 0.0)


@pytest.mark.parametrize("length", [1.0 - 4.9e-7, 1.0 + 4.9e-7])
def test_frames_in_between_are_unit_where_those_beside_them_just_pass_for_it(biped, length):
    frames = 12
    turns = quat.exp(np.linspace(0, 1, frames)[:, None, None] * np.ones((len(biped()), 3)))
    clip = MotionClip(biped(), length * turns, np.zeros((frames, 3)), 60.0)
    between = sample_at(clip, np.arange(frames - 1) / 60.0 + 0.4 / 60.0, fps=60.0).rotations
    np.testing.assert_allclose(np.linalg.norm(between, axis=-1), 1.0, atol=1e-15)
