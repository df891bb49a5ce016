"""Pairs of takes of the same action, best aligned first.

All pairs are compared at a coarse frame rate by plain dynamic time warping, which is cheap; only those that are kept go
through iterative motion warping.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Frame rate of the comparison that ranks all pairs.
COARSE_FPS = 10.0


@dataclass(frozen=True, eq=False)
class Take:
    """One training clip: its id, its action, and its standardised channels (T, J, 3)."""

    clip_id: str
    action: str
    values: Array


@dataclass(frozen=True, eq=False)
class Pair:
    """Two takes of one action and how well they align.

    Attributes
    ----------
    source, target
        The takes.
    distance
        Mean squared difference per channel along the coarse alignment.
    """

    source: Take
    target: Take
    distance: float


def rank(
    sources: Sequence[Take],
    targets: Sequence[Take],
    fps: float,
    report: Callable[[float], None] = lambda fraction: None,
) -> list[Pair]:
    """Every pair of a source and a target take of the same action, best aligned first; ties by the two ids."""
    from benchmark.motion.dtw import dtw

    every = max(1, round(fps / COARSE_FPS))
    coarse = {
        take.clip_id: take.values[::every].reshape(len(take.values[::every]), -1) for take in (*sources, *targets)
    }
    couples = [(source, target) for source in sources for target in targets if source.action == target.action]
    pairs = []
    for index, (source, target) in enumerate(couples):
        one = coarse[source.clip_id]
        distance = dtw(one, coarse[target.clip_id]).mean_cost / one.shape[1]
        pairs.append(Pair(source, target, distance))
        report((index + 1) / len(couples))
    return sorted(pairs, key=lambda pair: (pair.distance, pair.source.clip_id, pair.target.clip_id))


def keep(pairs: Sequence[Pair], *, partners: int, per_action: int) -> list[Pair]:
    """The pairs to learn from, in the order given.

    Parameters
    ----------
    pairs
        Best first.
    partners
        How many target takes each source take is paired with, its best; 0 for all.
    per_action
        How many pairs each action has in the end, its best; 0 for all.
    """
    by_source: dict[str, int] = {}
    by_action: dict[str, int] = {}
    kept = []
    for pair in pairs:
        source, action = pair.source.clip_id, pair.source.action
        if (partners and by_source.get(source, 0) >= partners) or (
            per_action and by_action.get(action, 0) >= per_action
        ):
            continue
        by_source[source] = by_source.get(source, 0) + 1
        by_action[action] = by_action.get(action, 0) + 1
        kept.append(pair)
    return kept
