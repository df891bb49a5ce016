"""A small finished run on synthetic data, made once by the command line."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def finished(tmp_path_factory) -> Path:
    """A run folder without a report: three methods, two test clips, and no metric that first trains classifiers."""
    folder = tmp_path_factory.mktemp("runs") / "small"
    groups = ("style", "distribution", "truth", "content", "timing", "physics", "jump")
    subprocess.run(
        [
            *(sys.executable, "-m", "benchmark", "run", "--methods", "identity,dynamic-scaling[time],child-reference"),
            *("--metrics", ",".join(f"{group}/*" for group in groups)),
            *("--limit", "2", "--no-report", "--quiet", "--out", str(folder)),
        ],
        check=True,
        capture_output=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    return folder
