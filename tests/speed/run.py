"""Time the suite beside other people's libraries: ``python tests/speed/run.py``.

Everything runs in one process on one thread; contestants take turns and the median counts.
"""

from __future__ import annotations

import csv
import importlib
import json
import os
import platform
import sys
import warnings
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import click

# Nothing above imports numpy, whose thread pool is sized once.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[_name] = "1"

#: Name on the command line to module; each module has ``run(console) -> list of rows``.
BENCHES = {
    "bvh": "bench_bvh",
    "fk": "bench_fk",
    "dtw": "bench_dtw",
    "start": "bench_start",
    "warp": "bench_warp",
    "identification": "bench_identification",
    "translation": "bench_translation",
    "cyclegan": "bench_cyclegan",
    "kc": "bench_kc",
    "video": "bench_video",
    "resample": "bench_resample",
    "distribution": "bench_distribution",
    "bootstrap": "bench_bootstrap",
    "autoencoder": "bench_autoencoder",
    "stages": "bench_stages",
}
INSTALL = "pip install -c constraints.txt -e '.[peers]'"


@dataclass(frozen=True)
class Goal:
    """What a task must reach: a figure of its own, or a multiple of the speed of the peers whose names start as given.

    Peers whose names say that they are approximate are no rivals.
    """

    task: str
    text: str
    at_least: float | None = None
    at_most: float | None = None
    faster_than: str | None = None
    times: float = 1.0


GOALS = (
    Goal("BVH read", "at least 100 MB/s", at_least=100.0),
    Goal("BVH write", "at least 25 MB/s", at_least=25.0),
    Goal("FK", "at least 6 times as fast as pybvh", faster_than="pybvh", times=6.0),
    Goal("DTW", "faster than every exact peer", faster_than=""),
    Goal("Start", "at most 700 ms", at_most=700.0),
    Goal("Space warp", "at least 500 times as fast as dense LU", faster_than="dense LU", times=500.0),
    Goal("Space warp growth", "exponent of the frames at most 1.1", at_most=1.1),
    Goal("Time warp", "faster than every peer", faster_than=""),
    Goal("Time warp growth", "exponent of the cells at most 1.1", at_most=1.1),
    Goal("Identification", "at least 10 times as fast as nfoursid", faster_than="nfoursid", times=10.0),
    Goal("Identification accuracy", "no more than 5 % behind any peer", faster_than="", times=0.95),
    Goal("CycleGAN training", "at least 10 times the plain one, batch 1", faster_than="plain, batch 1", times=10.0),
    Goal("CycleGAN transfer", "at least 100 times real time", at_least=100.0),
    Goal("cyclegan-kc transfer", "at least 100 times real time", at_least=100.0),
    Goal("Video", "at least 100 frames/s", at_least=100.0),
    Goal("Resampling", "faster than every peer", faster_than=""),
    Goal("Fréchet distance", "faster than every peer", faster_than=""),
    Goal("Kernel distance", "half as fast as scikit-learn, which gives no error", faster_than="", times=0.5),
    Goal("Bootstrap", "at least 10 times as fast as a loop", faster_than="plain loop", times=10.0),
    Goal("Autoencoder training", "as fast as torch's modules", faster_than="", times=0.95),
)


@dataclass(frozen=True)
class Verdict:
    """Whether a task met its goal; ``met`` is ``None`` where nothing was there to compare with."""

    task: str
    goal: str
    found: str
    met: bool | None


def speed(row: dict[str, Any]) -> float | None:
    """A figure that grows with speed, whatever the unit of the row."""
    value = row["value"]
    if value is None:
        return None
    return 1.0 / value if row["unit"] in ("ms", "s") else value


def ours_of(rows: list[dict[str, Any]], task: str) -> dict[str, Any] | None:
    """Our row of a task, if it was timed."""
    return next(
        (row for row in rows if row["task"] == task and row["what"] == "ours" and row["value"] is not None), None
    )


def judge(rows: list[dict[str, Any]], goals: tuple[Goal, ...] = GOALS) -> list[Verdict]:
    """Hold each task that has a goal against it. A goal is for its task and for the task's sizes (``DTW, 300 frames``)."""
    verdicts = []
    for goal in goals:
        for task in dict.fromkeys(row["task"] for row in rows):
            if task != goal.task and not task.startswith(f"{goal.task},"):
                continue
            ours = ours_of(rows, task)
            if ours is None:
                verdicts.append(Verdict(task, goal.text, "not timed", None))
                continue
            value = ours["value"]
            if goal.at_least is not None:
                verdicts.append(Verdict(task, goal.text, f"{value:.4g} {ours['unit']}", value >= goal.at_least))
            elif goal.at_most is not None:
                verdicts.append(Verdict(task, goal.text, f"{value:.4g} {ours['unit']}", value <= goal.at_most))
            else:
                verdicts.append(_compare(rows, task, ours, goal))
    return verdicts


def _compare(rows: list[dict[str, Any]], task: str, ours: dict[str, Any], goal: Goal) -> Verdict:
    prefix = goal.faster_than or ""
    rivals = {
        row["what"]: rate
        for row in rows
        if row["task"] == task
        and not row["what"].startswith(("ours", "floor"))
        and row["what"].startswith(prefix)
        and "approximate" not in row["what"]
        and (rate := speed(row)) is not None
    }
    if not rivals:
        return Verdict(task, goal.text, "no peer installed", None)
    name = max(rivals, key=lambda rival: rivals[rival])
    ratio = (speed(ours) or 0.0) / rivals[name]
    return Verdict(task, goal.text, f"{ratio:.2f} times {name}", ratio >= goal.times)


