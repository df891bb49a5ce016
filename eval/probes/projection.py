"""Features on the principal axes of the training clips, so that every method is seen along the same ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Most axes kept: the bias of a Fréchet distance grows with their square.
MOST_AXES = 32

#: A spread below this fraction of the median spread is no measure of a deviation.
_CONSTANT = 1e-3


@dataclass(frozen=True, eq=False)
class Projection:
    """Centring, optional standardising and rotation to principal axes, learned once.

    Attributes
    ----------
    centre, spread
        (D,) what is subtracted from features, and what they are then divided by.
    axes
        (D, K) orthonormal principal axes, those of largest variance first.
    variances
        (K,) variance of the training features along each.
    """

    centre: Array
    spread: Array
    axes: Array
    variances: Array

    @classmethod
    def fit(cls, features: Array, *, standardise: bool, most: int = MOST_AXES) -> Self:
        """Learn from (N, D) features: at most ``most`` axes, and at most one for ten rows.

        The sign of an axis is fixed by its largest entry, so that the same features give the same axes on any machine.
        """
        centre = features.mean(axis=0)
        deviation = features.std(axis=0)
        moving = deviation[deviation > 0.0]
        floor = _CONSTANT * float(np.median(moving)) if moving.size else 1.0
        spread = np.maximum(deviation, floor) if standardise else np.ones_like(deviation)
        scaled = (features - centre) / spread
        values, vectors = np.linalg.eigh(scaled.T @ scaled / max(1, len(features) - 1))
        count = max(1, min(most, len(features) // 10, int((values > 1e-9 * values[-1]).sum())))
        axes = vectors[:, ::-1][:, :count]
        axes = axes * np.where(np.take_along_axis(axes, np.abs(axes).argmax(axis=0)[None], axis=0) < 0.0, -1.0, 1.0)
        return cls(centre, spread, axes, np.maximum(values[::-1][:count], 0.0))

    def apply(self, features: Array) -> Array:
        """(N, K) coordinates of (N, D) features."""
        return ((features - self.centre) / self.spread) @ self.axes

    def to_arrays(self, prefix: str) -> dict[str, Array]:
        """The four arrays by name, ``prefix/centre`` for the first."""
        return {f"{prefix}/{name}": getattr(self, name) for name in ("centre", "spread", "axes", "variances")}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray], prefix: str) -> Self:
        """The inverse of :meth:`to_arrays`."""
        return cls(*(arrays[f"{prefix}/{name}"] for name in ("centre", "spread", "axes", "variances")))
