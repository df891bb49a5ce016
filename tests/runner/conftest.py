"""The fake data set, methods and metrics, and a way to run them."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest

FAKES = Path(__file__).with_name("fakes")


@pytest.fixture(autouse=True)
def fakes(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The module of fakes, importable here and in worker processes."""
    import importlib

    monkeypatch.syspath_prepend(str(FAKES))
    return importlib.import_module("fakebench")


@pytest.fixture
def registries(fakes):
    """Registries of fake methods and good fake metrics."""
    from benchmark.registry import Registry

    methods = Registry("method", "test.none", "fakebench:METHODS")
    metrics = Registry("metric", "test.none", "fakebench:GOOD_METRICS")
    return methods, metrics


@pytest.fixture
def make(registries, tmp_path):
    """``make(methods=[...], **settings)``: a run that is ready to start, on the fake data set."""
    from benchmark.config import load_config
    from benchmark.runner.run import prepare

    def make(*methods: str, metrics=None, gpu=lambda: False, opener="fakebench:open_fake", **settings):
        flags = {"methods": methods or ("copy",), "out": tmp_path / "run", "dataset": {"name": "fake"}, **settings}
        config = load_config(flags=flags)
        return prepare(config, methods=registries[0], metrics=metrics or registries[1], opener=opener, gpu=gpu)

    return make


@pytest.fixture
def go(registries):
    """``go(prepared)``: run it quietly."""
    from benchmark.runner.progress import Quiet
    from benchmark.runner.run import run

    def go(prepared, metrics=None, observer=None):
        return run(prepared, observer or Quiet(), methods=registries[0], metrics=metrics or registries[1])

    return go


@pytest.fixture
def results():
    """``results(folder)``: rows of ``results.parquet``; ``costs=False`` leaves out what time and memory measured."""
    import pyarrow.parquet as parquet

    def results(folder: Path, *, costs: bool = False) -> list[dict]:
        rows = parquet.ParquetFile(folder / "results.parquet").read().to_pylist()
        return rows if costs else [row for row in rows if not row["metric"].startswith("cost/")]

    return results
