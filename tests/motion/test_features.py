from __future__ import annotations

import numpy as np
import pytest

from benchmark.errors import ConfigError, ContractError, MotionFileError, UnknownNameError
from benchmark.motion import quat
from benchmark.motion.canonical import canonicalise
from benchmark.motion.clip import ClipMeta
from benchmark.motion.features import CODECS, Normalizer, Positions, Quaternions, codec, fix_signs, sign_reference


def _start(clip):
    from benchmark.motion.root import split

    track, _ = split(clip)
    return {"start": track.start, "start_yaw": track.start_yaw}


class TestCodecs:
    @pytest.mark.parametrize("name", ["quaternions", "sixd"])
    def test_rotation_codecs_are_exact(self, wild, rng, name):
        clip = wild(rng, 90)
        coder = codec(name, clip.skeleton)
        array = coder.encode(clip)
        assert array.shape == (90, coder.dim)
        back = coder.decode(array, clip.fps, **_start(clip), meta=clip.meta)
        assert quat.angle(back.rotations, clip.rotations).max() < 1e-9
        np.testing.assert_allclose(back.root, clip.root, atol=1e-9)
        assert back.fps == clip.fps and back.meta == clip.meta and back.skeleton == clip.skeleton

    @pytest.mark.parametrize("name", ["quaternions", "sixd"])
    def test_canonical_clips_start_at_zero(self, walk, name):
        clip = canonicalise(walk()[0])
        back = codec(name, clip.skeleton).decode(codec(name, clip.skeleton).encode(clip), clip.fps)
        np.testing.assert_allclose(back.positions, clip.positions, atol=1e-9)

    def test_positions_hold_every_joint(self, walk):
        clip = canonicalise(walk()[0])
        coder = Positions(clip.skeleton)
        back = coder.decode(coder.encode(clip), clip.fps)
        # Direction matching keeps positions where the skeleton allows it exactly, as it does on its own bones.
        np.testing.assert_allclose(back.positions, clip.positions, atol=1e-6)
        assert back.residual is not None and back.residual.max() < 1e-6

    @pytest.mark.parametrize("name", sorted(CODECS))
    def test_place_facing_and_size_do_not_show(self, walk, name):
        clip, _ = walk()
        small, _ = walk(scale=0.6)
        turn = quat.from_axis_angle([0.0, 1.0, 0.0], 1.9)
        rotations = clip.rotations.copy()
        rotations[:, 0] = quat.mul(turn, rotations[:, 0])
        moved = clip.replace(rotations=rotations, root=quat.rotate(turn, clip.root) + [3.0, 0.0, 1.0])
        coder = codec(name, clip.skeleton)
        np.testing.assert_allclose(coder.encode(moved), coder.encode(clip), atol=1e-8)
        # The same frames at the same rate: as many leg lengths a second.
        np.testing.assert_allclose(coder.encode(small.replace(fps=clip.fps)), coder.encode(clip), atol=1e-9)

    def test_decoding_on_another_skeleton_scales_the_path(self, walk, biped):
        clip = canonicalise(walk()[0])
        array = codec("sixd", clip.skeleton).encode(clip)
        small = codec("sixd", biped(0.6)).decode(array, clip.fps)
        np.testing.assert_allclose(small.positions, 0.6 * clip.positions, atol=1e-9)

    def test_groups_cover_every_column_once(self, biped):
        for name in CODECS:
            coder = codec(name, biped())
            columns = np.concatenate([np.arange(coder.dim)[group] for group in coder.groups.values()])
            assert columns.tolist() == list(range(coder.dim))

    def test_unnormalised_output_of_a_model_decodes(self, walk, rng):
        clip = canonicalise(walk()[0])
        for name in ("quaternions", "sixd"):
            coder = codec(name, clip.skeleton)
            array = coder.encode(clip) + rng.normal(scale=0.01, size=(len(clip), coder.dim))
            array[:, coder.groups["pose"]] *= 1.2
            back = coder.decode(array, clip.fps)
            assert quat.angle(back.rotations[:, 1:], clip.rotations[:, 1:]).max() < 0.2

    def test_mistakes_are_named(self, walk, wild, rng, biped):
        with pytest.raises(UnknownNameError, match="sixd"):
            codec("six", biped())
        clip, _ = walk()
        coder = codec("quaternions", clip.skeleton)
        with pytest.raises(ContractError, match="shape"):
            coder.decode(np.zeros((5, 7)), 30.0)
        with pytest.raises(ContractError, match="frame 2"):
            coder.decode(np.where(np.arange(5)[:, None] == 2, np.nan, np.ones((5, coder.dim))), 30.0)
        from benchmark.motion.skeleton import Skeleton

        other = Skeleton(("a", "b"), np.array([-1, 0]), np.ones((2, 3)))
        with pytest.raises(ContractError, match="joints"):
            Quaternions(other).encode(clip.replace(meta=ClipMeta("x")))


