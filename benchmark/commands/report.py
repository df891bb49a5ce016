"""``report`` and ``figures``: what a finished run looks like, made again from what it stored."""

from __future__ import annotations

from pathlib import Path

import click


@click.command()
@click.argument("run", type=click.Path(exists=True, file_okay=False, path_type=Path))
def report(run: Path) -> None:
    r"""Write figures, tables and the page of a finished run.

    Nothing is fitted, transferred or scored.

    \b
    Example:
      python -m benchmark report runs/synthetic-adult-child
    """
    from reports.build import build_report

    click.echo(f"report: {build_report(run)}")


@click.command()
@click.argument("run", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option(
    "--only", multiple=True, default=["all"], metavar="NAME", help="Figures to draw; patterns with * are allowed."
)
def figures(run: Path, only: tuple[str, ...]) -> None:
    r"""Draw the figures of a finished run as PDF and PNG, with the numbers behind each as CSV.

    \b
    Examples:
      python -m benchmark figures runs/synthetic-adult-child
      python -m benchmark figures runs/synthetic-adult-child --only pose-strips
    """
    from reports.build import draw_figures

    for drawing in draw_figures(run, only):
        click.echo(f"{drawing.name}: {drawing.png}, {drawing.pdf.name}, {drawing.csv.name}")
