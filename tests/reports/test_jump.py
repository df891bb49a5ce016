"""The landing figure and its table, on a generated jump; and without the data set that the run was made on."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmark.api import NotApplicableError
from benchmark.data.synthetic import SyntheticDataset
from eval.metrics.jump import arm_swing, find_jump, knee_angle, landing_duration, lowest_knee_bend
from reports.build import build_report, draw_figures
from reports.claims.definitions import Nearer
from reports.claims.evidence import MissingEvidenceError, find
from reports.figures.jump import jump_landing, landing
from reports.jumps import CLAIMS, JumpCase, JumpRow, jump_cases, jump_table
from reports.run import RunView

TASK = "adult:child"
ACTION = "jump-as-high-as-you-can-in-place"
#: The take that a limit of one clip chooses.
SOURCE = f"adult/adult003/{ACTION}_2"


@pytest.fixture(scope="module")
def jumped(tmp_path_factory) -> Path:
    """A run over one performer's jump, with one child to learn from and the others as references."""
    folder = tmp_path_factory.mktemp("runs") / "jump"
    options = ('train=["adult001", "child002"]', 'test=["adult003"]', f'actions=["{ACTION}"]')
    subprocess.run(
        [
            *(sys.executable, "-m", "benchmark", "run", "--dataset", "synthetic", "--split", "named"),
            *(part for option in options for part in ("--split-option", option)),
            *(
                "--methods",
                "identity,dynamic-scaling,nearest",
                "--variants",
                "raw",
                "--limit",
                "1",
                "--metrics",
                "jump/*",
            ),
            *("--no-report", "--quiet", "--out", str(folder)),
        ],
        check=True,
        capture_output=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    return folder


@pytest.fixture(scope="module")
def case(jumped) -> JumpCase:
    (case,) = jump_cases(RunView(jumped), TASK)
    return case


def test_rows_are_the_source_the_child_trained_on_the_methods_and_other_children(case):
    assert (case.clip_id, case.action, case.problem) == (SOURCE, ACTION, "")
    assert [row.clip_id for row in case.of("source")] == [SOURCE]
    assert {row.clip_id.split("/")[1] for row in case.of("trained on")} == {"child002"}
    roles = [row.role for row in case.rows]
    assert roles == sorted(roles, key=["source", "trained on", "method", "not trained on"].index)
    assert [row.label for row in case.of("method")][:3] == ["identity", "dynamic-scaling", "nearest"]
    others = {row.clip_id.split("/")[1] for row in case.of("not trained on")}
    assert others == {"child001", "child003", "child004", "child005"}


def test_measures_are_those_of_the_real_clips(case):
    dataset = SyntheticDataset()
    for row in (*case.of("source"), *case.of("trained on"), *case.of("not trained on")):
        clip = dataset.load(row.clip_id)
        jump = find_jump(clip)
        assert row.measures["landing_knee_angle_deg"] == lowest_knee_bend(clip, jump)
        assert row.measures["landing_knee_flexion_deg"] == 180.0 - lowest_knee_bend(clip, jump)
        assert row.measures["arm_swing_deg"] == arm_swing(clip, jump)
        assert row.measures["landing_duration_s"] == landing_duration(clip, jump)


def test_methods_measure_as_the_metrics_do(case, jumped):
    rows = RunView(jumped).results
    for row in case.of("method"):
        for metric, column in (
            ("jump/landing-knee-angle", "landing_knee_angle_deg"),
            ("jump/arm-swing", "arm_swing_deg"),
            ("jump/landing-duration", "landing_duration_s"),
            ("jump/recovery-duration", "recovery_duration_s"),
        ):
            method = "child-reference" if row.label == "held-out performer" else row.label
            (value,) = rows.loc[(rows["method"] == method) & (rows["metric"] == metric), "value"]
            assert row.measures[column] == pytest.approx(value, abs=1e-9)


def test_the_table_says_who_is_nearer_as_its_own_numbers_do(case):
    table = jump_table([case])
    assert list(table["role"]) == [row.role for row in case.rows]
    source = table[table["role"] == "source"].iloc[0]
    aim = table[table["role"] == "trained on"][list(CLAIMS)].median()
    judged = table[table["role"].isin(["method", "not trained on"])]
    for claim in CLAIMS:
        nearer = (judged[claim] - aim[claim]).abs() < abs(source[claim] - aim[claim])
        assert list(judged[f"nearer_{claim.rpartition('_')[0]}"]) == ["yes" if value else "no" for value in nearer]
        same_sense = (judged[claim] - source[claim]) * (aim[claim] - source[claim]) > 0.0
        assert list(judged[f"towards_{claim.rpartition('_')[0]}"]) == ["yes" if value else "no" for value in same_sense]
    assert (table.loc[table["role"].isin(["source", "trained on"]), "nearer_arm_swing"] == "").all()
    told = set(judged["nearer_arm_swing"]) | set(judged["nearer_landing_duration"])
    assert told == {"yes", "no"}


def with_measures(case: JumpCase, label: str, **measures: float) -> JumpRow:
    """A method's row with planted measures."""
    row = JumpRow("method", label, case.clip_id, case.rows[0].clip)
    row.__dict__["measures"] = {**case.rows[0].measures, **measures}
    return row


def test_nearer_is_strict_and_knows_what_it_cannot_say(case):
    (source,), aim = case.of("source"), case.aim
    at_aim = with_measures(case, "there", **aim)
    assert set(case.nearer(at_aim).values()) == {True}
    assert set(case.nearer(source).values()) == {False}
    assert set(case.towards(source).values()) == {False}

    def moved(share: float) -> JumpRow:
        """A row that has gone this share of the way from the source to the child."""
        way = {claim: aim[claim] - source.measures[claim] for claim in CLAIMS}
        return with_measures(case, "moved", **{claim: source.measures[claim] + share * way[claim] for claim in CLAIMS})

    for share, nearer, towards in ((-0.5, False, False), (0.1, True, True), (1.9, True, True), (2.1, False, True)):
        assert set(case.nearer(moved(share)).values()) == {nearer}
        assert set(case.towards(moved(share)).values()) == {towards}
    nothing = with_measures(case, "none", arm_swing_deg=float("nan"))
    assert case.nearer(nothing)["arm_swing_deg"] is None
    alone = JumpCase(case.clip_id, case.action, (source, at_aim))
    assert set(alone.nearer(at_aim).values()) == {None}


def test_the_curves_are_the_clips_own(jumped, case):
    (saved,) = draw_figures(jumped, ["jump-landing"])
    table = pd.read_csv(saved.csv)
    assert saved.png.is_file() and saved.pdf.is_file()
    row = case.of("source")[0]
    part = table[(table["role"] == "source")]
    np.testing.assert_allclose(part["knee_angle_deg"], knee_angle(row.clip), atol=1e-9)
    np.testing.assert_allclose(part["seconds_from_touchdown"], row.clip.times - row.jump.touchdown, atol=1e-9)
    hips = row.clip.positions[:, row.clip.skeleton.joint("hips"), 1] / row.clip.skeleton.leg_length
    np.testing.assert_allclose(part["hips_height_leg"], hips, atol=1e-9)
    assert set(table["row"]) >= {"identity", "dynamic-scaling", "nearest", "child child002"}
    assert "not trained on" not in set(table["role"])


def test_the_caption_states_what_holds(jumped, case):
    (drawing,) = jump_landing(RunView(jumped))
    assert "Synthetic data" in drawing.caption and SOURCE in drawing.caption
    for row in case.of("method"):
        held = [words for claim, words in CLAIMS.items() if case.nearer(row)[claim]]
        assert f"{row.label}: {', '.join(held) if held else 'none'} ({len(held)} of 3)" in drawing.caption


def test_the_figure_writes_every_value_and_mark(case):
    figure = landing(case)
    written = [text.get_text() for axes in figure.axes for text in axes.texts]
    for row in case.of("method"):
        mark = "✓" if case.nearer(row)["arm_swing_deg"] else "✗"
        assert f"swing {row.measures['arm_swing_deg']:.0f}° {mark}" in written
        assert row.label in written
    assert figure.get_size_inches()[0] == pytest.approx(7.1)


def test_a_result_without_a_jump_is_said_to_have_none(case):
    still = case.rows[0].clip.frames(0, 10)
    figure = landing(JumpCase(case.clip_id, case.action, (*case.rows, JumpRow("method", "stiff", case.clip_id, still))))
    written = [text.get_text() for axes in figure.axes for text in axes.texts]
    assert written.count("no jump is seen") == 3


def test_the_report_has_the_figure_and_the_tables(jumped):
    page = build_report(jumped).read_text(encoding="utf-8")
    assert "jump-landing-adult-to-child.pdf" in page and "Dong et al. 2018" in page
    csv = pd.read_csv(jumped / "tables" / "jump-landing-adult-to-child.csv", keep_default_na=False)
    assert csv["row"][0] == SOURCE and csv["row"][1].startswith("child/child002/")
    markdown = (jumped / "tables" / "jump-landing-adult-to-child.md").read_text(encoding="utf-8").splitlines()
    assert len(markdown) == 2 + len(csv) and len({line.count("|") for line in markdown}) == 1


@pytest.mark.parametrize("lost", ["data set", "settings", "split"])
def test_without_the_data_set_the_results_are_drawn_and_the_reason_is_said(jumped, tmp_path, lost):
    folder = tmp_path / "elsewhere"
    shutil.copytree(jumped, folder, ignore=shutil.ignore_patterns("tables", "figures", "report"))
    if lost == "data set":
        text = (folder / "config.toml").read_text()
        (folder / "config.toml").write_text(
            text.replace('name = "synthetic"', 'name = "kinder-gator"\nroot = "/absent"')
        )
    elif lost == "settings":
        (folder / "config.toml").unlink()
    else:
        (folder / "split.json").write_text("{}")
    (drawing,) = jump_landing(RunView(folder))
    assert "The real performances are missing, because the data set could not be read" in drawing.caption
    assert set(drawing.data["role"]) == {"method"}
    page = build_report(folder).read_text(encoding="utf-8")
    assert "could not be read" in page


def test_runs_without_jumps_have_no_such_figure(jumped, tmp_path):
    folder = tmp_path / "walks"
    shutil.copytree(jumped, folder, ignore=shutil.ignore_patterns("tables", "figures", "report"))
    for path in folder.glob("cells/*/items.json"):
        path.write_text(path.read_text().replace(f'"{ACTION}"', '"walk"'))
    run = RunView(folder)
    assert jump_cases(run, TASK) == []
    with pytest.raises(NotApplicableError, match="no result holds a jump"):
        jump_landing(run)
    build_report(folder)
    assert not list(folder.glob("tables/jump-*")) and not list(folder.glob("figures/jump-*"))


def test_claims_about_jumps_say_when_the_recordings_are_not_there(jumped, tmp_path, monkeypatch):
    test = Nearer("arm_swing", "nearest")
    assert find([RunView(jumped)], test).effect == 0.5

    folder = tmp_path / "moved"
    shutil.copytree(jumped, folder)
    config = folder / "config.toml"
    config.write_text(config.read_text().replace('"synthetic"', '"kinder-gator"'))
    (empty := tmp_path / "empty").mkdir()
    monkeypatch.setenv("BENCHMARK_DATA", str(empty))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    with pytest.raises(MissingEvidenceError, match=r"moved: .*kinder-gator.*data fetch"):
        find([RunView(folder)], test)
