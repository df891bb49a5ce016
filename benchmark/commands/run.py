"""``run``: the main job."""

from __future__ import annotations

import os
import shlex
import signal
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from rich.console import Console

    from benchmark.runner.costs import Estimate, Work
    from benchmark.runner.run import Outcome, Prepared
    from benchmark.runner.store import CellStatus

EPILOG = """\b
Examples:
  python -m benchmark run --methods all
  python -m benchmark run --methods 'dynamic-*,nearest' --dataset kinder-gator --task adult:child
  python -m benchmark run --methods 'nearest[shortlist=8]' --repetitions 5 --jobs 4 --time-limit 3600
  python -m benchmark run --config mine.toml --set nearest.coarse_fps=15 --dry-run
  python -m benchmark run --methods all --backend dask --scheduler tcp://node1:8786
  python -m benchmark run --methods all --shard 3/16
  python -m benchmark run -d kinder-gator --split named --split-option 'train=["734", "723"]' --split-option 'test=["934"]'

\b
A run that was interrupted goes on when the same command is given again. Exit codes: 0 done, 2 an error in what was
asked for, 3 done but some cells failed, 130 interrupted.
"""


@click.command("run", epilog=EPILOG)
@click.option(
    "--methods", "-m", multiple=True, help="Names, patterns, name[variant], name[param=value] or 'all'; by commas."
)
@click.option("--metrics", multiple=True, help="Names, patterns or 'all'; separated by commas.")
@click.option("--dataset", "-d", help="synthetic, kinder-gator, bandai-namco, adult2child or folder:PATH.")
@click.option(
    "--root", type=click.Path(path_type=Path), help="Folder of the data set; else BENCHMARK_DATA, else fetched."
)
@click.option("--data-option", multiple=True, metavar="NAME=VALUE", help="An option of the data set; may be repeated.")
@click.option(
    "--task", "-t", multiple=True, metavar="SOURCE:TARGET", help="From which style to which; may be repeated."
)
@click.option("--split", "protocol", help="Split protocol: auto, paper, actors-kfold, take-block, action or named.")
@click.option(
    "--split-option",
    multiple=True,
    metavar="NAME=VALUE",
    help='A parameter of the protocol, as folds=4 or train=["734", "723"]; may be repeated.',
)
@click.option("--fold", type=int, help="Fold of the split.")
@click.option("--split-seed", type=int, help="Seed of the split.")
@click.option("--split-file", type=click.Path(path_type=Path), help="A stored split to use instead.")
@click.option("--repetitions", "-r", type=int, help="How often each method that draws random numbers is run.")
@click.option("--seed", type=int, help="Seed of the run.")
@click.option("--limit", type=int, help="Transfer only so many test clips, for a quick look.")
@click.option("--variants", help="raw, cleaned or raw,cleaned: without and with the common foot lock.")
@click.option("--out", "-o", type=click.Path(path_type=Path), help="Run folder [default: runs/DATASET-TASK].")
@click.option(
    "--jobs",
    "-j",
    type=int,
    help="Cells at a time, in processes of their own [default: as many as cores and memory allow].",
)
@click.option("--threads", type=int, help="Threads of the numerical libraries in each process [default: 1].")
@click.option("--device", type=click.Choice(["auto", "cpu", "cuda"]), help="Where methods that can use a GPU run.")
@click.option(
    "--backend",
    type=click.Choice(["processes", "serial", "dask"]),
    help="dask: on the workers of a cluster; serial: in this process, for a debugger.",
)
@click.option(
    "--shard", metavar="K/N", help="Only one of N parts of the cells, for N processes or machines on one run folder."
)
@click.option("--scheduler", metavar="ADDRESS", help="Running Dask scheduler [default: a cluster on this machine].")
@click.option(
    "--overwrite",
    type=click.Choice(["missing", "always", "never", "only-cached"]),
    help="missing: run what is missing, damaged or failed; always: all; never: keep failures too; only-cached: run nothing.",
)
@click.option("--force", multiple=True, help="Run this method again whatever there is; may be repeated.")
@click.option("--time-limit", type=float, metavar="SECONDS", help="End a cell that takes longer.")
@click.option("--memory-limit", metavar="SIZE", help="End a cell that takes more memory, as 4GB.")
@click.option(
    "--config", "file", type=click.Path(path_type=Path), help="Settings in TOML; see config.toml in any run folder."
)
@click.option("--preset", help="Settings that come with the suite: quick or full.")
@click.option(
    "--set", "assign", multiple=True, metavar="METHOD.PARAM=VALUE", help="A hyper-parameter; may be repeated."
)
@click.option("--dry-run", is_flag=True, help="Print the plan and what is cached, and run nothing.")
@click.option("--no-report", is_flag=True, help="Leave the report and the statistics out.")
@click.option("--quiet", "-q", is_flag=True, help="Print the final lines only.")
@click.pass_context
def run(context: click.Context, **options: Any) -> None:
    """Plan, fit, transfer, score and report; resume where an earlier run was left.

    Every cell (data set x split x task x method x repetition) ends as ok, skipped with a reason, or failed with the
    traceback kept; a failure never stops the others.
    """
    from benchmark.commands.tables import make_console
    from benchmark.config import load_config
    from benchmark.runner.run import prepare

    start = time.perf_counter()
    config = load_config(
        preset=options["preset"], file=options["file"], flags=_flags(options), assign=options["assign"]
    )
    prepared = prepare(config)
    console = make_console()
    if options["dry_run"]:
        from benchmark.commands.tables import estimate_lines, plan_table
        from benchmark.runner.run import cell_states

        states = cell_states(prepared)
        guess = _estimate(prepared, states)[1]
        console.print(plan_table(prepared, states, guess))
        for line in estimate_lines(guess):
            console.print(line, markup=False, soft_wrap=True)
        return
    outcome = _run(context, prepared, console, quiet=options["quiet"])
    if prepared.config.shard is not None:
        _show_shard(outcome, prepared.config.shard, console, time.perf_counter() - start)
        context.exit(3 if outcome.failures else 0)
    # The report shows the statistics.
    statistics = [] if options["no_report"] else _statistics(outcome, console)
    report = None if options["no_report"] else _report(outcome, console)
    show(outcome, console, report, time.perf_counter() - start, statistics=statistics, quiet=options["quiet"])
    if outcome.failures:
        context.exit(3)


