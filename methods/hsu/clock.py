"""A model of the target style's clock: how fast it runs, read off the source's motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from methods.hsu.align import Record
from methods.hsu.joints import JointIdentification
from methods.hsu.lti import StateSpace
from methods.hsu.timing import cues, rate_of

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ClockModel:
    """Mean log rate, how its cues are standardised, and their response.

    Attributes
    ----------
    mean
        Log rate at which the clock runs on average.
    cue_mean, cue_std
        (K,) of the cues of :func:`methods.hsu.timing.cues` in the training sources.
    model
        From the standardised cues to the log rate above its mean.
    """

    mean: float
    cue_mean: Array
    cue_std: Array
    model: StateSpace

    @classmethod
    def fit(cls, records: Sequence[Record], identification: JointIdentification) -> tuple[Self, dict[str, Any]]:
        """Learn from what the time warps of all records say; also facts of how it was identified."""
        fps = identification.fps
        given = [cues(record.pair.source.values, fps) for record in records]
        rates = [rate_of(record.position, len(record.pair.source.values), fps)[:, None] for record in records]
        frames = np.concatenate(given)
        mean, std = frames.mean(axis=0), np.maximum(frames.std(axis=0), 1e-6)
        level = float(np.concatenate(rates).mean())
        model, facts = identification([(cue - mean) / std for cue in given], [rate - level for rate in rates])
        return cls(level, mean, std, model), facts

    def predict(self, values: Array, fps: float) -> Array:
        """(T,) log rate for standardised channels (T, J, 3)."""
        return self.mean + self.model.simulate((cues(values, fps) - self.cue_mean) / self.cue_std)[:, 0]
