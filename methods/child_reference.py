"""The ceiling row: a real performer of the target style."""

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
from benchmark.errors import DataError
from benchmark.motion.clip import MotionClip


class ChildReference(Method):
    """Return the real target clip of the same action that the task carries.

    The clip is given back as it was captured, on the performer's own skeleton: a ceiling that had been retargeted would
    carry retargeting's faults. It is the one method that is handed the answer, says so in its capabilities, and is exempt
    from the rule that results lie on ``task.target_skeleton``.
    """

    info = MethodInfo(
        name="child-reference",
        summary="a real clip of the target style and the same action: the ceiling, not a competitor",
        capabilities=Capabilities(
            supervision=Supervision.NONE, changes_timing=True, fit_scope="none", required_roles=(), uses_reference=True
        ),
        code_deps=("benchmark.motion.resample",),
    )

    def fit(self, train: TrainView, task: StyleTask, *, rng: np.random.Generator, ctx: FitContext) -> Self:
        """Learn nothing."""
        return self

    def transfer(self, source: MotionClip, task: StyleTask, *, rng: np.random.Generator) -> TransferResult:
        """Return ``task.reference`` at the source's frame rate; a :class:`~benchmark.errors.DataError` where there is none."""
        from benchmark.motion.resample import resample

        reference = task.reference
        if reference is None:
            raise DataError(
                f"no real {task.target_style} clip of {source.meta.action!r} to show beside {source.meta.clip_id!r}: "
                "the task carries no reference"
            )
        clip = reference if reference.fps == source.fps else resample(reference, source.fps)
        return TransferResult(clip, copied_from=reference.meta.clip_id)
