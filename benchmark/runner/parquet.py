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
            return _rows(file, path.stat().st_size)
    except (OSError, ValueError, pa.ArrowException) as error:
        raise StoreError(f"{path} is damaged ({error}): run again") from error


#: Rows, and bytes unpacked, for each byte of a file. Columns of one value pack well, but not without end.
_MOST_ROWS, _MOST_BYTES = 64, 1024

#: Rows unpacked at once, before it is known that they are not too large.
_BATCH = 1024


def _rows(file: Any, size: int) -> list[dict[str, Any]]:
    """The rows of an open file of ``size`` bytes; a ``ValueError`` where there are others than it says, or too many to be true.

    The facts about single columns, which would tell more beforehand, are not asked for: pyarrow ends the process where they
    contradict one another.
    """
    facts = file.metadata
    counts = [facts.row_group(index).num_rows for index in range(facts.num_row_groups)]
    if any(count < 0 for count in counts) or sum(counts) != facts.num_rows or facts.num_rows > _MOST_ROWS * size:
        raise ValueError(f"{facts.num_rows} rows in groups of {counts[:5]} in {size} bytes")
    rows: list[dict[str, Any]] = []
    unpacked = 0
    for batch in file.iter_batches(_BATCH, use_threads=False):
        unpacked += batch.nbytes
        if unpacked > _MOST_BYTES * size:
            raise ValueError(f"it unpacks to more than {_MOST_BYTES} times its size")
        rows += batch.to_pylist()
        if len(rows) > facts.num_rows:
            break
    if len(rows) != facts.num_rows:
        raise ValueError(f"it has not the {facts.num_rows} rows that it says")
    return rows
