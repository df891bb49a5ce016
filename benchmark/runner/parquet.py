"""Rows to and from parquet, exactly and without pandas, whose import costs a cell more than its scores do."""

from __future__ import annotations

import io
import json
from collections.abc import Iterable, Mapping
from itertools import islice
from pathlib import Path
from typing import Any

from benchmark.runner.store import replacing

#: Rows that are held in memory as text.
ROWS_AT_A_TIME = 100_000


def write_rows(path: Path, rows: Iterable[Mapping[str, Any]], columns: Mapping[str, str]) -> None:
    """Write rows atomically.

    Parameters
    ----------
    path
        The file.
    rows
        Each with all ``columns``; ``None`` where there is no value.
    columns
        Name and type of each column in order: ``string``, ``bool``, ``int64`` or ``double``.
    """
    import pyarrow as pa
    import pyarrow.parquet as parquet
    from pyarrow import json as arrow_json

    schema = pa.schema([(name, pa.type_for_alias(kind)) for name, kind in columns.items()])
    lines = (json.dumps({name: row[name] for name in columns}, allow_nan=False) for row in rows)
    with replacing(path) as part, parquet.ParquetWriter(part, schema) as file:
        # Piece by piece: a run may have more rows than memory for them as text.
        while piece := list(islice(lines, ROWS_AT_A_TIME)):
            # pa.array and Table.from_pylist import pandas; the JSON reader does not, and reads shortest floats back exactly.
            table = arrow_json.read_json(
                io.BytesIO("\n".join(piece).encode()),
                read_options=arrow_json.ReadOptions(use_threads=False),
                parse_options=arrow_json.ParseOptions(explicit_schema=schema, unexpected_field_behavior="error"),
            )
            file.write_table(table.combine_chunks())


def read_rows(path: Path) -> list[dict[str, Any]]:
    """Read the rows that :func:`write_rows` wrote."""
    import pyarrow.parquet as parquet

    rows: list[dict[str, Any]] = parquet.ParquetFile(path).read(use_threads=False).to_pylist()
    return rows
