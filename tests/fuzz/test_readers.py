"""Readers read or refuse, whatever the bytes: the targets of the fuzzer as property tests, and what it has found."""

from __future__ import annotations

import json
import random
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

import targets  # noqa: E402

NAMES = sorted(targets.TARGETS)

#: Pieces that readers stumble over.
DICTIONARY = [
    b"\0",
    b"\xff\xfe",
    b"\xef\xbb\xbf",
    b"nan",
    b"1e999",
    b"-1",
    b"9" * 30,
    b"../",
    b"\r",
    b'"',
    b"{",
    b"[" * 200,
    b"null",
]


@st.composite
def spoiled(draw: st.DrawFn, seeds: list[bytes]) -> bytes:
    """A whole file with some places changed, or bytes that never were one."""
    if draw(st.integers(0, 9)) == 0:
        return draw(st.binary(max_size=200))
    data = bytearray(draw(st.sampled_from(seeds)))
    for _ in range(draw(st.integers(1, 4))):
        place = draw(st.integers(0, len(data)))
        match draw(st.sampled_from(["flip", "cut", "drop", "put", "digits", "twice"])):
            case "flip" if place < len(data):
                data[place] ^= draw(st.integers(1, 255))
            case "cut":
                del data[place:]
            case "drop":
                del data[place : place + draw(st.integers(1, 40))]
            case "put":
                data[place:place] = draw(st.sampled_from(DICTIONARY))
            case "digits":
                data[place : place + 1] = str(draw(st.integers(-(10**20), 10**20))).encode()
            case "twice":
                data[place:place] = data[place : place + draw(st.integers(1, 80))]
    return bytes(data)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("readers")


def seeds_of(name: str) -> list[bytes]:
    corpus = HERE / "corpus" / name
    return targets.TARGETS[name].seeds() + [path.read_bytes() for path in sorted(corpus.glob("*"))]


@pytest.mark.parametrize("name", NAMES)
def test_whole_files_are_read(folder, name):
    for seed in targets.TARGETS[name].seeds():
        assert targets.run(targets.TARGETS[name], seed, folder / name) is None


@pytest.mark.parametrize("name", NAMES)
def test_what_the_fuzzer_reached_is_read_or_refused(folder, name):
    for data in seeds_of(name):
        targets.run(targets.TARGETS[name], data, folder / name)


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_spoiled_files_are_read_or_refused(folder, name, data):
    targets.run(targets.TARGETS[name], data.draw(spoiled(targets.TARGETS[name].seeds())), folder / name)


@pytest.mark.parametrize("name", NAMES)
def test_every_cut_is_read_or_refused(folder, name):
    """A file that was cut off while it was copied, at up to sixty places."""
    seed = targets.TARGETS[name].seeds()[0]
    places = random.Random(5).sample(range(len(seed)), min(60, len(seed)))
    for place in places:
        targets.run(targets.TARGETS[name], seed[:place], folder / name)


def header_of_array(shape: str, descr: str = "'<f8'") -> bytes:
    text = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode()


