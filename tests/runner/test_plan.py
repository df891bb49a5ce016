from __future__ import annotations

import json
import re
from dataclasses import replace

import pytest

from benchmark.api import Capabilities, Supervision
from benchmark.digest import digest
from benchmark.errors import ConfigError, ContractError, RegistryError, UnknownNameError
from benchmark.runner import plan as plan_module
from benchmark.runner import selection
from benchmark.runner.plan import capability_fate, limited, make_plan
from benchmark.runner.selection import choose_methods, choose_metrics


def keys(prepared) -> dict[str, str]:
    return {(cell.method, cell.task, cell.repetition): cell.key for cell in prepared.cells}


def test_planning_reads_no_clip_and_repeats(make, fakes, monkeypatch):
    monkeypatch.setattr(fakes.Fake, "load", lambda *_: pytest.fail("a clip was read"))
    first, second = make("all"), make("all")
    assert first.cells == second.cells
    assert len({cell.key for cell in first.cells}) == len(first.cells)


def test_a_key_is_the_digest_of_its_ingredients(make):
    for cell in make("copy", "noisy").cells:
        assert cell.key == digest(cell.ingredients)
        assert len(cell.key) == 64


def test_keys_ignore_order_jobs_output_path_and_company(make, tmp_path):
    base = keys(make("copy", "noisy"))
    assert keys(make("noisy", "copy")) == base
    assert keys(make("copy", "noisy", "paired")).items() >= base.items()
    others = {"jobs": 4, "out": tmp_path / "elsewhere", "time_limit": 5.0, "overwrite": "always", "force": ["copy"]}
    for name, value in others.items():
        assert keys(make("copy", "noisy", **{name: value})) == base, name
    assert keys(make("copy", "noisy", backend="serial")) == base


@pytest.mark.parametrize(
    "change",
    [
        {"seed": 1},
        {"threads": 2},
        {"limit": 2},
        {"variants": ["raw"]},
        {"split": {"fold": 1}},
        {"split": {"seed": 1}},
        {"dataset": {"name": "fake", "options": {"revision": 2}}},
        {"tasks": ["child:adult"]},
        {"params": {"copy": {"amount": 2.0}}},
    ],
    ids=str,
)
def test_every_setting_that_can_change_a_number_changes_the_key(make, change):
    def key(prepared):
        (cell,) = (cell for cell in prepared.cells if cell.method == "copy")
        return cell.key

    assert key(make("copy", **change)) != key(make("copy"))


def test_every_field_of_a_choice_changes_the_key(make, registries):
    base = make("copy")
    (choice,) = choose_methods(registries[0], ["copy"])

    def key(changed):
        (cell,) = make_plan(base.config, base.dataset, base.splits, [changed], gpu=lambda: False)
        return cell.key

    changes = [{"name": "other"}, {"version": "2"}, {"source": "other"}, {"params": {**choice.params, "amount": 3.0}}]
    assert len({key(choice)} | {key(replace(choice, **change)) for change in changes}) == 5
    assert key(replace(choice, label="copy[again]", origin="elsewhere")) == key(choice)


def test_code_the_pipeline_and_the_contract_are_in_the_key(make, monkeypatch):
    base = keys(make("copy"))
    for name, value in [("CONTRACT_VERSION", 999), ("source_digest", lambda *modules: "other")]:
        with monkeypatch.context() as patch:
            patch.setattr(plan_module, name, value)
            assert not set(keys(make("copy")).values()) & set(base.values()), name
    assert keys(make("copy")) == base


def test_pipeline_names_the_code_that_makes_outputs():
    assert {"benchmark.motion", "benchmark.api", "benchmark.data.views", "benchmark.runner.execute"} <= set(
        plan_module.PIPELINE
    )


