from __future__ import annotations

import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.runner.parquet import read_rows, write_rows

COLUMNS = {"text": "string", "flag": "bool", "count": "int64", "value": "double"}
ROWS = st.lists(
    st.fixed_dictionaries(
        {
            "text": st.none() | st.text(st.characters(exclude_categories=["Cs"])),
            "flag": st.none() | st.booleans(),
            "count": st.integers(-(2**63), 2**63 - 1),
            "value": st.none() | st.floats(allow_nan=False, allow_infinity=False),
        }
    ),
    max_size=6,
)


@settings(max_examples=60, deadline=None)
@given(rows=ROWS)
def test_rows_come_back_exactly(rows, tmp_path_factory):
    path = tmp_path_factory.getbasetemp() / "rows.parquet"
    write_rows(path, rows, COLUMNS)
    again = read_rows(path)
    assert again == rows
    assert [str(row["value"]) for row in again] == [str(row["value"]) for row in rows]  # the sign of zero too


def test_others_read_the_types(tmp_path):
    import pandas as pd

    rows = [
        {"text": "ü", "flag": True, "count": 2**62 + 1, "value": 0.1},
        {"text": "", "flag": None, "count": 0, "value": None},
    ]
    write_rows(tmp_path / "a.parquet", rows, COLUMNS)
    frame = pd.read_parquet(tmp_path / "a.parquet")
    assert list(frame.columns) == list(COLUMNS)
    assert frame["count"].dtype == np.int64
    assert frame["value"].dtype == np.float64
    assert frame["count"][0] == 2**62 + 1
    write_rows(tmp_path / "none.parquet", [], COLUMNS)
    assert list(pd.read_parquet(tmp_path / "none.parquet").columns) == list(COLUMNS)


def test_nan_and_missing_columns_are_refused(tmp_path):
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_rows(tmp_path / "a", [{"text": "", "flag": None, "count": 0, "value": float("nan")}], COLUMNS)
    with pytest.raises(KeyError):
        write_rows(tmp_path / "a", [{"text": ""}], COLUMNS)
    assert not list(tmp_path.iterdir())


def test_no_pandas_is_imported(tmp_path):
    import subprocess

    script = (
        "import sys; from pathlib import Path; from benchmark.runner.parquet import read_rows, write_rows\n"
        "write_rows(Path(sys.argv[1]), [{'a': 'x'}], {'a': 'string'}); read_rows(Path(sys.argv[1]))\n"
        "assert 'pandas' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", script, str(tmp_path / "a.parquet")], check=True)
