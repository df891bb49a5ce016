"""Whether the suite holds at a cluster's worth of cells: ``python tests/speed/scale.py grid|kill|plan|views``.

Each subcommand prints what it measured beside the goal, and exits with 1 where the goal is missed. ``grid`` and ``kill`` run
real worker processes on the synthetic data set; their times mean something on a machine that does nothing else. ``plan`` and
``views`` are held to their processor time, which is that of an idle machine.
"""

from __future__ import annotations

import os
import random
import resource
import signal
import sys
import tempfile
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import click

# Nothing above imports numpy, whose thread pool is sized once.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"

EFFICIENCY = 0.85
PLAN_SECONDS, PLAN_MEGABYTES = 5.0, 500.0
VIEW_SECONDS = 2.0


class Clock:
    """An observer that notes when the first cell began and when the last one ended."""

    def __init__(self) -> None:
        self.first, self.last, self.done = float("inf"), 0.0, 0

    def cell_started(self, cell: Any) -> None:
        self.first = min(self.first, time.monotonic())

    def cell_progress(self, cell: Any, stage: str, fraction: float, message: str) -> None:
        """Nothing."""

    def cell_finished(self, cell: Any, state: str, reason: str, seconds: float) -> None:
        self.last, self.done = time.monotonic(), self.done + 1


def grid(cells: int, out: Path, **settings: Any) -> Any:
    """A plan of ``cells`` small cells: one method without networks under many settings, on two test clips."""
    from benchmark.config import load_config
    from benchmark.runner.run import prepare

    pairs = [(shortlist, fps) for shortlist in range(1, 21) for fps in range(5, 25)][: cells - 1]
    methods = [f"nearest[shortlist={shortlist}, coarse_fps={fps}.0]" for shortlist, fps in pairs]
    flags = {"methods": methods, "metrics": ["content/*", "style/*", "physics/*"], "limit": 2, "variants": ["raw"]}
    return prepare(load_config(flags={**flags, "out": out, **settings}))


def execute(prepared: Any) -> tuple[float, float, list[dict]]:
    """Run a plan: seconds in all, seconds from the first cell to the last, and its rows without what was measured."""
    from benchmark.runner.parquet import read_rows
    from benchmark.runner.run import run

    clock, start = Clock(), time.monotonic()
    outcome = run(prepared, clock)
    whole = time.monotonic() - start
    if outcome.failures:
        raise click.ClickException(f"{len(outcome.failures)} cells failed: {outcome.failures[0]}")
    rows = [row for row in read_rows(outcome.folder / "results.parquet") if not row["metric"].startswith("cost/")]
    return whole, clock.last - clock.first, [{k: v for k, v in row.items() if k != "run"} for row in rows]


def verdict(text: str, met: bool) -> bool:
    """Print one line, and pass on whether it is good."""
    click.echo(f"{'met   ' if met else 'MISSED'}  {text}")
    return met


@click.group()
def main() -> None:
    """Measure what a cluster's worth of cells costs."""


@main.command("grid")
@click.option("--cells", default=200, show_default=True)
@click.option(
    "--workers",
    default="1,2,4",
    show_default=True,
    help="Numbers of workers, by commas; of one named again the best counts.",
)
@click.option("--backend", default="dask", show_default=True, type=click.Choice(["dask", "processes"]))
def grid_command(cells: int, workers: str, backend: str) -> None:
    """The same rows on any number of workers as in this process, and how well two cores are used."""
    good = True
    with tempfile.TemporaryDirectory() as folder:
        _, _, reference = execute(grid(cells, Path(folder) / "serial", backend="serial"))
        click.echo(f"serial: {len(reference)} rows of {cells} cells")
        taken: dict[int, float] = {}
        for turn, count in enumerate(map(int, workers.split(","))):
            out = Path(folder) / f"{turn}-{count}"
            whole, seconds, rows = execute(grid(cells, out, backend=backend, jobs=count))
            taken[count] = min(seconds, taken.get(count, seconds))
            text = f"{count} workers: {seconds:.1f} s from the first cell to the last, {whole:.1f} s in all"
            good &= verdict(f"{text}; rows equal to those of serial, value for value", rows == reference)
        if 1 in taken and 2 in taken:
            found = taken[1] / (2 * taken[2])
            good &= verdict(f"efficiency at 2 workers {found:.2f}; goal {EFFICIENCY}", found >= EFFICIENCY)
    sys.exit(not good)


@main.command("kill")
@click.option("--cells", default=200, show_default=True)
@click.option("--every", default=10.0, show_default=True, help="Seconds between two kills.")
def kill_command(cells: int, every: float) -> None:
    """A worker is killed every few seconds, and nothing is lost."""
    import distributed

    over = threading.Event()
    killed: list[int] = []
    with tempfile.TemporaryDirectory() as folder:
        _, _, reference = execute(grid(cells, Path(folder) / "serial", backend="serial"))
        local = {"n_workers": 2, "threads_per_worker": 1, "processes": True, "dashboard_address": ":0"}
        with distributed.LocalCluster(**local, memory_limit=0, silence_logs=50) as cluster:

            def kill() -> None:
                while not over.wait(every):
                    alive = [nanny.pid for nanny in cluster.workers.values() if nanny.pid]
                    with suppress(ProcessLookupError, IndexError):
                        killed.append(random.choice(alive))
                        os.kill(killed[-1], signal.SIGKILL)

            thread = threading.Thread(target=kill, daemon=True)
            thread.start()
            out = Path(folder) / "killed"
            whole, _, rows = execute(grid(cells, out, backend="dask", scheduler=cluster.scheduler_address))
            over.set()
            thread.join()
    good = verdict(f"{len(killed)} workers killed in {whole:.0f} s; rows equal to those of serial", rows == reference)
    sys.exit(not (good and killed))


