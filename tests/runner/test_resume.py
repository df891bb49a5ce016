"""``kill -9`` at any moment, then the same command again: the same results, value for value."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

DRIVER = Path(__file__).with_name("fakes") / "driver.py"


def start(out: Path) -> subprocess.Popen:
    environment = {**os.environ, "PYTHONPATH": str(DRIVER.parent)}
    return subprocess.Popen([sys.executable, str(DRIVER), str(out)], stdout=subprocess.PIPE, text=True, env=environment)


def finish(process: subprocess.Popen) -> str:
    text, _ = process.communicate(timeout=120)
    assert process.returncode == 0
    return text


def workers_of(out: Path) -> list[int]:
    """Processes that have a file in the run folder open."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            links = [str(link.readlink()) for link in (folder / "fd").iterdir()]
        except OSError:
            continue
        if int(folder.name) != os.getpid() and any(link.startswith(str(out)) for link in links):
            found.append(int(folder.name))
    return found


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """A finished run and how long it took after planning."""
    out = tmp_path_factory.mktemp("undisturbed") / "run"
    process = start(out)
    assert process.stdout is not None
    assert process.stdout.readline() == "planned\n"
    began = time.monotonic()
    assert finish(process).strip() == "done 6"
    return out, time.monotonic() - began


def kill_and_resume(out: Path, moment: float) -> str:
    process = start(out)
    assert process.stdout is not None
    assert process.stdout.readline() == "planned\n"
    time.sleep(moment)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    for _ in range(100):
        if not workers_of(out):
            break
        time.sleep(0.02)
    assert workers_of(out) == [], "workers outlive the run"
    return finish(start(out))


def check(undisturbed, results, tmp_path, moments):
    reference, seconds = undisturbed
    expected = results(reference)
    assert len(expected) > 50
    for index, moment in enumerate(moments):
        out = tmp_path / str(index) / "run"
        kill_and_resume(out, moment * seconds)
        assert results(out) == expected, f"killed after {moment:.3f} of the run"
        assert {path.name for path in (out / "cells").iterdir()} == {
            path.name for path in (reference / "cells").iterdir()
        }


@pytest.mark.skipif(sys.platform != "linux", reason="looks for workers in /proc")
def test_kill_at_a_few_moments(undisturbed, results, tmp_path):
    check(undisturbed, results, tmp_path, [0.05, 0.4, 0.8])


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="looks for workers in /proc")
def test_kill_at_20_moments(undisturbed, results, tmp_path):
    check(undisturbed, results, tmp_path, np.random.default_rng(9).uniform(0.0, 1.0, size=20))


@pytest.mark.skipif(sys.platform != "linux", reason="looks for workers in /proc")
def test_killed_several_times_over(undisturbed, results, tmp_path):
    reference, seconds = undisturbed
    out = tmp_path / "run"
    for moment in (0.2, 0.3, 0.3):
        kill_at = start(out)
        assert kill_at.stdout is not None
        kill_at.stdout.readline()
        time.sleep(moment * seconds)
        kill_at.kill()
        kill_at.communicate()
    finish(start(out))
    assert results(out) == results(reference)
