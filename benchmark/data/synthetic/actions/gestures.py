"""Actions on the spot that need no flight: throws, punches, kicks, and standing idle."""

from __future__ import annotations

import numpy as np

from benchmark.data.synthetic.score import Plant, Score


def throw(score: Score) -> None:
    """Throw a ball overarm: wind up over the rear foot, step forward with the other, release, follow through, step back."""
    content, style, leg, beat = score.content, score.style, score.leg, score.second
    hand, other = ("R", "L") if content.action == "throw-a-ball-with-right-arm" else ("L", "R")
    # +1 for a right-handed throw: trunk turns to the right (negative about Y) to wind up, to the left to throw.
    sign = 1.0 if hand == "R" else -1.0
    amplitude = style.amplitude * content.effort
    score.stand_still()
    start = content.before * beat
    wind = 0.75 * beat * style.anticipation * score.vary()
    stride = 0.38 * beat * score.vary()
    whip = 0.26 * beat * score.vary()
    follow = 0.45 * beat * style.landing * score.vary()
    length = 0.42 * leg * style.stride * amplitude
    cocked = start + wind
    landed = cocked + 0.85 * stride
    release = landed + whip
    settled = release + follow
    front = score.feet[other][0]
    score.step(
        other,
        start + 0.72 * wind,
        landed,
        Plant(0.0, np.inf, front.x, length, front.yaw, strike=-0.2, lift=0.10 * leg, push=0.4),
    )
    score.pose(
        {
            "pelvis_yaw": -sign * 0.35 * amplitude,
            "twist": -sign * 0.50 * amplitude * style.trunk_rotation**0.3,
            "shift_x": -sign * 0.55 * score.body.hip_half_width,
            "shift_z": -0.05 * leg,
            "bend": -0.06,
            "side": sign * 0.08,
            f"flex_{hand}": 0.95,
            f"abd_{hand}": 1.40 * min(amplitude, 1.15),
            f"elbow_{hand}": 1.45,
            f"flex_{other}": 0.85 * amplitude,
            f"abd_{other}": 0.35,
            f"elbow_{other}": 0.45,
        },
        start,
        wind,
    )
    whole = landed - cocked + whip
    score.pose(
        {"shift_x": sign * 0.25 * score.body.hip_half_width, "shift_z": 0.60 * length},
        start + 0.75 * wind,
        whole + 0.3 * wind,
    )
    score.pose({"pelvis_yaw": sign * 0.30 * amplitude}, cocked + 0.35 * stride, whole)
    score.pose(
        {"twist": sign * 0.45 * amplitude, "bend": 0.22 * amplitude, "side": -sign * 0.10},
        cocked + 0.55 * stride,
        whole,
    )
    score.pose({f"flex_{hand}": 1.75, f"abd_{hand}": 0.55}, landed - 0.25 * whip, 1.25 * whip)
    score.pose({f"elbow_{hand}": 0.12}, landed + 0.05 * whip, 1.05 * whip)
    score.pose({f"flex_{other}": -0.25, f"elbow_{other}": 0.9}, landed - 0.2 * whip, 1.4 * whip)
    score.pose(
        {
            f"flex_{hand}": 0.35,
            f"abd_{hand}": -0.10,
            f"elbow_{hand}": 0.35,
            "twist": sign * 0.60 * amplitude,
            "bend": 0.40 * amplitude,
            "pelvis_pitch": 0.12,
        },
        release - 0.05 * beat,
        follow,
    )
    score.move(f"wrist_{hand}", cocked, 0.3 * beat, -0.45)
    score.move(f"wrist_{hand}", release - 0.1 * beat, 0.2 * beat, 0.85)
    score.move(f"wrist_{hand}", release + 0.15 * beat, 0.4 * beat, -0.40)
    _sink(score, start, landed, settled, 0.07 * leg, release)
    back = settled + 0.10 * beat
    _return_foot(score, other, back, 0.5 * beat * style.landing)
    rest = dict.fromkeys(
        ("pelvis_yaw", "pelvis_pitch", "twist", "bend", "side", "shift_x", "shift_z",
         *(f"{part}_{side}" for part in ("flex", "abd", "elbow") for side in "LR")), 0.0,
    )  # fmt: skip
    score.pose(rest, settled - 0.1 * beat, 0.75 * beat * style.landing)
    score.end = settled + 0.75 * beat * style.landing + content.after * beat


def _sink(score: Score, start: float, landed: float, settled: float, depth: float, moment: float) -> None:
    """Lower the hips while the feet are apart."""
    score.heights += [
        (start, score.stand, 0.0, 0.0),
        (0.5 * (landed + moment), score.stand - depth, 0.0, 0.0),
        (settled, score.stand - 0.8 * depth, 0.0, 0.0),
        (settled + 0.7 * score.second * score.style.landing, score.stand, 0.0, 0.0),
    ]


