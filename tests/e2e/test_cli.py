from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time

import pytest

PATTERN = "pattern={style}/{actor}/{action}_{take}.bvh"


def folder_run(corpus, *more):
    return [
        "run",
        "--dataset",
        f"folder:{corpus}",
        "--data-option",
        PATTERN,
        "--task",
        "adult:child",
        "--split",
        "actors-kfold",
        "--out",
        "r",
        "--no-report",
        *more,
    ]


def test_help_teaches(cli):
    text = cli("--help").stdout
    assert "python -m benchmark run --methods all" in text
    for verb in ("run", "list", "score", "transfer", "compare"):
        assert f"  {verb} " in text
        assert "Usage" in cli(verb, "--help").stdout


def test_version(cli):
    assert cli("--version").stdout.startswith("motion-style-benchmark 0.")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "--methods", "identty"], "error: unknown method 'identty'; did you mean 'identity'"),
        (["run", "--dataset", "kinder-gatr"], "error: unknown data set 'kinder-gatr'; did you mean 'kinder-gator'"),
        (["run", "--set", "identity"], "error: --set 'identity'"),
        (["run", "--preset", "quik"], "error: unknown preset 'quik'; did you mean 'quick'"),
        (["run", "--config", "none.toml"], "error: no settings file none.toml"),
        (["run", "--jobs", "0"], "error: the command line: jobs"),
        (["score", "nowhere"], "error: nowhere is not a run folder"),
        (["compare", "a", "b"], "error: a is not a run folder"),
        (["rnu"], "Did you mean 'run'?"),
        (["run", "--methods", ""], "error: the command line: methods"),
    ],
    ids=lambda value: "-".join(value[:2]) if isinstance(value, list) else "",
)
def test_errors_are_one_line_and_name_the_fix(cli, arguments, message):
    run = cli(*arguments, code=2)
    assert message in run.stderr
    assert "Traceback" not in run.stderr
    assert run.stdout == ""


@pytest.mark.parametrize(
    "arguments", [["data", "synthesize", "file/corpus"], ["data", "index", "synthetic", "--csv", "file/index.csv"]]
)
def test_a_place_that_cannot_be_written_to_is_named(cli, tmp_path, arguments):
    (tmp_path / "file").write_text("x")
    told = cli(*arguments, code=2).stderr
    assert told.startswith("error: cannot use ") and "file" in told
    assert "a file is where a folder should be: choose another place" in told
    assert "Traceback" not in told


def test_faults_of_the_suite_are_shown_in_full(monkeypatch):
    from benchmark import cli

    def fault(**_):
        raise FileNotFoundError(2, "No such file or directory", "inner.bin")

    monkeypatch.setattr(cli.cli, "main", fault)
    with pytest.raises(FileNotFoundError, match=r"inner\.bin"):
        cli.call(["run"])


def test_the_whole_way_on_a_folder_of_files(cli, corpus, tmp_path):
    methods = ["--methods", "identity,nearest,dynamic-scaling"]
    plan = cli(*folder_run(corpus, *methods, "--dry-run")).stdout
    assert "4 cells, 4 to run" in plan
    assert not (tmp_path / "r").exists()

    first = cli(*folder_run(corpus, *methods)).stdout
    assert "4 cells: 4 run, 0 scored again, 0 from the cache, 0 skipped, 0 failed" in first
    assert "physics: folder:corpus" in first and "adult to child" in first
    assert "child-reference (ceiling)" in first
    import pandas as pd

    results = pd.read_parquet(tmp_path / "r" / "results.parquet")
    scored = results[(results.metric == "content/pose-distance") & (results.variant == "raw")]
    assert set(scored.method) == {"identity", "nearest", "dynamic-scaling", "child-reference"}
    assert (scored[scored.method == "identity"].value < 1e-6).all(), "the source has no distance to itself"
    assert (scored[scored.method == "child-reference"].value > 0.1).all()
    assert (results[results.status == "ok"].value.notna()).all()

    second = cli(*folder_run(corpus, *methods)).stdout
    assert "0 run, 0 scored again, 4 from the cache" in second
    assert "0 of 4 cells scored again" in cli("score", "r", "-q").stdout

    source = corpus / "adult" / "a" / "walk_1.bvh"
    told = cli("transfer", "--run", "r", "--method", "dynamic-scaling", source, "-o", "out/child.bvh").stdout
    assert "out/child.bvh" in told
    from benchmark.motion import bvh

    made, given = bvh.load(tmp_path / "out" / "child.bvh"), bvh.load(source)
    assert made.skeleton.leg_length < 0.7 * given.skeleton.leg_length
    assert len(made) < len(given), "a child is faster"

    unknown = cli("transfer", "--run", "r", "--method", "nearst", source, "-o", "x.bvh", code=2)
    assert "did you mean 'nearest'" in unknown.stderr
    ceiling = cli("transfer", "--run", "r", "--method", "child-reference", source, "-o", "x.bvh", code=2)
    assert "choose another method" in ceiling.stderr
    text = source.read_text().replace("LeftUpLeg", "Thing")
    (tmp_path / "odd.bvh").write_text(text)
    odd = cli("transfer", "--run", "r", "--method", "identity", "odd.bvh", "-o", "x.bvh", code=2)
    assert "left_hip" in odd.stderr
    assert "--role-map" in odd.stderr
    assert not (tmp_path / "x.bvh").exists()

    cli(
        *[
            argument if argument != "r" else "r2"
            for argument in folder_run(corpus, "--methods", "identity", "--seed", "5")
        ]
    )
    compared = cli("compare", "r", "r2").stdout
    assert "seed: 0 | 5" in compared
    assert "content/pose-distance" in compared


def test_list_shows_a_notebook_sized_amount(cli):
    methods = cli("list", "methods", "-v").stdout
    for name in ("identity", "nearest", "dynamic-scaling", "child-reference"):
        assert name in methods
    assert "parameters:" in methods
    assert "synthetic" in cli("list", "datasets").stdout
    assert "physics/foot-skate-ratio" in cli("list", "metrics").stdout


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_ctrl_c_leaves_a_run_that_resumes(cli, corpus, tmp_path):
    arguments = folder_run(corpus, "--methods", "identity,nearest,dynamic-scaling")
    process = subprocess.Popen(
        [sys.executable, "-m", "benchmark", *arguments],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    while not list((tmp_path / "r").glob("cells/*")) and process.poll() is None:
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    _, told = process.communicate(timeout=60)
    assert process.returncode == 130, told
    assert "Go on with:" in told
    assert "python -m benchmark run" in told
    assert "Traceback" not in told
    assert "0 failed" in cli(*arguments).stdout
    statuses = [json.loads(path.read_text())["state"] for path in (tmp_path / "r").glob("cells/*/status.json")]
    assert statuses == ["ok"] * 4
