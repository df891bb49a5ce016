"""Whether it is still the body that was asked for."""

from __future__ import annotations

import numpy as np

from benchmark.api import Metric, MetricInfo, NotApplicableError, Sample

#: Bones shorter than this many leg lengths are helper joints; relative errors mean nothing on them.
_SHORTEST = 0.01


class BoneLengthError(Metric):
    """Largest relative deviation of a bone's length from the target skeleton's, over frames and bones.

    ``max_{t,j} | |p_j(t) - p_parent(j)(t)| - l_j | / l_j``. Zero for a method that keeps to rotations on the target
    skeleton; a method that emits joint positions shows what it is off. A real performer keeps the own body, which nobody
    asked to be another's: no value.
    """

    info = MetricInfo(
        name="physics/bone-length-error",
        summary="largest relative deviation of a bone from the target skeleton",
        unit="1",
        direction="lower",
    )

    def compute(self, sample: Sample) -> float:
        """The error; not applicable where the result has other joints than the target."""
        clip = sample.clip
        target = sample.task.target_skeleton or sample.source.skeleton
        if not clip.skeleton.same_topology(target):
            raise NotApplicableError("the result has other joints than the target skeleton")
        own_body = sample.copied_from is not None and not np.allclose(clip.skeleton.offsets[1:], target.offsets[1:])
        if own_body:
            raise NotApplicableError("a real performer on the own body")
        bones = np.flatnonzero(target.bone_lengths > _SHORTEST * target.leg_length)
        span = clip.positions[:, bones] - clip.positions[:, target.parents[bones]]
        lengths = np.linalg.norm(span, axis=-1)
        return float(np.max(np.abs(lengths / target.bone_lengths[bones] - 1.0)))
