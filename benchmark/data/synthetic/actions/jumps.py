"""Jumps and hops: prepare, push off, fly, absorb, recover."""

from __future__ import annotations

import numpy as np

from benchmark.data.synthetic.score import GRAVITY, Plant, Score


def _turn(acceleration: float, depth: float, duration: float) -> float:
    """Upward acceleration at the bottom of a dip of ``depth`` that takes ``duration`` on its slower side.

    Above 20 depth / duration^2 a quintic between standing and the bottom would rise above standing first.
    """
    return min(acceleration, 14.0 * depth / duration**2)


def _leap(
    score: Score, start: float, *, rise: float, arms: float, forward: float = 0.0, tuck: float = 0.0, depth: float = 0.2
) -> float:
    """One two-footed jump from standing to standing; returns when it is over.

    Parameters
    ----------
    score
        Both feet planted beside each other.
    start
        When the preparation begins.
    rise
        Rise of the hips in flight, metres.
    arms
        Flexion of the upper arms at take-off, radians.
    forward
        How far the feet go, metres.
    tuck
        How far the feet are drawn up at the height of the jump, metres; negative if the legs stretch.
    depth
        Lowering of the hips before the jump, as a fraction of the leg.
    """
    style, leg, beat = score.style, score.leg, score.second
    speed = float(np.sqrt(2.0 * GRAVITY * rise))
    air = 2.0 * speed / GRAVITY
    flying = score.body.ankle_height + leg * ((0.915 if forward else 0.945) - style.knee_bend)
    low = score.stand - depth * leg
    push = (flying - low) / (0.52 * speed)
    prepare = 0.52 * beat * style.anticipation * score.vary()
    bottom = start + prepare
    take_off = bottom + push
    touch_down = take_off + air
    absorb = min(0.26 * beat * style.landing * score.vary(), 0.36 * leg / (0.5 * speed))
    sunk = flying - 0.5 * speed * absorb
    lowest = touch_down + absorb
    recovered = lowest + 0.62 * beat * style.landing
    score.heights += [
        (start, score.stand, 0.0, 0.0),
        (bottom, low, 0.0, _turn(1.1 * speed / push, score.stand - low, prepare)),
        (take_off, flying, speed, -GRAVITY),
        (touch_down, flying, -speed, -GRAVITY),
        (lowest, sunk, 0.0, _turn(0.9 * speed / absorb, score.stand - sunk, recovered - lowest)),
        (recovered, score.stand, 0.0, 0.0),
    ]
    score.flights.append((take_off, touch_down))
    for side in "LR":
        last = score.feet[side][-1]
        last.push, last.peel = 0.95, 0.5
        score.step(
            side,
            take_off,
            touch_down,
            Plant(
                0.0,
                np.inf,
                last.x,
                last.z + forward,
                last.yaw,
                strike=-0.12 if forward else 0.25,
                lift=tuck,
                rise=rise,
                settle=0.12,
            ),
        )
    if forward:
        _carry(score, bottom, take_off, touch_down, recovered, forward)
    amplitude = style.amplitude
    bow = (1.6 * depth + 0.14) * (1.0 if not forward else 1.35)
    crouch = {"bend": bow, "pelvis_pitch": 0.8 * bow, "head_pitch": -0.3 * bow, "shift_z": -0.22 * depth * leg}
    reach = {
        "bend": -0.10,
        "pelvis_pitch": 0.35 * min(forward / leg, 0.6),
        "head_pitch": -0.10 * style.head_motion,
        "shift_z": 0.0,
    }
    impact = {"bend": 0.75 * bow, "pelvis_pitch": 0.65 * bow, "head_pitch": 0.0, "shift_z": -0.10 * depth * leg}
    rest = {"bend": 0.0, "pelvis_pitch": 0.0, "head_pitch": 0.0, "shift_z": 0.0}
    swing_back, land = -0.42 * min(arms, 1.9) * amplitude, 0.35 * arms
    for side, sign in (("L", 1.0), ("R", -1.0)):
        own = 1.0 + 0.5 * sign * style.asymmetry
        crouch |= {f"flex_{side}": swing_back * own, f"elbow_{side}": 0.25, f"abd_{side}": 0.10}
        reach |= {f"flex_{side}": arms * amplitude * own, f"elbow_{side}": 0.35, f"abd_{side}": 0.20}
        impact |= {f"flex_{side}": land * own, f"elbow_{side}": 0.30, f"abd_{side}": 0.30 * amplitude}
        rest |= {f"flex_{side}": 0.0, f"elbow_{side}": 0.0, f"abd_{side}": 0.0}
    score.pose(crouch, start, 0.97 * prepare)
    score.pose(reach, bottom - 0.10 * beat, push + 0.12 * beat)
    score.pose(impact, take_off + 0.45 * air, 0.55 * air + absorb)
    score.pose(rest, lowest + 0.02, 0.9 * (recovered - lowest))
    return recovered


