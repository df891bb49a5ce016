"""``study``: from a run's results to ratings by people, on a web site of one's own."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from benchmark.errors import ConfigError, DataError

if TYPE_CHECKING:
    from rich.console import Console

    from reports.study.app import Site

EPILOG = """\b
From a run to a figure:
  python -m benchmark study build runs/kg -o study --conditions identity,hsu,cyclegan,child-reference
  python -m benchmark study simulate study 36      # a rehearsal, by simulated observers
  python -m benchmark study analyze study --rehearsal
  edit study/texts/consent.md                      # who you are, and what raters agree to
  python -m benchmark study serve study            # people
  python -m benchmark study analyze study

\b
A guide (on a laptop, behind a proxy with TLS, backups, what is stored):
  docs/study.md
"""

_STUDY = click.argument("study", type=click.Path(path_type=Path))
_REHEARSAL = click.option(
    "--rehearsal", is_flag=True, help="Of rehearsals: simulated observers, or yourself trying it out."
)


@click.group(epilog=EPILOG)
def study() -> None:
    """Ask people: a perceptual study of a run's results, as in Dong et al. (2020), on a web site of your own."""


@study.command()
@click.argument("run", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("-o", "--out", required=True, type=click.Path(path_type=Path), help="Folder of the study.")
@click.option("--task", default="", metavar="SOURCE:TARGET", help="[default: the run's first]")
@click.option("--conditions", default="", metavar="METHODS", help="Methods to compare, by commas. [default: all]")
@click.option("--actions", default="", metavar="ACTIONS", help="Actions to show, by commas. [default: all]")
@click.option(
    "--clips", default=10, show_default=True, help="Clips of each condition, balanced over actions and actors."
)
@click.option("--catch", default=0, show_default=True, help="Further clips that only check attention.")
@click.option("--seconds", default=10.0, show_default=True, help="Length of every video; a shorter clip is repeated.")
@click.option(
    "--min-watch", type=float, help="Seconds before a video can be answered. [default: once through the video]"
)
@click.option(
    "--action-question",
    type=click.Choice(["list", "text", "none"]),
    default="list",
    show_default=True,
    help="How the attention check is asked.",
)
@click.option("--choices", default=6, show_default=True, help="Answers in the list of actions, beside 'I cannot tell'.")
@click.option("--raters", default=36, show_default=True, help="Raters planned for; enrolment closes there.")
@click.option(
    "--figure",
    type=click.Choice(["leg", "height", "own"]),
    default="leg",
    show_default=True,
    help="Bring all figures to one size by legs or height, or leave sizes, which tell children from adults.",
)
@click.option("--credit", default="", metavar="TEXT", help="Line under every video. [default: data set and licence]")
@click.option("--seed", default=0, show_default=True, help="Of the choice of clips, orders, and wrong answers.")
@click.option("--size", default="640x480", show_default=True, metavar="WxH", help="Of the videos, in pixels.")
@click.option("--fps", default=30.0, show_default=True, help="Of the videos.")
@click.option("--jobs", "-j", type=click.IntRange(min=1), help="Videos rendered at a time. [default: the cores]")
@click.option("--quiet", "-q", is_flag=True, help="Print the final lines only.")
def build(
    run: Path, out: Path, conditions: str, actions: str, size: str, jobs: int | None, quiet: bool, **settings: object
) -> None:
    """Choose stimuli of RUN, render them blinded, and sign the plan of who sees what in which order.

    The same clips are shown in every condition. Videos have equal lengths and random names; what they are stands in
    private/key.csv only. Every rater has an order of his or her own, balanced over conditions by a Williams design. A build
    that was interrupted goes on where it was.
    """
    from benchmark.commands.tables import make_console
    from reports.run import RunView
    from reports.study.build import Settings, build_study
    from reports.study.power import what_can_be_found

    width, sign, height = size.partition("x")
    if not (sign and width.isdigit() and height.isdigit()):
        raise ConfigError(f"--size is written as 640x480, not {size!r}")
    console = make_console()
    wanted = Settings(
        methods=_names(conditions),
        actions=_names(actions),
        size=(int(width), int(height)),
        **settings,  # type: ignore[arg-type]
    )
    with _progress(console, "videos", quiet) as report:
        built = build_study(RunView(run), out, wanted, jobs=jobs or _cores(), report=report)
    plan = built.plan
    if not quiet:
        if built.kept:
            console.print(f"{built.kept} videos were there already and are kept.")
        for note in built.notes:
            console.print(note, markup=False)
        clips = len(plan.orders[0].stimuli) // len(built.conditions)
        for note in what_can_be_found(raters=plan.raters, conditions=len(built.conditions), clips=clips):
            console.print(note, markup=False)
        advice = "; fewer --conditions or --clips make it shorter" if plan.minutes > 25 else ""
        console.print(
            f"A session of {plan.pages} videos of {plan.seconds:g} s takes about {plan.minutes:.0f} minutes{advice}.",
            style="yellow" if advice else "",
        )
        console.print(f"Edit {built.folder.texts}/consent.md and thanks.md, then:", markup=False, soft_wrap=True)
        console.print(f"  python -m benchmark study serve {out}", markup=False, soft_wrap=True)
    console.print(f"study: {out}", markup=False, soft_wrap=True)


@study.command()
@_STUDY
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen on.")
@click.option("--port", type=click.IntRange(0, 65535), default=8000, show_default=True, help="0 takes a free one.")
@click.option("--rehearsal", is_flag=True, help="Try it out: no waiting, no limit; answers are kept apart.")
@click.option("--invited-only", is_flag=True, help="Only people with a link of `study invite` may take part.")
@click.option(
    "--export", type=click.Path(path_type=Path), metavar="FILE.csv", help="Keep a ratings file up to date meanwhile."
)
def serve(study: Path, host: str, port: int, rehearsal: bool, invited_only: bool, export: Path | None) -> None:
    """Show STUDY to raters until interrupted (Ctrl+C).

    The plan, every video and the key are held against the plan's signature first. Answers are on disk before a rater sees the
    next page; stopping, even by force, loses none, and raters go on where they were.
    """
    from benchmark.commands.tables import make_console
    from reports.study.layout import StudyFolder
    from reports.study.serve import address, bind
    from reports.study.serve import serve as serve_study
    from reports.study.texts import check_filled_in

    folder = StudyFolder(study)
    folder.check_built()
    if not rehearsal:
        check_filled_in(folder)
    console = make_console()
    bound = bind(host, port)

    def started(site: Site) -> None:
        finished, active = site.store.counts()
        console.print(address(bound), style="bold", markup=False)
        if rehearsal:
            console.print(
                "A rehearsal: answers are kept apart and count as simulated observers, not people.", style="yellow"
            )
        else:
            console.print(f"{finished} of {site.plan.raters} raters have finished, {active} are at it.", markup=False)
        console.print("Stop with Ctrl+C.")

    serve_study(folder, bound, rehearsal=rehearsal, invited_only=invited_only, export=export, started=started)
    if export is not None and export.is_file():
        console.print(f"ratings: {export}", markup=False, soft_wrap=True)


@study.command()
@_STUDY
@click.argument("count", type=click.IntRange(1, 10_000))
@click.option("--url", default="http://127.0.0.1:8000", show_default=True, help="Where raters will reach the site.")
def invite(study: Path, count: int, url: str) -> None:
    """Print COUNT personal links, one a line. Each is for one person, who can go on with it on any device.

    They are stored nowhere: keep what is printed. The site may be running.
    """
    from reports.study.layout import StudyFolder
    from reports.study.serve import invite as invite_raters

    for token in invite_raters(StudyFolder(study), count):
        click.echo(f"{url.rstrip('/')}/r/{token}")


@study.command()
@_STUDY
@click.argument("count", type=click.IntRange(min=1), default=36)
@click.option("--seed", default=0, show_default=True, help="Of the observers.")
@click.option("--quiet", "-q", is_flag=True, help="Print the final lines only.")
def simulate(study: Path, count: int, seed: int, quiet: bool) -> None:
    """Let COUNT simulated observers take STUDY through its web pages: a rehearsal of everything but the people.

    A server of its own is started; every page is fetched and every form is sent as a browser would. The answers are those of
    a model, driven by the metrics of the run. They are kept apart from people's, and say that they are simulated.
    """
    from benchmark.commands.tables import make_console
    from reports.study.layout import StudyFolder
    from reports.study.simulate import simulate_study

    console = make_console()
    with _progress(console, "pages", quiet) as report:
        done = simulate_study(StudyFolder(study), count, seed=seed, report=report)
    if not quiet:
        for note in done.notes:
            console.print(note, markup=False)
    console.print(f"{done.sessions} simulated sessions, {done.pages} pages in {done.seconds:.1f} s", markup=False)


@study.command()
@_STUDY
@click.option("-o", "--ratings", required=True, type=click.Path(path_type=Path), help="CSV file to write.")
@click.option("--stimuli", type=click.Path(path_type=Path), help="CSV file for the key.")
@_REHEARSAL
@click.option("--times", is_flag=True, help="Add when each page was answered, which can tell who answered.")
def export(study: Path, ratings: Path, stimuli: Path | None, rehearsal: bool, times: bool) -> None:
    """Write the ratings of STUDY as the CSV that `analyze --ratings` reads. The site may be running."""
    from reports.study.export import export_ratings, export_stimuli
    from reports.study.layout import StudyFolder

    folder = StudyFolder(study)
    done = export_ratings(folder, ratings, rehearsal=rehearsal, times=times)
    if stimuli is not None:
        export_stimuli(folder, stimuli)
    click.echo(
        f"{done.answers} answers of {done.finished} finished and {done.unfinished} unfinished sessions: {ratings}"
    )


@study.command()
@_STUDY
@_REHEARSAL
@click.option("--out", type=click.Path(path_type=Path), help="Folder that gets stats and tables. [default: in STUDY]")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Of the bootstrap.")
@click.option("--quiet", "-q", is_flag=True, help="Print the final lines only.")
def analyze(study: Path, rehearsal: bool, out: Path | None, seed: int, quiet: bool) -> None:
    """Analyse what STUDY's raters answered: tests, intervals, tables and the figure, in STUDY/analysis.

    With --out RUN the statistics of that run are replaced by these, and its report and claims use them.
    """
    from benchmark.commands.analyze import print_ratings
    from benchmark.commands.tables import make_console
    from reports.ratings import STATS
    from reports.study.analysis import analyse_study
    from reports.study.layout import StudyFolder

    console = make_console()
    folder = StudyFolder(study)
    folder.check_built()
    if not rehearsal and not folder.database(rehearsal=False).is_file():
        hint = "; there are rehearsals: --rehearsal" if folder.database(rehearsal=True).is_file() else ""
        raise DataError(f"nobody has taken part in {study} yet{hint}")
    results = analyse_study(folder, rehearsal=rehearsal, out=out, seed=seed)
    if not quiet:
        print_ratings(console, results.written)
    target = folder.results(rehearsal=rehearsal) if out is None else out
    whose = f" ({results.written.analysis.kind})" if rehearsal else ""
    for path in results.figures:
        console.print(f"figure{whose}: {path}", markup=False, soft_wrap=True)
    console.print(f"ratings{whose}: {target / STATS / 'ratings.md'}", markup=False, soft_wrap=True)


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


def _cores() -> int:
    import os

    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1


class _progress:
    """A bar on a terminal; elsewhere a line at each tenth."""

    def __init__(self, console: Console, what: str, quiet: bool) -> None:
        self._console, self._what, self._quiet = console, what, quiet
        self._tenth = -1

    def __enter__(self) -> _progress:
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            Progress,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )

        columns = (
            TextColumn(self._what),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
        )
        self._bar = Progress(
            *columns, console=self._console, transient=True, disable=self._quiet or not self._console.is_terminal
        )
        self._task = self._bar.add_task(self._what, total=None)
        if self._console.is_terminal:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def __call__(self, done: int, total: int) -> None:
        if self._console.is_terminal:
            self._bar.update(self._task, completed=done, total=total)
        elif not self._quiet and total and 10 * done // total > self._tenth:
            self._tenth = 10 * done // total
            self._console.print(f"{self._what}: {done} of {total}", markup=False)
