"""``analyze``: from the command line to files that say what they are."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmark.cli import call
from benchmark.runner.parquet import write_rows
from benchmark.runner.views import LEADERBOARD_COLUMNS, RESULT_COLUMNS, leaderboard
from eval.ratings.reading import PEOPLE, SIMULATED
from reports.ratings import choose_stimuli
from reports.run import RunView

METHODS = ("identity", "bold", "shy", "child-reference")
#: P(target) and jerk ratio of each method.
TRUTH = {"identity": (0.1, 1.0), "bold": (0.8, 8.0), "shy": (0.1, 1.0), "child-reference": (0.9, 1.0)}
DIRECTIONS = {
    "recognition/p-target-kinematic": ("higher", None),
    "physics/jerk-ratio": ("target", 1.0),
    "physics/bone-length-error": ("lower", None),
}


def result(method, clip, metric, value, **more):
    action = f"act{clip % 6}"
    return {
        **dict.fromkeys((name for name, kind in RESULT_COLUMNS.items() if kind == "string"), "x"),
        "cell_key": f"cell-{method}",
        "method": method,
        "dataset": "planted",
        "source_style": "adult",
        "target_style": "child",
        "clip_id": f"adult/a{clip % 3}/{action}_{clip}",
        "actor": f"a{clip % 3}",
        "action": action,
        "seen_actor": False,
        "repetition": 0,
        "seed": 0,
        "variant": "raw",
        "metric": metric,
        "value": value,
        "status": "ok",
        "reason": "",
        **more,
    }


def planted_rows(methods=METHODS, clips=14, holes=None, **more):
    rng = np.random.default_rng(5)
    rows = []
    for method in methods:
        p, jerk = TRUTH[method]
        for clip in range((holes or {}).get(method, clips)):
            scores = {
                "recognition/p-target-kinematic": float(np.clip(p + rng.normal(0, 0.04), 0, 1)),
                "physics/jerk-ratio": float(jerk * np.exp(rng.normal(0, 0.05))),
                "physics/bone-length-error": float(rng.uniform(0, 1e-15)),
                "cost/transfer_seconds": 0.1,
            }
            rows += [result(method, clip, metric, value, **more) for metric, value in scores.items()]
        rows.append(result(method, 0, "cost/fit_seconds", 1.0, **{"clip_id": "", "actor": "", "action": ""} | more))
    return rows


def planted_run(folder: Path, methods=METHODS, clips=14, also=(), **holes) -> Path:
    """A finished run of whose results the truth is known; ``holes`` gives how many clips a method has instead."""
    rows = [*planted_rows(methods, clips, holes), *also]
    folder.mkdir(parents=True)
    write_rows(folder / "results.parquet", rows, RESULT_COLUMNS)
    with (folder / "leaderboard.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, LEADERBOARD_COLUMNS)
        writer.writeheader()
        writer.writerows(leaderboard(rows, DIRECTIONS))
    return folder


@pytest.fixture(scope="module")
def analysed(tmp_path_factory):
    """A planted run, analysed with simulated observers, and what was printed."""
    folder = planted_run(tmp_path_factory.mktemp("runs") / "planted")
    capture = pytest.MonkeyPatch()
    printed: list[str] = []
    with capture.context() as patch:
        from rich.console import Console

        from benchmark.commands import tables

        def make() -> Console:
            console = Console(width=200, highlight=False, record=True)
            printed.append(console)  # type: ignore[arg-type]
            return console

        patch.setattr(tables, "make_console", make)
        code = call(["analyze", str(folder), "--raters", "24"])
    assert code == 0
    return folder, printed[0].export_text()  # type: ignore[attr-defined]


def test_what_was_planted_is_found(analysed):
    folder, _ = analysed
    contrasts = pd.read_csv(folder / "stats" / "ratings-contrasts.csv").query("sample == 'attentive'")
    keyed = contrasts.set_index(["question", "a", "b"])
    bold = keyed.loc[("child", "adult", "bold")]
    assert bold["reject"] and bold["diff"] < -0.2 and bold["high_clips"] < 0
    shy = keyed.loc[("child", "adult", "shy")]
    assert shy["low_clips"] < 0 < shy["high_clips"]
    assert keyed.loc[("naturalness", "bold", "child"), "diff"] < -1
    conditions = pd.read_csv(folder / "stats" / "ratings-conditions.csv")
    assert conditions["condition"].tolist() == ["adult", "bold", "shy", "child"]
    assert (conditions["clips"] == 10).all()


def test_every_product_says_that_nobody_was_asked(analysed):
    folder, printed = analysed
    made = sorted((folder / "stats").glob("ratings-*.csv"))
    assert len(made) == 18
    for path in made:
        if path.name != "ratings-stimuli.csv":
            assert SIMULATED in path.read_text(encoding="utf-8"), path.name
            assert set(pd.read_csv(path, comment="#")["kind"]) <= {SIMULATED}
    report = (folder / "stats" / "ratings.md").read_text(encoding="utf-8")
    headings = [line for line in report.splitlines() if line.startswith("#")]
    assert len(headings) > 6 and all(SIMULATED in line for line in headings)
    for name in ("anova", "tukey"):
        text = (folder / "tables" / f"ratings-{name}.tex").read_text(encoding="utf-8")
        caption = next(line for line in text.splitlines() if line.startswith(r"\caption"))
        assert SIMULATED.capitalize() in caption
    assert f"ratings ({SIMULATED})" in printed
    assert printed.rstrip().splitlines()[-1].startswith(f"ratings ({SIMULATED}): ")


def test_stimuli_are_balanced_and_blind(analysed):
    folder, _ = analysed
    stimuli = pd.read_csv(folder / "stats" / "ratings-stimuli.csv")
    assert stimuli["stimulus"].is_unique and len(stimuli) == 40
    clips = stimuli.groupby("condition")["clip_id"].agg(frozenset)
    assert len(set(clips)) == 1  # the same clips in every condition
    per_action = stimuli.drop_duplicates("clip_id")["action"].value_counts()
    assert per_action.max() - per_action.min() <= 1 and len(per_action) == 6
    # Sorted by id the conditions come in no order.
    switches = (
        stimuli.sort_values("stimulus")["condition"].shift() != stimuli.sort_values("stimulus")["condition"]
    ).sum()
    assert switches > 20


def test_metrics_are_compared_within_their_families(analysed):
    folder, printed = analysed
    table = pd.read_csv(folder / "stats" / "metrics-comparison.csv")
    assert set(table["family"]) == {"recognition", "physics"}
    assert set(table["family_size"]) == {6, 12}
    row = table.query("metric == 'recognition/p-target-kinematic' and a == 'identity' and b == 'bold'").iloc[0]
    assert row["diff"] == pytest.approx(-0.7, abs=0.05) and row["reject"] and row["high"] < -0.6
    assert not table.query("metric == 'physics/bone-length-error'")["reject"].any()  # rounding noise is no difference
    ranks = pd.read_csv(folder / "stats" / "metrics-ranks.csv")
    assert "child-reference" not in set(ranks["method"])
    recognition = ranks.query("metric == 'recognition/p-target-kinematic'")
    assert recognition["method"].iloc[0] == "bold" and recognition["mean_rank"].iloc[0] == 1.0
    jerk = ranks.query("metric == 'physics/jerk-ratio'").set_index("method")
    assert jerk.loc["bold", "mean_rank"] == 3.0
    assert not table.query("metric == 'recognition/p-target-kinematic' and a == 'identity' and b == 'shy'")[
        "reject"
    ].item()
    found = int(table.query("family == 'recognition'")["reject"].sum())
    assert f"recognition, adult to child: {found} of 6 differences between methods are significant" in printed


def test_the_same_seed_gives_the_same_files(analysed, tmp_path):
    folder, _ = analysed
    assert call(["analyze", str(folder), "--raters", "24", "--out", str(tmp_path), "-q"]) == 0
    files = sorted(path.relative_to(folder) for path in [*folder.glob("stats/*"), *folder.glob("tables/*")])
    assert len(files) == 23
    for path in files:
        assert (folder / path).read_bytes() == (tmp_path / path).read_bytes(), path


def write_people(folder, extra=""):
    stimuli, ratings = folder / "stimuli.csv", folder / "people.csv"
    rows = [f"s{c}{i},{c},k{i},walk" for i in range(4) for c in ("adult", "ours", "child")]
    stimuli.write_text("stimulus,condition,clip_id,action\n" + "\n".join(rows) + "\n")
    chance = {"adult": 0.1, "ours": 0.6, "child": 0.9}
    rng = np.random.default_rng(0)
    answers = [
        f"r{r},s{c}{i},{'child' if rng.random() < chance[c] else 'adult'},{rng.integers(3, 8)},walk"
        for r in range(12)
        for i in range(4)
        for c in chance
    ]
    ratings.write_text("rater,stimulus,style,naturalness,action\n" + "\n".join(answers) + "\n" + extra)
    return ["--ratings", str(ratings), "--stimuli", str(stimuli)]


def test_ratings_by_people_need_no_run(tmp_path, capsys):
    assert call(["analyze", *write_people(tmp_path), "--out", str(tmp_path / "study")]) == 0
    printed = capsys.readouterr().out
    assert "simulated" not in printed
    files = [
        *(tmp_path / "study").rglob("*.csv"),
        *(tmp_path / "study").rglob("*.tex"),
        tmp_path / "study/stats/ratings.md",
    ]
    assert len(files) == 18
    for path in files:
        assert "simulated" not in path.read_text(encoding="utf-8").lower()
    conditions = pd.read_csv(tmp_path / "study" / "stats" / "ratings-conditions.csv")
    assert set(conditions["kind"]) == {PEOPLE}
    assert not (tmp_path / "study" / "stats" / "metrics-comparison.csv").exists()


def test_simulated_observers_do_not_take_the_place_of_people(tmp_path, capsys):
    run = planted_run(tmp_path / "run")
    assert call(["analyze", *write_people(tmp_path), "--out", str(run), "-q"]) == 0
    before = (run / "stats" / "ratings.md").read_bytes()
    assert call(["analyze", str(run), "-q"]) == 2
    assert "simulated observers must not take its place" in capsys.readouterr().err
    assert (run / "stats" / "ratings.md").read_bytes() == before
    simulated = tmp_path / "simulated.csv"
    people = pd.read_csv(tmp_path / "people.csv")
    people.assign(kind=SIMULATED).to_csv(simulated, index=False)
    arguments = ["--ratings", str(simulated), "--stimuli", str(tmp_path / "stimuli.csv")]
    assert call(["analyze", *arguments, "--out", str(run)]) == 2
    assert (run / "stats" / "ratings.md").read_bytes() == before
    assert call(["analyze", *arguments, "--out", str(tmp_path / "else"), "-q"]) == 0
    assert SIMULATED in (tmp_path / "else" / "stats" / "ratings.md").read_text()


def test_people_take_the_place_of_simulated_observers(tmp_path):
    run = planted_run(tmp_path / "run")
    assert call(["analyze", str(run), "--raters", "5", "-q"]) == 0
    assert (run / "stats" / "ratings-answers.csv").exists()
    assert call(["analyze", str(run), *write_people(tmp_path), "-q"]) == 0
    for path in (run / "stats").glob("ratings*"):
        assert SIMULATED not in path.read_text(encoding="utf-8")
    assert not (run / "stats" / "ratings-answers.csv").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "give a RUN for simulated observers to rate, or --ratings and --stimuli"),
        (["--ratings", "a.csv"], "--ratings needs --stimuli"),
        (["--stimuli", "a.csv"], "--stimuli needs --ratings"),
        (["--ratings", "a.csv", "--stimuli", "b.csv"], "say by --out where the results go"),
        (["nowhere"], "nowhere has no results.parquet"),
        (
            ["--ratings", "a.csv", "--stimuli", "b.csv", "--out", "o", "--task", "adult"],
            "a task is written source:target",
        ),
        (["--ratings", "a.csv", "--stimuli", "none.csv", "--out", "o"], "none.csv: there is no such file"),
        (["nowhere", "--raters", "2"], "2 is not in the range x>=3"),
    ],
)
def test_what_cannot_be_done_is_said(arguments, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert call(["analyze", *arguments]) == 2
    assert message in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_bad_rows_are_listed_with_their_lines_and_nothing_is_written(tmp_path, capsys):
    arguments = write_people(tmp_path, extra="r1,sadult0,child,5,walk\nr99,nothing,child,9,walk\n")
    assert call(["analyze", *arguments, "--out", str(tmp_path / "study")]) == 2
    error = capsys.readouterr().err
    assert "3 problems" in error
    assert "line 146: rater 'r1' answered stimulus 'sadult0' on line" in error
    assert "line 147: unknown stimulus 'nothing'" in error and "line 147: naturalness is" in error
    assert not (tmp_path / "study").exists()


def test_a_task_that_the_run_lacks(tmp_path, capsys):
    run = planted_run(tmp_path / "run")
    assert call(["analyze", str(run), "--task", "child:adult"]) == 2
    assert "unknown task of the run 'child:adult'" in capsys.readouterr().err


def test_a_method_with_few_results_is_no_condition_and_that_is_said(tmp_path):
    run = planted_run(tmp_path / "run", shy=3)
    assert call(["analyze", str(run), "--raters", "5", "-q"]) == 0
    stimuli = pd.read_csv(run / "stats" / "ratings-stimuli.csv")
    assert set(stimuli["condition"]) == {"adult", "bold", "child"}
    assert "shy is no condition: it has results for 3 clips, others for 14" in (run / "stats/ratings.md").read_text()


def test_one_method_is_no_comparison(tmp_path, capsys):
    run = planted_run(tmp_path / "run", methods=("identity",))
    assert call(["analyze", str(run)]) == 2
    assert "no two methods have a result for the same clip of adult:child (identity 14)" in capsys.readouterr().err


def test_help_teaches_the_format(capsys):
    assert call(["analyze", "--help"]) == 0
    text = capsys.readouterr().out
    for word in ("rater,stimulus,style,naturalness,action", "stimulus,condition,clip_id,action", "simulated observers"):
        assert word in text


def test_every_task_of_a_run_is_rated_under_its_own_name(tmp_path, capsys):
    other = planted_rows(source_style="normal", target_style="tired")
    run = planted_run(tmp_path / "run", also=other)
    assert call(["analyze", str(run), "--raters", "5"]) == 0
    printed = capsys.readouterr().out
    assert "adult to child: means" in printed and "normal to tired: means" in printed
    first = pd.read_csv(run / "stats" / "ratings-conditions.csv")["condition"].tolist()
    second = pd.read_csv(run / "stats" / "ratings-normal-to-tired-conditions.csv")["condition"].tolist()
    assert first == ["adult", "bold", "shy", "child"] and second == ["normal", "bold", "shy", "tired"]
    assert "normal to tired" in (run / "stats" / "ratings-normal-to-tired.md").read_text()
    tex = (run / "tables" / "ratings-normal-to-tired-tukey.tex").read_text()
    assert r"\label{tab:ratings-normal-to-tired-tukey}" in tex
    for path in (run / "stats").glob("ratings-normal-to-tired-*.csv"):
        assert path.name.endswith("stimuli.csv") or SIMULATED in path.read_text()
    # One task alone leaves the files of the other as they are.
    before = (run / "stats" / "ratings-conditions.csv").read_bytes()
    assert call(["analyze", str(run), "--raters", "6", "--task", "normal:tired", "-q"]) == 0
    assert (run / "stats" / "ratings-conditions.csv").read_bytes() == before


def test_which_training_observers_see_is_a_choice(tmp_path, capsys):
    again = [
        row for number in (1, 2) for row in planted_rows(("bold", "shy"), repetition=number, cell_key=f"again-{number}")
    ]
    view = RunView(planted_run(tmp_path / "run", also=again))

    def shown(repetition):
        stimuli, scores, notes = choose_stimuli(
            view, "adult:child", rng=np.random.default_rng(0), repetition=repetition
        )
        table = stimuli.merge(scores, on="stimulus", validate="one_to_one")
        assert table["physics/jerk-ratio"].notna().all()
        return table.groupby("condition")["repetition"].agg(lambda numbers: sorted(numbers.tolist())), notes

    numbers, notes = shown("first")
    assert set(map(tuple, numbers)) == {(0,) * 10}
    assert "Of the up to 3 trainings of a method the first is shown." in notes
    numbers, notes = shown("spread")
    assert numbers["adult"] == [0] * 10 and numbers["bold"] == [0] * 4 + [1] * 3 + [2] * 3
    assert "Of the up to 3 trainings of a method each in turn from clip to clip is shown." in notes
    numbers, _ = shown(2)
    assert numbers["child"] == [0] * 10 and numbers["shy"] == [2] * 10
    folder = str(view.folder)
    assert call(["analyze", folder, "--repetition", "spread", "--raters", "5", "-q"]) == 0
    assert "each in turn" in (view.folder / "stats" / "ratings.md").read_text()
    for value, message in (
        ("7", "no method has repetition 7; there are 0, 1, 2"),
        ("all", "first, spread or a number"),
    ):
        assert call(["analyze", folder, "--repetition", value]) == 2
        assert message in capsys.readouterr().err