def _carry(score: Score, bottom: float, take_off: float, touch_down: float, recovered: float, forward: float) -> None:
    """Take the hips forward: ahead of the feet at take-off, at constant speed in flight, behind them on landing."""
    leg = score.leg
    z = score.path[-1][2]
    ahead, behind = 0.15 * leg, 0.20 * leg
    speed = (forward - ahead - behind) / (touch_down - take_off)
    round_off = 0.5 * min(0.16 * score.second, take_off - bottom)
    yaw = score.path[-1][3]
    # Corners are rounded before take-off and after landing only, so the flight itself is straight and even.
    score.path = [
        (take_off - 0.85 * (take_off - bottom) - round_off, 0.0, z, yaw),
        (take_off - round_off, 0.0, z + ahead - speed * round_off, yaw),
        (touch_down + round_off, 0.0, z + forward - behind + speed * round_off, yaw),
        (max(touch_down + 0.45 * score.second, touch_down + 3.5 * round_off), 0.0, z + forward, yaw),
    ]
    score.path_width = 2.0 * round_off


def jump_high(score: Score) -> None:
    """Jump in place as high as one can."""
    _single(score, rise=0.40, arms=2.65, depth=0.27, tuck=-0.10)


def jump(score: Score) -> None:
    """One or two easy jumps in place."""
    score.stand_still()
    t = score.content.before * score.second
    for _ in range(score.content.count):
        rise = 0.20 * score.leg * score.style.jump_height * score.content.effort * score.vary()
        t = _leap(score, t, rise=rise, arms=1.25, depth=0.17, tuck=-0.06 * score.leg) + 0.12 * score.second
    score.end = t + score.content.after * score.second


def _single(score: Score, *, rise: float, arms: float, depth: float, tuck: float) -> None:
    score.stand_still()
    height = rise * score.leg * score.style.jump_height * score.content.effort
    over = _leap(score, score.content.before * score.second, rise=height, arms=arms, depth=depth, tuck=tuck * score.leg)
    score.end = over + score.content.after * score.second


def broad_jump(score: Score) -> None:
    """Jump forward from standing."""
    score.stand_still()
    leg, effort = score.leg, score.content.effort * score.style.jump_height
    over = _leap(
        score,
        score.content.before * score.second,
        rise=0.19 * leg * effort,
        arms=1.75,
        forward=1.45 * leg * effort,
        tuck=0.12 * leg,
        depth=0.25,
    )
    score.end = over + score.content.after * score.second


def one_leg(score: Score) -> None:
    """Hop in place on one leg; the other is held up."""
    content, style, leg, beat = score.content, score.style, score.leg, score.second
    stance, free = ("L", "R") if content.action == "jump-with-one-leg" else ("R", "L")
    sign = 1.0 if stance == "L" else -1.0
    score.stand_still()
    foot = score.feet[stance][0]
    begin = content.before * beat
    lean = 0.55 * beat * style.anticipation
    score.move("shift_x", begin, lean, 0.82 * foot.x)
    score.move("side", begin, lean, -sign * (0.05 + style.spine_sway))
    score.move("pelvis_roll", begin, lean, sign * 0.04)
    lifted = begin + 0.45 * lean
    rise = 0.11 * leg * style.jump_height * content.effort
    flying = score.body.ankle_height + leg * (0.945 - style.knee_bend)
    t = begin + lean
    score.heights.append((begin + 0.4 * lean, score.stand, 0.0, 0.0))
    rhythm = score.vary_even(content.count)
    for k in range(content.count):
        height = rise * score.vary()
        speed = float(np.sqrt(2.0 * GRAVITY * height))
        air = 2.0 * speed / GRAVITY
        if k == 0:
            low = score.stand - 0.11 * leg
            push = (flying - low) / (0.52 * speed)
            score.heights.append((t, low, 0.0, _turn(1.1 * speed / push, score.stand - low, 0.6 * lean)))
            take_off = t + push
        else:
            contact = 0.34 * beat * rhythm[k]
            previous = t
            low = flying - 0.17 * speed * contact - 0.02 * leg
            score.heights.append((previous + 0.5 * contact, low, 0.0, 1.6 * speed / contact))
            take_off = previous + contact
        touch_down = take_off + air
        score.heights += [(take_off, flying, speed, -GRAVITY), (touch_down, flying, -speed, -GRAVITY)]
        score.flights.append((take_off, touch_down))
        last = score.feet[stance][-1]
        last.push = 0.85
        stray = 0.35 * leg * (score.vary() - 1.0)
        plant = Plant(0.0, np.inf, last.x, last.z + stray, last.yaw, strike=0.22, lift=0.01, rise=height, settle=0.10)
        score.step(stance, take_off, touch_down, plant)
        for side, part in (("L", 1.0), ("R", -1.0)):
            own = 1.0 + 0.5 * part * style.asymmetry
            up = 0.45 * style.arm_swing * own
            score.move(f"flex_{side}", take_off - 0.16 * beat, 0.26 * beat, up)
            score.move(f"flex_{side}", touch_down - 0.06 * beat, 0.30 * beat, -up)
        score.move("shift_z", touch_down - 0.5 * air, air, stray)
        t = touch_down
    absorb = 0.24 * beat * style.landing
    score.heights.append((t + absorb, flying - 0.5 * speed * absorb, 0.0, 0.9 * speed / absorb))
    done = t + absorb + 0.55 * beat * style.landing
    score.heights.append((done, score.stand, 0.0, 0.0))
    release = t + absorb + 0.10 * beat
    score.holds[free] = [(lifted, 0.55 * lean + 0.1 * beat, release, 0.55 * beat * style.landing, -0.45, 0.72)]
    for moves in ("shift_x", "side", "pelvis_roll"):
        score.pose({moves: 0.0}, release + 0.15 * beat, 0.6 * beat * style.landing)
    for side in "LR":
        score.move(f"abd_{side}", begin, lean, 0.40 * style.amplitude)
        score.move(f"elbow_{side}", begin, lean, 0.55)
        score.move(f"abd_{side}", release, 0.6 * beat, -0.40 * style.amplitude)
        score.move(f"elbow_{side}", release, 0.6 * beat, -0.55)
    score.move("bend", begin, lean, 0.12)
    score.move("bend", release, 0.6 * beat, -0.12)
    score.move("pelvis_pitch", begin, lean, 0.08)
    score.move("pelvis_pitch", release, 0.6 * beat, -0.08)
    score.end = max(done, release + 0.8 * beat * style.landing) + content.after * beat


