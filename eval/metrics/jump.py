"""Jumps: their phases, and how the figure lands and swings its arms (the observations of Dong et al. 2018, in numbers).

What Dong et al. 2018 say of "jump as high as you can": a child bends lower in landing, takes longer to do so, and swings the
arms further than an adult. Each is one number here that does not depend on the figure's size. They describe; which value is
better only the comparison with a child can say, and that is made where a run is reported.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.api import Metric, MetricInfo, NotApplicableError, Sample
from benchmark.motion import quat
from benchmark.motion.clip import MotionClip
from benchmark.motion.contacts import GRAVITY, hysteresis, runs
from benchmark.motion.pose import heading_rotations
from benchmark.motion.skeleton import SIDES
from eval.metrics.shared import per_clip

#: An ankle that is less than this above where the lower ankle stays longest is on the floor, in leg lengths.
_FLOOR = 0.1
#: A flight begins when every foot joint is this far above where it stands, in leg lengths; small hops rise little more.
_RISE = 0.07
#: It ends when one of them is as near as this to where it stands; the hips stand where they are as near.
_NEAR = 0.04
#: With the hips this far above where they stand no foot can be on the floor, whatever a sensor makes of the feet.
_CERTAIN = 0.25
#: Hips that have risen by this from their lowest point, in leg lengths, have turned: what follows is another dip.
_TURN = 0.1
#: Shortest flight, in sqrt(leg / g); one that raises the hips by 0.05 of a leg lasts 0.63.
_SHORTEST = 0.3
#: Knees that bend less than this, in degrees, do not bend; and the share of the bend that may be left after recovery.
_BENT, _LEFT = 5.0, 0.25
#: Seconds over which angles are median-filtered (a depth camera misplaces joints for a frame), and to either side of the
#: hips' lowest frame through which a cubic is laid.
_FILTER, _REACH = 0.1, 0.1

#: Words of an action's name that say that it is a jump, and those that say that it is another exercise.
_JUMP = re.compile(r"(?<![a-z])(jump(s|ed|ing)?|hop(s|ped|ping)?|leap(s|ed|ing)?)(?![a-z])")
_JACK = re.compile(r"jump(s|ing)?[^a-z]*jacks?(?![a-z])")

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Jump:
    """The phases of one jump; times in seconds from the clip's first frame, found between frames where that is possible.

    Attributes
    ----------
    start
        Where the crouch before the jump begins; the first frame, or the last landing, if it begins before that.
    take_off, touchdown
        When the last foot joint leaves the floor and the first comes back.
    apex, lowest
        When the hips are highest, and lowest in the landing.
    recovery
        When three quarters of the landing's knee bend are gone; ``None`` if the clip ends or the next jump begins before.
    end
        Where the landing ends: ``recovery``, or else the next take-off or the last frame.
    """

    start: float
    take_off: float
    apex: float
    touchdown: float
    lowest: float
    recovery: float | None
    end: float

    def divided(self, fps: float) -> Jump:
        """The same phases in seconds, where they are in frames."""
        return Jump(
            start=self.start / fps,
            take_off=self.take_off / fps,
            apex=self.apex / fps,
            touchdown=self.touchdown / fps,
            lowest=self.lowest / fps,
            recovery=None if self.recovery is None else self.recovery / fps,
            end=self.end / fps,
        )


def names_a_jump(action: str) -> bool:
    """Whether an action's name says that it is a jump, a hop or a leap; jumping jacks are none."""
    name = action.lower()
    return bool(_JUMP.search(name)) and not _JACK.search(name)


