"""What a figure function returns, and what becomes of it on disk."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Drawing:
    """A figure, what it says, and the numbers behind it."""

    name: str
    figure: Figure
    caption: str
    data: pd.DataFrame


@dataclass(frozen=True)
class SavedDrawing:
    """A figure on disk: its files share the stem ``name``."""

    name: str
    caption: str
    folder: Path

    @property
    def png(self) -> Path:
        """The picture for screens."""
        return self.folder / f"{self.name}.png"

    @property
    def pdf(self) -> Path:
        """The vector picture for print."""
        return self.folder / f"{self.name}.pdf"

    @property
    def csv(self) -> Path:
        """The numbers behind it."""
        return self.folder / f"{self.name}.csv"


def save(drawing: Drawing, folder: Path) -> SavedDrawing:
    """Write a drawing's PDF, PNG and CSV into ``folder``; the same drawing gives the same files."""
    from reports.figures.style import style

    entry = SavedDrawing(drawing.name, drawing.caption, folder)
    # The fonts of a PDF are settled when it is written, not when it is drawn.
    with style():
        drawing.figure.savefig(entry.png, dpi=200)
        drawing.figure.savefig(entry.pdf, metadata={"CreationDate": None})
    drawing.data.to_csv(entry.csv, index=False)
    return entry


@dataclass(frozen=True)
class FigureOutcome:
    """What became of one registered figure.

    Attributes
    ----------
    name
        As it is registered.
    drawings
        What was drawn, none if there is a reason.
    reason
        Why nothing was drawn, or ``""``.
    failed
        Whether that is a fault of the figure rather than of what the run holds.
    seconds
        How long it took.
    """

    name: str
    drawings: tuple[SavedDrawing, ...] = ()
    reason: str = ""
    failed: bool = False
    seconds: float = 0.0

    @property
    def line(self) -> str:
        """The outcome in a line."""
        if self.failed:
            return f"{self.name}: failed: {self.reason}"
        if self.reason:
            return f"{self.name}: nothing to draw: {self.reason}"
        count = len(self.drawings)
        return f"{self.name}: {count} drawing{'' if count == 1 else 's'} ({self.seconds:.1f} s)"
