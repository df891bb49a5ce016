from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path

import numpy as np
import pytest

from benchmark.errors import MotionFileError
from benchmark.motion import npz, quat
from benchmark.motion.clip import ClipMeta, MotionClip
from benchmark.motion.skeleton import EndSite, Skeleton


@pytest.fixture
def clip(rng: np.random.Generator) -> MotionClip:
    skeleton = Skeleton(
        ("Hips", "左 arm", "tip"),
        np.array([-1, 0, 1]),
        rng.normal(size=(3, 3)),
        (EndSite(2, (0.1, 1e-300, -0.3)),),
        ("ZXY", "XYZ", "YZX"),
        {"hips": 0, "left_shoulder": 1},
    )
    return MotionClip(
        skeleton,
        quat.normalize(rng.normal(size=(7, 3, 4))),
        rng.normal(size=(7, 3)),
        29.97,
        ClipMeta("a1", "child", "walk", "03", "somewhere/ü.bvh"),
        translations=rng.normal(size=(7, 3, 3)),
        residual=rng.random((7, 3)),
    )


def test_everything_comes_back_to_the_bit(clip: MotionClip, tmp_path: Path) -> None:
    npz.save(clip, tmp_path / "clip.npz")
    back = npz.load(tmp_path / "clip.npz")
    assert back.skeleton == clip.skeleton
    assert back.meta == clip.meta
    assert back.fps == clip.fps
    for name in ("rotations", "root", "translations", "residual"):
        np.testing.assert_array_equal(getattr(back, name), getattr(clip, name))


def test_absent_arrays_stay_absent(clip: MotionClip, tmp_path: Path) -> None:
    npz.save(clip.replace(translations=None, residual=None), tmp_path / "clip.npz")
    back = npz.load(tmp_path / "clip.npz")
    assert back.translations is None
    assert back.residual is None


def test_the_name_is_kept_as_given(clip: MotionClip, tmp_path: Path) -> None:
    npz.save(clip, tmp_path / "clip.anything")
    assert [path.name for path in tmp_path.iterdir()] == ["clip.anything"]


def test_saving_is_whole_or_not_at_all(clip: MotionClip, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "clip.npz"
    npz.save(clip, path)
    before = path.read_bytes()

    def fail(*args: object, **kwargs: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", fail)
    with pytest.raises(MotionFileError, match="No space left"):
        npz.save(clip, path)
    assert path.read_bytes() == before
    assert len(list(tmp_path.iterdir())) == 1


def test_saving_into_no_folder(clip: MotionClip, tmp_path: Path) -> None:
    with pytest.raises(MotionFileError, match="folder does not exist"):
        npz.save(clip, tmp_path / "none" / "clip.npz")


@pytest.mark.parametrize("content", [b"", b"junk", b"PK\x03\x04junk", b"\x93NUMPY"])
def test_junk_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "junk.npz"
    path.write_bytes(content)
    with pytest.raises(MotionFileError, match=r"junk\.npz: not a clip"):
        npz.load(path)


def test_missing_and_folder(tmp_path: Path) -> None:
    with pytest.raises(MotionFileError, match="no such file"):
        npz.load(tmp_path / "none.npz")
    with pytest.raises(MotionFileError):
        npz.load(tmp_path)


def test_truncated_and_altered_files_are_refused(clip: MotionClip, tmp_path: Path, rng: np.random.Generator) -> None:
    path = tmp_path / "clip.npz"
    npz.save(clip, path)
    whole = path.read_bytes()
    for cut in rng.integers(0, len(whole) - 1, 40):
        path.write_bytes(whole[:cut])
        with pytest.raises(MotionFileError):
            npz.load(path)
    for at in rng.integers(0, len(whole), 200):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0x5A]) + whole[at + 1 :])
        try:
            back = npz.load(path)
        except MotionFileError:
            continue
        np.testing.assert_array_equal(back.rotations, clip.rotations)  # the byte did not matter


def _repack(path: Path, name: str, content: bytes | None) -> None:
    with zipfile.ZipFile(path) as old:
        parts = {entry: old.read(entry) for entry in old.namelist()}
    if content is None:
        del parts[name]
    else:
        parts[name] = content
    with zipfile.ZipFile(path, "w") as new:
        for entry, data in parts.items():
            new.writestr(entry, data)


@pytest.mark.parametrize("name", ["header", "rotations", "root", "offsets"])
def test_missing_parts_are_refused(clip: MotionClip, tmp_path: Path, name: str) -> None:
    path = tmp_path / "clip.npz"
    npz.save(clip, path)
    _repack(path, f"{name}.npy", None)
    with pytest.raises(MotionFileError, match=name):
        npz.load(path)


def test_pickles_are_never_opened(clip: MotionClip, tmp_path: Path) -> None:
    path = tmp_path / "clip.npz"
    npz.save(clip, path)
    buffer = io.BytesIO()
    np.save(buffer, np.array([{"a": 1}], dtype=object), allow_pickle=True)
    _repack(path, "rotations.npy", buffer.getvalue())
    with pytest.raises(MotionFileError, match="only pickle could read"):
        npz.load(path)


@pytest.mark.parametrize(
    "change",
    [
        {"parents": [-1, 2, 1]},
        {"names": ["a", "a", "b"]},
        {"fps": 0},
        {"fps": "fast"},
        {"roles": {"tail": 1}},
        {"orders": ["ZXY", "XYZ", "AAA"]},
        {"meta": {"unknown": 1}},
        {"end_sites": [[9, [0, 0, 0]]]},
        {"end_sites": [[0, [0, 0]]]},
    ],
)
def test_headers_that_make_no_clip_are_refused(clip: MotionClip, tmp_path: Path, change: dict) -> None:
    path = tmp_path / "clip.npz"
    npz.save(clip, path)
    with np.load(path) as file:
        header = json.loads(file["header"].tobytes())
    buffer = io.BytesIO()
    np.save(buffer, np.frombuffer(json.dumps({**header, **change}).encode(), np.uint8))
    _repack(path, "header.npy", buffer.getvalue())
    with pytest.raises(MotionFileError):
        npz.load(path)
