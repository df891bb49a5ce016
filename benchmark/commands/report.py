"""``report``: the page, tables and figures of a finished run, made again from what it stored."""

from __future__ import annotations

from pathlib import Path

import click

EXAMPLES = """\b
Example:
  python -m benchmark report runs/synthetic-adult-child
"""


@click.command(epilog=EXAMPLES)
@click.argument("run", type=click.Path(exists=True, file_okay=False, path_type=Path))
def report(run: Path) -> None:
    """Write figures, tables and the page of a finished run.

    Nothing is fitted, transferred or scored.
    """
    from reports.build import build_report

    click.echo(f"report: {build_report(run)}")
