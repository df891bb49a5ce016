"""A run divided among processes: together the shards are the run, side by side in one folder or each in its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from benchmark.errors import ConfigError, StoreError
from benchmark.runner.merge import merge
from benchmark.runner.run import shard_cells
from benchmark.runner.store import RunStore

DRIVER = Path(__file__).with_name("fakes") / "driver.py"
NAMES = ("copy", "noisy", "raises", "paired")


def rows(folder, results):
    return [{key: value for key, value in row.items() if key != "run"} for row in results(folder)]


@pytest.mark.parametrize("parts", [1, 2, 3, 20])
def test_shards_divide_the_plan(make, parts):
    cells = make(*NAMES, repetitions=5).cells
    shards = [shard_cells(cells, f"{part + 1}/{parts}") for part in range(parts)]
    assert sorted(cell.key for shard in shards for cell in shard) == sorted(cell.key for cell in cells)
    assert max(map(len, shards)) - min(map(len, shards)) <= 1
    # Neither the order of the methods nor the other shards matter.
    again = make(*reversed(NAMES), repetitions=5).cells
    assert {cell.key for cell in shard_cells(again, f"1/{parts}")} == {cell.key for cell in shards[0]}


@pytest.mark.parametrize("shard", ["0/2", "3/2", "1", "a/b", "1/0", "-1/2"])
def test_what_is_no_shard_is_refused(make, shard):
    with pytest.raises(ConfigError, match="shard"):
        make("copy", shard=shard)


def test_shards_side_by_side_make_the_run(make, go, results, tmp_path):
    reference = go(make("copy[pause=0.1]", "noisy[pause=0.1]", repetitions=3, out=tmp_path / "a" / "run")).folder
    out = tmp_path / "b" / "run"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(DRIVER.parent), *filter(None, sys.path)])}
    settings = {"methods": ["copy[pause=0.1]", "noisy[pause=0.1]"], "repetitions": 3, "jobs": 1}
    shards = [
        subprocess.Popen(
            [sys.executable, str(DRIVER), str(out), json.dumps({**settings, "shard": f"{part}/2"})],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for part in (1, 2)
    ]
    for shard in shards:
        text, error = shard.communicate(timeout=120)
        assert shard.returncode == 0, error
        assert text.splitlines()[-1].startswith("done ")
    assert not (out / "results.parquet").exists()
    assert "shard =" not in (out / "config.toml").read_text()
    whole = go(make("copy[pause=0.1]", "noisy[pause=0.1]", repetitions=3, out=out))
    assert (whole.executed, whole.cached) == (0, len(whole.cells))
    assert rows(out, results) == rows(reference, results)


def test_parts_from_several_folders_are_merged(make, go, results, tmp_path):
    reference = go(make(*NAMES, repetitions=2, out=tmp_path / "whole" / "run")).folder
    folders = []
    for part in (1, 2):
        folders.append(tmp_path / str(part) / "run")
        go(make(*NAMES, repetitions=2, out=folders[-1], shard=f"{part}/2"))
    victim = next((folders[1] / "cells").glob("*/outputs/*.raw.npz"))
    victim.write_bytes(victim.read_bytes()[:-1] + b"?")  # neither size nor … time says so
    stamp = json.loads((victim.parents[1] / "status.json").read_bytes())["files"][f"outputs/{victim.name}"][1]
    os.utime(victim, ns=(stamp, stamp))
    merged = merge(folders[0], folders[1:])
    cells = make(*NAMES, repetitions=2).cells
    failed = sum(cell.method == "raises" for cell in cells)
    # The failed and the damaged cell are left, and made by the run that puts the parts together.
    assert merged.taken + merged.kept == len(cells) - failed - 1
    assert merged.left == failed + 1
    whole = go(make(*NAMES, repetitions=2, out=folders[0]))
    assert whole.executed == failed + 1
    assert rows(folders[0], results) == rows(reference, results)
    other = go(make("copy", tasks=["child:adult"], out=tmp_path / "other" / "run")).folder
    with pytest.raises(StoreError, match="do not go together"):
        merge(folders[0], [other])


def test_who_may_work_beside_whom(tmp_path):
    def store() -> RunStore:
        return RunStore(tmp_path / "run")

    with store().lock_shard("1/2"):
        with store().lock_shard("2/2"):
            pass
        with pytest.raises(StoreError, match=r"shard 1/2 of .* is in use by process"), store().lock_shard("1/2"):
            pass
        with pytest.raises(StoreError, match=r"other parts \(1-of-2\)"), store().lock_shard("1/3"):
            pass
        with pytest.raises(StoreError, match="in use by shard 1-of-2"), store().lock():
            pass
    with store().lock(), pytest.raises(StoreError, match="in use by process"), store().lock_shard("1/2"):
        pass
    with store().lock_shard("1/3"):
        pass


def test_a_held_cell_is_left_alone_and_waited_for(tmp_path):
    store, key = RunStore(tmp_path / "run"), "a" * 64
    with store.writing(key) as folder, store.holding(key):
        store.sweep()
        assert folder.is_dir()
        (store.cells / f".tmp-{'b' * 64}-1").mkdir()
        store.sweep()
        assert not list(store.cells.glob(".tmp-b*"))
    store.sweep()
    with store.holding(key):
        pass
