"""``merge``: parts of a run that were computed in different folders."""

from __future__ import annotations

from pathlib import Path

import click

EXAMPLES = """\b
Example, with parts from two machines:
  python -m benchmark run --methods all --shard 1/2 --out runs/a
  python -m benchmark run --methods all --shard 2/2 --out runs/b
  python -m benchmark merge runs/a runs/b
  python -m benchmark run --methods all --out runs/a
"""


@click.command("merge", epilog=EXAMPLES)
@click.argument("folder", metavar="RUN", type=click.Path(path_type=Path))
@click.argument("others", metavar="OTHER...", nargs=-1, required=True, type=click.Path(path_type=Path))
def merge(folder: Path, others: tuple[Path, ...]) -> None:
    """Take into RUN the finished cells of its plan that the OTHER run folders have.

    Every file is compared with its digest. The same run without --shard then makes what is still missing, the tables and the
    report.
    """
    from benchmark.runner.merge import merge as merge_runs

    merged = merge_runs(folder, others)
    click.echo(f"{merged.taken} cells taken, {merged.kept} were there, {merged.left} are in none of the folders")