@per_clip
def find_jump(clip: MotionClip) -> Jump | None:
    """The highest jump that a clip shows from the floor to the landing's lowest point; ``None`` if there is none.

    The *floor* is where the lower ankle stays longest (half-sample mode of Bickel and Fruehwirth 2006), so that a result that
    floats is measured too. *Standing* is the height at which the hips stay longest while an ankle is there, and for each
    ankle and toe its median height while they do: no frame has to be known as a standing one, and a depth camera's tilted
    floor matters little. A *flight* begins when all ankles and toes are 0.07 leg lengths above standing, and the hips above
    theirs; *take-off* and *touchdown* are where the lowest of them passes 0.04, which on generated jumps is 0.03 to 0.04 s
    after the one and before the other, for adults and children alike. While the hips are 0.25 above standing it goes on,
    whatever a sensor makes of the feet. The landing lasts until the knees, whose angle tells a shallow bend better than the
    hips' height does, have lost three quarters of their bend while the hips rise; the *lowest* point is the hips' before they
    have risen by 0.1. Legs drawn up in the air change none of this.

    Parameters
    ----------
    clip
        T frames of a skeleton with the hips, knee and ankle roles, Y up; toes are used where there are any.
    """
    skeleton = clip.skeleton
    leg = skeleton.leg_length
    heights = clip.positions[..., 1] / leg
    hips = heights[:, skeleton.joint("hips")]
    ankles = heights[:, skeleton.joints(*(f"{side}_ankle" for side in SIDES))]
    toes = [f"{side}_toe" for side in SIDES if skeleton.has(f"{side}_toe")]
    feet = np.concatenate([ankles, heights[:, skeleton.joints(*toes)]], axis=1)
    lower = ankles.min(axis=1)
    on_floor = lower < _half_sample_mode(lower) + _FLOOR
    standing = _half_sample_mode(hips[on_floor])
    stands = on_floor & (np.abs(hips - standing) < _NEAR)
    if not stands.any():
        return None
    clearance = (feet - np.median(feet[stands], axis=0)).min(axis=1)
    high = hips - standing
    flies = hysteresis((clearance > _RISE) & (high > _NEAR), (clearance > _NEAR) | (high > _CERTAIN))
    shortest = _SHORTEST * np.sqrt(leg / GRAVITY) * clip.fps
    flights = [(int(first), int(end)) for first, end in runs(flies) if end - first >= shortest]
    knees = knee_angle(clip)
    curves = _Curves(hips, clearance, np.median(knees[stands]) - knees, max(1, round(_REACH * clip.fps)))
    jumps = [jump for place in range(len(flights)) if (jump := _phases(curves, flights, place))]
    if not jumps:
        return None
    best = max(jumps, key=lambda jump: float(hips[int(jump.apex)]))
    return best.divided(clip.fps)


def knee_angle(clip: MotionClip) -> Array:
    """(T,) interior angle of the knees in degrees, 180 straight: mean of both, median-filtered over 0.1 s.

    The filter keeps a joint that a depth camera misplaces for a frame from being the lowest bend; of a quick, deep landing
    it takes up to two degrees off.
    """
    angles = []
    for side in SIDES:
        hip, knee, ankle = (
            clip.positions[:, clip.skeleton.joint(f"{side}_{part}")] for part in ("hip", "knee", "ankle")
        )
        cosine = np.sum((hip - knee) * (ankle - knee), axis=-1)
        length = np.linalg.norm(hip - knee, axis=-1) * np.linalg.norm(ankle - knee, axis=-1)
        angles.append(np.degrees(np.arccos(np.clip(cosine / np.maximum(length, 1e-12), -1.0, 1.0))))
    return _median_filter(np.mean(angles, axis=0), clip.fps)


def lowest_knee_bend(clip: MotionClip, jump: Jump) -> float:
    """Smallest angle of the knees (see :func:`knee_angle`) from touchdown to the end of the landing, degrees."""
    return float(_between(knee_angle(clip), clip.fps, jump.touchdown, jump.end).min())


def arm_swing(clip: MotionClip, jump: Jump) -> float:
    """Largest angle between two directions of an arm during a jump, degrees, mean of both arms.

    The direction is that from shoulder to wrist, seen facing forward and median-filtered over 0.1 s; the jump is taken from
    the start of the crouch to the lowest point of the landing. 180 at most: an arm that goes further has been opposite to
    where it was. An angle between directions has no axis along which it is undefined, as shoulder flexion has for an arm
    that is raised sideways.
    """
    turn = heading_rotations(clip)
    swings = []
    for side in SIDES:
        shoulder, wrist = clip.positions[:, clip.skeleton.joints(f"{side}_shoulder", f"{side}_wrist")].swapaxes(0, 1)
        arm = _median_filter(quat.inv_rotate(turn, wrist - shoulder), clip.fps)
        arm = _between(arm, clip.fps, jump.start, jump.lowest)
        arm = arm / np.maximum(np.linalg.norm(arm, axis=-1, keepdims=True), 1e-12)
        swings.append(np.degrees(np.arccos(np.clip((arm @ arm.T).min(), -1.0, 1.0))))
    return float(np.mean(swings))