def jumping_jacks(score: Score) -> None:
    """Five jumping jacks: hop astride with the arms overhead, and back."""
    content, style, leg, beat = score.content, score.style, score.leg, score.second
    score.stand_still()
    half = score.body.hip_half_width * style.step_width
    wide = half + 0.24 * leg * (0.6 + 0.4 * style.amplitude)
    rhythm = score.vary_even(2 * content.count)
    t = content.before * beat
    flying = score.body.ankle_height + leg * (0.965 - style.knee_bend)
    flying_wide = score.body.ankle_height + np.sqrt(
        max((0.985 * leg) ** 2 - (wide - score.body.hip_half_width) ** 2, 0.0)
    )
    flying = min(flying, float(flying_wide)) - style.knee_bend * leg
    score.heights.append((t, score.stand, 0.0, 0.0))
    score.move("bend", t, 0.3 * beat, 0.04)
    overhead = float(min(2.45 * style.amplitude, 2.85))
    for k in range(2 * content.count):
        outward = k % 2 == 0
        half_cycle = 0.46 * beat * rhythm[k] * (style.anticipation if k == 0 else 1.0)
        air = 0.36 * 0.46 * beat
        speed = 0.5 * GRAVITY * air
        contact = half_cycle - air
        low = flying - 0.20 * speed * contact - 0.008 * leg
        if k == 0:
            score.heights.append((t + 0.55 * contact, low, 0.0, 1.4 * speed / contact))
        take_off = t + contact
        touch_down = take_off + air
        score.heights += [(take_off, flying, speed, -GRAVITY), (touch_down, flying, -speed, -GRAVITY)]
        score.flights.append((take_off, touch_down))
        reach = (overhead - 0.06 - style.arm_spread) * (1.0 + 0.6 * (score.vary() - 1.0))
        for side, sign in (("L", 1.0), ("R", -1.0)):
            own = 1.0 + 0.3 * sign * style.asymmetry
            last = score.feet[side][-1]
            last.push, last.peel = 0.55, 0.6
            x = sign * (wide if outward else half)
            yaw = sign * (0.30 if outward else 0.10)
            plant = Plant(
                0.0, np.inf, x, 0.0, yaw, strike=0.25, lift=0.015 * leg, rise=GRAVITY * air**2 / 8.0, settle=0.08
            )
            score.step(side, take_off, touch_down, plant)
            score.pose(
                {f"abd_{side}": reach * own if outward else 0.05}, take_off - 0.16 * beat, 0.44 * beat * rhythm[k]
            )
            score.pose({f"elbow_{side}": 0.10 if outward else 0.0}, take_off - 0.16 * beat, 0.44 * beat * rhythm[k])
        score.pose({"head_pitch": -0.05 * style.head_motion if outward else 0.0}, take_off - 0.1 * beat, 0.4 * beat)
        t = touch_down
    absorb = 0.18 * beat * style.landing
    score.heights.append((t + absorb, flying - 0.5 * speed * absorb, 0.0, 0.9 * speed / absorb))
    done = t + absorb + 0.45 * beat * style.landing
    score.heights.append((done, score.stand, 0.0, 0.0))
    score.pose({"bend": 0.0, "head_pitch": 0.0, "abd_L": 0.0, "abd_R": 0.0}, t, 0.6 * beat)
    score.end = done + content.after * beat
