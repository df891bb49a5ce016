from __future__ import annotations

import io
import json
import os
import time

import numpy as np
import pytest
from rich.console import Console

from benchmark.commands.run import show
from benchmark.errors import ConfigError, StoreError
from benchmark.motion import bvh, npz
from benchmark.registry import Registry
from benchmark.runner.backends import make_backend
from benchmark.runner.run import cell_states, read_run, to_execute
from benchmark.runner.views import LEADERBOARD_COLUMNS, RESULT_COLUMNS, read_leaderboard


def states(outcome) -> dict[str, tuple[str, str]]:
    return {cell.method: (outcome.states[cell.key].state, outcome.states[cell.key].reason) for cell in outcome.cells}


def cell_folder(outcome, method):
    (cell,) = (cell for cell in outcome.cells if cell.method == method)
    return outcome.folder / "cells" / cell.key


def test_a_run_leaves_everything_it_promises(make, go, results):
    prepared = make("copy", "noisy")
    outcome = go(prepared)
    assert set(states(outcome).values()) == {("ok", "")}
    assert (outcome.executed, outcome.cached, outcome.failures) == (3, 0, [])
    for name in ("config.toml", "environment.json", "plan.json", "split.json", "results.parquet", "leaderboard.csv"):
        assert (outcome.folder / name).is_file(), name
    folder = cell_folder(outcome, "noisy")
    items = json.loads((folder / "items.json").read_text())
    assert [item["clip_id"] for item in items] == [item.clip_id for item in prepared.splits[0].test]
    for item in items:
        for variant in ("raw", "cleaned"):
            exact = npz.load(folder / "outputs" / f"{item['stem']}.{variant}.npz")
            again = bvh.load(folder / "outputs" / f"{item['stem']}.{variant}.bvh")
            order = [again.skeleton.names.index(name) for name in exact.skeleton.names]  # a BVH file is depth first
            np.testing.assert_allclose(again.positions[:, order], exact.positions, atol=1e-5)
    assert json.loads((folder / "model" / "size.json").read_text()) > 0
    log = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    assert {"prepare", "fit", "transfer", "save"} <= {line["stage"] for line in log}

    rows = results(outcome.folder, costs=True)
    assert list(rows[0]) == list(RESULT_COLUMNS)
    costs = {(row["method"], row["metric"]): row["value"] for row in rows if row["metric"].startswith("cost/")}
    assert costs["noisy", "cost/parameters"] == 1 + 12
    assert costs["noisy", "cost/model_bytes"] == (folder / "model" / "size.json").stat().st_size
    assert 20e6 < costs["noisy", "cost/peak_memory"] < 2e9
    assert 0 <= costs["noisy", "cost/fit_seconds"] < 60


def test_scores_are_of_the_stored_clips(make, go, results):
    outcome = go(make("noisy", variants=["raw"]))
    folder = cell_folder(outcome, "noisy")
    stems = {item["clip_id"]: item["stem"] for item in json.loads((folder / "items.json").read_text())}
    rows = [row for row in results(outcome.folder) if row["method"] == "noisy"]
    heights = {row["clip_id"]: row["value"] for row in rows if row["metric"] == "test/height"}
    assert heights.keys() == stems.keys()
    for clip_id, value in heights.items():
        clip = npz.load(folder / "outputs" / f"{stems[clip_id]}.raw.npz")
        assert value == clip.root[:, 1].mean()
    (spread,) = (row["value"] for row in rows if row["metric"] == "test/spread")
    assert spread == pytest.approx(np.std(list(heights.values())))
    truths = {row["clip_id"]: row["status"] for row in rows if row["metric"] == "test/truth"}
    assert all(status == ("ok" if "walk" in clip_id else "skipped") for clip_id, status in truths.items())


