"""BVH reading and writing, side by side with the libraries that people use."""

from __future__ import annotations

import gc
import importlib
import statistics
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.motion import bvh

JOINTS, FRAMES = 31, 4000
REPEATS = 9
TIME_LIMIT = 20.0  # seconds spent on a contestant, after which its repeats so far count

Job = Callable[[], object]


def make_file(path: Path, *, joints: int = JOINTS, frames: int = FRAMES) -> None:
    """Write a file as most exporters do: six decimals, one blank, angles that wander over the whole circle."""
    rng = np.random.default_rng(7)
    parents = [-1, *(max(0, joint - 1 if joint % 5 else joint - 5) for joint in range(1, joints))]
    children = {joint: [child for child in range(joints) if parents[child] == joint] for joint in range(joints)}
    lines: list[str] = ["HIERARCHY"]

    def block(joint: int, indent: str) -> None:
        root = joint == 0
        offset = "0.000000 0.000000 0.000000" if root else " ".join(f"{value:.6f}" for value in rng.normal(0, 9, 3))
        positions = "6 Xposition Yposition Zposition" if root else "3"
        lines.extend([f"{indent}{'ROOT' if root else 'JOINT'} joint{joint}", indent + "{"])
        lines.append(f"{indent}\tOFFSET {offset}")
        lines.append(f"{indent}\tCHANNELS {positions} Zrotation Xrotation Yrotation")
        for child in children[joint]:
            block(child, indent + "\t")
        if not children[joint]:
            lines.extend([f"{indent}\tEnd Site", f"{indent}\t{{", f"{indent}\t\tOFFSET 0.0 5.0 0.0", f"{indent}\t}}"])
        lines.append(indent + "}")

    block(0, "")
    values = (rng.uniform(-180, 180, 3 * joints + 3) + rng.normal(0, 1, (frames, 3 * joints + 3)).cumsum(0) + 180) % 360
    lines += ["MOTION", f"Frames: {frames}", "Frame Time: 0.008333"]
    lines += [" ".join(f"{value:.6f}" for value in row) for row in values - 180]
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


def _pybvh(source: Path, target: Path) -> tuple[Job, Job]:
    library = importlib.import_module("pybvh")
    motion = library.read_bvh_file(source)
    return lambda: library.read_bvh_file(source), lambda: motion.write(target)


def _pymotion(source: Path, target: Path) -> tuple[Job, Job]:
    reader = importlib.import_module("pymotion.io.bvh").BVH

    def load() -> Any:
        motion = reader()
        motion.load(str(source))
        return motion.get_data()

    motion = reader()
    motion.load(str(source))
    return load, lambda: motion.save(str(target))


def _bvhio(source: Path, target: Path) -> tuple[Job, Job]:
    library = importlib.import_module("bvhio")
    motion = library.readAsBvh(str(source))
    return lambda: library.readAsBvh(str(source)), lambda: library.writeBvh(str(target), motion)


def _bvhtoolbox(source: Path, target: Path) -> tuple[Job, Job | None]:
    tree = importlib.import_module("bvhtoolbox").BvhTree
    return lambda: tree(source.read_text()), None


def _bvhtools(source: Path, target: Path) -> tuple[Job, Job]:
    io = importlib.import_module("bvhTools.bvhIO")
    motion = io.readBvh(str(source))
    return lambda: io.readBvh(str(source)), lambda: io.writeBvh(motion, str(target))


PEERS: dict[str, Callable[[Path, Path], tuple[Job, Job | None]]] = {
    "pybvh": _pybvh,
    "pymotion": _pymotion,
    "bvhio": _bvhio,
    "bvhtoolbox": _bvhtoolbox,
    "bvhTools": _bvhtools,
}


def time_interleaved(jobs: dict[str, Job]) -> dict[str, float]:
    """Median seconds of each job.

    The jobs take turns, so that a slow moment of the machine hits all of them, and in another order each round, so that
    none always inherits the caches and the heap that a certain other one leaves behind.
    """
    rng = np.random.default_rng(11)
    taken: dict[str, list[float]] = {name: [] for name in jobs}
    for _ in range(REPEATS):
        for name in rng.permutation(list(jobs)).tolist():
            if sum(taken[name]) < TIME_LIMIT:
                gc.collect()
                started = time.perf_counter()
                jobs[name]()
                taken[name].append(time.perf_counter() - started)
    return {name: statistics.median(seconds) for name, seconds in taken.items()}


def run(console: Any) -> list[dict]:
    """Time reading and writing of one file of 31 joints and 4000 frames.

    Reading ends with everything in arrays: quaternions and a validated clip for ours, whatever the peer calls loaded.
    Writing is timed twice for ours: a clip as read, and the same motion without its source, whose Euler angles must be
    found first; peers write the channels they read.

    Parameters
    ----------
    console
        Anything with ``print``; told which peers are absent or failed.

    Returns
    -------
    list of dict
        ``task``, ``what``, ``value``, ``unit`` and ``ratio`` to the best peer (``None`` without one).
    """
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        source, target = Path(folder) / "in.bvh", Path(folder) / "out.bvh"
        make_file(source)
        size = source.stat().st_size / 1e6
        clip = bvh.load(source, unit="cm")
        bare = clip.replace(source=None)
        reads: dict[str, Job] = {"ours": lambda: bvh.load(source, unit="cm")}
        writes: dict[str, Job] = {
            "ours": lambda: bvh.save(clip, target),
            "ours, without source": lambda: bvh.save(bare, target),
        }
        for name, prepare in PEERS.items():
            try:
                read, write = prepare(source, Path(folder) / f"{name}.bvh")
                read()
                if write is not None:
                    write()
            except ImportError as error:
                console.print(f"BVH: {name} is not installed ({error}); skipped")
                continue
            except Exception as error:  # a peer's fault must not end the comparison
                console.print(f"BVH: {name} fails on the test file ({type(error).__name__}: {error}); skipped")
                continue
            reads[name] = read
            if write is not None:
                writes[name] = write
        return _rows("BVH read", reads, size) + _rows("BVH write", writes, size)


def _rows(task: str, jobs: dict[str, Job], size: float) -> list[dict]:
    rates = {name: size / seconds for name, seconds in time_interleaved(jobs).items()}
    peers = [rate for name, rate in rates.items() if not name.startswith("ours")]
    best = max(peers, default=None)
    return [
        {"task": task, "what": name, "value": rate, "unit": "MB/s", "ratio": None if best is None else rate / best}
        for name, rate in rates.items()
    ]
