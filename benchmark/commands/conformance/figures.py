"""Two small figures that walk, wave and jump, and a training view of them: enough to find out what a method does.

They are no data set (that is ``synthetic``): a few clips made from sines in milliseconds, an adult and a child of other
proportions, whose feet neither slide nor sink.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmark.motion import quat
from benchmark.motion.canonical import foot_points
from benchmark.motion.clip import ClipMeta, MotionClip
from benchmark.motion.contacts import GRAVITY
from benchmark.motion.skeleton import SIDES, EndSite, Skeleton

FPS = 60.0
ADULT, CHILD = "adult", "child"
#: What the training view holds, and what metrics are tried on: some measure nothing but jumps.
ACTIONS = ("walk", "wave")
MEASURED_ACTIONS = (*ACTIONS, "jump")

_X, _Y, _Z = np.eye(3)


def figure(
    leg: float = 0.8, *, trunk: float = 0.5, head: float = 0.25, arm: float = 0.55, roles: str = "all"
) -> Skeleton:
    """A figure that stands in a T at rest, facing +Z.

    Parameters
    ----------
    leg, trunk, head, arm
        Metres from hip to ankle, hips to neck, neck to the crown, shoulder to wrist.
    roles
        ``all``, or ``core`` for a figure without spine, neck, clavicle, toe and hand joints.
    """
    rich = roles == "all"
    foot = 0.25 * leg
    rows: list[tuple[str, str, tuple[float, float, float]]] = [("hips", "", (0.0, 0.0, 0.0))]
    if rich:
        rows += [("spine", "hips", (0.0, 0.4 * trunk, 0.0)), ("chest", "spine", (0.0, 0.3 * trunk, 0.0))]
        rows += [("neck", "chest", (0.0, 0.3 * trunk, 0.0)), ("head", "neck", (0.0, 0.4 * head, 0.0))]
    else:
        rows += [("head", "hips", (0.0, trunk + 0.4 * head, 0.0))]
    ends = [("head", (0.0, 0.6 * head, 0.0))]
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        if rich:
            rows += [(f"{side}_clavicle", "chest", (sign * 0.04, 0.2 * trunk, 0.0))]
            rows += [(f"{side}_shoulder", f"{side}_clavicle", (sign * 0.3 * trunk, 0.0, 0.0))]
        else:
            rows += [(f"{side}_shoulder", "hips", (sign * 0.35 * trunk, 0.9 * trunk, 0.0))]
        rows += [(f"{side}_elbow", f"{side}_shoulder", (sign * 0.55 * arm, 0.0, 0.0))]
        rows += [(f"{side}_wrist", f"{side}_elbow", (sign * 0.45 * arm, 0.0, 0.0))]
        if rich:
            rows += [(f"{side}_hand", f"{side}_wrist", (sign * 0.12 * arm, 0.0, 0.0))]
        ends += [(f"{side}_hand" if rich else f"{side}_wrist", (sign * 0.1 * arm, 0.0, 0.0))]
        rows += [(f"{side}_hip", "hips", (sign * 0.11 * leg, -0.03, 0.0))]
        rows += [(f"{side}_knee", f"{side}_hip", (0.0, -0.52 * leg, 0.0))]
        rows += [(f"{side}_ankle", f"{side}_knee", (0.0, -0.48 * leg, 0.0))]
        if rich:
            rows += [(f"{side}_toe", f"{side}_ankle", (0.0, -0.3 * foot, 0.7 * foot))]
        ends += [(f"{side}_toe", (0.0, 0.0, 0.3 * foot)) if rich else (f"{side}_ankle", (0.0, -0.3 * foot, 0.7 * foot))]
    names = [name for name, _, _ in rows]
    return Skeleton(
        tuple(names),
        np.array([names.index(parent) if parent else -1 for _, parent, _ in rows]),
        np.array([offset for _, _, offset in rows]),
        tuple(EndSite(names.index(name), offset) for name, offset in ends),
        roles={name: index for index, name in enumerate(names)},
    )


def walk(
    skeleton: Skeleton,
    *,
    seconds: float = 3.0,
    fps: float = FPS,
    tempo: float = 0.9,
    swing: float = 0.4,
    phase: float = 0.0,
    arms: float = 1.35,
) -> MotionClip:
    """Walking with strides of ``tempo`` a second, legs swinging by ``swing`` and arms lowered by ``arms`` radians."""
    frames = round(seconds * fps)
    cycle = 2.0 * np.pi * tempo * np.arange(frames) / fps + phase
    rotations = _at_ease(skeleton, frames, arms)
    for side, shift in zip(SIDES, (0.0, np.pi), strict=True):
        thigh = swing * np.sin(cycle + shift)
        # Bent early in the swing only: a bent knee on a leg that is already ahead would reach further down, not less.
        knee = 3.0 * swing * np.maximum(0.0, np.cos(cycle + shift + 0.4))
        _turn(rotations, skeleton, f"{side}_hip", _X, -thigh)
        _turn(rotations, skeleton, f"{side}_knee", _X, knee)
        _turn(rotations, skeleton, f"{side}_ankle", _X, thigh - knee)
        _turn(rotations, skeleton, f"{side}_shoulder", _X, 0.8 * thigh, before=True)
    _turn(rotations, skeleton, "hips", _Y, 0.1 * swing * np.sin(cycle))
    return _planted(skeleton, rotations, fps, (np.cos(cycle) >= 0.0).astype(int))


def wave(
    skeleton: Skeleton,
    *,
    seconds: float = 3.0,
    fps: float = FPS,
    tempo: float = 1.5,
    swing: float = 0.5,
    phase: float = 0.0,
    arms: float = 1.35,
) -> MotionClip:
    """Standing with the arms lowered by ``arms`` radians, and waving the right one's hand ``tempo`` times a second."""
    frames = round(seconds * fps)
    cycle = 2.0 * np.pi * tempo * np.arange(frames) / fps + phase
    rotations = _at_ease(skeleton, frames, arms)
    _turn(rotations, skeleton, "right_shoulder", _Z, np.full(frames, -1.6), before=True)
    _turn(rotations, skeleton, "right_elbow", _Z, -0.6 + swing * np.sin(cycle))
    _turn(rotations, skeleton, "head", _Y, 0.15 * np.sin(cycle))
    return _planted(skeleton, rotations, fps, np.zeros(frames, dtype=int))


