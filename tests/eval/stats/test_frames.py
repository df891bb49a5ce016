"""Tables that no analysis should swallow are refused with a message that helps."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pandas as pd
import pytest

from eval import stats as stats_package
from eval.stats.frames import binary, levels_of, to_wide

RM = {"subject": "rater", "within": "method", "value": "score"}


def test_matrix_has_subjects_and_cells_in_order(long):
    y = np.arange(12.0).reshape(4, 3)
    wide = to_wide(long(y).sample(frac=1.0, random_state=1), **RM)
    assert wide.values.tolist() == y.tolist()
    assert wide.levels == [["a", "b", "c"]]
    assert wide.subjects == ["r000", "r001", "r002", "r003"]


def test_several_factors_run_with_the_last_fastest():
    rows = [(s, a, b, 100 * s + 10 * a + b) for s in (0, 1) for a in (1, 2) for b in (3, 4, 5)]
    df = pd.DataFrame(rows, columns=["s", "a", "b", "v"]).sample(frac=1.0, random_state=2)
    wide = to_wide(df, subject="s", within=["a", "b"], value="v")
    assert wide.values[1].tolist() == [113, 114, 115, 123, 124, 125]


def test_categories_set_the_order(long):
    df = long(np.eye(3))
    df["method"] = pd.Categorical(df["method"], categories=["c", "unused", "a", "b"])
    assert to_wide(df, **RM).levels == [["c", "a", "b"]]
    assert levels_of(pd.Series([3, "x", 1])) == [1, 3, "x"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda df: df.drop(columns="score"), "no column score; the table has rater, method"),
        (lambda df: df.iloc[:0], "no rows"),
        (lambda df: df.assign(score="high"), "column score must hold numbers"),
        (lambda df: df.assign(score=np.inf), "infinite values in 9 rows"),
        (lambda df: df.assign(method=None), "column method has 9 rows without a label"),
        (lambda df: df[df["rater"] == "r000"], "at least 2 complete subjects and 2 conditions, got 1 and 3"),
        (lambda df: df[df["method"] == "a"], "got 3 and 1"),
    ],
)
def test_refusals(long, change, message):
    with pytest.raises(ValueError, match=message):
        to_wide(change(long(np.eye(3))), **RM)


def test_unknown_options(long):
    with pytest.raises(ValueError, match='missing must be "error" or "drop"'):
        to_wide(long(np.eye(3)), **RM, missing="ignore")
    with pytest.raises(ValueError, match='aggregate must be None or "mean"'):
        to_wide(long(np.eye(3)), **RM, aggregate="median")


def test_long_lists_of_subjects_are_cut(long):
    with pytest.raises(ValueError, match=r"r007 and 12 more"):
        df = long(np.ones((21, 2)))
        to_wide(df[(df["method"] == "a") | (df["rater"] == "r020")], **RM)


def test_answers_are_zero_or_one():
    assert binary(pd.DataFrame({"y": [True, False]}), "y").tolist() == [1.0, 0.0]
    with pytest.raises(ValueError, match=r"must be 0 or 1 in every row; 2 rows hold 2\.0, nan"):
        binary(pd.DataFrame({"y": [0, 2, None]}), "y")


def test_every_public_name_is_there_and_nothing_heavy_is_loaded():
    for name in stats_package.__all__:
        assert getattr(stats_package, name).__doc__, name
    code = (
        "import sys; from eval.stats import rm_anova, compare; "
        "heavy = {'torch', 'pandas', 'scipy.stats', 'statsmodels', 'sklearn', 'matplotlib'} & set(sys.modules); "
        "ours = [m for m in sys.modules if m.split('.')[0] in ('benchmark', 'methods', 'reports')]; "
        "sys.exit(f'{heavy} {ours}' if heavy or ours else 0)"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
