"""The file that comes out, read back by another decoder run."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from benchmark.errors import ConfigError
from reports.video import EncoderError, Panel, render, write_still, write_video
from reports.video.encoder import find_ffmpeg

imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")

SMALL = (160, 120)


def decoded(path):
    reader = imageio_ffmpeg.read_frames(str(path))
    meta = next(reader)
    width, height = meta["size"]
    return meta, [np.frombuffer(frame, dtype=np.uint8).reshape(height, width, 3) for frame in reader]


def test_what_is_decoded_is_what_was_drawn(walk, tmp_path):
    path = tmp_path / "folder" / "walk.mp4"
    done = []
    facts = write_video([Panel(walk)], path, size=SMALL, fps=30, footer="licence", report=done.append)
    meta, frames = decoded(path)
    drawn = list(render([Panel(walk)], size=SMALL, fps=30, footer="licence"))
    assert (facts.frames, len(frames), len(drawn)) == (61, 61, 61)
    assert facts.seconds == pytest.approx(61 / 30)
    assert meta["size"] == SMALL
    assert meta["fps"] == 30
    assert meta["duration"] == pytest.approx(facts.seconds, abs=0.05)
    assert (meta["codec"], meta["pix_fmt"].split("(")[0]) == ("h264", "yuv420p")
    assert facts.bytes == path.stat().st_size
    for ours, theirs in zip(drawn[::20], frames[::20], strict=True):
        assert np.abs(ours.astype(int) - theirs).mean() < 4
    assert done == sorted(done)
    assert done[-1] == 1.0
    assert [entry.name for entry in path.parent.iterdir()] == ["walk.mp4"]


def test_the_index_comes_before_the_pictures(walk, tmp_path):
    path = tmp_path / "walk.mp4"
    write_video([Panel(walk)], path, size=SMALL, fps=10)
    data = path.read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")


def test_ten_seconds_with_repeat_cards(walk, tmp_path):
    path = tmp_path / "stimulus.mp4"
    facts = write_video([Panel(walk)], path, size=SMALL, fps=10, seconds=10.0, sides=False, normalise="height")
    _, frames = decoded(path)
    assert facts.frames == len(frames) == 100
    # Two seconds and a frame, then a second of card.
    card = [frame.min(axis=-1).mean() > 240 for frame in frames]
    assert card[:21] == [False] * 21
    assert card[21:31] == [True] * 10
    assert card[31] is np.False_ or card[31] is False
    assert (frames[25].min(axis=-1) < 120).any()
    without = tmp_path / "without.mp4"
    write_video([Panel(walk)], without, size=SMALL, fps=10, seconds=10.0, repeat_card=False)
    assert not any(frame.min(axis=-1).mean() > 240 for frame in decoded(without)[1])


def test_the_same_input_gives_the_same_bytes(walk, jump, tmp_path):
    panels = [Panel(walk), Panel(jump)]
    one, two = (
        write_video(panels, tmp_path / name, size=SMALL, fps=10, footer="x", metadata={"title": "t"})
        for name in ("a.mp4", "b.mp4")
    )
    assert one == two
    assert (tmp_path / "a.mp4").read_bytes() == (tmp_path / "b.mp4").read_bytes()


def test_a_stimulus_says_nothing_of_where_it_comes_from(walk, tmp_path):
    secret = walk.replace(
        meta=type(walk.meta)(actor="adult009", style="adult", action="walk", source="cyclegan-cell.npz")
    )
    write_video([Panel(secret)], tmp_path / "0a1b.mp4", size=SMALL, fps=10)
    data = (tmp_path / "0a1b.mp4").read_bytes().lower()
    # Words of three letters turn up in compressed pictures by chance.
    for word in (b"cyclegan", b"adult", b"walk", b"0a1b", str(tmp_path).encode()):
        assert word not in data
    plain = write_video([Panel(walk)], tmp_path / "other.mp4", size=SMALL, fps=10)
    assert plain.sha256 == write_video([Panel(secret)], tmp_path / "0a1b.mp4", size=SMALL, fps=10).sha256
    write_video([Panel(walk)], tmp_path / "told.mp4", size=SMALL, fps=10, metadata={"title": "told-title"})
    assert b"told-title" in (tmp_path / "told.mp4").read_bytes()


def test_other_suffixes_and_folders_are_refused(walk, tmp_path):
    with pytest.raises(ConfigError, match=r"does not end in \.mp4"):
        write_video([Panel(walk)], tmp_path / "walk.avi", size=SMALL)
    with pytest.raises(ConfigError, match=r"does not end in \.png"):
        write_still([Panel(walk)], tmp_path / "walk.jpg", at=0.0, size=SMALL)
    (tmp_path / "there.mp4").mkdir()
    with pytest.raises(ConfigError, match="is a folder"):
        write_video([Panel(walk)], tmp_path / "there.mp4", size=SMALL)


def test_a_failing_ffmpeg_leaves_the_old_file_and_no_rest(walk, tmp_path, monkeypatch):
    path = tmp_path / "walk.mp4"
    path.write_bytes(b"old")
    broken = tmp_path / "ffmpeg"
    broken.write_text(f"#!{sys.executable}\nimport sys\nsys.stderr.write('Unknown encoder libx264\\n')\nsys.exit(1)\n")
    broken.chmod(0o755)
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(broken))
    with pytest.raises(EncoderError, match="Unknown encoder libx264"):
        write_video([Panel(walk)], path, size=SMALL, fps=10)
    assert path.read_bytes() == b"old"
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["ffmpeg", "walk.mp4"]


def test_an_interrupted_drawing_leaves_the_old_file_and_no_rest(walk, tmp_path):
    path = tmp_path / "walk.mp4"
    path.write_bytes(b"old")

    def stop(share: float) -> None:
        if share > 0.3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_video([Panel(walk)], path, size=SMALL, fps=10, report=stop)
    assert path.read_bytes() == b"old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["walk.mp4"]


def test_the_environment_names_the_ffmpeg(monkeypatch):
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", sys.executable)
    assert find_ffmpeg() == sys.executable
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", "/nowhere/ffmpeg")
    with pytest.raises(EncoderError, match="/nowhere/ffmpeg"):
        find_ffmpeg()


def test_without_the_wheel_the_error_names_the_extra(monkeypatch):
    monkeypatch.delenv("IMAGEIO_FFMPEG_EXE", raising=False)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(EncoderError, match=r"\[video\]"):
        find_ffmpeg()


def test_a_still_is_one_frame(walk, tmp_path):
    from PIL import Image

    path = tmp_path / "walk.png"
    write_still([Panel(walk, "walk")], path, at=1.0, size=SMALL, footer="licence")
    frames = list(render([Panel(walk, "walk")], size=SMALL, fps=10, footer="licence"))
    np.testing.assert_array_equal(np.asarray(Image.open(path)), frames[10])


def test_importing_needs_neither_pillow_nor_matplotlib():
    heavy = "[name for name in ('PIL', 'matplotlib', 'scipy', 'pandas', 'imageio_ffmpeg') if name in sys.modules]"
    code = f"import sys; import reports.video; print({heavy})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
