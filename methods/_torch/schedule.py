"""Learning-rate schedules: factors on the initial rate as functions of the epochs done, fractions included."""

from __future__ import annotations

import math
from collections.abc import Callable

Schedule = Callable[[float], float]


def constant() -> Schedule:
    """Always 1."""
    return lambda epoch: 1.0


def linear_decay(*, start: float, length: float, floor: float = 0.0) -> Schedule:
    """1 until epoch ``start``, then down in a straight line to ``floor`` over ``length`` epochs.

    A loss of 1 % of the initial rate per epoch is ``linear_decay(start=0, length=100)``; the schedule of Zhu et al. 2017 for
    CycleGANs is ``linear_decay(start=100, length=100)``.
    """
    return lambda epoch: 1.0 - (1.0 - floor) * min(max((epoch - start) / length, 0.0), 1.0)


def cosine(*, epochs: float, warmup: float = 0.0, floor: float = 0.0) -> Schedule:
    """Up from 0 over ``warmup`` epochs, then down to ``floor`` along half a cosine until epoch ``epochs``."""

    def factor(epoch: float) -> float:
        if epoch < warmup:
            return epoch / warmup
        done = min((epoch - warmup) / max(epochs - warmup, 1e-9), 1.0)
        return floor + (1.0 - floor) * 0.5 * (1.0 + math.cos(math.pi * done))

    return factor


def stepwise(schedule: Schedule) -> Schedule:
    """``schedule`` held over each epoch, at its value at the epoch's start."""
    return lambda epoch: schedule(math.floor(epoch))
