"""Simulated observers: what they see is found, what they do not see is not, and they say what they are."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from eval.ratings.exclusion import exclude_inattentive
from eval.ratings.observers import ObserverModel, flaw_losses, observe, target_evidence
from eval.ratings.reading import SIMULATED, read_ratings
from eval.ratings.writing import write_ratings


def read_back(tmp_path, observed, stimuli):
    path = tmp_path / "ratings.csv"
    write_ratings(path, observed.ratings, kind=SIMULATED, remarks=observed.notes)
    return path, read_ratings(path, stimuli)


def test_answers_are_in_the_format_of_a_ratings_file_and_say_what_they_are(tmp_path, stimuli, scores, rng):
    path, ratings = read_back(tmp_path, observe(stimuli, scores, rng=rng, raters=6), stimuli)
    assert path.read_text().startswith(f"# {SIMULATED}\n")
    assert ratings.simulated and ratings.kind == SIMULATED
    assert len(ratings.raters) == 7  # one careless on top of six
    assert len(ratings.table) == 7 * len(stimuli)
    assert not ratings.table[["child", "naturalness", "action"]].isna().any().any()
    for _, pages in ratings.table.groupby("rater"):
        assert sorted(pages["order"]) == list(range(1, len(stimuli) + 1))
    assert ratings.table["naturalness"].between(1, 7).all()


def test_the_same_generator_gives_the_same_answers(stimuli, scores):
    first, again, other = (observe(stimuli, scores, rng=np.random.default_rng(seed), raters=4) for seed in (1, 1, 2))
    assert first.ratings.equals(again.ratings)
    assert not first.ratings.equals(other.ratings)


def test_what_the_scores_say_is_answered(stimuli, scores, rng):
    observed = observe(stimuli, scores, rng=rng, raters=60)
    table = observed.ratings.merge(stimuli[["stimulus", "condition"]], on="stimulus")
    says_child = (table["style"] == "child").groupby(table["condition"]).mean()
    natural = table.groupby("condition")["naturalness"].mean()
    assert says_child["adult"] < 0.4 < 0.5 < says_child["ours"] < says_child["child"]
    assert natural["theirs"] < natural["child"] - 1.0
    assert abs(natural["adult"] - natural["child"]) < 0.5
    assert 4.8 < natural["child"] < 6.2


def test_without_bias_and_clips_the_share_is_the_model_s(stimuli, scores):
    model = ObserverModel(sensitivity=1.0, bias_sd=0, clip_sd=0, stimulus_sd=0, lapse=0.0, careless=0.0)
    observed = observe(stimuli, scores, rng=np.random.default_rng(3), raters=400, model=model)
    table = observed.ratings.merge(observed.evidence, on="stimulus")
    shares = (table["style"] == "child").groupby(table["condition"]).mean()
    for condition, expected in {"adult": 0.15, "ours": 0.6, "theirs": 0.2, "child": 0.85}.items():
        assert shares[condition] == pytest.approx(expected, abs=4 * np.sqrt(0.25 / 4000))
    assert np.allclose(observed.evidence["p_target"], scores["recognition/p-target-kinematic"])


def test_lapses_and_confusions_have_their_rates(stimuli, scores):
    model = ObserverModel(lapse=0.0, careless=0.0, confusion=0.2)
    observed = observe(stimuli, scores, rng=np.random.default_rng(4), raters=200, model=model)
    table = observed.ratings.merge(stimuli, on="stimulus", suffixes=("", "_shown"))
    assert (table["action"] == table["action_shown"]).mean() == pytest.approx(0.8, abs=0.02)
    lapsing = ObserverModel(lapse=1.0, careless=0.0)
    guessed = observe(stimuli, scores, rng=np.random.default_rng(5), raters=200, model=lapsing).ratings
    assert (guessed["style"] == "child").mean() == pytest.approx(0.5, abs=0.03)
    assert np.allclose(guessed["naturalness"].value_counts(normalize=True), 1 / 7, atol=0.02)


def test_careless_observers_come_on_top_and_the_attention_rule_finds_them(tmp_path, stimuli, scores, rng):
    four = stimuli.assign(expected=[f"action{index % 6}" for index in range(len(stimuli))])
    four["action"] = four["expected"]
    _, ratings = read_back(tmp_path, observe(four, scores, rng=rng, raters=36), four)
    assert len(ratings.raters) == 41
    exclusion = exclude_inattentive(ratings)
    assert len(exclusion.kept.raters) == 36
    assert exclusion.raters["excluded"].sum() == 5
    assert "5 of 41 raters" in exclusion.sentence and "declared before the analysis" in exclusion.sentence


def test_half_right_is_not_enough_and_unanswered_is_wrong(tmp_path, stimuli):
    few = stimuli.iloc[:4]
    rows = [("half", "walk"), ("half", few["expected"][1]), ("more", few["expected"][0]), ("silent", "")]
    lines = [f"{rater},s{index:03d},adult,5,{answer}" for index, (rater, answer) in enumerate(rows)]
    lines.append(f"more,s001,adult,5,{few['expected'][1]}")
    path = tmp_path / "ratings.csv"
    path.write_text("rater,stimulus,style,naturalness,action\n" + "\n".join(lines) + "\n")
    exclusion = exclude_inattentive(read_ratings(path, stimuli))
    assert exclusion.kept.raters == ["more"]
    assert dict(zip(exclusion.raters["rater"], exclusion.raters["share"], strict=True)) == {
        "half": 0.5,
        "more": 1.0,
        "silent": 0.0,
    }


def test_nobody_is_excluded_where_the_action_was_not_asked(tmp_path, stimuli):
    path = tmp_path / "ratings.csv"
    path.write_text("rater,stimulus,style,naturalness\nr1,s000,adult,5\n")
    exclusion = exclude_inattentive(read_ratings(path, stimuli))
    assert exclusion.kept.raters == ["r1"]
    assert "nobody could be excluded" in exclusion.sentence


def test_nobody_is_excluded_where_no_stimulus_checks_attention(tmp_path, stimuli):
    path = tmp_path / "ratings.csv"
    path.write_text("rater,stimulus,style,naturalness,action\nr1,s000,adult,5,swimming\nr2,s001,adult,5,\n")
    unchecked = read_ratings(path, stimuli.assign(attention=False))
    assert exclude_inattentive(unchecked).kept.raters == ["r1", "r2"]
    # With a check on the first stimulus alone, neither a wrong answer nor none shows attention.
    some = read_ratings(path, stimuli.assign(attention=stimuli["stimulus"] == "s000"))
    assert exclude_inattentive(some).kept.raters == []


def test_without_a_recognition_score_liveliness_stands_in_and_is_said(stimuli, scores):
    ratio = stimuli["condition"].map({"adult": 0.5, "ours": np.sqrt(0.5), "theirs": 0.5, "child": 1.0})
    plain = scores.drop(columns="recognition/p-target-kinematic").assign(**{"style/speed-ratio": ratio})
    table = stimuli.merge(plain, on="stimulus")
    z, note = target_evidence(table, ("adult", "child"))
    by_condition = pd.Series(z).groupby(table["condition"]).mean()
    assert by_condition["ours"] == pytest.approx(0.0, abs=1e-12)
    assert by_condition["adult"] == by_condition["theirs"] == pytest.approx(-by_condition["child"])
    assert by_condition["child"] == pytest.approx(1.176, abs=0.01)  # probit of 1 / (1 + exp(-2))
    assert "no recognition score" in note and "style/speed-ratio" in note


def test_without_any_evidence_everything_is_undecided(stimuli, scores):
    table = stimuli.merge(scores[["stimulus"]], on="stimulus")
    z, note = target_evidence(table, ("adult", "child"))
    assert not z.any() and "undecided" in note
    loss, note = flaw_losses(table, ("adult", "child"), ObserverModel())
    assert not loss.any() and "nothing looks unnatural" in note


def test_flaws_are_what_real_performers_do_not_do(stimuli, scores):
    model = ObserverModel()
    noisy = scores.assign(**{"physics/foot-skate-ratio": np.where(stimuli["condition"] == "ours", 0.35, 0.3)})
    loss, _ = flaw_losses(stimuli.merge(noisy, on="stimulus"), ("adult", "child"), model)
    of = pd.Series(loss).groupby(stimuli["condition"]).mean()
    assert of["adult"] == of["child"] == 0.0
    assert of["ours"] == pytest.approx(0.5 * 0.05 / 0.1)
    assert of["theirs"] == model.worst  # three doublings of jerk, and no more than the cap
    too_smooth = scores.assign(**{"physics/jerk-ratio": np.where(stimuli["condition"] == "theirs", 0.5, 1.0)})
    loss, _ = flaw_losses(stimuli.merge(too_smooth, on="stimulus"), ("adult", "child"), model)
    assert loss[stimuli["condition"] == "theirs"] == pytest.approx(0.9)


@pytest.mark.parametrize(
    "change",
    [
        {"thresholds": (0.0, 1.0)},
        {"thresholds": (0, 0, 1, 2, 3, 4)},
        {"lapse": 1.2},
        {"confusion": -0.1},
        {"bias_sd": -1.0},
    ],
)
def test_impossible_parameters_are_refused(change):
    with pytest.raises(ValueError, match=next(iter(change))):
        ObserverModel(**change)


def test_an_observer_needs_company_and_scores(stimuli, scores, rng):
    with pytest.raises(ValueError, match="two or more"):
        observe(stimuli, scores, rng=rng, raters=1)
    with pytest.raises(ValueError, match="no scores for the stimuli s000"):
        observe(stimuli, scores.iloc[1:], rng=rng)
