"""How long the command line takes to answer."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from timing import interleaved, rows

REPOSITORY = Path(__file__).resolve().parents[2]
REPEATS = 7


def run(console: Any, *, repeats: int = REPEATS) -> list[dict[str, Any]]:
    """Time a command in a fresh interpreter with its modules byte-compiled, beside an interpreter that does nothing."""
    commands = {
        "ours": [sys.executable, "-m", "benchmark", "list", "methods"],
        "python itself": [sys.executable, "-c", "pass"],
    }
    with tempfile.TemporaryDirectory() as cache:
        # Byte code goes to a folder of its own: an environment may forbid it beside the sources, which triples the time.
        environment = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
        environment["PYTHONPYCACHEPREFIX"] = cache

        def call(command: list[str]) -> None:
            done = subprocess.run(command, cwd=REPOSITORY, env=environment, capture_output=True, text=True, check=False)
            if done.returncode:
                raise RuntimeError(done.stderr.strip().rsplit("\n", 1)[-1])

        try:
            call(commands["ours"])
        except RuntimeError as error:
            console.print(f"`python -m benchmark list methods` fails: {error}")
            return rows("Start, list methods", {}, {"ours": f"fails: {error}"})
        jobs = {name: (lambda command=command: call(command)) for name, command in commands.items()}
        return rows("Start, list methods", interleaved(jobs, repeats=repeats), {})
