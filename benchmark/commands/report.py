"""``report``: the page, tables and figures of a finished run, made again from what it stored."""

from __future__ import annotations

from pathlib import Path

import click

EXAMPLES = """\b
Examples:
  python -m benchmark report runs/synthetic-adult-child
  python -m benchmark report runs/kinder-gator-adult-child --without-motion
"""


@click.command(epilog=EXAMPLES)
@click.argument("run", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option(
    "--without-motion",
    is_flag=True,
    help="Leave the moving pictures out, and with them the joint positions of recordings that may not be passed on.",
)
def report(run: Path, without_motion: bool) -> None:
    """Write figures, tables and the page of a finished run.

    Nothing is fitted, transferred or scored. The page, report/index.html, is one file that opens without a network.
    """
    from reports.build import build_report

    page = build_report(
        run, tell=lambda outcome: click.echo(outcome.line, err=outcome.failed), moving=not without_motion
    )
    click.echo(f"report: {page}")
