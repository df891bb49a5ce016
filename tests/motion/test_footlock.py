from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.errors import ContractError
from benchmark.motion import quat
from benchmark.motion.contacts import Contacts, detect
from benchmark.motion.footlock import lock_feet, two_bone


def _unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def _leg(rng, n, bend=(0.1, 2.0)):
    """Random legs, and the axis about which each is bent."""
    axis = _unit(rng.normal(size=(n, 3)))
    upper = _unit(np.cross(axis, rng.normal(size=(n, 3)))) * rng.uniform(0.3, 0.5, size=(n, 1))
    lower = quat.rotate(quat.from_axis_angle(axis, rng.uniform(*bend, size=n)), _unit(upper)) * rng.uniform(
        0.3, 0.5, size=(n, 1)
    )
    hip = rng.normal(size=(n, 3))
    return hip, hip + upper, hip + upper + lower, axis


def _apply(hip, knee, ankle, thigh, shank):
    new_knee = hip + quat.rotate(thigh, knee - hip)
    return new_knee, new_knee + quat.rotate(shank, ankle - knee)


def _length(v):
    return np.linalg.norm(v, axis=-1)


def _slide(clip, contacts):
    """Metres that contact joints travel over the floor while in contact."""
    steps = np.linalg.norm(np.diff(clip.positions[:, contacts.joints], axis=0)[..., [0, 2]], axis=-1)
    return float(steps[contacts.flags[1:] & contacts.flags[:-1]].sum())


class TestTwoBone:
    @settings(max_examples=40, deadline=None)
    @given(st.integers(0, 2**32 - 1))
    def test_reaches_what_is_within_reach_and_keeps_lengths_and_plane(self, seed):
        rng = np.random.default_rng(seed)
        hip, knee, ankle, axis = _leg(rng, 20)
        l1, l2 = _length(knee - hip), _length(ankle - knee)
        distance = np.abs(l1 - l2) + rng.uniform(0.05, 0.95, size=20) * (0.97 * (l1 + l2) - np.abs(l1 - l2))
        direction = _unit(_unit(ankle - hip) + 0.4 * rng.normal(size=(20, 3)))
        target = hip + distance[:, None] * direction
        thigh, shank = two_bone(hip, knee, ankle, target, axis)
        new_knee, new_ankle = _apply(hip, knee, ankle, thigh, shank)
        np.testing.assert_allclose(new_ankle, target, atol=1e-9)
        np.testing.assert_allclose(_length(new_knee - hip), l1, atol=1e-12)
        np.testing.assert_allclose(_length(new_ankle - new_knee), l2, atol=1e-12)
        # Thigh and shank turn about the hip together but for the bend, so the knee stays in the swung plane of the leg.
        swing = quat.between(ankle - hip, target - hip)
        normal = quat.rotate(swing, np.cross(knee - hip, ankle - knee))
        tilt = np.abs(np.sum(_unit(normal) * _unit(new_knee - hip), axis=-1))
        assert tilt.max() < 1e-6

    def test_no_move_is_no_turn(self, rng):
        hip, knee, ankle, axis = _leg(rng, 200, bend=(-0.3, 2.5))
        thigh, shank = two_bone(hip, knee, ankle, ankle, axis)
        assert quat.angle(thigh, quat.identity()).max() < 1e-7
        assert quat.angle(shank, quat.identity()).max() < 1e-7

    def test_out_of_reach_stretches_towards_the_target(self, rng):
        hip, knee, ankle, axis = _leg(rng, 50, bend=(0.6, 2.0))
        target = hip + 3.0 * _unit(rng.normal(size=(50, 3)))
        new_knee, new_ankle = _apply(hip, knee, ankle, *two_bone(hip, knee, ankle, target, axis))
        length = _length(knee - hip) + _length(ankle - knee)
        reach = _length(new_ankle - hip) / length
        assert reach.max() <= 0.9995 + 1e-9 and reach.min() > 0.99
        np.testing.assert_allclose(np.sum(_unit(new_ankle - hip) * _unit(target - hip), axis=-1), 1.0, atol=1e-9)
        assert np.all(np.isfinite(new_knee))

    def test_soft_limit_has_no_kink(self):
        """Ankle drawn away steadily: the leg extends monotonically and no frame turns the knee by a jump."""
        hip, knee, axis = np.zeros(3), np.array([0.0, -0.4, 0.0]), np.array([1.0, 0.0, 0.0])
        ankle = knee + quat.rotate(quat.from_axis_angle(axis, 1.0), np.array([0.0, -0.4, 0.0]))
        distance = np.linspace(0.5, 1.2, 400)
        target = _unit(ankle)[None] * distance[:, None]
        tile = (np.tile(x, (400, 1)) for x in (hip, knee, ankle))
        _, shank = two_bone(*tile, target, axis)
        assert quat.angle(shank[1:], shank[:-1]).max() < 0.04

    def test_straight_leg_bends_about_the_usual_axis(self):
        hip, knee, ankle = np.zeros(3), np.array([0.0, -0.4, 0.0]), np.array([0.0, -0.8, 0.0])
        thigh, shank = two_bone(hip, knee, ankle, np.array([0.0, -0.7, 0.0]), np.array([1.0, 0.0, 0.0]))
        new_knee, new_ankle = _apply(hip, knee, ankle, thigh, shank)
        np.testing.assert_allclose(new_ankle, [0.0, -0.7, 0.0], atol=1e-9)
        assert new_knee[2] > 0.1 and abs(new_knee[0]) < 1e-9  # Forward.

    def test_knee_jittering_about_straight_does_not_snap(self):
        """Flexion from -5 to 5 degrees with the ankle pulled up ever more: the knee turns continuously."""
        axis = np.array([1.0, 0.0, 0.0])
        for lift in (1e-4, 1e-3, 5e-3, 2e-2):
            bend = np.deg2rad(np.linspace(-5, 5, 2001))
            hip, knee = np.zeros((2001, 3)), np.tile([0.0, -0.4, 0.0], (2001, 1))
            ankle = knee + quat.rotate(quat.from_axis_angle(axis, bend), np.array([0.0, -0.4, 0.0]))
            thigh, shank = two_bone(hip, knee, ankle, ankle * (1 - lift), axis)
            assert quat.angle(shank[1:], shank[:-1]).max() < 0.01
            _, reached = _apply(hip, knee, ankle, thigh, shank)
            assert _length(reached - ankle * (1 - lift)).max() < 0.01


