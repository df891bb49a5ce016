"""Standardising, and what a joint's models leave unexplained."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from methods.hsu.lti import StateSpace, fit_lti
from methods.hsu.model import Scale, StyleModel, fit_style

FLAT = Scale(np.zeros((2, 3)), np.ones((2, 3)))


def curves(rng: np.random.Generator, frames: int = 120) -> np.ndarray:
    """Smooth channels (frames, 2, 3) of about unit size."""
    t = np.linspace(0.0, 2.0 * np.pi, frames)[:, None, None]
    return np.sqrt(2.0) * np.sin(rng.integers(1, 5, (2, 3)) * t + rng.uniform(0.0, 2.0 * np.pi, (2, 3)))


def static(inputs, outputs):
    return fit_lti(list(inputs), list(outputs), 0), {}


def spread(records) -> np.ndarray:
    return np.sum(np.var(np.concatenate(records), axis=0), axis=-1)


def test_standardising_and_back(rng: np.random.Generator) -> None:
    clips = [rng.normal(3.0, 2.0, (50, 2, 3)), rng.normal(3.0, 2.0, (30, 2, 3))]
    for clip in clips:
        clip[:, 1, 2] = 0.7  # never moves
    scale = Scale.of(clips)
    values = np.concatenate([scale.standardise(clip) for clip in clips])
    np.testing.assert_allclose(values.mean(axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(values.std(axis=0).ravel(), [1.0] * 5 + [0.0], atol=1e-12)
    np.testing.assert_allclose(scale.restore(scale.standardise(clips[0])), clips[0], atol=1e-12)


@given(st.floats(0.0, 1.0), st.integers(0, 1000))
@settings(max_examples=25, deadline=None)
def test_results_spread_as_the_target_does_however_loose_the_tie(tie: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    inputs = [curves(rng) for _ in range(8)]
    outputs = [tie * u + (1.0 - tie) * curves(rng) for u in inputs]
    filled, _ = fit_style(inputs, outputs, FLAT, FLAT, static, spread="source", limit=4.0)
    plain, _ = fit_style(inputs, outputs, FLAT, FLAT, static, spread="none", limit=4.0)
    np.testing.assert_allclose(spread([filled.respond(u) for u in inputs]), spread(outputs), rtol=1e-6)
    assert np.all(spread([plain.respond(u) for u in inputs]) <= spread(outputs) * (1.0 + 1e-9))
    assert np.all(filled.own >= 0.0)


def test_a_close_tie_needs_nothing_of_the_source(rng: np.random.Generator) -> None:
    inputs = [curves(rng) for _ in range(4)]
    model, _ = fit_style(inputs, [2.0 * u for u in inputs], FLAT, FLAT, static, spread="source", limit=4.0)
    np.testing.assert_allclose(model.own, 0.0, atol=1e-6)
    np.testing.assert_allclose(model.respond(inputs[0]), 2.0 * inputs[0], atol=1e-9)


def test_no_tie_gives_the_source_on_the_targets_scale(rng: np.random.Generator) -> None:
    noise = [rng.normal(size=(400, 2, 3)) for _ in range(10)]
    other = [rng.normal(size=(400, 2, 3)) for _ in range(10)]
    model, _ = fit_style(noise, other, FLAT, FLAT, static, spread="source", limit=4.0)
    np.testing.assert_allclose(model.respond(noise[0]), noise[0], atol=0.5)


def test_arrays_and_back(rng: np.random.Generator) -> None:
    still = Scale(FLAT.mean, FLAT.std * [[1.0], [0.0]])
    model = StateSpace(np.array([[0.5]]), np.ones((1, 3)), np.ones((3, 1)), np.eye(3))
    style = StyleModel(FLAT, still, (model, None), np.array([0.3, 0.0]), -np.ones((2, 3)), np.ones((2, 3)))
    again = StyleModel.from_arrays(style.arrays())
    values = rng.normal(size=(20, 2, 3))
    np.testing.assert_array_equal(again.translate(values)[0], style.translate(values)[0])
    assert again.joints[1] is None
    np.testing.assert_array_equal(style.translate(values)[0][:, 1], 0.0)


def test_limits_are_counted() -> None:
    model = StateSpace.static(np.eye(3))
    style = StyleModel(FLAT, FLAT, (model, model), np.zeros(2), -np.ones((2, 3)), np.ones((2, 3)))
    values = np.zeros((10, 2, 3))
    values[3, 0, 0] = 5.0
    out, share = style.translate(values)
    assert out.max() == 1.0
    assert share == pytest.approx(1.0 / 60.0)
