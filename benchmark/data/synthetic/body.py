"""Bodies by age: stature and proportions from anthropometry, on a 25-joint skeleton.

Adult segment lengths are the fractions of stature of Drillis and Contini (1966), as tabulated by Winter (Biomechanics and
Motor Control of Human Movement). A five-year-old's differ as growth references say: the head is larger (about 5.7 head heights
to the stature, against 7.7), the legs are shorter (sitting height is about 55 % of stature, against 52 %), so are the
arms. Ages between are interpolated. Statures of children follow the medians of growth charts, 1.09 m at five and 1.33 m at
nine. The fractions for children are rounded and meant to have the right direction and size, not to replace a growth chart.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from benchmark.errors import DataError
from benchmark.motion.skeleton import SIDES, EndSite, Skeleton

#: Fractions of stature at five years and for adults. Heights are of a joint above the floor, standing straight.
_PROPORTIONS: dict[str, tuple[float, float]] = {
    "head": (0.176, 0.130),
    "hip_height": (0.487, 0.530),
    "knee_height": (0.262, 0.285),
    "ankle_height": (0.041, 0.039),
    "shoulder_height": (0.782, 0.818),
    "shoulder_half_width": (0.112, 0.113),
    "hip_half_width": (0.053, 0.050),
    "upper_arm": (0.170, 0.186),
    "forearm": (0.132, 0.146),
    "hand": (0.102, 0.108),
    "foot": (0.156, 0.152),
}

_ADULT_AGE = 18.0

NAMES: tuple[str, ...] = (
    "Hips",
    "Spine",
    "Spine1",
    "Spine2",
    "Spine3",
    "Neck",
    "Head",
    *(f"{side}{part}" for side in ("Left", "Right") for part in ("Shoulder", "Arm", "ForeArm", "Hand", "HandMiddle1")),
    *(f"{side}{part}" for side in ("Left", "Right") for part in ("UpLeg", "Leg", "Foot", "ToeBase")),
)

PARENTS: tuple[int, ...] = (-1, 0, 1, 2, 3, 4, 5, 4, 7, 8, 9, 10, 4, 12, 13, 14, 15, 0, 17, 18, 19, 0, 21, 22, 23)

_ROLES: dict[str, str] = {
    "hips": "Hips",
    "spine": "Spine",
    "chest": "Spine3",
    "neck": "Neck",
    "head": "Head",
    **{
        f"{side}_{role}": f"{side.capitalize()}{joint}"
        for side in SIDES
        for role, joint in {
            "clavicle": "Shoulder",
            "shoulder": "Arm",
            "elbow": "ForeArm",
            "wrist": "Hand",
            "hand": "HandMiddle1",
            "hip": "UpLeg",
            "knee": "Leg",
            "ankle": "Foot",
            "toe": "ToeBase",
        }.items()
    },
}

ROLES: dict[str, int] = {role: NAMES.index(joint) for role, joint in _ROLES.items()}


def proportions(age: float) -> dict[str, float]:
    """Segment lengths and joint heights at ``age`` in years, as fractions of stature.

    Between five and eighteen years the values go linearly from a child's to an adult's and stay there on either side.
    """
    growth = float(np.clip((age - 5.0) / (_ADULT_AGE - 5.0), 0.0, 1.0))
    return {name: child + growth * (adult - child) for name, (child, adult) in _PROPORTIONS.items()}


def child_stature(age: float) -> float:
    """Median stature in metres of a child of ``age`` years, for 5 to 9 years."""
    return 1.09 + 0.06 * (age - 5.0)


@dataclass(frozen=True)
class Anatomy:
    """Who an actor is, bodily.

    ``build`` scales the three groups of lengths (trunk and head, arms, legs) by factors near 1 before the whole is brought to
    ``stature``; ``age`` is in years, ``stature`` in metres.
    """

    age: float
    stature: float
    build: tuple[float, float, float] = (1.0, 1.0, 1.0)

    @cached_property
    def skeleton(self) -> Skeleton:
        """The actor's skeleton in T-pose: arms along the x axis, legs straight down, toes to +Z."""
        return _skeleton(self)


def draw_anatomy(style: str, index: int, count: int, rng: np.random.Generator) -> Anatomy:
    """The body of actor ``index`` of ``count`` in ``style`` (``adult`` or ``child``).

    Actors are spread evenly over ages 5-9 and statures 1.05-1.35 m (children) or statures 1.52-1.85 m (adults) with
    individual variation, so that even a small cast covers the range.
    """
    place = (index + rng.uniform(0.15, 0.85)) / count
    build = tuple(float(x) for x in np.exp(0.015 * np.clip(rng.standard_normal(3), -2.0, 2.0)))
    if style == "child":
        age = 5.0 + 4.0 * place
        stature = float(np.clip(child_stature(age) * np.exp(0.02 * rng.standard_normal()), 1.05, 1.35))
        return Anatomy(age, stature, build)  # type: ignore[arg-type]
    # Neighbouring numbers should not be neighbouring sizes: the golden ratio scatters them evenly.
    scattered = (0.5 + index * 0.6180339887498949 + 0.1 * (rng.uniform() - 0.5)) % 1.0
    return Anatomy(float(rng.uniform(19.0, 45.0)), 1.52 + 0.33 * scattered, build)  # type: ignore[arg-type]


