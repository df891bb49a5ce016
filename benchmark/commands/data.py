"""``benchmark data``: fetch, verify and describe data sets, list a folder's clips, write the synthetic corpus."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from benchmark.errors import BenchmarkError, DataError

if TYPE_CHECKING:
    from rich.console import Console

    from benchmark.data.archive import Report
    from benchmark.data.base import Dataset
    from benchmark.data.cards import Card

_ROOT = click.option(
    "--root", type=click.Path(path_type=Path), help="Where its files are, instead of BENCHMARK_DATA or the cache."
)
_SHOWN = 20


@click.group()
def data() -> None:
    """Fetch, verify and describe data sets."""


@data.command()
@click.argument("dataset")
@click.option(
    "--from",
    "archive",
    type=click.Path(path_type=Path),
    help="A local archive, or a folder that holds one: no download.",
)
@click.option("--url", help="Download from here instead of upstream.")
@click.option("--again", is_flag=True, help="Fetch even if it is there.")
@click.option("--accept-licence", "accepted", is_flag=True, help="Accept the licence without being asked.")
def fetch(dataset: str, archive: Path | None, url: str | None, again: bool, accepted: bool) -> None:
    """Download DATASET, verify every file, and unpack it into the cache.

    An interrupted download goes on where it stopped. With BENCHMARK_DATA set, an archive found there is used instead.
    """
    from benchmark.data.archive import upstream
    from benchmark.data.cards import load_card
    from benchmark.data.fetch import fetch as fetch_data

    console = _console()
    card = load_card(dataset.partition(":")[0])
    upstream(card)
    _show_licence(console, card)
    if not accepted:
        try:
            click.confirm("Do you accept these terms?", abort=True)
        except click.Abort:
            raise DataError(
                "nothing was fetched: the terms were not accepted (--accept-licence accepts them)"
            ) from None
    with _progress(console) as report:
        result = fetch_data(card, archive=archive, url=url, report=report, again=again)
    console.print(f"{result.receipt.files} files of {card.title}, each as upstream has it, are in", style="green")
    console.print(f"  {result.folder}", soft_wrap=True)
    if result.missing:
        console.print(
            f"A subset: {result.missing} files that upstream has were not in {result.receipt.origin}.", soft_wrap=True
        )
    if result.receipt.left_packed:
        names = ", ".join(result.receipt.left_packed[:5])
        console.print(f"Left out, because their digests are not known: {names}", style="yellow", soft_wrap=True)


@data.command()
@click.argument("dataset")
@_ROOT
@click.option("--complete", is_flag=True, help="Count missing files as a fault: the copy must be whole.")
@click.option("--all", "everything", is_flag=True, help="Name every file, however many.")
@click.pass_context
def verify(context: click.Context, dataset: str, root: Path | None, complete: bool, everything: bool) -> None:
    """Compare every file of DATASET with upstream's digests.

    Ends with code 1 if a file is altered or is none of upstream's, and, with --complete, if one is missing: without it a
    subset is sound.
    """
    from benchmark.data.cards import load_card
    from benchmark.data.locate import locate
    from benchmark.data.verify import verify as verify_data

    console = _console()
    card = load_card(dataset.partition(":")[0])
    folder = locate(card, root)
    with _progress(console) as report:
        result = verify_data(card, folder, report=lambda done, total: report(done, total, "reading files"))
    for what, names, style in (
        ("missing (upstream has it)", result.missing, "red" if complete else "yellow"),
        ("altered", result.altered, "red"),
        ("extra (upstream does not have it)", result.extra, "red"),
    ):
        shown = names if everything or what == "altered" else names[:_SHOWN]
        for name in shown:
            console.print(f"{what}: {name}", style=style, soft_wrap=True, highlight=False, markup=False)
        if len(names) > len(shown):
            console.print(f"{what}: and {len(names) - len(shown)} more (--all names them)", style=style, markup=False)
    console.print(
        f"{folder}\n{len(result.sound)} sound, {len(result.missing)} missing, {len(result.altered)} altered, "
        f"{len(result.extra)} extra",
        soft_wrap=True,
        highlight=False,
    )
    if not result.ok(complete=complete):
        context.exit(1)


@data.command()
@click.argument("dataset", required=False)
@_ROOT
def info(dataset: str | None, root: Path | None) -> None:
    """Show the licence, citation and contents of DATASET, and what of it is on this machine; without a name, all data sets."""
    from rich.table import Table

    from benchmark.data.cards import list_cards, load_card

    console = _console()
    if dataset is None:
        table = Table("id", "what", "licence", "how to get it", box=None)
        for card in list_cards():
            name = "folder:PATH" if card.id == "folder" else card.id
            table.add_row(name, card.summary, card.licence.name, card.how_to_get.split(". ")[0])
        console.print(table)
        return
    card = load_card(dataset.partition(":")[0])
    console.print(f"{card.title} ({card.id}, version {card.version})", style="bold", soft_wrap=True)
    _show_licence(console, card)
    rows = Table.grid(padding=(0, 2))
    rows.add_column(style="cyan", no_wrap=True)
    rows.add_column()
    rows.add_row("contents", card.summary)
    rows.add_row("capture", card.capture or "-")
    rows.add_row("from", card.source.url if card.source else card.how_to_get)
    rows.add_row("cite", card.citation.text)
    if card.styles:
        rows.add_row("styles", "; ".join(f"{name}: {what}" for name, what in card.styles.items()))
    if card.actions:
        rows.add_row("actions", f"{len(card.actions)}: {', '.join(card.actions)}")
    for name, actor in card.actors.items():
        age = f"{actor.age} years, " if actor.age is not None else ""
        rows.add_row(f"actor {name}", f"{actor.style}, {age}{actor.sex}, hand {actor.handedness}, {actor.notes}")
    for trap in card.traps:
        rows.add_row("mind", trap)
    console.print(rows)
    if card.citation.bibtex:
        console.print(card.citation.bibtex.strip(), markup=False, highlight=False, soft_wrap=True)
    _show_copy(console, dataset, root)


@data.command()
@click.argument("dataset")
@_ROOT
@click.option("--pattern", help="For folder:PATH: how file names tell style, actor, action and take.")
@click.option("--index", help="For folder:PATH: a CSV file in the folder that lists its clips.")
@click.option(
    "--csv", "target", type=click.Path(path_type=Path, dir_okay=False), help="Write the table as a CSV index."
)
def index(dataset: str, root: Path | None, pattern: str | None, index: str | None, target: Path | None) -> None:
    """List the clips of DATASET, for example folder:captures."""
    from benchmark.data.catalog import open_dataset
    from benchmark.data.folder import FolderDataset

    console = _console()
    given = {key: value for key, value in (("pattern", pattern), ("index", index)) if value is not None}
    opened = open_dataset(dataset, root=root, **given)
    if target is not None:
        _write_index(opened, target)
        console.print(f"{len(opened.records)} clips are listed in {target}", soft_wrap=True)
    else:
        # Plain lines, never folded, so that the list can be searched and cut.
        rows = [("clip", "style", "actor", "action", "take", "file")]
        for record in opened.records:
            file = "generated" if record.path is None else record.path.name
            rows.append((record.clip_id, record.style, record.actor, record.action, record.take, file))
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        for row in rows:
            click.echo("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
    _show_counts(console, opened)
    twins = [digest for digest, count in Counter(record.sha256 for record in opened.records).items() if count > 1]
    for digest in twins:
        same = [record.clip_id for record in opened.records if record.sha256 == digest]
        console.print(f"the same file under {len(same)} names: {', '.join(same)}", style="yellow", soft_wrap=True)
    if isinstance(opened, FolderDataset) and opened.scan.unmatched:
        names = ", ".join(path.name for path in opened.scan.unmatched[:5])
        console.print(
            f"{len(opened.scan.unmatched)} files do not fit the pattern: {names}", style="yellow", soft_wrap=True
        )


@data.command()
@click.argument("out", type=click.Path(path_type=Path, file_okay=False))
@click.option("--seed", type=int, help="Another corpus of the same kind.")
def synthesize(out: Path, seed: int | None) -> None:
    """Write the synthetic corpus to the folder OUT as BVH files, ready to be used as folder:OUT."""
    from benchmark.data.synthetic import SyntheticDataset

    console = _console()
    opened = SyntheticDataset() if seed is None else SyntheticDataset(seed=seed)
    with _progress(console) as report:
        paths = opened.write_bvh(out, progress=lambda done, name: report(round(100 * done), 100, f"writing {name}"))
    console.print(f"{len(paths)} synthetic clips are in {out}; use them as --dataset folder:{out}", soft_wrap=True)


def _console() -> Console:
    from rich.console import Console

    return Console()


def _show_licence(console: Console, card: Card) -> None:
    licence = card.licence
    commercial = {True: "yes", False: "no", None: "not stated"}[licence.commercial]
    console.print(f"Licence: {licence.name} {licence.url}", style="bold yellow", soft_wrap=True)
    console.print(
        f"  redistribution: {licence.redistribution}\n  commercial use: {commercial}", soft_wrap=True, highlight=False
    )
    if licence.notes:
        console.print(f"  {licence.notes}", soft_wrap=True, highlight=False)


def _show_copy(console: Console, dataset: str, root: Path | None) -> None:
    from benchmark.data.catalog import open_dataset

    if dataset == "folder":
        return
    try:
        opened = open_dataset(dataset, root=root)
        _show_counts(console, opened)
    except BenchmarkError as error:
        console.print(f"Not usable here: {error}", style="yellow", soft_wrap=True, markup=False)
        return
    place = getattr(opened, "folder", None)
    console.print(f"digest {opened.digest}" + (f"\nin {place}" if place else ""), soft_wrap=True, highlight=False)


def _show_counts(console: Console, opened: Dataset) -> None:
    for style in opened.styles:
        records = [record for record in opened.records if record.style == style]
        actors = {record.actor for record in records if record.actor}
        actions = {record.action for record in records}
        performers = f"{len(actors)} performers" if actors else "performers unknown"
        console.print(f"{style}: {len(records)} clips, {performers}, {len(actions)} actions", highlight=False)


def _write_index(opened: Dataset, target: Path) -> None:
    import csv

    from benchmark.data.cache import atomic_path
    from benchmark.data.index import COLUMNS

    base = getattr(opened, "folder", None)
    with atomic_path(target) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        for record in opened.records:
            path = "" if record.path is None or base is None else record.path.relative_to(base).as_posix()
            writer.writerow([path, record.style, record.actor, record.action, record.take])


@contextmanager
def _progress(console: Console) -> Iterator[Report]:
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[amount]}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("starting", total=None, amount="")

        def report(done: int, total: int | None, what: str) -> None:
            large = max(done, total or 0) > 100_000
            amount = f"{done / 1e6:.1f} MB" if large else str(done)
            if total is not None:
                amount += f" of {total / 1e6:.1f} MB" if large else f" of {total}"
            progress.update(task, description=what, completed=done, total=total, amount=amount)

        yield report
