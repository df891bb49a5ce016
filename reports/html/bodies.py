"""The body that the moving pictures draw on a skeleton: tapered limbs, a trunk and a head, from joint roles."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.motion import quat
from benchmark.motion.clip import MotionClip
from benchmark.motion.skeleton import CORE_ROLES, SIDES, Skeleton
from reports.figures.bodies import segments

#: Radius of a limb at a role, in leg lengths: a slim figure, the same for adults and children.
_RADII = {
    "shoulder": 0.078,
    "elbow": 0.056,
    "wrist": 0.042,
    "hand": 0.034,
    "hip": 0.115,
    "knee": 0.078,
    "ankle": 0.054,
    "toe": 0.046,
}
_TIP = 0.030
_BONE = 0.045

_SIDE = {"trunk": 0, "left": 1, "right": 2}


@dataclass(frozen=True)
class Limb:
    """A tapered capsule between two points; ``trunk`` limbs are filled as one shape.

    ``start`` and ``end`` are places in :attr:`Body.points`, radii are in metres.
    """

    start: int
    end: int
    radius_start: float
    radius_end: float
    side: str
    trunk: bool = False


@dataclass(frozen=True)
class Body:
    """What is drawn of a skeleton.

    Attributes
    ----------
    points
        What is drawn, as joints (index) or end sites (-1 - index).
    limbs
        The capsules.
    head
        Two places in ``points`` between which the head lies (the same twice where only its joint is known), and its radius in
        metres; ``None`` for a skeleton without one.
    hips
        The place that the camera follows.
    """

    points: tuple[int, ...]
    limbs: tuple[Limb, ...]
    head: tuple[int, int, float] | None
    hips: int

    def to_json(self) -> dict[str, Any]:
        """The body as the page's script reads it; radii in millimetres."""
        return {
            "points": len(self.points),
            "limbs": [
                [
                    limb.start,
                    limb.end,
                    round(1e3 * limb.radius_start),
                    round(1e3 * limb.radius_end),
                    _SIDE[limb.side],
                    int(limb.trunk),
                ]
                for limb in self.limbs
            ],
            "head": None if self.head is None else [self.head[0], self.head[1], round(1e3 * self.head[2])],
            "hips": self.hips,
        }


class _Points:
    def __init__(self) -> None:
        self.places: dict[int, int] = {}

    def __call__(self, point: int) -> int:
        return self.places.setdefault(point, len(self.places))


def make_body(skeleton: Skeleton) -> Body:
    """The body of a skeleton; bones of one thickness where it lacks the roles that a figure is told by."""
    place = _Points()
    hips = place(skeleton.roles.get("hips", 0))
    if not skeleton.has(*CORE_ROLES):
        radius = _BONE * max(0.1, float(np.abs(skeleton.offsets[1:]).sum(axis=0).max()) / 3.0)
        limbs = [Limb(place(a), place(b), radius, radius, side) for a, b, side in segments(skeleton)]
        return Body(tuple(place.places), tuple(limbs), None, hips)
    leg = skeleton.leg_length
    limbs = _trunk(skeleton, place, leg)
    for side in SIDES:
        for parts in (("shoulder", "elbow", "wrist", "hand"), ("hip", "knee", "ankle", "toe")):
            limbs += _chain(skeleton, place, side, parts, leg)
    head = _head(skeleton, place, leg)
    return Body(tuple(place.places), tuple(limbs), head, hips)


def _trunk(skeleton: Skeleton, place: _Points, leg: float) -> list[Limb]:
    hips, shoulders, thighs = (
        place(skeleton.joint("hips")),
        [place(skeleton.joint(f"{side}_shoulder")) for side in SIDES],
        [place(skeleton.joint(f"{side}_hip")) for side in SIDES],
    )
    top = skeleton.joint(next(role for role in ("neck", "chest", "head") if role in skeleton.roles))
    upper, flank = 0.082 * leg, 0.105 * leg
    limbs = [
        Limb(hips, place(top), 0.135 * leg, 0.085 * leg, "trunk", trunk=True),
        Limb(thighs[0], shoulders[0], flank, upper, "trunk", trunk=True),
        Limb(thighs[1], shoulders[1], flank, upper, "trunk", trunk=True),
        Limb(shoulders[0], shoulders[1], upper, upper, "trunk", trunk=True),
        Limb(thighs[0], thighs[1], flank, flank, "trunk", trunk=True),
    ]
    if top != skeleton.joint("head"):
        limbs.append(Limb(place(top), place(skeleton.joint("head")), 0.062 * leg, 0.058 * leg, "trunk"))
    return limbs


def _chain(skeleton: Skeleton, place: _Points, side: str, parts: tuple[str, ...], leg: float) -> list[Limb]:
    known = [(skeleton.joint(f"{side}_{part}"), _RADII[part] * leg) for part in parts if skeleton.has(f"{side}_{part}")]
    tip = _tip(skeleton, known[-1][0])
    if tip is not None:
        known.append((tip, _TIP * leg))
    return [Limb(place(a), place(b), ra, rb, side) for (a, ra), (b, rb) in pairwise(known) if a != b]


def _tip(skeleton: Skeleton, joint: int) -> int | None:
    """The end site that hangs on a joint, as a point of :class:`Body`."""
    return next((-1 - index for index, end in enumerate(skeleton.end_sites) if end.parent == joint), None)


def _head(skeleton: Skeleton, place: _Points, leg: float) -> tuple[int, int, float]:
    joint = skeleton.joint("head")
    tip = _tip(skeleton, joint)
    if tip is None:
        return place(joint), place(joint), 0.16 * leg
    length = float(np.linalg.norm(skeleton.end_sites[-1 - tip].offset))
    # A head is about four fifths as wide as it is high; a tip that is only a marker says nothing of its size.
    if not 0.12 * leg < length < 0.6 * leg:
        return place(joint), place(joint), 0.16 * leg
    return place(joint), place(tip), 0.42 * length


def body_points(clip: MotionClip, body: Body) -> NDArray[np.float64]:
    """World positions (T, P, 3) in metres of the points of ``body`` in every frame of ``clip``."""
    rotations, positions = clip.world
    columns = []
    for point in body.points:
        if point >= 0:
            columns.append(positions[:, point])
        else:
            end = clip.skeleton.end_sites[-1 - point]
            offset = np.broadcast_to(np.asarray(end.offset), (len(clip), 3))
            columns.append(positions[:, end.parent] + quat.rotate(rotations[:, end.parent], offset))
    return np.stack(columns, axis=1)
