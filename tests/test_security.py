"""Files cannot run code: no reader of them can, and a pickle in place of a model is refused unopened."""

from __future__ import annotations

import ast
import os
import pickle
from pathlib import Path

import pytest

from benchmark.errors import StoreError
from benchmark.registry import METHODS, load_target

REPOSITORY = Path(__file__).resolve().parents[1]
PACKAGES = ("benchmark", "methods", "eval", "reports")

#: Modules that make code of bytes.
MODULES = {"pickle", "_pickle", "marshal", "shelve", "dill", "joblib", "cloudpickle"}
#: Where classes of a notebook go through a pipe to workers of the same run; never from a file.
ALLOWED = {("benchmark/runner/job.py", "cloudpickle")}
CALLS = {"eval", "exec", "torch.load", "joblib.load", "yaml.load", "pd.read_pickle", "pandas.read_pickle", "os.system"}

SOURCES = sorted(path for package in PACKAGES for path in (REPOSITORY / package).rglob("*.py"))


def dotted(node: ast.expr) -> str:
    if isinstance(node, ast.Attribute):
        return f"{dotted(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.relative_to(REPOSITORY).as_posix())
def test_no_source_makes_code_of_a_file(path):
    name = path.relative_to(REPOSITORY).as_posix()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import | ast.ImportFrom):
            modules = [node.module or ""] if isinstance(node, ast.ImportFrom) else [alias.name for alias in node.names]
            for module in modules:
                assert module.split(".")[0] not in MODULES or (name, module) in ALLOWED, (
                    f"{name}:{node.lineno}: {module}"
                )
        if isinstance(node, ast.Call):
            called = dotted(node.func)
            assert called not in CALLS, f"{name}:{node.lineno}: {called}"
            words = {word.arg: word.value for word in node.keywords}
            if called in ("np.load", "numpy.load"):
                allowed = words.get("allow_pickle")
                assert isinstance(allowed, ast.Constant), f"{name}:{node.lineno}: np.load without allow_pickle=False"
                assert allowed.value is False
            shell = words.get("shell")
            assert not (isinstance(shell, ast.Constant) and shell.value), f"{name}:{node.lineno}: shell=True"


class Payload:
    """Makes a folder when it is unpickled."""

    def __init__(self, place: Path) -> None:
        self.place = place

    def __reduce__(self):
        return os.mkdir, (str(self.place),)


#: Every file that some method's ``load`` opens.
FILES = (
    *("params.json", "nearest.json", "clip-00000.npz", "hsu.json", "models.npz", "body.npz", "reference.npz"),
    *("holden.safetensors", "cyclegan.json", "generators.safetensors", "cyclegan-kc.safetensors"),
)


@pytest.mark.parametrize("name", METHODS.names())
def test_a_pickle_in_place_of_a_model_is_refused(name, tmp_path):
    from benchmark.runner.apply import load_model

    ran = tmp_path / "ran"
    for file in FILES:
        (tmp_path / file).write_bytes(pickle.dumps(Payload(ran)))
    with pytest.raises(StoreError) as refusal:
        load_model(load_target(METHODS.entry(name).target, name), tmp_path)
    assert str(tmp_path) in str(refusal.value)
    assert not ran.exists()


def test_a_saved_torch_file_is_refused(tmp_path):
    """What ``torch.save`` writes is a pickle in a zip."""
    import torch

    from methods._torch.weights import read_tensors

    torch.save({"w": torch.zeros(2)}, tmp_path / "model.safetensors")
    with pytest.raises(StoreError, match="no weights of this suite"):
        read_tensors(tmp_path / "model.safetensors")
