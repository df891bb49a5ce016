"""Cells on the workers of a Dask cluster: the same numbers, and nothing lost with a worker or with the coordinator."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest

from benchmark.errors import ConfigError, StoreError
from benchmark.runner import cluster, remote
from benchmark.runner.backends import make_backend
from benchmark.runner.job import CellJob
from benchmark.runner.run import make_metric_jobs, split_path
from benchmark.runner.store import RunStore

DRIVER = Path(__file__).with_name("fakes") / "driver.py"


class Recorder:
    """Writes down what an observer is told."""

    def __init__(self) -> None:
        self.started: list[str] = []
        self.stages: set[str] = set()
        self.finished: list[str] = []

    def cell_started(self, cell):
        self.started.append(cell.key)

    def cell_progress(self, cell, stage, fraction, message):
        self.stages.add(stage)

    def cell_finished(self, cell, state, reason, seconds):
        self.finished.append(cell.key)


def same(first, second, results):
    """Whether two runs have the same rows, apart from what time and memory measured."""

    def rows(folder):
        return [{key: value for key, value in row.items() if key != "run"} for row in results(folder)]

    return rows(first) == rows(second)


@pytest.mark.parametrize("shared", [True, False], ids=["shared", "apart"])
def test_the_numbers_are_those_of_this_process(make, go, results, tmp_path, monkeypatch, shared, fakes):
    """Also with probes, with cells that fail or end their process, and where workers do not see the run folder."""
    from benchmark.registry import Registry

    metrics = Registry("metric", "test.none", "fakebench:PROBED_METRICS")
    probes = Registry("probe", "test.none", "fakebench:PROBES")

    def prepared(out, **settings):
        from benchmark.config import load_config
        from benchmark.runner.run import prepare

        flags = {"methods": ["copy", "noisy", "raises", "aborts"], "repetitions": 2, "dataset": {"name": "fake"}}
        config = load_config(flags={**flags, "out": out, **settings})
        methods = Registry("method", "test.none", "fakebench:METHODS")
        return prepare(config, methods=methods, metrics=metrics, probes=probes, opener="fakebench:open_fake")

    reference = go(prepared(tmp_path / "a" / "run"), metrics).folder
    if not shared:
        monkeypatch.setattr(cluster, "_marked", lambda run, token: contextlib.nullcontext())
    recorder = Recorder()
    out = go(prepared(tmp_path / "b" / "run", backend="dask", jobs=2), metrics, recorder)
    assert same(out.folder, reference, results)
    assert {"fit", "score"} <= recorder.stages
    keys = {cell.key for cell in out.cells}
    for told in (recorder.started, recorder.finished):
        assert keys <= set(told)
        assert len(told) == len(set(told))
    assert [path.name for path in out.folder.glob(".coordinator*")] == []
    found = {cell.method: out.states[cell.key].reason for cell in out.cells}
    assert found["aborts"] == "the process was ended by SIGABRT (stage: fit)"


@pytest.fixture
def workers(fakes):
    """A cluster of two workers that the test does not coordinate, and its address."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0", memory_limit=0, silence_logs=50
    ) as made:
        yield made


def pids(made) -> list[int]:
    return [nanny.pid for nanny in made.workers.values() if nanny.pid]


def test_a_lost_worker_costs_nothing(make, go, results, tmp_path, workers):
    reference = go(make("copy[pause=0.3]", "noisy", repetitions=3, out=tmp_path / "a" / "run")).folder
    killed = []
    enough = threading.Event()

    def kill() -> None:
        for _ in range(3):
            if enough.wait(0.7):
                return
            with contextlib.suppress(ProcessLookupError, IndexError):
                killed.append(pids(workers)[0])
                os.kill(killed[-1], signal.SIGKILL)

    thread = threading.Thread(target=kill)
    thread.start()
    try:
        settings = {"repetitions": 3, "backend": "dask", "scheduler": workers.scheduler_address}
        out = go(make("copy[pause=0.3]", "noisy", out=tmp_path / "b" / "run", **settings))
    finally:
        enough.set()
        thread.join()
    assert killed
    assert out.failures == []
    assert same(out.folder, reference, results)


def test_a_killed_coordinator_goes_on_where_it_was(results, tmp_path, workers, make, go):
    names = ["copy[pause=0.1]", "noisy[pause=0.1]", "paired[pause=0.1]"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(DRIVER.parent), *filter(None, sys.path)])}
    settings = {"methods": names, "repetitions": 3, "backend": "dask", "scheduler": workers.scheduler_address}
    command = [sys.executable, str(DRIVER), str(tmp_path / "b" / "run"), json.dumps(settings)]
    first = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
    cells = tmp_path / "b" / "run" / "cells"
    for _ in range(600):
        done = list(cells.glob("*/status.json"))
        if done:
            break
        time.sleep(0.05)
    first.kill()
    first.communicate()
    assert done, "no cell was finished before the coordinator was killed"
    stamps = {path: path.stat().st_mtime_ns for path in done}
    second = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=120)
    assert second.returncode == 0, second.stderr
    assert {path: path.stat().st_mtime_ns for path in done} == stamps, "a finished cell was made again"
    reference = go(make(*names, repetitions=3, out=tmp_path / "a" / "run", backend="serial")).folder
    assert same(tmp_path / "b" / "run", reference, results)


