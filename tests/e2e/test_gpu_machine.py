"""Training on a machine that has torch and little else: clips collected here, a method fitted there."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]

#: What such a machine lacks; a module that is ``None`` cannot be imported.
LACKING = (
    "click",
    "cloudpickle",
    "platformdirs",
    "psutil",
    "pydantic",
    "rich",
    "sklearn",
    "statsmodels",
    "threadpoolctl",
)


def call(*arguments: object, lacking: tuple[str, ...] = ()) -> subprocess.CompletedProcess:
    code = (
        f"import sys\nfor name in {lacking!r}: sys.modules[name] = None\n"
        "from experiments.gpu.train import main\nsys.exit(main(sys.argv[1:]))"
    )
    return subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )


def test_a_method_is_trained_without_the_smaller_dependencies_on_clips_collected_before(corpus, tmp_path):
    collected = call("collect", tmp_path / "carry", "-d", f"folder:{corpus}", "--limit", 2)
    assert collected.returncode == 0, collected.stderr
    told = json.loads((tmp_path / "carry" / "task.json").read_text())
    assert told["task"] == "adult:child"
    assert len(list((tmp_path / "carry" / "train").glob("*.npz"))) == told["train"] > 1
    assert len(list((tmp_path / "carry" / "test").glob("*.npz"))) == told["test"] == 2

    fitted = call(
        *("fit", tmp_path / "carry", "-o", tmp_path / "out", "--device", "cpu", "--set", "preset=smoke"),
        lacking=LACKING,
    )
    assert fitted.returncode == 0, fitted.stderr
    facts = json.loads((tmp_path / "out" / "facts.json").read_text())
    assert facts["epochs"] == 2
    assert facts["params"] == {"preset": "smoke"}
    curve = (tmp_path / "out" / "train.csv").read_text().splitlines()
    assert curve[0].startswith("step,epoch,seconds")
    assert len(curve) > 2

    from methods.cyclegan.method import CycleGan

    assert CycleGan.load(tmp_path / "out" / "model").params()["preset"] == "smoke"
    assert len(list((tmp_path / "out" / "outputs").glob("*.npz"))) == 2


def test_a_folder_that_was_not_collected_and_a_missing_gpu_are_named(tmp_path):
    told = call("fit", tmp_path, "-o", tmp_path / "out")
    assert told.returncode == 2
    assert "task.json" in told.stderr
    assert "collect" in told.stderr
