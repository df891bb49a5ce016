"""The frozen skeleton: names, hierarchy, rest offsets and what each joint means.

Nothing downstream knows a joint name or a joint count. It asks for *roles*, which :mod:`benchmark.motion.roles` finds from
the naming conventions of the field or reads from a map.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import SkeletonError, UnknownNameError

SIDES = ("left", "right")

#: Every role. ``hips`` is the pelvis; ``left_hip`` is the thigh's joint; ``left_clavicle`` is the joint between chest and
#: shoulder that many captures lack; ``left_wrist`` is the hand's joint; ``left_hand`` is a point beyond it.
ROLES: tuple[str, ...] = (
    "hips",
    "spine",
    "chest",
    "neck",
    "head",
    *(
        f"{side}_{part}"
        for side in SIDES
        for part in ("clavicle", "shoulder", "elbow", "wrist", "hand", "hip", "knee", "ankle", "toe")
    ),
)

#: The roles without which a figure cannot be oriented, scaled or set on the floor.
CORE_ROLES: tuple[str, ...] = (
    "hips",
    "head",
    *(f"{side}_{part}" for side in SIDES for part in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")),
)


@dataclass(frozen=True)
class EndSite:
    """The tip of a chain: the joint it hangs on and its offset (3,) in metres in that joint's frame."""

    parent: int
    offset: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Skeleton:
    """A joint hierarchy at rest.

    Attributes
    ----------
    names
        J joint names.
    parents
        (J,) parent indices; ``parents[0] == -1`` and ``parents[j] < j``.
    offsets
        (J, 3) offset of each joint in its parent's frame, metres. The first is ignored by kinematics: a clip carries
        the root's position.
    end_sites
        Tips of chains.
    orders
        Per joint, the order in which a file writes its Euler rotations, for example ``"ZXY"``.
    roles
        Role name (see :data:`ROLES`) to joint index.
    """

    names: tuple[str, ...]
    parents: NDArray[np.int64]
    offsets: NDArray[np.float64]
    end_sites: tuple[EndSite, ...] = ()
    orders: tuple[str, ...] = ()
    roles: Mapping[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        joints = len(self.names)
        parents = np.array(self.parents, dtype=np.int64)
        offsets = np.array(self.offsets, dtype=np.float64)
        if joints == 0:
            raise SkeletonError("a skeleton needs at least one joint")
        if len(set(self.names)) != joints:
            twice = next(name for name in self.names if self.names.count(name) > 1)
            raise SkeletonError(f"two joints are named {twice!r}")
        if parents.shape != (joints,) or offsets.shape != (joints, 3):
            raise SkeletonError(
                f"{joints} names need parents of shape ({joints},) and offsets of shape ({joints}, 3), "
                f"not {parents.shape} and {offsets.shape}"
            )
        if parents[0] != -1 or np.any(parents[1:] < 0) or np.any(parents[1:] >= np.arange(1, joints)):
            raise SkeletonError("parents must start with -1 and point to an earlier joint everywhere else")
        if not np.all(np.isfinite(offsets)):
            raise SkeletonError(
                f"offset of joint {self.names[int(np.argwhere(~np.isfinite(offsets))[0, 0])]!r} is not finite"
            )
        orders = tuple(self.orders) or ("ZXY",) * joints
        if len(orders) != joints:
            raise SkeletonError(f"{joints} joints need {joints} rotation orders, not {len(orders)}")
        for name, order in zip(self.names, orders, strict=True):
            if sorted(order) != ["X", "Y", "Z"]:
                raise SkeletonError(
                    f"the rotation order of joint {name!r} must hold X, Y and Z once each, not {order!r}"
                )
        for end in self.end_sites:
            if not 0 <= end.parent < joints:
                raise SkeletonError(f"an end site hangs on joint {end.parent} of {joints}")
            if np.shape(end.offset) != (3,) or not np.all(np.isfinite(end.offset)):
                raise SkeletonError(
                    f"the end site of joint {self.names[end.parent]!r} is not finite or not three numbers: {end.offset}"
                )
        for role, joint in self.roles.items():
            if role not in ROLES:
                raise UnknownNameError("joint role", role, ROLES)
            if not 0 <= joint < joints:
                raise SkeletonError(f"role {role!r} points to joint {joint} of {joints}")
        parents.flags.writeable = offsets.flags.writeable = False
        object.__setattr__(self, "parents", parents)
        object.__setattr__(self, "offsets", offsets)
        object.__setattr__(self, "orders", orders)
        object.__setattr__(self, "names", tuple(self.names))
        object.__setattr__(self, "roles", MappingProxyType(dict(self.roles)))

    def __reduce__(self) -> tuple:
        return _rebuild, (self.names, self.parents, self.offsets, self.end_sites, self.orders, dict(self.roles))

    def __len__(self) -> int:
        return len(self.names)

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, Skeleton)
            and self.same_topology(other)
            and np.array_equal(self.offsets, other.offsets)
            and self.end_sites == other.end_sites
            and self.orders == other.orders
            and dict(self.roles) == dict(other.roles)
        )

    def __hash__(self) -> int:
        return hash((self.names, self.parents.tobytes(), self.offsets.tobytes()))

    def same_topology(self, other: Skeleton) -> bool:
        """Whether both have the same joints in the same tree, whatever their lengths."""
        return self.names == other.names and np.array_equal(self.parents, other.parents)

    def has(self, *roles: str) -> bool:
        """Whether every one of ``roles`` is known."""
        return all(role in self.roles for role in roles)

    def joint(self, role: str) -> int:
        """Joint index of ``role``; a :class:`SkeletonError` says what to add where there is none."""
        if role not in ROLES:
            raise UnknownNameError("joint role", role, ROLES)
        if role not in self.roles:
            raise SkeletonError(
                f"the skeleton has no joint in the role {role!r} (joints: {', '.join(self.names)}); "
                "name it in a role map: [roles] in a TOML file, for example "
                f'{role} = "{self.names[-1]}"'
            )
        return self.roles[role]

    def joints(self, *roles: str) -> list[int]:
        """Joint indices of ``roles``, in that order."""
        return [self.joint(role) for role in roles]

    def children(self, joint: int) -> list[int]:
        """Indices of the direct children of ``joint``."""
        return [int(child) for child in np.flatnonzero(self.parents == joint)]

    def chain(self, start: int, end: int) -> list[int]:
        """Joints from ``start`` down to its descendant ``end``, both included."""
        path = [end]
        while path[-1] != start:
            if path[-1] < 0:
                raise SkeletonError(f"{self.names[end]!r} does not hang below {self.names[start]!r}")
            path.append(int(self.parents[path[-1]]))
        return path[::-1]

    @cached_property
    def bone_lengths(self) -> NDArray[np.float64]:
        """(J,) length of the bone from each joint's parent to it, metres; 0 for the root."""
        lengths = np.linalg.norm(self.offsets, axis=-1)
        lengths[0] = 0.0
        return lengths

    @cached_property
    def leg_length(self) -> float:
        """Hip to ankle along the bones, mean of both sides, metres. Needs the hip, knee and ankle roles."""
        legs = [
            self.bone_lengths[self.chain(self.joint(f"{side}_hip"), self.joint(f"{side}_ankle"))[1:]].sum()
            for side in SIDES
        ]
        return float(np.mean(legs))

    def with_offsets(self, offsets: NDArray[np.float64], end_sites: Sequence[EndSite] | None = None) -> Skeleton:
        """The same joints with other rest offsets (J, 3) in metres."""
        return replace(self, offsets=offsets, end_sites=self.end_sites if end_sites is None else tuple(end_sites))

    def scaled(self, factor: float) -> Skeleton:
        """The same figure, ``factor`` times as large."""
        ends = [EndSite(end.parent, tuple(factor * x for x in end.offset)) for end in self.end_sites]  # type: ignore[arg-type]
        return self.with_offsets(self.offsets * factor, ends)

    def with_roles(self, roles: Mapping[str, int]) -> Skeleton:
        """The same joints with other roles."""
        return replace(self, roles=dict(roles))


def _rebuild(
    names: tuple, parents: NDArray, offsets: NDArray, end_sites: tuple, orders: tuple, roles: dict
) -> Skeleton:
    return Skeleton(names, parents, offsets, end_sites, orders, roles)