def _return_foot(score: Score, side: str, when: float, duration: float) -> None:
    first = score.feet[side][0]
    score.feet[side][-1].push = 0.45
    plant = Plant(0.0, np.inf, first.x, first.z, first.yaw, strike=0.10, lift=0.08 * score.leg)
    score.step(side, when, when + duration, plant)


def punch(score: Score) -> None:
    """Raise the guard, step in, one to three straight punches with alternate hands, step back."""
    content, style, leg, beat = score.content, score.style, score.leg, score.second
    lead = "L" if content.side > 0 else "R"
    sign = 1.0 if lead == "L" else -1.0
    amplitude = style.amplitude * content.effort
    score.stand_still()
    start = content.before * beat
    ready = start + 0.60 * beat * style.anticipation * score.vary()
    front = score.feet[lead][0]
    length = 0.36 * leg * style.stride * amplitude
    plant = Plant(0.0, np.inf, front.x, length, front.yaw, strike=-0.15, lift=0.07 * leg, push=0.4)
    score.step(lead, start + 0.15 * beat, ready, plant)
    guard = {
        "shift_z": 0.45 * length,
        "bend": 0.12,
        "pelvis_pitch": 0.05,
        "pelvis_yaw": -sign * 0.20,
        "twist": -sign * 0.15,
    }
    for side in "LR":
        guard |= {
            f"flex_{side}": 0.55,
            f"abd_{side}": 0.02,
            f"elbow_{side}": 1.85 - style.elbow_bend,
            f"turn_{side}": -0.20,
        }
    score.pose(guard, start, ready - start)
    t = ready + 0.15 * beat
    hand = "R" if lead == "L" else "L"
    for _ in range(content.count):
        turn = 1.0 if hand == "R" else -1.0
        draw_back = 0.22 * beat * style.anticipation * score.vary()
        out = 0.22 * beat * score.vary()
        back = 0.34 * beat * style.landing * score.vary()
        reach = amplitude * score.vary()
        score.pose({"twist": -turn * 0.30 * reach, f"flex_{hand}": 0.35}, t, draw_back)
        hit = t + draw_back
        score.pose({"pelvis_yaw": turn * 0.25 * reach}, hit - 0.06 * beat, out)
        score.pose({"twist": turn * 0.45 * reach, "bend": 0.18}, hit - 0.02 * beat, out)
        elbow = max(0.10 - style.elbow_bend, -0.10 - style.elbow_bend) + 0.25 * max(1.0 - reach, 0.0)
        score.pose(
            {
                f"flex_{hand}": 1.45 * min(reach, 1.08),
                f"elbow_{hand}": elbow,
                f"abd_{hand}": 0.05,
                f"turn_{hand}": -0.5,
            },
            hit,
            out,
        )
        score.pose({"pelvis_yaw": -sign * 0.20, "twist": -sign * 0.15, "bend": 0.12}, hit + out + 0.04 * beat, back)
        score.pose(
            {
                f"flex_{hand}": 0.55,
                f"elbow_{hand}": 1.85 - style.elbow_bend,
                f"abd_{hand}": 0.02,
                f"turn_{hand}": -0.20,
            },
            hit + out + 0.04 * beat,
            back,
        )
        t = hit + out + back + 0.10 * beat
        hand = "L" if hand == "R" else "R"
    _sink(score, start, ready, t, 0.06 * leg, ready + 0.3 * beat)
    _return_foot(score, lead, t + 0.05 * beat, 0.5 * beat * style.landing)
    score.pose(dict.fromkeys(score.moves, 0.0), t, 0.75 * beat * style.landing)
    score.end = t + 0.75 * beat * style.landing + content.after * beat


