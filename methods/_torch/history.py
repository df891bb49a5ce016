"""Loss curves: rows in memory, a parquet file, and TensorBoard where it is asked for."""

from __future__ import annotations

import os
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from benchmark.errors import ConfigError

#: Environment variable that has loss curves written for TensorBoard, too: any value but 0. It is no setting of a method, as
#: it changes no result.
TENSORBOARD = "BENCHMARK_TENSORBOARD"


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
        """Also write rows for TensorBoard into ``folder``, if the environment variable :data:`TENSORBOARD` says so.

        Parameters
        ----------
        folder
            Made if it is not there. Events of an attempt that was interrupted stay in files of their own.
        step
            Steps done. What such an attempt wrote of later ones is void; they are done again.

        Raises
        ------
        ConfigError
            If the package is not installed.
        """
        if os.environ.get(TENSORBOARD, "0") in ("", "0"):
            return
        if find_spec("tensorboard") is None:
            raise ConfigError(
                f"{TENSORBOARD} is set, but the package tensorboard is not installed: install it by "
                "pip install -c constraints.txt -e '.[tensorboard]', or unset the variable"
            )
        from torch.utils.tensorboard import SummaryWriter

        self._writer = SummaryWriter(str(folder), purge_step=step + 1)

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
