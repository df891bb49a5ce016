"""Jerk: motion that is too rough or too smooth for a real performer."""

from __future__ import annotations

import numpy as np

from benchmark.api import Metric, MetricInfo, NotApplicableError, Sample
from benchmark.motion.clip import MotionClip
from benchmark.motion.skeleton import CORE_ROLES
from eval.metrics.shared import difference, over_references, per_clip, stride

#: Jerk in leg/s^3 below which a clip stands still but for rounding; a person who stands as still as possible is far above.
_STILL = 1e-6


@per_clip
def mean_jerk(clip: MotionClip) -> float:
    """Mean over frames and core joints of ``|d^3 p / dt^3|`` in leg/s^3, by third differences over a fixed time step."""
    needed = 3 * stride(clip.fps) + 1
    if len(clip) < needed:
        raise NotApplicableError(
            f"jerk needs {needed} frames at {clip.fps:g} frames a second, and there are {len(clip)}"
        )
    joints = clip.skeleton.joints(*(role for role in CORE_ROLES if clip.skeleton.has(role)))
    jerk = difference(clip.positions[:, joints], clip.fps, order=3)
    return float(np.linalg.norm(jerk, axis=-1).mean() / clip.skeleton.leg_length)


class JerkRatio(Metric):
    """Mean jerk of the result over that of real target clips of the same action; best at 1.

    ``mean_{t,j} |d^3 p_j / dt^3| / leg``, the result's over the median of the references'. Below 1 the result is smoother
    than people are, above 1 rougher: jitter and over-smoothing are both faults.
    """

    info = MetricInfo(
        name="physics/jerk-ratio",
        summary="mean jerk over that of real target motion",
        unit="1",
        direction="target",
        target=1.0,
        needs="reference",
        code_deps=("eval.metrics.shared",),
    )

    def compute(self, sample: Sample) -> float:
        """The ratio; not applicable without references that move or to clips too short to have a third difference."""
        real = over_references(sample, mean_jerk)
        if real <= _STILL:
            raise NotApplicableError("the real target clips do not move")
        return mean_jerk(sample.clip) / real
