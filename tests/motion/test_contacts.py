from __future__ import annotations

import numpy as np
import pytest

from benchmark.motion import quat
from benchmark.motion.canonical import canonicalise
from benchmark.motion.clip import MotionClip
from benchmark.motion.contacts import HEIGHT, SPEED, detect, hysteresis, runs
from benchmark.motion.resample import resample


def _slow_hysteresis(enter, stay):
    state, out = False, []
    for e, s in zip(enter, stay, strict=True):
        state = bool(e) or (state and bool(s))
        out.append(state)
    return out


def _gliding(biped, height, speed, frames=60, fps=60.0, scale=1.0):
    """A rigid figure whose left ankle glides at a height, with a speed along +X."""
    skeleton = biped(scale)
    rest = MotionClip(skeleton, quat.identity(1, 21), np.zeros((1, 3)), fps).positions[
        0, skeleton.joint("left_ankle"), 1
    ]
    time = np.arange(frames) / fps
    root = np.stack([speed * time, np.full(frames, height - rest), np.zeros(frames)], axis=-1)
    return MotionClip(skeleton, quat.identity(frames, 21), root, fps)


def test_hysteresis_equals_the_loop(rng):
    value = rng.random((200, 3)) * 2
    flags = hysteresis(value < 0.7, value < 1.3)
    for column in range(3):
        assert flags[:, column].tolist() == _slow_hysteresis(value[:, column] < 0.7, value[:, column] < 1.3)


def test_runs():
    assert runs(np.array([True, False, True, True])).tolist() == [[0, 1], [2, 4]]
    assert runs(np.zeros(3, dtype=bool)).tolist() == []


@pytest.mark.parametrize("scale", [0.6, 1.0])
def test_thresholds_are_those_of_the_definition(biped, scale):
    leg = 0.85 * scale
    fast, high = SPEED * np.sqrt(9.81 * leg), HEIGHT["ankle"] * leg
    for speed, height, expected in ((0.99, 0.0, True), (1.01, 0.0, False), (0.0, 0.99, True), (0.0, 1.01, False)):
        contacts = detect(_gliding(biped, height * high, speed * fast, scale=scale))
        assert contacts.roles == ("left_ankle", "left_toe", "right_ankle", "right_toe")
        assert contacts.flags[:, 0].all() == expected and contacts.flags[:, 0].any() == expected


def test_holden_numbers_for_his_skeleton():
    """CMU leg 14.64 units of 5.64 cm: 0.757 m/s, 0.169 m, 0.113 m."""
    leg = 14.64 * 0.0564
    assert SPEED * np.sqrt(9.81 * leg) == pytest.approx(np.sqrt(0.05) * 60 * 0.0564, rel=2e-3)
    assert HEIGHT["ankle"] * leg == pytest.approx(3.0 * 0.0564, rel=2e-3)
    assert HEIGHT["toe"] * leg == pytest.approx(2.0 * 0.0564, rel=4e-3)


def test_planted_feet_are_in_contact_and_swinging_ones_are_not(walk):
    clip, planted = walk()
    contacts = detect(clip)
    for i, side in enumerate(("left", "right")):
        columns = [contacts.roles.index(f"{side}_{part}") for part in ("ankle", "toe")]
        assert contacts.flags[planted[:, i]][:, columns].all()
        speed = np.linalg.norm(np.gradient(clip.positions[:, contacts.joints[columns]], axis=0), axis=-1) * clip.fps
        swinging = ~planted[:, i] & (speed.min(axis=1) > 2 * SPEED * np.sqrt(9.81 * 0.85))
        assert swinging.sum() > 20
        assert not contacts.flags[swinging][:, columns].any()
    assert contacts.side("left").mean() == pytest.approx(0.65, abs=0.1)


def test_frame_rate_does_not_matter(walk):
    clip, _ = walk(fps=120.0, seconds=4.0)
    fractions = [detect(resample(clip, fps)).flags.mean(axis=0) for fps in (120.0, 60.0, 30.0)]
    np.testing.assert_allclose(fractions[1], fractions[0], atol=0.015)
    np.testing.assert_allclose(fractions[2], fractions[0], atol=0.03)


def test_place_and_facing_do_not_matter(walk):
    clip, _ = walk()
    turn = quat.from_axis_angle([0.0, 1.0, 0.0], 2.0)
    rotations = clip.rotations.copy()
    rotations[:, 0] = quat.mul(turn, rotations[:, 0])
    moved = clip.replace(rotations=rotations, root=quat.rotate(turn, clip.root) + [5.0, 0.0, -3.0])
    np.testing.assert_array_equal(detect(moved).flags, detect(clip).flags)


@pytest.mark.parametrize("scale", [0.5, 0.7, 1.4])
def test_froude_scaling_keeps_every_flag(walk, scale):
    np.testing.assert_array_equal(detect(walk(scale=scale)[0]).flags, detect(walk()[0]).flags)


def test_froude_scaling_keeps_every_flag_of_a_trembling_foot(biped, rng):
    """Fast tremble makes speed depend on the span it is measured over, and contacts on their shortest length."""
    clip = _gliding(biped, 0.0, 0.0, frames=600, fps=240.0)
    shake = np.cumsum(rng.normal(scale=0.008, size=(600, 3)), axis=0) * [1.0, 0.0, 1.0]
    clip = clip.replace(root=clip.root + shake)
    small = MotionClip(clip.skeleton.scaled(0.4), clip.rotations, clip.root * 0.4, clip.fps / np.sqrt(0.4))
    flags = detect(clip).flags
    assert 0.1 < flags.mean() < 0.9
    np.testing.assert_array_equal(detect(small).flags, flags)


def test_a_foot_that_passes_briefly_is_not_in_contact(biped):
    clip = _gliding(biped, 0.05, 0.0, frames=40)
    root = clip.root.copy()
    root[:, 1] += 0.6
    root[20:22, 1] -= 0.6
    assert not detect(clip.replace(root=root)).flags.any()


def test_no_chatter_at_the_threshold(biped, rng):
    clip = _gliding(biped, 0.0, 0.0, frames=300)
    high = HEIGHT["ankle"] * 0.85
    root = clip.root.copy()
    root[:, 1] += high * (1.0 + 0.02 * rng.standard_normal(300).clip(-1, 1))
    flags = detect(clip.replace(root=root)).flags[:, 0]
    assert len(runs(flags)) <= 1


def test_skeleton_without_toes(walk):
    clip, _ = walk()
    roles = {role: joint for role, joint in clip.skeleton.roles.items() if not role.endswith("toe")}
    contacts = detect(clip.replace(skeleton=clip.skeleton.with_roles(roles)))
    assert contacts.roles == ("left_ankle", "right_ankle")
    np.testing.assert_array_equal(contacts.flags, detect(clip).flags[:, [0, 2]])


def test_single_frame_and_other_floor(walk):
    clip, _ = walk()
    assert detect(clip.frames(0, 1)).flags.shape == (1, 4)
    lifted = clip.replace(root=clip.root + [0.0, 2.0, 0.0])
    assert not detect(lifted).flags.any()
    np.testing.assert_array_equal(detect(lifted, floor=2.0).flags, detect(clip).flags)


@pytest.mark.real_data
def test_real_walks_put_their_feet_down(bandai_namco):
    from benchmark.motion import bvh

    files = sorted((bandai_namco / "dataset").rglob("*_walk_normal_*.bvh"))[:4]
    assert files
    for path in files:
        contacts = detect(canonicalise(bvh.load(path)))
        for side in ("left", "right"):
            assert 0.4 < contacts.side(side).mean() < 0.95, path.name
