"""Methods that misbehave: what they do stays in their cell, is named there, and the rest of the run is right."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from benchmark.errors import ConfigError
from benchmark.registry import Registry

FAKES = Path(__file__).with_name("fakes")
WELL_BEHAVED = ("copy", "noisy")

#: How each ends: state, and what the reason says.
ENDS = {
    "leaks": ("failed", "of memory, over its limit of 900 MiB (stage: fit)"),
    "leaks-in-child": ("failed", "of memory, over its limit of 900 MiB (stage: fit)"),
    "leaves": ("ok", ""),
    "abandons": ("failed", "the process ended with code 3 (stage: fit)"),
    "shouts": ("failed", "the process was ended by SIGABRT (stage: fit)"),
    "exits": ("failed", "SystemExit: enough"),
    "exits-in-transfer": ("failed", "SystemExit: 0"),
    "exits-hard": ("failed", "the process ended with code 0 (stage: fit)"),
    "interrupts": ("failed", "KeyboardInterrupt"),
    "raises-base": ("failed", "Own: nobody expects me"),
    "meddles": ("ok", ""),
    "handles": ("ok", ""),
    "wrong-rate": ("failed", "the result's clip has 60 frames per second and the source 30"),
    "huge": ("failed", "the result has 24000 frames, more than 50 times those of the source, 12"),
    "foreign-skeleton": ("failed", "the result's joints are not those of the source's skeleton"),
    "nan": ("failed", "root holds nan"),
    "nothing": ("failed", "transfer must return a TransferResult, not NoneType"),
    "closes": ("failed", "(stage: fit)"),
    "bad-text": ("failed", r"ValueError: \ud800 and a \x00"),
    "bad-save": ("failed", "the process was ended by SIGSEGV"),
}

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="looks for processes in /proc")


def start(out: Path, methods, mark: str, **flags) -> subprocess.Popen:
    """A run of the fakes as a program of its own."""
    arguments = [str(out), json.dumps({"methods": list(methods), **flags})]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(FAKES), os.environ.get("PYTHONPATH", "")])}
    environment["FAULTS_RUN"] = mark
    return subprocess.Popen(
        [sys.executable, str(FAKES / "program.py"), *arguments], stdout=subprocess.PIPE, text=True, env=environment
    )


def run(out: Path, methods, **flags) -> dict[str, list[str]]:
    """State and reason of every method of a finished run."""
    text, _ = start(out, methods, str(out), **flags).communicate(timeout=400)
    return json.loads(text.splitlines()[-1])


def living(mark: str) -> list[str]:
    """Command lines of processes that carry a mark."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if f"FAULTS_RUN={mark}".encode() in (folder / "environ").read_bytes().split(b"\0"):
                found.append((folder / "cmdline").read_bytes().replace(b"\0", b" ").decode())
        except OSError:
            continue
    return [line for line in found if line.strip()]


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    """The well-behaved methods among themselves."""
    out = tmp_path_factory.mktemp("reference") / "run"
    assert run(out, WELL_BEHAVED) == {name: ["ok", ""] for name in (*WELL_BEHAVED, "child-reference")}
    return out


@pytest.fixture(scope="module")
def hostile(tmp_path_factory):
    """A run of all of them, and how each ended."""
    out = tmp_path_factory.mktemp("hostile") / "run"
    ended = run(out, [*ENDS, *WELL_BEHAVED], jobs=2, memory_limit="900 MiB")
    for _ in range(100):
        if not living(str(out)):
            break
        time.sleep(0.1)
    return out, ended


@pytest.mark.parametrize("name", ENDS)
def test_each_is_contained_and_named(hostile, name):
    state, reason = hostile[1][name]
    assert state == ENDS[name][0], reason
    assert ENDS[name][1] in reason


def rows(results, folder, names):
    return [row for row in results(folder) if row["method"] in names]


def test_the_rest_of_the_run_is_right(hostile, reference, results):
    others = (*WELL_BEHAVED, "child-reference")
    assert {name: hostile[1][name] for name in others} == {name: ["ok", ""] for name in others}
    expected = rows(results, reference, others)
    assert len(expected) > 50
    assert rows(results, hostile[0], others) == expected


@pytest.mark.parametrize("name", ["meddles", "handles", "leaves"])
def test_what_a_method_changed_does_not_reach_its_scores(hostile, reference, results, name):
    def values(folder, method):
        return [
            (row["clip_id"], row["variant"], row["metric"], row["value"]) for row in rows(results, folder, (method,))
        ]

    assert values(hostile[0], name) == values(reference, "copy")


def test_nothing_is_left_behind(hostile):
    assert living(str(hostile[0])) == []
    assert [path.name for path in (hostile[0] / "cells").glob(".tmp*")] == []


def test_a_gigabyte_of_output_is_cut(hostile):
    folder = hostile[0]
    assert sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) < 20e6
    (trace,) = (
        path for path in folder.glob("cells/*/traceback.txt") if "the last words" in path.read_text(errors="replace")
    )
    assert "bytes left out" in trace.read_text() or trace.stat().st_size <= 20000