def _run(context: click.Context, prepared: Prepared, console: Console, *, quiet: bool) -> Outcome:
    from benchmark.runner.costs import Meter, document, error_line, keep, measured
    from benchmark.runner.progress import make_display
    from benchmark.runner.provenance import processor
    from benchmark.runner.run import ESTIMATE, cell_states, shard_cells
    from benchmark.runner.run import run as run_all
    from benchmark.runner.store import write_json

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    previous = signal.signal(signal.SIGTERM, stop)
    try:
        cells = shard_cells(prepared.cells, prepared.config.shard)
        works, guess = _estimate(prepared, cell_states(prepared))
        with make_display(console, len(cells), quiet=quiet) as display:
            meter, start = Meter(display), time.perf_counter()
            outcome = run_all(prepared, meter)
            seconds = time.perf_counter() - start
        if meter.seconds:
            keep(measured(works, prepared.folder, outcome.states, meter.seconds, processor()))
            if len(meter.seconds) == len(works):  # of cells that failed the estimate says nothing
                write_json(prepared.folder / ESTIMATE, document(guess, seconds))
                if not quiet:
                    console.print(error_line(guess, seconds), markup=False, soft_wrap=True)
        return outcome
    except KeyboardInterrupt:
        command = shlex.join(["python", "-m", "benchmark", *sys.argv[1:]])
        click.echo(f"\ninterrupted; finished cells are kept. Go on with:\n  {command}", err=True)
        context.exit(130)
    finally:
        signal.signal(signal.SIGTERM, previous)


def _estimate(prepared: Prepared, states: Mapping[str, CellStatus]) -> tuple[list[Work], Estimate]:
    """What will be run, and what it will cost by what earlier runs did cost."""
    from benchmark.runner.costs import estimate, pending, read_ledger
    from benchmark.runner.provenance import processor
    from benchmark.runner.run import cells_at_a_time

    works = pending(prepared, states)
    jobs = cells_at_a_time(prepared.config)
    return works, estimate(works, read_ledger(), jobs=jobs, processor=processor())


def _show_shard(outcome: Outcome, shard: str, console: Console, seconds: float) -> None:
    """Print how a part of a run ended, and how the whole is put together."""
    for what, cells in (("skipped", outcome.skips), ("failed", outcome.failures)):
        for cell, reason in cells:
            console.print(f"{what}: {cell.title}: {reason}", markup=False, soft_wrap=True)
    console.print(
        f"shard {shard}: {len(outcome.cells)} cells: {outcome.executed} run, {outcome.scored} scored again, {outcome.cached} "
        f"from the cache, {len(outcome.skips)} skipped, {len(outcome.failures)} failed; {seconds:.1f} s",
        soft_wrap=True,
    )
    console.print(
        "when every shard is done, the same command without --shard writes the tables and the report", soft_wrap=True
    )


def _report(outcome: Outcome, console: Console) -> Path | None:
    """Build the report; its failure is shown and leaves the run's results as they are."""
    page = outcome.folder / "report" / "index.html"
    if page.is_file() and not outcome.rebuilt:
        return page
    from benchmark.registry import load_target

    try:
        built: Path = load_target("reports.build:build_report", "the report")(
            outcome.folder, tell=lambda figure: _figure(figure, console)
        )
    except Exception as error:  # results are safe on disk; a plug-in figure may raise anything
        if os.environ.get("BENCHMARK_DEBUG"):
            raise
        console.print(
            f"[red]the report failed[/red] ({type(error).__name__}: {error}); results are complete without it"
        )
        return None
    return built


