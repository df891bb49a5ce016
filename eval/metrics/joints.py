"""Whether joints go where real ones go, and without jumps."""

from __future__ import annotations

import numpy as np

from benchmark.api import Metric, MetricInfo, NotApplicableError, Sample
from benchmark.errors import ContractError
from benchmark.motion import quat
from eval.metrics.content import compared_joints
from eval.metrics.shared import stride
from eval.probes.limits import JointLimits


class JointLimitViolation(Metric):
    """Share of joint angles, over frames and joints, outside the bounds that training motion of both styles keeps to.

    The bounds are percentiles 0.5 and 99.5 (:class:`~eval.probes.limits.JointLimits`), so real motion is at about 0.01: a
    value far above says that joints are bent as people's are not, one far below that the motion is tame.
    """

    info = MetricInfo(
        name="physics/joint-limit-violation",
        summary="share of joint angles outside the 0.5th to 99.5th percentile of training motion",
        unit="1",
        direction="lower",
        probe="joint-limits",
        code_deps=(
            "benchmark.motion.canonical",
            "benchmark.motion.pose",
            "benchmark.motion.resample",
            "eval.features",
            "eval.probes.limits",
        ),
    )

    def compute(self, sample: Sample) -> float:
        """The share, in [0, 1]."""
        probe = sample.probes["joint-limits"]
        if not isinstance(probe, JointLimits):
            raise ContractError(f"the probe 'joint-limits' is a {type(probe).__name__}, not JointLimits")
        return float(probe.violations(sample.clip).mean())


class PoseJump(Metric):
    """Largest turn of a joint within 1/30 s, degrees.

    ``max_{t,j} theta(q_j(t), q_j(t + 1/30 s))`` with ``theta = 2 atan2(|v|, |w|)`` of ``q^-1 q'``, over the joints whose
    rotation moves something, the whole body's turn with them. A jump at the seam of two windows, a flip of a limb or a reset
    of the facing stands out; fast real motion reaches tens of degrees, so read it beside the row of real performers.
    """

    info = MetricInfo(
        name="physics/pose-jump",
        summary="largest turn of a joint within 1/30 s",
        unit="deg",
        direction="lower",
        code_deps=("eval.metrics.content", "eval.metrics.shared"),
    )

    def compute(self, sample: Sample) -> float:
        """The angle in degrees; not applicable to a clip of less than 1/30 s."""
        clip = sample.clip
        step = stride(clip.fps)
        if len(clip) <= step:
            raise NotApplicableError(f"{len(clip)} frames are too few for a turn over 1/30 s")
        rotations = clip.rotations[:, compared_joints(clip.skeleton)]
        return float(np.degrees(quat.angle(rotations[:-step], rotations[step:]).max()))
