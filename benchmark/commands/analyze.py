"""``analyze``: the statistics of a run, and of ratings by people or by simulated observers."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    import pandas as pd
    from rich.console import Console

    from reports.ratings import Written

EPILOG = """\b
Examples:
  python -m benchmark analyze runs/kg
  python -m benchmark analyze runs/kg --raters 60 --seed 1
  python -m benchmark analyze runs/kg --ratings ratings.csv --stimuli stimuli.csv
  python -m benchmark analyze --ratings ratings.csv --stimuli stimuli.csv --out study

\b
A ratings file (CSV, UTF-8) has one row for each page a rater answered:
  rater,stimulus,style,naturalness,action
  r01,s017,child,5,jump as high as you can
  r01,s003,adult,,walk
Required: rater, stimulus, style (adult or child, or the styles of --task) and
naturalness (1 to 7). Optional: action, order, seconds, time, kind. An empty
cell is a missing answer. The stimuli file says what was shown:
  stimulus,condition,clip_id,action,attention,expected
  s017,cyclegan,adult/934/jump_1,jump,yes,jump|jump as high as you can
Name the conditions of real motion after the two styles. Bad rows are refused
with their line. Everything about both files: eval/ratings/README.md

\b
Written: stats/ratings-*.csv, stats/ratings.md, tables/ratings-*.tex, and of a
run stats/metrics-comparison.csv and stats/metrics-ranks.csv. Of a run with
several tasks the files of all but the first are named
ratings-SOURCE-to-TARGET.
"""


@click.command("analyze", epilog=EPILOG)
@click.argument("folder", metavar="[RUN]", required=False, type=click.Path(path_type=Path))
@click.option("--ratings", type=click.Path(path_type=Path), metavar="FILE.csv", help="Ratings by people.")
@click.option("--stimuli", type=click.Path(path_type=Path), metavar="FILE.csv", help="What they were shown.")
@click.option(
    "--task",
    metavar="SOURCE:TARGET",
    help="The two styles. [default: every task of the run; with --ratings its first, or adult:child]",
)
@click.option(
    "--repetition",
    default="first",
    show_default=True,
    metavar="first|spread|N",
    help="Which training of a method simulated observers see: its first, each in turn from clip to clip, or number N.",
)
@click.option(
    "--raters", type=click.IntRange(min=3), default=36, show_default=True, help="Simulated attentive observers."
)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Of every draw and bootstrap.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder that gets stats and tables. [default: RUN]")
@click.option("--quiet", "-q", is_flag=True, help="Print the final lines only.")
def analyze(
    folder: Path | None,
    ratings: Path | None,
    stimuli: Path | None,
    task: str | None,
    repetition: str,
    raters: int,
    seed: int,
    out: Path | None,
    quiet: bool,
) -> None:
    """Compare methods by their metrics and by ratings, with intervals, corrections and plain words.

    With --ratings and --stimuli the answers of people are analysed. Without them simulated observers rate RUN, a model
    driven by its metrics: that rehearses a study and says nothing about people, and everything made of it says so. Every task
    of the run is rated.

    Raters who name the action right on half of the attention checks or fewer are left out; the analysis with nobody left
    out is given beside. Of a RUN, every metric is compared between methods, too.
    """
    from benchmark.commands.tables import make_console
    from reports.comparison import COMPARISON, RANKS, write_comparison
    from reports.ratings import STATS, ratings_stem
    from reports.run import RunView

    _check_arguments(folder, ratings, stimuli, out)
    shown = _repetition(repetition, ratings)
    console = make_console()
    run = None if folder is None else RunView(folder)
    tasks = [_styles(run, name) for name in (run.tasks if run and not (task or ratings) else [task])]
    target = out if out is not None else folder
    if target is None:  # refused above
        raise click.UsageError("give RUN or --out")
    lines = []
    for styles in tasks:
        written = _rate(run, ratings, stimuli, styles, target, seed, raters, shown)
        if not quiet:
            print_ratings(console, written, ":".join(styles) if len(tasks) > 1 else "")
        whose = f" ({written.analysis.kind})" if written.analysis.kind != "people" else ""
        lines.append(f"ratings{whose}: {target / STATS / ratings_stem(run, ':'.join(styles))}.md")
    if run is not None:
        comparison = write_comparison(run, target / STATS, seed=seed)
        if not quiet:
            _print_metrics(console, comparison.differences, comparison.ranks)
        console.print(f"metrics: {target / STATS / COMPARISON}, {RANKS}", markup=False, soft_wrap=True)
    for line in lines:
        console.print(line, markup=False, soft_wrap=True)


def _repetition(text: str, ratings: Path | None) -> int | str:
    from reports.ratings import FIRST, SPREAD

    if ratings is not None and text != FIRST:
        raise click.UsageError(
            "--repetition chooses what simulated observers see; the stimuli of --ratings are chosen already"
        )
    if text in (FIRST, SPREAD):
        return text
    if not text.isdecimal():
        raise click.UsageError(f"--repetition is {FIRST}, {SPREAD} or a number from 0, not {text!r}")
    return int(text)


def _check_arguments(folder: Path | None, ratings: Path | None, stimuli: Path | None, out: Path | None) -> None:
    if (ratings is None) != (stimuli is None):
        here, missing = ("--ratings", "--stimuli") if stimuli is None else ("--stimuli", "--ratings")
        raise click.UsageError(f"{here} needs {missing}: one file holds the answers, the other says what was shown")
    if folder is None and ratings is None:
        raise click.UsageError("give a RUN for simulated observers to rate, or --ratings and --stimuli")
    if folder is None and out is None:
        raise click.UsageError("without a RUN say by --out where the results go")


def _styles(run: Any, task: str | None) -> tuple[str, str]:
    from benchmark.errors import ConfigError, UnknownNameError

    if task is None:
        task = run.tasks[0] if run is not None else "adult:child"
    elif run is not None and task not in run.tasks:
        raise UnknownNameError("task of the run", task, run.tasks)
    source, sign, target = task.partition(":")
    if not (sign and source and target and source != target):
        raise ConfigError(f"a task is written source:target, for example adult:child, not {task!r}")
    return source, target


def _rate(
    run: Any,
    ratings: Path | None,
    stimuli: Path | None,
    styles: tuple[str, str],
    out: Path,
    seed: int,
    raters: int,
    repetition: int | str,
) -> Written:
    from eval.ratings.reading import read_ratings, read_stimuli
    from reports.ratings import analyse_ratings, ratings_stem, simulate_ratings

    task = ":".join(styles)
    if ratings is None or stimuli is None:
        return simulate_ratings(run, task, out, seed=seed, raters=raters, repetition=repetition)
    read = read_ratings(ratings, read_stimuli(stimuli), styles=styles)
    notes = (f"Ratings: {ratings.name}; stimuli: {stimuli.name}.",)
    return analyse_ratings(read, out, seed=seed, notes=notes, stem=ratings_stem(run, task))


#: Sections that the terminal shows; the whole is in ``stats/ratings.md``.
_SHOWN = ("Raters", "Sensitivity")


def print_ratings(console: Console, written: Written, task: str = "") -> None:
    """Print what ratings say: a table of conditions, and the sentences that the terminal shows."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    analysis, plan = written.analysis, written.plan
    whose = "" if analysis.kind == "people" else f" ({analysis.kind})"
    rows: list[Any] = list(analysis.tables["conditions"].itertuples())
    real = [name for name in (plan.source, plan.target) if name in {row.condition for row in rows}]
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("condition", overflow="fold")
    for heading in (f"called {plan.target} [%]", "naturalness [1 to 7]"):
        table.add_column(Text(heading), justify="right")
        for name in real:
            table.add_column(Text(f"- {name}"), justify="right")
    table.add_column(Text("action right [%]"), justify="right")
    contrasts = analysis.tables["contrasts"]
    contrasts = contrasts[contrasts["sample"] == "attentive"]
    for row in rows:
        action = "-" if row.action_correct != row.action_correct else f"{100 * row.action_correct:.0f}"
        table.add_row(
            Text(row.condition),
            Text(f"{100 * row.child_share:.0f} [{100 * row.child_low:.0f}, {100 * row.child_high:.0f}]"),
            *(Text(_difference(contrasts, "child", row.condition, name)) for name in real),
            Text(f"{row.naturalness_mean:.1f} [{row.naturalness_low_clips:.1f}, {row.naturalness_high_clips:.1f}]"),
            *(Text(_difference(contrasts, "naturalness", row.condition, name)) for name in real),
            action,
        )
    of_task = f", {task.replace(':', ' to ')}" if task else ""
    console.print(Text(f"ratings{whose}{of_task}: means [95 % intervals], differences from real motion", style="bold"))
    console.print(table)
    console.print(
        "  * paired t test over raters, Holm-corrected p < 0.05; (*) likewise, but the rater x clip interval holds 0"
    )
    for note in (*written.notes, *analysis.sections["Main effect"][:2]):
        console.print(f"  {note}", markup=False)
    for heading in _SHOWN:
        for sentence in analysis.sections[heading]:
            console.print(f"  {sentence}", markup=False)
    console.print()


