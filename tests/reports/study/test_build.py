from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace

import pandas as pd
import pytest

from benchmark.errors import ConfigError, DataError, StoreError, UnknownNameError
from eval.ratings.reading import read_stimuli
from reports.study.build import build_study, name_source
from reports.study.layout import StudyFolder
from reports.study.plan import read_plan
from reports.study.sign import stimulus_id

METHODS = ("identity", "bold", "child-reference")


def test_the_same_clips_in_every_condition_and_a_catch_trial_and_an_example(built):
    plan, key = read_plan(built), read_stimuli(built.key)
    compared = key[key["condition"] != ""]
    assert list(dict.fromkeys(compared["condition"])) == ["adult", "bold", "child"]
    clips = compared.groupby("condition")["clip_id"].agg(set)
    assert all(found == clips.iloc[0] and len(found) == 2 for found in clips)
    assert len(key) == plan.pages == 7 and len(plan.stimuli) == 8
    (catch,) = key.loc[key["condition"] == "", "clip_id"]
    assert catch not in clips.iloc[0]
    assert plan.example and plan.example not in set(key["stimulus"])
    assert len(plan.orders) == 6
    assert {order.first_style for order in plan.orders} == {0, 1}


def test_nothing_that_raters_can_reach_says_what_a_stimulus_is(built):
    plan = read_plan(built)
    assert all(re.fullmatch(r"[0-9a-f]{16}", name) for name in plan.stimuli)
    assert {path.stem for path in built.stimuli.iterdir()} == set(plan.stimuli)
    words = [*METHODS, "adult/a0", "cell-", "reference"]
    for path in (built.plan, *built.stimuli.iterdir()):
        data = path.read_bytes()
        assert not [word for word in words if word.encode() in data], path
    # Files have one date, and the same length in time.
    assert {path.stat().st_mtime for path in built.stimuli.iterdir()} == {0.0}
    # Answers offered for a clip are the same in every condition.
    key = pd.read_csv(built.key)
    for _, rows in key[key["condition"].notna()].groupby("clip_id"):
        assert len({plan.stimuli[name].actions for name in rows["stimulus"]}) == 1
    assert built.private.stat().st_mode & 0o077 == 0 and built.secret.stat().st_mode & 0o077 == 0


def test_every_video_has_the_same_length_and_the_credit(built):
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    for path in built.stimuli.iterdir():
        frames, seconds = imageio_ffmpeg.count_frames_and_secs(str(path))
        assert (frames, seconds) == (20, 2.0)
        reader = imageio_ffmpeg.read_frames(str(path))
        facts = next(reader)
        reader.close()
        assert facts["size"] == (160, 120)
    assert read_plan(built).source == "Synthetic adults and children · licence: MIT, as this suite"


def test_ids_depend_on_the_secret_alone_and_choices_on_the_seed(run, small, built, tmp_path):
    other = build_study(run, tmp_path / "other", small).folder
    first, second = (pd.read_csv(folder.key).fillna("") for folder in (built, other))
    assert not set(first["stimulus"]) & set(second["stimulus"])
    assert first.drop(columns="stimulus").equals(second.drop(columns="stimulus"))
    assert stimulus_id("bold", b"1" * 32) != stimulus_id("bold", b"2" * 32)


def test_a_build_that_was_interrupted_goes_on(run, small, tmp_path, monkeypatch):
    import reports.video

    rendered = []
    write = reports.video.write_video

    def stop_at_the_fourth(panels, path, **options):
        if len(rendered) == 3:
            raise KeyboardInterrupt
        rendered.append(path.name)
        return write(panels, path, **options)

    monkeypatch.setattr(reports.video, "write_video", stop_at_the_fourth)
    out = tmp_path / "study"
    with pytest.raises(KeyboardInterrupt):
        build_study(run, out, small)
    with pytest.raises(StoreError, match="its build was interrupted: run it again"):
        read_plan(StudyFolder(out))
    # One of them is damaged meanwhile, and a line of the notes was cut off.
    (out / "stimuli" / rendered[0]).write_bytes(b"half")
    with StudyFolder(out).rendered.open("a") as file:
        file.write('["abc')
    counts = []
    monkeypatch.setattr(
        reports.video,
        "write_video",
        lambda panels, path, **options: counts.append(path) or write(panels, path, **options),
    )
    seen = []
    finished = build_study(run, out, small, report=lambda done, total: seen.append((done, total)))
    assert finished.kept == 2 and len(counts) == 6 and seen[0] == (2, 8) and seen[-1] == (8, 8)
    read_plan(finished.folder)
    # Once more: nothing to do.
    assert build_study(run, out, small).kept == 8 and len(counts) == 6


