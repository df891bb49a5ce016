"""The side-by-side timings of ``tests/speed`` still run: small sizes, no figure asserted."""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner

FOLDER = Path(__file__).resolve().parents[1] / "speed"
NAMES = (
    "timing",
    "bench_bvh",
    "bench_fk",
    "bench_dtw",
    "bench_start",
    "bench_warp",
    "bench_identification",
    "bench_translation",
    "bench_cyclegan",
    "bench_kc",
    "bench_video",
    "bench_resample",
    "bench_distribution",
    "bench_bootstrap",
    "bench_autoencoder",
    "bench_stages",
    "run",
)
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


class Silent:
    def __init__(self) -> None:
        self.said: list[str] = []

    def print(self, *words: object, **_: object) -> None:
        self.said.append(" ".join(map(str, words)))


@pytest.fixture
def speed(monkeypatch):
    """The modules of the folder, loaded as the script loads them and forgotten afterwards."""
    for name in THREADS:
        monkeypatch.setenv(name, "1")
    monkeypatch.syspath_prepend(str(FOLDER))
    for name in NAMES:
        monkeypatch.delitem(sys.modules, name, raising=False)
    yield SimpleNamespace(**{name: importlib.import_module(name) for name in NAMES})
    for name in NAMES:
        sys.modules.pop(name, None)


def check_rows(rows: list[dict]) -> None:
    assert rows
    for row in rows:
        assert {"task", "what", "value", "unit", "ratio"} <= set(row)
        assert row["value"] is not None or row["note"]
    for task in {row["task"] for row in rows}:
        ours = [row for row in rows if row["task"] == task and row["what"] == "ours"]
        assert len(ours) == 1
        assert ours[0]["value"] > 0


def test_kinematics_bench_runs(speed):
    rows = speed.bench_fk.run(Silent(), frames=5, repeats=1)
    check_rows(rows)
    by_name = {row["what"]: row for row in rows if row["task"] == "FK"}
    # These two are installed wherever the suite is; so they must run, and give our positions.
    assert by_name["scipy Rotation"]["value"] > 0
    assert by_name["torch joint loop"]["value"] > 0


def test_a_peer_with_another_answer_is_struck_off(speed):
    case = speed.bench_fk.Case(3)
    with pytest.raises(ValueError, match="differ from ours"):
        case.check(case.positions + 1e-3)
    alignment = speed.bench_dtw.Case(20)
    with pytest.raises(ValueError, match="its cost is"):
        alignment.check(alignment.cost * 1.001)

    def wrong(case):
        case.check(case.positions + 1.0)

    def absent(case):
        raise ImportError("no such library")

    jobs, missing = speed.timing.collect({"wrong": wrong, "absent": absent}, case, console=Silent())
    assert jobs == {}
    assert missing["absent"] == "not installed"
    assert missing["wrong"].startswith("fails: ValueError")


def test_alignment_bench_runs(speed):
    check_rows(speed.bench_dtw.run(Silent(), sizes={12: 1, 20: 1}))


def test_file_bench_runs(speed):
    check_rows(speed.bench_bvh.run(Silent(), frames=12, repeats=1))


def test_start_bench_runs(speed):
    check_rows(speed.bench_start.run(Silent(), repeats=1))


def test_video_bench_runs(speed):
    pytest.importorskip("imageio_ffmpeg")
    rows = speed.bench_video.run(Silent(), frames=3, size=(160, 120), repeats=1)
    check_rows(rows)
    by_name = {row["what"]: row["value"] for row in rows}
    assert by_name["matplotlib 3-D sticks"] > 0
    assert by_name["pillow sticks"] > 0


