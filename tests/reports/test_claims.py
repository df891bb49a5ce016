from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from benchmark.commands.claims import claims as claims_command
from benchmark.runner.views import RESULT_COLUMNS
from reports.claims.definitions import CLAIMS, Between, Claim, Contrast, Level, Nearer, Rated, Untestable
from reports.claims.evidence import (
    FAILS,
    HOLDS,
    UNTESTED,
    MissingEvidenceError,
    claim_counts,
    claim_verdicts,
    find,
    judge,
)
from reports.claims.table import write_claims
from reports.run import RunView


def make_run(folder: Path, scores: dict[str, dict[str, np.ndarray]], *, seeds: int = 1) -> RunView:
    """A run of 24 clips of 4 actors with the given values (clips,) or (seeds, clips) by method and metric."""
    rows = []
    for method, metrics in scores.items():
        for metric, values in metrics.items():
            for repetition, of_seed in enumerate(np.atleast_2d(values)):
                for clip, value in enumerate(of_seed):
                    row = dict.fromkeys(RESULT_COLUMNS, "")
                    row |= {"source_style": "adult", "target_style": "child", "method": method, "metric": metric}
                    row |= {"clip_id": f"clip{clip:02d}", "actor": f"actor{clip % 4}", "action": "walk"}
                    row |= {"repetition": repetition, "variant": "raw", "value": value, "status": "ok", "reason": ""}
                    rows.append(row)
    folder.mkdir()
    pd.DataFrame(rows).to_parquet(folder / "results.parquet")
    (folder / "leaderboard.csv").write_text("")
    return RunView(folder)


@pytest.fixture
def run(tmp_path):
    rng = np.random.default_rng(0)
    base = rng.normal(1.0, 0.2, size=24)
    noise = rng.normal(0.0, 0.05, size=(4, 24))
    return make_run(
        tmp_path / "run",
        {
            "identity": {"m/x": base},
            "better": {"m/x": base - 0.2 + noise[0], "m/y": base},
            "same": {"m/x": base + noise[1]},
            "seeds": {"m/x": np.stack([base - 0.2 + noise[k] for k in (1, 2, 3)])},
        },
    )


def claim(*tests, name="c", alpha=0.05):
    return Claim(name, "Paper", "section", "It is so", tests, alpha)


def verdict(run, *tests, **options):
    return claim_verdicts(judge([run], [claim(*tests, **options)]))["c"]


def test_a_planted_difference_holds_in_its_direction_only(run):
    assert verdict(run, Contrast("m/x", "better", "identity", "lower")) == HOLDS
    assert verdict(run, Contrast("m/x", "better", "identity", "higher")) == FAILS
    assert verdict(run, Contrast("m/x", "identity", "better", "higher")) == HOLDS
    row = judge([run], [claim(Contrast("m/x", "better", "identity", "higher"))]).iloc[0]
    assert row["effect"] < 0
    assert row["high"] < 0
    assert "the other way" in row["why"]


def test_the_effect_is_the_mean_difference_with_the_stated_sign(run):
    found = find([run], Contrast("m/x", "better", "identity", "lower"))
    rows = run.results
    means = rows[rows["metric"] == "m/x"].groupby("method")["value"].mean()
    assert found.effect == pytest.approx(means["identity"] - means["better"])
    assert found.low < found.effect < found.high
    assert found.n == "24 clips of 4 actors"
    assert find([run], Contrast("m/x", "seeds", "identity", "lower")).n == "24 clips of 4 actors, 3 training seeds"


def test_no_difference_is_not_shown(run):
    row = judge([run], [claim(Contrast("m/x", "same", "identity", "lower"))]).iloc[0]
    assert row["verdict"] == FAILS
    assert row["low"] < 0 < row["high"]


def test_no_worse_by_a_margin(run):
    assert verdict(run, Contrast("m/x", "same", "identity", "lower", margin=0.1)) == HOLDS
    assert verdict(run, Contrast("m/x", "identity", "better", "lower", margin=0.1)) == FAILS


