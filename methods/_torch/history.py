"""Loss curves: rows in memory, a parquet file, and TensorBoard where it is installed."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any


class History:
    """A table of numbers that grows by rows; a row may lack columns.

    Attributes
    ----------
    rows
        As added: column names to numbers. Every row of a training has ``step``, ``epoch`` and ``seconds`` at its end.
    """

    def __init__(self, rows: list[dict[str, float]] | None = None) -> None:
        self.rows: list[dict[str, float]] = list(rows or [])
        self._writer: Any = None

    def __len__(self) -> int:
        return len(self.rows)

    def watch(self, folder: Path, step: int) -> None:
        """Also write rows for TensorBoard, where it is installed, in place of what it has after ``step``."""
        if find_spec("tensorboard") is not None:
            from torch.utils.tensorboard import SummaryWriter

            self._writer = SummaryWriter(str(folder), purge_step=step)

    def add(self, row: Mapping[str, float]) -> None:
        """Add a row."""
        self.rows.append({name: float(value) for name, value in row.items()})
        if self._writer is not None:
            for name, value in row.items():
                if name not in ("step", "epoch", "seconds"):
                    self._writer.add_scalar(name, value, int(row["step"]))

    def column(self, name: str) -> list[float]:
        """The values of a column, without the rows that lack it."""
        return [row[name] for row in self.rows if name in row]

    @property
    def columns(self) -> list[str]:
        """All column names, in the order in which they first appear."""
        return list(dict.fromkeys(name for row in self.rows for name in row))

    def save(self, path: Path) -> None:
        """Write the rows as parquet, all columns ``double``, null where a row lacks one; no file where there are no rows."""
        if not self.rows:
            return
        import pyarrow as pa
        import pyarrow.parquet as parquet

        path.parent.mkdir(parents=True, exist_ok=True)
        table = pa.table({name: pa.array([row.get(name) for row in self.rows], pa.float64()) for name in self.columns})
        parquet.write_table(table, path)

    def close(self) -> None:
        """Finish writing for TensorBoard."""
        if self._writer is not None:
            self._writer.close()