def test_warp_bench_runs(speed):
    rows = speed.bench_warp.run(
        Silent(), dense={9: 1}, growth={6: 1, 12: 1}, full={12: 1, 20: 1}, banded={30: 1, 60: 1}, reach=5
    )
    # At these lengths growth is noise, which may be of either sign.
    growth = [row for row in rows if row["unit"] == "exponent"]
    assert [row["task"] for row in growth] == [
        "Space warp growth, 6 to 12 frames",
        "Time warp growth, frames times band",
    ]
    check_rows([row for row in rows if row not in growth])
    by_name = {row["what"]: row for row in rows if row["task"] == "Space warp, 9 frames, 1 channel"}
    assert by_name["dense LU"]["value"] > 0
    assert by_name["dense Cholesky"]["value"] > 0
    assert speed.bench_warp.exponent([1.0, 10.0, 100.0], [3.0, 300.0, 30000.0]) == pytest.approx(2.0)


def test_identification_bench_runs(speed):
    rows = speed.bench_identification.run(Silent(), cases={(2, 2): 1}, repeats=1, frames=400, fresh=50, truth=3)
    check_rows(rows)
    ours = {row["task"]: row for row in rows if row["what"] == "ours"}
    assert ours["Identification accuracy, order 2, 2 in, 2 out"]["value"] > 1.0
    assert ours["Simulation, 25 joints, order 3"]["unit"] == "times real time"
    case = speed.bench_identification.Case(2, 2, frames=400, fresh=50, truth=3)
    silent = speed.bench_identification.StateSpace.static(np.zeros((2, 2)))
    with pytest.raises(ValueError, match="its error on fresh data"):
        case.check(silent)


def test_translation_bench_runs(speed):
    rows = speed.bench_translation.run(Silent(), seconds=1.0, order=1, repeats=1)
    check_rows(rows)
    assert rows[0]["unit"] == "times real time"


def test_cyclegan_bench_runs(speed):
    size = {"joints": 3, "width": 2, "blocks": 1, "judge_width": 4, "batch": 3}
    rows = speed.bench_cyclegan.run(Silent(), **size, repeats=1, seconds=2.0)
    check_rows(rows)
    # The plain update is checked against ours before it is timed.
    by_name = {row["what"]: row for row in rows if row["task"] == "CycleGAN training, 3 joints"}
    assert by_name["plain, batch 1"]["value"] > 0
    assert by_name["plain at batch 3"]["value"] > 0
    case = speed.bench_cyclegan.Case(3, 2, 1, 4, 3)
    with pytest.raises(ValueError, match="its loss"):
        case.check(lambda: dict.fromkeys(("adversarial", "cycle", "coherence", "d_source", "d_target"), 0.5))


def test_kc_bench_runs(speed):
    rows = speed.bench_kc.run(Silent(), sizes={1.0: 1}, takes=1, params={"preset": "smoke"})
    check_rows(rows)
    assert [(row["what"], row["unit"]) for row in rows] == [
        ("ours", "times real time"),
        ("ours, without refinement", "times real time"),
    ]


def test_resampling_bench_runs(speed):
    rows = speed.bench_resample.run(Silent(), frames=40, repeats=1)
    check_rows(rows)
    by_name = {row["what"]: row for row in rows}
    assert by_name["scipy Slerp"]["value"] > 0
    case = speed.bench_resample.Case(20)
    with pytest.raises(ValueError, match="its root differs"):
        case.check(case.result.rotations, case.result.root + 1e-3)


def test_distribution_bench_runs(speed):
    rows = speed.bench_distribution.run(Silent(), count=40, dimensions=6, repeats=1)
    check_rows(rows)
    # Both peers give our distances, or they would not be timed.
    assert all(row["value"] > 0 for row in rows)


def test_bootstrap_bench_runs(speed):
    rows = speed.bench_bootstrap.run(Silent(), clips=100, actors=10, resamples=200, repeats=1)
    check_rows(rows)
    assert all(row["value"] > 0 for row in rows)


def test_autoencoder_bench_runs(speed):
    size = {"channels": 5, "filters": 4, "width": 3, "frames": 8, "batch": 2}
    rows = speed.bench_autoencoder.run(Silent(), **size, repeats=1)
    check_rows(rows)
    assert {row["what"]: row for row in rows}["torch modules"]["value"] > 0


