"""Clips as channels and back."""

from __future__ import annotations

import numpy as np
import pytest

from benchmark.commands.conformance.figures import figure, perform, walk
from benchmark.motion import quat
from benchmark.motion.canonical import foot_points
from benchmark.motion.retarget import retarget
from methods.hsu.track import COORDINATES, FLOORS, channels, pose


@pytest.mark.parametrize("coordinates", COORDINATES)
@pytest.mark.parametrize("unit", [1.0, 0.8])
@pytest.mark.parametrize("floor", FLOORS)
def test_a_clip_survives_its_own_channels(coordinates: str, floor: str, unit: float) -> None:
    clip = perform("walk", "adult", 1)
    values = channels(clip, coordinates=coordinates, unit=unit)
    assert values.shape == (len(clip), len(clip.skeleton), 3)
    again = pose(clip, values, coordinates=coordinates, unit=unit, floor=floor)
    assert np.abs(again.positions - clip.positions).max() < 1e-9
    assert quat.angle(again.rotations, clip.rotations).max() < 1e-6


@pytest.mark.parametrize("coordinates", COORDINATES)
def test_channels_do_not_see_place_and_facing(coordinates: str) -> None:
    clip = walk(figure(0.8))
    turn = quat.from_axis_angle([0.0, 1.0, 0.0], 1.1)
    rotations = clip.rotations.copy()
    rotations[:, 0] = quat.mul(turn, rotations[:, 0])
    moved = clip.replace(rotations=rotations, root=quat.rotate(turn, clip.root) + [2.0, 0.0, -1.0])
    np.testing.assert_allclose(
        channels(moved, coordinates=coordinates), channels(clip, coordinates=coordinates), atol=1e-9
    )


def test_channels_in_leg_lengths_do_not_see_size() -> None:
    clip = walk(figure(0.8))
    small = figure(0.6, trunk=0.375, head=0.1875, arm=0.4125)
    ours, theirs = channels(clip, unit=0.8), channels(retarget(clip, small), unit=0.6)
    # The small figure is not quite similar: its collar bones have a fixed length.
    assert np.abs(ours - theirs).max() < 0.02


def test_bones_keep_their_length_whatever_the_channels_say() -> None:
    clip = walk(figure(0.8))
    values = channels(clip) * np.array([1.3, 0.7, 1.1])
    posed = pose(clip, values)
    spans = posed.positions[:, 1:] - posed.positions[:, clip.skeleton.parents[1:]]
    lengths = np.linalg.norm(spans, axis=-1)
    np.testing.assert_allclose(lengths, np.broadcast_to(clip.skeleton.bone_lengths[1:], lengths.shape), atol=1e-9)


@pytest.mark.parametrize("floor", FLOORS)
def test_the_stance_foot_stays_on_the_floor(floor: str) -> None:
    clip = walk(figure(0.8))
    values = channels(clip)
    values[:, 0, 1] += 0.3
    lowest = foot_points(pose(clip, values, floor=floor))[..., 1].min(axis=1)
    assert abs(np.quantile(lowest, 0.1)) < 0.01


def test_feet_neither_hover_nor_sink_when_the_legs_bend() -> None:
    clip = walk(figure(0.8))
    values = channels(clip)
    # The thighs swing further forward from frame to frame, which lifts the feet of a body whose hips stay where they are.
    for side in ("left_knee", "right_knee"):
        values[:, clip.skeleton.joint(side), 2] += np.linspace(0.0, 0.4, len(clip))
    gap = {floor: np.abs(foot_points(pose(clip, values, floor=floor))[..., 1].min(axis=1)).mean() for floor in FLOORS}
    assert gap["follow"] < 0.7 * gap["clip"]


def test_a_flight_keeps_its_height() -> None:
    clip = walk(figure(0.8))
    flight = 0.4 * np.clip(np.sin(np.linspace(-np.pi, 2.0 * np.pi, len(clip))), 0.0, None)
    jump = clip.replace(root=clip.root + flight[:, None] * [0.0, 1.0, 0.0])
    values = channels(jump)
    higher = values.copy()
    higher[:, 0, 1] += 0.5 * flight
    assert np.ptp(pose(jump, higher).root[:, 1] - jump.root[:, 1]) == pytest.approx(0.2, abs=0.02)
