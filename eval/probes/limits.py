"""How far joints go in real motion."""

from __future__ import annotations

from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from benchmark.api import FitContext, NotApplicableError, Probe, ProbeInfo, StyleTask, TrainView
from benchmark.motion.clip import MotionClip
from eval.features.angles import ANGLE_NAMES, joint_angles
from eval.probes.storage import read_arrays, write_arrays

#: Percentiles of the training frames that bound what is usual.
PERCENTILES = (0.5, 99.5)

#: Radians beyond a bound that are still inside: half a degree, less than captures resolve. An angle that training motion holds
#: still has bounds that coincide, and rounding must not decide on which side of them the same angle is.
MARGIN = np.radians(0.5)


class JointLimits(Probe):
    """Bounds of joint angles: the 0.5th and 99.5th percentile over all training frames of both styles.

    The angles are those of :func:`~eval.features.angles.joint_angles`, left and right pooled. Every clip counts for its
    duration. By construction at most 1 % of training motion is outside.

    Attributes
    ----------
    bounds_
        (2, A) lower and upper bound in radians, in the order of :data:`~eval.features.angles.ANGLE_NAMES`.
    """

    info = ProbeInfo(
        name="joint-limits",
        summary="0.5th and 99.5th percentile of joint angles in the training motion of both styles",
        code_deps=(
            "benchmark.motion.canonical",
            "benchmark.motion.pose",
            "benchmark.motion.resample",
            "eval.features",
            "eval.probes.storage",
        ),
    )

    def fit(self, train: TrainView, task: StyleTask, *, rng: np.random.Generator, ctx: FitContext) -> Self:
        """Take the percentiles; a :class:`~benchmark.api.NotApplicableError` where there is no training motion."""
        clips = [clip for style in (task.source_style, task.target_style) for clip in train.clips(style)]
        if not clips:
            raise NotApplicableError("there is no training motion to take joint limits from")
        angles = np.concatenate([joint_angles(clip) for clip in clips])
        self.bounds_: NDArray[np.float64] = np.percentile(angles.reshape(-1, len(ANGLE_NAMES)), PERCENTILES, axis=0)
        return self

    def violations(self, clip: MotionClip) -> NDArray[np.bool_]:
        """(T, 2, A) whether each angle of each frame is out of bounds by more than half a degree."""
        angles = joint_angles(clip)
        return (angles < self.bounds_[0] - MARGIN) | (angles > self.bounds_[1] + MARGIN)

    def save(self, folder: Path) -> None:
        """Write the bounds, bit for bit."""
        write_arrays(folder, {"bounds": self.bounds_}, {"angles": list(ANGLE_NAMES), "percentiles": list(PERCENTILES)})

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read what :meth:`save` wrote."""
        probe = cls()
        probe.bounds_ = read_arrays(folder)[0]["bounds"]
        return probe
