from __future__ import annotations

import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from benchmark.commands.check_method import check_method, resolve
from benchmark.errors import RegistryError, UnknownNameError

PLUGIN = Path(__file__).parents[1] / "fixtures" / "plugin" / "src" / "gaussian_smooth"


@pytest.fixture(autouse=True)
def clean_imports(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    before = set(sys.modules)
    yield
    for name in set(sys.modules) - before:
        if "gaussian_smooth" in name or name.startswith("mine"):
            del sys.modules[name]


def invoke(*arguments: str):
    return CliRunner().invoke(check_method, list(arguments), terminal_width=200)


def test_a_registered_method() -> None:
    result = invoke("identity")
    assert result.exit_code == 0, result.output
    assert "16 passed, 0 failed, 1 not concerned" in result.output


def test_a_class_by_its_place() -> None:
    assert resolve("methods.nearest:Nearest").info.name == "nearest"


def test_a_file_of_a_package() -> None:
    assert resolve(str(PLUGIN / "method.py")).__module__ == "gaussian_smooth.method"
    assert resolve(f"{PLUGIN / 'method.py'}:GaussianSmooth").info.name == "gaussian-smooth"


def test_a_metric() -> None:
    result = invoke("--metric", str(PLUGIN / "metric.py"))
    assert result.exit_code == 0, result.output
    assert "0 failed" in result.output


def test_an_unknown_name_suggests_the_nearest() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'nearest'"):
        resolve("nearst")


@pytest.mark.parametrize(
    ("text", "name", "message"),
    [
        ("x = 1\n", "", "must define one subclass"),
        ("import no_such_thing\n", "", "ModuleNotFoundError"),
        ("from methods.identity import Identity\n", "", "must define one subclass"),
        ("def f(:\n", "", "SyntaxError"),
    ],
)
def test_files_that_hold_no_method(text: str, name: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / f"mine{abs(hash(text))}.py"
    path.write_text(text)
    with pytest.raises(RegistryError, match=message):
        resolve(f"{path}{name}")


def test_a_file_called_as_something_else() -> None:
    with pytest.raises(RegistryError, match="no such file"):
        resolve("nowhere/mine.py")


def test_a_file_that_a_module_of_python_hides(tmp_path: Path) -> None:
    path = tmp_path / "json.py"
    path.write_text("")
    with pytest.raises(RegistryError, match="rename the file"):
        resolve(str(path))


def test_an_attribute_that_is_no_method() -> None:
    with pytest.raises(RegistryError, match="is no subclass of"):
        resolve("methods.nearest:json")


BROKEN = """
from __future__ import annotations
from benchmark.api import Capabilities, Method, MethodInfo, Supervision, TransferResult

class Broken(Method):
    info = MethodInfo(name="broken", summary="draws in secret", capabilities=Capabilities(supervision=Supervision.NONE))

    def fit(self, train, task, *, rng, ctx):
        return self

    def transfer(self, source, task, *, rng):
        return TransferResult(source.replace(root=source.root + rng.standard_normal(3)))
"""


def test_a_broken_method_ends_with_one_and_says_what_to_do(tmp_path: Path) -> None:
    path = tmp_path / "mine_broken.py"
    path.write_text(BROKEN)
    result = invoke(str(path))
    assert result.exit_code == 1
    assert "FAILED" in result.output
    flat = " ".join(result.output.split())
    assert "another seed of transfer" in flat or "changes_proportions" in flat
