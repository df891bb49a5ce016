"""Resampling of 31 joints x 4000 frames from 120 to 100 frames a second, side by side."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from bench_fk import ORDER, PARENTS
from timing import Job, collect, copy_floor, interleaved, rows

from benchmark.motion import quat, rotations
from benchmark.motion.clip import MotionClip
from benchmark.motion.resample import resample
from benchmark.motion.skeleton import Skeleton

FRAMES, REPEATS = 4000, 9
BEFORE, AFTER = 120.0, 100.0


class Case:
    """A smooth motion and its frames on the new clock."""

    def __init__(self, frames: int) -> None:
        rng = np.random.default_rng(5)
        joints = len(PARENTS)
        offsets = rng.normal(0.0, 0.2, (joints, 3))
        skeleton = Skeleton(tuple(f"joint{i}" for i in range(joints)), np.array(PARENTS), offsets)
        angles = np.cumsum(rng.normal(0.0, 0.02, (frames, joints, 3)), axis=0)
        local = quat.unroll(quat.normalize(rotations.from_euler(angles, ORDER)))
        root = np.cumsum(rng.normal(0.0, 0.01, (frames, 3)), axis=0)
        self.clip = MotionClip(skeleton, local, root, BEFORE)
        self.result = resample(self.clip, AFTER, lowpass=False)
        self.times = np.arange(len(self.result)) / AFTER

    def check(self, turned: Any, root: Any) -> None:
        """Hold a peer to the same rotations, whatever their sign, and the same path of the root."""
        dots = np.abs(np.einsum("tji,tji->tj", np.asarray(turned), self.result.rotations))
        if not np.allclose(dots, 1.0, atol=1e-6):
            raise ValueError("its rotations differ from ours")
        if not np.allclose(root, self.result.root, atol=1e-6):
            raise ValueError("its root differs from ours")


def _scipy(case: Case) -> Job:
    from scipy.interpolate import CubicSpline
    from scipy.spatial.transform import Rotation, Slerp

    clip, before = case.clip, np.arange(len(case.clip)) / BEFORE
    times = np.minimum(case.times, before[-1])

    def job() -> Any:
        turned = [
            Slerp(before, Rotation.from_quat(clip.rotations[:, joint], scalar_first=True))(times).as_quat(
                scalar_first=True
            )
            for joint in range(len(PARENTS))
        ]
        return np.stack(turned, axis=1), CubicSpline(before, clip.root, axis=0)(times)

    case.check(*job())
    return job


def _pymotion(case: Case) -> Job:
    """Its slerp between the frames on either side; the root as above, which it leaves to the caller."""
    from scipy.interpolate import CubicSpline

    library = importlib.import_module("pymotion.rotations.quat")
    clip, before = case.clip, np.arange(len(case.clip)) / BEFORE
    position = np.minimum(case.times * BEFORE, len(clip) - 1)
    low = np.minimum(position.astype(int), len(clip) - 2)
    share = (position - low)[:, None, None]

    def job() -> Any:
        turned = library.slerp(clip.rotations[low], clip.rotations[low + 1], share, shortest=True)
        return turned, CubicSpline(before, clip.root, axis=0)(position / BEFORE)

    case.check(*job())
    return job


def run(console: Any, *, frames: int = FRAMES, repeats: int = REPEATS) -> list[dict[str, Any]]:
    """Time resampling without the filter, which peers have none of, and ours with it; and copying as many bytes."""
    case = Case(frames)
    peers, missing = collect({"scipy Slerp": _scipy, "pymotion slerp": _pymotion}, case, console=console)
    jobs = {
        "ours": lambda: resample(case.clip, AFTER, lowpass=False),
        "ours, with the filter": lambda: resample(case.clip, AFTER),
        **peers,
        "floor: copying the arrays": copy_floor(case.clip.rotations, case.result.rotations),
    }
    return rows("Resampling", interleaved(jobs, repeats=repeats), missing, work=frames / 1e3, unit="k frames/s")
