from __future__ import annotations

import sys
from importlib.metadata import EntryPoint

import pytest

from benchmark.errors import RegistryError, UnknownNameError
from benchmark.registry import METHODS, METRICS, Registry


@pytest.fixture
def modules(tmp_path, monkeypatch):
    """Modules of entries that record their import, and a mapping of them."""
    (tmp_path / "reg_entries.py").write_text(
        "from benchmark.api import MethodInfo, Capabilities, Supervision\n"
        "class Good:\n"
        "    info = MethodInfo('good', 'does ' 'good', Capabilities(supervision=Supervision.PAIRED, changes_timing=True))\n"
        "class Bare:\n    pass\n"
    )
    (tmp_path / "reg_broken.py").write_text(
        "import a_library_nobody_has\n"
        "class Heavy:\n    info = MethodInfo(name='heavy', summary='needs a library', capabilities=Capabilities())\n"
    )
    (tmp_path / "reg_syntax.py").write_text("class :\n")
    (tmp_path / "reg_map.py").write_text(
        "MAP = {'good': 'reg_entries:Good', 'bare': 'reg_entries:Bare', 'heavy': 'reg_broken:Heavy',\n"
        "       'gone': 'reg_nowhere:X', 'unnamed': 'reg_entries:Missing', 'garbled': 'reg_syntax:Y'}\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    for name in ("reg_entries", "reg_broken", "reg_map", "reg_syntax"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    return Registry("method", "test.group", "reg_map:MAP", ("name", "summary", "capabilities"))


def entry_points(monkeypatch, *points):
    def found(*, group):
        return [EntryPoint(name, value, group) for name, value in points]

    monkeypatch.setattr("importlib.metadata.entry_points", found)


def test_listing_and_describing_import_no_entry(modules):
    assert modules.names() == ["good", "bare", "heavy", "gone", "unnamed", "garbled"]
    good = modules.describe("good")
    assert (good.summary, good.error) == ("does good", None)
    assert good.facts["capabilities"] == {"supervision": "paired", "changes_timing": True}
    assert "reg_entries" not in sys.modules
    assert modules.get("good").__name__ == "Good"
    assert "reg_entries" in sys.modules


def test_a_broken_entry_is_listed_and_breaks_only_itself(modules):
    assert modules.describe("heavy").summary == "needs a library"
    assert modules.describe("bare").error is None
    for name, why in [("gone", "reg_nowhere"), ("unnamed", "Missing"), ("garbled", "")]:
        assert why in (modules.describe(name).error or "")
        assert modules.describe(name).error
    with pytest.raises(RegistryError, match=r"'heavy'.*ModuleNotFoundError.*a_library_nobody_has"):
        modules.get("heavy")
    with pytest.raises(RegistryError, match="has no 'Missing'"):
        modules.get("unnamed")
    with pytest.raises(RegistryError, match="SyntaxError"):
        modules.get("garbled")
    assert modules.get("good")


def test_an_unknown_name_suggests_the_nearest(modules):
    with pytest.raises(UnknownNameError, match="unknown method 'goood'; did you mean 'good'"):
        modules.get("goood")


def test_installed_packages_come_through_entry_points(modules, monkeypatch):
    entry_points(monkeypatch, ("extra", "reg_entries:Bare"))
    assert modules.names()[-1] == "extra"
    assert modules.get("extra").__name__ == "Bare"
    assert "reg_entries:Bare" in modules.origin("extra")


def test_collisions_name_both_origins(modules, monkeypatch):
    entry_points(monkeypatch, ("good", "reg_other:Good"))
    with pytest.raises(
        RegistryError, match=r"two methods are named 'good': built-in \(reg_entries:Good\) and .*reg_other:Good"
    ):
        modules.names()


def test_two_installed_packages_collide_too(modules, monkeypatch):
    entry_points(monkeypatch, ("mine", "a:X"), ("mine", "b:X"))
    with pytest.raises(RegistryError, match=r"'mine'.*a:X.*b:X"):
        modules.get("good")


def test_the_decorator_registers_and_collides(modules):
    @modules.register(name="notebook")
    class Mine:
        pass

    assert modules.get("notebook") is Mine
    assert modules.names()[-1] == "notebook"
    with pytest.raises(RegistryError, match="two methods are named 'good'"):
        modules.register(name="good")(Mine)
    modules.unregister("notebook")
    assert "notebook" not in modules


def test_the_decorator_takes_the_name_from_info(modules):
    class Info:
        name = "from-info"
        summary = "says so"

    @modules.register
    class Mine:
        info = Info

    assert modules.get("from-info") is Mine
    assert modules.describe("from-info").summary == "says so"
    with pytest.raises(RegistryError, match=r"no info\.name"):
        modules.register(object())


def test_running_a_cell_again_replaces_its_class(modules):
    def cell():
        @modules.register(name="again")
        class Mine:
            pass

        return Mine

    cell()
    second = cell()
    assert modules.get("again") is second


def test_lazy_strings_can_be_registered(modules):
    modules.register("lazy", "reg_entries:Bare")
    assert modules.get("lazy").__name__ == "Bare"
    for bad in ("reg_entries", "reg_entries:", None):
        with pytest.raises(RegistryError, match="needs a target"):
            modules.register("bad", bad)


def test_selection_by_pattern(modules):
    assert modules.select("all") == modules.names()
    assert modules.select("g*") == ["good", "gone", "garbled"]
    assert modules.select("bare") == ["bare"]
    with pytest.raises(UnknownNameError, match=r"pattern 'x\*'"):
        modules.select("x*")
    with pytest.raises(UnknownNameError):
        modules.select("nothing")


@pytest.mark.parametrize("registry", [METHODS, METRICS])
def test_every_built_in_entry_loads_and_is_what_its_name_says(registry):
    assert registry.names()
    for name in registry.names():
        found = registry.get(name)
        assert found.info.name == name
        described = registry.describe(name)
        assert described.error is None
        assert described.summary == found.info.summary


def test_an_info_made_by_a_function_is_read_by_importing(tmp_path, monkeypatch):
    (tmp_path / "made_info.py").write_text(
        "from types import SimpleNamespace\n"
        "def make(name, extra):\n    return SimpleNamespace(name=name, summary=f'all about {extra}', unit='m')\n"
        "class Thing:\n    info = make('thing', 'things')\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    registry = Registry("thing", "test.none")
    registry.register("thing", "made_info:Thing")
    found = registry.describe("thing")
    assert found.summary == "all about things"
    assert found.facts["unit"] == "m"
