"""The architecture: who may import whom, and what must not be imported just to look around."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
PACKAGES = ("benchmark", "methods", "eval", "reports")
SOURCES = sorted(path for package in PACKAGES for path in (REPOSITORY / package).rglob("*.py"))


def imports(path: Path) -> list[ast.Import | ast.ImportFrom]:
    return [node for node in ast.walk(ast.parse(path.read_bytes())) if isinstance(node, ast.Import | ast.ImportFrom)]


def module_level(path: Path) -> set[str]:
    """Top-level packages imported whenever the module is, type checking apart."""
    found, waiting = set(), list(ast.parse(path.read_bytes()).body)
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found.add((node.module or "").split(".")[0])
        elif isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        elif isinstance(node, ast.If | ast.Try | ast.With):
            waiting += ast.iter_child_nodes(node)
    return found


def test_layers():
    run = subprocess.run(
        [
            sys.executable,
            "-c",
            "from importlinter.cli import lint_imports_command; lint_imports_command()",
            "--no-cache",
        ],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stdout + run.stderr
    assert "0 broken" in run.stdout


@pytest.mark.parametrize("package", PACKAGES)
def test_nobody_shadows_the_builtin_eval(package):
    for path in (REPOSITORY / package).rglob("*.py"):
        for node in imports(path):
            if isinstance(node, ast.Import):
                names = [alias.asname or alias.name.split(".")[0] for alias in node.names]
            else:
                names = [alias.asname or alias.name for alias in node.names]
            assert "eval" not in names, f"{path}: {ast.unparse(node)}"


def test_imports_are_absolute_and_annotations_are_lazy():
    for path in SOURCES:
        nodes = imports(path)
        assert not any(isinstance(node, ast.ImportFrom) and node.level for node in nodes), path
        future = any(isinstance(node, ast.ImportFrom) and node.module == "__future__" for node in nodes)
        assert future or not ast.parse(path.read_bytes()).body[1:], f"{path} lacks from __future__ import annotations"


def test_heavy_libraries_are_imported_inside_functions():
    heavy = {"pandas", "torch", "sklearn", "statsmodels", "matplotlib", "pyarrow", "joblib", "pooch", "scipy"}
    for path in SOURCES:
        if "_torch" in path.parts:  # the torch twin is only ever imported by code that needs torch
            continue
        # Networks are torch modules; that methods and metrics can be listed without them the conformance tests see to.
        network = path.parent.name in ("holden", "cyclegan", "cyclegan_kc") and path.stem != "method"
        network |= path.parent.name == "probes" and path.stem in ("autoencoder", "tcn")
        allowed = {"torch"} if network else set()
        found = (module_level(path) & heavy) - allowed
        assert not found, f"{path}: {found}"


def test_no_file_is_read_by_unpickling():
    for path in SOURCES:
        found = module_level(path) | {
            name.split(".")[0]
            for node in imports(path)
            if isinstance(node, ast.Import)
            for name in [a.name for a in node.names]
        }
        assert not found & {"pickle", "shelve", "dill"}, path
        text = path.read_text(encoding="utf-8")
        assert "allow_pickle=True" not in text, path
        assert "weights_only=False" not in text, path


@pytest.mark.parametrize(
    "arguments", [["--help"], ["run", "--help"], ["list", "methods"], ["list", "metrics"], ["list", "figures"]]
)
def test_looking_around_imports_nothing_heavy(arguments):
    script = (
        "import sys\n"
        "from benchmark.cli import call\n"
        "code = call(sys.argv[1:])\n"
        "heavy = {'torch', 'pandas', 'scipy', 'sklearn', 'matplotlib', 'statsmodels', 'pyarrow', 'joblib'} & set(sys.modules)\n"
        "print('heavy:', sorted(heavy), file=sys.stderr)\n"
        "sys.exit(code or len(heavy))\n"
    )
    run = subprocess.run(
        [sys.executable, "-c", script, *arguments], cwd=REPOSITORY, capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
    assert "heavy: []" in run.stderr
    assert run.stdout


def test_listing_methods_imports_none_of_them():
    script = (
        "import sys\nfrom benchmark.cli import call\ncall(['list', 'methods'])\n"
        "print([m for m in sys.modules if m.startswith('methods.')], file=sys.stderr)"
    )
    run = subprocess.run([sys.executable, "-c", script], cwd=REPOSITORY, capture_output=True, text=True, check=True)
    assert run.stderr.strip() == "[]"
    assert "identity" in run.stdout