def landing_duration(clip: MotionClip, jump: Jump) -> float:
    """Seconds from touchdown to the lowest point."""
    return jump.lowest - jump.touchdown


def recovery_duration(clip: MotionClip, jump: Jump) -> float:
    """Seconds from touchdown until the knees are straight again."""
    if jump.recovery is None:
        raise NotApplicableError("the clip ends, or the next jump begins, before the figure stands again")
    return jump.recovery - jump.touchdown


def measure(sample: Sample, value: Callable[[MotionClip, Jump], float]) -> float:
    """``value`` of the result's jump.

    Raises
    ------
    NotApplicableError
        The action's name says nothing of a jump, so that strides of a run are never measured as jumps, or the motion shows
        none.
    """
    action = sample.source.meta.action
    if not names_a_jump(action):
        raise NotApplicableError(f"the action {action!r} is no jump")
    jump = find_jump(sample.clip)
    if jump is None:
        raise NotApplicableError("no jump is seen from take-off to the lowest point of its landing")
    return value(sample.clip, jump)


_CITATION = "after Dong et al. 2018 (Eurographics posters: what differs in landing and arm swing)"
_DEPS = ("benchmark.motion.contacts", "benchmark.motion.pose", "benchmark.motion.canonical", "eval.metrics.shared")


class LandingKneeAngle(Metric):
    """Lowest bend of the knees in landing: their smallest interior angle from touchdown until they are straight again.

    180 degrees is straight, so a lower value is a lower bend; flexion is 180 less this. See :func:`find_jump` for the phases
    and :func:`knee_angle`. Not applicable to actions that are no jump.
    """

    info = MetricInfo(
        name="jump/landing-knee-angle",
        summary="smallest knee angle in the landing of a jump; 180 is straight",
        unit="deg",
        direction="none",
        citation=_CITATION,
        code_deps=_DEPS,
    )

    def compute(self, sample: Sample) -> float:
        """The angle in degrees; not applicable without a jump."""
        return measure(sample, lowest_knee_bend)


class ArmSwing(Metric):
    """How far the arms swing in a jump: the largest angle between two of an arm's directions. See :func:`arm_swing`.

    Not applicable to actions that are no jump.
    """

    info = MetricInfo(
        name="jump/arm-swing",
        summary="largest angle between two directions of an arm during a jump",
        unit="deg",
        direction="none",
        citation=_CITATION,
        code_deps=_DEPS,
    )

    def compute(self, sample: Sample) -> float:
        """The angle in degrees; not applicable without a jump."""
        return measure(sample, arm_swing)


class LandingDuration(Metric):
    """Seconds from touchdown to the lowest point of the hips. See :func:`find_jump`.

    Not applicable to actions that are no jump.
    """

    info = MetricInfo(
        name="jump/landing-duration",
        summary="time from touchdown to the lowest point of the landing",
        unit="s",
        direction="none",
        citation=_CITATION,
        code_deps=_DEPS,
    )

    def compute(self, sample: Sample) -> float:
        """The duration in seconds; not applicable without a jump."""
        return measure(sample, landing_duration)


class RecoveryDuration(Metric):
    """Seconds from touchdown until three quarters of the landing's knee bend are gone. See :func:`find_jump`.

    Not applicable to actions that are no jump, nor to landings that the clip does not show to their end.
    """

    info = MetricInfo(
        name="jump/recovery-duration",
        summary="time from touchdown until the knees are straight again",
        unit="s",
        direction="none",
        citation=_CITATION,
        code_deps=_DEPS,
    )

    def compute(self, sample: Sample) -> float:
        """The duration in seconds; not applicable without a jump, or if its landing is cut off."""
        return measure(sample, recovery_duration)


@dataclass(frozen=True)
class _Curves:
    """What phases are read from: hips and the lowest foot joint above standing (leg lengths), and the knees' bend (degrees)."""

    hips: Array
    clearance: Array
    bend: Array
    reach: int


