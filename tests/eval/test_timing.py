from __future__ import annotations

import numpy as np
import pytest

from benchmark.api import NotApplicableError, Sample, StyleTask
from benchmark.commands.conformance.figures import figure, perform, walk, wave
from benchmark.motion import quat
from benchmark.motion.clip import MotionClip
from benchmark.motion.resample import resample
from eval.metrics.timing import DurationRatio, TempoRatio, tempo

BODY = figure(0.8)


def sample(clip: MotionClip, *references: MotionClip) -> Sample:
    return Sample(clip, clip, references, None, StyleTask("adult", "child"))


def jump(seconds: float = 3.0) -> MotionClip:
    """One crouch of a second's half in the middle of standing still."""
    clip = wave(BODY, seconds=seconds, swing=0.0)
    t = clip.times
    depth = np.where(np.abs(t - 0.5 * seconds) < 0.25, 0.5 + 0.5 * np.cos(4.0 * np.pi * (t - 0.5 * seconds)), 0.0)
    return clip.replace(root=clip.root - np.stack([0.0 * t, 0.3 * depth, 0.0 * t], axis=1))


@pytest.mark.parametrize("hertz", [0.75, 1.0, 1.7, 2.6, 4.0])
@pytest.mark.parametrize("fps", [30.0, 60.0, 120.0])
def test_tempo_of_a_wave(hertz: float, fps: float) -> None:
    assert tempo(wave(BODY, tempo=hertz, fps=fps, seconds=4.0)) == pytest.approx(hertz, rel=0.01)


@pytest.mark.parametrize("hertz", [0.7, 1.1])
def test_tempo_of_walking_is_strides_not_steps(hertz: float) -> None:
    assert tempo(walk(BODY, tempo=hertz, seconds=5.0)) == pytest.approx(hertz, rel=0.01)


def test_tempo_in_noise(rng: np.random.Generator) -> None:
    clip = walk(BODY, tempo=0.9, seconds=5.0)
    shake = quat.exp(0.05 * rng.standard_normal((*clip.rotations.shape[:2], 3)))
    noisy = clip.replace(rotations=quat.normalize(quat.mul(clip.rotations, shake)))
    assert tempo(noisy) == pytest.approx(0.9, rel=0.02)


def test_tempo_survives_a_drift_and_a_turn() -> None:
    clip = wave(BODY, tempo=1.5, seconds=4.0)
    turn = quat.from_axis_angle(np.array([0.0, 1.0, 0.0]), np.linspace(0.0, 3.0, len(clip)))
    rotations = clip.rotations.copy()
    rotations[:, 0] = quat.mul(turn, rotations[:, 0])
    moved = clip.replace(rotations=rotations, root=clip.root + np.linspace(0.0, 2.0, len(clip))[:, None] * [1, 0.05, 1])
    assert tempo(moved) == pytest.approx(1.5, rel=0.01)


def test_tempo_ratio() -> None:
    value = TempoRatio().compute(sample(wave(BODY, tempo=1.2), wave(BODY, tempo=1.6)))
    assert value == pytest.approx(0.75, rel=0.01)
    clip = walk(BODY)
    assert TempoRatio().compute(sample(clip, clip)) == 1.0


def test_tempo_does_not_depend_on_the_frame_rate() -> None:
    clip = perform("walk", "child", 1)
    assert tempo(resample(clip, 30.0)) == pytest.approx(tempo(clip), rel=0.01)


@pytest.mark.parametrize("make", [jump, lambda: wave(BODY, swing=0.0), lambda: wave(BODY, tempo=0.3, seconds=3.0)])
def test_what_does_not_repeat_has_no_tempo(make) -> None:
    with pytest.raises(NotApplicableError, match="does not repeat"):
        tempo(make())


def test_tempo_of_one_frame() -> None:
    with pytest.raises(NotApplicableError):
        tempo(walk(BODY).frames(0, 1))


def test_references_that_do_not_repeat_do_not_count() -> None:
    value = TempoRatio().compute(sample(wave(BODY, tempo=1.2), jump(), wave(BODY, tempo=1.2)))
    assert value == pytest.approx(1.0, rel=0.001)


def test_duration_ratio() -> None:
    clips = [walk(BODY, seconds=s) for s in (2.0, 3.0, 8.0)]
    value = DurationRatio().compute(sample(walk(BODY, seconds=1.5), *clips))
    assert value == pytest.approx((1.5 - 1 / 60) / (3.0 - 1 / 60))


def test_duration_of_one_frame() -> None:
    with pytest.raises(NotApplicableError, match="single frame"):
        DurationRatio().compute(sample(walk(BODY).frames(0, 1), walk(BODY)))
