"""``new-method``: a plug-in package that works, to be changed into one's own method."""

from __future__ import annotations

from pathlib import Path

import click


@click.command("new-method")
@click.argument("name")
@click.option(
    "--into",
    type=click.Path(path_type=Path, file_okay=False),
    default=None,
    help="Folder of the new package; by default one called NAME in the current folder.",
)
def new_method(name: str, into: Path | None) -> None:
    """Write an installable plug-in package for a new method NAME (lower-case words joined by hyphens).

    It holds a working example, its tests and the entry point by which the suite finds it once it is installed.
    """
    from benchmark.commands import scaffold

    folder = Path(name) if into is None else into
    for path in scaffold.write(name, folder):
        click.echo(f"wrote {path}")
    module = scaffold.module_name(name)
    click.echo(
        f"\nNext:\n  pip install -e '{folder}[test]'\n  python -m benchmark check-method {name}\n"
        f"then change {folder / 'src' / module / 'method.py'} into your method."
    )
