"""``metrics-check``: which metric sees which fault, on performances of which the truth is known."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import TYPE_CHECKING, Self

import click

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import TaskID
    from rich.table import Table

    from eval.meta.study import Study

EXAMPLES = """\b
Examples:
  python -m benchmark metrics-check
  python -m benchmark metrics-check --metrics 'physics/*' --clips 40 --out runs/metrics-check-physics
"""


@click.command("metrics-check", epilog=EXAMPLES)
@click.option("--metrics", multiple=True, help="Names, patterns or 'all'; by commas. Default: all.")
@click.option("--corruptions", multiple=True, help="Names of faults, by commas. Default: all.")
@click.option("--dataset", "-d", default="synthetic", show_default=True, help="A data set that knows the truth.")
@click.option("--clips", "-n", default=20, show_default=True, type=click.IntRange(min=3), help="How many performances.")
@click.option("--seed", default=0, show_default=True, type=int, help="Of the corruptions, probes and intervals.")
@click.option("--jobs", "-j", type=click.IntRange(min=1), help="Processes. Default: the number of cores.")
@click.option(
    "--out",
    "-o",
    default=Path("runs/metrics-check"),
    show_default=True,
    type=click.Path(file_okay=False, path_type=Path),
    help="Where tables and the figure go.",
)
@click.option("--quiet", "-q", is_flag=True, help="Print the final lines only.")
def metrics_check(
    metrics: tuple[str, ...],
    corruptions: tuple[str, ...],
    dataset: str,
    clips: int,
    seed: int,
    jobs: int | None,
    out: Path,
    quiet: bool,
) -> None:
    """Corrupt true performances in grades and see what each metric says.

    Generated clips have a true performance in the target style. It is captured as a real clip would be, then spoiled in grades:
    noise, jitter, smoothing, freezing, lag, foot slide, a wrong floor, half of the style, none, another action and more. Every
    metric ought to order the grades of the faults that are its business, and to leave the others alone. What is expected is
    declared in eval/meta/expectations.py; the table says what happened. The same command gives the same numbers.
    """
    from benchmark.commands.run import split_list
    from benchmark.commands.tables import make_console
    from eval.meta.study import run_study
    from reports.metrics_check import LEGEND, write_metrics_check

    start = time.perf_counter()
    console = make_console()
    with _Display(console, quiet) as display:
        study = run_study(
            split_list(metrics) or ("all",),
            corruptions=split_list(corruptions) or (),
            dataset=dataset,
            clips=clips,
            seed=seed,
            jobs=jobs or available_cpus(),
            progress=display.moved,
        )
    files = write_metrics_check(study, out)
    if not quiet:
        console.print(summary_table(study))
        console.print(LEGEND, markup=False, soft_wrap=True)
    good, bad = study.verdicts()
    console.print(
        f"{good} of {good + bad} declared expectations hold; {len(study.metrics)} metrics, "
        f"{len(study.corruptions)} faults, {study.clips} clips; {time.perf_counter() - start:.0f} s"
    )
    for metric, corruption, expected, found in study.surprises():
        console.print(f"  not as expected: {metric} on {corruption}: {found}, expected {expected}", markup=False)
    for name, reason in study.left_out.items():
        console.print(f"  left out: {name}: {reason}", markup=False)
    for path in files:
        console.print(f"{path}", markup=False, soft_wrap=True)


def available_cpus() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def summary_table(study: Study) -> Table:
    """The check for the terminal: metrics by group as rows, faults as columns, colour for worse and better."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    from reports.metrics_check import cell, groups

    table = Table(
        title=f"which metric sees which fault: {study.clips} true performances in graded corruption",
        title_justify="left",
        title_style="bold",
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    table.add_column("metric", no_wrap=True)
    for entry in study.corruptions:
        table.add_column(entry.title, justify="center")
    for group, members in groups(study).items():
        table.add_row(Text(group, style="bold"))
        for metric in members:
            cells = []
            for entry in study.corruptions:
                found = study.orderings[metric, entry.name]
                surprise = study.holds(metric, entry.name) is False
                colour = {"ordered": "green", "seen": "yellow", "fooled": "red"}.get(found.observed, "dim")
                cells.append(
                    Text(cell(found) + ("!" if surprise else ""), style="bold magenta" if surprise else colour)
                )
            table.add_row(Text("  " + metric.partition("/")[2]), *cells)
        table.add_section()
    return table


class _Display:
    """A bar for the units of work that are under way, or one line for each that is done where there is no terminal."""

    def __init__(self, console: Console, quiet: bool) -> None:
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        self._console, self._quiet = console, quiet
        self._bars = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=24),
            TextColumn("{task.fields[note]}", markup=False),
            TimeElapsedColumn(),
            console=console,
            disable=quiet or not console.is_terminal,
            transient=True,
        )
        self._tasks: dict[str, TaskID] = {}
        self._start = time.perf_counter()

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bars.stop()

    def moved(self, unit: str, fraction: float, message: str) -> None:
        """Show that ``unit`` has come to ``fraction``."""
        if unit not in self._tasks:
            self._tasks[unit] = self._bars.add_task(unit, total=1.0, note="")
        self._bars.update(self._tasks[unit], completed=fraction, note=message)
        if fraction >= 1.0 and message in ("done", "fitted"):
            self._bars.remove_task(self._tasks.pop(unit))
            if not self._quiet:
                self._console.print(f"{time.perf_counter() - self._start:5.0f} s  {unit} {message}", markup=False)
