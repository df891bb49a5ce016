"""``figures``: the figures of a finished run, drawn again from what it stored."""

from __future__ import annotations

from pathlib import Path

import click

EXAMPLES = """\b
Examples:
  python -m benchmark figures runs/synthetic-adult-child
  python -m benchmark figures runs/synthetic-adult-child --only pose-strips
"""


@click.command(epilog=EXAMPLES)
@click.argument("run", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option(
    "--only", multiple=True, default=["all"], metavar="NAME", help="Figures to draw; patterns with * are allowed."
)
def figures(run: Path, only: tuple[str, ...]) -> None:
    """Draw the figures of a finished run as PDF and PNG, with the numbers behind each as CSV."""
    from reports.build import draw_figures

    for drawing in draw_figures(run, only):
        click.echo(f"{drawing.name}: {drawing.png}, {drawing.pdf.name}, {drawing.csv.name}")