class TestSigns:
    def test_same_pose_same_sign_whatever_the_file_says(self, wild, rng):
        clips = [wild(rng, 40) for _ in range(5)]
        reference = sign_reference(clips)
        assert np.all(reference[:, 0] >= 0)
        for clip in clips:
            scrambled = clip.rotations * rng.choice([-1.0, 1.0], size=(40, 21, 1))
            np.testing.assert_allclose(sign_reference([scrambled]), sign_reference([clip]), atol=1e-9)
            fixed = fix_signs(scrambled, reference)
            np.testing.assert_array_equal(fixed, fix_signs(clip, reference))
            assert np.all(np.sum(fixed[1:] * fixed[:-1], axis=-1) >= 0)
            assert np.all(np.sum(fixed * reference, axis=-1).mean(axis=0) >= 0)

    def test_continuity_goes_before_the_reference(self):
        """A joint that turns by 1.5 circles is followed past the hemisphere, not flipped."""
        q = quat.from_axis_angle([0.0, 1.0, 0.0], np.linspace(0, 3 * np.pi, 60))[:, None]
        fixed = fix_signs(q, quat.identity(1))
        assert np.all(np.sum(fixed[1:] * fixed[:-1], axis=-1) > 0)
        assert np.any(fixed[..., 0] < 0) and np.any(fixed[..., 0] > 0)

    def test_clips_of_one_pose_cluster_on_one_side(self, rng):
        """Without the reference this set has two modes: methods 1.2.1."""
        pose = quat.exp([3.0, 0.0, 0.0])  # Near half a turn, where w >= 0 is a coin toss.
        clips = [quat.mul(pose, quat.exp(0.3 * rng.standard_normal((20, 1, 3)))) for _ in range(30)]
        reference = sign_reference(clips)
        means = np.array([fix_signs(clip, reference)[:, 0].mean(axis=0) for clip in clips])
        plain = np.array([quat.absolute(clip[:1, 0])[0] for clip in clips])
        assert np.sum(means * means[:1], axis=-1).min() > 0.8
        assert np.sum(plain * plain[:1], axis=-1).min() < -0.5

    def test_codec_uses_the_reference(self, wild, rng):
        clip = wild(rng, 30)
        coder = Quaternions(clip.skeleton, reference=-quat.identity(21))
        pose = coder.encode(clip)[:, 4:].reshape(30, 21, 4)
        assert np.all(pose[..., 0].mean(axis=0) <= 0)
        with pytest.raises(ContractError, match="training clip"):
            sign_reference([])