class TestLockFeet:
    def test_planted_walk_is_unchanged(self, walk):
        clip, planted = walk()
        flags = np.repeat(planted, 2, axis=1)
        found = detect(clip)
        out = lock_feet(clip, Contacts(flags, found.joints, found.roles))
        np.testing.assert_allclose(out.positions, clip.positions, atol=1e-6)
        assert quat.angle(out.rotations, clip.rotations).max() < 1e-6

    def test_standing_figure_is_the_clip_itself(self, biped):
        from benchmark.motion.clip import MotionClip

        clip = MotionClip(biped(), quat.identity(30, 21), np.tile([0.0, 0.97, 0.0], (30, 1)), 30.0)
        assert lock_feet(clip) is clip

    @pytest.mark.parametrize("slide", [-0.15, -0.05, 0.03, 0.1])
    @pytest.mark.parametrize("scale", [0.6, 1.0])
    def test_skating_ends(self, walk, slide, scale):
        clip, _ = walk(slide=slide, scale=scale)
        contacts = detect(clip)
        before = _slide(clip, contacts)
        out = lock_feet(clip)
        assert before > 0.05 * scale
        assert _slide(out, contacts) < 0.5 * before
        # In the middle of each contact the feet stand.
        planted = walk(scale=scale)[1]
        middle = planted & np.roll(planted, 8, axis=0) & np.roll(planted, -8, axis=0)
        middle[:10] = middle[-10:] = False
        for i, side in enumerate(("left", "right")):
            speed = np.linalg.norm(np.gradient(out.positions[:, clip.skeleton.joint(f"{side}_ankle")], axis=0), axis=-1)
            assert (speed[middle[:, i]] * clip.fps).max() < 0.02

    def test_bones_feet_and_the_rest_of_the_body_are_kept(self, walk):
        clip, _ = walk(slide=0.1)
        out = lock_feet(clip)
        parents = clip.skeleton.parents
        bones = np.linalg.norm(out.positions[:, 1:] - out.positions[:, parents[1:]], axis=-1)
        np.testing.assert_allclose(bones, np.tile(clip.skeleton.bone_lengths[1:], (len(clip), 1)), atol=1e-9)
        feet = [joint for role, joint in clip.skeleton.roles.items() if role.endswith(("ankle", "toe"))]
        assert quat.angle(out.world[0][:, feet], clip.world[0][:, feet]).max() < 1e-9
        legs = [j for role, j in clip.skeleton.roles.items() if role.endswith(("_hip", "knee", "ankle"))]
        others = [joint for joint in range(21) if joint not in legs]
        np.testing.assert_array_equal(out.rotations[:, others], clip.rotations[:, others])
        np.testing.assert_array_equal(out.root, clip.root)

    @pytest.mark.parametrize("slide", [-0.15, 0.1])
    def test_no_pops(self, walk, slide):
        clip, _ = walk(slide=slide)
        out = lock_feet(clip)
        before = quat.angle(clip.rotations[1:], clip.rotations[:-1]).max()
        after = quat.angle(out.rotations[1:], out.rotations[:-1]).max()
        assert after < before + np.deg2rad(1.0)

    def test_no_pops_in_a_noisy_capture(self, walk, rng):
        """Jitter of a depth camera, knees that measure as bent backwards included."""
        clip, _ = walk(fps=30.0, slide=0.05)
        legs = [j for role, j in clip.skeleton.roles.items() if role.endswith(("_hip", "knee"))]
        rotations = clip.rotations.copy()
        noise = quat.exp(0.03 * rng.standard_normal((len(clip), len(legs), 3)).clip(-2, 2))
        rotations[:, legs] = quat.mul(rotations[:, legs], noise)
        noisy = clip.replace(rotations=rotations)
        contacts = detect(noisy)
        out = lock_feet(noisy, contacts)
        before = quat.angle(noisy.rotations[1:], noisy.rotations[:-1]).max()
        after = quat.angle(out.rotations[1:], out.rotations[:-1]).max()
        assert after < before + np.deg2rad(5.0)
        assert _slide(out, contacts) < 0.6 * _slide(noisy, contacts)

    def test_twice_changes_little(self, walk):
        clip, _ = walk(slide=0.08)
        contacts = detect(clip)
        once = lock_feet(clip, contacts)
        twice = lock_feet(once, contacts)
        assert _slide(twice, contacts) <= _slide(once, contacts) + 1e-6
        assert np.abs(twice.positions - once.positions).max() < 0.25 * np.abs(once.positions - clip.positions).max()

    def test_feet_are_moved_along_the_floor_only(self, walk):
        clip, _ = walk(slide=0.1)
        feet = clip.skeleton.joints("left_ankle", "right_ankle", "left_toe", "right_toe")
        moved = lock_feet(clip).positions[:, feet] - clip.positions[:, feet]
        assert np.abs(moved[..., 2]).max() > 0.02
        # But for the frames in which the leg is stretched to its end.
        assert np.median(np.abs(moved[..., 1])) < 1e-9 and np.abs(moved[..., 1]).max() < 0.01

    def test_place_and_facing_do_not_matter(self, walk):
        clip, _ = walk(slide=0.1)
        turn = quat.from_axis_angle([0.0, 1.0, 0.0], 1.2)
        rotations = clip.rotations.copy()
        rotations[:, 0] = quat.mul(turn, rotations[:, 0])
        moved = clip.replace(rotations=rotations, root=quat.rotate(turn, clip.root) + [1.0, 0.0, 2.0])
        expected = quat.rotate(turn, lock_feet(clip).positions) + [1.0, 0.0, 2.0]
        np.testing.assert_allclose(lock_feet(moved).positions, expected, atol=1e-7)

    def test_without_contacts_nothing_moves(self, walk):
        clip, _ = walk(slide=0.2)
        found = detect(clip)
        assert lock_feet(clip, Contacts(np.zeros_like(found.flags), found.joints, found.roles)) is clip

    def test_whole_clip_in_contact_and_single_frames(self, walk):
        clip, _ = walk(slide=0.2, seconds=0.2)
        found = detect(clip)
        held = lock_feet(clip, Contacts(np.ones_like(found.flags), found.joints, found.roles))
        assert _slide(held, Contacts(np.ones_like(found.flags), found.joints, found.roles)) < _slide(clip, found)
        one = clip.frames(0, 1)
        assert lock_feet(one) is one

    def test_contacts_of_another_clip_are_refused(self, walk):
        clip, _ = walk()
        with pytest.raises(ContractError, match="frames"):
            lock_feet(clip, detect(clip.frames(0, 20)))


@pytest.mark.real_data
def test_real_clips_skate_less_and_do_not_pop(bandai_namco, kinder_gator):
    from benchmark.motion import bvh, kinect
    from benchmark.motion.canonical import canonicalise

    paths = sorted((bandai_namco / "dataset").rglob("*.bvh"))[::24] + sorted(kinder_gator.rglob("*.csv"))[::48]
    for path in paths:
        clip = canonicalise(bvh.load(path) if path.suffix == ".bvh" else kinect.load(path))
        contacts = detect(clip)
        out = lock_feet(clip, contacts)
        assert _slide(out, contacts) <= _slide(clip, contacts) + 1e-9, path.name
        before = quat.angle(clip.rotations[1:], clip.rotations[:-1]).max()
        after = quat.angle(out.rotations[1:], out.rotations[:-1]).max()
        assert after < max(before, np.deg2rad(10.0)) + np.deg2rad(15.0), path.name