def test_editing_a_helper_of_a_method_changes_its_key_only(tmp_path, monkeypatch, make, registries):
    package = tmp_path / "plug_under_test"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "helper.py").write_text("FACTOR = 1\n")
    (package / "main.py").write_text(
        "from fakebench import Copy, _info\nfrom plug_under_test.helper import FACTOR\n"
        "class Mine(Copy):\n    info = _info('mine')\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    registries[0].register("mine", "plug_under_test.main:Mine")
    before = keys(make("mine", "copy"))
    (package / "helper.py").write_text("FACTOR = 2\n")
    after = keys(make("mine", "copy"))
    assert {name for name in before if before[name] != after[name]} == {("mine", "adult:child", 0)}


def test_repetitions_are_for_random_methods_only(make):
    cells = make("copy", "noisy", repetitions=3).cells
    assert [cell.repetition for cell in cells if cell.method == "noisy"] == [0, 1, 2]
    assert [cell.repetition for cell in cells if cell.method == "copy"] == [0]
    assert len({cell.seed for cell in cells if cell.method == "noisy"}) == 3


def test_the_real_row_is_always_there(make):
    assert [cell.method for cell in make("copy").cells] == ["copy", "child-reference"]
    assert [cell.method for cell in make("child-reference", "copy").cells] == ["child-reference", "copy"]


def fates(prepared):
    return {cell.method: (cell.fate, cell.reason) for cell in prepared.cells}


def test_fates_come_from_capabilities(make):
    found = fates(make("all"))
    assert found["copy"] == ("run", "")
    assert found["needs-gpu"] == ("skipped", "needs a GPU")
    assert found["at-120"][0] == "skipped"
    assert "120 frames per second" in found["at-120"][1]
    assert found["absent"][0] == "failed"
    assert "fakebench_absent" in found["absent"][1]


def test_a_gpu_is_used_where_a_method_asks_for_one(make):
    def device(**settings):
        return {cell.method: (cell.device, cell.fate) for cell in make("needs-gpu", "copy", **settings).cells}

    assert device(gpu=lambda: True)["needs-gpu"] == ("cuda", "run")
    assert device(gpu=lambda: True)["copy"] == ("cpu", "run")
    assert device(gpu=lambda: True, device="cpu")["needs-gpu"] == ("cpu", "skipped")
    with pytest.raises(ConfigError, match="cuda"):
        device(device="cuda")
    make("copy", gpu=lambda: pytest.fail("nobody asked for a GPU"))


def test_supervision_is_checked_against_the_training_clips(make):
    prepared = make("copy")
    (split,) = prepared.splits
    adults = tuple(clip for clip in split.train if clip.startswith("adult"))
    walks = tuple(clip for clip in split.train if ("walk" in clip) == clip.startswith("adult"))

    def fate(supervision, train):
        return capability_fate(Capabilities(supervision=supervision), prepared.dataset, replace(split, train=train))

    assert fate(Supervision.UNPAIRED, split.train)[0] == "run"
    assert fate(Supervision.UNPAIRED, adults)[0] == "skipped"
    assert "'child'" in fate(Supervision.UNPAIRED, adults)[1]
    assert fate(Supervision.NONE, adults)[0] == "run"
    assert fate(Supervision.UNPAIRED, walks)[0] == "run"
    assert fate(Supervision.PAIRED, walks)[0] == "skipped"
    assert fate(Supervision.PAIRED, split.train)[0] == "run"


def test_the_ceiling_row_needs_real_clips(make):
    prepared = make("copy")
    split = replace(prepared.splits[0], references=())
    assert capability_fate(Capabilities(uses_reference=True), prepared.dataset, split)[0] == "skipped"
    assert (
        capability_fate(Capabilities(supervision=Supervision.NONE), prepared.dataset, replace(split, test=()))[0]
        == "skipped"
    )


def test_variants_and_parameters(registries):
    methods = registries[0]

    def labels(*requests, **params):
        return {choice.label: choice.params["amount"] for choice in choose_methods(methods, requests, params)}

    assert labels("copy") == {"copy": 1.0}
    assert labels("copy[half]") == {"copy[half]": 0.5}
    # Presets are run when asked for, and by no pattern.
    assert labels("copy[tenth]") == {"copy[tenth]": 0.1}
    assert labels("cop*") == {"copy": 1.0, "copy[half]": 0.5}
    assert labels("copy[amount=0.25]") == {"copy[amount=0.25]": 0.25}
    assert labels("copy[amount=0.25, pause=1]") == {"copy[amount=0.25, pause=1]": 0.25}
    assert labels("copy", "copy[half]", "copy", copy={"pause": 1.0}) == {"copy": 1.0, "copy[half]": 0.5}


@pytest.mark.parametrize(
    ("request_", "error", "message"),
    [
        ("cpy", UnknownNameError, "did you mean 'copy'"),
        ("copy[hlf]", UnknownNameError, "unknown variant of copy 'hlf'; did you mean 'half'"),
        ("copy[amout=2]", ConfigError, "no parameter 'amout'; did you mean 'amount'"),
        ("copy[amount=1,half]", ConfigError, "'half' is not param=value"),
        ("copy[", ConfigError, "write name"),
        ("absent", RegistryError, "fakebench_absent"),
    ],
)
def test_wrong_requests(registries, request_, error, message):
    with pytest.raises(error, match=re.escape(message)):
        choose_methods(registries[0], [request_])


def test_parameters_of_an_unknown_method_are_an_error(registries):
    with pytest.raises(UnknownNameError):
        choose_methods(registries[0], ["copy"], {"cpy": {}})


def test_what_is_no_method_or_metric_is_refused(registries):
    methods, metrics = registries
    methods.register("function", "fakebench:skeleton")
    metrics.register("test/misnamed", "fakebench:Height")
    metrics.register("test/nothing", "fakebench:skeleton")
    with pytest.raises(ContractError, match="not a complete subclass of Method"):
        choose_methods(methods, ["function"])
    with pytest.raises(ContractError, match="calls itself 'test/height'"):
        choose_metrics(metrics, ["test/misnamed"])
    assert {m.name: bool(m.error) for m in choose_metrics(metrics, ["all"])}["test/nothing"]


def test_a_notebook_class_is_digested_from_its_text(monkeypatch):
    class Base:
        pass

    class Mine(Base):
        pass

    assert not selection.importable(Mine)
    first = selection.class_digest(Mine)
    monkeypatch.setattr(selection.inspect, "getsource", lambda cls: "other text")
    assert selection.class_digest(Mine) != first


def test_limit_spreads_over_the_clips():
    assert limited(range(10), None) == list(range(10))
    assert limited(range(10), 20) == list(range(10))
    assert limited(range(10), 2) == [2, 7]
    assert limited(range(10), 10) == list(range(10))
    assert limited(range(9), 1) == [4]
    for count in range(1, 10):
        assert len(set(limited(range(10), count))) == count


def test_forced_names_must_be_planned(make):
    with pytest.raises(UnknownNameError, match="force"):
        make("copy", force=["noisy"])
    with pytest.raises(ConfigError, match="contradict"):
        make("copy", force=["copy"], overwrite="only-cached")


def test_equal_cells_are_planned_once(make):
    cells = make("copy", "copy[amount=1.0]").cells
    assert [cell.method for cell in cells] == ["copy", "child-reference"]


def test_a_plan_is_read_back_as_it_was_written(make):
    cells = make("all", repetitions=3, tasks=["adult:child", "child:adult"]).cells
    text = plan_module.plan_text(cells)
    assert plan_module.read_plan(json.loads(text)) == cells
    # One short line for each cell, however much its key is made of.
    assert sum(cell.key in line and len(line) < 120 for line in text.splitlines() for cell in cells) == len(cells)


def test_planning_many_cells_goes_through_each_method_once(make, monkeypatch):
    """What grows with the repetitions is the keys and nothing else: neither code is digested anew nor a setting written."""
    calls: list[str] = []

    def counted(name, function):
        def call(*args, **kwargs):
            calls.append(name)
            return function(*args, **kwargs)

        return call

    for name in ("source_digest", "digest", "capability_fate"):
        monkeypatch.setattr(plan_module, name, counted(name, getattr(plan_module, name)))
    few = make("noisy", repetitions=2)
    first = len(calls)
    many = make("noisy", repetitions=2000)
    assert len(calls) == 2 * first
    assert len(many.cells) == len(few.cells) + 1998
    # Cells of one method share what they have in common, so that very many fit in memory.
    assert len({id(cell.params) for cell in many.cells}) == 2