class TestNormalizer:
    def test_training_data_come_out_standard(self, rng):
        data = [rng.normal(3.0, [1.0, 5.0, 0.2], size=(n, 3)) for n in (40, 90)]
        both = np.concatenate([Normalizer.fit(data).apply(array) for array in data])
        np.testing.assert_allclose(both.mean(axis=0), 0.0, atol=1e-12)
        np.testing.assert_allclose(both.std(axis=0), 1.0, atol=1e-12)

    @pytest.mark.parametrize("kind", Normalizer.KINDS)
    def test_round_trip(self, rng, kind):
        data = rng.normal(size=(50, 4)) * [1.0, 2.0, 3.0, 0.0]
        norm = Normalizer.fit([data], kind=kind, groups={"a": slice(0, 2), "b": slice(2, 4)})
        other = rng.normal(size=(2, 7, 4))
        np.testing.assert_allclose(norm.invert(norm.apply(other)), other, atol=1e-12)

    def test_constant_columns_do_not_explode(self, rng):
        data = rng.normal(size=(100, 5))
        data[:, 2] = 0.1 + 0.2  # Not exactly representable: its computed deviation may be rounding dust.
        norm = Normalizer.fit([data])
        np.testing.assert_allclose(norm.scale[2], 1e-3 * np.median(np.delete(norm.scale, 2)), rtol=1e-9)
        assert Normalizer.fit([np.ones((5, 2))]).apply(np.ones((1, 2))).tolist() == [[0.0, 0.0]]
        assert np.all(np.isfinite(Normalizer.fit([np.ones((5, 2))], kind="minmax").apply(np.zeros((1, 2)))))

    def test_group_keeps_relative_amplitudes(self, rng):
        data = rng.normal(size=(500, 3)) * [1.0, 3.0, 10.0]
        norm = Normalizer.fit([data], kind="group", groups={"ab": slice(0, 2), "c": slice(2, 3)})
        assert norm.scale[0] == norm.scale[1] == pytest.approx(np.sqrt((data.std(axis=0)[:2] ** 2).mean()))
        assert norm.apply(data)[:, 2].std() == pytest.approx(1.0)

    def test_minmax_is_one_scale_to_plus_minus_one(self, rng):
        data = rng.normal(size=(50, 3))
        out = Normalizer.fit([data[:20], data[20:]], kind="minmax").apply(data)
        assert out.min() == pytest.approx(-1.0) and out.max() == pytest.approx(1.0)
        np.testing.assert_allclose(np.ptp(out, axis=0), np.ptp(data, axis=0) * 2 / np.ptp(data))

    def test_file_round_trip_and_damage(self, rng, tmp_path):
        norm = Normalizer.fit([rng.normal(size=(50, 3))])
        norm.save(tmp_path / "norm.npz")
        again = Normalizer.load(tmp_path / "norm.npz")
        np.testing.assert_array_equal(again.offset, norm.offset)
        np.testing.assert_array_equal(again.scale, norm.scale)
        assert again.kind == norm.kind
        np.savez(tmp_path / "bad.npz", offset=np.zeros(3), scale=np.zeros(3), kind=norm.to_arrays()["kind"])
        (tmp_path / "cut.npz").write_bytes((tmp_path / "norm.npz").read_bytes()[:100])
        np.savez(tmp_path / "object.npz", offset=np.array([{}], dtype=object))
        for name in ("bad.npz", "cut.npz", "object.npz", "absent.npz"):
            with pytest.raises(MotionFileError, match=name):
                Normalizer.load(tmp_path / name)

    def test_mistakes_are_named(self, rng):
        data = [rng.normal(size=(5, 2))]
        with pytest.raises(ConfigError, match="minmax"):
            Normalizer.fit(data, kind="robust")
        with pytest.raises(ConfigError, match="groups"):
            Normalizer.fit(data, kind="group")
        for bad in ([], [np.full((3, 2), np.nan)], [np.zeros((0, 2))], [np.zeros(4)]):
            with pytest.raises(ContractError, match="normaliser"):
                Normalizer.fit(bad)
        with pytest.raises(ContractError, match="scale"):
            Normalizer.from_arrays({"offset": np.zeros(2), "kind": np.zeros(1)})
