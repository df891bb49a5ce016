"""Every reader of files from outside, or of files that a run reads back, fed with any bytes.

A reader either reads or refuses. A refusal is an error of :mod:`benchmark.errors` whose message names the file;
anything else that comes out is a fault of ours. The same targets serve the property tests and the coverage-guided
fuzzer (``make fuzz``).
"""

from __future__ import annotations

import io
import json
import struct
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.errors import BenchmarkError

Reader = Callable[[Path], Any]

#: The cell that run folders of these targets have.
KEY = "0" * 64


@dataclass(frozen=True)
class Target:
    """A reader under test.

    Attributes
    ----------
    name
        File name, with folders, that the bytes are written to.
    read
        Called with the path of that file.
    seeds
        Whole files that the reader takes, to start from.
    before
        Makes what must lie around the file.
    wrap
        Makes the file of the bytes, where a format has a frame (a checksum, a length) that random bytes never get right.
    """

    name: str
    read: Reader
    seeds: Callable[[], list[bytes]]
    before: Callable[[Path], None] = lambda folder: None
    wrap: Callable[[bytes], bytes] = bytes


def run(target: Target, data: bytes, folder: Path) -> BenchmarkError | None:
    """Write the bytes, call the reader, and return the error by which it refused; any other error is raised."""
    path = folder / target.name
    path.parent.mkdir(parents=True, exist_ok=True)
    target.before(folder)
    path.write_bytes(target.wrap(data))
    try:
        target.read(path)
    except BenchmarkError as error:
        message = str(error)
        assert path.name in message or str(path.parent) in message, f"the refusal names no file: {message}"
        return error
    return None


# ---- motion files


BVH = b"""HIERARCHY
ROOT Hips
{
  OFFSET 0.0 0.0 0.0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT LeftUpLeg
  {
    OFFSET 10.0 0.0 0.0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0.0 -40.0 0.0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.0333333
0.0 90.0 0.0 1.0 2.0 3.0 4.5 -5.25 6.125
0.1 90.0 0.0 1.0 2.0 3.0 4.5 -5.25 6.125
"""


def _read_bvh(path: Path) -> None:
    from benchmark.motion import bvh

    bvh.load(path, max_bytes=1 << 20)


def kinect_csv(frames: int = 5) -> bytes:
    """A made-up capture of a figure that stands still."""
    from benchmark.motion.kinect import JOINTS

    header = ["Timestamp", *(f"{joint}{axis}" for joint in JOINTS for axis in "XYZ"), "User-ID", "Action", ""]
    rows = [",".join(header)]
    for frame in range(frames):
        places = [f"{0.1 * index + 0.01 * axis:.3f}" for index in range(len(JOINTS)) for axis in range(3)]
        rows.append(",".join([str(1000 + 33 * frame), *places, "101", "Wave", ""]))
    return "\n".join(rows).encode()


def _read_kinect(path: Path) -> None:
    from benchmark.motion import kinect

    kinect.load(path)


@cache
def _npz_seeds() -> list[bytes]:
    from benchmark.motion import npz, quat
    from benchmark.motion.clip import MotionClip
    from benchmark.motion.skeleton import Skeleton

    skeleton = Skeleton(("Hips", "Head"), np.array([-1, 0]), np.array([[0, 0, 0], [0, 1.0, 0]]), roles={"hips": 0})
    clip = MotionClip(skeleton, quat.identity(2, 2), np.zeros((2, 3)), 30.0)
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        npz.save(clip, Path(folder) / "clip.npz")
        return [(Path(folder) / "clip.npz").read_bytes()]


def _read_npz(path: Path) -> None:
    from benchmark.motion import npz

    npz.load(path)


def _array(value: Any) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, np.asarray(value))
    return buffer.getvalue()


def _archive(members: dict[str, bytes]) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return buffer.getvalue()