def jump(
    skeleton: Skeleton,
    *,
    seconds: float = 3.0,
    fps: float = FPS,
    tempo: float = 0.9,
    swing: float = 0.4,
    phase: float = 0.0,
    arms: float = 1.35,
) -> MotionClip:
    """One jump in place: a crouch, a flight under gravity and a landing, each quicker for a higher ``tempo``.

    The knees bend by 4 ``swing`` before and by 2.5 ``swing`` after the flight, the arms swing by 2 ``swing`` radians.
    """
    frames = round(seconds * fps)
    t = np.arange(frames) / fps
    start = 0.25 + 0.05 * phase
    crouch, air, landing = 0.5 / tempo, 0.32 / tempo, 0.45 / tempo
    take_off, down = start + crouch, start + crouch + air

    def bump(begin: float, length: float) -> NDArray[np.float64]:
        return 0.5 - 0.5 * np.cos(2.0 * np.pi * np.clip((t - begin) / length, 0.0, 1.0))

    rotations = _at_ease(skeleton, frames, arms)
    knee = 4.0 * swing * bump(start, crouch) + 2.5 * swing * bump(down, landing)
    for side in SIDES:
        _turn(rotations, skeleton, f"{side}_hip", _X, -0.5 * knee)
        _turn(rotations, skeleton, f"{side}_knee", _X, knee)
        _turn(rotations, skeleton, f"{side}_ankle", _X, -0.5 * knee)
        lifted = -2.0 * swing * bump(start + 0.5 * crouch, crouch + air)
        _turn(rotations, skeleton, f"{side}_shoulder", _X, lifted, before=True)
    standing = _planted(skeleton, rotations, fps, np.zeros(frames, dtype=int))
    since = np.clip(t - take_off, 0.0, air)
    height = 0.5 * GRAVITY * since * (air - since)
    return standing.replace(root=standing.root + height[:, None] * _Y)


