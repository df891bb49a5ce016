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
