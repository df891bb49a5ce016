"""Walks, runs, skips and hop-scotch: there, half a turn by stepping, and back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmark.data.synthetic.curves import remembered, soft_polyline
from benchmark.data.synthetic.score import Score, Support, TravelPlan

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Gait:
    """A gait of the average adult; lengths are fractions of the leg, times nominal seconds, angles radians.

    Attributes
    ----------
    step, period
        Length and duration of a step. Walking speeds and cadences are those of adults (about 1.3 m/s at 113 steps a minute).
    overlap
        Double support (positive) or flight (negative) as a fraction of the step's duration.
    lift, skew, strike, push
        Clearance of the swing foot and its timing, pitch of the foot at landing and leaving.
    lean
        Forward lean of the trunk.
    arm, arm_offset
        Amplitude and centre of the swing of the upper arms.
    elbow, elbow_swing
        Elbow flexion and how much of it comes with the forward swing.
    pelvis, thorax
        Amplitude of the rotation of the pelvis, and of the thorax against it.
    apart
        Distance between the tracks of the feet, as a fraction of that between the hip joints.
    crouch
        Lowering of the hips.
    turn_steps
        Steps of the half turn.
    over
        When in a stance the hips are above the foot.
    spread
        Additional distance of the arms from the body, radians.
    nod
        Nodding of the head, radians.
    roll
        Amplitude of the list of the pelvis, radians.
    """

    step: float
    period: float
    overlap: float
    lift: float
    skew: float
    strike: float
    push: float
    lean: float
    arm: float
    arm_offset: float
    elbow: float
    elbow_swing: float
    pelvis: float
    thorax: float
    apart: float = 0.75
    crouch: float = 0.0
    turn_steps: int = 4
    over: float = 0.46
    spread: float = 0.0
    nod: float = 0.02
    roll: float = 0.05


GAITS: dict[str, Gait] = {
    "walk": Gait(
        step=0.80,
        period=0.53,
        overlap=0.24,
        lift=0.07,
        skew=0.0,
        strike=-0.30,
        push=0.75,
        lean=0.02,
        arm=0.36,
        arm_offset=-0.04,
        elbow=0.10,
        elbow_swing=0.22,
        pelvis=0.07,
        thorax=0.12,
        over=0.44,
    ),
    "walk-as-fast-as-you-can": Gait(
        step=0.98,
        period=0.44,
        overlap=0.18,
        lift=0.09,
        skew=0.0,
        strike=-0.36,
        push=0.85,
        lean=0.06,
        arm=0.58,
        arm_offset=0.0,
        elbow=0.65,
        elbow_swing=0.35,
        pelvis=0.11,
        thorax=0.18,
        over=0.455,
    ),
    "sneaky-walk": Gait(
        step=0.62,
        period=0.86,
        overlap=0.34,
        lift=0.26,
        skew=0.1,
        strike=0.22,
        push=0.55,
        lean=0.30,
        arm=0.22,
        arm_offset=0.55,
        elbow=1.15,
        elbow_swing=0.25,
        pelvis=0.06,
        thorax=0.08,
        apart=0.9,
        crouch=0.09,
        spread=0.15,
        nod=0.05,
    ),
    "happy-walk": Gait(
        step=0.82,
        period=0.50,
        overlap=0.20,
        lift=0.13,
        skew=0.0,
        strike=-0.22,
        push=0.85,
        lean=-0.03,
        arm=0.62,
        arm_offset=0.05,
        elbow=0.35,
        elbow_swing=0.45,
        pelvis=0.10,
        thorax=0.18,
        apart=0.9,
        over=0.43,
        spread=0.16,
        nod=0.07,
        roll=0.09,
    ),
    "jog": Gait(
        step=1.10,
        period=0.37,
        overlap=-0.32,
        lift=0.22,
        skew=-0.3,
        strike=-0.10,
        push=1.05,
        lean=0.09,
        arm=0.50,
        arm_offset=-0.05,
        elbow=1.35,
        elbow_swing=0.30,
        pelvis=0.10,
        thorax=0.20,
        apart=0.45,
        crouch=0.01,
        turn_steps=5,
        over=0.385,
    ),
    "run-as-fast-as-you-can": Gait(
        step=1.30,
        period=0.29,
        overlap=-0.44,
        lift=0.34,
        skew=-0.35,
        strike=0.08,
        push=1.25,
        lean=0.17,
        arm=0.82,
        arm_offset=-0.02,
        elbow=1.45,
        elbow_swing=0.40,
        pelvis=0.13,
        thorax=0.26,
        apart=0.3,
        crouch=0.02,
        turn_steps=6,
        over=0.40,
    ),
}


def _pace(score: Score, gait: Gait, fractions: list[float], turns: list[float], *, first: str) -> list[Support]:
    """Alternate steps of the gait, each a fraction of its full length."""
    style, leg = score.style, score.leg
    length = gait.step * leg * style.stride * score.content.effort
    rhythm = score.vary_even(len(fractions))
    stretch = score.vary_even(len(fractions))
    apart = 2.0 * score.body.hip_half_width * style.step_width
    supports = []
    feet = first
    for j, (fraction, turn) in enumerate(zip(fractions, turns, strict=True)):
        full = float(np.clip((fraction - 0.35) / 0.45, 0.0, 1.0))
        period = gait.period * score.second * rhythm[j]
        # Short steps of a run are walked: there is no time to fly.
        overlap = gait.overlap if gait.overlap > 0 else (gait.overlap if full >= 1.0 else 0.12)
        supports.append(
            Support(
                feet=feet,
                advance=fraction * length * stretch[j],
                turn=turn,
                period=period,
                overlap=overlap * period,
                apart=apart * (1.05 + full * (gait.apart - 1.05)) if fraction else apart * 1.05,
                lift=leg * (0.07 + max(full, 0.3) * (gait.lift - 0.07)),
                skew=gait.skew,
                strike=gait.strike * (full if gait.strike < 0 else 1.0) if fraction else 0.0,
                push=gait.push * (0.45 + 0.55 * full),
                crouch=gait.crouch * leg,
            )
        )
        feet = "R" if feet == "L" else "L"
    return supports


def _swing(score: Score, plan: TravelPlan, gait: Gait, nominal: float) -> None:
    """Arms against legs, thorax against pelvis, hips over the standing foot."""
    style = score.style
    phase, strength = plan.phase(), plan.intensity(nominal)
    touch = plan.touch
    period = float(np.median([support.period for support in plan.supports]))
    wobble = score.vary_even(len(touch))

    @remembered
    def cycles(t: Array) -> Array:
        return strength(t) * soft_polyline(t, touch, wobble, period)

    amplitude = gait.arm * style.arm_swing
    for side, sign in (("L", -1.0), ("R", 1.0)):
        own = 1.0 - 0.5 * sign * style.asymmetry

        def flex(t: Array, sign: float = sign, own: float = own) -> Array:
            swing = sign * np.cos(phase(t) - 0.15)
            return cycles(t) * amplitude * own * swing + strength(t) * gait.arm_offset

        def elbow(t: Array, sign: float = sign) -> Array:
            forward = 0.5 * (1.0 + sign * np.cos(phase(t) - 0.45))
            return strength(t) * (gait.elbow + gait.elbow_swing * style.arm_swing * forward)

        def spread(t: Array, sign: float = sign) -> Array:
            return strength(t) * (gait.spread + 0.05 * style.arm_swing * np.cos(2.0 * phase(t)))

        score.wave(f"flex_{side}", flex)
        score.wave(f"elbow_{side}", elbow)
        score.wave(f"abd_{side}", spread)
        score.wave(f"turn_{side}", lambda t: -0.25 * gait.elbow * strength(t))
    pelvis, thorax = gait.pelvis * style.trunk_rotation, gait.thorax * style.trunk_rotation
    score.wave("pelvis_yaw", lambda t: -pelvis * cycles(t) * np.cos(phase(t)))
    score.wave("twist", lambda t: (pelvis + thorax) * cycles(t) * np.cos(phase(t) - 0.1))
    score.wave("pelvis_roll", lambda t: gait.roll * strength(t) * np.sin(phase(t)))
    score.wave("side", lambda t: -(gait.roll + style.spine_sway) * cycles(t) * np.sin(phase(t)))
    reach = 0.30 * score.body.hip_half_width * style.step_width * gait.apart
    score.wave("shift_x", lambda t: reach * strength(t) * np.sin(phase(t)))
    score.wave("pelvis_pitch", lambda t: strength(t) * (0.45 * gait.lean + 0.015 * np.cos(2.0 * phase(t))))
    score.wave("bend", lambda t: strength(t) * (0.55 * gait.lean + 0.02 * style.bounce * np.cos(2.0 * phase(t) - 0.6)))
    nod = gait.nod * style.head_motion
    score.wave("head_pitch", lambda t: nod * cycles(t) * np.sin(2.0 * phase(t)))
    score.wave("head_roll", lambda t: 0.5 * nod * cycles(t) * np.sin(phase(t) + 0.4))


def there_and_back(score: Score) -> None:
    """Walk or run ``count`` steps, turn by stepping, and come back."""
    content = score.content
    gait = GAITS[content.action]
    going = content.count
    runs = gait.overlap < 0
    speed_up = [0.55, 0.8] if runs else [0.7]
    slow_down = [0.75, 0.55] if runs else [0.8]
    straight = [1.0] * (going - len(speed_up) - len(slow_down) + (2 if runs else 1))
    leg_out = speed_up + straight + slow_down
    turn_advance = 0.34 / max(gait.step, 0.75)
    fractions = leg_out + [turn_advance] * gait.turn_steps + leg_out + [0.0]
    angle = content.side * np.pi / gait.turn_steps
    turns = [0.0] * len(leg_out) + [angle] * gait.turn_steps + [0.0] * (len(leg_out) + 1)
    # The foot on the outside of the turn makes its first step.
    before = len(leg_out) % 2
    outer = "R" if content.side > 0 else "L"
    other = "L" if outer == "R" else "R"
    supports = _pace(score, gait, fractions, turns, first=other if before else outer)
    plan = score.travel(content.before * score.second, supports, flight_reach=0.935, over=gait.over)
    _swing(score, plan, gait, gait.step * score.leg * score.style.stride)
    _look_into_turn(score, plan, content.side)


def _look_into_turn(score: Score, plan: TravelPlan, side: int) -> None:
    turning = [time for time, support in zip(plan.touch, plan.supports, strict=True) if support.turn]
    amount = 0.35 * side * min(score.style.head_motion, 1.5)
    begin, end = turning[0] - 0.5 * score.second, turning[-1]
    score.move("head_yaw", begin, 0.6 * (end - begin), amount)
    score.move("head_yaw", begin + 0.5 * (end - begin), 0.6 * (end - begin), -amount)


def step_over(score: Score) -> None:
    """Walk, step over an obstacle of a third of a leg with both feet, walk on."""
    content, leg = score.content, score.leg
    gait = GAITS["walk"]
    approach = content.count
    fractions = [0.7] + [1.0] * (approach - 2) + [0.85] + [0.88, 0.88] + [0.9, 0.8, 0.6, 0.0]
    supports = _pace(score, gait, fractions, [0.0] * len(fractions), first="L" if content.side > 0 else "R")
    for j in (approach, approach + 1):
        high = 0.36 * leg * content.effort * (1.0 + 0.5 * (score.style.amplitude - 1.0))
        period = 1.35 * supports[j].period
        supports[j] = replace(
            supports[j], lift=high, skew=0.0, period=period, overlap=0.22 * period, strike=-0.1, push=0.8
        )
    plan = score.travel(content.before * score.second, supports, over=gait.over)
    _swing(score, plan, gait, gait.step * leg * score.style.stride)
    begin = plan.touch[max(approach - 2, 0)]
    # Eyes on the obstacle, arms out for balance.
    score.move("head_pitch", begin, 0.5 * score.second, 0.28)
    score.move("head_pitch", plan.touch[approach], 0.7 * score.second, -0.28)
    rise = plan.touch[approach - 1]
    for side in "LR":
        score.move(f"abd_{side}", rise, 0.5 * score.second, 0.22 * score.style.amplitude)
        score.move(
            f"abd_{side}",
            plan.touch[approach + 1] - 0.1 * score.second,
            0.6 * score.second,
            -0.22 * score.style.amplitude,
        )
    score.move("bend", rise, 0.5 * score.second, 0.12)
    score.move("bend", plan.touch[approach + 1] - 0.1 * score.second, 0.6 * score.second, -0.12)


def skip(score: Score) -> None:
    """Step and hop on one foot, step and hop on the other; half a turn; and back."""
    content, leg, style = score.content, score.leg, score.style
    length = leg * style.stride * content.effort
    apart = 1.5 * score.body.hip_half_width * style.step_width
    rhythm = iter(score.vary_even(8 * content.count + 12))
    beat = score.second

    def step_hop(feet: str, size: float, turn: float) -> list[Support]:
        period = 0.30 * beat * next(rhythm)
        step = Support(
            feet, 0.62 * size * length, 0.0, period, 0.10 * period, apart, 0.12 * leg, 0.0, 0.05, 0.9, phase=0.25
        )
        period = 0.38 * beat * next(rhythm)
        flight = 0.48 * period
        hop = Support(feet, 0.42 * size * length, turn, period, -flight, apart, 0.05 * leg, 0.0, 0.25, 1.0, phase=0.75)
        return [replace(step, hold=(0.85 * min(1.0, 0.4 + 0.6 * size), 0.74)), hop]

    def walked(feet: str, size: float, turn: float) -> Support:
        period = 0.42 * beat * next(rhythm)
        return Support(feet, size * length, turn, period, 0.15 * period, 1.3 * apart, 0.09 * leg, 0.0, 0.0, 0.6)

    def bout(feet: str) -> tuple[list[Support], str]:
        supports: list[Support] = []
        for k in range(content.count):
            supports += step_hop(feet, 0.75 if k == 0 else 1.0, 0.0)
            feet = "R" if feet == "L" else "L"
        return supports, feet

    first = "L" if content.side > 0 else "R"
    supports, feet = bout(first)
    for _ in range(4):
        supports.append(walked(feet, 0.28, content.side * np.pi / 4))
        feet = "R" if feet == "L" else "L"
    back, feet = bout(feet)
    supports += back
    supports.append(walked(feet, 0.3, 0.0))
    supports.append(walked("R" if feet == "L" else "L", 0.0, 0.0))
    plan = score.travel(content.before * beat, supports, flight_reach=0.95, over=0.45)
    gait = replace(
        GAITS["jog"], lean=0.03, arm=0.75, arm_offset=0.15, elbow=0.55, elbow_swing=0.45, thorax=0.16, spread=0.12, nod=0.05,
        apart=0.75,
    )  # fmt: skip
    _swing(score, plan, gait, 0.4 * length)
    _look_into_turn(score, plan, content.side)


def hop_scotch(score: Score) -> None:
    """Hop, hop, straddle, hop, straddle; turn about in two jumps; and back."""
    content, leg, style = score.content, score.leg, score.style
    length = 0.58 * leg * style.stride * content.effort
    narrow = 0.5 * score.body.hip_half_width
    wide = 4.4 * score.body.hip_half_width * (0.5 + 0.5 * style.step_width)
    hops_per_way = 5
    rhythm = iter(score.vary_even(2 * hops_per_way + 6))
    beat = score.second
    single = "L" if content.side > 0 else "R"

    def hop(feet: str, size: float, turn: float = 0.0, *, pause: float = 1.0) -> Support:
        period = 0.52 * pause * beat * next(rhythm)
        flight = min(0.50 * 0.52 * beat, 0.5 * period)
        return Support(
            feet,
            size * length,
            turn,
            period,
            -flight,
            wide if feet == "LR" else narrow,
            0.06 * leg if feet == "LR" else 0.03 * leg,
            0.0,
            0.28,
            0.9,
            hold=(-0.60, 0.70),
            phase=1.0,
        )

    def row() -> list[Support]:
        return [hop(single, 0.9), hop(single, 1.0), hop("LR", 1.0), hop(single, 1.0), hop("LR", 0.9)]

    quarter = content.side * np.pi / 2
    about = [hop("LR", 0.0, quarter, pause=1.15), hop("LR", 0.0, quarter, pause=1.15)]
    closing = replace(hop("LR", 0.0, pause=1.2), apart=2.0 * score.body.hip_half_width * style.step_width)
    supports = [replace(s, lift=0.05 * leg) for s in row()] + about + row() + [closing]
    plan = score.travel((content.before + 0.35) * beat, supports, flight_reach=0.94, over=0.5)
    strength = plan.intensity(0.4 * length)
    middle = plan.middles

    @remembered
    def pump(t: Array) -> Array:
        knots = np.array([plan.start, *middle])
        cycle = soft_polyline(t, knots, 2.0 * np.pi * np.arange(len(knots)), 0.3 * beat)
        return strength(t) * 0.5 * (1.0 - np.cos(cycle))

    for side, sign in (("L", -1.0), ("R", 1.0)):
        own = 1.0 - 0.5 * sign * style.asymmetry
        swing = 0.55 * style.arm_swing * own

        def flex(t: Array, swing: float = swing) -> Array:
            return swing * pump(t) + 0.15 * strength(t)

        score.wave(f"flex_{side}", flex)
        score.wave(f"abd_{side}", lambda t: strength(t) * (0.45 + 0.2 * style.arm_swing * pump(t) - 0.1))
        score.wave(f"elbow_{side}", lambda t: strength(t) * (0.75 - 0.25 * pump(t)))
    score.wave("bend", lambda t: strength(t) * (0.20 - 0.12 * pump(t)))
    score.wave("pelvis_pitch", lambda t: 0.10 * strength(t))
    standing = [0.0 if s.feet == "LR" else (1.0 if s.feet == "L" else -1.0) for s in supports]
    lean = _over_supports(plan, standing)
    score.wave("side", lambda t: -(0.05 + style.spine_sway) * lean(t))
    score.wave("pelvis_roll", lambda t: 0.06 * lean(t))
    score.wave("head_pitch", lambda t: strength(t) * (0.22 + 0.03 * style.head_motion * pump(t)))
    _look_into_turn(score, plan, content.side)


def _over_supports(plan: TravelPlan, values: list[float]) -> Callable[[Array], Array]:
    """A value for each support, reached at its middle."""
    knots = [plan.start, *plan.middles]
    width = 0.6 * float(np.median([support.period for support in plan.supports]))
    heights = [0.0, *values]

    @remembered
    def value(t: Array) -> Array:
        return soft_polyline(t, knots, heights, width)

    return value


def run_and_jump(score: Score) -> None:
    """Run up, leap from one foot, land on both, and come to rest in two steps."""
    content, leg, style = score.content, score.leg, score.style
    gait = GAITS["jog"]
    run = [0.55, 0.85] + [1.0] * (content.count - 2)
    fractions = [*run, 1.0, 0.45, 0.3, 0.0]
    supports = _pace(score, gait, fractions, [0.0] * len(fractions), first="L" if content.side > 0 else "R")
    leap = len(run)
    rise = 0.20 * leg * style.jump_height * content.effort
    air = float(np.sqrt(8.0 * rise / 9.81))
    wide = 2.2 * score.body.hip_half_width * style.step_width
    base = supports[leap - 1]
    speed = gait.step * leg * style.stride / (gait.period * score.second)
    contact = 0.62 * base.period
    supports[leap] = replace(
        base, feet="LR", advance=0.30 * leg + 0.85 * speed * air, period=air + contact, overlap=-air, apart=wide,
        lift=0.13 * leg, skew=0.1, strike=0.15, push=1.1,
    )  # fmt: skip
    after = supports[leap + 1]
    free = "L" if base.feet == "R" else "R"
    hold = score.second * style.landing
    supports[leap + 1] = replace(after, feet=free, period=0.62 * hold, overlap=0.12 * hold, lift=0.09 * leg)
    supports[leap + 2] = replace(supports[leap + 2], feet=base.feet, overlap=0.12 * supports[leap + 2].period)
    supports[leap + 3] = replace(supports[leap + 3], feet=free, overlap=0.12 * supports[leap + 3].period)
    plan = score.travel(content.before * score.second, supports, flight_reach=0.94, over=gait.over)
    _swing(score, plan, gait, gait.step * leg * style.stride)
    take_off, landing = plan.touch[leap] - air, plan.touch[leap]
    for side in "LR":
        score.move(f"flex_{side}", take_off - 0.2 * score.second, 0.35 * score.second, 1.3 * style.amplitude)
        score.move(f"flex_{side}", landing - 0.1 * score.second, 0.5 * hold, -1.3 * style.amplitude)
        score.move(f"abd_{side}", take_off - 0.1 * score.second, 0.35 * score.second, 0.35)
        score.move(f"abd_{side}", landing, 0.6 * hold, -0.35)
    for channel, amount in (("bend", 0.38), ("pelvis_pitch", 0.22)):
        score.move(channel, landing - 0.12 * score.second, 0.32 * hold, amount)
        score.move(channel, landing + 0.28 * hold, 0.6 * hold, -amount)
