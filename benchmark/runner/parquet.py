"""Rows to and from parquet, exactly and without pandas, whose import costs a cell more than its scores do."""

from __future__ import annotations

import io
import json
from collections.abc import Iterable, Mapping
from itertools import islice
from pathlib import Path
from typing import Any

from benchmark.errors import StoreError
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
    with replacing(path) as part, parquet.ParquetWriter(part, schema, write_page_checksum=True) as file:
        # Piece by piece: a run may have more rows than memory for them as text.
        while piece := list(islice(lines, ROWS_AT_A_TIME)):
            # pa.array and Table.from_pylist import pandas; the JSON reader does not, and reads shortest floats back exactly.
            table = arrow_json.read_json(
                io.BytesIO("\n".join(piece).encode()),
                read_options=arrow_json.ReadOptions(use_threads=False),
                parse_options=arrow_json.ParseOptions(explicit_schema=schema, unexpected_field_behavior="error"),
            )
            file.write_table(table.combine_chunks())


def read_rows(path: Path, columns: Mapping[str, str] | None = None) -> list[dict[str, Any]]:
    """Read the rows that :func:`write_rows` wrote, of those ``columns`` if they are given.

    Raises
    ------
    StoreError
        If the file is damaged, or has other columns.
    """
    import pyarrow as pa
    import pyarrow.parquet as parquet

    try:
        with parquet.ParquetFile(path, page_checksum_verification=True) as file:
            found = {field.name: field.type for field in file.schema_arrow}
            if columns is not None and found != {name: pa.type_for_alias(kind) for name, kind in columns.items()}:
                raise StoreError(f"{path} has other columns than this version writes: run again")
            _check_size(file.metadata, path.stat().st_size)
            rows: list[dict[str, Any]] = file.read(use_threads=False).to_pylist()
            return rows
    except (OSError, ValueError, pa.ArrowException) as error:
        raise StoreError(f"{path} is damaged ({error}): run again") from error


#: Rows, and bytes unpacked, for each byte of a file. Columns of one value pack well, but not without end.
_MOST_ROWS, _MOST_BYTES = 64, 1024


def _check_size(facts: Any, size: int) -> None:
    """Raise a ``ValueError`` where the numbers by which the reader reserves memory cannot be of a file of ``size`` bytes."""
    groups = [facts.row_group(index) for index in range(facts.num_row_groups)]
    counts = [group.num_rows for group in groups]
    if any(count < 0 for count in counts) or sum(counts) != facts.num_rows or facts.num_rows > _MOST_ROWS * size:
        raise ValueError(f"{facts.num_rows} rows in groups of {counts[:5]} in {size} bytes")
    for group in groups:
        for index in range(group.num_columns):
            column = group.column(index)
            if column.num_values != group.num_rows:
                raise ValueError(f"column {index} has {column.num_values} values in {group.num_rows} rows")
            if not 0 <= column.total_uncompressed_size <= _MOST_BYTES * size:
                raise ValueError(f"column {index} unpacks to {column.total_uncompressed_size} bytes")