_CLIP_ARRAYS = {
    "offsets.npy": [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
    "rotations.npy": [[[1.0, 0.0, 0.0, 0.0]] * 2] * 2,
    "root.npy": [[0.0, 0.0, 0.0]] * 2,
}


def _npz_of_header(header: bytes) -> bytes:
    arrays = {name: _array(value) for name, value in _CLIP_ARRAYS.items()}
    return _archive({"header.npy": _array(np.frombuffer(header, np.uint8)), **arrays})


def _npz_of_array(member: bytes) -> bytes:
    arrays = {name: _array(value) for name, value in _CLIP_ARRAYS.items()}
    header = _array(np.frombuffer(_clip_header(), np.uint8))
    return _archive({"header.npy": header, **arrays, "root.npy": member})


@cache
def _clip_header() -> bytes:
    with np.load(io.BytesIO(_npz_seeds()[0]), allow_pickle=False) as file:
        return bytes(file["header"].tobytes())


# ---- settings and tables


CONFIG = b"""methods = ["all", "nearest[shortlist=8]"]
tasks = ["adult:child"]
repetitions = 2
out = "runs/x"
[dataset]
name = "synthetic"
[split]
protocol = "paper"
[split.parameters]
n_train = 3
[params.nearest]
shortlist = 3
"""


def _read_config(path: Path) -> None:
    from benchmark.config import read_config

    read_config(path)


ROLES = b'[roles]\nleft_knee = "LeftLeg"\nhips = ""\n'


def _read_roles(path: Path) -> None:
    from benchmark.motion.roles import load_role_map

    load_role_map(path)


INDEX = b"path,style,actor,action,take\na.bvh,adult,1,walk,1\n"


def _bvh_beside(folder: Path) -> None:
    (folder / "a.bvh").write_bytes(BVH)


def _read_index(path: Path) -> None:
    from benchmark.data.index import read_index

    read_index(path, path.parent)


SETTINGS = (
    b'pattern = "{style}/{action}.bvh"\nunit = "cm"\nfps = 30\n[styles]\nkids = "child"\n[roles]\nhips = "Hips"\n'
)


def _read_settings(path: Path) -> None:
    from benchmark.data.folder import FolderDataset
    from benchmark.errors import DataError

    try:
        FolderDataset(path.parent)
    except DataError as error:
        # That the files beside it do not fit the settings is said of the files.
        if path.parent.as_posix() not in str(error):
            raise


CARD = b"""id = "x"
title = "X"
version = "1"
summary = "s"
kind = "own-copy"
[licence]
name = "MIT"
redistribution = "yes"
[citation]
text = "t"
[actors.1]
style = "adult"
age = 30
"""


def _read_card(path: Path) -> None:
    from benchmark.data.cards import parse_card

    parse_card(path.read_bytes(), path.name)


STIMULI = b"stimulus,condition,clip_id,action,actor,attention,expected\ns1,real,c1,jump,1,yes,jump|hop\ns2,hsu,c1,jump,1,no,\n"
RATINGS = (
    b"rater,stimulus,style,naturalness,action,order,seconds,time,kind\n"
    b"r1,s1,adult,5,jump,1,3.5,2026-11-22T18:30:00+00:00,people\nr1,s2,child,NA,hop,2,4,,people\n"
)


def _stimuli_beside(folder: Path) -> None:
    (folder / "key.csv").write_bytes(STIMULI)


def _read_stimuli(path: Path) -> None:
    from eval.ratings.reading import read_stimuli

    read_stimuli(path)


@cache
def _stimuli() -> Any:
    import tempfile

    from eval.ratings.reading import read_stimuli

    with tempfile.TemporaryDirectory() as folder:
        _stimuli_beside(Path(folder))
        return read_stimuli(Path(folder) / "key.csv")


def _read_ratings(path: Path) -> None:
    from eval.ratings.reading import read_ratings

    read_ratings(path, _stimuli())


# ---- a run folder


def _split_seeds() -> list[bytes]:
    from benchmark.data.catalog import open_dataset
    from benchmark.data.splits import make_split

    dataset = open_dataset("synthetic", adults=4, children=4, takes=2, actions=["walk"])
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        split = make_split(dataset, "adult", "child")
        split.to_json(Path(folder) / "split.json")
        return [(Path(folder) / "split.json").read_bytes()]


def _read_split(path: Path) -> None:
    from benchmark.data.splits import Split

    Split.from_json(path)


def _split_stated(data: bytes) -> bytes:
    """The manifest with the digest that its content has, so that what stands behind the digest is reached."""
    try:
        content = json.loads(data)
    except (ValueError, RecursionError):
        return data
    if not isinstance(content, dict):
        return data
    from benchmark.data.splits import FORMAT
    from benchmark.digest import digest

    rest = {name: value for name, value in content.items() if name != "digest"}
    try:
        return json.dumps({**rest, "format": FORMAT, "digest": digest({**rest, "format": FORMAT})}).encode()
    except (BenchmarkError, ValueError, TypeError, RecursionError):
        return data


def _read_status(path: Path) -> None:
    from benchmark.runner.store import RunStore

    status = RunStore(path.parents[2]).status(KEY)
    assert status.state in ("ok", "skipped", "failed", "damaged"), status.state
    assert status.state == "ok" or status.reason or status.state == "skipped", "no reason"


def _plan_around(folder: Path) -> None:
    (folder / "config.toml").write_bytes(CONFIG)


def _plan_seeds() -> list[bytes]:
    from dataclasses import fields

    from benchmark.runner.plan import Cell, plan_text

    values: dict[str, Any] = {name.name: "x" for name in fields(Cell)}
    values |= {"key": KEY, "params": {}, "repetition": 0, "seed": 1, "fate": "run", "task": "adult:child"}
    return [plan_text([Cell(**{**values, "ingredients": {"repetition": 0, "seed": 1}})]).encode()]


def _read_plan(path: Path) -> None:
    from benchmark.runner.run import read_run

    for cell in read_run(path.parent)[1]:
        # What the first lines of every command that reads a run do with it.
        assert isinstance(cell.styles, tuple)
        assert isinstance(cell.title, str)
        assert isinstance(cell.key, str)


def _items_seeds() -> list[bytes]:
    item = {
        "clip_id": "c",
        "actor": "1",
        "action": "walk",
        "seen_actor": False,
        "reference_ids": [],
        "has_truth": False,
    }
    done = {"state": "ok", "reason": "", "stem": "0000-c", "variants": {"raw": None}, "transfer_seconds": 0.1}
    return [
        json.dumps([{**item, **done, "copied_from": None, "diagnostics": {}}]).encode(),
        json.dumps([{**item, "state": "skipped", "reason": "no"}]).encode(),
    ]


def _read_items(path: Path) -> None:
    from benchmark.runner.items import read_items

    for item in read_items(path.parent):
        assert isinstance(item["clip_id"], str)
        assert item["state"] in ("ok", "skipped")


def _score_rows() -> list[dict[str, Any]]:
    row = {"clip_id": "c", "actor": "1", "action": "walk", "seen_actor": False, "variant": "raw", "metric": "m"}
    return [{**row, "metric_version": "1", "probe_digest": "", "value": 1.5, "unit": "m", "status": "ok", "reason": ""}]


@cache
def _scores() -> tuple[bytes, bytes]:
    """A cell's rows and the mark beside them."""
    import tempfile

    from benchmark.runner.score import Scores, write_scores

    with tempfile.TemporaryDirectory() as name:
        write_scores(Path(name), Scores(_score_rows(), {"m": "d"}))
        return (Path(name) / "metrics.parquet").read_bytes(), (Path(name) / "metrics.json").read_bytes()


def _read_scores(path: Path) -> None:
    from benchmark.runner.score import read_scores

    for row in read_scores(path.parent).rows:
        assert isinstance(row["metric"], str)


def _rows_beside(folder: Path) -> None:
    (folder / "metrics.parquet").write_bytes(_scores()[0])


def _read_vouched(path: Path) -> None:
    """A table that its mark vouches for, as one written by somebody else would be."""
    from benchmark.digest import file_digest

    mark = {"digests": {"m": "d"}, "sha256": file_digest(path), "size": path.stat().st_size, "mtime_ns": 0}
    (path.parent / "metrics.json").write_text(json.dumps(mark))
    _read_scores(path)


LEADERBOARD = (
    b"dataset,task,method,variant,metric,unit,direction,target,mean,sd,n,skipped,failed,repetitions,real_mean,real_n,reason\n"
    b"synthetic,adult:child,hsu,raw,m,m,lower,,1.5,0.1,2,0,0,1,1.0,2,\n"
)


def _read_leaderboard(path: Path) -> None:
    from benchmark.runner.views import read_leaderboard

    read_leaderboard(path.parent)


# ---- models


def _safetensors(header: bytes) -> bytes:
    return struct.pack("<Q", len(header)) + header + bytes(16)


def _safetensors_seeds() -> list[bytes]:
    facts = {"facts": json.dumps({"params": {}})}
    header = {"__metadata__": facts, "w": {"dtype": "F32", "shape": [2, 2], "data_offsets": [0, 16]}}
    return [json.dumps(header).encode()]


def _read_tensors(path: Path) -> None:
    from methods._torch.weights import read_tensors

    read_tensors(path)


def _probe_seeds() -> list[bytes]:
    return [_archive({"weights.npy": _array([[1.0, 2.0]]), "names.npy": _array(["a", "b"])})]


def _facts_beside(folder: Path) -> None:
    (folder / "facts.json").write_text("{}")


def _read_probe(path: Path) -> None:
    from eval.probes.storage import read_arrays

    read_arrays(path.parent)


TARGETS: dict[str, Target] = {
    "bvh": Target("walk.bvh", _read_bvh, lambda: [BVH]),
    "kinect": Target("walk.csv", _read_kinect, lambda: [kinect_csv()]),
    "npz": Target("clip.npz", _read_npz, _npz_seeds),
    "npz-header": Target("clip.npz", _read_npz, lambda: [_clip_header()], wrap=_npz_of_header),
    "npz-array": Target("clip.npz", _read_npz, lambda: [_array([[0.0, 0.0, 0.0]] * 2)], wrap=_npz_of_array),
    "config": Target("config.toml", _read_config, lambda: [CONFIG]),
    "roles": Target("roles.toml", _read_roles, lambda: [ROLES]),
    "index": Target("index.csv", _read_index, lambda: [INDEX], _bvh_beside),
    "settings": Target("dataset.toml", _read_settings, lambda: [SETTINGS], _bvh_beside),
    "card": Target("card.toml", _read_card, lambda: [CARD]),
    "stimuli": Target("key.csv", _read_stimuli, lambda: [STIMULI]),
    "ratings": Target("answers.csv", _read_ratings, lambda: [RATINGS]),
    "split": Target("split.json", _read_split, _split_seeds),
    "split-stated": Target("split.json", _read_split, _split_seeds, wrap=_split_stated),
    "status": Target(
        f"cells/{KEY}/status.json",
        _read_status,
        lambda: [json.dumps({"key": KEY, "state": "ok", "reason": "", "files": {}, "costs": {}}).encode()],
    ),
    "plan": Target("plan.json", _read_plan, _plan_seeds, _plan_around),
    "items": Target("items.json", _read_items, _items_seeds),
    "mark": Target("metrics.json", _read_scores, lambda: [_scores()[1]], _rows_beside),
    "parquet": Target("metrics.parquet", _read_vouched, lambda: [_scores()[0]]),
    "leaderboard": Target("leaderboard.csv", _read_leaderboard, lambda: [LEADERBOARD]),
    "safetensors": Target("model.safetensors", _read_tensors, lambda: [_safetensors(_safetensors_seeds()[0])]),
    "safetensors-header": Target("model.safetensors", _read_tensors, _safetensors_seeds, wrap=_safetensors),
    "probe": Target("arrays.npz", _read_probe, _probe_seeds, _facts_beside),
}
