"""Retrieval: the training clip of the target style that is closest to the source in content."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from benchmark.api import (
    Capabilities,
    FitContext,
    Method,
    MethodInfo,
    StyleTask,
    Supervision,
    TrainView,
    TransferResult,
)
from benchmark.errors import ConfigError, DataError
from benchmark.motion import npz
from benchmark.motion.clip import MotionClip


class Nearest(Method):
    """Return the real clip of the target style, same action, whose poses are closest to the source's.

    Closeness is the mean distance between the directions of trunk and limbs, facing forward
    (:func:`~benchmark.motion.pose.segment_directions`), and of the hips' height in leg lengths, along the dynamic time
    warping path: no size, proportions, place, facing, tempo or duration in it. All candidates are ranked on poses at
    ``coarse_fps`` frames a second; the best ``shortlist`` are compared again at ``fine_fps``. An action that the training
    clips lack is sought among all actions, and the diagnostics say so.

    The clip found is retargeted onto ``task.target_skeleton``. It is real motion of the target style with no claim to the
    source's content: what a transfer method has to beat on content, and will hardly beat on style.

    Parameters
    ----------
    coarse_fps, fine_fps
        Frame rates of the two comparisons.
    shortlist
        How many candidates the second comparison sees.
    """

    info = MethodInfo(
        name="nearest",
        summary="the closest training clip of the target style and the same action",
        capabilities=Capabilities(supervision=Supervision.UNPAIRED, changes_timing=True),
        code_deps=(
            "benchmark.motion.retarget",
            "benchmark.motion.resample",
            "benchmark.motion.dtw",
            "benchmark.motion.pose",
            "benchmark.motion.canonical",
        ),
    )

    def __init__(self, *, coarse_fps: float = 10.0, fine_fps: float = 30.0, shortlist: int = 4) -> None:
        self.coarse_fps = coarse_fps
        self.fine_fps = fine_fps
        self.shortlist = shortlist

    def fit(self, train: TrainView, task: StyleTask, *, rng: np.random.Generator, ctx: FitContext) -> Self:
        """Keep the training clips of the target style."""
        self._check()
        clips = tuple(train.clips(task.target_style))
        if not clips:
            raise DataError(f"nearest needs training clips of the style {task.target_style!r}, and there are none")
        self.clips_ = clips
        self.poses_ = tuple(self._poses(clip) for clip in clips)
        return self

    def transfer(self, source: MotionClip, task: StyleTask, *, rng: np.random.Generator) -> TransferResult:
        """Return the closest stored clip on the target skeleton, at the source's frame rate."""
        from benchmark.motion.resample import resample
        from benchmark.motion.retarget import retarget

        same = [i for i, clip in enumerate(self.clips_) if clip.meta.action == source.meta.action]
        candidates = same or list(range(len(self.clips_)))
        coarse, fine = self._poses(source)
        ranked = self._ranked(coarse, candidates, 0)[: self.shortlist]
        best, distance = self._ranked(fine, [index for index, _ in ranked], 1)[0]
        found = self.clips_[best]
        clip = found if found.fps == source.fps else resample(found, source.fps)
        clip = retarget(clip, source.skeleton if task.target_skeleton is None else task.target_skeleton)
        diagnostics = {
            "clip_id": found.meta.clip_id,
            "distance": distance,
            "candidates": len(candidates),
            "action_in_training": bool(same),
        }
        return TransferResult(clip, diagnostics=diagnostics, copied_from=found.meta.clip_id)

    def save(self, folder: Path) -> None:
        """Write the parameters and the stored clips."""
        folder.mkdir(parents=True, exist_ok=True)
        header = {"params": self.params(), "clips": len(self.clips_)}
        (folder / "nearest.json").write_text(json.dumps(header, indent=2, sort_keys=True))
        for index, clip in enumerate(self.clips_):
            npz.save(clip, folder / f"clip-{index:05d}.npz")

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read what :meth:`save` wrote."""
        header = json.loads((folder / "nearest.json").read_text())
        method = cls(**header["params"])
        method.clips_ = tuple(npz.load(folder / f"clip-{index:05d}.npz") for index in range(header["clips"]))
        method.poses_ = tuple(method._poses(clip) for clip in method.clips_)
        return method

    def _check(self) -> None:
        if not 0 < self.coarse_fps <= self.fine_fps:
            raise ConfigError(
                f"nearest: coarse_fps must be positive and at most fine_fps, not {self.coarse_fps} and {self.fine_fps}"
            )
        if self.shortlist < 1:
            raise ConfigError(f"nearest: shortlist must be at least 1, not {self.shortlist}")

    def _poses(self, clip: MotionClip) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Coarse and fine pose vectors, (N, 3S) and (M, 3S): S - 1 directions, and the height of the hips as one more."""
        from benchmark.motion.pose import segment_directions

        skeleton = clip.skeleton
        hips = clip.positions[:, skeleton.joint("hips")] * [0.0, 1.0, 0.0] / skeleton.leg_length
        poses = np.concatenate([segment_directions(clip).reshape(len(clip), -1), hips], axis=1)
        return _thinned(poses, clip.fps, self.coarse_fps), _thinned(poses, clip.fps, self.fine_fps)

    def _ranked(self, query: NDArray[np.float64], candidates: Sequence[int], level: int) -> list[tuple[int, float]]:
        """Candidates with their distances, closest first; ties keep the training order."""
        from benchmark.motion.dtw import dtw

        parts = query.shape[1] // 3
        scored = []
        for index in candidates:
            other = self.poses_[index][level]
            path = dtw(query, other).path
            gaps = (query[path[:, 0]] - other[path[:, 1]]).reshape(len(path), parts, 3)
            scored.append((index, float(np.linalg.norm(gaps, axis=-1).mean())))
        return sorted(scored, key=lambda pair: pair[1])


def _thinned(poses: NDArray[np.float64], fps: float, wanted: float) -> NDArray[np.float64]:
    """Every k-th frame, so that about ``wanted`` a second remain."""
    return np.ascontiguousarray(poses[:: max(1, round(fps / wanted))])
