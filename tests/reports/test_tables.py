"""How numbers are written."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from reports.tables import arrow, column_names, latex_leaderboard, number, with_values


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (3e-15, "0"),
        (1.0, "1.00"),
        (12.345, "12.3"),
        (1234.5, "1,234"),
        (499123.0, "499,123"),
        (1.5e9, "1.50e+09"),
        (0.012345, "0.0123"),
        (1.5e-6, "1.50e-06"),
        (-2.5, "-2.50"),
        (float("nan"), "–"),
        (None, "–"),
    ],
)
def test_number(value, text):
    assert number(value) == text


def test_arrow():
    assert [arrow("lower", None), arrow("higher", float("nan")), arrow("target", 1.0), arrow("none", None)] == [
        "↓",
        "↑",
        "→ 1",
        "",
    ]


def test_a_name_that_two_groups_share_keeps_its_group():
    names = column_names(["content/pose-distance", "truth/pose-distance", "physics/jerk-ratio"])
    assert list(names.values()) == ["content/pose-distance", "truth/pose-distance", "jerk-ratio"]


def test_latex_escapes_what_it_would_read_as_a_command():
    columns = ["method", "label", "metric", "unit", "direction", "target", "mean", "low", "high", "n"]
    row = ("a", "a", "b/c", "1", "lower", float("nan"), 1.0, 1.0, 1.0, 2)
    tex = latex_leaderboard(pd.DataFrame([row], columns=columns), caption="folder:~/a^b{c}_d", label="t")
    assert r"\caption{folder:\textasciitilde{}/a\textasciicircum{}b\{c\}\_d}" in tex


def test_metrics_without_any_value_take_no_column() -> None:
    table = pd.DataFrame(
        {"method": ["a", "b", "a", "b"], "metric": ["x", "x", "y", "y"], "mean": [np.nan, 1.0, np.nan, np.nan]}
    )
    assert with_values(table)["metric"].tolist() == ["x", "x"]


def test_a_flipped_byte_in_the_results_is_refused(finished, tmp_path):
    import shutil

    from benchmark.errors import StoreError
    from reports.run import RunView

    for name in ("results.parquet", "leaderboard.csv"):
        shutil.copy(finished / name, tmp_path / name)
    content = bytearray((tmp_path / "results.parquet").read_bytes())
    content[len(content) // 3] ^= 1
    (tmp_path / "results.parquet").write_bytes(content)
    with pytest.raises(StoreError, match=r"results\.parquet is damaged"):
        _ = RunView(tmp_path).results