def test_levels_and_metrics_of_one_row(run):
    assert verdict(run, Level("m/x", "better", 1.0, "lower")) == HOLDS
    assert verdict(run, Level("m/x", "better", 0.5, "lower")) == FAILS
    assert verdict(run, Between("m/x", "m/y", "better", "lower")) == HOLDS


def test_every_test_of_a_claim_must_hold(run):
    good, bad = Contrast("m/x", "better", "identity", "lower"), Contrast("m/x", "same", "identity", "lower")
    lost = Contrast("m/x", "absent", "identity", "lower")
    assert verdict(run, good, bad) == FAILS
    assert verdict(run, good, lost) == UNTESTED
    assert verdict(run, bad, lost) == FAILS


def test_what_is_missing_is_named(run):
    with pytest.raises(MissingEvidenceError, match="no row absent"):
        find([run], Contrast("m/x", "absent", "identity", "lower"))
    with pytest.raises(MissingEvidenceError, match="same has no m/y"):
        find([run], Contrast("m/y", "same", "better", "lower"))
    with pytest.raises(MissingEvidenceError, match="benchmark analyze"):
        find([run], Rated("child", "better", "identity", "higher"))
    with pytest.raises(MissingEvidenceError, match=r"dong2018\.toml"):
        find([run], Nearer("arm_swing", "hsu"))


def test_the_first_run_that_can_answer_does(run, tmp_path):
    other = make_run(tmp_path / "other", {"a": {"m/z": np.zeros(24)}, "b": {"m/z": np.arange(1.0, 25.0)}})
    assert find([run, other], Contrast("m/z", "a", "b", "lower")).run == "other"
    assert find([run, other], Contrast("m/x", "better", "identity", "lower")).run == "run"


def test_a_claim_about_every_style_is_tested_on_every_task(run, tmp_path):
    rows = run.results.drop(columns="task")
    other = rows.assign(target_style="old")
    other.loc[other["method"] == "better", "value"] += 1.0
    folder = tmp_path / "styles"
    folder.mkdir()
    pd.concat([rows, other]).to_parquet(folder / "results.parquet")
    (folder / "leaderboard.csv").write_text("")
    test = Contrast("m/x", "better", "identity", "lower")
    whole = Claim("c", "Paper", "section", "It is so", (test,), every_task=True)
    table = judge([RunView(folder)], [whole])
    assert table["verdict"].tolist() == [HOLDS, FAILS]
    assert [text.rpartition("(")[2] for text in table["test"]] == ["styles, adult:child)", "styles, adult:old)"]
    assert claim_verdicts(table)["c"] == FAILS
    assert len(judge([RunView(folder)], [claim(test)])) == 1


def test_holm_is_over_the_whole_table(run):
    tests = [claim(Contrast("m/x", "better", "identity", "lower"), name=f"c{k}") for k in range(5)]
    table = judge([run], tests)
    assert np.allclose(table["p_holm"], np.minimum(1.0, 5 * table["p"]))


def test_about_one_in_twenty_true_nulls_is_called_a_difference(tmp_path):
    rng = np.random.default_rng(1)
    wrong = 0
    for trial in range(60):
        actors = np.repeat(rng.normal(size=6), 4)[np.argsort(np.tile(np.arange(6), 4), kind="stable")]
        a, b = (actors + rng.normal(size=24) for _ in range(2))
        run = make_run(tmp_path / f"null{trial}", {"a": {"m/x": a}, "b": {"m/x": b}})
        wrong += verdict(run, Contrast("m/x", "a", "b", "lower")) == HOLDS
    assert wrong <= 6  # one-sided: 2.5 % expected, P(> 6 of 60) below 0.001


