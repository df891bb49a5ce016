from __future__ import annotations

import numpy as np
import pytest

from benchmark.api import FitContext, NotApplicableError, StyleTask
from benchmark.commands.conformance.figures import MEASURED_ACTIONS, SmallView, perform
from benchmark.errors import StoreError
from benchmark.motion.clip import MotionClip
from benchmark.motion.resample import resample
from eval.features.kinematic import kinematic_features
from eval.features.sequence import pose_sequence
from eval.probes.encoder import MotionEncoder
from eval.probes.projection import Projection

TASK = StyleTask("adult", "child")
FEATURE_SETS = ("kinematic", "learned")
CLIPS = tuple(
    perform(action, style, take) for action in MEASURED_ACTIONS for style in ("adult", "child") for take in range(1, 6)
)


class QuickEncoder(MotionEncoder):
    """Trained for a moment."""

    steps = 15


def fitted(seed: int = 0) -> QuickEncoder:
    return QuickEncoder().fit(SmallView(CLIPS), TASK, rng=np.random.default_rng(seed), ctx=FitContext())


@pytest.fixture(scope="module")
def encoder() -> QuickEncoder:
    return fitted()


def test_the_plain_layers_are_the_trained_ones(encoder: QuickEncoder) -> None:
    """What is measured with is computed without torch; it must be what torch has trained."""
    import torch
    from torch.nn import functional

    clip = CLIPS[0]
    sequence = (pose_sequence(clip) - encoder.mean_) / encoder.deviation_
    x = torch.from_numpy(sequence[: len(sequence) // 4 * 4].T[None])
    layers = []
    for name, width in (("first", 15), ("second", 7)):
        weight, bias = (torch.from_numpy(encoder.weights_[f"{name}/{kind}"]).double() for kind in ("weight", "bias"))
        x = functional.max_pool1d(functional.relu(functional.conv1d(x, weight, bias, padding=width // 2)), 2)
        layers.append(x[0].T.numpy())
    hidden = encoder.hidden(clip)
    count = len(layers[0]) - 8  # the last frames see where the sequence was cut to a multiple of four
    np.testing.assert_allclose(hidden[:count], layers[0][:count], atol=1e-9)
    whole = perform("walk", "adult", 1).frames(0, 2 * 60)
    features = encoder.features(whole, "learned")
    x = torch.from_numpy(((pose_sequence(whole) - encoder.mean_) / encoder.deviation_).T[None])
    for name, width in (("first", 15), ("second", 7)):
        weight, bias = (torch.from_numpy(encoder.weights_[f"{name}/{kind}"]).double() for kind in ("weight", "bias"))
        x = functional.max_pool1d(functional.relu(functional.conv1d(x, weight, bias, padding=width // 2)), 2)
    pooled = np.concatenate([x[0].mean(dim=1).numpy(), x[0].std(dim=1, correction=0).numpy()])
    scale = np.sqrt(encoder.learned_.variances.mean())
    np.testing.assert_allclose(features[0], encoder.learned_.apply(pooled[None])[0] / scale, atol=1e-9)


def test_training_reduces_the_error() -> None:
    said: list[float] = []

    class Longer(MotionEncoder):
        steps = 60

    Longer().fit(
        SmallView(CLIPS),
        TASK,
        rng=np.random.default_rng(0),
        ctx=FitContext(report=lambda fraction, message: said.append(float(message.split()[-1]))),
    )
    assert len(said) == 60
    assert np.mean(said[-5:]) < 0.5 * np.mean(said[:5])


def test_the_same_generator_gives_the_same_encoder(encoder: QuickEncoder) -> None:
    again, other = fitted(), fitted(1)
    for which in FEATURE_SETS:
        np.testing.assert_array_equal(again.features(CLIPS[0], which), encoder.features(CLIPS[0], which))
    np.testing.assert_array_equal(again.hidden(CLIPS[0]), encoder.hidden(CLIPS[0]))
    assert np.abs(other.hidden(CLIPS[0]) - encoder.hidden(CLIPS[0])).max() > 1e-3


def test_the_number_of_threads_does_not_matter(encoder: QuickEncoder) -> None:
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        np.testing.assert_array_equal(fitted().hidden(CLIPS[0]), encoder.hidden(CLIPS[0]))
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)


def test_saved_and_loaded_it_is_the_same_bit_for_bit(encoder: QuickEncoder, tmp_path) -> None:
    encoder.save(tmp_path / "probe")
    loaded = MotionEncoder.load(tmp_path / "probe")
    for clip in (CLIPS[0], CLIPS[-1]):
        np.testing.assert_array_equal(loaded.hidden(clip), encoder.hidden(clip))
        for which in FEATURE_SETS:
            np.testing.assert_array_equal(loaded.features(clip, which), encoder.features(clip, which))
    loaded.save(tmp_path / "again")
    for name in ("arrays.npz", "facts.json"):
        assert (tmp_path / "again" / name).read_bytes() == (tmp_path / "probe" / name).read_bytes()


def test_a_damaged_folder_is_refused(encoder: QuickEncoder, tmp_path) -> None:
    with pytest.raises(StoreError, match="no probe"):
        MotionEncoder.load(tmp_path / "nothing")
    encoder.save(tmp_path)
    (tmp_path / "arrays.npz").write_bytes(b"not an archive")
    with pytest.raises(StoreError, match="fit again"):
        MotionEncoder.load(tmp_path)


@pytest.mark.parametrize("which", FEATURE_SETS)
def test_features_of_training_windows_have_mean_zero_and_variance_one_an_axis(encoder: QuickEncoder, which) -> None:
    features = np.concatenate([encoder.features(clip, which) for clip in CLIPS])
    np.testing.assert_allclose(features.mean(axis=0), 0.0, atol=1e-8)
    assert features.var(axis=0, ddof=1).mean() == pytest.approx(1.0)
    covariance = np.cov(features.T)
    np.testing.assert_allclose(covariance, np.diag(np.diag(covariance)), atol=1e-6)
    assert np.all(np.diff(np.diag(covariance)) <= 1e-9)
    assert len(features) >= 10 * features.shape[1]


def test_size_does_not_reach_the_encoder(encoder: QuickEncoder) -> None:
    clip = CLIPS[0]
    small = MotionClip(clip.skeleton.scaled(0.6), clip.rotations, 0.6 * clip.root, clip.fps)
    np.testing.assert_allclose(encoder.hidden(small), encoder.hidden(clip), atol=1e-9)
    for which in FEATURE_SETS:
        np.testing.assert_allclose(encoder.features(small, which), encoder.features(clip, which), atol=1e-6)
    np.testing.assert_allclose(
        encoder.features(resample(clip, 30.0), "learned"), encoder.features(clip, "learned"), atol=1e-9
    )


@pytest.mark.parametrize("frames", [1, 2, 3, 5, 59, 61, 118, 119, 121])
def test_clips_of_any_length(encoder: QuickEncoder, frames: int) -> None:
    clip = perform("walk", "adult", 9, fps=30.0).frames(0, frames)
    assert encoder.hidden(clip).shape == (-(-len(clip) // 2), 64)
    learned = encoder.features(clip, "learned")
    assert np.all(np.isfinite(learned))
    if frames >= 4:
        assert len(learned) == len(kinematic_features(clip))
    else:
        with pytest.raises(NotApplicableError):
            encoder.features(clip, "kinematic")


def test_too_little_to_learn_from() -> None:
    with pytest.raises(NotApplicableError, match="too few to learn"):
        QuickEncoder().fit(SmallView(CLIPS[:2]), TASK, rng=np.random.default_rng(0), ctx=FitContext())


def test_other_styles_are_not_looked_at(encoder: QuickEncoder) -> None:
    stranger = perform("walk", "adult", 1)
    from dataclasses import replace

    stranger = stranger.replace(meta=replace(stranger.meta, style="martian"))
    view = SmallView((*CLIPS, stranger))
    probe = QuickEncoder().fit(view, TASK, rng=np.random.default_rng(0), ctx=FitContext())
    np.testing.assert_array_equal(probe.mean_, encoder.mean_)


def test_projection_finds_the_axes_of_largest_variance(rng: np.random.Generator) -> None:
    turn = np.linalg.qr(rng.normal(size=(4, 4)))[0]
    features = (rng.normal(size=(500, 4)) * [5.0, 2.0, 1.0, 0.1]) @ turn.T + 7.0
    projection = Projection.fit(features, standardise=False, most=2)
    assert projection.axes.shape == (4, 2)
    np.testing.assert_allclose(np.abs(projection.axes.T @ turn[:, :2]), np.eye(2), atol=0.05)
    np.testing.assert_allclose(projection.variances, [25.0, 4.0], rtol=0.15)
    assert projection.apply(features).mean() == pytest.approx(0.0, abs=1e-9)


def test_a_standardised_projection_does_not_know_units(rng: np.random.Generator) -> None:
    features = rng.normal(size=(200, 5)) @ rng.normal(size=(5, 5))
    scale = np.array([1.0, 30.0, 0.05, 10.0, 1.0])
    one = Projection.fit(features, standardise=True).apply(features)
    two = Projection.fit(features * scale + 3.0, standardise=True).apply(features * scale + 3.0)
    np.testing.assert_allclose(one, two, atol=1e-8)


def test_a_column_that_never_moved_has_no_say(rng: np.random.Generator) -> None:
    features = np.concatenate([rng.normal(size=(200, 3)), np.full((200, 1), 0.5)], axis=1)
    projection = Projection.fit(features, standardise=True)
    assert projection.axes.shape == (4, 3)
    moved = features + [0.0, 0.0, 0.0, 0.2]
    np.testing.assert_allclose(projection.apply(moved), projection.apply(features), atol=1e-6)


def test_a_projection_has_one_axis_for_ten_rows(rng: np.random.Generator) -> None:
    assert Projection.fit(rng.normal(size=(57, 20)), standardise=True).axes.shape == (20, 5)
    assert Projection.fit(rng.normal(size=(5, 20)), standardise=True).axes.shape == (20, 1)
