"""The statistics that every run ends with: methods compared on metrics, and ratings by simulated observers."""

from __future__ import annotations

from pathlib import Path

from benchmark.errors import BenchmarkError
from reports.comparison import write_comparison
from reports.ratings import STATS, simulate_ratings
from reports.run import RunView


def analyse_run(folder: Path) -> list[str]:
    """Write the comparison of metrics and, where nobody was asked, simulated ratings into ``folder/stats``.

    Ratings are of the run's first task; an analysis of ratings by people that is there stays.

    Returns
    -------
    list of str
        What was written, and what could not be and why, a line each.
    """
    run = RunView(folder)
    write_comparison(run, folder / STATS)
    lines = [f"statistics: {folder / STATS}"]
    try:
        written = simulate_ratings(run, run.tasks[0], folder)
    except BenchmarkError as reason:
        return [*lines, f"no simulated ratings: {reason}"]
    return [*lines, f"ratings ({written.analysis.kind}): {folder / STATS / 'ratings.md'}"]
