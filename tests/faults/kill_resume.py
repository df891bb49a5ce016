"""``kill -9`` a run at random moments, resume it, and compare what comes out with a run that nobody disturbed.

    python tests/faults/kill_resume.py --kills 100

Every learned method trains (presets that finish in seconds), on a small part of the synthetic corpus. A run is killed
again and again until it gets to its end before the next kill; then the next begins in a new folder, until there were
enough kills. After each kill everything that the run left is looked at: a file under its final name must be whole,
and no process of the run may live.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import uuid
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

#: Environment variable by which every process of a run is known, however it was started.
MARKER = "FAULTS_RUN"

#: Every method, with settings that train in seconds.
METHODS = (
    "identity",
    "nearest",
    "dynamic-scaling[both]",
    "hsu[identification=subspace,order=1]",
    "holden[preset=smoke]",
    "cyclegan[preset=smoke]",
    "cyclegan-kc[preset=smoke]",
)
#: A corpus of four performers of each style, three actions and two takes.
CORPUS = ("adults=4", "children=4", "takes=2", 'actions=["walk","jump","kick"]')

#: Seconds within which every process of a killed run must have ended.
GRACE = 20.0


def command(folder: Path, *, jobs: int = 2) -> list[str]:
    """The command line of the run."""
    options = [part for option in CORPUS for part in ("--data-option", option)]
    return [
        *(sys.executable, "-m", "benchmark", "run", "--methods", ",".join(METHODS), *options),
        *("--limit", "2", "--jobs", str(jobs), "--no-report", "--quiet", "--out", str(folder)),
    ]


@dataclass
class Harness:
    """Starts, kills and looks after runs of one command.

    Attributes
    ----------
    make
        The command for a run folder.
    rng
        Draws moments and victims.
    environment
        Of the runs, besides the marker.
    problems
        What was found wrong, in words.
    kills
        Runs killed, and before which fraction of what an undisturbed run takes.
    """

    make: Any
    rng: np.random.Generator
    environment: dict[str, str] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    kills: list[float] = field(default_factory=list)
    workers_killed: int = 0
    looked_at: int = 0

    def start(self, folder: Path) -> tuple[subprocess.Popen, str]:
        """Start a run; the marker that its processes carry comes with it."""
        mark = uuid.uuid4().hex
        environment = {**os.environ, **self.environment, MARKER: mark}
        process = subprocess.Popen(
            self.make(folder), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, env=environment
        )
        return process, mark

    def undisturbed(self, folder: Path) -> float:
        """Run to the end; how long it took."""
        began = time.monotonic()
        process, mark = self.start(folder)
        _, errors = process.communicate()
        if process.returncode != 0:
            raise RuntimeError(f"the undisturbed run ended with {process.returncode}: {errors}")
        self.no_orphans(mark)
        return time.monotonic() - began

    def disturbed(self, folder: Path, delays: Sequence[float], *, worker: float = 0.0) -> int:
        """Start the run anew after each of the ``delays`` (seconds) until one start gets to its end; how many kills that took.

        Parameters
        ----------
        folder
            The run folder.
        delays
            After which time each start is killed; the start after the last one is left alone.
        worker
            How probable it is that a worker is killed shortly before the run is.
        """
        kills = 0
        for delay in delays:
            process, mark = self.start(folder)
            try:
                early = min(delay, float(self.rng.uniform(0.2, 2.0))) if self.rng.random() < worker else 0.0
                process.wait(timeout=max(0.0, delay - early))
            except subprocess.TimeoutExpired:
                if early:
                    self.kill_a_worker(process, mark)
                    with contextlib.suppress(subprocess.TimeoutExpired):
                        process.wait(timeout=early)
            if process.poll() is None:
                process.send_signal(signal.SIGKILL)
                process.communicate()
                kills += 1
                self.kills.append(delay)
                self.no_orphans(mark)
                self.look(folder)
                continue
            if self.ended(process, mark, folder):
                return kills
        process, mark = self.start(folder)
        if not self.ended(process, mark, folder):
            process, mark = self.start(folder)  # a cell whose worker was killed failed, and is tried again
            if not self.ended(process, mark, folder):
                self.problems.append(f"{folder}: does not get to its end when it is left alone")
        return kills

    def ended(self, process: subprocess.Popen, mark: str, folder: Path) -> bool:
        """Wait for a run; whether it ended well."""
        _, errors = process.communicate()
        self.no_orphans(mark)
        self.look(folder)
        if process.returncode not in (0, 3):
            self.problems.append(f"{folder}: ended with {process.returncode}: {errors.strip()[-500:]}")
        return process.returncode == 0

    def kill_a_worker(self, process: subprocess.Popen, mark: str) -> None:
        """Kill one process of the run that is not its first."""
        others = [pid for pid in marked(mark) if pid != process.pid]
        if others:
            with contextlib.suppress(ProcessLookupError):
                os.kill(int(self.rng.choice(others)), signal.SIGKILL)
                self.workers_killed += 1

    def no_orphans(self, mark: str) -> None:
        """Find processes that outlived their run."""
        deadline = time.monotonic() + GRACE
        while (left := marked(mark)) and time.monotonic() < deadline:
            time.sleep(0.05)
        for pid in left:
            with contextlib.suppress(OSError):
                line = Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
                self.problems.append(f"orphan {pid}: {line}")
                os.kill(pid, signal.SIGKILL)

    def look(self, folder: Path) -> None:
        """Read every file that has its final name."""
        self.problems += [f"{folder}: {problem}" for problem in partial_files(folder)]
        self.looked_at += 1

    def compare(self, reference: Path, folder: Path) -> None:
        """Rows but those of ``cost/`` must be equal, and nothing half done may be left."""
        expected, found = rows(reference), rows(folder)
        if found != expected:
            different = sum(a != b for a, b in zip(expected, found, strict=False))
            self.problems.append(
                f"{folder}: {different} rows differ, {len(found)} rows where there should be {len(expected)}"
            )
        left = [path.name for path in (*folder.glob(".*.part"), *(folder / "cells").glob(".*")) if path.name != ".lock"]
        if left:
            self.problems.append(f"{folder}: left behind: {', '.join(left)}")


def marked(mark: str) -> list[int]:
    """Living processes that carry the marker."""
    needle = f"{MARKER}={mark}".encode()
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        try:
            if needle in (path / "environ").read_bytes().split(b"\0"):
                state = (path / "stat").read_text().rpartition(")")[2].split()[0]
                if state != "Z":
                    found.append(int(path.name))
        except OSError:
            continue
    return found


def rows(folder: Path) -> list[dict[str, Any]]:
    """Rows of ``results.parquet`` without measurements of time and memory."""
    import pyarrow.parquet as parquet

    table = parquet.ParquetFile(folder / "results.parquet").read()
    return [row for row in table.to_pylist() if not row["metric"].startswith("cost/")]


def partial_files(folder: Path) -> list[str]:
    """Files with a final name that cannot be read whole, in a run folder or a cache."""
    from benchmark.runner.store import RunStore

    problems = []
    for cells in (folder / "cells", folder / "probes" / "cells"):
        store = RunStore(cells.parent)
        for cell in cells.glob("[!.]*") if cells.is_dir() else ():
            status = store.status(cell.name, thorough=True)
            if status.state == "damaged":
                problems.append(f"{cell}: {status.reason}")
    for path in folder.rglob("*"):
        if path.name.startswith(".") or not path.is_file() or any(part.startswith(".tmp-") for part in path.parts):
            continue
        try:
            _read(path)
        except FileNotFoundError:
            continue
        except Exception as error:  # whatever a reader says of a damaged file
            problems.append(f"{path}: {type(error).__name__}: {error}")
    return problems


def _read(path: Path) -> None:
    if path.suffix == ".json":
        json.loads(path.read_bytes())
    elif path.suffix == ".toml":
        import tomllib

        tomllib.loads(path.read_text(encoding="utf-8"))
    elif path.suffix == ".npz":
        with np.load(path, allow_pickle=False) as arrays:
            for name in arrays.files:
                arrays[name]
    elif path.suffix == ".parquet":
        import pyarrow.parquet as parquet

        parquet.ParquetFile(path).read()
    elif path.suffix == ".safetensors":
        from safetensors import safe_open

        with safe_open(path, framework="np") as file:
            for name in file.keys():  # noqa: SIM118 - not a dict
                file.get_tensor(name)
    elif path.suffix == ".bvh":
        from benchmark.motion import bvh

        bvh.load(path)


def main() -> int:
    """Do it, and print what was found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=100, help="how many in all")
    parser.add_argument("--seed", type=int, default=7, help="of the moments")
    parser.add_argument("--jobs", type=int, default=2, help="cells at a time")
    parser.add_argument(
        "--longest", type=float, default=0.0, help="seconds up to which a start may go on before it is killed"
    )
    parser.add_argument("--folder", type=Path, help="where to work; a temporary folder if left out")
    options = parser.parse_args()
    top = options.folder or Path(tempfile.mkdtemp(prefix="kill-resume-"))
    rng = np.random.default_rng(options.seed)
    harness = Harness(lambda folder: command(folder, jobs=options.jobs), rng, {"BENCHMARK_CACHE": str(top / "cache")})
    reference = top / "reference" / "run"
    seconds = harness.undisturbed(reference)
    longest = options.longest or 0.6 * seconds
    print(f"undisturbed: {seconds:.0f} s, {len(rows(reference))} rows", flush=True)
    runs = 0
    while len(harness.kills) < options.kills:
        runs += 1
        folder = top / str(runs) / "run"
        # A run and its cache begin anew in every other folder, so that kills meet the reading of clips too.
        harness.environment["BENCHMARK_CACHE"] = str(top / "cache") if runs % 2 else str(top / str(runs) / "cache")
        # Half of the moments early, where files change often.
        delays = [float(rng.uniform(0.0, longest if rng.random() < 0.5 else longest / 4)) for _ in range(20)]
        kills = harness.disturbed(folder, delays[: options.kills - len(harness.kills)], worker=0.2)
        harness.compare(reference, folder)
        harness.problems += [
            f"cache: {problem}" for problem in partial_files(Path(harness.environment["BENCHMARK_CACHE"]))
        ]
        print(
            f"run {runs}: {kills} kills, {len(harness.kills)} in all, {harness.workers_killed} workers besides; "
            f"{len(harness.problems)} problems",
            flush=True,
        )
        for problem in harness.problems:
            print(f"  {problem}", flush=True)
        if not harness.problems:
            shutil.rmtree(top / str(runs))
    moments = np.percentile(harness.kills, [0, 25, 50, 75, 100])
    print(
        f"{len(harness.kills)} kills in {runs} runs at {', '.join(f'{value:.1f}' for value in moments)} s (quartiles)"
    )
    print(f"{harness.looked_at} looks at the files left; {harness.workers_killed} workers killed besides")
    print("equal, whole, no orphan" if not harness.problems else f"{len(harness.problems)} problems")
    return bool(harness.problems)


if __name__ == "__main__":
    sys.exit(main())
