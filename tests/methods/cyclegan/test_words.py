"""Cutting clips into words, putting them together, and smoothing."""

from __future__ import annotations

import numpy as np
import pytest

from benchmark.commands.conformance.figures import ADULT, CHILD, perform
from benchmark.errors import ConfigError
from benchmark.motion import quat
from benchmark.motion.canonical import heading
from benchmark.motion.windows import overlap_add_quat
from methods.cyclegan.smoothing import butterworth, hampel, smooth_rotations
from methods.cyclegan.training import WordTable
from methods.cyclegan.words import Domain, PairSampler, at_rate, cut_clip, on_body, turned, word_reference

CUT = {"length": 60, "hop": 20}


def clips(style: str, takes=(1, 2)):
    body = perform("walk", CHILD, 1).skeleton
    return [on_body(perform(action, style, take), body, 60.0) for action in ("walk", "wave") for take in takes]


def facing(clip, yaw: float):
    return clip.replace(rotations=turned(clip.rotations, np.full(len(clip), yaw)))


@pytest.mark.parametrize("frames", [2, 41, 60, 61, 79, 80, 150])
def test_words_put_together_again_are_the_clip(frames):
    clip = facing(perform("walk", ADULT, 1), 1.3).frames(0, frames)
    reference = word_reference([clip], **CUT)
    cut = cut_clip(clip, reference, **CUT)
    back = overlap_add_quat(cut.restored(cut.windows.array))
    assert back.shape == clip.rotations.shape
    assert float(quat.angle(back, clip.rotations).max()) < 1e-6


def test_heading_is_taken_out_at_the_first_frame_only():
    clip = perform("walk", ADULT, 1)
    turn = np.linspace(0.0, 2.0, len(clip))
    turning = clip.replace(rotations=turned(clip.rotations, turn))
    cut = cut_clip(turning, None, **CUT)
    assert np.allclose(cut.yaw, heading(turning)[cut.windows.starts])
    words = [clip.replace(rotations=quat.normalize(word), root=np.zeros((60, 3))) for word in cut.windows.array]
    for word in words[1:-1]:
        start, end = heading(word)[[5, 54]]
        assert abs(start) < 0.25
        # The turn within the word is still there.
        assert end - start == pytest.approx(49 * 2.0 / (len(clip) - 1), abs=0.25)


def test_signs_and_facing_of_a_clip_do_not_change_its_words():
    clip = perform("walk", ADULT, 1)
    reference = word_reference([clip], **CUT)
    expected = cut_clip(clip, reference, **CUT).windows.array
    for other in (clip.replace(rotations=-clip.rotations), facing(clip, 2.5), facing(clip, -3.0)):
        assert np.allclose(cut_clip(other, reference, **CUT).windows.array, expected, atol=1e-6)


def test_domain_holds_the_words_of_all_clips():
    held = [*clips(ADULT), perform("jump", ADULT, 1).frames(0, 30)]
    body = held[0].skeleton
    held[-1] = on_body(held[-1], body, 60.0)
    reference = word_reference(held, **CUT)
    domain = Domain.of(held, reference, ["jump", "walk", "wave"], **CUT)
    expected = np.concatenate([cut_clip(clip, reference, **CUT).windows.array for clip in held])
    assert len(domain) == len(expected)
    got = WordTable(domain).words(np.arange(len(domain))).double().numpy()
    assert float(np.abs(got).max()) == pytest.approx(1.0, abs=1e-5)
    restored = (got * domain.scale.scale + domain.scale.offset).transpose(3, 2, 0, 1)
    assert np.allclose(restored, expected, atol=1e-5)
    mean, spread = WordTable(domain).moments(least=0.05)
    assert np.allclose(mean.numpy(), got.mean(axis=(2, 3)), atol=1e-5)
    assert np.allclose(spread.numpy(), np.maximum(got.std(axis=(2, 3)), 0.05), atol=1e-4)
    for number in domain.neighbours():
        turn = float(WordTable(domain).turn(np.array([number])))
        one = turned(expected[number], np.zeros(60))[20:]
        two = turned(expected[number + 1], np.full(60, turn))[:40]
        assert float(quat.angle(one, two).max()) < 1e-4


def test_short_clips_are_left_out_where_there_are_longer_ones():
    long, short = perform("walk", ADULT, 1), perform("walk", ADULT, 2).frames(0, 30)
    short = on_body(short, long.skeleton, 60.0)
    reference = word_reference([long, short], **CUT)
    assert set(Domain.of([long, short], reference, ["walk"], **CUT).clip.tolist()) == {0}


