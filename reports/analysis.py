"""The statistics that every run ends with: methods compared, ratings by simulated observers, and the papers' claims."""

from __future__ import annotations

from pathlib import Path

from benchmark.errors import BenchmarkError
from reports.claims.evidence import claim_counts, judge
from reports.claims.table import write_claims
from reports.comparison import write_comparison
from reports.ratings import STATS, ratings_stem, simulate_ratings
from reports.run import RunView


def analyse_run(folder: Path) -> list[str]:
    """Write the comparison of metrics, where nobody was asked simulated ratings, and claims into ``folder/stats``.

    Every task of the run is rated; an analysis of ratings by people that is there stays.

    Returns
    -------
    list of str
        What was written, and what could not be and why, a line each.
    """
    run = RunView(folder)
    write_comparison(run, folder / STATS)
    lines = [f"statistics: {folder / STATS}"]
    for task in run.tasks:
        of_task = f" of {task}" if len(run.tasks) > 1 else ""
        try:
            written = simulate_ratings(run, task, folder)
        except BenchmarkError as reason:
            lines.append(f"no simulated ratings{of_task}: {reason}")
            continue
        lines.append(f"ratings{of_task} ({written.analysis.kind}): {folder / STATS / ratings_stem(run, task)}.md")
    # After the ratings, which some claims are about.
    table = judge([run])
    written_to, *_ = write_claims(table, folder)
    return [*lines, f"claims of the papers ({claim_counts(table)}): {written_to}"]