def machine() -> dict[str, Any]:
    """The facts that the figures depend on."""
    import numpy as np
    import scipy
    import threadpoolctl

    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        lines = info.read_text().splitlines()
        model = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), model)
    np.ones((2, 2)) @ np.ones((2, 2))
    pools = [pool for pool in threadpoolctl.threadpool_info() if pool["user_api"] == "blas"]
    return {
        "processor": model,
        "cores": os.cpu_count(),
        "threads used": 1,
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "BLAS": ", ".join(f"{p['internal_api']} {p['version']} {p.get('architecture', '')}".strip() for p in pools),
    }


def table(rows: list[dict[str, Any]], versions: dict[str, str]) -> Any:
    """One table over all tasks; the last column is how many times faster ours is."""
    from rich.table import Table

    result = Table(title="Speed, side by side on one thread (medians)")
    for heading, justify in (
        ("task", "left"),
        ("who", "left"),
        ("version", "left"),
        ("value", "right"),
        ("ours is", "right"),
    ):
        result.add_column(heading, justify=justify)
    task = None
    for row in rows:
        if task is not None and row["task"] != task:
            result.add_section()
        first, task = row["task"] != task, row["task"]
        ours, rate = ours_of(rows, task), speed(row)
        if rate is None:
            value, ratio = row.get("note", "not timed"), ""
        else:
            value = f"{row['value']:.4g} {row['unit']}"
            ratio = "" if ours is None or row is ours else f"{(speed(ours) or 0.0) / rate:.2f}x"
        style = "bold" if row["what"].startswith("ours") else None
        result.add_row(task if first else "", row["what"], versions.get(row["what"], ""), value, ratio, style=style)
    return result


def known_versions(rows: list[dict[str, Any]]) -> dict[str, str]:
    """Version of the library behind each row."""
    from timing import version

    try:
        own = metadata.version("motion-style-benchmark")
    except metadata.PackageNotFoundError:
        own = ""
    names = {row["what"] for row in rows}
    known = {name: own if name.startswith("ours") else version(name) for name in names}
    return {**known, "python itself": platform.python_version()}


def write_table(path: Path, rows: list[dict[str, Any]], versions: dict[str, str], facts: dict[str, Any]) -> None:
    """Keep the table in a file, as Markdown or CSV by its ending."""
    lines = []
    for row in rows:
        ours, rate = ours_of(rows, row["task"]), speed(row)
        value = row.get("note", "not timed") if rate is None else f"{row['value']:.4g}"
        ratio = "" if ours is None or row is ours or rate is None else f"{(speed(ours) or 0.0) / rate:.2f}"
        unit = "" if rate is None else row["unit"]
        lines.append([row["task"], row["what"], versions.get(row["what"], ""), value, unit, ratio])
    heads = ["task", "who", "version", "value", "unit", "ours is so many times faster"]
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".csv":
        with path.open("w", encoding="utf-8", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([heads, *lines])
        return
    about = "; ".join(f"{key} {value}" for key, value in facts.items())
    table = [heads, ["---"] * len(heads), *lines]
    text = "\n".join("| " + " | ".join(str(cell).replace("|", "\\|") for cell in line) + " |" for line in table)
    path.write_text(f"Medians, contestants taking turns on one thread. {about}.\n\n{text}\n", encoding="utf-8")


@click.command(help=__doc__)
@click.option("--only", default=",".join(BENCHES), show_default=True, help="Benches to run, separated by commas.")
@click.option(
    "--json", "target", type=click.Path(dir_okay=False, path_type=Path), help="Keep the figures in this file."
)
@click.option(
    "--table", "tables", multiple=True, type=click.Path(dir_okay=False, path_type=Path), help="Keep it as .md or .csv."
)
def main(only: str, target: Path | None, tables: tuple[Path, ...]) -> None:
    """Run the benches, print the table and say which goals are met."""
    from rich.console import Console
    from threadpoolctl import threadpool_limits

    console = Console()
    if not console.is_terminal:
        # A file or a pipe has no width of its own; the table needs this much.
        console = Console(width=120)
    chosen = [name.strip() for name in only.split(",") if name.strip()]
    unknown = [name for name in chosen if name not in BENCHES]
    if unknown or not chosen:
        raise click.BadParameter(
            f"{', '.join(unknown) or 'nothing'} (known: {', '.join(BENCHES)})", param_hint="--only"
        )
    facts = machine()
    console.print("; ".join(f"{key} {value}" for key, value in facts.items()), highlight=False)
    if os.environ.get("OPENBLAS_CORETYPE"):
        console.print("OPENBLAS_CORETYPE is set: matrix products run on that kernel, not on the processor's best.")
    rows: list[dict[str, Any]] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name in chosen:
            console.print(f"timing {name} …", highlight=False)
            module = importlib.import_module(BENCHES[name])
            with threadpool_limits(limits=1):
                rows += module.run(console)
    versions = known_versions(rows)
    console.print(table(rows, versions))
    if any(row.get("note") == "not installed" for row in rows):
        console.print(f"Peers that are not installed: {INSTALL}", markup=False, highlight=False)
    verdicts = judge(rows)
    for verdict in verdicts:
        mark = {True: "met", False: "MISSED", None: "open"}[verdict.met]
        console.print(
            f"{mark:>6}  {verdict.task}: {verdict.goal}; found {verdict.found}", markup=False, highlight=False
        )
    for path in tables:
        write_table(path, rows, versions, facts)
        console.print(f"table kept in {path}", markup=False, highlight=False)
    if target is not None:
        kept = {
            "machine": facts,
            "rows": [{**row, "version": versions.get(row["what"], "")} for row in rows],
            "goals": [asdict(verdict) for verdict in verdicts],
        }
        target.write_text(json.dumps(kept, indent=2) + "\n", encoding="utf-8")
        console.print(f"figures kept in {target}", markup=False, highlight=False)


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parent))
    main()
