"""Every way a BVH file can be wrong: the message names the file, the line and what was expected."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.errors import MotionFileError
from benchmark.motion import bvh

GOOD = """HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Arm
  {
    OFFSET 0 10 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 2 0 0
    }
  }
}
MOTION
Frames: 3
Frame Time: 0.04
1 2 3 90 0 0 90 0 0
1 2 3 90 1.5 0 1e1 0 0
1 2 3 90 -0.25 0 90 0 0
"""


def put(folder: Path, content: str | bytes) -> Path:
    path = folder / "broken.bvh"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def swap(old: str, new: str) -> str:
    assert GOOD.count(old) >= 1
    return GOOD.replace(old, new, 1)


CASES: dict[str, tuple[str, int, str]] = {
    "empty": ("", 1, "empty file"),
    "only blanks": (" \n\n \n", 3, "expected HIERARCHY"),
    "something else": ("hello\n", 1, "expected HIERARCHY, found 'hello'"),
    "no root": (swap("ROOT Hips", "JOINT Hips"), 2, "expected ROOT"),
    "root without a name": (swap("ROOT Hips", "ROOT"), 2, "expected a joint name"),
    "no brace": (swap("ROOT Hips\n{", "ROOT Hips\n"), 4, "expected '{' after joint 'Hips', found 'OFFSET'"),
    "two roots": (swap("}\nMOTION", "}\nROOT Other\n{\n}\nMOTION"), 16, "second ROOT"),
    "a root inside": (swap("JOINT Arm", "ROOT Arm"), 6, "missing"),
    "no offset": (swap("    OFFSET 0 10 0\n", ""), 13, "ends without an OFFSET"),
    "two offsets": (swap("OFFSET 0 10 0", "OFFSET 0 10 0\nOFFSET 0 10 0"), 9, "second OFFSET"),
    "short offset": (swap("OFFSET 0 10 0", "OFFSET 0 10"), 9, "found 'CHANNELS' for Z"),
    "offset no number": (swap("OFFSET 0 10 0", "OFFSET 0 ten 0"), 8, "'ten' for Y"),
    "offset nan": (swap("OFFSET 0 10 0", "OFFSET 0 nan 0"), 8, "'nan' for Y"),
    "offset inf": (swap("OFFSET 0 10 0", "OFFSET 0 1e999 0"), 8, "'1e999' for Y"),
    "end site without offset": (swap("      OFFSET 2 0 0\n", ""), 12, "expected OFFSET"),
    "end of something": (swap("End Site", "End Effector"), 10, "expected 'End Site'"),
    "end site not closed": (swap("OFFSET 2 0 0\n    }", "OFFSET 2 0 0\n"), 15, "expected MOTION|expected"),
    "unknown channel": (swap("Zposition Z", "Zscale Z"), 5, "expected channel 3 of 6 of joint 'Hips'.*found 'Zscale'"),
    "too few channels": (swap("CHANNELS 6 Xposition ", "CHANNELS 6 "), 6, "expected channel 6 of 6.*found 'JOINT'"),
    "too many channels": (swap("CHANNELS 3 Z", "CHANNELS 3 Yrotation Z"), 9, "listed twice|found 'Yrotation'"),
    "repeated channel": (swap("3 Zrotation Xrotation Yrotation", "3 Zrotation Xrotation Zrotation"), 9, "listed twice"),
    "channel count no number": (swap("CHANNELS 3", "CHANNELS three"), 9, "number of channels"),
    "channel count too large": (swap("CHANNELS 3", "CHANNELS 7"), 9, "number of channels"),
    "channels twice": (swap("    End Site", "    CHANNELS 0\n    End Site"), 10, "second CHANNELS"),
    "channels after a joint": (
        swap("  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n", "").replace(
            "}\nMOTION", "CHANNELS 1 Yrotation\n}\nMOTION"
        ),
        14,
        "before its first JOINT",
    ),
    "two joints of one name": (
        swap("JOINT Arm", "JOINT Hips"),
        6,
        r"second joint named 'Hips' \(the first is on line 2\)",
    ),
    "brace in a name": (swap("JOINT Arm", "JOINT A}rm"), 6, "brace"),
    "stray word": (swap("  JOINT Arm", "  SCALE 3\n  JOINT Arm"), 6, "found 'SCALE'"),
    "brace missing at the end": (swap("}\nMOTION", "MOTION"), 14, "the hierarchy ends here"),
    "one brace too many": (swap("}\nMOTION", "}\n}\nMOTION"), 16, "expected MOTION after the hierarchy, found '}'"),
    "no MOTION": (swap("MOTION\n", ""), 16, "expected MOTION after the hierarchy, found 'Frames:'"),
    "ends before MOTION": (GOOD.split("MOTION")[0], 15, "expected MOTION after the hierarchy, but the file ends"),
    "ends after MOTION": (GOOD.split("Frames")[0], 16, "expected 'Frames: N', found the end of the file"),
    "ends after frames": (GOOD.split("Frame Time")[0], 17, "expected 'Frame Time: seconds', found the end"),
    "frames no number": (swap("Frames: 3", "Frames: three"), 17, "expected 'Frames: N', found 'Frames: three'"),
    "frames negative": (swap("Frames: 3", "Frames: -3"), 17, "expected 'Frames: N'"),
    "frames a fraction": (swap("Frames: 3", "Frames: 3.5"), 17, "expected 'Frames: N'"),
    "no frames": (swap("Frames: 3", "Frames: 0"), 17, "at least one frame"),
    "more frames than rows": (
        swap("Frames: 3", "Frames: 4").replace(" 1.5 ", f" 1.5{'0' * 40} "),
        17,
        "3 rows follow.*should be 'Frames: 3'",
    ),
    "fewer frames than rows": (swap("Frames: 3", "Frames: 2"), 21, "beyond the 2 announced"),
    "frames beyond the file's size": (swap("Frames: 3", "Frames: 1000000000000"), 17, "hold 3 at most"),
    "frames beyond an integer": (swap("Frames: 3", "Frames: " + "9" * 40), 17, "expected 'Frames: N'"),
    "frame time zero": (swap("0.04", "0"), 18, "positive frame time, found '0'"),
    "frame time negative": (swap("0.04", "-0.04"), 18, "positive frame time, found '-0.04'"),
    "frame time nan": (swap("0.04", "nan"), 18, "expected 'Frame Time: seconds'"),
    "frame time missing": (swap("Frame Time: 0.04\n", ""), 18, "expected 'Frame Time: seconds', found '1 2 3"),
    "no rows": (GOOD.split("1 2 3 90 0")[0], 17, "cut short"),
    "a value too few": (swap("90 1.5 0 1e1 0 0", "90 1.5 0 1e1 0"), 20, "8 values where the hierarchy has 9"),
    "a value too many": (swap("90 1.5 0 1e1 0 0", "90 1.5 0 1e1 0 0 7"), 20, "10 values where the hierarchy has 9"),
    "rows run together": (swap("0 0\n1 2 3 90 1", "0 0 1 2 3 90 1"), 19, "18 values"),
    "a row over two lines": (swap("90 1.5", "90\n1.5"), 20, "4 values"),
    "last row cut": (GOOD[:-5], 21, "values where"),
    "a word": (swap("1.5", "x1.5"), 20, "'x1.5' is not a number.*value 5, Xrotation of 'Hips'"),
    "nan": (swap("1.5", "nan"), 20, "'nan' is not a number.*value 5, Xrotation of 'Hips'"),
    "inf": (swap("1.5", "-inf"), 20, "'-inf' is not a number"),
    "overflow": (swap("1.5", "1e400"), 20, "'1e400' is not a number"),
    "beyond reason": (swap("1.5", "2e12"), 20, "'2e12' is not a number of at most 1e.12"),
    "underscore": (swap("1.5", "1_5"), 20, "'1_5' is not a number"),
    "hexadecimal": (swap("1.5", "0x15"), 20, "'0x15' is not a number"),
    "decimal comma": (swap("1.5", "1,5"), 20, "'1,5' is not a number"),
    "two points": (swap("1.5", "1.5.2"), 20, "'1.5.2' is not a number"),
    "two signs": (swap("1.5", "--1.5"), 20, "'--1.5' is not a number"),
    "sign in the middle": (swap("1.5", "1-5"), 20, "'1-5' is not a number"),
    "sign alone": (swap("1.5", "-"), 20, "'-' is not a number"),
    "point alone": (swap("1.5", "."), 20, "'.' is not a number"),
    "exponent alone": (swap("1.5", "e5"), 20, "'e5' is not a number"),
    "exponent without digits": (swap("1.5", "1e"), 20, "'1e' is not a number"),
    "exponent with a point": (swap("1.5", "1e1.5"), 20, "'1e1.5' is not a number"),
    "two exponents": (swap("1.5", "1e1e1"), 20, "'1e1e1' is not a number"),
    "colon": (swap("1.5", "1:5"), 20, "'1:5' is not a number"),
    "semicolon": (swap("1.5", ";"), 20, "';' is not a number"),
    "slash": (swap("1.5", "1/5"), 20, "'1/5' is not a number"),
    "digits of another script": (swap("1.5", "١"), 20, "is not a number"),
    "nul byte": (swap("1.5", "1\x005"), 20, "is not a number"),
    "comment": (swap("1 2 3 90 1.5", "# comment\n1 2 3 90 1.5"), 20, "'#' is not a number"),
    "no channel at all": (
        "HIERARCHY\nROOT a\n{\nOFFSET 0 0 0\nCHANNELS 0\n}\nMOTION\nFrames: 1\nFrame Time: 1\n",
        8,
        "no joint has a channel",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_the_message_names_the_line_and_what_was_expected(tmp_path: Path, case: str) -> None:
    content, line, message = CASES[case]
    path = put(tmp_path, content)
    with pytest.raises(MotionFileError, match=message) as caught:
        bvh.load(path, unit="cm")
    assert caught.value.line == line
    assert caught.value.path == path
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("row", [0, 1, 4999, 9999])
@pytest.mark.parametrize(("old", "new", "message"), [(" 7 ", " seven ", "value 4"), (" 7 ", " ", "8 values")])
def test_the_line_is_right_far_into_a_file(tmp_path: Path, row: int, old: str, new: str, message: str) -> None:
    rows = ["1 2 3 7 0 0 90 0 0"] * 10000
    rows[row] = rows[row].replace(old, new)
    head = GOOD.split("1 2 3")[0].replace("Frames: 3", "Frames: 10000")
    path = put(tmp_path, head + "\n".join(rows).replace("\n", "\n\n", 3) + "\n")
    blank = 0 if row == 0 else 1 if row == 1 else 3
    with pytest.raises(MotionFileError, match=message) as caught:
        bvh.load(path, unit="cm")
    assert caught.value.line == 19 + row + blank


def test_surplus_rows_far_into_a_file(tmp_path: Path) -> None:
    head = GOOD.split("1 2 3")[0].replace("Frames: 3", "Frames: 9000")
    path = put(tmp_path, head + "\n".join(["1 2 3 7 0 0 90 0 0"] * 10000))
    with pytest.raises(MotionFileError, match="beyond the 9000") as caught:
        bvh.load(path, unit="cm")
    assert caught.value.line == 19 + 9000


def test_missing_file_folder_and_link_to_nothing(tmp_path: Path) -> None:
    with pytest.raises(MotionFileError, match="no such file"):
        bvh.load(tmp_path / "none.bvh")
    with pytest.raises(MotionFileError, match="a folder"):
        bvh.load(tmp_path)
    (tmp_path / "link.bvh").symlink_to(tmp_path / "none.bvh")
    with pytest.raises(MotionFileError, match="no such file"):
        bvh.load(tmp_path / "link.bvh")
    with pytest.raises(MotionFileError, match="cannot be read"):
        bvh.load(tmp_path / "null\x00byte.bvh")


def test_pipes_and_devices_are_refused_without_being_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.bvh")
    with pytest.raises(MotionFileError, match="pipe or device"):
        bvh.load(tmp_path / "pipe.bvh")
    with pytest.raises(MotionFileError, match="pipe or device"):
        bvh.load(Path("/dev/zero"))


def test_files_beyond_the_limit_are_refused_unread(tmp_path: Path) -> None:
    path = put(tmp_path, GOOD)
    os.truncate(path, 1 << 40)  # sparse: takes no space
    with pytest.raises(MotionFileError, match=f"{1 << 40} bytes; the limit is {1 << 30}"):
        bvh.load(path)
    path = put(tmp_path, GOOD)
    with pytest.raises(MotionFileError, match=r"limit is 100 \(max_bytes\)"):
        bvh.load(path, max_bytes=100)
    assert len(bvh.load(path, unit="cm", max_bytes=len(GOOD))) == 3


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"\0" * 3_000_000, "not a text file"),
        (bytes(range(256)) * 100, "not a text file"),
        (b"\x89PNG\r\n\x1a\n" + bytes(200), "not a text file"),
        (b"a" * 9_000_000, "expected HIERARCHY"),
        (b"HIERARCHY " * 900_000, "expected ROOT"),
        (b"HIERARCHY\nROOT " + b"a" * 9_000_000, "does not end within its first 4194304 bytes"),
        (b"HIERARCHY\nROOT a {\nOFFSET 0 0 0\n" + b"\n" * 9_000_000, "does not end within its first 4194304 bytes"),
        (GOOD.encode("utf-16"), "UTF-16"),
        (b"PK\x03\x04" + bytes(100), "not a text file"),
    ],
)
def test_junk(tmp_path: Path, content: bytes, message: str) -> None:
    with pytest.raises(MotionFileError, match=message):
        bvh.load(put(tmp_path, content), unit="cm")


def test_joints_without_channels_cannot_fill_the_memory(tmp_path: Path) -> None:
    """A megabyte of rows of one digit, on joints that take no room in a row, is gigabytes of rotations."""
    joints, frames = 400, 400_000
    still = "".join(f"JOINT j{i}\n{{\nOFFSET 0 1 0\n}}\n" for i in range(joints))
    head = f"HIERARCHY\nROOT r\n{{\nOFFSET 0 0 0\nCHANNELS 1 Xrotation\n{still}}}\n"
    line = head.count("\n") + 2
    path = put(tmp_path, f"{head}MOTION\nFrames: {frames}\nFrame Time: 0.01\n" + "1\n" * frames)
    with pytest.raises(MotionFileError, match=f"line {line}: 'Frames: 400000' of 401 joints .* raise max_bytes"):
        bvh.load(path)


def test_one_endless_row(tmp_path: Path) -> None:
    head = GOOD.split("1 2 3")[0].replace("Frames: 3", "Frames: 1")
    with pytest.raises(MotionFileError, match="a row of 9 values was expected") as caught:
        bvh.load(put(tmp_path, head + "1 " * 3_000_000), unit="cm")
    assert caught.value.line == 19
    with pytest.raises(MotionFileError, match="a row of 9 values was expected"):
        bvh.load(put(tmp_path, head + "1" * 3_000_000 + "\n"), unit="cm")


def test_a_million_nested_joints_neither_crash_nor_linger(tmp_path: Path) -> None:
    nest = "".join(f"JOINT j{i} {{\nOFFSET 0 0 0\n" for i in range(1_000_000))
    with pytest.raises(MotionFileError, match="does not end within"):
        bvh.load(put(tmp_path, "HIERARCHY\nROOT a {\nOFFSET 0 0 0\n" + nest), unit="cm")


TOKENS = [
    "{",
    "}",
    "0",
    "-",
    "nan",
    "JOINT",
    "End Site",
    "OFFSET",
    "CHANNELS",
    "1e308",
    "-1e-400",
    "Xrotation",
    "\n",
    "MOTION",
    "é",
    "\x00",
]


@st.composite
def mutated(draw: st.DrawFn) -> bytes:
    data = GOOD.encode()
    for _ in range(draw(st.integers(1, 3))):
        kind = draw(st.sampled_from(["cut", "delete", "byte", "token", "swap", "repeat"]))
        at = draw(st.integers(0, max(len(data) - 1, 0)))
        if kind == "cut":
            data = data[:at]
        elif kind == "delete":
            data = data[:at] + data[at + draw(st.integers(1, 30)) :]
        elif kind == "byte":
            data = data[:at] + bytes([draw(st.integers(0, 255))]) + data[at + 1 :]
        elif kind == "repeat":
            data = data[:at] + data[at : at + draw(st.integers(1, 40))] * 2 + data[at:]
        else:
            words = data.split(b" ")
            i, j = (draw(st.integers(0, len(words) - 1)) for _ in range(2))
            if kind == "token":
                words[i] = draw(st.sampled_from(TOKENS)).encode()
            else:
                words[i], words[j] = words[j], words[i]
            data = b" ".join(words)
    return data


@settings(max_examples=600, deadline=None)
@given(mutated())
def test_a_damaged_file_is_refused_or_read_but_never_breaks_the_reader(
    tmp_path_factory: pytest.TempPathFactory, data: bytes
) -> None:
    path = put(tmp_path_factory.getbasetemp(), data)
    try:
        clip = bvh.load(path, unit="cm")
    except MotionFileError as error:
        assert str(path) in str(error)
    else:
        assert np.isfinite(clip.positions).all()
        bvh.save(clip, path)
        again = bvh.load(path, unit="cm")
        assert clip.source is not None
        assert again.source is not None
        np.testing.assert_array_equal(again.source.values, clip.source.values)


def test_the_good_file_is_good(tmp_path: Path) -> None:
    assert len(bvh.load(put(tmp_path, GOOD), unit="cm")) == 3


@pytest.mark.parametrize("error", [lambda p: MotionFileError(p, "odd", line=3)])
def test_errors_cross_process_borders(tmp_path: Path, error: Callable[[Path], MotionFileError]) -> None:
    import pickle

    made = error(tmp_path)
    back = pickle.loads(pickle.dumps(made))  # noqa: S301
    assert (str(back), back.path, back.line) == (str(made), made.path, made.line)
