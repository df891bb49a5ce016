from __future__ import annotations

import pickle

import numpy as np
import pytest

from benchmark.errors import ContractError
from benchmark.motion import quat
from benchmark.motion.clip import ClipMeta, MotionClip, SourceChannels
from benchmark.motion.skeleton import Skeleton

SKELETON = Skeleton(("a", "b"), np.array([-1, 0]), np.array([[0.0, 0, 0], [0, 2, 0]]))


def make(frames: int = 5, **changes: object) -> MotionClip:
    fields = {
        "skeleton": SKELETON,
        "rotations": quat.identity(frames, 2),
        "root": np.arange(3.0 * frames).reshape(frames, 3),
        "fps": 25,
    }
    return MotionClip(**{**fields, **changes})  # type: ignore[arg-type]


def test_times() -> None:
    clip = make()
    assert len(clip) == 5
    assert clip.duration == pytest.approx(0.16)
    np.testing.assert_allclose(clip.times, [0, 0.04, 0.08, 0.12, 0.16])
    assert make(1).duration == 0.0


def test_positions_follow_the_chain() -> None:
    clip = make()
    np.testing.assert_allclose(clip.positions[:, 1] - clip.root, [[0, 2, 0]] * 5)
    turned = clip.replace(rotations=np.broadcast_to(quat.exp([0, 0, np.pi / 2]), (5, 2, 4)))
    np.testing.assert_allclose(turned.positions[:, 1] - clip.root, [[-2, 0, 0]] * 5, atol=1e-12)


def test_translations_replace_offsets() -> None:
    moved = make(translations=np.full((5, 2, 3), 7.0))
    np.testing.assert_allclose(moved.positions[:, 1] - moved.root, 7.0)
    np.testing.assert_allclose(moved.positions[:, 0], moved.root)


def test_arrays_are_read_only() -> None:
    clip = make(translations=np.zeros((5, 2, 3)), residual=np.zeros((5, 2)))
    for array in (clip.rotations, clip.root, clip.translations, clip.residual, clip.positions, clip.world[0]):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0  # type: ignore[index]


def test_replace_forgets_what_was_computed() -> None:
    clip = make()
    before = clip.positions
    np.testing.assert_allclose(clip.replace(root=clip.root + 1.0).positions, before + 1.0)


def test_frames_cuts_everything_that_has_frames() -> None:
    source = SourceChannels(((), ("Xrotation",)), np.arange(5.0)[:, None], 1.0, np.zeros((2, 3)), 0.04)
    clip = make(translations=np.random.default_rng(0).random((5, 2, 3)), residual=np.ones((5, 2)), source=source)
    part = clip.frames(1, 4)
    assert len(part) == 3
    np.testing.assert_array_equal(part.root, clip.root[1:4])
    np.testing.assert_array_equal(part.translations, clip.translations[1:4])
    assert part.residual is not None
    assert part.residual.shape == (3, 2)
    assert part.source is not None
    assert part.source.values.tolist() == [[1.0], [2.0], [3.0]]


def test_pickling_keeps_it() -> None:
    clip = make(meta=ClipMeta("a", "child", "walk", "1"))
    back = pickle.loads(pickle.dumps(clip))  # noqa: S301
    np.testing.assert_array_equal(back.rotations, clip.rotations)
    assert back.meta == clip.meta
    assert back.skeleton == clip.skeleton


@pytest.mark.parametrize(
    ("meta", "clip_id"),
    [
        (ClipMeta("p1", "child", "walk", "2"), "child/p1/walk_2"),
        (ClipMeta(style="child", action="walk"), "child/walk"),
        (ClipMeta(), ""),
    ],
)
def test_clip_ids(meta: ClipMeta, clip_id: str) -> None:
    assert meta.clip_id == clip_id


def _with(array: np.ndarray, value: float) -> np.ndarray:
    array = array.copy()
    array[3, 1] = value
    return array


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rotations": quat.identity(5, 3)}, r"shape \(T, 2, 4\)"),
        ({"rotations": quat.identity(0, 2), "root": np.zeros((0, 3))}, "T > 0"),
        ({"root": np.zeros((4, 3))}, r"root must have shape \(5, 3\)"),
        ({"fps": 0.0}, "fps must be positive"),
        ({"fps": float("nan")}, "fps must be positive"),
        ({"fps": float("inf")}, "fps must be positive"),
        ({"rotations": _with(quat.identity(5, 2), np.nan)}, r"rotations holds nan at index \(3, 1, 0\)"),
        ({"root": _with(np.zeros((5, 3)), np.inf)}, r"root holds inf at index \(3, 1\)"),
        ({"rotations": _with(quat.identity(5, 2), 0.1)}, "joint 'b' at frame 3 has length 0.2"),
        ({"translations": np.zeros((5, 2, 2))}, "translations must be finite and of shape"),
        ({"translations": np.full((5, 2, 3), np.nan)}, "translations must be finite"),
        ({"residual": np.zeros((5, 3))}, "residual must be finite and of shape"),
    ],
)
def test_malformed_clips_are_refused(change: dict, message: str) -> None:
    with pytest.raises(ContractError, match=message):
        make(**change)