#: What was found, by the fuzzer or by looking: target, bytes, and what the refusal says (``None``: it is read).
FOUND = {
    "a zip of a version to come": (
        "npz",
        targets.TARGETS["npz"]
        .seeds()[0]
        .replace(b"PK\x01\x02\x14", b"PK\x01\x02\x52", 1)
        .replace(b"\x2d\0\0\0", b"\x52\0\0\0"),
        "",
    ),
    "an array header that does not end": ("npz-array", b"\x93NUMPY\x01\x00\x76\x00{'descr':".ljust(128), "not a clip"),
    "an array larger than any memory": ("npz-array", header_of_array("(1 << 40, 3)"), "not a clip"),
    "an array of 8 TB": ("npz-array", header_of_array("(1000000000000,)"), "an array of shape"),
    "an array of objects": ("npz-array", header_of_array("(1,)", "'|O'"), "only pickle"),
    "an array of negative length": ("npz-array", header_of_array("(-1, 3)"), "not a clip"),
    "a clip whose header is a list": ("npz-header", b"[]", "not a clip"),
    "a zero byte in a path": ("index", b"path,style,actor,action,take\na\0.bvh,adult,1,walk,1\n", "line 2"),
    "a path longer than a file system takes": (
        "index",
        b"path,style,action\n" + b"a" * 5000 + b",adult,walk\n",
        "line 2",
    ),
    "a pattern without a known field": ("settings", b'pattern = "{ste}/{action}.bvh"\n', "dataset.toml: pattern"),
    "a unit out of range, in the file": (
        "settings",
        b'pattern = "{style}/{action}.bvh"\nunit = -1.0\n',
        "dataset.toml: unit",
    ),
    "a state that does not exist": (
        "status",
        json.dumps({"key": targets.KEY, "state": "oj", "reason": "", "files": {}}).encode(),
        None,
    ),
    "a status that is a list": ("status", b"[]", None),
    "files that are a list": (
        "status",
        json.dumps({"key": targets.KEY, "state": "ok", "reason": "", "files": []}).encode(),
        None,
    ),
    "lists in lists": ("status", b"[" * 100_000, None),
    "a plan of lists in lists": ("plan", b"[" * 100_000, "plan.json"),
    "a plan that is a list": ("plan", b"[]", "not a plan"),
    "a plan whose cells are a number": ("plan", b'{"cells": 3}', "not a plan"),
    "a key that is a path": (
        "plan",
        targets.TARGETS["plan"].seeds()[0].replace(targets.KEY.encode(), b"../../../etc"),
        "no key of a cell",
    ),
    "a name that is a path": (
        "items",
        targets.TARGETS["items"].seeds()[0].replace(b"0000-c", b"../../c"),
        "no plain file name",
    ),
    "clips without a state": ("items", b'[{"clip_id": "c"}]', "0.actor"),
    "a mark whose digests are a number": ("mark", b'{"digests": 1, "sha256": "", "size": 1, "mtime_ns": 1}', None),
    "a table of another kind": ("parquet", b"PAR1" + bytes(40) + b"PAR1", None),
    "a table of endless rows": ("parquet", (HERE / "found" / "parquet-of-endless-rows").read_bytes(), None),
    "a table of statistics that contradict one another": (
        "parquet",
        (HERE / "found" / "parquet-of-statistics-that-contradict").read_bytes(),
        None,
    ),
    "a pattern of a hundred stars": (
        "settings",
        b'pattern = "{style}/{action}' + b"*" * 100 + b'=%s"\n',
        None,
    ),
    "a pattern of stars and letters": (
        "settings",
        b'pattern = "{style}/{action}' + b"*a" * 50 + b'"\n',
        "more than 12",
    ),
    "a leaderboard with a word for a number": (
        "leaderboard",
        targets.LEADERBOARD.replace(b",2,0,0,1,", b",two,0,0,1,"),
        "line 2",
    ),
    "a leaderboard with a cell too few": ("leaderboard", targets.LEADERBOARD.replace(b",2,\n", b"\n"), "line 2"),
    "a date in a card": ("card", targets.CARD.replace(b'title = "X"', b"title = 2020-01-01"), "card.toml"),
    **{
        f"tables in tables of {what}": (what, b"x = " + b"{a=" * 3000, "nested too deep")
        for what in ("roles", "settings", "card", "config")
    },
    "a probe's archive that is none": ("probe", b"PK\x05\x06", "no probe"),
}


@pytest.mark.parametrize("found", FOUND)
def test_what_was_found(folder, found):
    name, data, says = FOUND[found]
    error = targets.run(targets.TARGETS[name], data, folder / name)
    if says is None:
        assert error is None
    else:
        assert error is not None
        assert says in str(error)
