"""``score``: the metrics of a finished run again, without refitting."""

from __future__ import annotations

import time
from pathlib import Path

import click

EXAMPLES = """\b
Examples:
  python -m benchmark score runs/kg
  python -m benchmark score runs/kg --metrics 'physics/*' --force
"""


@click.command("score", epilog=EXAMPLES)
@click.argument("folder", metavar="RUN", type=click.Path(path_type=Path))
@click.option(
    "--metrics", multiple=True, help="Metrics to add to those of the run: names, patterns or 'all'; by commas."
)
@click.option("--force", is_flag=True, help="Compute --metrics (or all) again, not only those whose code changed.")
@click.option("--jobs", "-j", type=int, help="Cells at a time.")
@click.option("--quiet", "-q", is_flag=True, help="Print the final lines only.")
@click.pass_context
def score(
    context: click.Context, folder: Path, metrics: tuple[str, ...], force: bool, jobs: int | None, quiet: bool
) -> None:
    """Score the stored clips of a run.

    Metrics whose code, version or settings changed since are computed again; nothing is fitted or transferred.
    """
    from benchmark.commands.run import split_list
    from benchmark.commands.tables import leaderboard_tables, make_console
    from benchmark.runner.progress import make_display
    from benchmark.runner.run import read_run
    from benchmark.runner.run import score as score_run
    from benchmark.runner.views import read_leaderboard

    start = time.perf_counter()
    console = make_console()
    _, cells = read_run(folder)
    with make_display(console, len(cells), quiet=quiet) as display:
        outcome = score_run(folder, display, requests=split_list(metrics) or (), force=force, jobs=jobs)
    if not quiet:
        for table in leaderboard_tables(read_leaderboard(folder)):
            console.print(table)
            console.print()
    console.print(f"{outcome.scored} of {len(outcome.cells)} cells scored again; {time.perf_counter() - start:.1f} s")
    console.print(f"results: {folder / 'results.parquet'}", markup=False, soft_wrap=True)
    if outcome.failures:
        context.exit(3)
