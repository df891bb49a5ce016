"""From records to the model of one joint: what is chosen, on which records, and what is worth keeping of it."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from methods.hsu.lti import Identification, StateSpace, identify

Array = NDArray[np.float64]

#: Independent numbers for each free parameter of a model whose order is chosen, and how many a second of a channel holds: most
#: of human motion lies below 5 Hz, and recording it at 60 frames a second says no more of it.
PER_PARAMETER, PER_SECOND = 10, 10


@dataclass(frozen=True)
class JointIdentification:
    """How joints are identified; see :class:`methods.hsu.method.Hsu` for what each setting means.

    Attributes
    ----------
    fps
        Frames per second of the records.
    """

    method: str
    order: int | str
    max_order: int
    ridge: float | None
    refine: bool
    choice_frames: int
    fps: float

    def __call__(self, inputs: Sequence[Array], outputs: Sequence[Array]) -> tuple[StateSpace, dict[str, Any]]:
        """One joint's model from records of inputs (T, m) and outputs (T, p), and facts for JSON of how it was found.

        What is to be chosen is chosen on some of the records where there are many, and then fitted to all.
        """
        some = spread_out(inputs, self.choice_frames)
        chosen, warned = self._identified(
            [inputs[k] for k in some], [outputs[k] for k in some], self.order, self.method
        )
        found = chosen
        if len(some) < len(inputs) and not chosen.refined:
            kind = "kernel-fir" if chosen.method == "kernel-fir" else "subspace"
            found, warned = self._identified(inputs, outputs, chosen.order, kind)
        return found.model, {
            "method": found.method,
            "order": found.order,
            "held_out_error": _number(chosen.held_out_error),
            "train_error": _number(found.train_error),
            "spectral_radius_found": _number(found.spectral_radius_found),
            "stabilised": found.stabilised,
            "rank": found.rank,
            "rank_needed": found.rank_needed,
            "refined": found.refined,
            "warnings": warned,
        }

    def _identified(
        self, inputs: Sequence[Array], outputs: Sequence[Array], order: int | str, method: str
    ) -> tuple[Identification, list[str]]:
        """The identification, and the warnings it gave: they belong into the facts of 25 joints, not on the screen."""
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            found = identify(
                list(inputs),
                list(outputs),
                order,
                method=method,
                ridge=self.ridge,
                refine=self.refine,
                max_order=supported_order(inputs, outputs, self.max_order, self.fps),
                fps=self.fps,
            )
        return found, sorted({str(warning.message) for warning in caught})


def supported_order(inputs: Sequence[Array], outputs: Sequence[Array], cap: int, fps: float) -> int:
    """The highest order, up to ``cap``, whose ``n (m + l) + l m`` free parameters the recorded outputs can settle."""
    m, p = inputs[0].shape[1], outputs[0].shape[1]
    seconds = sum(len(record) for record in outputs) / fps
    parameters = PER_SECOND * p * seconds / PER_PARAMETER
    return int(np.clip((parameters - p * m) // (m + p), 0, cap))


def spread_out(records: Sequence[Array], frames: int) -> list[int]:
    """Indices of records, evenly spread, that have about so many frames; of all where there are no more."""
    total = sum(len(record) for record in records)
    if frames == 0 or total <= frames:
        return list(range(len(records)))
    count = max(5, round(len(records) * frames / total))
    return sorted(set(np.linspace(0, len(records) - 1, min(count, len(records))).round().astype(int).tolist()))


def _number(value: float) -> float | None:
    """``value`` for JSON, which has no not-a-number."""
    return float(value) if np.isfinite(value) else None