def test_pairs_show_the_same_action_uniformly():
    source, target = clips(ADULT, (1, 2)), clips(CHILD, (1,))
    reference = word_reference([*source, *target], **CUT)
    ours = Domain.of(source, reference, ["walk", "wave"], **CUT)
    theirs = Domain.of(target, reference, ["walk", "wave"], **CUT)
    sampler = PairSampler(ours, theirs)
    assert len(sampler) == max(len(ours), len(theirs))
    drawn = sampler.draw(2000, np.random.default_rng(0))
    assert np.array_equal(ours.action[drawn[:, 0]], theirs.action[drawn[:, 1]])
    assert abs(np.mean(ours.action[drawn[:, 0]]) - 0.5) < 0.05
    counts = np.bincount(ours.clip[drawn[:, 0]], minlength=4)
    assert counts.min() > 400
    assert set(drawn[:, 0].tolist()) == set(range(len(ours)))
    adjacent = PairSampler(ours, theirs, adjacent=True).draw(500, np.random.default_rng(0))
    assert set(adjacent[:, 0].tolist()) <= set(ours.neighbours().tolist())
    other = Domain.of([clip for clip in target if clip.meta.action == "wave"], reference, ["walk", "wave"], **CUT)
    walks = Domain.of([clip for clip in source if clip.meta.action == "walk"], reference, ["walk", "wave"], **CUT)
    free = PairSampler(walks, other)
    assert not free.conditional
    assert free.draw(10, np.random.default_rng(0)).shape == (10, 2)


@pytest.mark.parametrize("fps", [25.0, 30.0, 60.0, 120.0])
def test_another_rate_covers_the_whole_clip(fps):
    clip = perform("walk", ADULT, 1, fps=fps)
    other = at_rate(clip, 60.0)
    assert other.fps == 60.0
    assert 0.0 <= other.duration - clip.duration < 1.0 / 60.0


def test_peaks_are_replaced_and_nothing_else():
    t = np.arange(120) / 60.0
    smooth = np.stack([np.sin(2.0 * t), 0.3 * np.cos(3.0 * t)], axis=1)
    spiked = smooth.copy()
    spiked[[0, 31, 90, 119], 0] += [0.9, -0.8, 1.1, 0.7]
    cleaned = hampel(spiked)
    assert float(np.abs(cleaned - smooth)[[0, 31, 90, 119], 0].max()) < 0.12
    assert np.array_equal(cleaned[:, 1], hampel(smooth)[:, 1])
    rest = np.setdiff1d(np.arange(120), [0, 31, 90, 119])
    assert float(np.abs(cleaned - smooth)[rest].max()) < 0.03
    still = np.zeros((20, 3))
    still[7, 1] = 0.5
    assert not hampel(still).any()
    assert np.array_equal(hampel(smooth[:2]), smooth[:2])
    with pytest.raises(ConfigError, match="odd number"):
        hampel(smooth, window=4)


def test_low_pass_has_no_phase_and_half_the_amplitude_at_its_cutoff():
    """Methods section 5.6: a second-order design at 7 Hz, run both ways, leaves 0.500 at 7 Hz and 60 fps."""
    t = np.arange(1200) / 60.0
    inner = slice(300, 900)
    for hertz, expected in ((0.5, 1.0), (7.0, 0.5), (20.0, 0.0)):
        wave = np.sin(2.0 * np.pi * hertz * t)
        out = butterworth(wave, 60.0, cutoff=7.0)
        gain = float(out[inner] @ wave[inner] / (wave[inner] @ wave[inner]))
        assert gain == pytest.approx(expected, abs=5e-3)
        assert float(np.abs(out - gain * wave)[inner].max()) < 5e-3
    assert np.allclose(butterworth(np.ones((30, 2)), 60.0), 1.0, atol=1e-9)
    assert butterworth(np.ones((1, 2)), 60.0).shape == (1, 2)
    noise = np.random.default_rng(0).normal(size=(50, 2))
    assert np.array_equal(butterworth(noise, 12.0, cutoff=7.0), noise)
    with pytest.raises(ConfigError, match="positive"):
        butterworth(noise, 60.0, cutoff=0.0)


def test_smoothed_rotations_are_unit_and_do_not_care_about_signs():
    clip = perform("walk", ADULT, 1)
    rng = np.random.default_rng(0)
    rough = quat.normalize(clip.rotations + rng.normal(0.0, 0.03, clip.rotations.shape))
    out = smooth_rotations(rough, clip.fps)
    assert float(np.abs(np.linalg.norm(out, axis=-1) - 1.0).max()) < 1e-12
    flipped = rough * np.where(rng.random(rough.shape[:2]) < 0.5, -1.0, 1.0)[..., None]
    assert float(quat.angle(smooth_rotations(flipped, clip.fps), out).max()) < 1e-6
    assert quat.angle(out, clip.rotations).mean() < 0.6 * quat.angle(rough, clip.rotations).mean()
    assert float(quat.angle(smooth_rotations(rough, clip.fps, peaks=False, cutoff=0.0), rough).max()) < 1e-6