def test_other_settings_or_other_results_need_another_folder(run, small, built, plant, tmp_path):
    with pytest.raises(StoreError, match=r"other settings \(clips, seed\)"):
        build_study(run, built.path, replace(small, clips=1, seed=2))
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.txt").write_text("x")
    with pytest.raises(StoreError, match="not empty and holds no study"):
        build_study(run, tmp_path / "full", small)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"methods": ("bald",)}, UnknownNameError, "unknown method of the run 'bald'; did you mean 'bold'"),
        ({"actions": ("jmp",)}, UnknownNameError, "did you mean 'jump'"),
        ({"task": "adult:elder"}, UnknownNameError, "task of the run"),
        ({"clips": 0}, ConfigError, "--clips is 1 to 1000, not 0"),
        ({"seconds": float("nan")}, ConfigError, "--seconds"),
        ({"min_watch": -1.0}, ConfigError, "--min-watch"),
        ({"catch": 9}, DataError, "9 catch trials need as many clips that are not shown"),
        ({"methods": ("bold",)}, DataError, "no two methods have a result"),
    ],
)
def test_settings_out_of_range_are_refused(run, small, tmp_path, change, error, message):
    with pytest.raises(error, match=message):
        build_study(run, tmp_path / "study", replace(small, **change))


def test_every_source_is_named_and_what_may_not_be_passed_on_is_said(plant, small, tmp_path):
    built = build_study(
        plant(tmp_path / "run", dataset="kinder-gator"), tmp_path / "study", replace(small, clips=1, catch=0)
    )
    assert any("no licence for redistribution" in note and "do not publish them" in note for note in built.notes)
    assert "none stated" in built.plan.source
    with pytest.raises(ConfigError, match="give --credit"):
        name_source("folder:captures")
    assert name_source("folder:captures", "Mine, CC BY 4.0")[0] == "Mine, CC BY 4.0"


@pytest.fixture
def copy(built, tmp_path):
    shutil.copytree(built.path, tmp_path / "study")
    return StudyFolder(tmp_path / "study")


def test_whatever_is_changed_after_signing_is_refused_by_name(copy):
    def refused(match):
        with pytest.raises(StoreError, match=match):
            read_plan(copy)

    video = sorted(copy.stimuli.iterdir())[2]
    data = video.read_bytes()
    video.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    refused(rf"{video.name} was changed after the plan was signed: restore the stimulus")
    video.unlink()
    refused(rf"{video.name} is missing")
    video.write_bytes(data)
    (copy.stimuli / "more.mp4").write_bytes(b"")
    refused(r"more.mp4 is not in the plan")
    (copy.stimuli / "more.mp4").unlink()
    key = copy.key.read_text()
    copy.key.write_text(key.replace("bold", "child"))
    refused("key.csv was changed after the plan was signed")
    copy.key.write_text(key)
    text = copy.plan.read_text()
    for old, new in (('"raters": 6', '"raters": 600'), ('"min_watch": 0.0', '"min_watch": 0.1')):
        assert old in text
        copy.plan.write_text(text.replace(old, new))
        refused("plan.json was changed after it was signed")
    document = json.loads(text)
    document["signature"] = "0" * 64
    copy.plan.write_text(json.dumps(document))
    refused("plan.json was changed after it was signed")
    for nonsense in ("[]", "{", '{"plan": 1}', '{"plan": NaN, "signature": ""}'):
        copy.plan.write_text(nonsense)
        refused("plan.json is no")
    copy.plan.write_text(text)
    read_plan(copy)
    secret = copy.secret.read_bytes()
    copy.secret.unlink()
    refused("secret is missing")
    copy.secret.write_bytes(bytes(32))
    refused("plan.json was changed")
    copy.secret.write_bytes(secret)
    read_plan(copy)
