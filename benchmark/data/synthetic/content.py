"""What is performed, apart from by whom and how: the part of a clip that adult and child share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

#: The 21 actions of Adult2child 2020, section 3, by kind.
KINDS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "discrete": (
            "throw-a-ball-with-left-arm",
            "throw-a-ball-with-right-arm",
            "punch",
            "kick",
            "jump-with-one-leg",
            "jump-with-the-other-leg",
            "idle",
            "broad-jump-forward",
            "jump-as-high-as-you-can-in-place",
            "jump",
            "5-jumping-jacks",
        ),
        "cyclic": (
            "walk",
            "walk-as-fast-as-you-can",
            "hop-scotch",
            "sneaky-walk",
            "happy-walk",
            "jog",
            "run-as-fast-as-you-can",
            "skip",
        ),
        "combination": ("run-and-jump", "walk-step-over-obstacle"),
    }
)

ACTIONS: tuple[str, ...] = tuple(action for actions in KINDS.values() for action in actions)

_DRAWS = 64

#: How often something is repeated, lowest and highest: steps before the turn, hops, blows.
_COUNTS: dict[str, tuple[int, int]] = {
    "punch": (1, 3),
    "kick": (1, 2),
    "jump-with-one-leg": (3, 5),
    "jump-with-the-other-leg": (3, 5),
    "jump": (1, 2),
    "5-jumping-jacks": (5, 5),
    "walk": (3, 4),
    "walk-as-fast-as-you-can": (3, 5),
    "hop-scotch": (2, 2),
    "sneaky-walk": (2, 3),
    "happy-walk": (3, 4),
    "jog": (4, 5),
    "run-as-fast-as-you-can": (4, 5),
    "skip": (2, 3),
    "run-and-jump": (4, 5),
    "walk-step-over-obstacle": (3, 4),
}


@dataclass(frozen=True, eq=False)
class Content:
    """The content of one clip.

    Nothing in here is in metres and nothing but the T-pose is in seconds of the clip: performing it turns nominal lengths and
    durations into actual ones by the body and the style.

    Attributes
    ----------
    action
        One of :data:`ACTIONS`.
    count
        Repetitions: steps before the turn, hops, blows.
    side
        +1 or -1: which foot goes first, and the way of the turn (+1: left).
    effort
        How far or hard it is meant, near 1.
    facing
        Direction in the capture volume at the start, radians about +Y.
    before, after
        Nominal seconds of standing before and after the action.
    tpose, blend
        Seconds of T-pose, and of the way from it into standing.
    draws
        Standard normal numbers. A style scales them by its variability, so both styles stray in the same direction at the
        same moment.
    """

    action: str
    count: int
    side: int
    effort: float
    facing: float
    before: float
    after: float
    tpose: float
    blend: float
    draws: NDArray[np.float64]

    @property
    def kind(self) -> str:
        """``discrete``, ``cyclic`` or ``combination``."""
        return next(kind for kind, actions in KINDS.items() if self.action in actions)


def draw_content(action: str, rng: np.random.Generator) -> Content:
    """One take's content of ``action``."""
    low, high = _COUNTS.get(action, (1, 1))
    return Content(
        action=action,
        count=int(rng.integers(low, high + 1)),
        side=1 if rng.uniform() < 0.5 else -1,
        effort=float(np.exp(0.03 * np.clip(rng.standard_normal(), -2.0, 2.0))),
        facing=float(rng.uniform(-0.3, 0.3)),
        before=float(rng.uniform(0.15, 0.4)),
        after=float(rng.uniform(0.3, 0.6)),
        tpose=float(rng.uniform(0.3, 1.0)),
        blend=float(rng.uniform(0.6, 0.9)),
        draws=np.clip(rng.standard_normal(_DRAWS), -2.5, 2.5),
    )