def test_the_real_row_is_not_compared_with_itself(make, go, results, fakes):
    outcome = go(make("copy", variants=["raw"]))
    items = json.loads((cell_folder(outcome, "child-reference") / "items.json").read_text())
    dataset = fakes.Fake()
    for item in items:
        assert item["copied_from"] in item["reference_ids"]
        others = [dataset.load(clip) for clip in item["reference_ids"] if clip != item["copied_from"]]
        own = dataset.load(item["copied_from"])
        (row,) = (
            row
            for row in results(outcome.folder)
            if (row["method"], row["metric"], row["clip_id"]) == ("child-reference", "test/gap", item["clip_id"])
        )
        expected = abs(own.root[:, 1].mean() - np.mean([clip.root[:, 1].mean() for clip in others]))
        assert row["value"] == pytest.approx(expected, abs=1e-12)


BAD = {
    "raises": "RuntimeError: the learning rate exploded",
    "raises-late": "ValueError: cannot walk",
    "nan": "ContractError: root holds nan",
    "sneaky-nan": "ContractError: root of the result's clip are not finite",
    "wrong-skeleton": "ContractError: the bone to",
    "wrong-length": "ContractError: the result has 5 frames and the source 12",
    "loops": "outran its time limit of 1.5 s (stage: fit)",
    "aborts": "the process was ended by SIGABRT (stage: fit)",
    "absent": "fakebench_absent",
}


def test_failures_are_isolated_and_kept(make, go, results):
    outcome = go(make(*[name for name in BAD if name != "absent"], "abs*", "copy", time_limit=1.5, jobs=2))
    found = states(outcome)
    for name, reason in BAD.items():
        assert found[name][0] == "failed", name
        assert reason in found[name][1], name
    assert found["copy"][0] == found["child-reference"][0] == "ok"
    assert {cell.method for cell, _ in outcome.failures} == set(BAD)
    trace = (cell_folder(outcome, "raises") / "traceback.txt").read_text()
    assert 'raise RuntimeError("the learning rate exploded")' in trace
    late = (cell_folder(outcome, "raises-late") / "traceback.txt").read_text()
    assert "while transferring clip adult/" in late
    assert "Abort" in (cell_folder(outcome, "aborts") / "traceback.txt").read_text()
    rows = results(outcome.folder, costs=True)
    for name in BAD:
        of_method = [row for row in rows if row["method"] == name]
        assert {row["status"] for row in of_method} == {"failed"}
        assert all(row["value"] is None and row["reason"] for row in of_method)
    assert {"test/height", "cost/fit_seconds"} <= {row["metric"] for row in rows if row["method"] == "loops"}


def test_a_time_limit_reaches_the_processes_a_method_started(make, go, tmp_path, monkeypatch):
    monkeypatch.setenv("FAKE_PID_FILE", str(tmp_path / "pid"))
    # The variable must be known where workers are forked from, so the server has to start with it.
    from multiprocessing import forkserver

    forkserver._forkserver._stop()  # type: ignore[attr-defined]
    outcome = go(make("forked", time_limit=1.5))
    assert "outran its time limit" in states(outcome)["forked"][1]
    pid = int((tmp_path / "pid").read_text())
    for _ in range(50):
        try:
            state = open(f"/proc/{pid}/stat").read().split(")")[1].split()[0]  # noqa: PTH123, SIM115
        except FileNotFoundError:
            return
        if state == "Z":  # ended; only its entry waits to be collected
            return
        time.sleep(0.1)
    pytest.fail("the method's own process was left behind")


def test_skips_decided_in_the_cell(make, go, results):
    outcome = go(make("needs-toes", "long-only"))
    found = states(outcome)
    assert found["needs-toes"] == ("skipped", "the target skeleton has no joint in the role left_toe")
    assert found["long-only"] == ("skipped", "the clip has 12 frames, fewer than the 100 the method needs")
    rows = [row for row in results(outcome.folder) if row["method"] == "long-only"]
    assert {(row["status"], row["value"]) for row in rows} == {("skipped", None)}


