from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmark.api import FitContext, NotApplicableError, Sample, StyleTask
from benchmark.commands.conformance.figures import MEASURED_ACTIONS, SmallView, perform
from benchmark.errors import ContractError
from benchmark.motion.clip import MotionClip
from benchmark.motion.resample import resample
from benchmark.motion.retarget import retarget
from eval.metrics.gram import (
    ContentGramDistance,
    ContentSimilarity,
    StyleGramDistance,
    StyleSimilarity,
    gram,
    gram_distance,
)
from eval.probes.encoder import MotionEncoder


class QuickEncoder(MotionEncoder):
    """Trained for a moment."""

    steps = 15


@pytest.fixture(scope="module")
def probes() -> dict[str, MotionEncoder]:
    view = SmallView(
        tuple(perform(a, style, take) for a in MEASURED_ACTIONS for style in ("adult", "child") for take in (1, 2))
    )
    task = StyleTask("adult", "child")
    return {"motion-encoder": QuickEncoder().fit(view, task, rng=np.random.default_rng(0), ctx=FitContext())}


def sample(probes, clip: MotionClip, *references: MotionClip) -> Sample:
    source = perform(clip.meta.action, "adult", 5)
    return Sample(clip, source, references, None, StyleTask("adult", "child"), probes=probes)


def test_gram_by_hand() -> None:
    hidden = np.array([[1.0, 2.0], [3.0, 0.0]])
    np.testing.assert_allclose(gram(hidden), [[5.0, 1.0], [1.0, 2.0]])
    assert gram_distance(np.array([[1.0, 0.0]]), np.array([[0.0, 1.0]])) == pytest.approx(np.sqrt(2.0))
    assert gram_distance(np.array([[2.0]]), np.array([[1.0]])) == pytest.approx(1.5)
    assert gram_distance(np.zeros((3, 2)), np.zeros((5, 2))) == 0.0
    assert np.isfinite(gram_distance(np.zeros((3, 2)), np.ones((5, 2))))


def test_gram_does_not_know_order_and_repetition(rng: np.random.Generator) -> None:
    hidden = rng.normal(size=(40, 6))
    np.testing.assert_allclose(gram(np.tile(hidden, (3, 1))), gram(hidden))
    np.testing.assert_allclose(gram(rng.permutation(hidden)), gram(hidden))
    other = rng.normal(size=(25, 6))
    assert gram_distance(hidden, other) == pytest.approx(gram_distance(other, hidden))
    assert gram_distance(3.0 * hidden, 3.0 * other) == pytest.approx(gram_distance(hidden, other))


def test_a_motion_shown_twice_is_the_same_motion(probes) -> None:
    clip = perform("walk", "child", 1)
    # Played forward and then backward twice, so that nothing jumps where it repeats.
    there = np.concatenate([clip.rotations, clip.rotations[::-1]])
    root = np.concatenate([clip.root, clip.root[::-1]])
    once = clip.replace(rotations=there, root=root)
    twice = clip.replace(rotations=np.tile(there, (2, 1, 1)), root=np.tile(root, (2, 1)))
    encoder = probes["motion-encoder"]
    other = perform("wave", "child", 1)
    same = gram_distance(encoder.hidden(once), encoder.hidden(twice))
    assert same < 0.1 * gram_distance(encoder.hidden(once), encoder.hidden(other))


def test_the_two_ends(probes) -> None:
    """The source is all content and no style, a real performance is all style; the shares add up to one."""
    child, source = perform("walk", "child", 3), perform("walk", "adult", 5)
    at_source = sample(probes, source, child)
    assert ContentGramDistance().compute(at_source) == 0.0
    assert StyleSimilarity().compute(at_source) == 1.0
    assert ContentSimilarity().compute(at_source) == 0.0
    at_target = sample(probes, child, child)
    assert StyleGramDistance().compute(at_target) == 0.0
    assert StyleSimilarity().compute(at_target) == 0.0
    assert ContentGramDistance().compute(at_target) == StyleGramDistance().compute(at_source) > 0.1


def test_shares_are_those_of_equations_16_and_17(probes) -> None:
    between = sample(probes, perform("walk", "child", 2), perform("walk", "child", 9))
    style, content = StyleGramDistance().compute(between), ContentGramDistance().compute(between)
    assert style > 0.0 and content > 0.0
    assert StyleSimilarity().compute(between) == pytest.approx(style / (style + content))
    assert ContentSimilarity().compute(between) == pytest.approx(content / (style + content))
    assert StyleSimilarity().compute(between) < 0.5 < ContentSimilarity().compute(between)


def test_style_is_the_median_over_references(probes) -> None:
    clip = perform("walk", "child", 2)
    references = [perform("walk", "child", 4), perform("walk", "adult", 7), perform("wave", "adult", 7)]
    single = [StyleGramDistance().compute(sample(probes, clip, each)) for each in references]
    assert single[0] < single[1] < single[2]
    assert StyleGramDistance().compute(sample(probes, clip, *references)) == single[1]


def test_size_and_frame_rate_do_not_matter(probes) -> None:
    clip, child = perform("jump", "adult", 2), perform("jump", "child", 3)
    small = MotionClip(clip.skeleton.scaled(0.6), clip.rotations, 0.6 * clip.root, clip.fps, clip.meta)
    for metric in (StyleGramDistance(), ContentGramDistance(), StyleSimilarity(), ContentSimilarity()):
        value = metric.compute(sample(probes, clip, child))
        assert metric.compute(sample(probes, small, child)) == pytest.approx(value, abs=1e-9)
        assert metric.compute(sample(probes, resample(clip, 30.0), child)) == pytest.approx(value, abs=1e-9)
        # The body differs, the motion hardly does.
        moved = retarget(clip, child.skeleton)
        assert metric.compute(sample(probes, moved, child)) == pytest.approx(value, abs=0.02)


def test_what_has_no_value(probes) -> None:
    clip = perform("walk", "adult", 5)
    with pytest.raises(NotApplicableError, match="no real child clip"):
        StyleGramDistance().compute(sample(probes, clip))
    assert np.isfinite(ContentGramDistance().compute(sample(probes, clip)))
    with pytest.raises(NotApplicableError, match="are the same"):
        StyleSimilarity().compute(sample(probes, clip, clip))
    with pytest.raises(ContractError, match="not a MotionEncoder"):
        StyleGramDistance().compute(replace(sample(probes, clip, clip), probes={"motion-encoder": object()}))


@pytest.mark.parametrize("frames", [1, 2, 7])
def test_short_clips_have_a_value(probes, frames: int) -> None:
    clip = perform("walk", "adult", 2).frames(0, frames)
    assert 0.0 < ContentGramDistance().compute(sample(probes, clip)) < 10.0
