"""Forward kinematics of 31 joints x 4000 frames, side by side."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from timing import Job, collect, interleaved, rows

from benchmark.motion import quat, rotations
from benchmark.motion.kinematics import fk
from benchmark.motion.skeleton import Skeleton

#: A hierarchy of the depth and branching of the CMU captures: two legs, a spine, a head, two arms with a thumb each.
PARENTS = [
    -1,
    0,
    1,
    2,
    3,
    4,
    0,
    6,
    7,
    8,
    9,
    0,
    11,
    12,
    13,
    14,
    15,
    13,
    17,
    18,
    19,
    20,
    21,
    20,
    13,
    24,
    25,
    26,
    27,
    28,
    27,
]
FRAMES, REPEATS = 4000, 15
ORDER = "ZXY"


class Case:
    """A skeleton and a motion, as Euler angles in radians (T, J, 3) and as quaternions (T, J, 4)."""

    def __init__(self, frames: int) -> None:
        rng = np.random.default_rng(31)
        joints = len(PARENTS)
        self.parents = np.array(PARENTS)
        self.offsets = rng.normal(0.0, 0.2, (joints, 3))
        self.offsets[0] = 0.0
        self.skeleton = Skeleton(tuple(f"joint{i}" for i in range(joints)), self.parents, self.offsets)
        self.angles = rng.uniform(-1.5, 1.5, (frames, joints, 3))
        self.rotations = quat.normalize(rotations.from_euler(self.angles, ORDER))
        self.root = rng.normal(size=(frames, 3))
        self.positions = fk(self.skeleton, self.rotations, self.root)[1]

    def check(self, positions: Any) -> None:
        """Hold a peer to the same answer, up to the 1e-7 that pymotion's guarded normalisation takes off."""
        if not np.allclose(np.asarray(positions), self.positions, atol=1e-6):
            raise ValueError("its positions differ from ours")


def _pymotion(case: Case) -> Job:
    library = importlib.import_module("pymotion.ops.skeleton_np")

    def job() -> Any:
        return library.fk_quat(case.rotations, case.root, case.offsets, case.parents)

    case.check(job()[0])
    return job


def _pymotion_matrices(case: Case) -> Job:
    library = importlib.import_module("pymotion.ops.skeleton_np")

    def job() -> Any:
        return library.fk(case.rotations, case.root, case.offsets, case.parents)

    case.check(job()[0])
    return job


def _scipy(case: Case) -> Job:
    from scipy.spatial.transform import Rotation

    def job() -> Any:
        world: list[Any] = []
        placed: list[Any] = []
        for joint, parent in enumerate(PARENTS):
            local = Rotation.from_quat(case.rotations[:, joint], scalar_first=True)
            world.append(local if parent < 0 else world[parent] * local)
            placed.append(case.root if parent < 0 else placed[parent] + world[parent].apply(case.offsets[joint]))
        return np.stack([turn.as_quat(scalar_first=True) for turn in world], axis=1), np.stack(placed, axis=1)

    case.check(job()[1])
    return job


def _torch(case: Case) -> Job:
    import torch

    from methods._torch.kinematics import mul, rotate

    offsets, local, root = (torch.from_numpy(array) for array in (case.offsets, case.rotations, case.root))

    def job() -> Any:
        world, placed = [local[:, 0]], [root]
        for joint, parent in enumerate(PARENTS[1:], start=1):
            placed.append(placed[parent] + rotate(world[parent], offsets[joint]))
            world.append(mul(world[parent], local[:, joint]))
        return torch.stack(world, 1), torch.stack(placed, 1)

    case.check(job()[1])
    return job


def _pybvh(case: Case) -> Job:
    library = importlib.import_module("pybvh.spatial_coord")
    joints = len(PARENTS)
    topology = library.FkTopology(case.offsets, case.parents, np.arange(joints), [ORDER] * joints)

    def job() -> Any:
        return library.frames_to_node_positions(topology, case.root, case.angles)

    case.check(job())
    return job


def run(console: Any, *, frames: int = FRAMES, repeats: int = REPEATS) -> list[dict[str, Any]]:
    """Time world rotations and positions from local rotations, and from the Euler angles of a file.

    pybvh takes nothing but Euler angles and returns positions only: it is in both tables with the same call, so that the
    first compares kinematics as each library offers them and the second the same work from the same input.
    """
    case = Case(frames)
    tasks: dict[str, tuple[Job, dict[str, Any]]] = {
        "FK": (
            lambda: fk(case.skeleton, case.rotations, case.root),
            {
                "pybvh, from Euler angles": _pybvh,
                "pymotion fk_quat": _pymotion,
                "pymotion fk": _pymotion_matrices,
                "torch joint loop": _torch,
                "scipy Rotation": _scipy,
            },
        ),
        "FK from Euler angles": (
            lambda: fk(case.skeleton, rotations.from_euler(case.angles, ORDER), case.root),
            {"pybvh": _pybvh},
        ),
    }
    result = []
    for task, (ours, builders) in tasks.items():
        peers, missing = collect(builders, case, console=console)
        seconds = interleaved({"ours": ours, **peers}, repeats=repeats)
        result += rows(task, seconds, missing, work=frames / 1e3, unit="k poses/s")
    return result