def kick(score: Score) -> None:
    """Shift onto one leg, swing the other back and kick forward, once or twice."""
    content, style, leg, beat = score.content, score.style, score.leg, score.second
    foot, stance = ("R", "L") if content.side > 0 else ("L", "R")
    sign = 1.0 if stance == "L" else -1.0
    arm_sign = 1.0 if foot == "R" else -1.0
    score.stand_still()
    start = content.before * beat
    shift = 0.50 * beat * style.anticipation * score.vary()
    score.pose({"shift_x": 0.85 * score.feet[stance][0].x, "side": -sign * 0.05}, start, shift)
    score.move("pelvis_roll", start, shift, sign * 0.03)
    lifted = start + 0.55 * shift
    score.heights += [(start, score.stand, 0.0, 0.0), (start + shift, score.stand - 0.035 * leg, 0.0, 0.0)]
    free = score.free.setdefault(foot, {"angle": [], "length": []})
    t = start + shift
    for k in range(content.count):
        wind = 0.42 * beat * style.anticipation * score.vary()
        strike = 0.27 * beat * score.vary()
        back = 0.55 * beat * style.landing * score.vary()
        height = 1.30 * style.amplitude * content.effort * score.vary()
        free["angle"] += [(t - 0.1 * beat, wind, -0.55), (t + wind - 0.12 * beat, strike + 0.06 * beat, 0.55 + height)]
        free["angle"].append((t + wind + strike + 0.02 * beat, back, -height))
        free["length"] += [
            (t - 0.1 * beat, wind, -0.12),
            (t + wind - 0.02 * beat, strike, 0.22),
            (t + wind + strike, back, -0.10),
        ]
        score.pose(
            {"bend": -0.02, "pelvis_pitch": 0.10, "twist": -arm_sign * 0.15, "pelvis_yaw": -arm_sign * 0.15}, t, wind
        )
        hit = t + wind
        score.pose(
            {
                "bend": 0.16,
                "pelvis_pitch": -0.22 * style.amplitude,
                "twist": -arm_sign * 0.30 * style.trunk_rotation**0.5,
                "pelvis_yaw": arm_sign * 0.22,
                f"flex_{foot}": -0.55 * style.arm_swing**0.5,
                f"flex_{stance}": 0.75 * style.arm_swing**0.5,
            },
            hit - 0.10 * beat,
            strike + 0.10 * beat,
        )
        score.pose(
            {
                "bend": 0.0,
                "pelvis_pitch": 0.0,
                "twist": 0.0,
                "pelvis_yaw": 0.0,
                f"flex_{foot}": 0.0,
                f"flex_{stance}": 0.0,
            },
            hit + strike,
            back,
        )
        score.pitch_moves.setdefault(foot, []).extend(
            [(hit - 0.05 * beat, strike, -0.55 - 0.35 * height), (hit + strike, back, 0.55 + 0.35 * height)]
        )
        t = hit + strike + back + (0.08 * beat if k + 1 < content.count else 0.0)
    down = 0.50 * beat * style.landing
    score.holds[foot] = [(lifted, 0.45 * shift + 0.2 * beat, t - 0.10 * beat, down, 0.0, 0.84)]
    pitch = score.pitch_moves[foot]
    pitch.append((lifted - 0.1 * beat, 0.45 * shift + 0.2 * beat, 0.30))
    pitch.append((t - 0.10 * beat, 0.9 * down, -0.30))
    for side in "LR":
        score.move(f"abd_{side}", start, shift, 0.38 * style.amplitude)
        score.move(f"elbow_{side}", start, shift, 0.30)
        score.move(f"abd_{side}", t - 0.1 * beat, 0.6 * beat, -0.38 * style.amplitude)
        score.move(f"elbow_{side}", t - 0.1 * beat, 0.6 * beat, -0.30)
    recovered = t + down
    score.heights += [(t, score.stand - 0.035 * leg, 0.0, 0.0), (recovered + 0.1 * beat, score.stand, 0.0, 0.0)]
    score.pose({"shift_x": 0.0, "side": 0.0, "pelvis_roll": 0.0}, t + 0.45 * down, 0.9 * down)
    score.end = recovered + 0.5 * down + content.after * beat


def idle(score: Score) -> None:
    """Stand about for some seconds: breathe, shift the weight, look around, move the arms a little."""
    content, style, beat = score.content, score.style, score.second
    score.stand_still()
    events = 6
    spacing = [0.75 * beat * factor for factor in score.vary_even(events)]
    draws = content.draws[32:]
    half = score.body.hip_half_width
    t = content.before * beat
    leaning = 0.0
    for k in range(events):
        onset, duration = t + 0.1 * beat, (0.75 + 0.2 * abs(float(draws[k]))) * beat
        way = content.side * (1.0 if k % 2 == 0 else -1.0)
        leaning = way * half * (0.30 + 0.12 * abs(float(draws[k + 6]))) * min(style.fidget, 2.0) ** 0.6
        score.pose({"shift_x": leaning}, onset, duration)
        score.pose({"side": -0.05 * style.fidget * way, "pelvis_roll": 0.02 * style.fidget * way}, onset, duration)
        score.pose(
            {"head_yaw": 0.22 * style.head_motion * float(np.tanh(draws[k + 12]))}, onset + 0.1 * beat, 0.6 * duration
        )
        score.pose({"head_pitch": 0.06 * style.head_motion * float(np.tanh(draws[k + 18]))}, onset, 0.7 * duration)
        arm = "LR"[k % 2]
        score.pose({f"flex_{arm}": 0.10 * style.fidget * float(np.tanh(draws[k + 24]))}, onset, duration)
        score.pose({f"elbow_{arm}": 0.09 * style.fidget * (1.0 + float(np.tanh(draws[k])))}, onset, duration)
        score.pose({"twist": 0.05 * style.fidget * float(np.tanh(draws[k + 20]))}, onset, duration)
        t += spacing[k]
    breath = 2.0 * np.pi * 0.3 / beat
    score.wave("bend", lambda t: 0.012 * style.fidget**0.5 * (1.0 - np.cos(breath * np.maximum(t, 0.0))))
    score.pose(dict.fromkeys(list(score.moves), 0.0), t + 0.2 * beat, 0.9 * beat)
    score.end = t + 1.1 * beat + content.after * beat
