"""Seeds from named axes.

A seed depends on the axes it is asked for and on nothing else: not on the order of methods, the number of processes or what
ran before. Generators are passed in; nothing is seeded globally.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from benchmark.digest import VaryingDigest, digest
from benchmark.errors import ConfigError, UnknownNameError

#: The axes there are. ``seed`` is the run's own seed; ``stage`` tells apart the uses of one cell's randomness.
AXES: tuple[str, ...] = ("seed", "dataset", "split", "task", "method", "repetition", "stage", "clip", "metric", "probe")


def seed_for(**axes: str | int) -> int:
    """A seed of 63 bits for these axes and their values.

    Raises
    ------
    UnknownNameError
        For an axis that is not in :data:`AXES`.
    ConfigError
        Without any axis, or for a value that is neither a string nor an integer.
    """
    if not axes:
        raise ConfigError(f"a seed needs at least one axis ({', '.join(AXES)})")
    _check(axes)
    return _seed(digest(axes))


class Seeds:
    """:func:`seed_for` for many seeds that have all but the axes ``varying`` in common."""

    def __init__(self, varying: Iterable[str], **fixed: str | int) -> None:
        _check(fixed)
        self._digest = VaryingDigest(fixed, varying)

    def __call__(self, **axes: str | int) -> int:
        """The seed for the values of the varying axes."""
        _check(axes)
        return _seed(self._digest(**axes))


def _check(axes: Mapping[str, Any]) -> None:
    for name, value in axes.items():
        if name not in AXES:
            raise UnknownNameError("seed axis", name, AXES)
        if isinstance(value, bool) or not isinstance(value, str | int):
            raise ConfigError(f"seed axis {name!r} must be a string or an integer, not {value!r}")


def _seed(text: str) -> int:
    return int(text[:16], 16) >> 1


def generator(**axes: str | int) -> np.random.Generator:
    """A generator seeded by :func:`seed_for`."""
    return np.random.default_rng(seed_for(**axes))
