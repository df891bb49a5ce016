from __future__ import annotations

import numpy as np
import pytest

from benchmark.errors import ConfigError, SkeletonError
from benchmark.motion import quat
from benchmark.motion.canonical import (
    canonicalise,
    collapse_root,
    floor_height,
    heading,
    rigid,
    to_y_up,
    tpose_frames,
    trim_tpose,
    up_axis,
)
from benchmark.motion.clip import MotionClip
from benchmark.motion.resample import resample
from benchmark.motion.skeleton import EndSite, Skeleton

UP = np.array([0.0, 1.0, 0.0])


def _turned(clip, turn, shift=(0.0, 0.0, 0.0)):
    rotations = clip.rotations.copy()
    rotations[:, 0] = quat.mul(turn, rotations[:, 0])
    return clip.replace(rotations=rotations, root=quat.rotate(turn, clip.root) + shift)


def _same(a, b, atol=1e-9):
    assert len(a) == len(b) and a.fps == b.fps
    np.testing.assert_allclose(a.root, b.root, atol=atol)
    np.testing.assert_allclose(a.positions, b.positions, atol=atol)
    assert quat.angle(a.rotations, b.rotations).max() < max(atol, 1e-7)


def _in_t(biped, seconds, fps, sway=0.0):
    frames = round(seconds * fps)
    time = np.arange(frames) / fps
    rotations = quat.identity(frames, 21)
    rotations[:, 1] = quat.from_axis_angle([1.0, 0.0, 0.0], sway * np.sin(2 * np.pi * time))
    return MotionClip(biped(), rotations, np.tile([0.0, 0.97, 0.0], (frames, 1)), fps)


def _joined(*clips):
    return clips[0].replace(
        rotations=np.concatenate([clip.rotations for clip in clips]), root=np.concatenate([clip.root for clip in clips])
    )


def _arms(biped, lean, fps=60.0, root=None):
    """A standing figure with both arms ``lean`` (T,) radians below horizontal."""
    skeleton, frames = biped(), len(lean)
    rotations = quat.identity(frames, 21)
    rotations[:, skeleton.joint("left_shoulder")] = quat.from_axis_angle([0.0, 0.0, 1.0], -lean)
    rotations[:, skeleton.joint("right_shoulder")] = quat.from_axis_angle([0.0, 0.0, 1.0], lean)
    return MotionClip(skeleton, rotations, np.tile([0.0, 0.97, 0.0], (frames, 1)) if root is None else root, fps)


