"""The command line as a user meets it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.fixture
def cli(tmp_path):
    """``cli(*arguments)``: run ``python -m benchmark`` in an empty folder."""

    def call(*arguments: object, code: int = 0, **environment: str) -> subprocess.CompletedProcess:
        run = subprocess.run(
            [sys.executable, "-m", "benchmark", *map(str, arguments)],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
            env={**os.environ, "OMP_NUM_THREADS": "1", **environment},
        )
        assert run.returncode == code, f"exit code {run.returncode}\n{run.stdout}\n{run.stderr}"
        return run

    return call


@pytest.fixture(scope="session")
def corpus(tmp_path_factory) -> Path:
    """Two adults and two children, two actions, two takes, as BVH files of two seconds; for ``folder:``."""
    import numpy as np

    from benchmark.motion import bvh, quat
    from benchmark.motion.clip import MotionClip
    from benchmark.motion.skeleton import Skeleton

    sides = [f"{side}{part}" for side in ("Left", "Right") for part in ("Arm", "ForeArm", "Hand")]
    legs = [f"{side}{part}" for side in ("Left", "Right") for part in ("UpLeg", "Leg", "Foot")]
    names = ("Hips", "Spine", "Head", *sides, *legs)
    parents = np.array([-1, 0, 1, 1, 3, 4, 1, 6, 7, 0, 9, 10, 0, 12, 13])
    offsets = [[0, 0, 0], [0, 0.3, 0], [0, 0.3, 0]]
    for x in (1, -1):
        offsets += [[0.2 * x, 0.2, 0], [0.3 * x, 0, 0], [0.25 * x, 0, 0]]
    for x in (1, -1):
        offsets += [[0.1 * x, 0, 0], [0, -0.42, 0], [0, -0.42, 0]]
    folder = tmp_path_factory.mktemp("corpus")
    for style, scale, tempo in (("adult", 1.0, 1.0), ("child", 0.6, 1.3)):
        for actor in ("a", "b"):
            for action, amplitude in (("walk", 0.4), ("wave", 0.1)):
                for take in (1, 2):
                    rng = np.random.default_rng([ord(style[0]), ord(actor), ord(action[1]), take])
                    skeleton = Skeleton(names, parents, scale * np.array(offsets, dtype=float))
                    phase = 2 * np.pi * tempo * np.arange(60) / 30 + rng.uniform(0, 0.3)
                    angles = np.zeros((60, len(names), 3))
                    angles[:, 9, 0] = amplitude * np.sin(phase)
                    angles[:, 12, 0] = -amplitude * np.sin(phase)
                    angles[:, 3, 2] = angles[:, 6, 2] = (0.5 - amplitude) * np.cos(phase) - 0.6
                    root = np.zeros((60, 3))
                    root[:, 1] = 0.84 * scale
                    root[:, 2] = amplitude * scale * tempo * np.arange(60) / 30
                    clip = MotionClip(skeleton, quat.exp(angles / 2), root, 30.0)
                    path = folder / style / actor / f"{action}_{take}.bvh"
                    path.parent.mkdir(parents=True, exist_ok=True)
                    bvh.save(clip, path)
    return folder
