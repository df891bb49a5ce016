from __future__ import annotations

from pathlib import Path

import pytest

from benchmark.config import RunConfig, load_config, parse_value, presets, read_config, to_toml
from benchmark.errors import ConfigError, UnknownNameError


@pytest.fixture
def settings(tmp_path):
    def write(text: str) -> Path:
        path = tmp_path / "mine.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def test_layers_in_order(settings):
    file = settings("repetitions = 2\nlimit = 9\nseed = 7\n[split]\nfold = 3\n")
    config = load_config(preset="quick", file=file, flags={"seed": 8, "limit": None, "split": {"seed": 4}})
    assert config.time_limit == 600.0  # preset
    assert (config.repetitions, config.limit) == (2, 9)  # file over preset
    assert config.seed == 8  # flags over file
    assert (config.split.fold, config.split.seed) == (3, 4)  # tables are merged
    assert config.jobs is None  # default


def test_a_file_can_name_a_preset(settings):
    assert load_config(file=settings('preset = "quick"\nlimit = 2\n')).time_limit == 600.0
    assert load_config(file=settings('preset = "quick"\nlimit = 2\n')).limit == 2


def test_every_preset_is_valid():
    assert {"quick", "full"} <= set(presets())
    for preset in presets():
        assert load_config(preset=preset).preset == preset
    with pytest.raises(UnknownNameError, match="did you mean 'quick'"):
        load_config(preset="quik")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("repetition = 2", r"mine\.toml: unknown setting 'repetition'; did you mean 'repetitions'"),
        ("[split]\nfolds = 2", r"mine\.toml: unknown setting 'split\.folds'; did you mean 'split\.fold'"),
        ("repetitions = 0", r"mine\.toml: repetitions: .*greater than or equal to 1"),
        ('overwrite = "sometimes"', r"mine\.toml: overwrite: .*'missing', 'always', 'never' or 'only-cached'"),
        ('tasks = ["adult"]', r"source:target"),
        ('tasks = ["adult:adult"]', r"the same"),
        ("methods = []", r"methods"),
        ('variants = ["polished"]', r"variants"),
        ("limit = nan", r"limit"),
        ("= 3", r"mine\.toml"),
        ("preset = 3", r"mine\.toml: preset: .*full, quick.*not 3"),
        ('dataset = "kinder-gator"', r"mine\.toml: dataset is a table \[dataset\] with name.*'kinder-gator'"),
        ("[split]\nprotocol = 3", r"mine\.toml: split\.protocol"),
    ],
)
def test_a_wrong_setting_names_file_and_field(settings, text, message):
    with pytest.raises(ConfigError, match=message):
        load_config(file=settings(text), flags={"dataset": {"name": None}, "split": {"fold": None}})


def test_a_wrong_flag_is_told_from_a_wrong_file(settings):
    with pytest.raises(ConfigError, match=r"the command line: jobs"):
        load_config(file=settings("jobs = 2"), flags={"jobs": 0})


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"no settings file .*none\.toml"):
        load_config(file=tmp_path / "none.toml")


def test_assignments():
    config = load_config(assign=["nearest.shortlist=8", "dynamic-scaling.mode=time", "nearest.fine_fps=15.0"])
    assert config.params == {"nearest": {"shortlist": 8, "fine_fps": 15.0}, "dynamic-scaling": {"mode": "time"}}
    for bad in ("nearest", "nearest.x", "x=1", ".x=1", "nearest.=1"):
        with pytest.raises(ConfigError, match="--set"):
            load_config(assign=[bad])


@pytest.mark.parametrize(
    ("text", "value"), [("1", 1), ("1.5", 1.5), ("true", True), ("[1, 2]", [1, 2]), ("both", "both"), ('"a b"', "a b")]
)
def test_typed_values(text, value):
    assert parse_value(text) == value
    assert type(parse_value(text)) is type(value)


def test_a_value_of_endless_brackets_is_text():
    assert parse_value("[" * 5000) == "[" * 5000


def test_settings_survive_being_written(tmp_path):
    config = load_config(
        flags={
            "dataset": {
                "name": "folder:/data/x y",
                "options": {"pattern": '{style}/"q"\\{actor}.bvh', "n": 2, "on": True},
            },
            "methods": ["nearest[shortlist=8]", "all"],
            "tasks": ["adult:child"],
            "time_limit": 1e-3,
            "split": {"parameters": {"held_out": 0.25}},
            "out": tmp_path,
        },
        assign=["a.list=[1, 2.5]", "a.text=ü"],
    )
    (tmp_path / "config.toml").write_text(to_toml(config), encoding="utf-8")
    assert read_config(tmp_path / "config.toml") == config


def test_tasks_and_variants_are_normalised():
    config = load_config(flags={"tasks": ["a:b", "a:b", "b:a"], "variants": ["cleaned", "raw"]})
    assert config.tasks == ("a:b", "b:a")
    assert config.variants == ("raw", "cleaned")


def test_settings_are_frozen():
    with pytest.raises(ValueError, match="frozen"):
        RunConfig().jobs = 3
