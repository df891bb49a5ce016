"""BVH reading and writing, side by side with the libraries that people use."""

from __future__ import annotations

import importlib
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from timing import Job, interleaved, rows

from benchmark.motion import bvh

JOINTS, FRAMES = 31, 4000
REPEATS = 9
TIME_LIMIT = 20.0  # seconds spent on a contestant, after which its repeats so far count


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


def _pybvh(source: Path, target: Path) -> dict[str, Job]:
    library = importlib.import_module("pybvh")
    motion = library.read_bvh_file(source)
    return {
        "read": lambda: library.read_bvh_file(source),
        "place": lambda: library.read_bvh_file(source).node_positions(),
        "write": lambda: motion.write(target),
    }


def _pymotion(source: Path, target: Path) -> dict[str, Job]:
    reader = importlib.import_module("pymotion.io.bvh").BVH
    kinematics = importlib.import_module("pymotion.ops.skeleton_np")

    def load() -> Any:
        motion = reader()
        motion.load(str(source))
        return motion.get_data()

    def place() -> Any:
        rotations, positions, parents, offsets, *_ = load()
        return kinematics.fk_quat(rotations, positions[:, 0], offsets, parents)

    motion = reader()
    motion.load(str(source))
    return {"read": load, "place": place, "write": lambda: motion.save(str(target))}


def _bvhio(source: Path, target: Path) -> dict[str, Job]:
    library = importlib.import_module("bvhio")
    motion = library.readAsBvh(str(source))
    return {"read": lambda: library.readAsBvh(str(source)), "write": lambda: library.writeBvh(str(target), motion)}


def _bvhtools(source: Path, target: Path) -> dict[str, Job]:
    io = importlib.import_module("bvhTools.bvhIO")
    motion = io.readBvh(str(source))
    return {"read": lambda: io.readBvh(str(source)), "write": lambda: io.writeBvh(motion, str(target))}


PEERS: dict[str, Callable[[Path, Path], dict[str, Job]]] = {
    "pybvh": _pybvh,
    "pymotion": _pymotion,
    "bvhio": _bvhio,
    "bvhTools": _bvhtools,
}

TASKS = {"read": "BVH read", "place": "BVH read and world positions", "write": "BVH write"}


def run(console: Any, *, frames: int = FRAMES, repeats: int = REPEATS) -> list[dict[str, Any]]:
    """Time reading and writing of one file of 31 joints.

    Reading ends with everything in arrays: quaternions and a validated clip for ours, whatever the peer calls loaded (Euler
    angles for pybvh and bvhTools). So that the same work is compared too, reading is also timed up to world positions, for
    the peers that offer them. Writing is timed twice for ours: a clip as read, and the same motion without its source,
    whose Euler angles must be found first; peers write the channels they read.

    Parameters
    ----------
    console
        Anything with ``print``; told which peers failed.
    frames, repeats
        Size of the file, and how often each is timed.

    Returns
    -------
    list of dict
        ``task``, ``what``, ``value``, ``unit`` and ``ratio`` to the best peer (``None`` without one).
    """
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        source, target = Path(folder) / "in.bvh", Path(folder) / "out.bvh"
        make_file(source, frames=frames)
        size = source.stat().st_size / 1e6
        clip = bvh.load(source, unit="cm")
        bare = clip.replace(source=None)
        jobs: dict[str, dict[str, Job]] = {
            "read": {"ours": lambda: bvh.load(source, unit="cm")},
            "place": {"ours": lambda: bvh.load(source, unit="cm").positions},
            "write": {
                "ours": lambda: bvh.save(clip, target),
                "ours, without source": lambda: bvh.save(bare, target),
            },
        }
        missing: dict[str, str] = {}
        for name, prepare in PEERS.items():
            try:
                offered = prepare(source, Path(folder) / f"{name}.bvh")
                for job in offered.values():
                    job()
            except ImportError:
                missing[name] = "not installed"
            except Exception as error:  # a peer's fault must not end the comparison
                missing[name] = f"fails: {type(error).__name__}: {error}"
                console.print(f"{name} {missing[name]}")
            else:
                for task, job in offered.items():
                    jobs[task][name] = job
        result = []
        for task, contestants in jobs.items():
            seconds = interleaved(contestants, repeats=repeats, limit=TIME_LIMIT)
            result += rows(TASKS[task], seconds, missing, work=size, unit="MB/s")
        return result
