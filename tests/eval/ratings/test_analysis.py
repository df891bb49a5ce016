"""The analysis of ratings: planted truth is found, null effects are not, and holes are said."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from benchmark.errors import DataError
from eval.ratings.analysis import Plan, analyse, rater_cells
from eval.ratings.observers import ObserverModel, observe
from eval.ratings.reading import SIMULATED, read_ratings
from eval.ratings.words import mixed_words
from eval.ratings.writing import write_ratings, write_table
from eval.stats import pigeonhole_bootstrap, rm_anova

PLAN = Plan(resamples=500)


def rated(folder, observed, stimuli):
    path = folder / "ratings.csv"
    write_ratings(path, observed.ratings, kind=SIMULATED)
    return read_ratings(path, stimuli)


@pytest.fixture(scope="module")
def ratings(tmp_path_factory, stimuli, scores):
    return rated(
        tmp_path_factory.mktemp("planted"), observe(stimuli, scores, rng=np.random.default_rng(8), raters=30), stimuli
    )


@pytest.fixture(scope="module")
def analysis(ratings):
    return analyse(ratings, PLAN)


def contrast(analysis, question, a, b):
    table = analysis.tables["contrasts"]
    rows = table[(table["sample"] == "attentive") & (table["question"] == question)]
    row = rows[(rows["a"].isin([a, b])) & (rows["b"].isin([a, b]))].iloc[0]
    return row, 1 if row["a"] == a else -1


def test_planted_differences_are_found(analysis):
    for more, less in (("child", "adult"), ("ours", "adult"), ("child", "theirs"), ("ours", "theirs")):
        row, sign = contrast(analysis, "child", more, less)
        assert row["reject"] and sign * row["diff"] > 0
        assert row["low_clips"] * row["high_clips"] > 0
    for better in ("adult", "ours", "child"):
        row, sign = contrast(analysis, "naturalness", better, "theirs")
        assert row["reject"] and sign * row["diff"] > 1
    anova = analysis.tables["anova"]
    main = anova[(anova["sample"] == "attentive") & (anova["design"] == "repeated measures")]
    assert (main["p_gg"] < 1e-4).all()
    assert analysis.tables["ranks"]["condition"].iloc[-1] == "theirs"
    assert not analysis.tables["equivalence"]["equivalent"].all()
    text = " ".join(sentence for sentences in analysis.sections.values() for sentence in sentences)
    assert "child was called 'child' more often than adult" in text
    assert "theirs was not shown to be within 10 points of real child motion" in text


def test_numbers_are_those_of_the_answers(ratings, analysis):
    kept = ratings.table[~ratings.table["rater"].isin(analysis.tables["raters"].query("excluded")["rater"])]
    shares = kept.groupby("condition")["child"].mean()
    natural = kept.groupby("condition")["naturalness"].mean()
    for row in analysis.tables["conditions"].itertuples():
        assert row.child_share == pytest.approx(shares[row.condition])
        assert row.naturalness_mean == pytest.approx(natural[row.condition])
        assert row.child_low < row.child_share < row.child_high
    assert analysis.tables["conditions"]["condition"].tolist() == ["adult", "ours", "theirs", "child"]
    row, sign = contrast(analysis, "child", "ours", "adult")
    assert sign * row["diff"] == pytest.approx(shares["ours"] - shares["adult"])
    assert row["diff"] == pytest.approx(row["diff_answers"])
    cells = analysis.tables["cells"].query("sample == 'attentive'")
    wide = cells.pivot(index="rater", columns="condition", values="child")
    n, k = wide.shape
    residual = wide.to_numpy() - wide.mean(axis=1).to_numpy()[:, None] - wide.mean().to_numpy() + wide.to_numpy().mean()
    F = n * ((wide.mean() - wide.to_numpy().mean()) ** 2).sum() / (k - 1) / ((residual**2).sum() / ((n - 1) * (k - 1)))
    anova = analysis.tables["anova"].query(
        "sample == 'attentive' and question == 'child' and design == 'repeated measures'"
    )
    assert anova["F"].item() == pytest.approx(F)
    assert (anova["df1"].item(), anova["df2"].item()) == (k - 1, (n - 1) * (k - 1))


def test_clips_count_in_both_questions(ratings, analysis):
    contrasts = analysis.tables["contrasts"].query("sample == 'attentive'")
    width = {
        question: (rows["high_clips"] - rows["low_clips"]).mean() / (rows["high"] - rows["low"]).mean()
        for question, rows in contrasts.groupby("question")
    }
    assert all(ratio > 1.1 for ratio in width.values())  # clips vary, too
    assert contrasts["p_shaffer"].le(contrasts["p_holm"] + 1e-15).all() and contrasts["p_shaffer"].notna().all()
    for row in analysis.tables["conditions"].itertuples():
        assert row.naturalness_low_clips < row.naturalness_mean < row.naturalness_high_clips
    tests = analysis.tables["equivalence"].groupby("question")["test"].agg(set)
    assert all(found == {"paired t", "rater x clip bootstrap"} for found in tests)


def test_the_mixed_model_tells_the_same_story(ratings, analysis):
    mixed = analysis.tables["mixed"].set_index(["question", "a"])
    assert mixed["converged"].all() and set(mixed["b"]) == {"adult"}
    for question in ("child", "naturalness"):
        for condition in ("ours", "theirs", "child"):
            row, sign = contrast(analysis, question, condition, "adult")
            assert mixed.loc[(question, condition), "diff"] == pytest.approx(sign * row["diff"], abs=1e-6)
    assert mixed.loc[("child", "child"), "p"] < 0.001 and mixed.loc[("naturalness", "theirs"), "high"] < 0
    text = " ".join(analysis.sections["Replication and robustness"])
    assert (
        "Linear mixed model of the share of target-style answers, raters and clips both random: against adult" in text
    )


def test_a_mixed_model_that_did_not_converge_says_nothing_else():
    table = pd.DataFrame(
        [{"a": "x", "p": 0.0, "converged": False, "note": "the fit did not converge (LIMIT): disregard"}]
    )
    text = mixed_words(table, "naturalness", "adult", 0.05)
    assert text.endswith("raters and clips both random: the fit did not converge (LIMIT): disregard.")


def test_the_study_of_2020_has_its_degrees_of_freedom(tmp_path):
    five = pd.DataFrame(
        [
            {
                "stimulus": f"s{i}",
                "condition": c,
                "clip_id": f"k{i // 5}",
                "action": "walk",
                "actor": "",
                "attention": True,
            }
            for i, c in enumerate(["adult", "child", "ours", "holden", "aberman"] * 10)
        ]
    ).assign(expected="walk")
    scores = pd.DataFrame({"stimulus": five["stimulus"]})
    careful = ObserverModel(careless=0.0)
    ratings = rated(tmp_path, observe(five, scores, rng=np.random.default_rng(0), raters=36, model=careful), five)
    anova = analyse(ratings, PLAN).tables["anova"].query("question == 'child'")
    assert anova.loc[anova["design"] == "repeated measures", ["df1", "df2"]].to_numpy().tolist() == [[4, 140]]


def test_everything_not_from_people_says_so(tmp_path, analysis):
    assert analysis.kind == SIMULATED
    for name, table in analysis.tables.items():
        path = tmp_path / f"{name}.csv"
        write_table(path, table, kind=analysis.kind)
        assert (pd.read_csv(path)["kind"] == SIMULATED).all()


def test_the_sensitivity_analysis_is_of_all_raters(tmp_path, stimuli, scores):
    many = stimuli.assign(expected=[f"action{index % 8}" for index in range(len(stimuli))])
    observed = observe(many, scores, rng=np.random.default_rng(1), raters=15)
    analysis = analyse(rated(tmp_path, observed, many), PLAN)
    excluded = int(analysis.tables["raters"]["excluded"].sum())
    assert excluded == 2
    counts = analysis.tables["contrasts"].groupby("sample")["n"].first()
    assert counts["all"] == counts["attentive"] + excluded == 17
    assert "With all 17 raters instead of the 15 who count" in analysis.sections["Sensitivity"][0]


def test_missing_answers_are_left_out_and_raters_without_a_condition_too(tmp_path, stimuli, scores):
    observed = observe(stimuli, scores, rng=np.random.default_rng(2), raters=12, model=ObserverModel(careless=0.0))
    table = observed.ratings.astype({"naturalness": object})
    ours = set(stimuli.loc[stimuli["condition"] == "ours", "stimulus"])
    table.loc[(table["rater"] == "o01") & table["stimulus"].isin(ours), "naturalness"] = ""
    table = table[~((table["rater"] == "o02") & (table["stimulus"] == "s005"))]
    path = tmp_path / "holes.csv"
    write_ratings(path, table, kind=SIMULATED)
    ratings = read_ratings(path, stimuli)
    analysis = analyse(ratings, PLAN)
    main = (
        analysis.tables["anova"].query("sample == 'attentive' and design == 'repeated measures'").set_index("question")
    )
    assert main.loc["child", ["n", "n_dropped"]].tolist() == [12, 0]
    assert main.loc["naturalness", ["n", "n_dropped"]].tolist() == [11, 1]
    text = " ".join(analysis.sections["Raters"])
    assert "10 of 1437 answers are missing (naturalness 10)" in text
    assert "1 raters did not see every stimulus: o02 (39 of 40)" in text
    assert any("1 subjects lack a condition (o01)" in sentence for sentence in analysis.sections["Assumptions"])


def test_a_file_without_actions_or_real_motion_is_analysed_too(tmp_path, stimuli, scores):
    plain = stimuli[stimuli["condition"].isin(["ours", "theirs"])].reset_index(drop=True)
    observed = observe(plain, scores, rng=np.random.default_rng(3), raters=10)
    path = tmp_path / "plain.csv"
    write_ratings(path, observed.ratings.drop(columns="action"), kind=SIMULATED)
    analysis = analyse(read_ratings(path, plain), PLAN)
    assert analysis.tables["actions"].empty and analysis.tables["equivalence"].empty
    assert "no condition 'child' of real motion" in " ".join(analysis.sections["Against real motion"])
    assert len(analysis.sections["Among methods"]) == 2


def test_answers_all_alike_break_nothing(tmp_path, stimuli):
    rows = [f"r{r},{s},child,4" for r in range(4) for s in stimuli["stimulus"]]
    path = tmp_path / "same.csv"
    path.write_text("rater,stimulus,style,naturalness\n" + "\n".join(rows) + "\n")
    analysis = analyse(read_ratings(path, stimuli), PLAN)
    assert not analysis.tables["contrasts"]["reject"].any()
    assert "does not vary" in " ".join(analysis.sections["Main effect"])
    assert "odds ratios could not be estimated" in " ".join(analysis.sections["Replication and robustness"])
    equal = analysis.tables["equivalence"]
    assert equal["equivalent"].all()  # nothing could be more equivalent


def test_two_raters_are_too_few(tmp_path, stimuli):
    rows = [f"r{r},{s},child,4" for r in range(2) for s in stimuli["stimulus"]]
    path = tmp_path / "two.csv"
    path.write_text("rater,stimulus,style,naturalness\n" + "\n".join(rows) + "\n")
    with pytest.raises(DataError, match=r"2 of 2 raters count .* three or more are needed"):
        analyse(read_ratings(path, stimuli), PLAN)


def test_answers_to_one_condition_are_no_comparison(tmp_path, stimuli):
    rows = [f"r{r},{s},child,4" for r in range(4) for s in stimuli.loc[stimuli["condition"] == "ours", "stimulus"]]
    path = tmp_path / "one.csv"
    path.write_text("rater,stimulus,style,naturalness\n" + "\n".join(rows) + "\n")
    with pytest.raises(DataError, match=r"answers to 1 condition\(s\) are no comparison"):
        analyse(read_ratings(path, stimuli), PLAN)


def null_cells(stimuli, scores, model, seed):
    table = observe(stimuli, scores, rng=np.random.default_rng(seed), raters=12, model=model).ratings
    table = table.merge(stimuli[["stimulus", "condition", "clip_id"]], on="stimulus")
    return table.assign(child=(table["style"] == "child").astype(float))


def test_without_an_effect_one_in_twenty_analyses_finds_one(stimuli):
    scores = pd.DataFrame({"stimulus": stimuli["stimulus"], "recognition/p-target-kinematic": 0.5})
    same = ObserverModel(stimulus_sd=0.0, careless=0.0)
    found = 0
    for seed in range(120):
        cells = null_cells(stimuli, scores, same, seed).groupby(["rater", "condition"], as_index=False)["child"].mean()
        found += rm_anova(cells, subject="rater", within="condition", value="child")["p_gg"].item() < 0.05
    # 99.9 % of binomial(120, 0.05) lie between 1 and 14.
    assert 1 <= found <= 14


def test_clips_that_differ_by_chance_fool_tests_over_raters_and_not_the_bootstrap_over_clips(stimuli):
    scores = pd.DataFrame({"stimulus": stimuli["stimulus"], "recognition/p-target-kinematic": 0.5})
    different = ObserverModel(stimulus_sd=0.6, clip_sd=0.0, careless=0.0)
    by_raters, by_clips, runs = 0, 0, 40
    for seed in range(runs):
        table = null_cells(stimuli, scores, different, seed)
        cells = table.groupby(["rater", "condition"], as_index=False)["child"].mean()
        by_raters += rm_anova(cells, subject="rater", within="condition", value="child")["p_gg"].item() < 0.05
        drawn = pigeonhole_bootstrap(
            table,
            rater="rater",
            clip="clip_id",
            condition="condition",
            answer="child",
            pairs=[("adult", "ours")],
            resamples=400,
        )
        row = drawn[drawn["quantity"] == "difference"].iloc[0]
        by_clips += row["low"] > 0 or row["high"] < 0
    assert by_raters > 0.4 * runs
    # 99.9 % of binomial(40, 0.05) lie at 8 or below.
    assert by_clips <= 8


def test_means_of_a_rater_are_of_what_was_answered(ratings):
    cells = rater_cells(ratings)
    assert (cells["pages"] == 10).all()
    first = ratings.table[(ratings.table["rater"] == "o01") & (ratings.table["condition"] == "ours")]
    row = cells[(cells["rater"] == "o01") & (cells["condition"] == "ours")].iloc[0]
    assert row["child"] == first["child"].mean() and row["correct"] == first["correct"].mean()
