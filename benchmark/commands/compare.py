"""``compare``: two runs side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from benchmark.runner.plan import Cell


EXAMPLES = """\b
Example:
  python -m benchmark compare runs/before runs/after
"""


@click.command("compare", epilog=EXAMPLES)
@click.argument("first", metavar="R1", type=click.Path(path_type=Path))
@click.argument("second", metavar="R2", type=click.Path(path_type=Path))
@click.option("--variant", type=click.Choice(["raw", "cleaned"]), default="raw", show_default=True, help="Which rows.")
@click.option("--costs", is_flag=True, help="Compare time, memory and size too.")
def compare(first: Path, second: Path, variant: str, costs: bool) -> None:
    """Two runs side by side, with what differs between their settings, code, data and machines."""
    from benchmark.commands.tables import make_console
    from benchmark.runner.run import ENVIRONMENT, read_run
    from benchmark.runner.store import read_json
    from benchmark.runner.views import read_leaderboard

    console = make_console()
    (one, cells_one), (two, cells_two) = read_run(first), read_run(second)
    changes = differences(one.model_dump(mode="json", exclude={"out"}), two.model_dump(mode="json", exclude={"out"}))
    keep = ("versions", "git", "hardware", "python", "platform", "threads")
    here, there = ({name: read_json(run / ENVIRONMENT).get(name) for name in keep} for run in (first, second))
    changes += differences(here, there)
    changes += cell_differences(cells_one, cells_two)
    for name, before, after in sorted(set(changes)):
        console.print(f"{name}: {_short(before)} | {_short(after)}", markup=False, soft_wrap=True)
    if not changes:
        console.print("settings, code, data and machine are the same")
    if any(name in ("dataset_digest", "split_digest") for name, _, _ in changes):
        console.print("the runs were made on other data or another split: their values cannot be compared one to one")
    console.print()
    console.print(_table(read_leaderboard(first), read_leaderboard(second), (str(first), str(second)), variant, costs))


def cell_differences(first: Sequence[Cell], second: Sequence[Cell]) -> list[tuple[str, str, str]]:
    """What the keys of cells that both plans have are made of, where it differs."""
    found: list[tuple[str, str, str]] = []
    others = {(cell.task, cell.method, cell.repetition): cell for cell in second}
    for cell in first:
        other = others.get((cell.task, cell.method, cell.repetition))
        if other is None:
            continue
        for part in ("method_source", "method_version", "params"):
            name = f"{cell.method}: {part}"
            found += differences({name: cell.ingredients.get(part)}, {name: other.ingredients.get(part)})
        for part in ("dataset_digest", "split_digest", "pipeline", "contract"):
            found += differences({part: cell.ingredients.get(part)}, {part: other.ingredients.get(part)})
    return found


def differences(first: Mapping[str, Any], second: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str, str]]:
    """Name and both values, as texts, of every leaf in which two nested tables differ; ``-`` where one lacks it."""
    found: list[tuple[str, str, str]] = []
    for key in sorted({*first, *second}):
        a, b = first.get(key), second.get(key)
        if isinstance(a, Mapping) and isinstance(b, Mapping):
            found += differences(a, b, f"{prefix}{key}.")
        elif a != b:
            found.append((f"{prefix}{key}", "-" if a is None else str(a), "-" if b is None else str(b)))
    return found


def _short(text: str) -> str:
    is_digest = len(text) == 64 and all(sign in "0123456789abcdef" for sign in text)
    return f"{text[:12]}…" if is_digest else text


def _table(
    first: list[dict[str, Any]], second: list[dict[str, Any]], names: tuple[str, str], variant: str, costs: bool
) -> Any:
    from rich.table import Table
    from rich.text import Text

    def key(row: dict[str, Any]) -> tuple[str, str, str]:
        return row["task"], row["method"], row["metric"]

    def wanted(row: dict[str, Any]) -> bool:
        if row["metric"].startswith("cost/"):
            return costs
        return bool(row["variant"] == variant)

    left, right = ({key(row): row for row in rows if wanted(row)} for rows in (first, second))
    table = Table(title=f"mean over clips (n), {variant}", title_justify="left")
    for name in ("task", "method", "metric", names[0], names[1], "difference"):
        table.add_column(Text(name), overflow="fold")
    for task, method, metric in dict.fromkeys([*left, *right]):
        a, b = left.get((task, method, metric)), right.get((task, method, metric))
        both = a is not None and b is not None and a["mean"] is not None and b["mean"] is not None
        gap = f"{b['mean'] - a['mean']:+.3g}" if both and a is not None and b is not None else ""
        table.add_row(*(Text(text) for text in (task, method, metric, _mean(a), _mean(b), gap)))
    return table


def _mean(row: dict[str, Any] | None) -> str:
    if row is None:
        return "-"
    return "none" if row["mean"] is None else f"{row['mean']:.4g} ({row['n']})"