def _phases(curves: _Curves, flights: Sequence[tuple[int, int]], place: int) -> Jump | None:
    """The jump about one of the flights, times in frames; ``None`` if the clip does not show it to its lowest point."""
    hips, clearance, bend = curves.hips, curves.clearance, curves.bend
    first, down = flights[place]
    since = flights[place - 1][1] if place else 0
    until = flights[place + 1][0] if place + 1 < len(flights) else len(hips)
    lift = next((frame for frame in range(first - 1, since - 1, -1) if clearance[frame] <= _NEAR), None)
    if lift is None or down >= until:
        return None
    straight = _straight_again(bend[down:until], rising=np.diff(hips[down - 1 : until]) > 0.0)
    end = until - 1 if straight is None else down + straight
    landing = hips[down : end + 1]
    turned = np.flatnonzero(landing > np.minimum.accumulate(landing) + _TURN)
    deepest = down + int(np.argmin(landing[: turned[0]] if turned.size else landing))
    if deepest == len(hips) - 1:
        return None
    recovery = None
    if straight is not None:
        recovery = _crossing(bend, end - 1, _LEFT * float(bend[down : end + 1].max())) if straight else float(end)
    bent = _straight_again(bend[since : lift + 1][::-1], rising=np.ones(lift + 1 - since, dtype=bool))
    return Jump(
        start=float(since if bent is None else lift - bent),
        take_off=_crossing(clearance, lift, _NEAR),
        apex=float(first + np.argmax(hips[first:down])),
        touchdown=_crossing(clearance, down - 1, _NEAR),
        lowest=max(_vertex(hips, deepest, down, until - 1, curves.reach), float(down - 1)),
        recovery=recovery,
        end=float(end) if recovery is None else recovery,
    )


def _straight_again(bend: Array, *, rising: NDArray[np.bool_]) -> int | None:
    """The first index at which a bend has come and, while ``rising``, three quarters of it have gone; ``None`` if never."""
    most = np.maximum.accumulate(bend)
    found = np.flatnonzero((most > _BENT) & (bend <= _LEFT * most) & rising)
    return int(found[0]) if found.size else None


def _vertex(values: Array, lowest: int, first: int, last: int, reach: int) -> float:
    """Where between frames ``values`` are lowest about their lowest frame: minimum of a cubic through them.

    A landing falls faster than it rises, which would pull the vertex of a parabola towards the slower side.
    """
    index = np.arange(max(lowest - reach, first), min(lowest + reach, last) + 1)
    if len(index) < 5:
        return float(lowest)
    third, second, slope, _ = np.polyfit(index - lowest, values[index], 3)
    # The root of the slope, 3 third x^2 + 2 second x + slope, at which it rises.
    under = second**2 - 3.0 * third * slope
    if under <= 0.0 or second + np.sqrt(under) <= 0.0:
        return float(lowest)
    return float(lowest + np.clip(-slope / (second + np.sqrt(under)), -1.0, 1.0))


def _crossing(values: Array, frame: int, level: float) -> float:
    """Where between ``frame`` and the next ``values`` pass ``level``; the next frame if they do not."""
    now, then = values[frame], values[frame + 1]
    if (now - level) * (then - level) > 0.0 or now == then:
        return float(frame + 1)
    return float(frame + (level - now) / (then - now))


def _between(values: Array, fps: float, start: float, end: float) -> Array:
    """The frames of ``values`` (T, ...) whose times are in ``start`` to ``end``, and those just outside."""
    return values[int(np.floor(start * fps + 1e-9)) : int(np.ceil(end * fps - 1e-9)) + 1]


def _median_filter(values: Array, fps: float) -> Array:
    """(T, ...) medians over :data:`_FILTER` seconds about each frame; the ends are repeated outwards."""
    half = max(1, int(0.5 * _FILTER * fps + 1e-9))
    padded = np.concatenate([np.repeat(values[:1], half, axis=0), values, np.repeat(values[-1:], half, axis=0)])
    return np.asarray(np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1, axis=0), axis=-1))


def _half_sample_mode(values: Array) -> float:
    """The value about which ``values`` are densest: the half of them that spans least, halved again until two are left."""
    values = np.sort(values)
    while len(values) > 2:
        half = (len(values) + 1) // 2
        first = int(np.argmin(values[half - 1 :] - values[: len(values) - half + 1]))
        values = values[first : first + half]
    return float(values.mean())
