"""Everything that is made of a finished run: figures, tables and the page."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from benchmark.registry import FIGURES
from reports.drawing import Drawing, SavedDrawing
from reports.html.parts import Parts
from reports.run import RunView


def draw_figures(folder: Path, only: Iterable[str] = ("all",), *, parts: Parts | None = None) -> list[SavedDrawing]:
    """Draw figures of a finished run into ``folder/figures`` as PDF and PNG, with the numbers behind each as CSV.

    Parameters
    ----------
    folder
        The run folder.
    only
        Names or patterns of registered figures.
    parts
        Notes which figures failed; without it a failure is raised.
    """
    names = list(dict.fromkeys(name for pattern in only for name in FIGURES.select(pattern)))
    run = RunView(folder)
    target = folder / "figures"
    target.mkdir(exist_ok=True)
    saved: list[SavedDrawing] = []
    for name in names:

        def draw(name: str = name) -> list[SavedDrawing]:
            return [_save(drawing, target) for drawing in FIGURES.get(name)(run)]

        saved += draw() if parts is None else parts.make(f"the figure {name}", draw, [])
    return saved


def _save(drawing: Drawing, folder: Path) -> SavedDrawing:
    entry = SavedDrawing(drawing.name, drawing.caption, folder)
    drawing.figure.savefig(entry.png, dpi=200)
    # Without a date the same run gives the same file.
    drawing.figure.savefig(entry.pdf, metadata={"CreationDate": None})
    drawing.data.to_csv(entry.csv, index=False)
    return entry


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
    from reports.jumps import write_jump_tables
    from reports.page import write_page
    from reports.tables import write_tables

    parts = Parts()
    drawings = draw_figures(folder, parts=parts)
    run = RunView(folder)
    parts.make("the tables", lambda: write_tables(run), [])
    parts.make("the tables of jumps", lambda: write_jump_tables(run), [])
    return write_page(run, drawings, failures=parts.failures, moving=moving)
