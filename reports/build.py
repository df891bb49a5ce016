"""Everything that is made of a finished run: figures, tables and the page."""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from benchmark.api import NotApplicableError
from benchmark.registry import FIGURES
from reports.drawing import FigureOutcome, SavedDrawing, save
from reports.run import RunView


def iter_figures(folder: Path, only: Iterable[str] = ("all",)) -> Iterator[FigureOutcome]:
    """Draw figures of a finished run into ``folder/figures``, one after the other; a broken one does not stop the others.

    Each drawing is saved as PDF and PNG, with the numbers behind it as CSV.

    Parameters
    ----------
    folder
        The run folder.
    only
        Names or patterns of registered figures; a name that is unknown is refused before anything is drawn.

    Yields
    ------
    FigureOutcome
        As soon as a figure is on disk, or has turned out to have nothing to show, or has failed.
    """
    names = list(dict.fromkeys(name for pattern in only for name in FIGURES.select(pattern)))
    run = RunView(folder)
    target = folder / "figures"
    target.mkdir(exist_ok=True)
    for name in names:
        yield _draw(run, name, target)


def draw_figures(
    folder: Path, only: Iterable[str] = ("all",), tell: Callable[[FigureOutcome], None] | None = None
) -> list[SavedDrawing]:
    """Draw figures as :func:`iter_figures` does and return the drawings; ``tell`` hears of each figure as it is done.

    Without ``tell`` a figure that failed is a warning.
    """
    saved: list[SavedDrawing] = []
    for outcome in iter_figures(folder, only):
        if tell is not None:
            tell(outcome)
        elif outcome.failed:
            warnings.warn(f"figure {outcome.line}", stacklevel=2)
        saved += outcome.drawings
    return saved


def _draw(run: RunView, name: str, target: Path) -> FigureOutcome:
    start = time.perf_counter()
    saved: list[SavedDrawing] = []
    try:
        saved.extend(save(drawing, target) for drawing in FIGURES.get(name)(run))
    except NotApplicableError as lacking:
        return FigureOutcome(name, tuple(saved), str(lacking), seconds=time.perf_counter() - start)
    except Exception as error:  # a plug-in figure may raise anything, and the others are still wanted
        if os.environ.get("BENCHMARK_DEBUG"):
            raise
        return FigureOutcome(name, tuple(saved), f"{type(error).__name__}: {error}", True, time.perf_counter() - start)
    reason = "" if saved else "this run holds nothing for it"
    return FigureOutcome(name, tuple(saved), reason, seconds=time.perf_counter() - start)


def build_report(folder: Path, tell: Callable[[FigureOutcome], None] | None = None, *, moving: bool = True) -> Path:
    """Draw all figures, write the tables and the page, and return the page's path.

    A figure or table that fails is named on the page with the reason, and the others are made.

    Parameters
    ----------
    folder
        The run folder.
    tell
        Hears of each figure as it is done.
    moving
        Whether the page holds moving pictures, and with them joint positions of the clips.
    """
    from reports.html.parts import Parts
    from reports.jumps import write_jump_tables
    from reports.page import write_page
    from reports.tables import write_tables
    from reports.trajectory_tables import write_trajectory_tables

    parts = Parts()
    drawings: list[SavedDrawing] = []
    for outcome in iter_figures(folder):
        drawings += outcome.drawings
        if outcome.failed:
            parts.failures.append((f"the figure {outcome.name}", outcome.reason))
        if tell is not None:
            tell(outcome)
    run = RunView(folder)
    parts.make("the tables", lambda: write_tables(run), [])
    parts.make("the tables of jumps", lambda: write_jump_tables(run), [])
    parts.make("the tables of trajectories", lambda: write_trajectory_tables(run), [])
    return write_page(run, drawings, failures=parts.failures, moving=moving)
