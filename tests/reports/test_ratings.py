"""``analyze`` on a run that was really made, and how its LaTeX tables are written."""

from __future__ import annotations

import shutil

import numpy as np
import pandas as pd
import pytest

from benchmark.cli import call
from benchmark.errors import DataError
from eval.ratings.analysis import Analysis
from eval.ratings.reading import PEOPLE, SIMULATED, read_ratings, read_stimuli
from reports.comparison import compare_metrics
from reports.ratings import choose_stimuli, latex_anova, latex_tukey
from reports.run import RunView


@pytest.fixture(scope="module")
def analysed(finished, tmp_path_factory):
    folder = tmp_path_factory.mktemp("analysed") / "run"
    folder.mkdir()
    for name in ("results.parquet", "leaderboard.csv"):
        shutil.copy(finished / name, folder / name)
    assert call(["analyze", str(folder), "--raters", "8", "--quiet"]) == 0
    return folder


def test_a_run_is_rated_from_end_to_end(analysed):
    stats = analysed / "stats"
    ratings = read_ratings(stats / "ratings-answers.csv", read_stimuli(stats / "ratings-stimuli.csv"))
    assert ratings.simulated and ratings.conditions == ["adult", "dynamic-scaling[time]", "child"]
    assert len(ratings.raters) == 9 and len(ratings.stimuli) == 6
    conditions = pd.read_csv(stats / "ratings-conditions.csv")
    assert conditions["condition"].tolist() == ratings.conditions
    assert (
        "Only 2 clips have a result in every condition, fewer than the 10 asked for."
        in (stats / "ratings.md").read_text()
    )


def test_the_evidence_of_the_observers_is_that_of_the_run(analysed):
    evidence = pd.read_csv(analysed / "stats" / "ratings-evidence.csv").groupby("condition")["p_target"].mean()
    assert evidence["child"] > evidence["adult"]


def test_a_run_s_metrics_are_compared(analysed):
    run = RunView(analysed)
    comparison = compare_metrics(run, resamples=200)
    table, ranks = comparison.differences, comparison.ranks
    assert set(table["variant"]) == {"raw", "cleaned"} and set(table["task"]) == {"adult:child"}
    assert not table["metric"].str.startswith("cost/").any()
    assert (table["family"] == table["metric"].str.partition("/")[0]).all()
    rows = run.results[(run.results["status"] == "ok") & (run.results["variant"] == "raw")]
    values = rows[rows["metric"] == "style/pose-distance"].pivot_table(
        index="clip_id", columns="method", values="value"
    )
    row = table.query("metric == 'style/pose-distance' and variant == 'raw' and b == 'dynamic-scaling[time]'").iloc[0]
    assert row["a"] == "identity"
    assert row["diff"] == pytest.approx((values["identity"] - values["dynamic-scaling[time]"]).mean())
    assert set(ranks["method"]) == {"identity", "dynamic-scaling[time]"}
    assert not ranks["metric"].isin(["cost/fit_seconds"]).any() and set(ranks["direction"]) <= {
        "lower",
        "higher",
        "target",
    }


def test_the_choice_of_stimuli_depends_on_the_generator_alone(analysed):
    run = RunView(analysed)
    first, again, other = (choose_stimuli(run, "adult:child", rng=np.random.default_rng(seed))[0] for seed in (0, 0, 4))
    assert first.equals(again)
    assert not first["stimulus"].equals(other["stimulus"])


def test_a_task_without_results_has_nothing_to_show(analysed):
    with pytest.raises(DataError, match="no two methods have a result for the same clip of child:adult"):
        choose_stimuli(RunView(analysed), "child:adult", rng=np.random.default_rng(0))


def planted(kind):
    anova = pd.DataFrame(
        {
            "sample": ["attentive", "attentive", "all"],
            "design": ["repeated measures", "between", "repeated measures"],
            "question": ["child"] * 3,
            "df1": [4] * 3,
            "df2": [140, 175, 160],
            "F": [23.66, 1.0, 2.0],
            "p": [5.8e-15, 0.5, 0.5],
            "eps_gg": [0.91, np.nan, 0.9],
            "p_gg": [1e-13, np.nan, 0.5],
            "eta_p2": [0.403, 0.1, 0.1],
            "eta_p2_low": [0.287, 0.0, 0.0],
            "eta_p2_high": [0.476, 0.2, 0.2],
            "n": [36, 36, 41],
        }
    )
    pair = {"question": "child", "a": "adult", "b": "a_b%[time]"}
    tukey = pd.DataFrame(
        [
            {**pair, "error_term": "within raters", "diff": -0.123, "p": 0.04},
            {**pair, "error_term": "between raters (naive)", "diff": -0.123, "p": 0.3},
        ]
    )
    contrasts = pd.DataFrame(
        [
            {**pair, "sample": "attentive", "p_holm": 0.0501, "p_shaffer": 0.049, "n": 36},
            {**pair, "sample": "all", "p_holm": 0.9, "p_shaffer": 0.9, "n": 41},
        ]
    )
    return Analysis(kind, {"anova": anova, "tukey": tukey, "contrasts": contrasts}, {})


def test_latex_tables():
    anova, tukey = latex_anova(planted(PEOPLE)), latex_tukey(planted(PEOPLE))
    assert r"style & 4, 140 & 23.7 & $<$ .001 & 0.91 & $<$ .001 & 0.40 [0.29, 0.48] \\" in anova
    assert anova.count(r" \\") == 2 and "36 raters" in anova  # a head and one row
    assert r"style & adult -- a\_b\%[time] & -12 & .040 & .300 & .049 & .050 \\" in tukey
    for text in (anova, tukey):
        assert text.index(r"\toprule") < text.index(r"\midrule") < text.index(r"\bottomrule")
        assert "observers" not in text
    for text in (latex_anova(planted(SIMULATED)), latex_tukey(planted(SIMULATED))):
        assert r"\caption{Simulated observers, not people. " in text


def test_a_table_of_many_pairs_runs_on_over_pages():
    few = planted(SIMULATED)
    pairs = [(f"m{i}", f"m{j}") for i in range(10) for j in range(i + 1, 10)]

    def many(name):
        parts = [few.tables[name].assign(a=a, b=b) for a, b in pairs]
        return pd.concat(parts, ignore_index=True)

    text = latex_tukey(Analysis(SIMULATED, {"tukey": many("tukey"), "contrasts": many("contrasts")}, {}))
    lines = text.splitlines()
    assert "longtable" in lines[0] and text.count(r"\begin{longtable}") == text.count(r"\end{longtable}") == 1
    assert text.count("{") == text.count("}")
    # Every row has as many cells as the table has columns.
    rows = [line for line in lines if line.startswith(("question", "style"))]
    assert len(rows) == 2 + len(pairs) and {row.count(" & ") for row in rows} == {6}
    assert "llrrrrr" in text and SIMULATED.capitalize() in text and "36 raters" in text
