"""Ratios of durations, and rates from time warps and back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from methods.hsu.timing import MAX_RATE, cues, duration_ratio, rate_of, retimed


def test_every_action_counts_once() -> None:
    source = {"walk": [2.0, 2.0, 2.0], "jump": [1.0], "only-adults": [9.0]}
    target = {"walk": [1.0] * 7, "jump": [4.0], "only-children": [1.0]}
    assert duration_ratio(source, target) == pytest.approx(np.sqrt(0.5 * 4.0))


def test_without_common_actions_or_with_takes_of_no_length_nothing_changes() -> None:
    assert duration_ratio({"walk": [1.0]}, {"jump": [2.0]}) == 1.0
    assert duration_ratio({"walk": [0.0]}, {"walk": [2.0]}) == 1.0


@pytest.mark.parametrize("factor", [0.6, 1.0, 1.7])
def test_a_steady_warp_has_a_steady_rate(factor: float) -> None:
    frames = 200
    position = np.linspace(0, frames - 1, round(factor * frames))
    rate = np.exp(rate_of(position, frames, 30.0))
    np.testing.assert_allclose(rate[20:-20], factor, rtol=0.03)


def test_rates_are_bounded() -> None:
    position = np.concatenate([np.zeros(500), np.linspace(0, 99, 20)])
    rate = np.exp(rate_of(position, 100, 30.0))
    assert rate.max() == pytest.approx(MAX_RATE)
    assert rate.min() == pytest.approx(1.0 / MAX_RATE)


def test_retiming_undoes_a_warp() -> None:
    """The clock read off a warp, played back, is the warp."""
    frames, fps = 300, 30.0
    speed = 1.0 + 0.4 * np.sin(np.linspace(0.0, 2.0 * np.pi, 360))
    position = np.cumsum(speed)
    position = (position - position[0]) / (position[-1] - position[0]) * (frames - 1)
    times = retimed(rate_of(position, frames, fps), fps)
    assert len(times) == pytest.approx(360, abs=8)
    found = np.interp(np.linspace(0, 1, 100), np.linspace(0, 1, len(times)), times * fps)
    wanted = np.interp(np.linspace(0, 1, 100), np.linspace(0, 1, 360), position)
    assert np.abs(found - wanted).max() < 6.0


@given(st.lists(st.floats(-3.0, 3.0), min_size=1, max_size=60))
@settings(max_examples=60, deadline=None)
def test_times_never_decrease_and_stay_within_the_clip(log_rate: list[float]) -> None:
    times = retimed(np.array(log_rate), 30.0)
    assert times[0] == 0.0
    assert np.all(np.diff(times) >= 0.0)
    assert times[-1] <= (len(log_rate) - 1) / 30.0 + 1e-9


def test_cues_of_a_single_frame_are_still() -> None:
    found = cues(np.ones((1, 4, 3)), 30.0)
    np.testing.assert_array_equal(found, [[1.0, 0.0, 0.0]])
