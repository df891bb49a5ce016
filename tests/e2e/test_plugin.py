"""A plug-in package, installed for real: the suite lists it with its origin and runs it like its own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

PLUGIN = Path(__file__).parents[1] / "fixtures" / "plugin"


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The environment of a shell in which the plug-in is installed, in a folder of its own."""
    import shutil

    folder = tmp_path_factory.mktemp("plugin")
    # A copy, since building leaves files beside the sources.
    shutil.copytree(PLUGIN, folder / "source")
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation"]
    command += ["--no-index", "--disable-pip-version-check", "--target", str(folder / "site"), str(folder / "source")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return {
        **os.environ,
        "PYTHONPATH": str(folder / "site"),
        "BENCHMARK_CACHE": str(folder / "cache"),
        "COLUMNS": "200",
    }


def benchmark(environment: dict[str, str], *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "benchmark", *arguments], env=environment, capture_output=True, text=True, check=False
    )


def test_it_is_listed_with_its_origin(environment: dict[str, str]) -> None:
    methods = benchmark(environment, "list", "methods", "-v")
    assert methods.returncode == 0, methods.stderr
    assert "gaussian-smooth" in methods.stdout
    assert "msb-plugin-gaussian-smooth 1.2.3" in methods.stdout
    metrics = benchmark(environment, "list", "metrics")
    assert "plugin/mean-head-height" in metrics.stdout


def test_without_it_installed_it_is_not_there() -> None:
    done = benchmark({**os.environ, "PYTHONPATH": ""}, "list", "methods")
    assert done.returncode == 0, done.stderr
    assert "gaussian-smooth" not in done.stdout


def test_it_keeps_the_contract(environment: dict[str, str]) -> None:
    method = benchmark(environment, "check-method", "gaussian-smooth")
    assert method.returncode == 0, method.stdout + method.stderr
    metric = benchmark(environment, "check-method", "--metric", "plugin/mean-head-height")
    assert metric.returncode == 0, metric.stdout + metric.stderr


def test_it_runs_from_end_to_end(environment: dict[str, str], tmp_path: Path) -> None:
    import pandas as pd

    from benchmark.motion import bvh

    run = tmp_path / "run"
    done = benchmark(
        environment,
        *("run", "--methods", "gaussian-smooth,identity", "--metrics", "plugin/*,content/pose-distance"),
        *("--data-option", "adults=5", "--data-option", "children=5", "--data-option", "takes=2"),
        *("--limit", "2", "--no-report", "--out", str(run)),
    )
    assert done.returncode == 0, done.stdout + done.stderr
    rows = pd.read_parquet(run / "results.parquet")
    ours = rows[(rows.method == "gaussian-smooth") & (rows.variant == "raw") & (rows.status == "ok")]
    heights = ours[ours.metric == "plugin/mean-head-height"].value
    assert len(heights) == 2
    assert heights.between(0.5, 3.0).all()
    # Smoothing moves joints, which the identity does not: the plug-in's own code has run.
    assert (ours[ours.metric == "content/pose-distance"].value > 0.01).all()
    files = sorted(run.glob("cells/*/outputs/*.bvh"))
    assert files
    assert len(bvh.load(files[0])) > 1
