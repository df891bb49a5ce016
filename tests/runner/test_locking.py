"""Two runs, or several shards of one, in the same folder."""

from __future__ import annotations

import errno
import json
import os
import socket
import subprocess
import sys
from contextlib import contextmanager

import pytest

from benchmark.errors import ConfigError, StoreError
from benchmark.runner import locking
from benchmark.runner.locking import LOCK, SHARDS, held

HOLD = (
    "import sys\nfrom pathlib import Path\nfrom benchmark.runner.locking import held\n"
    "shard = tuple(map(int, sys.argv[2:])) or None\n"
    "with held(Path(sys.argv[1]), shard):\n    print('held', flush=True)\n    sys.stdin.read()\n"
)


@contextmanager
def holder(folder, *shard):
    """Another process that holds the folder."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(folder), *map(str, shard)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "held\n"
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def test_the_refusal_says_who_where_since_when_and_by_which_command(tmp_path):
    with holder(tmp_path) as process, pytest.raises(StoreError) as refusal, held(tmp_path):
        pytest.fail("two holders")
    text = str(refusal.value)
    for part in (f"process {process.pid}", socket.gethostname(), "since 20", f"(-c {tmp_path})", "--out"):
        assert part in text


def test_shards_stand_side_by_side(tmp_path):
    with holder(tmp_path, 1, 3), held(tmp_path, (2, 3)), held(tmp_path, (3, 3)):
        assert len(list((tmp_path / SHARDS).glob("*-of-3"))) == 3


@pytest.mark.parametrize(
    ("first", "second", "why"),
    [
        ((1, 2), (1, 2), "in use by process"),
        ((1, 2), None, r"in use by shard 1-of-2 \(process"),
        ((), (1, 2), "in use by process"),
        ((1, 2), (2, 3), r"other parts \(1-of-2\)"),
    ],
)
def test_what_would_do_the_same_work_is_refused(tmp_path, first, second, why):
    with holder(tmp_path, *first) as process:
        with pytest.raises(StoreError, match=why) as refusal, held(tmp_path, second):
            pytest.fail("two holders")
        assert f"process {process.pid} " in str(refusal.value)
    with held(tmp_path, second):  # the holder is dead
        pass


@pytest.mark.parametrize("shard", [(0, 2), (3, 2), (1, 0)])
def test_a_shard_that_cannot_be_is_refused(tmp_path, shard):
    with pytest.raises(ConfigError, match="shard"), held(tmp_path, shard):
        pytest.fail("held")


@pytest.mark.parametrize("shard", [None, (1, 2)])
def test_without_locks_a_living_process_counts(tmp_path, monkeypatch, shard):
    """On a file system without locks, what the holder wrote decides."""
    import fcntl

    def no_locks(*_):
        raise OSError(errno.ENOLCK, "no locks available")

    with holder(tmp_path) as process:
        monkeypatch.setattr(fcntl, "flock", no_locks)
        with pytest.raises(StoreError, match=f"process {process.pid}"), held(tmp_path, shard):
            pytest.fail("two holders")
    signature = json.loads((tmp_path / LOCK).read_text())
    assert signature["pid"] == process.pid
    with held(tmp_path, shard):  # it is dead: taken over
        pass


def test_another_process_with_the_number_of_a_dead_one_is_not_taken_for_it():
    mine = locking._own_signature()
    assert locking.alive(mine)
    assert not locking.alive({**mine, "started": float(str(mine["started"])) - 1000})
    assert not locking.alive({})
    assert locking.alive({**mine, "host": "elsewhere", "pid": 1})


def test_a_signature_that_cannot_be_read_blocks_nobody(tmp_path):
    (tmp_path / LOCK).write_bytes(b"\xff{")
    with held(tmp_path):
        assert json.loads((tmp_path / LOCK).read_text())["pid"] == os.getpid()
    assert (tmp_path / LOCK).read_text() == ""


def test_a_shard_takes_its_own_lock_before_it_looks_for_other_divisions(tmp_path, monkeypatch):
    from benchmark.runner import locking

    look, held_then = locking._shards, []

    def looking(folder):
        held_then.append(locking.is_held(folder / locking.SHARDS / "1-of-3"))
        return look(folder)

    monkeypatch.setattr(locking, "_shards", looking)
    with locking.held(tmp_path, (1, 3)):
        pass
    assert held_then == [True]