def test_stages_bench_adds_up_what_workers_report(speed, monkeypatch):
    clock = iter([0.0, 1.0, 3.0, 7.0])
    monkeypatch.setattr(speed.bench_stages.time, "perf_counter", lambda: next(clock))
    stages, cell = speed.bench_stages.Stages(), SimpleNamespace(key="a")
    stages.cell_started(cell)
    stages.cell_progress(cell, "fit", 0.0, "")
    stages.cell_progress(cell, "score", 0.0, "")
    stages.cell_finished(cell, "ok", "", 7.0)
    assert dict(stages.seconds) == {"starting processes": 1.0, "fitting": 2.0, "scoring": 4.0}


def row(task: str, what: str, value: float | None, unit: str = "ms") -> dict:
    return {"task": task, "what": what, "value": value, "unit": unit, "ratio": None, "note": "not installed"}


@pytest.mark.parametrize(
    ("rows", "met"),
    [
        ([row("BVH read", "ours", 101.0, "MB/s")], True),
        ([row("BVH read", "ours", 99.0, "MB/s")], False),
        ([row("Start, list methods", "ours", 900.0)], False),
        ([row("FK", "ours", 1.0), row("FK", "pybvh, from Euler angles", 6.5), row("FK", "pymotion", 2.0)], True),
        ([row("FK", "ours", 1.0), row("FK", "pybvh, from Euler angles", 5.5)], False),
        ([row("FK", "ours", 1.0), row("FK", "pybvh, from Euler angles", None)], None),
        ([row("DTW, 300 frames", "ours", 2.0), row("DTW, 300 frames", "librosa", 3.0)], True),
        ([row("DTW, 300 frames", "ours", 2.0), row("DTW, 300 frames", "librosa", 1.9)], False),
        ([row("DTW, 9 frames", "ours", 2.0), row("DTW, 9 frames", "fastdtw, approximate", 1.0)], None),
        ([row("FK", "ours", None)], None),
    ],
)
def test_goals_are_judged_in_the_right_direction(speed, rows, met):
    (verdict,) = speed.run.judge(rows)
    assert verdict.met is met


def test_the_command_prints_a_table_and_keeps_the_figures(speed, monkeypatch, tmp_path):
    fake = ModuleType("bench_fake")
    fake.run = lambda console: [row("FK", "ours", 2.0), row("FK", "pybvh", 14.0), row("FK", "pymotion", None)]
    monkeypatch.setitem(sys.modules, "bench_fake", fake)
    monkeypatch.setattr(speed.run, "BENCHES", {"fake": "bench_fake"})
    kept = tmp_path / "speed.json"
    tables = [tmp_path / "speed.md", tmp_path / "speed.csv"]
    arguments = ["--only", "fake", "--json", str(kept), *(word for path in tables for word in ("--table", str(path)))]
    result = CliRunner().invoke(speed.run.main, arguments, catch_exceptions=False)
    assert "| FK | pybvh | " in tables[0].read_text()
    assert [line.split(",")[-1] for line in tables[1].read_text().splitlines()][1:] == ["", "7.00", ""]
    assert result.exit_code == 0
    assert "7.00x" in result.output
    assert "not installed" in result.output
    assert "-c constraints.txt -e '.[peers]'" in result.output
    assert "met  FK: at least 6 times as fast as pybvh; found 7.00 times pybvh" in result.output
    figures = json.loads(kept.read_text())
    assert figures["machine"]["numpy"]
    assert figures["rows"][0]["value"] == 2.0
    assert figures["goals"][0]["met"] is True


def test_an_unknown_bench_is_named(speed):
    result = CliRunner().invoke(speed.run.main, ["--only", "fk,nonesuch"])
    assert result.exit_code == 2
    assert f"nonesuch (known: {', '.join(speed.run.BENCHES)})" in result.output
