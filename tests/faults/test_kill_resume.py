"""The harness that kills whole runs, training included, at a few moments; its long run is ``kill_resume.py --kills 100``."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

HARNESS = Path(__file__).with_name("kill_resume.py")


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="looks for processes in /proc")
def test_runs_of_all_methods_survive_kills(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, HARNESS, "--kills", "6", "--folder", tmp_path], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "6 kills in" in done.stdout and "equal, whole, no orphan" in done.stdout
