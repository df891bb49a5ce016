"""The statistics that every run ends with: methods compared, ratings by simulated observers, and the papers' claims."""

from __future__ import annotations

from pathlib import Path

from benchmark.errors import BenchmarkError
from reports.claims.evidence import claim_verdicts, judge
from reports.claims.table import write_claims
from reports.comparison import write_comparison
from reports.ratings import STATS, simulate_ratings
from reports.run import RunView


def analyse_run(folder: Path) -> list[str]:
    """Write the comparison of metrics, where nobody was asked simulated ratings, and claims into ``folder/stats``.

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
        lines.append(f"ratings ({written.analysis.kind}): {folder / STATS / 'ratings.md'}")
    except BenchmarkError as reason:
        lines.append(f"no simulated ratings: {reason}")
    # After the ratings, which some claims are about.
    verdicts = list(claim_verdicts(table := judge([run])).values())
    written_to, *_ = write_claims(table, folder)
    counts = ", ".join(f"{verdicts.count(verdict)} {verdict}" for verdict in dict.fromkeys(verdicts))
    return [*lines, f"claims of the papers ({counts}): {written_to}"]
