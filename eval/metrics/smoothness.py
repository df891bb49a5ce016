"""Motion that is too rough or too smooth for a real performer: jerk, dimensionless jerk, jumps between frames."""

from __future__ import annotations

import numpy as np

from benchmark.api import Metric, MetricInfo, NotApplicableError, Sample
from benchmark.motion.clip import MotionClip
from benchmark.motion.pose import SEGMENTS
from benchmark.motion.skeleton import CORE_ROLES
from eval.metrics.shared import difference, over_references, per_clip, stride
from eval.metrics.windowed import windows

#: Jerk in leg/s^3 below which a clip stands still but for rounding; a person who stands as still as possible is far above.
_STILL = 1e-6

#: Seconds of the windows of the dimensionless jerk, and mean speed in leg/s below which a window holds no movement.
_WINDOW, _RESTING = 1.0, 0.01

#: Largest turn of a limb from one step to the next, in degrees, below which a clip stands still.
_HELD = 1e-3


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


class JerkDeviation(Metric):
    """Size of the relative difference of jerk to real target motion, ``|ln(jerk / real jerk)|``.

    Jitter and over-smoothing are both faults, and unlike in a mean of :class:`JerkRatio` they do not cancel: 0.7 is half or
    twice the jerk of real motion.
    """

    info = MetricInfo(
        name="physics/jerk-deviation",
        summary="size of the log ratio of mean jerk to that of real target motion",
        unit="1",
        direction="lower",
        needs="reference",
        code_deps=("eval.metrics.shared",),
    )

    def compute(self, sample: Sample) -> float:
        """The deviation; not applicable where either side does not move, or as in :class:`JerkRatio`."""
        real, ours = over_references(sample, mean_jerk), mean_jerk(sample.clip)
        if min(real, ours) <= _STILL:
            raise NotApplicableError("the result or the real target clips do not move")
        return float(abs(np.log(ours / real)))


@per_clip
def log_dimensionless_jerk(clip: MotionClip) -> float:
    """Median over windows of 1 s of ``-ln(D^3 sum_j int |d^3 p_j / dt^3|^2 dt / sum_j max_t |dp_j / dt|^2)``.

    The log dimensionless jerk of Balasubramanian et al. 2015, over the core joints together, with D the window's length. It
    depends on neither amplitude nor size; windows of fixed length take out the length of the recording, on which it depends
    for movements that repeat. Windows in which nothing moves do not count. Lower is less smooth.
    """
    needed = 3 * stride(clip.fps) + 2
    if len(clip) < needed:
        raise NotApplicableError(f"dimensionless jerk needs {needed} frames, and there are {len(clip)}")
    joints = clip.skeleton.joints(*(role for role in CORE_ROLES if clip.skeleton.has(role)))
    positions = clip.positions[:, joints] / clip.skeleton.leg_length
    values = []
    for start, stop in windows(len(clip), clip.fps, _WINDOW):
        part = positions[start:stop]
        if len(part) < needed:
            continue
        speed = np.linalg.norm(difference(part, clip.fps), axis=-1)
        jerk = np.linalg.norm(difference(part, clip.fps, order=3), axis=-1)
        if speed.mean() < _RESTING:
            continue
        span = (stop - start - 1) / clip.fps
        squared = float(np.sum(jerk**2) / len(jerk)) * span
        values.append(-np.log(max(squared, 1e-300) * span**3 / np.sum(speed.max(axis=0) ** 2)))
    if not values:
        raise NotApplicableError("nothing moves in this clip")
    return float(np.median(values))


class LogDimensionlessJerk(Metric):
    """Log dimensionless jerk of the result minus the median of real target clips of the same action; best at 0.

    See :func:`log_dimensionless_jerk`. Below 0 the result is less smooth than people are, above 0 smoother. Amplitude and size
    do not enter, so a calm result is not taken for a smooth one, as mean jerk takes it.
    """

    info = MetricInfo(
        name="physics/log-dimensionless-jerk",
        summary="log dimensionless jerk minus that of real target motion",
        unit="1",
        direction="target",
        target=0.0,
        needs="reference",
        citation="Balasubramanian, Melendez-Calderon, Roby-Brami & Burdet 2015",
        code_deps=("eval.metrics.shared", "eval.metrics.windowed"),
    )

    def compute(self, sample: Sample) -> float:
        """The difference; not applicable where either side does not move."""
        return log_dimensionless_jerk(sample.clip) - over_references(sample, log_dimensionless_jerk)


@per_clip
def largest_turn(clip: MotionClip) -> float:
    """Largest angle in degrees by which trunk or a limb turns within 1/30 s, seen from the world."""
    step = stride(clip.fps)
    if len(clip) <= step:
        raise NotApplicableError(f"{len(clip)} frames are too few for a step of {step}")
    joint = clip.skeleton.joint
    starts, ends = ([joint(pair[i]) for pair in SEGMENTS] for i in range(2))
    spans = clip.positions[:, ends] - clip.positions[:, starts]
    before, after = spans[:-step], spans[step:]
    across = np.linalg.norm(np.cross(before, after), axis=-1)
    return float(np.degrees(np.arctan2(across, np.sum(before * after, axis=-1)).max()))


class LargestTurnRatio(Metric):
    """Largest turn of a limb within 1/30 s, over that of real target clips of the same action; best at 1.

    One pop is enough to be seen, which no mean shows. Directions of limbs are measured, not quaternions, so neither sign nor
    twist enters; see :func:`largest_turn`.
    """

    info = MetricInfo(
        name="physics/largest-turn-ratio",
        summary="largest turn of a limb within 1/30 s over that of real target motion",
        unit="1",
        direction="target",
        target=1.0,
        needs="reference",
        code_deps=("benchmark.motion.pose", "eval.metrics.shared"),
    )

    def compute(self, sample: Sample) -> float:
        """The ratio; not applicable where the real clips stand still."""
        real = over_references(sample, largest_turn)
        if real < _HELD:
            raise NotApplicableError("the real target clips do not move")
        return largest_turn(sample.clip) / real
