"""``figures``: the figures of a finished run, drawn again from what it stored."""

from __future__ import annotations

from pathlib import Path

import click

EXAMPLES = """\b
Examples:
  python -m benchmark figures runs/synthetic-adult-child
  python -m benchmark figures runs/synthetic-adult-child --only pose-strips
  python -m benchmark figures runs/synthetic-adult-child --only "*-strips" --only tempo
"""


@click.command(epilog=EXAMPLES)
@click.argument("run", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option(
    "--only",
    multiple=True,
    default=["all"],
    metavar="NAME",
    help="Figures to draw (see `list figures`); patterns with * are allowed, and the option can be repeated.",
)
def figures(run: Path, only: tuple[str, ...]) -> None:
    """Draw the figures of a finished run as PDF and PNG, with the numbers behind each as CSV.

    Each figure is named as it is done. One that fails is named with the reason, the others are drawn, and the exit status is 1.
    """
    from reports.build import iter_figures

    failed = 0
    for outcome in iter_figures(run, only):
        failed += outcome.failed
        click.echo(outcome.line, err=outcome.failed)
        for drawing in outcome.drawings:
            click.echo(f"  {drawing.png}, {drawing.pdf.name}, {drawing.csv.name}")
    if failed:
        raise SystemExit(1)
