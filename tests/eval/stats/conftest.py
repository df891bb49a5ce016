"""Tables that several tests of the statistics need."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest


@pytest.fixture
def long() -> Callable[..., pd.DataFrame]:
    """A function from a matrix of subjects by conditions to a long table with columns ``rater, method, score``."""

    def melt(matrix, levels=None) -> pd.DataFrame:
        array = np.asarray(matrix, dtype=float)
        names = list("abcdefgh"[: array.shape[1]]) if levels is None else list(levels)
        rows = [(f"r{i:03d}", name, array[i, j]) for i in range(len(array)) for j, name in enumerate(names)]
        return pd.DataFrame(rows, columns=["rater", "method", "score"])

    return melt


@pytest.fixture
def ratings(rng, long) -> pd.DataFrame:
    """36 raters, five methods, one of them far off: the design of the 2020 study."""
    matrix = rng.normal(size=(36, 1)) + rng.normal(size=(36, 5)) + np.array([0.0, 0.1, 0.3, 0.4, 1.5])
    return long(matrix)
