"""The floor row: the source motion on the target's body, and nothing else."""

from __future__ import annotations

from typing import Self

import numpy as np

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
from benchmark.motion.clip import MotionClip


class Identity(Method):
    """Return the source, retargeted onto ``task.target_skeleton``; its clock and joint angles stay as they are.

    Every method is shown on the same body, so whatever another row gains over this one it owes to its motion, not to a
    smaller figure.
    """

    info = MethodInfo(
        name="identity",
        summary="the source motion, retargeted onto the target's body",
        capabilities=Capabilities(supervision=Supervision.NONE, fit_scope="none"),
        code_deps=("benchmark.motion.retarget",),
    )

    def fit(self, train: TrainView, task: StyleTask, *, rng: np.random.Generator, ctx: FitContext) -> Self:
        """Learn nothing."""
        return self

    def transfer(self, source: MotionClip, task: StyleTask, *, rng: np.random.Generator) -> TransferResult:
        """Put ``source`` on the target skeleton, if the task names one."""
        from benchmark.motion.retarget import retarget

        return TransferResult(source if task.target_skeleton is None else retarget(source, task.target_skeleton))