def errand(prepared, registries, run: Path, **changes) -> remote.Errand:
    """The errand of the first cell of a plan."""
    cell = prepared.cells[0]
    run.mkdir(parents=True, exist_ok=True)
    place = split_path(run, prepared.config.tasks, cell.task)
    prepared.splits[0].to_json(place)
    metrics = make_metric_jobs(prepared.metrics, registries[1])
    job = CellJob(cell, run, prepared.source, place, ("raw",), None, 0, 1, True, metrics)
    made = remote.Errand(
        job, run, "token", None, prepared.dataset.digest, remote.suite_digest(), remote.package_versions()
    )
    return replace(made, **changes)


def test_a_worker_without_the_run_folder_asks_for_luggage_and_sends_the_cell(make, registries, tmp_path):
    prepared = make("copy")
    asked = errand(prepared, registries, tmp_path / "there")
    news: list[str] = []
    scratch = tmp_path / "scratch"
    assert remote.do(asked, lambda *one: news.append(one[0]), scratch).state == "unseen"
    luggage = remote.Luggage(asked.job.split_file.read_bytes())
    answer = remote.do(replace(asked, luggage=luggage), lambda *one: news.append(one[0]), scratch)
    assert (answer.state, news[0]) == ("ok", "started")
    assert answer.parcel is not None
    assert not RunStore(tmp_path / "there").cells.exists()
    key = asked.job.cell.key
    assert not list(scratch.rglob(f"cells/{key}")), "the worker keeps what it has sent"

    home = RunStore(tmp_path / "home")
    with home.writing(key) as folder:
        cluster.unpack(answer.parcel, folder / "cells" / key)
        home.adopt(key, folder / "cells" / key)
    assert home.status(key, thorough=True).state == "ok"
    # It was scored where it was made; it can be scored again elsewhere from what is stored.
    parcel = cluster.pack(home.cell(key))
    only_score = replace(asked, job=replace(asked.job, execute=False), luggage=replace(luggage, cell=parcel))
    assert remote.do(only_score, lambda *_: None, scratch).state == "ok"


def test_a_damaged_cell_is_not_adopted(make, registries, tmp_path):
    asked = errand(make("copy"), registries, tmp_path / "there")
    answer = remote.do(
        replace(asked, luggage=remote.Luggage(asked.job.split_file.read_bytes())), lambda *_: None, tmp_path / "scratch"
    )
    assert answer.parcel is not None
    home, key = RunStore(tmp_path / "home"), asked.job.cell.key
    with home.writing(key) as folder:
        place = folder / "cells" / key
        cluster.unpack(answer.parcel, place)
        victim = next((place / "outputs").glob("*.raw.npz"))
        victim.write_bytes(victim.read_bytes()[:-1] + b"?")
        with pytest.raises(StoreError, match="came damaged"):
            home.adopt(key, place)
    assert home.status(key).state == "missing"


def test_a_cell_that_another_worker_finished_meanwhile_is_not_made_again(make, registries, tmp_path):
    run = tmp_path / "run"
    asked = errand(make("copy"), registries, run)
    remote.marker(run, "token").write_text("here")
    assert remote.do(asked, lambda *_: None).state == "ok"
    stamp = (run / "cells" / asked.job.cell.key / "status.json").stat().st_mtime_ns
    news: list[str] = []
    assert remote.do(asked, lambda *one: news.append(one[0])).state == "ok"
    assert news == []
    assert (run / "cells" / asked.job.cell.key / "status.json").stat().st_mtime_ns == stamp


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"suite": "other"}, "other code of the suite"),
        ({"versions": {"numpy": "1.0"}}, r"numpy \d.* and not 1\.0"),
        ({"dataset_digest": "0" * 64}, "data set fake of the worker is not the coordinator's"),
    ],
)
def test_a_worker_with_other_code_or_data_refuses(make, registries, tmp_path, changes, message):
    with pytest.raises(ConfigError, match=message):
        remote.require_same(errand(make("copy"), registries, tmp_path / "run", **changes))


def test_a_worker_with_another_version_of_the_method_refuses(make, registries, tmp_path, monkeypatch):
    asked = errand(make("copy"), registries, tmp_path / "run")
    changed = replace(asked.job.cell, ingredients={**asked.job.cell.ingredients, "method_source": "0" * 64})
    with pytest.raises(ConfigError, match="other code of method 'copy'"):
        remote.require_same(replace(asked, job=replace(asked.job, cell=changed)))


def test_without_dask_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ConfigError, match=r"needs the package distributed.*\[dask\]"):
        make_backend("dask", jobs=1, time_limit=None)


def test_a_scheduler_needs_the_backend_that_knows_it():
    with pytest.raises(ConfigError, match="add --backend dask"):
        make_backend("processes", jobs=1, time_limit=None, scheduler="tcp://127.0.0.1:1")


def test_a_scheduler_that_does_not_answer_is_named():
    with pytest.raises(ConfigError, match=r"no scheduler answers at 'tcp://127\.0\.0\.1:9'"):
        cluster.connect("tcp://127.0.0.1:9", timeout=0.5)


def test_other_backends_import_nothing_of_dask(tmp_path):
    script = (
        f"import runpy, sys\nsys.argv = ['driver', {str(tmp_path / 'run')!r}]\n"
        f"runpy.run_path({str(DRIVER)!r}, run_name='__main__')\n"
        "print(sorted(m for m in sys.modules if m.partition('.')[0] in ('dask', 'distributed', 'submitit')))"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(DRIVER.parent), *filter(None, sys.path)])}
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "[]"
