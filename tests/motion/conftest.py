"""A biped and a walk with exactly known contacts, for every test of the motion core."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from benchmark.motion import quat
from benchmark.motion.clip import ClipMeta, MotionClip
from benchmark.motion.skeleton import EndSite, Skeleton

_X, _Z = [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]
THIGH, SHANK, ANKLE = 0.43, 0.42, 0.07


def _biped(scale: float = 1.0) -> Skeleton:
    names, parents, offsets = ["hips"], [-1], [(0.0, 0.0, 0.0)]

    def add(name: str, parent: str, offset: tuple[float, float, float]) -> None:
        names.append(name)
        parents.append(names.index(parent))
        offsets.append(offset)

    add("spine", "hips", (0.0, 0.12, 0.0))
    add("chest", "spine", (0.0, 0.18, 0.0))
    add("neck", "chest", (0.0, 0.2, 0.0))
    add("head", "neck", (0.0, 0.1, 0.0))
    for side, x in (("left", 1.0), ("right", -1.0)):
        add(f"{side}_clavicle", "chest", (0.03 * x, 0.15, 0.0))
        add(f"{side}_shoulder", f"{side}_clavicle", (0.14 * x, 0.0, 0.0))
        add(f"{side}_elbow", f"{side}_shoulder", (0.28 * x, 0.0, 0.0))
        add(f"{side}_wrist", f"{side}_elbow", (0.25 * x, 0.0, 0.0))
    for side, x in (("left", 1.0), ("right", -1.0)):
        add(f"{side}_hip", "hips", (0.09 * x, -0.05, 0.0))
        add(f"{side}_knee", f"{side}_hip", (0.0, -THIGH, 0.0))
        add(f"{side}_ankle", f"{side}_knee", (0.0, -SHANK, 0.0))
        add(f"{side}_toe", f"{side}_ankle", (0.0, -0.05, 0.14))
    ends = [EndSite(names.index(f"{side}_toe"), (0.0, -0.02, 0.05)) for side in ("left", "right")]
    ends.append(EndSite(names.index("head"), (0.0, 0.18, 0.0)))
    roles = {name: i for i, name in enumerate(names)}
    skeleton = Skeleton(tuple(names), np.array(parents), np.array(offsets), tuple(ends), roles=roles)
    return skeleton if scale == 1.0 else skeleton.scaled(scale)


def _walk(
    *, seconds: float = 3.0, fps: float = 60.0, scale: float = 1.0, slide: float = 0.0, stride: float = 1.0
) -> tuple[MotionClip, np.ndarray]:
    """A walk along +Z with level feet planted for 60 % of each one-second cycle, and (T, 2) whether each foot is planted.

    ``slide`` adds that fraction to the root's path without telling the legs. ``scale`` scales lengths by it, and times by
    its square root (``fps`` is then that of the unscaled clock).
    """
    skeleton = _biped(scale)
    frames = round(seconds * fps) + 1
    time = np.arange(frames) / fps
    root = np.stack([np.zeros(frames), 0.85 + 0.005 * np.cos(4 * np.pi * time), stride * time], axis=-1)
    rotations = quat.identity(frames, len(skeleton))
    planted = np.zeros((frames, 2), dtype=bool)
    for i, side in enumerate(("left", "right")):
        cycle, phase = np.divmod(time + 0.5 * i, 1.0)
        planted[:, i] = phase <= 0.6
        swing = np.clip((phase - 0.6) / 0.4, 0.0, 1.0)
        z = stride * (cycle + 0.3 - 0.5 * i + swing - np.sin(2 * np.pi * swing) / (2 * np.pi))
        y = ANKLE + 0.1 * np.sin(np.pi * swing) ** 2
        hip = root + [0.0, -0.05, 0.0]
        vy, vz = y - hip[:, 1], z - hip[:, 2]
        knee = np.arccos((vy**2 + vz**2 - THIGH**2 - SHANK**2) / (2 * THIGH * SHANK))
        thigh = np.arctan2(-vz, -vy) - np.arctan2(SHANK * np.sin(knee), THIGH + SHANK * np.cos(knee))
        for part, angle in (("hip", thigh), ("knee", knee), ("ankle", -(thigh + knee))):
            rotations[:, skeleton.joint(f"{side}_{part}")] = quat.from_axis_angle(_X, angle)
        down = quat.from_axis_angle(_Z, np.full(frames, (-1.0, 1.0)[i] * 0.5 * np.pi))
        swung = quat.from_axis_angle(_X, 0.4 * np.sin(2 * np.pi * time + np.pi * (i + 1)))
        rotations[:, skeleton.joint(f"{side}_shoulder")] = quat.mul(swung, down)
    root[:, 2] *= 1.0 + slide
    meta = ClipMeta("a", "adult", "walk", "1")
    return MotionClip(skeleton, rotations, root * scale, fps / np.sqrt(scale), meta), planted


def _wild(
    rng: np.random.Generator, frames: int = 80, fps: float = 30.0, skeleton: Skeleton | None = None
) -> MotionClip:
    """Smooth random rotations of every joint along a smooth random path."""
    from scipy.ndimage import gaussian_filter1d

    skeleton = skeleton or _biped()
    turns = gaussian_filter1d(rng.normal(size=(frames, len(skeleton), 3)), 6.0, axis=0, mode="nearest") * 3.0
    path = gaussian_filter1d(rng.normal(size=(frames, 3)), 6.0, axis=0, mode="nearest") + [0.0, 0.9, 0.0]
    return MotionClip(skeleton, quat.exp(turns), path, fps)


@pytest.fixture
def biped() -> Callable[..., Skeleton]:
    """``biped(scale)``: 21 joints in all roles but the hands, at rest in a T, facing +Z."""
    return _biped


@pytest.fixture
def walk() -> Callable[..., tuple[MotionClip, np.ndarray]]:
    """``walk(**options)``: see the function."""
    return _walk


@pytest.fixture
def wild() -> Callable[..., MotionClip]:
    """``wild(rng, frames, fps)``: a smooth random clip."""
    return _wild