def _difference(contrasts: pd.DataFrame, question: str, condition: str, other: str) -> str:
    """The condition minus another, with its mark; empty for itself."""
    of = contrasts[(contrasts["question"] == question) & contrasts["a"].isin([condition, other])]
    of = of[of["b"].isin([condition, other])]
    if condition == other or of.empty:
        return ""
    row = of.iloc[0]
    sign = 1 if row["a"] == condition else -1
    mark = "*" if row["reject"] else ""
    mark = "(*)" if mark and row["low_clips"] <= 0 <= row["high_clips"] else mark
    scale, digits = (100, 0) if question == "child" else (1, 1)
    return f"{scale * sign * row['diff']:+.{digits}f} {mark:<3}"


def _print_metrics(console: Console, differences: pd.DataFrame, ranks: pd.DataFrame) -> None:
    from rich import box
    from rich.table import Table
    from rich.text import Text

    from reports.tables import column_names

    if differences.empty:
        console.print("metrics: no task has two methods with values to compare")
        return
    # Where all methods have the same values there is nothing to rank.
    shown = ranks[(ranks["variant"] == "raw") & ranks["p"].notna()]
    names = column_names(dict.fromkeys(shown["metric"]))
    for task in dict.fromkeys(shown["task"]):
        of_task = shown[shown["task"] == task]
        methods = list(dict.fromkeys(of_task["method"]))
        title = f"metrics, {task.replace(':', ' to ')}: mean rank over clips, 1 is best (* not told from the best)"
        table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
        table.add_column("metric", no_wrap=True)
        for method in methods:
            table.add_column(Text(method), justify="right", overflow="fold")
        table.add_column("Friedman p", justify="right")
        table.add_column("clips", justify="right")
        for metric in dict.fromkeys(of_task["metric"]):
            of = of_task[of_task["metric"] == metric]
            cells = {row.method: _rank(row, of["mean_rank"].min()) for row in of.itertuples()}
            first = of.iloc[0]
            p = "< 0.001" if first["p"] < 0.001 else f"{first['p']:.3f}"
            table.add_row(Text(names[metric]), *(cells.get(name, Text("")) for name in methods), p, str(first["n"]))
        console.print(Text(title, style="bold"))
        console.print(table)
    raw = differences[differences["variant"] == "raw"]
    for task, family in dict.fromkeys(zip(raw["task"], raw["family"], strict=True)):
        of = raw[(raw["task"] == task) & (raw["family"] == family)]
        console.print(
            f"  {family}, {task.replace(':', ' to ')}: {int(of['reject'].sum())} of {len(of)} differences between methods are "
            "significant, Holm-corrected within this family",
            markup=False,
        )
    console.print()


def _rank(row: Any, best: float) -> Any:
    from rich.text import Text

    near = row.mean_rank - best < row.cd
    return Text(f"{row.mean_rank:.1f}{'*' if near else ' '}", style="bold" if row.mean_rank == best else "")
