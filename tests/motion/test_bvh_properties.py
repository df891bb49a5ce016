"""Random hierarchies, channel orders and numbers, against a reader of a few lines that knows no tricks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from benchmark.errors import MotionFileError
from benchmark.motion import _bvh_numbers, _bvh_text, bvh, quat
from benchmark.motion._bvh_fixed import read_fixed
from benchmark.motion.rotations import to_matrix

AXES = "XYZ"


@dataclass
class Case:
    """A file, and what it says."""

    text: str
    values: np.ndarray
    channels: list[list[str]]
    parents: list[int]


@st.composite
def files(draw: st.DrawFn) -> Case:
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    joints = draw(st.integers(1, 12))
    parents = [-1, *(draw(st.integers(max(0, j - 3), j - 1)) for j in range(1, joints))]
    children = {j: [c for c in range(joints) if parents[c] == j] for j in range(joints)}
    lines, channels, order = ["HIERARCHY"], [], []

    def block(joint: int) -> None:
        at = len(order)
        order.append(joint)
        rotations = [f"{a}rotation" for a in draw(st.permutations(AXES))][: draw(st.sampled_from([3, 3, 3, 2, 1, 0]))]
        positions = [f"{a}position" for a in AXES] if joint == 0 or draw(st.integers(0, 4)) == 0 else []
        names = draw(st.permutations(positions + rotations)) if draw(st.booleans()) else positions + rotations
        channels.append(list(names))
        lines.extend(
            [f"{'JOINT' if at else 'ROOT'} j{at}", "{", "OFFSET " + " ".join(map(repr, rng.normal(0, 9, 3).tolist()))]
        )
        lines.append(" ".join(["CHANNELS", str(len(names)), *names]))
        for _ in range(draw(st.sampled_from([0, 0, 1, 2]))):
            lines.extend(["End Site", "{", "OFFSET 0.1 -2 3e-1", "}"])
        for child in children[joint]:
            block(child)
        lines.append("}")

    block(0)
    frames = draw(st.integers(1, 9))
    columns = sum(map(len, channels))
    style = draw(st.sampled_from(["%.6f", "%.4f", "%g", "%r", "%d", "%.12f", "%e"]))
    scale = draw(st.sampled_from([1.0, 90.0, 400.0, 1e-5]))
    raw = rng.normal(0, scale, (frames, columns))
    if draw(st.booleans()):
        raw = np.where(
            rng.random(raw.shape) < 0.5, rng.choice([0.0, 90.0, -90.0, 180.0, -180.0, 270.0, 45.0], raw.shape), raw
        )
    words = [[repr(v) if style == "%r" else style % v for v in row] for row in raw.tolist()]
    lines += ["MOTION", f"Frames: {frames}", "Frame Time: 0.0333333", *(" ".join(row) for row in words)]
    # Parents in file order, which is depth first.
    renumbered = [-1 if parents[j] < 0 else order.index(parents[j]) for j in order]
    return Case("\n".join(lines) + "\n", np.array(words, dtype=float).reshape(frames, columns), channels, renumbered)


def plain_rotations(case: Case) -> np.ndarray:
    """(T, J, 3, 3) by scipy, one joint at a time."""
    out, column = [], 0
    for names in case.channels:
        axes = "".join(name[0] for name in names if name.endswith("rotation"))
        at = [column + i for i, name in enumerate(names) if name.endswith("rotation")]
        column += len(names)
        if axes:
            angles = case.values[:, at]
            out.append(Rotation.from_euler(axes, angles, degrees=True).as_matrix())
        else:
            out.append(np.broadcast_to(np.eye(3), (len(case.values), 3, 3)))
    return np.stack(out, axis=1)


@settings(max_examples=120, deadline=None)
@given(files())
def test_loading_saving_and_loading_again(tmp_path_factory: pytest.TempPathFactory, case: Case) -> None:
    folder = tmp_path_factory.getbasetemp()
    path, copy = folder / "property.bvh", folder / "property-copy.bvh"
    path.write_text(case.text)
    if case.values.shape[1] == 0:
        with pytest.raises(MotionFileError, match="no joint has a channel"):
            bvh.load(path, unit="cm")
        return
    clip = bvh.load(path, unit="cm")
    assert clip.source is not None
    np.testing.assert_array_equal(clip.source.values, case.values)
    assert [list(names) for names in clip.source.channels] == case.channels
    assert clip.skeleton.parents.tolist() == case.parents
    np.testing.assert_allclose(to_matrix(clip.rotations), plain_rotations(case), atol=1e-12)

    bvh.save(clip, copy)
    again = bvh.load(copy, unit="cm")
    assert again.source is not None
    np.testing.assert_array_equal(again.source.values, clip.source.values)
    np.testing.assert_array_equal(again.source.offsets, clip.source.offsets)
    assert again.source.channels == clip.source.channels
    assert again.skeleton.same_topology(clip.skeleton)
    np.testing.assert_array_equal(again.rotations, clip.rotations)

    bvh.save(clip.replace(source=None), copy)
    again = bvh.load(copy, unit="cm")
    assert quat.angle(again.rotations, clip.rotations).max() < 1e-9
    np.testing.assert_allclose(again.positions, clip.positions, atol=1e-8)


@settings(max_examples=40, deadline=None)
@given(files(), st.integers(0, 2**32))
def test_changed_clips_come_back_too(tmp_path_factory: pytest.TempPathFactory, case: Case, seed: int) -> None:
    if case.values.shape[1] == 0:
        return
    path = tmp_path_factory.getbasetemp() / "changed.bvh"
    path.write_text(case.text)
    clip = bvh.load(path, unit="cm")
    rng = np.random.default_rng(seed)
    where = rng.random(clip.rotations.shape[:2]) < rng.choice([0.0, 0.1, 1.0])
    turned = np.where(
        where[..., None], quat.mul(clip.rotations, quat.exp(rng.normal(0, 1, (*where.shape, 3)))), clip.rotations
    )
    changed = clip.replace(
        rotations=turned,
        root=clip.root + rng.choice([0.0, 1.0]) * rng.normal(size=clip.root.shape),
        skeleton=clip.skeleton.scaled(rng.choice([1.0, 0.6])) if clip.translations is None else clip.skeleton,
    )
    bvh.save(changed, path)
    again = bvh.load(path, unit="cm")
    assert quat.angle(again.rotations, changed.rotations).max() < 1e-9
    np.testing.assert_allclose(again.positions, changed.positions, atol=3e-6)


numbers = st.one_of(
    st.floats(-1e12, 1e12).map(repr),
    st.floats(-1000, 1000).map(lambda v: f"{v:.6f}"),
    st.floats(-1e12, 1e12).map(lambda v: f"{v:e}"),
    st.floats(-1e-300, 1e-300).map(repr),
    st.integers(-(10**11), 10**11).map(str),
    st.from_regex(r"[+-]?([0-9]{1,9}\.?[0-9]{0,20}|\.[0-9]{1,20})([eE][+-]?[0-9]{1,2})?", fullmatch=True).filter(
        lambda word: abs(float(word)) <= 1e12
    ),
)
anything = st.one_of(
    numbers,
    numbers,
    numbers,
    st.text("0123456789.+-eE", min_size=1, max_size=8),
    st.sampled_from(["nan", "inf", "1_0", "0x1", "1e13", "-", ":", ";5", "1,5", "é", "\x00", "1e5e5"]),
)


def read(text: bytes, columns: int, rows: int, block: int = _bvh_numbers.BLOCK) -> np.ndarray:
    out = np.empty((rows, columns))
    padded = bytearray(text + b"9" * _bvh_numbers.PADDING)
    found = _bvh_numbers.read_values(
        padded, 0, len(text), out, path=Path("x"), line=1, names=["?"] * columns, block=block
    )
    assert found == rows
    return out


@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(numbers, numbers, numbers), min_size=1, max_size=20), st.integers(1, 200))
def test_numbers_are_read_to_the_last_bit(rows: list[tuple[str, str, str]], block: int) -> None:
    text = "".join(" ".join(row) + "\n" for row in rows).encode()
    expected = np.array([[float(word) for word in row] for row in rows])
    for size in (block, _bvh_numbers.BLOCK):
        values = read(text, 3, len(rows), size)
        np.testing.assert_array_equal(values, expected)
        np.testing.assert_array_equal(np.signbit(values), np.signbit(expected))


@settings(max_examples=600, deadline=None)
@given(st.lists(anything, min_size=1, max_size=6), st.sampled_from([" ", "  ", "\t", " \r\n", "\n", "\x0b"]))
def test_the_vectorised_reader_accepts_nothing_that_the_plain_one_refuses(words: list[str], separator: str) -> None:
    text = (separator.join(words) + "\n").encode()
    padded = bytearray(text + b"9" * _bvh_numbers.PADDING)
    view = np.ndarray(len(padded) - 7, "<u8", padded, 0, (1,))
    for columns in (1, len(words)):
        fast = _bvh_numbers._read_fast(padded, view, 0, len(text), columns)
        if fast is not None:
            plain = _bvh_numbers._read_plain(text, columns, Path("x"), 1, ["?"] * columns)
            np.testing.assert_array_equal(fast, plain)
            np.testing.assert_array_equal(np.signbit(fast), np.signbit(plain))


@pytest.mark.parametrize("form", ["%.6f", "%.2f", "%d", "%g", "%e", "%.10f", "%.15f", "%+.3f", "%9.4f"])
def test_ordinary_files_take_the_vectorised_path(form: str, rng: np.random.Generator) -> None:
    values = rng.normal(0, 200, (300, 8))
    text = "".join(" ".join(form % v for v in row) + " \n" for row in values).encode()
    padded = bytearray(text + b"9" * _bvh_numbers.PADDING)
    view = np.ndarray(len(padded) - 7, "<u8", padded, 0, (1,))
    fast = _bvh_numbers._read_fast(padded, view, 0, len(text), 8)
    if form.startswith("%+"):
        assert fast is None  # a plus sign in front is rare enough for the plain reader
    else:
        np.testing.assert_array_equal(fast, np.array(text.split(), dtype=float).reshape(300, 8))


@st.composite
def fixed(draw: st.DrawFn) -> list[str]:
    """Numbers of one to five digits, all with the same one to six decimals."""
    decimals = draw(st.integers(1, 6))
    scale = 10.0 ** draw(st.integers(0, 4))
    values = draw(st.lists(st.floats(-scale, scale), min_size=1, max_size=12))
    return [f"{value:.{decimals}f}" for value in values]


@settings(max_examples=200, deadline=None)
@given(fixed(), st.sampled_from([" ", "\t", "\n", " \n", "\r\n"]), st.sampled_from(["\n", " \n", "\r\n", " \r\n"]))
def test_fixed_decimals_are_read_to_the_last_bit(words: list[str], separator: str, end: str) -> None:
    columns = 1 if "\n" in separator else len(words)
    block = (separator.join(words) + (separator if columns == 1 and "\n" in separator else end)).encode()
    expected = np.array([float(word) for word in words]).reshape(-1, columns)
    values = read_fixed(block, columns)
    if all(len(word.split(".")[0]) <= 5 for word in words):
        assert values is not None
    if values is not None:
        np.testing.assert_array_equal(values, expected)
        np.testing.assert_array_equal(np.signbit(values), np.signbit(expected))


@settings(max_examples=600, deadline=None)
@given(
    fixed(),
    st.lists(st.tuples(st.integers(0, 200), st.binary(max_size=1)), min_size=1, max_size=2),
    st.sampled_from([" ", "\n"]),
    st.booleans(),
)
def test_fixed_decimals_with_a_wrong_byte_are_never_misread(
    words: list[str], edits: list[tuple[int, bytes]], separator: str, insert: bool
) -> None:
    block = (separator.join(words) + "\n").encode()
    columns = 1 if separator == "\n" else len(words)
    for at, byte in edits:
        at %= len(block) - 1
        block = block[:at] + byte + block[at + (not insert) :]
    values = read_fixed(block, columns)
    if values is not None:
        np.testing.assert_array_equal(values, _bvh_numbers._read_plain(block, columns, Path("x"), 1, ["?"] * columns))


@pytest.mark.parametrize("wrong", [chr(code) for code in range(256) if not chr(code).isdigit()])
def test_no_byte_passes_for_a_digit(wrong: str) -> None:
    for at in range(12):
        for good in (b"-123.456789\n", b"1234.456789\n", b"4.567890 1.567890\n", b"-21.5\n", b"1.5 12.5 3.25\n"):
            at = min(at, len(good) - 2)
            block = good[:at] + wrong.encode("latin-1") + good[at + 1 :]
            columns = len(good.split())
            values = read_fixed(block, columns)
            if values is not None:
                plain = _bvh_numbers._read_plain(block, columns, Path("x"), 1, ["?"] * columns)
                np.testing.assert_array_equal(values, plain)


@settings(max_examples=300, deadline=None)
@given(
    st.lists(
        st.one_of(
            st.floats(allow_nan=False, allow_infinity=False),
            st.floats(-400, 400),
            st.floats(-1e5, 1e5).map(lambda v: round(v, 6)),
            st.integers(-(10**6), 10**6).map(float),
            st.sampled_from([0.0, -0.0, 1e5, 99999.99999999, 99999.999999999, 1e-8, 5e-9, 0.1, -0.00000001, 5e-324]),
        ),
        min_size=1,
        max_size=40,
    )
)
def test_what_is_written_reads_back_to_the_bit(values: list[float]) -> None:
    rows = np.array(values)[:, None].repeat(3, axis=1)
    text = _bvh_text.format_rows(rows)
    assert text.count(b"\n") == len(values)
    back = np.array([[float(word) for word in line.split(b" ")] for line in text.splitlines()])
    np.testing.assert_array_equal(back, rows)
    np.testing.assert_array_equal(np.signbit(back), np.signbit(rows))


def test_writing_spends_no_byte_on_zeros() -> None:
    rows = np.array([[0.0, -0.5, 12.25], [100.0, 1e-7, -3.0], [40000.125, -0.0, 7e9]])
    assert _bvh_text.format_rows(rows) == b"0 -0.5 12.25\n100 0.0000001 -3\n40000.125 -0 7000000000\n"
