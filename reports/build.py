"""Everything that is made of a finished run: figures, tables and the page."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from pathlib import Path

from benchmark.registry import FIGURES
from reports.drawing import SavedDrawing
from reports.run import RunView


def draw_figures(folder: Path, only: Iterable[str] = ("all",)) -> list[SavedDrawing]:
    """Draw figures of a finished run into ``folder/figures`` as PDF and PNG, with the numbers behind each as CSV.

    Parameters
    ----------
    folder
        The run folder.
    only
        Names or patterns of registered figures.
    """
    names = list(dict.fromkeys(name for pattern in only for name in FIGURES.select(pattern)))
    run = RunView(folder)
    target = folder / "figures"
    target.mkdir(exist_ok=True)
    saved = []
    for name in names:
        for drawing in FIGURES.get(name)(run):
            entry = SavedDrawing(drawing.name, drawing.caption, target)
            drawing.figure.savefig(entry.png, dpi=200)
            # Without a date the same run gives the same file.
            drawing.figure.savefig(entry.pdf, metadata={"CreationDate": None})
            drawing.data.to_csv(entry.csv, index=False)
            saved.append(entry)
    return saved


def build_report(folder: Path, *, moving: bool = True) -> Path:
    """Draw all figures, write the tables and the page, and return the page's path.

    A figure or table that fails is named on the page with the reason, and the others are made.

    Parameters
    ----------
    folder
        The run folder.
    moving
        Whether the page holds moving pictures, and with them joint positions of the clips.
    """
    from reports.html.parts import Parts
    from reports.jumps import write_jump_tables
    from reports.page import write_page
    from reports.tables import write_tables

    parts = Parts()
    drawings: list[SavedDrawing] = []
    for name in FIGURES.names():
        drawings += parts.make(f"the figure {name}", partial(draw_figures, folder, [name]), [])
    run = RunView(folder)
    parts.make("the tables", lambda: write_tables(run), [])
    parts.make("the tables of jumps", lambda: write_jump_tables(run), [])
    return write_page(run, drawings, failures=parts.failures, moving=moving)