def test_methods_say_themselves_what_they_cannot_do(make, go, results):
    outcome = go(make("learnless", "choosy"))
    found = states(outcome)
    assert found["learnless"] == ("skipped", "the training clips hold no jump")
    assert found["choosy"][0] == "ok"
    rows = [row for row in results(outcome.folder) if row["method"] == "choosy" and row["metric"] == "test/height"]
    assert {(row["action"] == "walk", row["status"]) for row in rows} == {(True, "skipped"), (False, "ok")}
    assert {row["reason"] for row in rows if row["status"] == "skipped"} == {"walking was not learned"}


def test_a_second_run_does_nothing(make, go):
    first = go(make("copy", "noisy"))
    stamps = {
        path: path.stat().st_mtime_ns for path in first.folder.rglob("*") if path.is_file() and path.name != ".lock"
    }
    second = go(make("copy", "noisy"))
    assert (second.executed, second.scored, second.cached, second.rebuilt) == (0, 0, 3, False)
    assert stamps == {path: path.stat().st_mtime_ns for path in stamps}


@pytest.mark.parametrize(
    ("word", "expected"),
    [
        ("missing", {"copy": False, "raises": True, "noisy": True, "paired": True}),
        ("always", {"copy": True, "raises": True, "noisy": True, "paired": True}),
        ("never", {"copy": False, "raises": False, "noisy": True, "paired": True}),
        ("only-cached", {"copy": False, "raises": False, "noisy": False, "paired": False}),
    ],
)
def test_overwrite_words(make, go, word, expected):
    """copy: finished; raises: failed; noisy: not run yet; paired: damaged."""
    outcome = go(make("copy", "raises", "paired"))
    (cell_folder(outcome, "paired") / "items.json").write_text("[]")
    prepared = make("copy", "raises", "noisy", "paired", overwrite=word)
    found = cell_states(prepared)
    wanted = {cell.method: to_execute(prepared.config, cell, found[cell.key]) for cell in prepared.cells}
    del wanted["child-reference"]
    assert wanted == expected
    again = go(prepared)
    assert again.executed == sum(expected.values()) + (word == "always")
    if word == "only-cached":
        assert states(again)["noisy"] == ("skipped", "not in the cache: not run yet")
    else:
        assert states(again)["paired"][0] == "ok"


def test_forced_methods_run_again(make, go):
    first = go(make("copy", "noisy"))
    stamp = (cell_folder(first, "copy") / "status.json").stat().st_mtime_ns
    again = go(make("copy", "noisy", force=["copy"]))
    assert again.executed == 1
    assert (cell_folder(again, "copy") / "status.json").stat().st_mtime_ns != stamp


def test_a_corrupted_cell_is_made_again(make, go, results):
    first = go(make("noisy"))
    before = results(first.folder)
    path = next((cell_folder(first, "noisy") / "outputs").glob("*.raw.npz"))
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(bytes(data))
    again = go(make("noisy"))
    assert again.executed == 1
    assert results(again.folder) == before


def test_a_failed_cell_is_retried_with_its_checkpoints(make, go):
    assert states(go(make("checkpoints")))["checkpoints"][0] == "failed"
    assert states(go(make("checkpoints")))["checkpoints"] == ("ok", "")


@pytest.mark.parametrize("settings", [{"jobs": 2}, {"backend": "serial"}, {"methods_reversed": True}])
def test_numbers_do_not_depend_on_how_cells_are_run(make, go, results, tmp_path, settings):
    names = ["copy", "noisy", "paired"]
    reference = results(go(make(*names, repetitions=2, out=tmp_path / "a" / "run")).folder)
    if settings.pop("methods_reversed", False):
        names.reverse()
    other = results(go(make(*names, repetitions=2, out=tmp_path / "b" / "run", **settings)).folder)

    def order(row):
        return row["method"], row["repetition"], row["clip_id"], row["variant"], row["metric"]

    assert sorted(other, key=order) == sorted(reference, key=order)
    assert len({row["value"] for row in reference if (row["method"], row["metric"]) == ("noisy", "test/height")}) == 8


def test_a_time_limit_needs_processes():
    with pytest.raises(ConfigError, match="processes"):
        make_backend("serial", jobs=1, time_limit=1.0)