@main.command("plan")
@click.option("--cells", default=100_000, show_default=True)
def plan_command(cells: int) -> None:
    """Make a plan of very many cells, write it and look which of them are there."""
    from benchmark.config import load_config
    from benchmark.runner.plan import plan_text, read_plan
    from benchmark.runner.run import cell_states, prepare
    from benchmark.runner.store import read_json, write_text

    names = ("holden", "cyclegan", "cyclegan-kc", "cyclegan-kc[unconstrained]", "cyclegan-kc[bone-only]")
    with tempfile.TemporaryDirectory() as folder:
        flags = {"methods": names, "repetitions": cells // len(names), "out": Path(folder) / "run"}
        start, cpu = time.perf_counter(), time.process_time()
        prepared = prepare(load_config(flags=flags))
        write_text(Path(folder) / "plan.json", plan_text(prepared.cells))
        states = cell_states(prepared)
        seconds, cpu = time.perf_counter() - start, time.process_time() - cpu
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        same = read_plan(read_json(Path(folder) / "plan.json")) == prepared.cells and len(states) == len(prepared.cells)
    good = verdict(f"{len(prepared.cells)} cells planned, written and looked for; read back the same", same)
    good &= verdict(
        f"{cpu:.2f} s of processor, {seconds:.2f} s by the clock; goal {PLAN_SECONDS} s", cpu < PLAN_SECONDS
    )
    good &= verdict(f"{memory:.0f} MB; goal {PLAN_MEGABYTES} MB", memory < PLAN_MEGABYTES)
    sys.exit(not good)


def write_large(path: Path, rows: int) -> None:
    """A ``results.parquet`` of so many rows as a run of 50 metrics on 100 clips has, 10 methods repeated."""
    import hashlib

    import numpy as np
    import pyarrow as pa
    import pyarrow.parquet as parquet

    from benchmark.runner.views import RESULT_COLUMNS

    number = np.arange(rows)
    metric, clip, cell = number % 50, number // 50 % 100, number // 5000

    def texts(index: Any, make: Any) -> Any:
        return pa.array([make(one) for one in range(int(index.max()) + 1)]).take(pa.array(index))

    def digest(value: object) -> str:
        return hashlib.sha256(str(value).encode()).hexdigest()

    nothing = np.zeros(rows, dtype=np.int64)
    columns = {name: texts(nothing, lambda _, name=name: digest(name)) for name in RESULT_COLUMNS}
    columns |= {
        "cell_key": texts(cell, digest),
        "method": texts(cell % 10, "method-{}".format),
        "dataset": texts(nothing, lambda _: "synthetic"),
        "source_style": texts(nothing, lambda _: "adult"),
        "target_style": texts(nothing, lambda _: "child"),
        "clip_id": texts(clip, lambda one: f"adult/a{one % 5}/walk_{one}"),
        "actor": texts(clip % 5, "a{}".format),
        "action": texts(clip % 3, ("walk", "run", "jump").__getitem__),
        "seen_actor": pa.array(nothing.astype(bool)),
        "repetition": pa.array(cell // 10),
        "seed": pa.array(cell),
        "variant": texts(clip % 2, ("raw", "cleaned").__getitem__),
        "metric": texts(metric, lambda one: "cost/fit_seconds" if one == 0 else f"content/metric-{one}"),
        "value": pa.array(np.random.default_rng(0).normal(size=rows)),
        "unit": texts(nothing, lambda _: "m"),
        "status": texts((metric == 7).astype(np.int64), ("ok", "skipped").__getitem__),
        "reason": texts((metric == 7).astype(np.int64), ("", "there is no other real clip").__getitem__),
    }
    parquet.write_table(pa.table({name: columns[name] for name in RESULT_COLUMNS}), path)


@main.command("views")
@click.option("--rows", default=1_000_000, show_default=True)
def views_command(rows: int) -> None:
    """Open a table of very many rows as reports do."""
    with tempfile.TemporaryDirectory() as folder:
        write_large(Path(folder) / "results.parquet", rows)
        (Path(folder) / "leaderboard.csv").write_text("dataset\n", encoding="utf-8")
        start, cpu = time.perf_counter(), time.process_time()
        from reports.run import RunView

        run = RunView(Path(folder))
        found = len(run.results)
        methods = len(run.methods(run.tasks[0]))
        empty, variants = len(run.empty_cells), run.variants(run.tasks[0])
        seconds, cpu = time.perf_counter() - start, time.process_time() - cpu
    good = verdict(f"{found} rows of {methods} methods, {empty} empty cells, {variants}", found == rows)
    text = f"opened in {cpu:.2f} s of processor, {seconds:.2f} s by the clock, imports included; goal {VIEW_SECONDS} s"
    sys.exit(not (verdict(text, cpu < VIEW_SECONDS) and good))


if __name__ == "__main__":
    main()
