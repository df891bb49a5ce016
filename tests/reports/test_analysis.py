from __future__ import annotations

import shutil

import pandas as pd
import pytest

from eval.ratings.reading import PEOPLE, SIMULATED
from reports.analysis import analyse_run


@pytest.fixture
def run(finished, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(finished, folder)
    shutil.rmtree(folder / "stats", ignore_errors=True)
    return folder


def test_a_run_ends_with_comparisons_and_simulated_ratings(run):
    first, second, third = analyse_run(run)
    assert str(run / "stats") in first
    assert SIMULATED in second
    assert (run / "stats" / "metrics-comparison.csv").is_file()
    assert str(run / "stats" / "claims.csv") in third
    verdicts = pd.read_csv(run / "stats" / "claims.csv")["verdict"]
    assert set(verdicts) <= {"holds", "does not hold", "cannot be tested here"} and len(verdicts) > 20
    assert SIMULATED in (run / "stats" / "ratings.md").read_text(encoding="utf-8").lower()


def test_ratings_by_people_stay(run):
    (run / "stats").mkdir()
    kept = run / "stats" / "ratings-conditions.csv"
    kept.write_text(f"condition,kind\nadult,{PEOPLE}\n", encoding="utf-8")
    _, second, _ = analyse_run(run)
    assert second.startswith("no simulated ratings")
    assert kept.read_text(encoding="utf-8").endswith(f"adult,{PEOPLE}\n")
