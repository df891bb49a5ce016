"""Which moment each frame shows."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from reports.video.timeline import CARD_SECONDS, schedule


def test_once_through_ends_on_the_last_frame():
    times = schedule(2.0, 30, None)
    assert len(times) == 61
    assert times[0] == 0.0
    assert times[-1] == 2.0


def test_a_long_clip_is_cut():
    times = schedule(30.0, 30, 10.0)
    assert len(times) == 300
    np.testing.assert_allclose(np.diff(times), 1 / 30)


def test_a_short_clip_starts_again_after_a_card():
    times = schedule(3.0, 30, 10.0)
    card = np.flatnonzero(np.isnan(times))
    assert len(times) == 300
    # 3 s and a frame, a card of a second, and so on: two cards and three showings, the last one cut.
    assert card.tolist() == [*range(91, 121), *range(212, 242)]
    np.testing.assert_array_equal(times[121:212], times[:91])
    np.testing.assert_array_equal(times[242:], times[:58])


def test_nothing_is_shown_again_for_less_than_a_second():
    times = schedule(8.5, 30, 10.0)
    assert len(times) == 300
    assert not np.isnan(times).any()
    assert (times[256:] == times[255]).all()


def test_without_a_card_it_starts_again_at_once():
    times = schedule(3.0, 30, 10.0, card=False)
    assert not np.isnan(times).any()
    assert times[91] == 0.0


@given(st.floats(0.0, 20.0), st.integers(1, 120), st.floats(0.05, 30.0), st.booleans())
def test_length_and_range(duration, fps, seconds, card):
    times = schedule(duration, fps, seconds, card=card)
    assert len(times) == max(round(seconds * fps), 1)
    shown = times[~np.isnan(times)]
    assert len(shown)
    assert shown.min() == 0.0
    assert shown.max() <= duration + 1e-6
    if np.isnan(times).any():
        assert not np.isnan(times[0])
        assert np.isnan(times).sum() % max(round(CARD_SECONDS * fps), 1) == 0 or np.isnan(times[-1])


@pytest.mark.parametrize("frames", [1, 2])
def test_a_still_clip_is_held(frames):
    times = schedule((frames - 1) / 30, 30, 3.0)
    assert len(times) == 90
