"""Simulated raters through a real server in a process of its own."""

from __future__ import annotations

import asyncio
from contextlib import closing

import pandas as pd
import pytest

from benchmark.cli import call
from benchmark.errors import DataError
from eval.ratings.reading import SIMULATED, read_ratings, read_stimuli
from reports.study.analysis import analyse_study
from reports.study.export import export_ratings
from reports.study.plan import read_plan
from reports.study.schema import connect
from reports.study.simulate import SimulationError, drive, observe_study, simulate_study


def check_all_stored(study, sessions):
    """No answer is lost or doubled: every rater has every stimulus of his order once, in that order."""
    plan = read_plan(study)
    with closing(connect(study.database(rehearsal=True), read_only=True)) as connection:
        rows = connection.execute("SELECT rater, position, stimulus FROM answers ORDER BY rater, position").fetchall()
        slots = dict(connection.execute("SELECT id, slot FROM raters WHERE finished IS NOT NULL"))
    assert len(rows) == sessions * plan.pages and len(slots) == sessions
    of_rater: dict[int, list[str]] = {}
    for rater, position, stimulus in rows:
        assert position == len(of_rater.setdefault(rater, []))
        of_rater[rater].append(stimulus)
    assert all(tuple(shown) == plan.orders[slots[rater]].stimuli for rater, shown in of_rater.items())
    # The orders are used equally often.
    counts = pd.Series(list(slots.values())).value_counts()
    assert counts.max() - counts.min() <= 1


@pytest.fixture(scope="module")
def rehearsed(built, tmp_path_factory):
    """A study that 30 simulated raters took, all at once."""
    import shutil

    from reports.study.layout import StudyFolder

    folder = StudyFolder(tmp_path_factory.mktemp("rehearsed") / "study")
    shutil.copytree(built.path, folder.path)
    done = simulate_study(folder, 30)
    assert (done.sessions, done.pages) == (30, 210)
    return folder


def test_thirty_at_once_lose_no_answer(rehearsed):
    check_all_stored(rehearsed, 30)


@pytest.mark.slow
def test_two_hundred_at_once_lose_no_answer(study):
    assert simulate_study(study, 200).pages == 1400
    check_all_stored(study, 200)


def test_the_answers_are_those_of_the_observers(rehearsed, built):
    observed = observe_study(built, read_plan(built), 30).ratings
    export_ratings(rehearsed, rehearsed.path / "ratings.csv", rehearsal=True)
    text = (rehearsed.path / "ratings.csv").read_text()
    assert text.startswith(f"# {SIMULATED}\n")
    ratings = read_ratings(rehearsed.path / "ratings.csv", read_stimuli(rehearsed.key))
    assert ratings.simulated and set(pd.read_csv(rehearsed.path / "ratings.csv", comment="#")["kind"]) == {SIMULATED}
    columns = ["stimulus", "style", "naturalness"]
    found = ratings.table.assign(style=ratings.table["child"].map({1.0: "child", 0.0: "adult"}))
    assert sorted(map(tuple, found[columns].to_numpy())) == sorted(map(tuple, observed[columns].to_numpy()))
    # Every rater's sheet came through whole.
    sheets = {frozenset(map(tuple, rows[columns].to_numpy())) for _, rows in observed.groupby("rater")}
    assert {frozenset(map(tuple, rows[columns].to_numpy())) for _, rows in found.groupby("rater")} == sheets


def test_the_analysis_says_that_nobody_was_asked(rehearsed, capsys):
    assert call(["study", "analyze", str(rehearsed.path), "--rehearsal"]) == 0
    said = capsys.readouterr().out
    assert SIMULATED in said and "adult" in said
    stats = rehearsed.path / "rehearsal" / "stats"
    assert SIMULATED in (stats / "ratings.md").read_text()
    for table in stats.glob("ratings-*.csv"):
        assert set(pd.read_csv(table)["kind"]) == {SIMULATED}, table
    for name in ("ratings.png", "ratings.pdf", "ratings.csv"):
        assert (stats.parent / "figures" / name).is_file(), list((stats.parent / "figures").iterdir())
    conditions = pd.read_csv(stats / "ratings-conditions.csv")
    assert conditions["condition"].tolist() == ["adult", "bold", "child"]
    share = conditions.set_index("condition")["child_share"]
    assert share["adult"] < share["bold"] < share["child"]
    # People have not been asked, and simulated answers do not stand in for them.
    assert call(["study", "analyze", str(rehearsed.path)]) == 2
    assert "nobody has taken part" in capsys.readouterr().err


def test_another_rehearsal_has_other_observers(rehearsed, built):
    plan = read_plan(built)
    first, again = observe_study(built, plan, 5).ratings, observe_study(built, plan, 5).ratings
    after = observe_study(rehearsed, plan, 5).ratings
    assert first.equals(again) and not first.equals(after)
    # 10 attentive ones come with one careless, 11 with two.
    assert observe_study(built, plan, 12).ratings["rater"].nunique() == 13
    with pytest.raises(DataError, match="too few"):
        observe_study(built, plan, 2)


def test_the_driver_notices_a_site_that_does_not_answer_as_it_should(serving, study):
    plan = read_plan(study)
    sheet = {name: {"style": "elder", "naturalness": 4, "action": "walk"} for name in plan.stimuli}
    with (
        serving(study, "--rehearsal") as (address, _),
        pytest.raises(SimulationError, match="/page answers with status 422"),
    ):
        asyncio.run(drive(address, plan, [sheet]))


def test_an_analysis_of_people_is_kept_from_simulated_answers(rehearsed, tmp_path):
    from benchmark.errors import ConfigError

    out = tmp_path / "out"
    (out / "stats").mkdir(parents=True)
    (out / "stats" / "ratings-conditions.csv").write_text("condition,kind\nadult,people\n")
    with pytest.raises(ConfigError, match="must not take its place"):
        analyse_study(rehearsed, rehearsal=True, out=out)
