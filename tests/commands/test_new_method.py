from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from click.testing import CliRunner

from benchmark.commands import scaffold
from benchmark.commands.new_method import new_method
from benchmark.errors import ConfigError


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scaffold") / "two-word"
    result = CliRunner().invoke(new_method, ["two-word", "--into", str(folder)])
    assert result.exit_code == 0, result.output
    return folder


def test_it_writes_a_package_that_names_its_entry_point(package: Path) -> None:
    written = {str(path.relative_to(package)) for path in package.rglob("*") if path.is_file()}
    assert written == {
        "LICENSE",
        "README.md",
        "pyproject.toml",
        "src/two_word/__init__.py",
        "src/two_word/method.py",
        "tests/test_method.py",
    }
    project = tomllib.loads((package / "pyproject.toml").read_text())["project"]
    assert project["entry-points"]["motion_style_benchmark.methods"] == {"two-word": "two_word.method:TwoWord"}


def test_what_it_writes_passes_check_method(package: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "benchmark", "check-method", str(package / "src/two_word/method.py")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "16 passed, 0 failed, 1 not concerned" in done.stdout


def test_what_it_writes_passes_its_own_tests(package: Path) -> None:
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"]
    done = subprocess.run(command, cwd=package, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "19 passed" in done.stdout


def test_it_overwrites_nothing(package: Path) -> None:
    before = (package / "README.md").read_text()
    with pytest.raises(ConfigError, match="exists already"):
        scaffold.write("two-word", package)
    assert (package / "README.md").read_text() == before


def test_an_empty_folder_will_do(tmp_path: Path) -> None:
    assert len(scaffold.write("third-one", tmp_path)) == len(scaffold.FILES)


@pytest.mark.parametrize(
    "name", ["Two", "two_words", "2fast", "-x", "x-", "a--b", "", "x" * 61, "../evil", "a b", "ünder"]
)
def test_names_that_will_not_do(name: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="lower-case words"):
        scaffold.write(name, tmp_path / "package")
    assert not (tmp_path / "package").exists()


def test_a_better_name_is_suggested(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="try 'my-method-2'"):
        scaffold.write("My Method_2", tmp_path / "package")


@pytest.mark.parametrize("name", ["nearest", "json", "class", "methods"])
def test_names_that_are_taken(name: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="already"):
        scaffold.write(name, tmp_path / "package")
