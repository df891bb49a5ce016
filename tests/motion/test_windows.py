from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.errors import ConfigError, ContractError
from benchmark.motion import quat
from benchmark.motion.windows import WEIGHTS, cut, overlap_add, overlap_add_quat

_cuts = st.integers(1, 80).flatmap(
    lambda length: st.tuples(st.integers(1, 250), st.just(length), st.integers(1, length), st.integers(0, 2**32 - 1))
)


@settings(max_examples=80, deadline=None)
@given(_cuts, st.sampled_from(WEIGHTS))
def test_overlap_add_undoes_cut_for_any_length(sizes, weights):
    frames, length, hop, seed = sizes
    array = np.random.default_rng(seed).normal(size=(frames, 3, 2))
    windows = cut(array, length, hop)
    np.testing.assert_allclose(overlap_add(windows, weights=weights), array, atol=1e-12)


@settings(max_examples=60, deadline=None)
@given(_cuts, st.sampled_from(WEIGHTS))
def test_quaternions_survive_any_signs_of_the_windows(sizes, weights):
    frames, length, hop, seed = sizes
    rng = np.random.default_rng(seed)
    q = quat.unroll(quat.normalize(rng.normal(size=(frames, 4, 4))))
    windows = cut(q, length, hop)
    signs = rng.choice([-1.0, 1.0], size=(len(windows), 1, 4, 1))
    signs[0] = 1.0
    out = overlap_add_quat(windows.with_array(windows.array * signs), weights=weights)
    np.testing.assert_allclose(out, q, atol=1e-9)


@settings(max_examples=60, deadline=None)
@given(_cuts)
def test_the_cut_itself(sizes):
    frames, length, hop, _ = sizes
    windows = cut(np.arange(frames), length, hop)
    assert len(windows) == max(0, -(-(frames - length) // hop)) + 1  # methods 1.4
    assert windows.array.shape == windows.mask.shape == (len(windows), length)
    if frames >= length:
        assert windows.mask.all()
        assert windows.starts[0] == 0 and windows.starts[-1] == frames - length
        assert np.all(np.diff(windows.starts)[:-1] == hop)
        assert np.all((np.diff(windows.starts) > 0) & (np.diff(windows.starts) <= hop))
    else:
        assert windows.mask.sum() == frames
    assert set(windows.array[windows.mask]) == set(range(frames))


def test_short_clips_are_held_on_both_sides():
    windows = cut(np.array([3.0, 4.0, 5.0]), 8, 2)
    assert windows.array.tolist() == [[3, 3, 3, 4, 5, 5, 5, 5]]
    assert windows.mask[0].tolist() == [False, False, True, True, True, False, False, False]
    assert windows.starts.tolist() == [-2]


def test_coverage_of_the_paper_words():
    """60 frames every 20: inside three words show each frame, the first and last 20 frames one."""
    windows = cut(np.arange(200), 60, 20)
    shown = np.bincount(windows.array.ravel())
    assert np.all(shown[:20] == 1) and np.all(shown[-20:] == 1) and np.all(shown[40:-40] == 3)


def test_held_rows_do_not_count():
    windows = cut(np.array([[1.0], [2.0]]), 6, 3)
    spoiled = np.where(windows.mask[..., None], windows.array, 99.0)
    assert overlap_add(windows.with_array(spoiled)).ravel().tolist() == [1.0, 2.0]


def test_ones_average_and_hann_fades():
    windows = cut(np.zeros((30, 1)), 20, 10)
    two = windows.with_array(np.concatenate([np.zeros((1, 20, 1)), np.ones((1, 20, 1))]))
    plain = overlap_add(two)[:, 0]
    assert np.all(plain[:10] == 0) and np.all(plain[10:20] == 0.5) and np.all(plain[20:] == 1)
    for weights in ("hann", "triangular"):
        faded = overlap_add(two, weights=weights)[:, 0]
        assert np.all(np.diff(faded) >= 0) and np.abs(np.diff(faded)).max() < 0.2


def test_quaternion_blend_is_halfway():
    a, b = quat.identity(1, 20, 1), np.broadcast_to(quat.exp([0.6, 0.0, 0.0]), (1, 20, 1, 4))
    windows = cut(quat.identity(30, 1), 20, 10).with_array(np.concatenate([a, -b]))
    out = overlap_add_quat(windows)
    np.testing.assert_allclose(quat.angle(out[10:20], quat.exp([0.3, 0.0, 0.0])), 0.0, atol=1e-9)
    np.testing.assert_allclose(quat.angle(out[20:], b[0, :10]), 0.0, atol=1e-7)
    np.testing.assert_allclose(np.linalg.norm(out, axis=-1), 1.0)


@pytest.mark.parametrize(("length", "hop"), [(0, 1), (5, 0), (5, 6)])
def test_cuts_with_gaps_are_refused(length, hop):
    with pytest.raises(ConfigError, match="hop"):
        cut(np.zeros(10), length, hop)


def test_other_mistakes_are_refused():
    with pytest.raises(ContractError, match="empty"):
        cut(np.zeros((0, 3)), 5, 1)
    windows = cut(np.zeros((10, 3)), 5, 1)
    with pytest.raises(ConfigError, match="hann"):
        overlap_add(windows, weights="cosine")
    with pytest.raises(ContractError, match="contents"):
        windows.with_array(np.zeros((2, 5, 3)))