def test_a_method_that_ends_the_fork_server_ends_only_what_runs_beside_it(tmp_path, reference, results):
    ended = run(tmp_path / "run", ["kills-server", *WELL_BEHAVED], jobs=1)
    assert ended["kills-server"][0] == "failed"
    assert ended["copy"] == ended["noisy"] == ["ok", ""]
    assert rows(results, tmp_path / "run", WELL_BEHAVED) == rows(results, reference, WELL_BEHAVED)


def test_cells_that_a_method_spoils_are_made_again(tmp_path, reference, results):
    ended = run(tmp_path / "run", [*WELL_BEHAVED, "scribbles"], jobs=1)
    assert {name: state for name, (state, _) in ended.items()} == dict.fromkeys(
        (*WELL_BEHAVED, "scribbles", "child-reference"), "ok"
    )
    assert rows(results, tmp_path / "run", WELL_BEHAVED) == rows(results, reference, WELL_BEHAVED)


def test_a_time_limit_ends_a_method_that_is_stuck_in_c(tmp_path):
    ended = run(tmp_path / "run", ["stuck"], time_limit=4.0)
    assert ended["stuck"] == ["failed", "outran its time limit of 4 s (stage: fit)"]


def test_a_stuck_method_ends_with_a_run_that_is_killed(tmp_path):
    process = start(tmp_path / "run", ["stuck", "leaves"], str(tmp_path), jobs=2)
    assert process.stdout is not None
    assert process.stdout.readline() == "planned\n"
    for _ in range(200):
        if sum("sleep 30" in line for line in living(str(tmp_path))) == 2:
            break
        time.sleep(0.1)
    time.sleep(0.5)
    process.kill()
    process.communicate()
    for _ in range(200):
        if not (left := living(str(tmp_path))):
            break
        time.sleep(0.1)
    assert left == []


def test_a_class_that_cannot_be_sent_is_a_failed_cell(make, go, registries, fakes):
    import threading

    lock = threading.Lock()

    class Unsendable(fakes.Copy):
        info = fakes._info("unsendable")

        def fit(self, train, task, *, rng, ctx):
            with lock:
                return self

        @classmethod
        def variants(cls):
            return {"": {}}

    registries[0].register(Unsendable)
    outcome = go(make("unsendable", "copy"))
    found = {cell.method: outcome.states[cell.key] for cell in outcome.cells}
    assert found["copy"].state == "ok"
    assert found["unsendable"].state == "failed"
    assert "cannot be sent to a worker process (TypeError" in found["unsendable"].reason


def test_in_this_process_the_user_interrupts_and_a_method_only_fails(make, go, registries, monkeypatch, fakes):
    methods = Registry("method", "test.none", "hostile:METHODS")
    from benchmark.config import load_config
    from benchmark.runner.progress import Quiet
    from benchmark.runner.run import prepare
    from benchmark.runner.run import run as run_all

    before = os.environ.get("PATH"), os.environ.get("OMP_NUM_THREADS"), Path.cwd()
    prepared = make("copy")
    flags = {**prepared.config.model_dump(), "methods": ["exits", "meddles"], "backend": "serial"}
    prepared = prepare(load_config(flags=flags), methods=methods, metrics=registries[1], opener="fakebench:open_fake")
    outcome = run_all(prepared, Quiet(), methods=methods, metrics=registries[1])
    ended = {cell.method: outcome.states[cell.key].state for cell in outcome.cells}
    assert ended == {"exits": "failed", "meddles": "ok", "child-reference": "ok"}
    assert (os.environ.get("PATH"), os.environ.get("OMP_NUM_THREADS"), Path.cwd()) == before
    flags["methods"] = ["interrupts"]
    prepared = prepare(load_config(flags=flags), methods=methods, metrics=registries[1], opener="fakebench:open_fake")
    with pytest.raises(KeyboardInterrupt):
        run_all(prepared, Quiet(), methods=methods, metrics=registries[1])


@pytest.mark.parametrize(
    ("text", "size"), [("4GB", 4 << 30), ("500 MiB", 500 << 20), ("1.5g", 3 << 29), ("2048", 2048), (4096, 4096)]
)
def test_memory_limits_are_read(text, size):
    from benchmark.config import load_config

    assert load_config(flags={"memory_limit": text}).memory_limit == size


@pytest.mark.parametrize("text", ["", "much", "-1GB", "0", "4XB", "1e9", -5])
def test_other_memory_limits_are_refused(text):
    from benchmark.config import load_config

    with pytest.raises(ConfigError, match="memory_limit"):
        load_config(flags={"memory_limit": text})


def test_a_memory_limit_needs_processes(make, go):
    with pytest.raises(ConfigError, match="memory limit needs backend 'processes'"):
        go(make("copy", backend="serial", memory_limit="1GB"))