def _skeleton(anatomy: Anatomy) -> Skeleton:
    part = proportions(anatomy.age)
    trunk, arm, leg = anatomy.build
    legs = leg * (part["hip_height"] - part["ankle_height"]) + part["ankle_height"]
    upper = trunk * (1.0 - part["hip_height"])
    scale = anatomy.stature / (legs + upper)

    def above_hip(fraction: float) -> float:
        return scale * trunk * (fraction - part["hip_height"])

    hips, shoulder = part["hip_height"] + 0.02, part["shoulder_height"]
    torso = shoulder - hips
    levels = {
        "Hips": hips,
        "Spine": hips + 0.10 * torso,
        "Spine1": hips + 0.32 * torso,
        "Spine2": hips + 0.54 * torso,
        "Spine3": hips + 0.76 * torso,
        "Neck": shoulder + 0.012,
        "Head": 1.0 - 0.94 * part["head"],
    }
    height = {name: above_hip(level) for name, level in levels.items()}
    offsets = np.zeros((len(NAMES), 3))

    def place(name: str, x: float, y: float, z: float) -> None:
        offsets[NAMES.index(name)] = (x, y, z)

    thigh = scale * leg * (part["hip_height"] - part["knee_height"])
    shank = scale * leg * (part["knee_height"] - part["ankle_height"])
    ankle = scale * part["ankle_height"]
    foot = scale * part["foot"]
    place("Hips", 0.0, ankle + shank + thigh + height["Hips"], 0.0)
    for below, name in zip(("Hips", "Spine", "Spine1", "Spine2"), ("Spine", "Spine1", "Spine2", "Spine3"), strict=True):
        place(name, 0.0, height[name] - height[below], 0.0)
    place("Neck", 0.0, height["Neck"] - height["Spine3"], 0.0)
    place("Head", 0.0, height["Head"] - height["Neck"], 0.01 * scale)
    ends = [EndSite(NAMES.index("Head"), (0.0, above_hip(1.0) - height["Head"], 0.0))]
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        shoulder_y = above_hip(shoulder) - height["Spine3"]
        clavicle = 0.02 * scale
        place(f"{side}Shoulder", sign * clavicle, shoulder_y, 0.0)
        place(f"{side}Arm", sign * (scale * part["shoulder_half_width"] - clavicle), 0.0, 0.0)
        place(f"{side}ForeArm", sign * scale * arm * part["upper_arm"], 0.0, 0.0)
        place(f"{side}Hand", sign * scale * arm * part["forearm"], 0.0, 0.0)
        hand = scale * arm * part["hand"]
        place(f"{side}HandMiddle1", sign * 0.48 * hand, 0.0, 0.0)
        ends.append(EndSite(NAMES.index(f"{side}HandMiddle1"), (sign * 0.52 * hand, 0.0, 0.0)))
        place(f"{side}UpLeg", sign * scale * part["hip_half_width"], -height["Hips"], 0.0)
        place(f"{side}Leg", 0.0, -thigh, 0.0)
        place(f"{side}Foot", 0.0, -shank, 0.0)
        place(f"{side}ToeBase", 0.0, -0.62 * ankle, 0.50 * foot)
        ends.append(EndSite(NAMES.index(f"{side}ToeBase"), (0.0, -0.38 * ankle, 0.26 * foot)))
    return Skeleton(NAMES, np.array(PARENTS), offsets, tuple(ends), ("ZXY",) * len(NAMES), ROLES)


@dataclass(frozen=True, eq=False)
class Body:
    """The measures of a skeleton that a performance needs.

    Parameters
    ----------
    skeleton
        A skeleton with the joints of this data set, of any lengths.

    Raises
    ------
    DataError
        If its joints are others.
    """

    skeleton: Skeleton

    def __post_init__(self) -> None:
        if self.skeleton.names != NAMES or tuple(int(p) for p in self.skeleton.parents) != PARENTS:
            raise DataError(
                "synthetic motions are performed on the 25 joints of the synthetic data set (Hips … RightToeBase), not on "
                f"a skeleton of {len(self.skeleton)} joints ({', '.join(self.skeleton.names[:4])} …); retarget the result"
            )

    def offset(self, role: str) -> np.ndarray:
        """(3,) rest offset of the joint in ``role``."""
        return self.skeleton.offsets[ROLES[role]]

    @cached_property
    def thigh(self) -> float:
        """Hip to knee, metres."""
        return float(-self.offset("left_knee")[1])

    @cached_property
    def shank(self) -> float:
        """Knee to ankle, metres."""
        return float(-self.offset("left_ankle")[1])

    @property
    def leg(self) -> float:
        """Hip to ankle, metres."""
        return self.thigh + self.shank

    @cached_property
    def ankle_height(self) -> float:
        """Ankle above the floor when the foot is flat, metres."""
        return float(-self.offset("left_toe")[1] / 0.62)

    @cached_property
    def ball(self) -> np.ndarray:
        """(3,) the toe joint seen from the ankle: the foot rolls over it."""
        return np.array([0.0, self.offset("left_toe")[1], self.offset("left_toe")[2]])

    @cached_property
    def heel(self) -> np.ndarray:
        """(3,) where the heel touches the floor, seen from the ankle."""
        return np.array([0.0, -self.ankle_height, -0.42 * self.offset("left_toe")[2]])

    @cached_property
    def hip_half_width(self) -> float:
        """Half the distance between the hip joints, metres."""
        return float(self.offset("left_hip")[0])

    @cached_property
    def hips_above_hip(self) -> float:
        """Height of the root above the hip joints at rest, metres."""
        return float(-self.offset("left_hip")[1])