class TestHeading:
    def test_facing_z_is_zero_and_facing_x_a_quarter(self, biped):
        clip = _in_t(biped, 0.1, 30.0)
        np.testing.assert_allclose(heading(clip), 0.0, atol=1e-12)
        # Turned by +90 degrees about Y, what pointed along +Z points along +X.
        turn = quat.from_axis_angle(UP, np.pi / 2)
        np.testing.assert_allclose(quat.rotate(turn, [0.0, 0.0, 1.0]), [1.0, 0.0, 0.0], atol=1e-12)
        np.testing.assert_allclose(heading(_turned(clip, turn)), np.pi / 2, atol=1e-12)

    def test_full_turns_are_continuous(self, biped):
        clip = _in_t(biped, 4.0, 30.0)
        yaw = np.linspace(0, 7 * np.pi, len(clip))
        np.testing.assert_allclose(heading(_turned(clip, quat.from_axis_angle(UP, yaw))), yaw, atol=1e-9)

    @pytest.mark.parametrize("fps", [30.0, 120.0])
    def test_smoothing_is_in_seconds(self, biped, fps):
        """A Gaussian of sigma s passes a sinusoid of f hertz with gain exp(-(2 pi f s)^2 / 2)."""
        clip = _in_t(biped, 8.0, fps)
        yaw = 0.1 * np.sin(2 * np.pi * 0.5 * clip.times)
        smooth = heading(_turned(clip, quat.from_axis_angle(UP, yaw)), sigma=1 / 3)
        middle = slice(len(clip) // 4, 3 * len(clip) // 4)
        gain = np.abs(smooth[middle]).max() / 0.1
        assert gain == pytest.approx(np.exp(-0.5 * (2 * np.pi * 0.5 / 3) ** 2), rel=0.02)

    def test_lying_on_one_side_keeps_the_last_direction(self, biped):
        clip = _in_t(biped, 1.0, 30.0)
        roll = np.where(np.arange(30) < 10, 0.0, np.pi / 2)
        yaw = quat.from_axis_angle(UP, np.full(30, 0.4))
        lying = _turned(clip, quat.mul(yaw, quat.from_axis_angle([0.0, 0.0, 1.0], roll)))
        np.testing.assert_allclose(heading(lying), 0.4, atol=1e-9)

    def test_needs_hips_or_shoulders(self, biped):
        clip = _in_t(biped, 0.1, 30.0)
        bare = clip.replace(skeleton=clip.skeleton.with_roles({"hips": 0}))
        with pytest.raises(SkeletonError, match="left_hip"):
            heading(bare)


class TestFloor:
    @pytest.mark.parametrize("shift", [0.0, -1.3, 2.0])
    def test_of_a_walk_is_under_the_soles(self, walk, shift):
        clip, _ = walk()
        assert floor_height(clip.replace(root=clip.root + [0.0, shift, 0.0])) == pytest.approx(shift, abs=0.002)

    def test_scales_with_the_figure(self, walk):
        assert floor_height(walk(scale=0.6)[0]) == pytest.approx(0.0, abs=0.002)

    def test_of_a_jump_is_where_it_lands(self, walk, biped):
        time = np.arange(120) / 60
        flight = np.maximum(0.0, 3.5 * (time - 0.4) - 4.905 * (time - 0.4) ** 2) * (time > 0.4)
        root = np.stack([np.zeros(120), 0.97 + flight, np.zeros(120)], axis=-1)
        assert flight.max() > 0.6
        assert floor_height(_in_t(biped, 2.0, 60.0).replace(root=root)) == pytest.approx(0.0, abs=0.003)

    def test_jitter_of_a_depth_camera_averages_out(self, walk, rng):
        clip, _ = walk(fps=30.0, seconds=6.0)
        noisy = clip.replace(root=clip.root + rng.normal(scale=0.004, size=clip.root.shape) - [0.0, 0.8, 0.0])
        assert floor_height(noisy) == pytest.approx(-0.8, abs=0.006)

    def test_single_wrong_frames_do_not_matter(self, walk):
        clip, _ = walk()
        root = clip.root.copy()
        root[50:54, 1] -= 0.4
        assert floor_height(clip.replace(root=root)) == pytest.approx(0.0, abs=0.003)

    def test_feet_lost_by_the_camera_do_not_lower_it(self, walk, rng):
        clip, _ = walk(fps=30.0, seconds=6.0)
        root = clip.root.copy()
        root[60:100, 1] += rng.uniform(-0.4, -0.1, size=40)
        assert floor_height(clip.replace(root=root)) == pytest.approx(0.0, abs=0.005)

    def test_feet_that_are_nowhere_still_give_a_height_among_theirs(self, walk, rng):
        clip, _ = walk(fps=30.0)
        root = clip.root + np.linspace(0, 3, len(clip))[:, None] * [0.0, 1.0, 0.0]
        assert 0.0 <= floor_height(clip.replace(root=root)) <= 3.0
        assert np.isfinite(floor_height(clip.frames(0, 1)))

    def test_a_step_up_does_not_raise_it(self, biped):
        clip = _in_t(biped, 2.0, 60.0)
        root = clip.root.copy()
        root[60:, 1] += 0.2
        assert floor_height(clip.replace(root=root)) == pytest.approx(0.0, abs=0.003)

    def test_legs_that_end_at_the_ankle(self, walk):
        """Sole 0.039 / 0.491 leg lengths below the ankle (Winter)."""
        clip, _ = walk()
        skeleton = clip.skeleton
        keep = [joint for joint, name in enumerate(skeleton.names) if not name.endswith("toe")]
        new = {old: i for i, old in enumerate(keep)}
        smaller = Skeleton(
            tuple(skeleton.names[joint] for joint in keep),
            np.array([-1] + [new[int(skeleton.parents[joint])] for joint in keep[1:]]),
            skeleton.offsets[keep],
            roles={role: new[joint] for role, joint in skeleton.roles.items() if joint in new},
        )
        short = MotionClip(smaller, clip.rotations[:, keep], clip.root, clip.fps)
        assert floor_height(short) == pytest.approx(0.07 - 0.039 / 0.491 * 0.85, abs=0.003)


class TestTPose:
    @pytest.mark.parametrize("fps", [30.0, 120.0])
    def test_prefix_is_cut_where_the_arms_have_left_it(self, biped, fps):
        frames = round(fps)
        lean = np.concatenate([np.zeros(frames), np.linspace(0, 1.4, frames // 2), np.full(frames, 1.4)])
        cut = tpose_frames(_arms(biped, lean, fps))
        assert lean[cut] >= np.deg2rad(60.0) > lean[cut - 1]
        assert len(trim_tpose(_arms(biped, lean, fps))) == len(lean) - cut

    def test_jittery_prefix_is_cut_once(self, biped, rng):
        lean = np.concatenate([0.01 * rng.standard_normal(45).clip(-2, 2), np.linspace(0, 1.4, 12), np.full(40, 1.4)])
        clip = _arms(biped, lean, 30.0)
        assert 52 <= tpose_frames(clip) <= 57
        once = trim_tpose(clip)
        assert trim_tpose(once) is once

    def test_walking_off_in_a_t_ends_the_prefix(self, biped):
        lean = np.zeros(240)
        root = np.tile([0.0, 0.97, 0.0], (240, 1))
        root[120:, 2] = 1.2 * np.arange(120) / 60
        lean[200:] = np.linspace(0, 1.4, 40)
        assert 105 <= tpose_frames(_arms(biped, lean, root=root)) <= 121

    def test_passing_through_a_t_is_the_motion(self, biped):
        up_and_down = 1.4 * np.cos(2 * np.pi * np.arange(120) / 60)
        for start in (0, 10, 15, 20, 42, 45):  # 15 and 45 start right in the T, on the way up and down.
            assert tpose_frames(_arms(biped, np.roll(up_and_down, -start))) == 0

    def test_clip_that_starts_on_the_way_out_of_a_t(self, biped):
        """Most Kinder-Gator clips: recording began as the arms, once in a T, were being put down."""
        lean = np.concatenate(
            [np.linspace(0.4, 0.8, 12), np.full(10, 0.8), np.linspace(0.8, 1.4, 20), np.full(30, 1.4)]
        )
        cut = tpose_frames(_arms(biped, lean, 30.0))
        assert lean[cut] >= np.deg2rad(60.0) > lean[cut - 1]

    def test_arms_that_go_up_again_have_begun(self, biped):
        held = np.zeros(30)
        for after in (np.linspace(0, -1.5, 30), np.concatenate([np.linspace(0, 0.7, 15), np.linspace(0.7, -1.0, 25)])):
            cut = tpose_frames(_arms(biped, np.concatenate([held, after]), 30.0))
            assert cut == 30 + np.argmax(after < np.maximum.accumulate(after) - np.deg2rad(20.0))
            # Without the rest in a T it is all performance.
            assert tpose_frames(_arms(biped, after, 30.0)) == 0

    def test_a_second_t_right_after_the_first_is_cut_too(self, biped):
        back = np.concatenate([np.zeros(30), np.linspace(0, 0.45, 15), np.linspace(0.45, 0.05, 15), np.full(30, 0.05)])
        clip = _arms(biped, np.concatenate([back, np.linspace(0.05, 1.4, 20), np.full(20, 1.4)]), 30.0)
        once = trim_tpose(clip)
        assert len(clip) - len(once) > 90 and trim_tpose(once) is once

    def test_a_later_t_is_the_motion(self, biped):
        lean = np.concatenate([np.full(30, 1.4), np.linspace(1.4, 0, 30), np.zeros(60), np.linspace(0, 1.4, 30)])
        assert tpose_frames(_arms(biped, lean)) == 0

    def test_bent_elbows_or_arms_forward_are_no_t(self, biped):
        clip = _arms(biped, np.concatenate([np.zeros(60), np.linspace(0, 1.4, 30)]))
        assert tpose_frames(clip) > 0
        for joint, turn in (("left_elbow", [0.0, -1.2, 0.0]), ("right_shoulder", [0.0, 1.2, 0.0])):
            rotations = clip.rotations.copy()
            rotations[:60, clip.skeleton.joint(joint)] = quat.exp(np.array(turn))
            assert tpose_frames(clip.replace(rotations=rotations)) == 0

    def test_never_leaving_it_is_no_prefix(self, biped):
        clip = _arms(biped, np.zeros(90))
        assert trim_tpose(clip) is clip

    def test_lone_calibration_frame_is_cut(self, biped, walk):
        clip, _ = walk(fps=30.0)
        pose = _in_t(biped, 1 / 30, 30.0).replace(root=clip.root[:1])
        assert tpose_frames(_joined(pose, clip)) == 1
        assert tpose_frames(clip) == 0

    def test_single_frame_and_missing_arms(self, biped):
        assert tpose_frames(_arms(biped, np.zeros(1))) == 0
        clip = _arms(biped, np.concatenate([np.zeros(60), np.linspace(0, 1.4, 30)]))
        roles = {role: joint for role, joint in clip.skeleton.roles.items() if "elbow" not in role}
        assert tpose_frames(clip.replace(skeleton=clip.skeleton.with_roles(roles))) == 0


class TestRoot:
    def _wrapped(self, clip, *, beside=()):
        """The clip under a moving reference node, its hips carried as translations, with extra joints beside them."""
        skeleton, frames, extra = clip.skeleton, len(clip), len(beside)
        first = 1 + extra
        names = ("reference", *beside, *skeleton.names)
        parents = np.concatenate([[-1], np.zeros(extra, dtype=int), [0], skeleton.parents[1:] + first])
        offsets = np.concatenate([np.zeros((1 + extra, 3)), skeleton.offsets])
        offsets[first] = [9.0, 9.0, 9.0]  # An artefact of the file.
        ends = [EndSite(end.parent + first, end.offset) for end in skeleton.end_sites]
        roles = {role: joint + first for role, joint in skeleton.roles.items()}
        wrapped = Skeleton(names, parents, offsets, tuple(ends), roles=roles)
        turn = quat.from_axis_angle(UP, 0.3 * np.arange(frames) / frames)
        place = np.arange(frames)[:, None] * np.array([0.01, 0.0, 0.02])
        translations = np.tile(offsets, (frames, 1, 1))
        translations[:, first] = quat.inv_rotate(turn, clip.root - place)
        rotations = quat.identity(frames, len(names))
        rotations[:, 0] = turn
        rotations[:, first:] = clip.rotations
        rotations[:, first] = quat.inv_mul(turn, clip.rotations[:, 0])
        return MotionClip(wrapped, rotations, place, clip.fps, translations=translations)

    @pytest.mark.parametrize("beside", [(), ("prop", "camera")])
    def test_hips_become_the_root_exactly(self, wild, rng, beside):
        clip = wild(rng)
        out = collapse_root(self._wrapped(clip, beside=beside))
        assert out.skeleton.names == clip.skeleton.names
        assert dict(out.skeleton.roles) == dict(clip.skeleton.roles)
        assert out.skeleton.end_sites == clip.skeleton.end_sites
        _same(out, clip)
        whole = canonicalise(self._wrapped(clip, beside=beside), trim=False, face=False, floor=False)
        assert whole.translations is None and whole.skeleton == clip.skeleton
        _same(whole, clip)

    def test_hips_that_are_not_the_whole_body_stay(self, wild, rng):
        clip = self._wrapped(wild(rng), beside=("prop",))
        roles = {**clip.skeleton.roles, "left_hand": 1}
        clip = clip.replace(skeleton=clip.skeleton.with_roles(roles))
        assert collapse_root(clip) is clip

    def test_hips_first_is_unchanged(self, wild, rng):
        clip = wild(rng)
        assert collapse_root(clip) is clip and rigid(clip) is clip

    def test_constant_translations_become_offsets(self, wild, rng):
        clip = wild(rng)
        wrong = clip.skeleton.with_offsets(clip.skeleton.offsets * 2.0)
        moving = clip.replace(skeleton=wrong, translations=np.tile(clip.skeleton.offsets, (len(clip), 1, 1)))
        out = rigid(moving)
        assert out.translations is None and out.residual is None
        np.testing.assert_array_equal(out.skeleton.offsets[1:], clip.skeleton.offsets[1:])
        _same(out, clip)

    def test_breathing_bones_get_median_lengths_and_a_residual(self, wild, rng):
        clip = wild(rng, 99)
        factor = 1.0 + 0.05 * np.sin(np.arange(99) / 5.0)
        moving = clip.replace(translations=clip.skeleton.offsets * factor[:, None, None])
        out = rigid(moving)
        np.testing.assert_allclose(out.skeleton.bone_lengths, np.median(factor) * clip.skeleton.bone_lengths, rtol=1e-9)
        assert out.residual is not None
        np.testing.assert_allclose(out.residual, np.linalg.norm(out.positions - moving.positions, axis=-1))
        assert 0.01 < out.residual.max() < 0.1


class TestUp:
    #: A Z-up file: what is up in ours, (0, 1, 0), is (0, 0, 1) there.
    TO_Z = quat.from_axis_angle([1.0, 0.0, 0.0], np.pi / 2)

    def _z_up(self, clip, turn):
        """The clip as a file whose axes are all turned, rest pose included."""
        skeleton = clip.skeleton
        ends = [EndSite(end.parent, tuple(quat.rotate(turn, end.offset))) for end in skeleton.end_sites]
        return clip.replace(
            skeleton=skeleton.with_offsets(quat.rotate(turn, skeleton.offsets), ends),
            rotations=quat.mul(quat.mul(turn, clip.rotations), quat.inverse(turn)),
            root=quat.rotate(turn, clip.root),
        )

    def test_y_up_is_unchanged(self, walk):
        clip, _ = walk()
        assert up_axis(clip) == "Y" and to_y_up(clip) is clip

    @pytest.mark.parametrize(
        ("axis", "vector"), [("Z", (0, 0, 1)), ("X", (1, 0, 0)), ("-Z", (0, 0, -1)), ("-Y", (0, -1, 0))]
    )
    def test_whole_file_in_other_axes(self, walk, axis, vector):
        clip, _ = walk()
        turn = quat.between(UP, vector)
        other = self._z_up(clip, turn)
        np.testing.assert_allclose(other.positions, quat.rotate(turn, clip.positions), atol=1e-9)
        assert up_axis(other) == axis
        _same(canonicalise(other), canonicalise(clip), atol=1e-6)
        np.testing.assert_allclose(to_y_up(other).skeleton.offsets, clip.skeleton.offsets, atol=1e-12)

    def test_walk_in_z_up_world_with_y_up_rest(self, walk):
        clip, _ = walk()
        # Facing +Z here is -Y there: walking leaves any floor that Y could have.
        other = _turned(clip, self.TO_Z)
        assert up_axis(other) == "Z"
        back = canonicalise(other)
        _same(back, canonicalise(clip), atol=1e-6)

    def test_lying_down_is_not_another_axis(self, biped):
        clip = _in_t(biped, 2.0, 30.0, sway=0.1)
        lying = _turned(clip, quat.from_axis_angle([1.0, 0.0, 0.0], np.pi / 2))
        assert up_axis(lying) == "Y"
        assert to_y_up(lying) is lying

    def test_axis_can_be_declared(self, biped):
        clip = _in_t(biped, 2.0, 30.0, sway=0.1)
        standing = to_y_up(_turned(clip, self.TO_Z), "Z")
        np.testing.assert_allclose(standing.positions, clip.positions, atol=1e-9)
        with pytest.raises(ConfigError, match="'W'"):
            canonicalise(clip, up="W")


class TestWhole:
    @pytest.mark.parametrize("fps", [None, 30.0, 50.0])
    def test_twice_is_once(self, walk, biped, fps):
        lead = _in_t(biped, 1.0, 60.0)
        clip = _turned(_joined(lead, walk()[0]), quat.from_axis_angle(UP, 2.2), [3.0, 0.7, -8.0])
        once = canonicalise(clip, fps=fps)
        assert len(once) < len(clip)
        _same(canonicalise(once, fps=fps), once)

    def test_first_frame_faces_z_over_the_origin_on_the_floor(self, walk):
        clip, _ = walk()
        out = canonicalise(_turned(clip, quat.from_axis_angle(UP, -1.7), [3.0, 0.7, -8.0]))
        np.testing.assert_allclose(out.root[0, [0, 2]], 0.0, atol=1e-12)
        assert heading(out, sigma=1 / 3)[0] == pytest.approx(0.0, abs=1e-9)
        assert floor_height(out) == pytest.approx(0.0, abs=1e-12)
        assert out.root[-1, 2] > 2.5  # It walks forward.

    def test_place_and_facing_do_not_matter(self, wild, rng):
        clip = wild(rng)
        moved = _turned(clip, quat.from_axis_angle(UP, 2.5), [4.0, -1.0, 2.0])
        _same(canonicalise(moved), canonicalise(clip))

    def test_joint_angles_stay(self, wild, rng):
        clip = wild(rng)
        out = canonicalise(clip)
        assert quat.angle(out.rotations[:, 1:], clip.rotations[:, 1:]).max() < 1e-12
        assert out.skeleton == clip.skeleton and out.meta == clip.meta
        # The root turns about the vertical only, by the same angle in every frame.
        turn = quat.mul(out.rotations[:, 0], quat.inverse(clip.rotations[:, 0]))
        np.testing.assert_allclose(np.abs(turn[:, [1, 3]]), 0.0, atol=1e-9)
        assert quat.angle(turn, turn[0]).max() < 1e-9

    def test_switches(self, walk):
        clip = _turned(walk()[0], quat.from_axis_angle(UP, 1.0), [1.0, 0.5, 2.0])
        bare = canonicalise(clip, trim=False, face=False, floor=False)
        np.testing.assert_array_equal(bare.root, clip.root)
        assert canonicalise(clip, face=False).root[0, 1] == pytest.approx(clip.root[0, 1] - 0.5, abs=0.003)
        assert canonicalise(clip, floor=False).root[0, 1] == pytest.approx(clip.root[0, 1])
        assert canonicalise(clip, floor=0.3).root[0, 1] == pytest.approx(clip.root[0, 1] - 0.3)
        assert canonicalise(clip, floor=0.0).root[0, 1] == pytest.approx(clip.root[0, 1])

    def test_resampling_keeps_the_motion(self, walk):
        clip, _ = walk(fps=120.0)
        np.testing.assert_allclose(
            canonicalise(clip, fps=30.0).positions, resample(canonicalise(clip), 30.0).positions, atol=0.01
        )


@pytest.mark.real_data
def test_bandai_clips_share_one_skeleton_and_stand_on_the_floor(bandai_namco):
    from benchmark.motion import bvh

    skeletons = []
    for path in sorted((bandai_namco / "dataset").rglob("*.bvh"))[::12]:
        clip = canonicalise(bvh.load(path))
        assert clip.skeleton.joint("hips") == 0 and clip.translations is None
        assert clip.residual is None or clip.residual.max() < 1e-3
        assert -0.02 < floor_height(clip) < 0.02
        assert 0.7 < np.median(clip.root[:, 1]) / clip.skeleton.leg_length < 1.4, path.name
        skeletons.append(clip.skeleton)
    assert all(np.allclose(s.offsets, skeletons[0].offsets, atol=1e-5) for s in skeletons)


@pytest.mark.real_data
def test_kinect_figures_face_the_sensor_and_stand_on_the_floor(kinder_gator):
    from benchmark.motion import kinect

    for path in sorted(kinder_gator.rglob("*.csv"))[::40]:
        raw = kinect.load(path)
        # The actor faces the sensor, which the reader makes +Z; feet point where the body faces.
        assert np.cos(heading(raw)[0]) > 0.7, path.name
        toes = raw.positions[:, raw.skeleton.joints("left_toe", "right_toe")]
        feet = (toes - raw.positions[:, raw.skeleton.joints("left_ankle", "right_ankle")]).mean(axis=(0, 1))
        assert feet[2] > 0.0, path.name
        clip = canonicalise(raw)
        assert floor_height(clip) == pytest.approx(0.0, abs=1e-9)
        assert 0.7 < np.median(clip.root[:, 1]) / clip.skeleton.leg_length < 1.5, path.name
        assert np.percentile(clip.positions[..., 1].min(axis=1), 5) > -0.06


@pytest.mark.real_data
def test_clips_that_start_in_a_t_are_cut_for_adults_and_children_alike(kinder_gator):
    """Three quarters of the recordings start as the arms leave a T; cutting it off one group only would be taken for style."""
    from benchmark.motion import kinect

    for group in ("Adults", "Children"):
        starts, cuts = 0, []
        for path in sorted((kinder_gator / group).glob("*.csv"))[::4]:
            clip = kinect.load(path)
            joints = clip.skeleton.joints("left_shoulder", "left_wrist", "right_shoulder", "right_wrist")
            left_shoulder, left_wrist, right_shoulder, right_wrist = clip.positions[0, joints]
            reach = np.array([left_wrist - left_shoulder, right_shoulder - right_wrist])
            if np.all(reach[:, 0] > 0.9 * np.linalg.norm(reach, axis=-1)):
                starts += 1
                cuts.append(tpose_frames(clip) / clip.fps)
        assert starts > 10
        assert np.mean(np.array(cuts) > 0) > 0.85, group
        assert max(cuts) < 3.0
