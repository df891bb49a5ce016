from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys

import pytest

from benchmark.errors import StoreError
from benchmark.runner.store import RunStore, read_json, replacing, write_json, write_text


@pytest.fixture
def store(tmp_path):
    return RunStore(tmp_path / "run")


@pytest.fixture
def stored(store):
    """A store with one cell ``k`` of two files."""
    with store.writing("k") as folder:
        (folder / "sub").mkdir()
        (folder / "sub" / "a.bin").write_bytes(b"abc")
        (folder / "b.txt").write_text("text")
        store.commit("k", folder, "ok", facts={"costs": {"fit_seconds": 1.5}})
    return store


def test_a_committed_cell_is_whole(stored):
    status = stored.status("k", thorough=True)
    assert (status.state, status.reason) == ("ok", "")
    assert status.facts["costs"] == {"fit_seconds": 1.5}
    assert [path.name for path in stored.cells.iterdir()] == ["k"]


def test_absent_cells_are_missing(store):
    assert store.status("k").state == "missing"


def test_an_error_while_writing_leaves_nothing(store):
    with pytest.raises(RuntimeError), store.writing("k") as folder:
        (folder / "a").write_text("half")
        raise RuntimeError
    assert store.status("k").state == "missing"
    assert list(store.cells.iterdir()) == []


def damage_bytes(folder):
    (folder / "sub" / "a.bin").write_bytes(b"abd")


def damage_length(folder):
    path = folder / "sub" / "a.bin"
    stat = path.stat()
    path.write_bytes(b"ab")
    os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))


def damage_missing(folder):
    (folder / "b.txt").unlink()


def damage_extra(folder):
    (folder / "c.txt").write_text("x")


def damage_marker(folder):
    (folder / "status.json").write_text("{")


def damage_no_marker(folder):
    (folder / "status.json").unlink()


def damage_other_cell(folder):
    status = json.loads((folder / "status.json").read_text())
    (folder / "status.json").write_text(json.dumps({**status, "key": "other"}))


DAMAGES = [
    damage_bytes,
    damage_length,
    damage_missing,
    damage_extra,
    damage_marker,
    damage_no_marker,
    damage_other_cell,
]


@pytest.mark.parametrize("damage", DAMAGES)
def test_damage_is_found_and_named(stored, damage):
    damage(stored.cell("k"))
    status = stored.status("k")
    assert status.state == "damaged"
    assert status.reason


def test_silent_damage_is_found_by_a_thorough_look(stored):
    path = stored.cell("k") / "sub" / "a.bin"
    stat = path.stat()
    path.write_bytes(b"abd")
    os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    assert stored.status("k", thorough=True).state == "damaged"


def test_a_copied_folder_is_as_good_as_the_first(stored, tmp_path):
    shutil.copytree(stored.folder, tmp_path / "copy", copy_function=shutil.copyfile)
    assert RunStore(tmp_path / "copy").status("k").state == "ok"


def test_failures_keep_the_traceback_and_the_checkpoints(store):
    store.work("k").mkdir(parents=True)
    (store.work("k") / "epoch-1").write_text("weights")
    store.commit_failure("k", "RuntimeError: no", "Traceback …", "{}\n")
    status = store.status("k")
    assert (status.state, status.reason) == ("failed", "RuntimeError: no")
    assert (store.cell("k") / "traceback.txt").read_text() == "Traceback …"
    assert (store.work("k") / "epoch-1").exists()
    with store.writing("k") as folder:
        store.commit("k", folder, "ok")
    assert store.status("k").state == "ok"
    assert not store.work("k").exists()


def test_sweep_removes_what_is_half_written_and_nothing_else(stored):
    (stored.cells / ".tmp-k2-99").mkdir()
    (stored.cells / ".tmp-k2-99" / "x").write_text("")
    (stored.cells / ".old-k3-99").mkdir()
    (stored.cells / ".tmp-output-k4").write_text("")
    (stored.cells / ".work-k2").mkdir()
    (stored.cell("k") / ".metrics.parquet.99.part").write_text("")
    stored.sweep()
    assert sorted(path.name for path in stored.cells.iterdir()) == [".work-k2", "k"]
    assert stored.status("k").state == "ok"
    assert not list(stored.cell("k").glob(".*"))


def test_two_runs_in_one_folder_are_told_apart(store):
    with (
        store.lock(),
        pytest.raises(StoreError, match=rf"in use by process {os.getpid()} on .*--out"),
        RunStore(store.folder).lock(),
    ):
        pytest.fail("two holders")
    with store.lock():
        pass


def test_the_lock_of_a_dead_process_is_taken_over(store):
    script = (
        "import os, sys\nfrom pathlib import Path\nfrom benchmark.runner.store import RunStore\n"
        "with RunStore(Path(sys.argv[1])).lock():\n    print('held', flush=True)\n    sys.stdin.read()\n"
    )
    holder = subprocess.Popen(
        [sys.executable, "-c", script, str(store.folder)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert holder.stdout is not None
    assert holder.stdout.readline() == "held\n"
    with pytest.raises(StoreError, match=f"process {holder.pid}"), store.lock():
        pytest.fail("two holders")
    holder.kill()
    holder.communicate()
    assert str(holder.pid) in (store.folder / ".lock").read_text()
    with store.lock():
        assert str(os.getpid()) in (store.folder / ".lock").read_text()


def test_files_are_replaced_whole_or_not_at_all(tmp_path):
    path = tmp_path / "a.json"
    write_json(path, {"b": 1, "a": [1.5, "ü"]})
    assert read_json(path) == {"a": [1.5, "ü"], "b": 1}
    with pytest.raises(RuntimeError), replacing(path) as part:
        part.write_text("half")
        raise RuntimeError
    assert read_json(path)["b"] == 1
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]


def test_an_unchanged_file_is_left_alone(tmp_path):
    path = tmp_path / "a.txt"
    write_text(path, "same")
    os.utime(path, ns=(1, 1))
    write_text(path, "same")
    assert path.stat().st_mtime_ns == 1
    write_text(path, "other")
    assert path.stat().st_mtime_ns != 1


def test_damaged_json_is_named(tmp_path):
    with pytest.raises(StoreError, match=r"plan\.json is missing"):
        read_json(tmp_path / "plan.json")
    (tmp_path / "plan.json").write_text("{")
    with pytest.raises(StoreError, match=r"plan\.json is damaged"):
        read_json(tmp_path / "plan.json")
