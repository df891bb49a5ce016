"""From a score to joint rotations: hips on their path, feet on their plants, legs between them by inverse kinematics.

The feet lead. A planted foot does not move; it rolls over the heel on landing and over the ball on leaving. The legs
follow by the analytic solution of the two-bone chain, whose knee bends forward by construction.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from benchmark.data.synthetic.body import NAMES, Body
from benchmark.data.synthetic.curves import bump, hop_arc, quintic, smoothstep, soft_polyline, submovements
from benchmark.data.synthetic.score import CHANNELS, REACH, Plant, Score
from benchmark.motion import quat
from benchmark.motion.clip import ClipMeta, MotionClip

Array = NDArray[np.float64]

#: Frames per second of a capture.
CAPTURE_FPS = 120.0

_X, _Y, _Z = np.eye(3)
_INDEX = {name: i for i, name in enumerate(NAMES)}
_SIDES = (("L", "Left", 1.0), ("R", "Right", -1.0))

#: Seconds in which a foot that leaves the floor with the body gains the body's speed.
_FOOT_RAMP = 0.07
#: Seconds after leaving and before landing in which the reach of a swinging leg is softened.
_LEG_RAMP = 0.09


def _rx(angle: Array) -> Array:
    return quat.from_axis_angle(_X, angle)


def _ry(angle: Array) -> Array:
    return quat.from_axis_angle(_Y, angle)


def _rz(angle: Array) -> Array:
    return quat.from_axis_angle(_Z, angle)


def _euler_yxz(yaw: Array, pitch: Array, roll: Array) -> Array:
    """(T, 4) rotation by ``roll`` about Z, then ``pitch`` about X, then ``yaw`` about Y."""
    return quat.mul(quat.mul(_ry(yaw), _rx(pitch)), _rz(roll))


def perform(score: Score, *, fps: float = CAPTURE_FPS, tpose: bool = True, meta: ClipMeta | None = None) -> MotionClip:
    """The motion of a score, without capture noise.

    Parameters
    ----------
    score
        What to do, by whom and how.
    fps
        Frames per second; the motion itself does not depend on it.
    tpose
        Whether to begin with the T-pose and the way out of it.
    meta
        Carried by the clip.

    Returns
    -------
    MotionClip
        On the score's skeleton.
    """
    content = score.content
    prefix = content.tpose + content.blend if tpose else 0.0
    frames = round((prefix + score.end) * fps) + 1
    t = np.arange(frames) / fps - prefix
    out_of_t = smoothstep((t + content.blend) / content.blend) if tpose else np.ones(frames)
    channels = _channels(score, t, out_of_t)
    rotations = quat.identity(frames, len(NAMES))
    root, yaw = _root(score, t, channels)
    pelvis = _euler_yxz(yaw, channels["pelvis_pitch"], channels["pelvis_roll"])
    rotations[:, 0] = pelvis
    feet = {side: _foot(score, side, t, root, yaw, pelvis) for side in "LR"}
    root[:, 1] -= _shortfall(score, root, pelvis, feet)
    for side, name, sign in _SIDES:
        _leg(score.body, rotations, name, sign, root, pelvis, yaw, feet[side])
    _trunk(rotations, channels)
    for side, name, sign in _SIDES:
        _arm(rotations, name, sign, side, channels, out_of_t)
    turn = quat.from_axis_angle(_Y, np.array(content.facing))
    rotations[:, 0] = quat.mul(turn, rotations[:, 0])
    return MotionClip(score.body.skeleton, quat.unroll(rotations), quat.rotate(turn, root), fps, meta or ClipMeta())


def _channels(score: Score, t: Array, out_of_t: Array) -> dict[str, Array]:
    style = score.style
    rest = {"bend": style.spine_bend, "head_pitch": -0.5 * style.spine_bend}
    for side in "LR":
        rest |= {
            f"abd_{side}": 0.06 + style.arm_spread,
            f"flex_{side}": 0.04,
            f"elbow_{side}": 0.22 + style.elbow_bend,
            f"wrist_{side}": 0.08,
        }
    channels = {name: submovements(t, rest.get(name, 0.0), score.moves.get(name, [])) for name in CHANNELS}
    for name, shape in score.waves:
        channels[name] = channels[name] + shape(t)
    tpose = {"abd_L": 0.5 * np.pi, "abd_R": 0.5 * np.pi}
    for name in CHANNELS:
        start = tpose.get(name, 0.0)
        channels[name] = start + (channels[name] - start) * out_of_t
    return channels


def _root(score: Score, t: Array, channels: dict[str, Array]) -> tuple[Array, Array]:
    knots = np.array(score.path)
    if len(knots) == 1:
        x, z, heading = (np.full(len(t), value) for value in knots[0, 1:])
    else:
        x, z, heading = soft_polyline(t, knots[:, 0], knots[:, 1:], score.path_width).T
    sin, cos = np.sin(heading), np.cos(heading)
    shift_x, shift_z = channels["shift_x"], channels["shift_z"]
    height = quintic(t, score.heights) if len(score.heights) > 1 else np.full(len(t), score.stand)
    root = np.stack(
        [
            x + cos * shift_x + sin * shift_z,
            height + score.body.hips_above_hip,
            z - sin * shift_x + cos * shift_z,
        ],
        axis=-1,
    )
    return root, heading + channels["pelvis_yaw"]


@dataclass
class _Foot:
    """One foot over time.

    Attributes
    ----------
    ankle
        (T, 3) where the ankle should be.
    yaw, pitch, toe
        (T,) direction and pitch of the foot, bend of the toes.
    planted
        (T,) whether it stands.
    airborne
        (T,) from 0 where it stands to 1 within a swing.
    """

    ankle: Array
    yaw: Array
    pitch: Array
    toe: Array
    planted: NDArray[np.bool_]
    airborne: Array


def _foot(score: Score, side: str, t: Array, root: Array, heading: Array, pelvis: Array) -> _Foot:
    body, plants = score.body, score.feet[side]
    first = plants[0]
    base: tuple[list[tuple[float, float, float]], ...] = ([], [], [])
    pitch_moves = list(score.pitch_moves.get(side, []))
    toe_moves: list[tuple[float, float, float]] = []
    heel_moves: list[tuple[float, float, float]] = []
    lift = np.zeros(len(t))
    held: list[tuple[float, float, float, float, float, float]] = list(score.holds.get(side, []))
    planted = np.ones(len(t), dtype=bool)
    airborne = np.zeros(len(t))
    for before, plant in pairwise(plants):
        start, end = before.off, plant.on
        swing = end - start
        for moves, change in zip(base, (plant.x - before.x, plant.z - before.z, plant.yaw - before.yaw), strict=True):
            moves.append((start, swing, change))
        u = (t - start) / swing
        lift += plant.lift * bump(u, plant.skew)
        if plant.rise:
            lift += plant.rise * hop_arc(t, start, end, _FOOT_RAMP)
        if plant.hold is not None:
            held.append((start, 0.45 * swing, end - 0.45 * swing, 0.45 * swing, *plant.hold))
        planted &= (t <= start) | (t >= end)
        ramp = min(_LEG_RAMP, 0.35 * swing)
        airborne += smoothstep((t - start) / ramp) * smoothstep((end - t) / ramp)
        _roll(before, plant, pitch_moves, toe_moves, heel_moves)
    x, z, yaw = (
        submovements(t, value, moves) for value, moves in zip((first.x, first.z, first.yaw), base, strict=True)
    )
    pitch = submovements(t, 0.0, pitch_moves)
    toe = submovements(t, 0.0, toe_moves)
    on_heel = submovements(t, 0.0, heel_moves)
    pivot = body.ball + on_heel[:, None] * (body.heel - body.ball)
    turn = _ry(yaw)
    ankle = np.stack([x, body.ankle_height + lift, z], axis=-1)
    ankle += quat.rotate(turn, pivot - quat.rotate(_rx(pitch), pivot))
    if held or side in score.free:
        ankle, free = _held(score, side, t, ankle, root, heading, pelvis, held)
        planted &= free == 0.0
        airborne = np.maximum(airborne, np.clip(free, 0.0, 1.0))
    return _Foot(ankle, yaw, pitch, toe, planted, airborne)


def _roll(before: Plant, plant: Plant, pitch: list, toe: list, heel: list) -> None:
    """The pitch of the foot while it leaves one plant, swings, and settles on the next."""
    start, end = before.off, plant.on
    swing = end - start
    stance = before.off - before.on if np.isfinite(before.on) else 0.5
    peel = min(before.peel * stance, 0.35)
    after = before.follow * swing
    # The heel goes on rising as the toes leave, so the foot does not stop at the moment of leaving.
    pitch.append((start - peel, peel + after, before.push))
    pitch.append((start + 0.5 * after, swing - 0.5 * after, plant.strike - before.push))
    toe.append((start - peel, peel + after, before.push))
    toe.append((start + 0.12 * swing, 0.6 * swing, -before.push))
    following = plant.off - plant.on
    settle = min(plant.settle, 0.3 * following)
    pitch.append((end, settle, -plant.strike))
    if plant.strike > 0.0:
        toe.append((start + 0.6 * swing, 0.4 * swing, plant.strike))
        toe.append((end, settle, -plant.strike))
    else:
        heel.append((start, swing, 1.0))
        # While the foot is flat the pivot has no effect, so it may change at once.
        heel.append((end + settle, 1e-9, -1.0))


def _held(
    score: Score, side: str, t: Array, ankle: Array, root: Array, heading: Array, pelvis: Array, held: list
) -> tuple[Array, Array]:
    """Blend the ankle to a place beside the hip for a leg that is held up or swung freely."""
    body = score.body
    sign = 1.0 if side == "L" else -1.0
    weight = np.zeros(len(t))
    angle, length = np.zeros(len(t)), np.zeros(len(t))
    for onset, rise, release, fall, theta, rho in held:
        w = smoothstep((t - onset) / rise) - smoothstep((t - release) / fall)
        weight += w
        angle += w * theta
        length += w * rho
    safe = np.where(weight > 1e-9, weight, 1.0)
    angle, length = angle / safe, np.where(weight > 1e-9, length / safe, 1.0)
    spread = np.full(len(t), 0.04)
    if side in score.free:
        angle = angle + submovements(t, 0.0, score.free[side].get("angle", []))
        length = length + submovements(t, 0.0, score.free[side].get("length", []))
        spread = spread + submovements(t, 0.0, score.free[side].get("spread", []))
    reach = length * body.leg
    target = np.stack([sign * np.sin(spread) * reach, -np.cos(angle) * reach, np.sin(angle) * reach], axis=-1)
    hip = root + quat.rotate(pelvis, body.offset("left_hip" if side == "L" else "right_hip"))
    place = hip + quat.rotate(_ry(heading), target)
    return ankle + weight[:, None] * (place - ankle), weight


def _shortfall(score: Score, root: Array, pelvis: Array, feet: dict[str, _Foot]) -> float:
    """By how much the hips must come down, once and for all, so that no planted foot is out of reach."""
    body = score.body
    missing = 0.0
    for side, role in (("L", "left_hip"), ("R", "right_hip")):
        foot = feet[side]
        hip = root + quat.rotate(pelvis, body.offset(role))
        gap = (hip - foot.ankle)[foot.planted]
        across = gap[:, 0] ** 2 + gap[:, 2] ** 2
        room = np.sqrt(np.maximum((REACH * body.leg) ** 2 - across, 0.0))
        if len(gap):
            missing = max(missing, float(np.max(gap[:, 1] - room)))
    return missing


def _leg(
    body: Body, rotations: Array, name: str, sign: float, root: Array, pelvis: Array, yaw: Array, foot: _Foot
) -> None:
    hip = root + quat.rotate(pelvis, body.offset("left_hip" if sign > 0 else "right_hip"))
    facing = 0.5 * (yaw + foot.yaw)
    turn = _ry(facing)
    gap = quat.inv_rotate(turn, foot.ankle - hip)
    distance = np.sqrt(np.sum(gap**2, axis=-1))
    direction = gap / distance[:, None]
    # A swinging foot that is out of reach is approached, so that the knee never snaps straight: a smooth minimum of the
    # distance and a little less than the leg. For a planted foot, which is in reach, it is the distance itself.
    soft = (1e-6 + 0.030 * foot.airborne) * body.leg
    most = (0.9995 - 0.0245 * foot.airborne) * body.leg
    reach = np.maximum(distance - soft * np.logaddexp(0.0, (distance - most) / soft), 0.35 * body.leg)
    a, b = body.thigh, body.shank
    at_hip = np.arccos(np.clip((a * a + reach**2 - b * b) / (2.0 * a * reach), -1.0, 1.0))
    at_knee = np.pi - np.arccos(np.clip((a * a + b * b - reach**2) / (2.0 * a * b), -1.0, 1.0))
    swing = np.unwrap(np.arctan2(-direction[:, 2], -direction[:, 1]))
    thigh = quat.mul(
        quat.mul(turn, _rx(swing)), quat.mul(_rz(np.arcsin(np.clip(direction[:, 0], -1.0, 1.0))), _rx(-at_hip))
    )
    knee = _rx(at_knee)
    rotations[:, _INDEX[f"{name}UpLeg"]] = quat.inv_mul(pelvis, thigh)
    rotations[:, _INDEX[f"{name}Leg"]] = knee
    sole = quat.mul(_ry(foot.yaw), _rx(foot.pitch))
    rotations[:, _INDEX[f"{name}Foot"]] = quat.inv_mul(quat.mul(thigh, knee), sole)
    rotations[:, _INDEX[f"{name}ToeBase"]] = _rx(-foot.toe)


def _trunk(rotations: Array, channels: dict[str, Array]) -> None:
    bend, side, twist = channels["bend"], channels["side"], channels["twist"]
    joint = _euler_yxz(0.25 * twist, 0.25 * bend, 0.25 * side)
    for name in ("Spine", "Spine1", "Spine2", "Spine3"):
        rotations[:, _INDEX[name]] = joint
    # The head keeps most of its orientation whatever the trunk does.
    yaw = channels["head_yaw"] - 0.75 * (twist + channels["pelvis_yaw"])
    pitch = channels["head_pitch"] - 0.6 * (bend + channels["pelvis_pitch"])
    roll = channels["head_roll"] - 0.6 * (side + channels["pelvis_roll"])
    rotations[:, _INDEX["Neck"]] = _euler_yxz(0.4 * yaw, 0.4 * pitch, 0.4 * roll)
    rotations[:, _INDEX["Head"]] = _euler_yxz(0.6 * yaw, 0.6 * pitch, 0.6 * roll)


def _arm(rotations: Array, name: str, sign: float, side: str, channels: dict[str, Array], out_of_t: Array) -> None:
    flex, abd, turn = (channels[f"{part}_{side}"] for part in ("flex", "abd", "turn"))
    # The shoulder girdle gives way when the arm goes up (scapulo-humeral rhythm) and goes along when it reaches forward.
    raised = 0.5 * (1.0 - np.cos(abd) * np.cos(flex))
    forward = np.sin(np.clip(flex, -1.5, 1.5)) * np.cos(abd)
    lift = 0.30 * (raised - 0.5) * (raised > 0.5) * (raised - 0.5) * 2.0
    girdle = _euler_yxz(-sign * 0.15 * forward * out_of_t, np.zeros_like(flex), sign * lift)
    upper = quat.mul(quat.mul(_rx(-flex), _rz(sign * (abd - 0.5 * np.pi))), _rx(-turn))
    rotations[:, _INDEX[f"{name}Shoulder"]] = girdle
    rotations[:, _INDEX[f"{name}Arm"]] = quat.inv_mul(girdle, upper)
    rotations[:, _INDEX[f"{name}ForeArm"]] = _ry(-sign * channels[f"elbow_{side}"])
    rotations[:, _INDEX[f"{name}Hand"]] = _ry(-sign * channels[f"wrist_{side}"])
    rotations[:, _INDEX[f"{name}HandMiddle1"]] = _rz(-sign * 0.25 * out_of_t)


def capture_noise(clip: MotionClip, rng: np.random.Generator) -> MotionClip:
    """The clip as a solved optical capture would give it.

    Each joint gets a slow wander of 0.25 degrees (markers on skin and cloth) and white jitter of 0.03 degrees, the root one
    of 0.5 mm and 0.1 mm; standard deviations per axis.
    """
    frames, joints = clip.rotations.shape[:2]
    angles = np.deg2rad(0.25) * _wander(frames, 3 * joints, clip.fps, rng)
    angles += np.deg2rad(0.03) * rng.standard_normal((frames, 3 * joints))
    root = 0.0005 * _wander(frames, 3, clip.fps, rng) + 0.0001 * rng.standard_normal((frames, 3))
    shake = quat.exp(angles.reshape(frames, joints, 3))
    return clip.replace(rotations=quat.mul(clip.rotations, shake), root=clip.root + root)


def _wander(frames: int, channels: int, fps: float, rng: np.random.Generator) -> Array:
    """(T, C) smooth noise of unit standard deviation with a time scale of a fifth of a second."""
    every = 0.2 * fps
    knots = int(np.ceil((frames - 1) / every)) + 4
    values = rng.standard_normal((knots, channels))
    place = np.arange(frames) / every
    i = place.astype(np.int64)
    u = (place - i)[:, None]
    # Uniform cubic B-spline: smooth to the second derivative.
    weights = ((1 - u) ** 3 / 6, (3 * u**3 - 6 * u**2 + 4) / 6, (-3 * u**3 + 3 * u**2 + 3 * u + 1) / 6, u**3 / 6)
    smooth = sum(w * values[i + k] for k, w in enumerate(weights))
    # The mean square of the weights over a knot interval is 151/315.
    return smooth / np.sqrt(151.0 / 315.0)
