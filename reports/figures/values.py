"""Means with intervals of single metrics, as several figures need them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from benchmark.api import NotApplicableError
from reports.ratings import STATS
from reports.run import RunView

if TYPE_CHECKING:
    import pandas as pd


def metric_table(run: RunView, task: str, metric: str) -> pd.DataFrame:
    """The rows of the leaderboard of one metric, raw results, by method: ``label, mean, low, high, n, unit, direction, …``.

    Methods without a value are left out; empty where nothing was scored.
    """
    table = run.leaderboard(task, variant="raw")
    table = table[(table["metric"] == metric) & np.isfinite(table["mean"].astype(float))]
    return table.set_index("method")


def statistics_table(run: RunView, file: str) -> pd.DataFrame:
    """A table of the statistics that ``analyze`` wrote; :class:`~benchmark.api.NotApplicableError` where there is none."""
    import pandas as pd

    path = run.folder / STATS / file
    stored = pd.read_csv(path) if path.is_file() else pd.DataFrame()
    if "variant" not in stored:
        raise NotApplicableError(no_statistics(run))
    return stored


def no_statistics(run: RunView) -> str:
    """Why a figure of statistics has nothing to draw, and what to do."""
    return f"there are no statistics yet, or they are an earlier version's: python -m benchmark analyze {run.folder} makes them"


def clips_line(counts: pd.Series) -> str:
    """How many clips a mean is over, for captions: ``n = 80 clips``, ``n = 60 to 80 clips``."""
    low, high = int(counts.min()), int(counts.max())
    if high == 1:
        return "n = 1 clip"
    return f"n = {high} clips" if low == high else f"n = {low} to {high} clips"


#: What the whiskers are, for captions.
INTERVALS = "95 % intervals from resampling actors and then their clips"