def ratings(folder: Path, kind: str) -> None:
    stats = folder / "stats"
    stats.mkdir()
    pd.DataFrame({"condition": ["adult", "child", "better"], "kind": kind}).to_csv(stats / "ratings-conditions.csv")
    contrast = {"sample": "attentive", "p": 1e-6, "n": 36, "kind": kind}
    rows = [
        {"question": "child", "a": "adult", "b": "better", "diff_answers": -0.3, "low_clips": -0.5, "high_clips": -0.1},
        {"question": "naturalness", "a": "better", "b": "child", "diff": -0.2, "low": -0.4, "high": 0.0},
    ]
    pd.DataFrame([{**contrast, **row} for row in rows]).to_csv(stats / "ratings-contrasts.csv")


def test_ratings_are_read_in_either_order_and_simulated_ones_say_so(run):
    ratings(run.folder, "simulated observers, not people")
    found = find([run], Rated("child", "better", "identity", "higher"))
    assert (found.effect, found.low, found.high) == pytest.approx((0.3, 0.1, 0.5))
    assert found.n == "36 raters"
    assert found.note == "simulated observers, not people"
    assert find([run], Rated("child", "identity", "better", "lower")).effect == pytest.approx(0.3)
    table = judge([run], [claim(Rated("child", "better", "identity", "higher"))])
    assert table.loc[0, "verdict"] == HOLDS
    for path in write_claims(table, run.folder):
        assert "simulated observers, not people" in path.read_text(), path
    assert verdict(run, Rated("naturalness", "better", "child-reference", "higher", margin=0.5)) == HOLDS
    assert verdict(run, Rated("naturalness", "better", "child-reference", "higher", margin=0.3)) == FAILS


def test_the_claims_of_the_papers_are_whole(run):
    names = [entry.name for entry in CLAIMS]
    assert len(set(names)) == len(names)
    table = judge([run])
    assert list(table["claim"].drop_duplicates()) == names
    assert set(table["verdict"]) == {UNTESTED}
    assert (table["why"].str.len() > 0).all()


def test_claims_name_registered_metrics_and_methods():
    from benchmark.registry import METHODS, METRICS

    for entry in CLAIMS:
        for test in () if isinstance(entry, Untestable) else entry.tests:
            for name in (getattr(test, "metric", None), getattr(test, "other", None)):
                assert name is None or name in METRICS, f"{entry.name}: {name}"
            for method in test.methods:
                assert method.partition("[")[0] in METHODS, f"{entry.name}: {method}"


def test_the_files_hold_every_test(run):
    table = judge([run], [claim(Contrast("m/x", "better", "identity", "lower")), *CLAIMS[:3]])
    csv, text, tex = write_claims(table, run.folder)
    assert len(pd.read_csv(csv)) == len(table)
    assert "**holds**" in text.read_text()
    assert tex.read_text().count(r"\\") > len(table)


@pytest.mark.parametrize(
    ("verdicts", "told"),
    [
        ([HOLDS, FAILS, UNTESTED], "3 claims: 1 holds, 1 does not hold, 1 cannot be tested here"),
        ([FAILS, HOLDS, HOLDS, FAILS], "4 claims: 2 hold, 2 do not hold"),
        ([UNTESTED], "1 claim: 1 cannot be tested here"),
    ],
)
def test_counts_are_told_in_words(verdicts, told):
    table = pd.DataFrame({"claim": [f"c{n}" for n in range(len(verdicts))], "verdict": verdicts})
    assert claim_counts(table) == told


def test_what_is_shown_changes_nothing_of_what_is_judged(run):
    """Fewer tests would be corrected for, and a verdict could be had by asking for it alone."""
    command = CliRunner()
    whole = command.invoke(claims_command, [str(run.folder)], catch_exceptions=False)
    written = (run.folder / "stats/claims.csv").read_text()
    some = command.invoke(claims_command, [str(run.folder), "--only", "jump-*"], catch_exceptions=False)
    assert f"{len(CLAIMS)} claims:" in whole.output
    assert "3 claims:" in some.output and "Kernels of each joint" not in " ".join(some.output.split())
    assert (run.folder / "stats/claims.csv").read_text() == written
    lost = command.invoke(claims_command, [str(run.folder), "--only", "leap-*"])
    assert "leap-*" in str(lost.exception)