def test_methods_of_a_notebook_run_too(make, go, registries, fakes):
    class Mine(fakes.Copy):
        info = fakes._info("mine")

        def transfer(self, source, task, *, rng):
            return super().transfer(source, task, rng=rng)

        @classmethod
        def variants(cls):
            return {"": {}}

    registries[0].register(Mine)
    assert states(go(make("mine")))["mine"] == ("ok", "")


def test_a_folder_is_not_taken_over(make, go, tmp_path):
    go(make("copy"))
    with pytest.raises(StoreError, match="is a run with tasks adult:child, not child:adult"):
        go(make("copy", tasks=["child:adult"]))
    with pytest.raises(StoreError, match=r"data set fake, not fake \{.*revision"):
        go(make("copy", dataset={"name": "fake", "options": {"revision": 3}}))
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "letter.txt").write_text("dear")
    with pytest.raises(StoreError, match=r"letter\.txt.*no run folder"):
        go(make("copy", out=tmp_path / "home"))
    with pytest.raises(StoreError, match="is a file"):
        go(make("copy", out=tmp_path / "home" / "letter.txt"))


def test_a_run_whose_settings_were_spoiled_keeps_its_cells(make, go):
    folder = go(make("copy")).folder
    config = (folder / "config.toml").read_bytes()
    (folder / "config.toml").write_text("jobs = [")
    for attempt in (lambda: go(make("copy")), lambda: read_run(folder)):
        with pytest.raises(StoreError, match=r"config\.toml.*remove it and give the whole command"):
            attempt()
    (folder / "config.toml").unlink()
    outcome = go(make("copy"))
    assert (outcome.executed, outcome.scored, outcome.cached) == (0, 0, 2)
    assert (folder / "config.toml").read_bytes() == config