def _figure(figure: Any, console: Console) -> None:
    """Say which figure failed; those that were drawn or have nothing to show need no word here."""
    if figure.failed:
        console.print(f"figure {figure.line}", style="yellow", markup=False)


def _statistics(outcome: Outcome, console: Console) -> list[str]:
    """Compare the methods and simulate ratings, unless nothing has changed; a failure is shown and leaves the results."""
    folder = outcome.folder / "stats"
    if (folder / "metrics-comparison.csv").is_file() and not outcome.rebuilt:
        return [f"statistics: {folder}"]
    from benchmark.registry import load_target

    try:
        lines: list[str] = load_target("reports.analysis:analyse_run", "the statistics")(outcome.folder)
    except Exception as error:  # results are safe on disk
        if os.environ.get("BENCHMARK_DEBUG"):
            raise
        console.print(f"[red]the statistics failed[/red] ({type(error).__name__}: {error}); try `analyze`")
        return []
    return lines


def show(
    outcome: Outcome,
    console: Console,
    report: Path | None,
    seconds: float,
    *,
    statistics: Sequence[str] = (),
    quiet: bool,
) -> None:
    """Print how a run ended: the leaderboard, what was skipped or failed and why, and where the results are."""
    from benchmark.runner.views import read_leaderboard

    rows = read_leaderboard(outcome.folder)
    if not quiet:
        from benchmark.commands.tables import leaderboard_tables

        for table in leaderboard_tables(rows):
            console.print(table)
            console.print()
    ended = {cell.method for cell, _ in outcome.failures}
    broken = sorted({row["metric"] for row in rows if row["failed"] and row["method"] not in ended})
    if broken:
        console.print(
            f"metrics that failed on some clips: {', '.join(broken)}; results.parquet has the reasons",
            markup=False,
            soft_wrap=True,
        )
    for what, cells in (("skipped", outcome.skips), ("failed", outcome.failures)):
        for cell, reason in cells:
            console.print(f"{what}: {cell.title}: {reason}", markup=False, soft_wrap=True)
    for cell, _ in outcome.failures:
        traceback = outcome.folder / "cells" / cell.key / "traceback.txt"
        if traceback.is_file():
            console.print(f"traceback of {cell.title}: {traceback}", markup=False, soft_wrap=True)
    console.print(
        f"{len(outcome.cells)} cells: {outcome.executed} run, {outcome.scored} scored again, {outcome.cached} from the cache, "
        f"{len(outcome.skips)} skipped, {len(outcome.failures)} failed; {seconds:.1f} s",
        soft_wrap=True,
    )
    console.print(f"results: {outcome.folder / 'results.parquet'}", markup=False, soft_wrap=True)
    for line in statistics:
        console.print(line, markup=False, soft_wrap=True)
    if report is not None:
        console.print(f"report: {report}", markup=False, soft_wrap=True)


def split_list(texts: tuple[str, ...]) -> list[str] | None:
    """Split at commas outside brackets; ``None`` for no option, so that lower layers of the settings show through."""
    parts: list[str] = []
    for text in texts:
        depth, part = 0, ""
        for sign in text:
            depth += (sign == "[") - (sign == "]")
            if sign == "," and depth == 0:
                parts.append(part)
                part = ""
            else:
                part += sign
        parts.append(part)
    # An option with nothing in it, as of an unset shell variable, must not mean "all".
    return [part.strip() for part in parts if part.strip()] if texts else None


def _flags(options: dict[str, Any]) -> dict[str, Any]:
    from benchmark.config import parse_value
    from benchmark.errors import ConfigError

    def assigned(option: str, texts: tuple[str, ...]) -> dict[str, Any] | None:
        values = {}
        for text in texts:
            name, equals, value = text.partition("=")
            if not equals:
                raise ConfigError(f"{option} {text!r}: write name=value")
            values[name.strip()] = parse_value(value.strip())
        return values or None

    same = (
        *("repetitions", "seed", "limit", "out", "jobs", "threads", "device", "backend", "scheduler"),
        *("shard", "overwrite", "time_limit", "memory_limit"),
    )
    return {
        **{name: options[name] for name in same},
        "methods": split_list(options["methods"]),
        "metrics": split_list(options["metrics"]),
        "tasks": split_list(options["task"]),
        "force": split_list(options["force"]),
        "variants": split_list((options["variants"],)) if options["variants"] else None,
        "dataset": {
            "name": options["dataset"],
            "root": options["root"],
            "options": assigned("--data-option", options["data_option"]),
        },
        "split": {
            "protocol": options["protocol"],
            "fold": options["fold"],
            "seed": options["split_seed"],
            "parameters": assigned("--split-option", options["split_option"]),
            "file": options["split_file"],
        },
    }
