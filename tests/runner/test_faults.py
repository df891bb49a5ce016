"""A full disk, a folder that cannot be written to, a clock that jumps, a flipped byte: nothing wrong is kept, nothing
right is lost."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

FAKES = Path(__file__).with_name("fakes")
METHODS = ["copy", "noisy", "paired"]

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="limits and mounts as Linux has them")


def run(out: Path, *, file_size: int | None = None) -> tuple[int, str]:
    """A run of its own process: exit code, and the last line of what it says."""

    def limit() -> None:
        if file_size is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (file_size, file_size))

    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(FAKES), os.environ.get("PYTHONPATH", "")])}
    done = subprocess.run(
        [sys.executable, str(FAKES / "program.py"), str(out), json.dumps({"methods": METHODS})],
        capture_output=True,
        text=True,
        env=environment,
        preexec_fn=limit,
        timeout=200,
        check=False,
    )
    return done.returncode, (done.stdout if done.returncode == 0 else done.stderr).strip().splitlines()[-1]


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    out = tmp_path_factory.mktemp("reference") / "run"
    assert run(out)[0] == 0
    return out


@pytest.fixture
def small_disk(tmp_path):
    """``small_disk(options)``: a disk of its own, made or changed; skips where that is not allowed."""
    place = tmp_path / "disk"
    place.mkdir()

    def mount(options: str) -> Path:
        command = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(place)]
        if subprocess.run(command, capture_output=True, check=False).returncode:
            pytest.skip("mounting is not allowed here")
        return place

    yield mount
    subprocess.run(["umount", str(place)], capture_output=True, check=False)


@pytest.mark.parametrize("kilobytes", [40, 200, 400])
def test_a_full_disk(small_disk, reference, results, kilobytes):
    out = small_disk(f"size={kilobytes}k") / "run"
    code, said = run(out)
    if code:
        assert "StoreError: cannot write" in said
        assert "finished cells are kept" in said or "free some space" in said
    else:
        assert any("No space left" in reason for state, reason in json.loads(said).values() if state == "failed")
    small_disk("remount,size=64m")
    assert run(out)[0] == 0
    assert results(out) == results(reference)


@pytest.mark.parametrize("size", [100, 3000, 9000])
def test_files_that_may_not_grow(tmp_path, reference, results, size):
    code, said = run(tmp_path / "run", file_size=size)
    if code:
        assert "StoreError: cannot write" in said
    else:
        assert any("File too large" in reason for state, reason in json.loads(said).values() if state == "failed")
    assert run(tmp_path / "run")[0] == 0
    assert results(tmp_path / "run") == results(reference)


def test_a_folder_that_cannot_be_written_to(small_disk):
    out = small_disk("size=1m")
    (out / "run").mkdir()
    small_disk("remount,ro")
    code, said = run(out / "run")
    assert code
    assert "cannot write to the run folder" in said
    assert "Read-only file system" in said


@pytest.mark.parametrize("days", [-400, 400])
def test_a_clock_that_jumped(tmp_path, make, go, results, days):
    first = go(make(*METHODS))
    before = results(first.folder)
    for path in first.folder.rglob("*"):
        stat = path.stat()
        os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns + days * 86_400 * 10**9))
    again = go(make(*METHODS))
    assert (again.executed, again.scored) == (0, 0)
    assert results(again.folder) == before


#: Kinds of files of a run folder, by pattern.
KINDS = (
    *(
        "config.toml",
        "plan.json",
        "split.json",
        "environment.json",
        "results.parquet",
        "leaderboard.csv",
        ".views.json",
    ),
    *(
        "cells/*/status.json",
        "cells/*/items.json",
        "cells/*/metrics.parquet",
        "cells/*/metrics.json",
        "cells/*/cell.json",
    ),
    *("cells/*/log.jsonl", "cells/*/target-skeleton.npz", "cells/*/outputs/*.npz", "cells/*/outputs/*.bvh"),
    "cells/*/model/*.json",
)


@pytest.mark.parametrize("kind", KINDS)
def test_a_flipped_byte_is_found_and_mended(make, go, results, kind):
    from benchmark.errors import StoreError

    first = go(make(*METHODS))
    before = results(first.folder)
    path = sorted(first.folder.glob(kind))[0]
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 4
    path.write_bytes(bytes(data))
    try:
        go(make(*METHODS))
    except StoreError as error:
        assert kind == "config.toml", error  # the only file that somebody may have written by hand
        path.unlink()
        go(make(*METHODS))
    assert results(first.folder) == before


@pytest.mark.parametrize("place", range(0, 400, 25))
def test_any_flipped_byte_of_a_status_is_found(make, go, place):
    from benchmark.runner.store import RunStore

    folder = go(make("copy")).folder
    cell = sorted((folder / "cells").glob("[!.]*"))[0]
    data = bytearray((cell / "status.json").read_bytes())
    data[place % len(data)] ^= 1
    (cell / "status.json").write_bytes(bytes(data))
    assert RunStore(folder).status(cell.name).state == "damaged"
