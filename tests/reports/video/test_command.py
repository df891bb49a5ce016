"""The verb ``video``."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmark.cli import call
from benchmark.data.synthetic import SyntheticDataset
from benchmark.motion import bvh, npz
from benchmark.motion.quat import from_axis_angle, mul, rotate
from benchmark.runner.views import RESULT_COLUMNS

imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Path:
    """A folder with a BVH and an .npz of half a second each."""
    folder = tmp_path_factory.mktemp("clips")
    corpus = SyntheticDataset()
    for style, name in (("adult", "adult.bvh"), ("child", "child.npz")):
        clip_id = next(r.clip_id for r in corpus.records if r.style == style and r.action == "jog")
        clip = corpus.load(clip_id).frames(30, 60)
        (bvh if name.endswith("bvh") else npz).save(clip, folder / name)
    return folder


@pytest.fixture(scope="module")
def finished(files, tmp_path_factory) -> Path:
    """A run folder with what a video needs of one: two source clips and what three methods made of them."""
    import pandas as pd

    folder = tmp_path_factory.mktemp("runs") / "small"
    rows = []
    for method, name in (
        ("child-reference", "child.npz"),
        ("dynamic-scaling[time]", "child.npz"),
        ("identity", "child.npz"),
    ):
        cell = folder / "cells" / f"key-{method}"
        (cell / "outputs").mkdir(parents=True)
        items = []
        for number, action in enumerate(("jog", "walk")):
            stem = f"{number:04d}"
            clip_id = f"adult/adult001/{action}_1"
            items.append(
                {
                    "clip_id": clip_id,
                    "actor": "adult001",
                    "action": action,
                    "state": "ok",
                    "reason": "",
                    "stem": stem,
                    "seen_actor": False,
                    "reference_ids": [],
                    "has_truth": False,
                    "variants": {"raw": None},
                    "copied_from": None,
                    "transfer_seconds": 0.1,
                }
            )
            (cell / "outputs" / f"{stem}.raw.npz").write_bytes((files / name).read_bytes())
            rows.append(
                {
                    **dict.fromkeys(RESULT_COLUMNS, ""),
                    "cell_key": cell.name,
                    "method": method,
                    "repetition": 0,
                    "dataset": "synthetic",
                    "source_style": "adult",
                    "target_style": "child",
                    "clip_id": clip_id,
                    "variant": "raw",
                    "metric": "content/x",
                    "status": "ok",
                    "value": 0.0,
                    "actor": "adult001",
                    "action": action,
                }
            )
        (cell / "items.json").write_text(json.dumps(items))
    pd.DataFrame(rows).to_parquet(folder / "results.parquet")
    (folder / "leaderboard.csv").write_text("dataset\n")
    return folder


def run(*arguments: object) -> int:
    return call(["video", *map(str, arguments)])


def frames_of(path: Path) -> list[np.ndarray]:
    reader = imageio_ffmpeg.read_frames(str(path))
    width, height = next(reader)["size"]
    return [np.frombuffer(frame, dtype=np.uint8).reshape(height, width, 3) for frame in reader]


def test_a_file_becomes_a_video(files, tmp_path, capsys):
    out = tmp_path / "adult.mp4"
    assert run(files / "adult.bvh", "-o", out, "--size", "160x120") == 0
    said = capsys.readouterr().out
    frames = frames_of(out)
    assert f"{len(frames)} frames" in said
    assert "160 x 120" in said
    assert "frames/s" in said
    assert frames[0].shape == (120, 160, 3)


def test_several_files_stand_side_by_side_with_their_names(files, tmp_path):
    both, titled = tmp_path / "both.png", tmp_path / "titled.png"
    pair = (files / "adult.bvh", files / "child.npz")
    assert run(*pair, "-o", both, "--still", "0.2", "--size", "320x160") == 0
    assert run(*pair, "-o", titled, "--still", "0.2", "--size", "320x160", "--title", "a", "--title", "b") == 0
    assert both.read_bytes() != titled.read_bytes()
    assert run(*pair, "-o", both, "--still", "0.2", "--title", "one only") == 2


def test_length_and_rate(files, tmp_path):
    out = tmp_path / "loop.mp4"
    assert run(files / "adult.bvh", "-o", out, "--size", "160x120", "--seconds", "4", "--fps", "10") == 0
    assert len(frames_of(out)) == 40


def test_a_file_is_turned_to_the_camera_and_set_on_the_floor(files, tmp_path):
    clip = bvh.load(files / "adult.bvh")
    turn = from_axis_angle([0.0, 1.0, 0.0], 2.3)
    turned = clip.rotations.copy()
    turned[:, 0] = mul(turn, turned[:, 0])
    root = rotate(turn, clip.root) + [3.0, 0.7, -2.0]
    bvh.save(clip.replace(rotations=turned, root=root, source=None), tmp_path / "turned.bvh")
    for name, path in (("a", files / "adult.bvh"), ("b", tmp_path / "turned.bvh")):
        assert run(path, "-o", tmp_path / f"{name}.png", "--still", "0", "--size", "160x120") == 0
    from PIL import Image

    one, other = (np.asarray(Image.open(tmp_path / f"{name}.png")).astype(int) for name in "ab")
    assert np.abs(one - other).max() < 12


def test_a_run_is_shown_side_by_side_and_blind(finished, tmp_path, capsys):
    first = "adult/adult001/jog_1"
    out = tmp_path / "run.mp4"
    assert run(finished, "-o", out, "--clip", first, "--size", "320x160", "--fps", "5") == 0
    said = capsys.readouterr().out
    assert "adult input, dynamic-scaling[time], held-out performer" in said
    assert first.encode() in out.read_bytes()
    assert b"licence: MIT" in out.read_bytes()
    blind = tmp_path / "blind.mp4"
    assert run(finished, "-o", blind, "--clip", first, "--size", "320x160", "--fps", "5", "--blind") == 0
    assert first.encode() not in blind.read_bytes()
    few = tmp_path / "few.png"
    assert (
        run(finished, "-o", few, "--clip", first, "--methods", "identity", "--still", "0.1", "--size", "320x160") == 0
    )
    assert "dynamic" not in capsys.readouterr().out.rsplit("\n", 3)[-3]


def test_all_clips_of_a_run(finished, tmp_path):
    assert run(finished, "-o", tmp_path / "all", "--all", "--size", "160x96", "--fps", "2", "-m", "identity") == 0
    assert len(list((tmp_path / "all").glob("*.mp4"))) == 2


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("RUN", "-o", "x.mp4", "--clip", "adult/nobody"), "has no clip 'adult/nobody'"),
        (("RUN", "-o", "x.mp4", "--clip", "adult/"), "2 clips of the run have 'adult/'"),
        (("RUN", "-o", "x.mp4", "-m", "dynamic-scaling"), "did you mean 'dynamic-scaling[time]'"),
        (("RUN", "-o", "x.mp4", "--task", "adult:chidl"), "did you mean 'adult:child'"),
        (("RUN", "-o", "x.mp4", "--all"), "give a folder"),
        (("RUN", "-o", "x.mp4", "--title", "t"), "are for files"),
        (("FILE", "-o", "x.avi"), "does not end in .mp4"),
        (("FILE", "-o", "x.mp4", "--still", "1"), "does not end in .png"),
        (("FILE", "-o", "x.mp4", "--clip", "c"), "are for a run"),
        (("FILE", "-o", "x.mp4", "--loop", "--seconds", "3"), "give one of them"),
        (("FILE", "-o", "x.mp4", "--size", "161x120"), "both even"),
        (("FILE", "-o", "x.mp4", "--fps", "0"), "frames per second"),
        (("FILE", "-o", "x.png", "--still", "77"), "between 0 and"),
    ],
)
def test_what_cannot_be_drawn_is_told(finished, files, tmp_path, monkeypatch, capsys, arguments, words):
    monkeypatch.chdir(tmp_path)
    places = {"RUN": finished, "FILE": files / "adult.bvh"}
    assert run(*(places.get(argument, argument) for argument in arguments)) == 2
    assert words in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_size_that_is_none_is_told(files, capsys):
    assert run(files / "adult.bvh", "-o", "x.mp4", "--size", "big") == 2
    assert "640x480" in capsys.readouterr().err


def test_without_ffmpeg_the_extra_is_named(files, tmp_path, monkeypatch, capsys):
    import sys

    monkeypatch.delenv("IMAGEIO_FFMPEG_EXE", raising=False)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    assert run(files / "adult.bvh", "-o", tmp_path / "x.mp4") == 2
    assert "[video]" in capsys.readouterr().err


def test_joints_that_are_not_known_are_drawn_as_bones(tmp_path, capsys):
    (tmp_path / "arm.bvh").write_text(
        "HIERARCHY\nROOT a\n{\n OFFSET 0 0 0\n CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n"
        " JOINT b\n {\n  OFFSET 0 0.4 0\n  CHANNELS 3 Zrotation Xrotation Yrotation\n"
        "  End Site\n  {\n   OFFSET 0 0.4 0\n  }\n }\n}\n"
        "MOTION\nFrames: 2\nFrame Time: 0.0333333\n0 0 0 0 0 0 0 0 0\n0 0 0 0 0 0 40 0 0\n"
    )
    code = run(tmp_path / "arm.bvh", "-o", tmp_path / "arm.png", "--still", "0", "--size", "160x120")
    said = capsys.readouterr()
    assert code == 0, said.err
    assert "bare bones" in said.out
