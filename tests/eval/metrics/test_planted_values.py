"""Metrics against closed forms and against faults that were put there."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from benchmark.api import NotApplicableError, Sample, StyleTask
from benchmark.commands.conformance.figures import CHILD, figure, jump, perform, walk, wave
from benchmark.motion import quat
from benchmark.motion.clip import MotionClip
from benchmark.motion.resample import sample_at
from benchmark.motion.retarget import retarget
from eval.metrics.content import (
    HeadingDeviation,
    PhasePoseDistance,
    PoseDistance,
    PositionDistance,
    RoundTripError,
    compared_joints,
)
from eval.metrics.foot import Floating, FootSkateCommon
from eval.metrics.shared import STEP
from eval.metrics.smoothness import (
    JerkDeviation,
    LargestTurnRatio,
    LogDimensionlessJerk,
    largest_turn,
    log_dimensionless_jerk,
)
from eval.metrics.spectral import (
    PowerSpectrumDistance,
    SpectralArcLength,
    mean_arc_length,
    power_spectra,
    power_spectrum_distance,
    spectral_arc_length,
)
from eval.metrics.timing import TempoError, WarpDeviation
from eval.metrics.windowed import windows

BODY = figure(0.8)
UP = np.array([0.0, 1.0, 0.0])


def sample(clip: MotionClip, *references: MotionClip, source: MotionClip | None = None) -> Sample:
    return Sample(clip, source or clip, references, None, StyleTask("adult", "child"))


def rocking(amplitude: float, hertz: float, *, seconds: float = 6.0, fps: float = 60.0) -> MotionClip:
    """A stiff figure carried to and fro."""
    t = np.arange(round(seconds * fps) + 1) / fps
    root = np.stack([0.0 * t, np.ones_like(t), amplitude * np.sin(2.0 * np.pi * hertz * t)], axis=1)
    return MotionClip(BODY, quat.identity(len(t), len(BODY)), root, fps)


def bending(degrees: float, *, hertz: float = 1.0, late: float = 0.0, seconds: float = 4.0) -> MotionClip:
    """The left elbow swings to either side of a right angle."""
    t = np.arange(round(60.0 * seconds) + 1) / 60.0
    rotations = quat.identity(len(t), len(BODY))
    angle = np.radians(80.0 + degrees * np.sin(2.0 * np.pi * hertz * (t - late)))
    rotations[:, BODY.joint("left_elbow")] = quat.from_axis_angle(np.array([0.0, 0.0, 1.0]), angle)
    return MotionClip(BODY, rotations, np.tile([0.0, 1.0, 0.0], (len(t), 1)), 60.0)


def joint_turned(clip: MotionClip, degrees: float) -> MotionClip:
    rotations = np.array(clip.rotations)
    joint = clip.skeleton.joint("left_knee")
    turn = quat.from_axis_angle(np.array([0.6, 0.0, 0.8]), np.radians(degrees))
    rotations[:, joint] = quat.mul(rotations[:, joint], turn)
    return clip.replace(rotations=rotations)


def stretched(clip: MotionClip, factor: float) -> MotionClip:
    frames = round(clip.duration * factor * clip.fps) + 1
    return sample_at(clip, np.arange(frames) / clip.fps / factor, fps=clip.fps)


@pytest.mark.parametrize("frames", [1, 30, 60, 61, 62, 119, 500])
def test_windows_cover_every_frame_and_have_one_length(frames: int) -> None:
    spans = windows(frames, 60.0, 1.0)
    assert {stop - start for start, stop in spans} == {min(frames, 61)}
    assert spans[0][0] == 0
    assert spans[-1][1] == frames
    assert all(later[0] <= earlier[1] for earlier, later in pairwise(spans))


class TestContent:
    @pytest.mark.parametrize("degrees", [2.0, 25.0])
    def test_one_joint_turned_is_its_angle_over_the_joints(self, degrees: float) -> None:
        clip = wave(BODY)
        expected = degrees / len(compared_joints(BODY))
        turned = joint_turned(clip, degrees)
        assert PhasePoseDistance().compute(sample(turned, source=clip)) == pytest.approx(expected, rel=1e-6)
        there_and_back = replace(sample(clip), round_trip=turned)
        assert RoundTripError().compute(there_and_back) == pytest.approx(expected, rel=1e-6)

    def test_the_way_back_is_measured_on_the_source_s_body(self) -> None:
        clip = wave(BODY)
        elsewhere = retarget(clip, perform("wave", CHILD, 1).skeleton)
        assert RoundTripError().compute(replace(sample(clip), round_trip=elsewhere)) == pytest.approx(0.0, abs=1e-4)
        with pytest.raises(NotApplicableError, match="does not translate back"):
            RoundTripError().compute(sample(clip))

    @pytest.mark.parametrize("late", [0.05, 0.1, 0.2])
    def test_a_limb_that_comes_late(self, late: float) -> None:
        # The angle differs by 2 A sin(w d / 2) cos(w t + ...), whose mean size is 4 / pi A sin(w d / 2).
        source, clip = bending(30.0), bending(30.0, late=late)
        expected = 4.0 / np.pi * 30.0 * np.sin(np.pi * late) / len(compared_joints(BODY))
        assert PhasePoseDistance().compute(sample(clip, source=source)) == pytest.approx(expected, rel=0.02)
        assert PoseDistance().compute(sample(clip, source=source)) < 0.5 * expected

    def test_phase_takes_an_even_change_of_tempo_out(self) -> None:
        clip = walk(BODY)
        assert PhasePoseDistance().compute(sample(stretched(clip, 1.3), source=clip)) < 0.2

    @pytest.mark.parametrize("height", [0.01, 0.2])
    def test_every_joint_higher_by_the_same(self, height: float) -> None:
        clip = wave(BODY)
        raised = clip.replace(root=clip.root + [0.0, height, 0.0])
        value = PositionDistance().compute(sample(raised, source=clip))
        assert value == pytest.approx(height / BODY.leg_length, rel=1e-6)
        assert PositionDistance().compute(sample(clip)) == pytest.approx(0.0, abs=1e-7)

    @pytest.mark.parametrize("degrees", [10.0, -80.0, 300.0])
    def test_a_heading_that_drifts_evenly(self, degrees: float) -> None:
        # What is left of a ramp without its mean is on average a quarter of it.
        clip = wave(BODY, seconds=6.0)
        turn = quat.from_axis_angle(UP, np.radians(degrees) * np.linspace(0.0, 1.0, len(clip)))
        rotations = np.array(clip.rotations)
        rotations[:, 0] = quat.mul(turn, rotations[:, 0])
        value = HeadingDeviation().compute(sample(clip.replace(rotations=rotations), source=clip))
        assert value == pytest.approx(abs(degrees) / 4.0, rel=0.02)


class TestTiming:
    @pytest.mark.parametrize("factor", [0.8, 1.25])
    def test_warp_deviation_of_an_even_stretch(self, factor: float) -> None:
        # A gesture that nowhere repeats, so that there is one alignment only.
        t = np.linspace(0.0, 1.0, 181)
        rotations = quat.identity(len(t), len(BODY))
        for role in ("left_shoulder", "right_shoulder"):
            rotations[:, BODY.joint(role)] = quat.from_axis_angle(np.array([0.0, 0.0, 1.0]), 2.0 * t - 1.0)
        source = MotionClip(BODY, rotations, np.tile([0.0, 1.0, 0.0], (len(t), 1)), 60.0)
        clip = stretched(source, factor)
        expected = abs(1.0 - 1.0 / factor) * clip.duration / 2.0
        assert WarpDeviation().compute(sample(clip, source=source)) == pytest.approx(expected, abs=STEP / 2.0)
        assert WarpDeviation().compute(sample(source)) == 0.0

    def test_tempo_error_is_the_same_for_too_quick_and_too_slow(self) -> None:
        slow, quick = wave(BODY, tempo=1.2, seconds=4.0), wave(BODY, tempo=1.6, seconds=4.0)
        expected = np.log(1.6 / 1.2)
        assert TempoError().compute(sample(slow, quick)) == pytest.approx(expected, rel=0.03)
        assert TempoError().compute(sample(quick, slow)) == pytest.approx(expected, rel=0.03)


class TestFeet:
    @staticmethod
    def gliding(speed: float, height: float = 0.0) -> MotionClip:
        """A figure whose toes are ``height`` above the floor glides; 3 s are 60 steps of the common definition."""
        t = np.arange(181) / 60.0
        still = MotionClip(BODY, quat.identity(len(t), len(BODY)), np.zeros((len(t), 3)), 60.0)
        toe = still.positions[0, BODY.joint("left_toe"), 1]
        return still.replace(root=np.stack([0.6 * speed * t, 0.0 * t + height - toe, 0.8 * speed * t], axis=1))

    def test_the_common_skate_ratio_of_a_glide(self) -> None:
        # In two frames at each end the mean over five, filled with zeros, stays below the threshold for speeds up to 0.62 m/s.
        assert FootSkateCommon().compute(sample(self.gliding(0.6, 0.04))) == pytest.approx(56.0 / 60.0)
        assert FootSkateCommon().compute(sample(self.gliding(0.9, 0.04))) == 1.0
        assert FootSkateCommon().compute(sample(self.gliding(0.49, 0.04))) == 0.0
        assert FootSkateCommon().compute(sample(self.gliding(0.6, 0.06))) == 0.0

    def test_the_common_skate_ratio_needs_two_frames(self) -> None:
        with pytest.raises(NotApplicableError, match="two frames"):
            FootSkateCommon().compute(sample(self.gliding(0.6).frames(0, 2)))

    @pytest.mark.parametrize("height", [0.01, 0.3])
    def test_floating_is_the_height_while_standing(self, height: float) -> None:
        clip = wave(BODY)
        raised = clip.replace(root=clip.root + [0.0, height, 0.0])
        assert Floating().compute(sample(raised)) == pytest.approx(height, abs=1e-9)
        assert Floating().compute(sample(clip)) == pytest.approx(0.0, abs=1e-9)
        lowered = clip.replace(root=clip.root - [0.0, height, 0.0])
        assert Floating().compute(sample(lowered)) == 0.0

    def test_a_jump_hardly_floats(self) -> None:
        assert Floating().compute(sample(jump(BODY))) < 0.01

    def test_feet_that_never_rest(self) -> None:
        with pytest.raises(NotApplicableError, match="ever rests"):
            Floating().compute(sample(self.gliding(5.0)))


class TestSmoothness:
    @pytest.mark.parametrize("factor", [0.5, 2.0])
    def test_jerk_deviation_of_half_and_twice_the_amplitude(self, factor: float) -> None:
        value = JerkDeviation().compute(sample(rocking(0.1 * factor, 1.0), rocking(0.1, 1.0)))
        assert value == pytest.approx(np.log(2.0), rel=1e-6)
        with pytest.raises(NotApplicableError, match="do not move"):
            JerkDeviation().compute(sample(rocking(0.0, 1.0), rocking(0.1, 1.0)))

    @pytest.mark.parametrize("amplitude", [0.02, 0.4])
    @pytest.mark.parametrize("hertz", [1.0, 2.0])
    def test_log_dimensionless_jerk_of_a_sinusoid(self, hertz: float, amplitude: float) -> None:
        # Peak speed A w, mean squared jerk (A w^3)^2 / 2, D = 1 s: -ln(w^4 / 2); third differences lose a little of it.
        omega = 2.0 * np.pi * hertz
        value = log_dimensionless_jerk(rocking(amplitude, hertz))
        assert value == pytest.approx(-np.log(omega**4 / 2.0), abs=0.15)

    def test_log_dimensionless_jerk_compares_frequencies_not_amplitudes(self) -> None:
        metric = LogDimensionlessJerk()
        assert metric.compute(sample(rocking(0.3, 1.0), rocking(0.1, 1.0))) == pytest.approx(0.0, abs=1e-9)
        value = metric.compute(sample(rocking(0.1, 2.0), rocking(0.1, 1.0)))
        assert value == pytest.approx(-np.log(2.0**4), abs=0.15)
        with pytest.raises(NotApplicableError, match="nothing moves"):
            metric.compute(sample(rocking(0.0, 1.0), rocking(0.1, 1.0)))

    @pytest.mark.parametrize("degrees", [10.0, 40.0])
    def test_largest_turn_of_a_swing(self, degrees: float) -> None:
        # Within h a swing of amplitude A turns by at most 2 A sin(w h / 2).
        expected = 2.0 * degrees * np.sin(np.pi * STEP)
        assert largest_turn(bending(degrees)) == pytest.approx(expected, rel=0.01)

    def test_largest_turn_ratio_sees_one_pop(self) -> None:
        clip = bending(20.0)
        assert LargestTurnRatio().compute(sample(bending(40.0), clip)) == pytest.approx(2.0, rel=0.02)
        rotations = np.array(clip.rotations)
        joint = BODY.joint("right_shoulder")
        rotations[100, joint] = quat.from_axis_angle(np.array([0.0, 0.0, 1.0]), np.radians(50.0))
        popped = LargestTurnRatio().compute(sample(clip.replace(rotations=rotations), clip))
        assert popped == pytest.approx(50.0 / largest_turn(clip), rel=1e-6)
        with pytest.raises(NotApplicableError, match="do not move"):
            LargestTurnRatio().compute(sample(clip, rocking(0.1, 1.0)))


class TestSpectra:
    @staticmethod
    def reaching(movements: int) -> np.ndarray:
        """Speed at 100 Hz of minimum-jerk movements of 1 s, one after the other."""
        u = np.linspace(0.0, 1.0, 101)[:-1]
        return np.tile(30.0 * u**2 * (1.0 - u) ** 2, movements)

    def test_arc_length_of_a_minimum_jerk_movement(self) -> None:
        # Balasubramanian et al. 2015 give -1.41 for one movement, and less with every submovement.
        lengths = [spectral_arc_length(self.reaching(movements), 100.0) for movements in (1, 2, 3, 4)]
        assert lengths[0] == pytest.approx(-1.41, abs=0.02)
        assert lengths == sorted(lengths, reverse=True)

    def test_arc_length_does_not_depend_on_amplitude_or_sampling(self) -> None:
        speed = self.reaching(2)
        assert spectral_arc_length(7.0 * speed, 100.0) == pytest.approx(spectral_arc_length(speed, 100.0), rel=1e-9)
        assert spectral_arc_length(speed[::2], 50.0) == pytest.approx(spectral_arc_length(speed, 100.0), rel=0.01)
        tremor = speed * (1.0 + 0.5 * np.sin(2.0 * np.pi * 5.0 * np.arange(len(speed)) / 100.0))
        assert spectral_arc_length(tremor, 100.0) < spectral_arc_length(speed, 100.0) - 0.3

    def test_arc_length_of_clips(self) -> None:
        clip = wave(BODY, seconds=4.0)
        assert SpectralArcLength().compute(sample(clip, clip)) == 0.0
        rotations = np.array(clip.rotations)
        joint = BODY.joint("right_elbow")
        tremor = quat.from_axis_angle(np.array([0.0, 0.0, 1.0]), 0.04 * np.sin(2.0 * np.pi * 6.0 * clip.times))
        rotations[:, joint] = quat.mul(rotations[:, joint], tremor)
        assert SpectralArcLength().compute(sample(clip.replace(rotations=rotations), clip)) < -0.2
        with pytest.raises(NotApplicableError, match="rest"):
            mean_arc_length(rocking(0.0, 1.0))
        with pytest.raises(NotApplicableError, match=r"needs 0\.5 s"):
            mean_arc_length(clip.frames(0, 20))

    def test_distance_between_lines_is_their_distance(self) -> None:
        ours, theirs = np.zeros((61, 2)), np.zeros((61, 2))
        ours[10, 0], theirs[18, 0] = 3.0, 1.0
        ours[5, 1], theirs[5, 1] = 1.0, 3.0
        # 8 bins of 0.25 Hz in a component with a quarter of the reference's power.
        assert power_spectrum_distance(ours, theirs) == pytest.approx(0.25 * 8 * 0.25)
        assert power_spectrum_distance(theirs, theirs) == 0.0
        with pytest.raises(NotApplicableError, match="stands still"):
            power_spectrum_distance(ours, 0.0 * theirs)

    @pytest.mark.parametrize(("one", "two"), [(1.0, 2.0), (3.0, 1.5)])
    def test_distance_between_swings_is_that_of_their_frequencies(self, one: float, two: float) -> None:
        # Small swings, whose directions have no harmonics to speak of.
        value = PowerSpectrumDistance().compute(sample(bending(4.0, hertz=one), bending(4.0, hertz=two)))
        assert value == pytest.approx(abs(one - two), rel=0.08)

    def test_spectra_ignore_when_and_see_freezing(self) -> None:
        clip, later = bending(20.0, seconds=6.0), bending(20.0, late=0.3, seconds=6.0)
        assert PowerSpectrumDistance().compute(sample(later, clip)) < 0.03
        still = sample_at(clip, np.zeros(len(clip)), fps=60.0)
        assert PowerSpectrumDistance().compute(sample(still, clip)) > 0.5
        with pytest.raises(NotApplicableError, match="no reference has a spectrum"):
            PowerSpectrumDistance().compute(sample(clip, still))
        with pytest.raises(NotApplicableError, match=r"needs 0\.5 s"):
            power_spectra(clip.frames(0, 20))
