"""What a run shows while it works: one live display on a terminal, one line for each finished cell elsewhere."""

from __future__ import annotations

from typing import Self

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.text import Text

from benchmark.runner.job import Unit
from benchmark.runner.probes import ProbeUnit

_MARKS = {"ok": ("ok", "green"), "skipped": ("skipped", "yellow"), "failed": ("failed", "red")}


class Quiet:
    """Shows nothing."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def cell_started(self, cell: Unit) -> None:
        """Nothing."""

    def cell_progress(self, cell: Unit, stage: str, fraction: float, message: str) -> None:
        """Nothing."""

    def cell_finished(self, cell: Unit, state: str, reason: str, seconds: float) -> None:
        """Nothing."""


class Plain(Quiet):
    """One line for each finished cell, for logs and pipes."""

    def __init__(self, console: Console, total: int) -> None:
        self._console, self._total, self._done = console, total, 0

    def cell_finished(self, cell: Unit, state: str, reason: str, seconds: float) -> None:
        """Print the line; probes are not counted."""
        self._done += counts(cell)
        prefix = f"[{self._done}/{self._total}]"
        self._console.print(
            _line(prefix if counts(cell) else " " * len(prefix), cell, state, reason, seconds), soft_wrap=True
        )


class Bars(Quiet):
    """A bar for all cells and one for each cell at work, with what its method says of itself."""

    def __init__(self, console: Console, total: int) -> None:
        self._console = console
        self._bars = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=24),
            TextColumn("{task.fields[count]}", markup=False),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[message]}", markup=False, style="dim"),
            console=console,
            transient=True,
        )
        self._all = self._bars.add_task("cells", total=total, count=f"0/{total}", message="")
        self._total, self._done = total, 0
        self._of: dict[str, TaskID] = {}

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bars.stop()

    def cell_started(self, cell: Unit) -> None:
        """Add the cell's bar."""
        self._of[cell.key] = self._bars.add_task(f"  {cell.title}", total=1.0, count="", message="starting")

    def cell_progress(self, cell: Unit, stage: str, fraction: float, message: str) -> None:
        """Move the cell's bar."""
        task = self._of.get(cell.key)
        if task is not None:
            text = f"{stage}: {message}" if message else stage
            self._bars.update(task, completed=min(max(fraction, 0.0), 1.0), message=" ".join(text.split())[:60])

    def cell_finished(self, cell: Unit, state: str, reason: str, seconds: float) -> None:
        """Take the cell's bar away and print its line above."""
        task = self._of.pop(cell.key, None)
        if task is not None:
            self._bars.remove_task(task)
        self._done += counts(cell)
        self._bars.update(self._all, completed=self._done, count=f"{self._done}/{self._total}")
        self._console.print(_line("", cell, state, reason, seconds), soft_wrap=True)


def counts(unit: Unit) -> bool:
    """Whether a unit is one of the plan's cells."""
    return not isinstance(unit, ProbeUnit)


def _line(prefix: str, cell: Unit, state: str, reason: str, seconds: float) -> Text:
    word, style = _MARKS.get(state, (state, "red"))
    text = Text(f"{prefix} " if prefix else "")
    text.append(f"{word:<8}", style=style)
    text.append(f"{cell.title}  {seconds:.1f} s")
    if reason:
        text.append(f"  {reason}", style="dim")
    return text


def make_display(console: Console, total: int, *, quiet: bool) -> Quiet:
    """The display that suits the console."""
    if quiet:
        return Quiet()
    return Bars(console, total) if console.is_terminal else Plain(console, total)