def test_a_folder_that_cannot_be_made_is_named(make, go, tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(StoreError, match=r"cannot write to the run folder .*file.run.*--out"):
        go(make("copy", out=tmp_path / "file" / "run"))


def test_a_run_in_use_is_refused(make, go):
    from benchmark.runner.store import RunStore

    prepared = make("copy")
    with RunStore(prepared.folder).lock(), pytest.raises(StoreError, match="in use by process"):
        go(prepared)


def test_several_tasks_have_several_splits(make, go, results):
    outcome = go(make("copy", tasks=["adult:child", "child:adult"]))
    assert {path.name for path in outcome.folder.glob("split*")} == {"split-adult-child.json", "split-child-adult.json"}
    assert {(row["source_style"], row["target_style"]) for row in results(outcome.folder)} == {
        ("adult", "child"),
        ("child", "adult"),
    }


def test_limit_and_views_follow_the_last_plan(make, go, results):
    full = results(go(make("copy", "noisy")).folder)
    limited = results(go(make("noisy", limit=2)).folder)
    assert {row["method"] for row in limited} == {"noisy", "child-reference"}
    assert len({row["clip_id"] for row in limited if row["metric"] == "test/height"}) == 2
    assert results(go(make("copy", "noisy")).folder) == full


def test_the_leaderboard_is_the_mean_of_the_results(make, go, results):
    outcome = go(make("noisy", "raises", repetitions=2))
    table = read_leaderboard(outcome.folder)
    assert tuple(table[0]) == LEADERBOARD_COLUMNS
    rows = results(outcome.folder)
    found = {(row["method"], row["variant"], row["metric"]): row for row in table}
    values = [r["value"] for r in rows if (r["method"], r["variant"], r["metric"]) == ("noisy", "raw", "test/height")]
    entry = found["noisy", "raw", "test/height"]
    assert entry["mean"] == pytest.approx(np.mean(values), rel=1e-12)
    assert entry["sd"] == pytest.approx(np.std(values, ddof=1), rel=1e-9)
    assert (entry["n"], entry["repetitions"]) == (len(values), 2)
    real = [
        r["value"]
        for r in rows
        if (r["method"], r["variant"], r["metric"]) == ("child-reference", "raw", "test/height")
    ]
    assert (entry["real_mean"], entry["real_n"]) == (pytest.approx(np.mean(real)), len(real))
    broken = found["raises", "raw", "test/height"]
    assert (broken["mean"], broken["n"], broken["failed"]) == (None, 0, 1)
    assert "exploded" in broken["reason"]


def test_a_run_can_be_read_back(make, go):
    outcome = go(make("copy", "noisy"))
    config, cells = read_run(outcome.folder)
    assert [cell.key for cell in cells] == [cell.key for cell in outcome.cells]
    assert config.tasks == ("adult:child",)
    with pytest.raises(StoreError, match="not a run folder"):
        read_run(outcome.folder / "cells")


def test_provenance_is_recorded_once(make, go):
    outcome = go(make("copy"))
    before = json.loads((outcome.folder / "environment.json").read_text())
    assert {"time", "command", "git", "versions", "hardware", "threads", "python", "platform"} <= set(before)
    assert before["versions"]["numpy"] == np.__version__
    assert before["threads"] == 1
    go(make("copy"))
    assert json.loads((outcome.folder / "environment.json").read_text()) == before


def test_workers_have_their_threads_capped(make, go, registries, tmp_path, monkeypatch):
    (tmp_path / "threads_under_test.py").write_text(
        "import os\nfrom fakebench import Copy, _info\nclass Threads(Copy):\n    info = _info('threads')\n"
        "    def fit(self, train, task, *, rng, ctx):\n"
        "        from threadpoolctl import threadpool_info\n"
        "        found = [pool['num_threads'] for pool in threadpool_info()]\n"
        "        assert found and set(found) == {1}, found\n"
        "        assert os.environ['OMP_NUM_THREADS'] == '1'\n"
        "        return self\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("OMP_NUM_THREADS", "8")
    registries[0].register("threads", "threads_under_test:Threads")
    assert states(go(make("threads")))["threads"] == ("ok", "")
    assert os.environ["OMP_NUM_THREADS"] == "8"


def test_metrics_fail_alone(make, go, results):
    metrics = Registry("metric", "test.none", "fakebench:METRICS")
    outcome = go(make("copy", metrics=metrics), metrics=metrics)
    assert states(outcome)["copy"] == ("ok", "")
    rows = [row for row in results(outcome.folder) if row["method"] == "copy"]
    by_metric = {name: [row for row in rows if row["metric"] == name] for name in metrics.names()}
    assert {row["status"] for row in by_metric["test/height"]} == {"ok"}
    assert {row["reason"] for row in by_metric["test/broken"]} == {"ZeroDivisionError: division by zero"}
    assert {row["reason"] for row in by_metric["test/infinite"]} == {"the value is inf"}
    assert {row["reason"] for row in by_metric["test/crash"]} == {"scoring: the process was ended by SIGABRT"}
    for name in ("test/broken", "test/infinite", "test/crash"):
        assert {(row["status"], row["value"]) for row in by_metric[name]} == {("failed", None)}
    told = io.StringIO()
    show(outcome, Console(file=told, width=200), None, 1.0, quiet=True)
    assert "metrics that failed on some clips: test/broken, test/crash, test/infinite" in told.getvalue()
    again = go(make("copy", metrics=metrics), metrics=metrics)
    assert (again.executed, again.scored) == (0, 2), "only the metric that crashed is tried again"


def test_the_number_of_processes_fits_cores_and_memory(monkeypatch):
    import os
    from types import SimpleNamespace

    import psutil

    from benchmark.runner import backends

    def jobs(cores: int, gigabytes: int, threads: int) -> int:
        monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(cores)), raising=False)
        free = SimpleNamespace(available=gigabytes << 30)
        monkeypatch.setattr(psutil, "virtual_memory", lambda: free)
        return backends.default_jobs(threads)

    assert jobs(8, 64, 1) == 8
    assert jobs(8, 64, 4) == 2
    assert jobs(8, 6, 1) == 3
    assert jobs(1, 1, 2) == 1