def perform(action: str, style: str, take: int, *, fps: float = FPS, roles: str = "all") -> MotionClip:
    """A take of a :data:`MEASURED_ACTIONS` by an adult or a child, who is smaller, quicker, and swings and spreads further."""
    child = style == CHILD
    # Takes are by different performers, so that a target skeleton and a reference are never the same body.
    grown = 1.0 + 0.02 * take
    if child:
        body = figure(0.52 * grown, trunk=0.38, head=0.22, arm=0.36, roles=roles)
    else:
        body = figure(0.82 * grown, trunk=0.52, head=0.25, arm=0.58, roles=roles)
    move = {"walk": walk, "wave": wave, "jump": jump}[action]
    clip = move(
        body,
        seconds=2.5 + 0.2 * take,
        fps=fps,
        tempo=(1.15 if child else 0.9) * (1.0 + 0.03 * take),
        swing=0.45 if child else 0.35,
        phase=0.7 * take,
        arms=1.1 if child else 1.35,
    )
    return clip.replace(meta=ClipMeta(f"{style}{take}", style, action, str(take), "conformance"))


@dataclass(frozen=True)
class SmallView:
    """A training view over clips held in memory; see :class:`benchmark.api.TrainView`."""

    held: tuple[MotionClip, ...]
    fps: float = FPS

    @property
    def actions(self) -> tuple[str, ...]:
        """The actions present, sorted."""
        return tuple(sorted({clip.meta.action for clip in self.held}))

    def clips(
        self, style: str | None = None, *, action: str | None = None, actor: str | None = None
    ) -> Sequence[MotionClip]:
        """The clips that match, in their own order."""
        return tuple(
            clip
            for clip in self.held
            if style in (None, clip.meta.style)
            and action in (None, clip.meta.action)
            and actor in (None, clip.meta.actor)
        )

    def pairs(self, source_style: str, target_style: str) -> Iterator[tuple[MotionClip, MotionClip]]:
        """Every pair of takes of the same action."""
        for action in self.actions:
            for source in self.clips(source_style, action=action):
                for target in self.clips(target_style, action=action):
                    yield source, target

    def validation(self, fraction: float = 0.1) -> tuple[SmallView, SmallView]:
        """The view cut in two by clip, the larger part first."""
        held_out = max(1, round(fraction * len(self.held)))
        return replace(self, held=self.held[:-held_out]), replace(self, held=self.held[-held_out:])


def small_view(*, fps: float = FPS, roles: str = "all") -> SmallView:
    """Two takes of each action by adults and by children."""
    return SmallView(
        tuple(
            perform(action, style, take, fps=fps, roles=roles)
            for style in (ADULT, CHILD)
            for action in ACTIONS
            for take in (1, 2)
        ),
        fps,
    )


def _at_ease(skeleton: Skeleton, frames: int, arms: float) -> NDArray[np.float64]:
    rotations = quat.identity(frames, len(skeleton))
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        _turn(rotations, skeleton, f"{side}_shoulder", _Z, np.full(frames, -arms * sign))
    return rotations


def _turn(
    rotations: NDArray, skeleton: Skeleton, role: str, axis: NDArray, angles: NDArray, *, before: bool = False
) -> None:
    joint = skeleton.joint(role)
    turn = quat.from_axis_angle(axis, angles)
    own = rotations[:, joint]
    rotations[:, joint] = quat.normalize(quat.mul(turn, own) if before else quat.mul(own, turn))


def _planted(skeleton: Skeleton, rotations: NDArray[np.float64], fps: float, standing: NDArray[np.int64]) -> MotionClip:
    """Carry the body so that foot ``standing`` (T,; 0 left, 1 right) keeps its place and the lowest one is on the floor."""
    frames = len(rotations)
    still = MotionClip(skeleton, rotations, np.zeros((frames, 3)), fps)
    feet = still.positions[:, skeleton.joints("left_ankle", "right_ankle")]
    now = np.arange(1, frames)
    root = np.zeros((frames, 3))
    root[:, 1] = -foot_points(still)[..., 1].min(axis=1)
    steps = feet[now - 1, standing[1:]] - feet[now, standing[1:]]
    root[1:, [0, 2]] = np.cumsum(steps[:, [0, 2]], axis=0)
    return still.replace(root=root)
