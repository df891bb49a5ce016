"""The protocol of published experiments, which name their performers."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner

from benchmark.cli import cli
from benchmark.config import load_config, to_toml
from benchmark.data.catalog import open_dataset
from benchmark.data.splits import PROTOCOLS, Split, TestItem, check, load_split, make_split
from benchmark.data.views import eval_items, train_view
from benchmark.errors import ConfigError, DataError, LeakageError, UnknownNameError

EXPERIMENT = Path(__file__).resolve().parents[2] / "experiments" / "dong2018.toml"


def named(dataset, **parameters):
    return make_split(dataset, "adult", "child", protocol="named", **parameters)


def test_the_named_train_and_are_tested_and_all_other_children_are_references(grid):
    dataset = grid(4, 5, 3, 2)
    split = named(dataset, train=["a1", "c2"], test=["a3"])
    of = {clip.clip_id: clip for clip in dataset.records}
    assert set(split.train) == {i for i, r in of.items() if r.actor in ("a1", "c2")}
    assert {item.clip_id for item in split.test} == {i for i, r in of.items() if r.actor == "a3"}
    assert not any(item.seen_actor for item in split.test)
    assert set(split.references) == {i for i, r in of.items() if r.style == "child" and r.actor != "c2"}
    assert split.parameters == {"train": ("a1", "c2"), "test": ("a3",), "actions": ()}
    assert "named" in PROTOCOLS


def test_actions_narrow_all_three_sides(grid):
    dataset = grid(3, 3, 4, 2)
    split = named(dataset, train=["a0", "c0"], test=["a1", "a2"], actions=["action1", "action3"])
    assert {dataset.record(clip_id).action for clip_id in split.clip_ids} == {"action1", "action3"}
    assert (len(split.train), len(split.test), len(split.references)) == (8, 8, 8)
    view = train_view(dataset, split, "adult", "child")
    assert view.clip_ids == split.train and view.actions == ("action1", "action3")
    items = eval_items(dataset, split, "adult", "child")
    assert all({dataset.record(i).action for i in item.reference_ids} == {item.record.action} for item in items)


def test_the_order_and_repetition_of_names_change_nothing(grid):
    dataset = grid(4, 4, 3, 1)
    first = named(dataset, train=["a0", "c1", "c0"], test=("a2", "a1"), actions=["action2", "action0"])
    second = named(dataset, train=["c0", "a0", "c1", "a0"], test=["a1", "a2"], actions=["action0", "action2"])
    assert first == second and first.digest == second.digest
    assert first.digest != named(dataset, train=["a0", "c1", "c0"], test=["a1", "a2"], actions=["action0"]).digest


def test_people_who_perform_both_styles_stay_on_one_side(listed, record):
    dataset = listed([record(s, p, "walk", "1") for s in ("normal", "old") for p in ("p0", "p1", "p2")])
    split = make_split(dataset, "normal", "old", protocol="named", train=["p0"], test=["p1"])
    assert split.train == ("normal/p0/walk_1", "old/p0/walk_1")
    assert [item.clip_id for item in split.test] == ["normal/p1/walk_1"]
    assert split.references == ("old/p1/walk_1", "old/p2/walk_1")


def test_a_manifest_comes_back_and_refuses_other_kinds_of_parameters(grid, tmp_path):
    dataset = grid(3, 3, 2, 1)
    split = named(dataset, train=["a0", "c0"], test=["a1"], actions=["action0"])
    path = tmp_path / "split.json"
    split.to_json(path)
    again = load_split(path, dataset)
    assert again == split and again.digest == split.digest and again.parameters["train"] == ("a0", "c0")
    stored = json.loads(path.read_text())
    for value in ("a0", [0, 1], {"a0": 1}, None):
        path.write_text(json.dumps({**stored, "parameters": {**stored["parameters"], "train": value}}))
        with pytest.raises(DataError, match=r"parameters\.train"):
            Split.from_json(path)
    path.write_text(json.dumps({**stored, "parameters": {**stored["parameters"], "train": ["a0", "c1"]}}))
    with pytest.raises(DataError, match="changed after it was written"):
        Split.from_json(path)


def test_wrong_names_are_told_with_the_nearest(grid):
    dataset = grid(3, 3, 2, 1)
    with pytest.raises(UnknownNameError, match=r"performer of data set \S+ 'a9'; did you mean 'a[0-2]'"):
        named(dataset, train=["a9", "c0"], test=["a1"])
    with pytest.raises(UnknownNameError, match="unknown performer"):
        named(dataset, train=["a0", "c0"], test=["b1"])
    with pytest.raises(UnknownNameError, match=r"action of data set \S+ 'action_1'; did you mean 'action1'"):
        named(dataset, train=["a0", "c0"], test=["a1"], actions=["action_1"])
    with pytest.raises(UnknownNameError, match=r"parameter of protocol named 'tests'; did you mean 'test'"):
        named(dataset, train=["a0", "c0"], tests=["a1"])


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"test": ["a1"]}, r"needs the parameter 'train', a list of performers of \S+: a0, a1, a2, c0, c1, c2"),
        ({"train": ["a0", "c0"]}, "needs the parameter 'test'"),
        ({"train": ["a0", "c0"], "test": ["a0"]}, "'a0' is named under both"),
        ({"train": ["a0", "c0"], "test": ["c1"]}, "'c1' has no clip in style 'adult'"),
        ({"train": ["a0", "a2"], "test": ["a1"]}, "no 'child' clip to learn from"),
        ({"train": ["a0", "c0"], "test": ["a1"], "fold": 1}, "fold 0 only"),
        (
            {"train": "a0", "test": ["a1"]},
            r'\'train\' of protocol \'named\' must be a list of names.*"one".*not \'a0\'',
        ),
        ({"train": 734.0, "test": ["a1"]}, "must be a list of names.*not 734.0"),
        ({"train": ["a0", 723], "test": ["a1"]}, "must be a list of names"),
    ],
)
def test_requests_that_cannot_be_met(grid, parameters, message):
    with pytest.raises(DataError, match=message):
        named(grid(3, 3, 2, 1), **parameters)


def test_names_are_refused_where_a_number_is_due(grid):
    with pytest.raises(DataError, match="'n_train' of protocol 'paper' must be a number, not"):
        make_split(grid(4, 4, 4, 1), "adult", "child", protocol="paper", n_train=["a0"])


def test_a_performer_without_the_action_is_named(listed, record):
    clips = [record(s, p, "walk", "1") for s, p in (("adult", "a0"), ("adult", "a1"), ("child", "c0"))]
    dataset = listed([*clips, record("adult", "a1", "run", "1"), record("child", "c0", "run", "1")])
    with pytest.raises(DataError, match="'a0' has no clip in style 'adult' or 'child' of run"):
        named(dataset, train=["a0", "c0"], test=["a1"], actions=["run"])


def test_planted_leaks_are_found(grid):
    dataset = grid(4, 4, 3, 1)
    split = named(dataset, train=["a0", "c0"], test=["a1"], actions=["action0"])

    def moved(clip_id, **sides):
        return replace(split, files={**split.files, clip_id: dataset.record(clip_id).sha256}, **sides)

    leaks = {
        "training clip 'adult/a2/action0_0' is by performer 'a2', whom the split does not name": moved(
            "adult/a2/action0_0", train=(*split.train, "adult/a2/action0_0")
        ),
        "test clip 'adult/a3/action0_0' is by performer 'a3'": moved(
            "adult/a3/action0_0", test=(*split.test, TestItem("adult/a3/action0_0", False))
        ),
        "reference clip 'child/c1/action1_0' is of action 'action1'": moved(
            "child/c1/action1_0", references=(*split.references, "child/c1/action1_0")
        ),
        "performer 'c0' is in training": replace(
            moved("child/c0/action1_0", references=(*split.references, "child/c0/action1_0")),
            parameters={**split.parameters, "actions": ()},
        ),
    }
    for message, leaky in leaks.items():
        with pytest.raises(LeakageError, match=message):
            check(leaky, dataset)


def test_settings_hold_numbers_and_names(tmp_path):
    path = tmp_path / "mine.toml"

    def read(text):
        path.write_text(text)
        return load_config(file=path)

    config = read('[split]\nprotocol = "named"\n[split.parameters]\ntrain = ["734"]\nfolds = 3\n')
    assert config.split.parameters == {"train": ("734",), "folds": 3.0}
    path.write_text(to_toml(config))
    assert load_config(file=path) == config
    with pytest.raises(
        ConfigError, match=r"mine\.toml: split\.parameters\.train\.names\.0: .*valid string \(got 734\)"
    ):
        read("[split.parameters]\ntrain = [734]\n")
    with pytest.raises(ConfigError, match=r"split\.parameters\.folds\.number: .*valid number.*'many'"):
        read('[split.parameters]\nfolds = "many"\n')
    with pytest.raises(ConfigError, match=r"fold is a setting of the split itself: write split\.fold"):
        read("[split.parameters]\nfold = 1\n")


def test_the_command_line_takes_names():
    command = ["run", "--dataset", "synthetic", "--methods", "identity", "--split", "named", "--dry-run"]

    def given(*options):
        options = [part for option in options for part in ("--split-option", option)]
        return CliRunner().invoke(cli, [*command, *options])

    fine = given('train=["adult001", "child002"]', 'test=["adult003"]', 'actions=["jump"]')
    assert fine.exit_code == 0, fine.output
    assert "identity" in fine.output
    wrong = given('train=["adult001", "child02"]', 'test=["adult003"]')
    assert isinstance(wrong.exception, UnknownNameError) and "did you mean 'child002'" in str(wrong.exception)
    malformed = given("train")
    assert isinstance(malformed.exception, ConfigError) and "write name=value" in str(malformed.exception)


def test_the_help_names_the_protocol():
    text = " ".join(CliRunner().invoke(cli, ["run", "--help"]).output.split())
    assert "action or named" in text and 'train=["734", "723"]' in text


def test_the_committed_experiment_is_valid():
    config = load_config(file=EXPERIMENT)
    assert config.dataset.name == "kinder-gator" and config.tasks == ("adult:child",)
    assert config.split.parameters == {
        "train": ("734", "723"),
        "test": ("934",),
        "actions": ("jump-as-high-as-you-can",),
    }


@pytest.mark.real_data
def test_the_committed_experiment_splits_as_the_poster_did(kinder_gator):
    config = load_config(file=EXPERIMENT)
    dataset = open_dataset(config.dataset.name, root=kinder_gator)
    wanted = config.split
    split = make_split(
        dataset, "adult", "child", protocol=wanted.protocol, fold=wanted.fold, seed=wanted.seed, **wanted.parameters
    )
    jump = "jump-as-high-as-you-can_1"
    assert split.train == (f"adult/734/{jump}", f"child/723/{jump}")
    assert split.test == (TestItem(f"adult/934/{jump}", seen_actor=False),)
    assert split.references == tuple(f"child/{child}/{jump}" for child in (106, 169, 337, 342, 595, 644))
