from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner, Result

from benchmark.cli import cli

ARGUMENTS = ["metrics-check", "--metrics", "physics/jerk-ratio,truth/*", "--corruptions", "noise,foot-slide,no-style"]


@pytest.fixture(scope="module")
def outcome(tmp_path_factory: pytest.TempPathFactory) -> tuple[Result, Path]:
    folder = tmp_path_factory.mktemp("check") / "out"
    arguments = [*ARGUMENTS, "--clips", "4", "--jobs", "1", "--out", str(folder)]
    return CliRunner().invoke(cli, arguments, catch_exceptions=False), folder


def test_what_it_prints(outcome: tuple[Result, Path]) -> None:
    result, folder = outcome
    assert result.exit_code == 0
    assert "jerk-ratio" in result.output
    assert "foot slide" in result.output
    assert "declared expectations hold; 2 metrics, 3 faults, 4 clips" in result.output
    assert str(folder / "metrics-check.png") in result.output


def test_the_files_it_writes(outcome: tuple[Result, Path]) -> None:
    _, folder = outcome
    assert {path.name for path in folder.iterdir()} == {
        *(f"metrics-check.{kind}" for kind in ("png", "pdf", "csv", "md", "tex")),
        "values.csv",
    }
    assert (folder / "metrics-check.png").read_bytes().startswith(b"\x89PNG")
    assert (folder / "metrics-check.pdf").read_bytes().startswith(b"%PDF")


def test_the_summary_agrees_with_the_values(outcome: tuple[Result, Path]) -> None:
    _, folder = outcome
    summary = pd.read_csv(folder / "metrics-check.csv")
    values = pd.read_csv(folder / "values.csv")
    assert len(summary) == 2 * 3
    row = summary[(summary["metric"] == "physics/jerk-ratio") & (summary["corruption"] == "noise")].iloc[0]
    assert (row["observed"], row["expected"], row["as_expected"]) == ("ordered", "worse with every grade", "yes")
    assert row["first_seen_amount"] == "0.25°"
    part = values[(values["metric"] == "physics/jerk-ratio") & (values["corruption"] == "noise")]
    for grade in range(1, 5):
        assert row[f"mean_{grade}"] == pytest.approx(part.loc[part["grade"] == grade, "value"].mean())
    assert np.isnan(summary.loc[summary["corruption"] == "no-style", "mean_2"]).all()


def test_the_tables_can_be_read(outcome: tuple[Result, Path]) -> None:
    _, folder = outcome
    markdown = (folder / "metrics-check.md").read_text(encoding="utf-8")
    assert "| metric | noise | foot slide | no style |" in markdown
    assert "| jerk-ratio → 1 | ●1 |" in markdown
    latex = (folder / "metrics-check.tex").read_text(encoding="utf-8")
    assert latex.count(r"\\") == 1 + 2 + 2
    assert r"\toprule" in latex
    assert latex.count("{") == latex.count("}")


def test_what_it_refuses() -> None:
    for options, message in (
        (["--metrics", "physics/jerk-ration"], "jerk-ratio"),
        (["--corruptions", "nois"], "noise"),
        (["--dataset", "kinder-gator"], "true performances"),
    ):
        with pytest.raises(Exception, match=message):
            CliRunner().invoke(cli, ["metrics-check", *options], catch_exceptions=False)
