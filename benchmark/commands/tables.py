"""Tables for the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    import pandas as pd

    from benchmark.runner.costs import Estimate, Guess
    from benchmark.runner.run import Prepared
    from benchmark.runner.store import CellStatus


#: Rows of a plan that are shown.
SHOWN = 200


def plan_table(prepared: Prepared, states: Mapping[str, CellStatus], estimate: Estimate) -> Table:
    """The plan with what is cached, and what the rest will cost."""
    from benchmark.runner.run import shard_cells, to_execute

    cells = shard_cells(prepared.cells, prepared.config.shard)
    runs = sum(to_execute(prepared.config, cell, states[cell.key]) for cell in cells)
    more = f"; the first {SHOWN} are shown" if len(cells) > SHOWN else ""
    table = Table(title=f"{len(cells)} cells, {runs} to run, in {prepared.folder}{more}", title_justify="left")
    for name in ("cell", "task", "method", "rep", "seed", "device", "now", "will be", "time", "memory", "disk", "why"):
        table.add_column(name, overflow="fold")
    for cell in cells[:SHOWN]:
        status = states[cell.key]
        will = "run" if to_execute(prepared.config, cell, status) else {"ok": "kept"}.get(status.state, status.state)
        reason = status.reason if status.state != "missing" else ""
        row = [cell.key[:12], cell.task, cell.method, str(cell.repetition), str(cell.seed), cell.device]
        costs = ["", "", ""]
        if cell.key in estimate.works:
            guess = estimate.works[cell.key]
            costs = ["unknown"] * 3
            if guess is not None:
                costs = [f"{_range(guess.seconds)} s", _bytes(guess.memory.value), _bytes(guess.disk.value)]
                reason = reason or guess.basis
        table.add_row(*(Text(value) for value in [*row, status.state, will, *costs, reason]))
    return table


def estimate_lines(estimate: Estimate) -> list[str]:
    """What a run will cost in all, for the terminal."""
    if not estimate.works:
        return []
    lines = []
    if len(estimate.works) > estimate.unknown:
        wall, memory, disk = estimate.wall, estimate.memory, estimate.disk
        lines.append(
            f"estimated: {_range(wall)} s with {estimate.jobs} at a time, {_bytes(memory.value)} of memory for them, "
            f"{_bytes(disk.value)} on disk; from the costs of earlier runs"
        )
    if estimate.unknown:
        lines.append(
            f"unknown: {estimate.unknown} of {len(estimate.works)} cells and probes are of a kind that was never run here; a "
            "run with --limit 2 or of a smaller data set tells"
        )
    return lines


def _range(guess: Guess) -> str:
    return f"{guess.value:.0f} ({guess.low:.0f} to {guess.high:.0f})"


def leaderboard_tables(rows: Sequence[dict[str, Any]]) -> list[Table | Text]:
    """One table for each task and group of metrics: methods as rows, real motion last, the best of the others in bold.

    Physics is shown without and with the common foot lock; other groups without. Of a group in which nothing has a value, a
    line says why.
    """
    tables: list[Table | Text] = []
    for task in dict.fromkeys(row["task"] for row in rows):
        of_task = [row for row in rows if row["task"] == task]
        groups: dict[str, list[dict[str, Any]]] = {}
        for row in of_task:
            groups.setdefault(row["metric"].partition("/")[0], []).append(row)
        for group, members in groups.items():
            if any(row["mean"] is not None for row in members):
                tables.append(_group_table(task, group, members))
            else:
                reasons = "; ".join(dict.fromkeys(row["reason"] for row in members))
                tables.append(Text(f"{group}, {task}: no values ({reasons})", style="dim"))
    return tables


def _group_table(task: str, group: str, rows: Sequence[dict[str, Any]]) -> Table:
    from benchmark.runner.views import REAL
    from reports.tables import arrow

    variants = ("raw", "cleaned") if group == "physics" else ("raw",)
    rows = [row for row in rows if row["variant"] in variants]
    metrics = {row["metric"]: row for row in reversed(rows)}
    names = sorted(dict.fromkeys((row["method"], row["variant"]) for row in rows), key=lambda pair: pair[0] == REAL)
    cells = {(row["method"], row["variant"], row["metric"]): row for row in rows}
    title = f"{group}: {rows[0]['dataset']}, {task.replace(':', ' to ')}; mean over clips (n)"
    table = Table(
        title=Text(title), title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0)
    )
    shown = list(dict.fromkeys(row["metric"] for row in rows))
    best = {metric: _best([r for r in rows if r["metric"] == metric and r["method"] != REAL]) for metric in shown}

    def heading(metric: str) -> str:
        info = metrics[metric]
        aim = arrow(info["direction"], info["target"])
        words = f"{metric.partition('/')[2].replace('_', ' ').replace('-', ' ')} {aim}".strip()
        return words + ("" if info["unit"] in ("1", "B") else f" [{info['unit']}]")

    def label(method: str, variant: str) -> str:
        return method + ("" if variant == "raw" else " (cleaned)") + (" (ceiling)" if method == REAL else "")

    if len(shown) > len(names):
        # Many metrics of few methods are read down the page.
        table.add_column("metric", no_wrap=True)
        for name in names:
            table.add_column(Text(label(*name)), justify="right", overflow="fold")
        for metric in shown:
            values = [_value(cells.get((*name, metric)), best[metric]) for name in names]
            table.add_row(Text(heading(metric)), *values)
        return table
    table.add_column("method", no_wrap=True)
    for metric in shown:
        table.add_column(Text(heading(metric)), justify="right")
    for method, variant in names:
        if method == REAL and variant == "raw":
            table.add_section()
        values = [_value(cells.get((method, variant, metric)), best[metric]) for metric in shown]
        table.add_row(Text(label(method, variant)), *values)
    return table


def _best(rows: Sequence[dict[str, Any]]) -> float | None:
    known = [row for row in rows if row["mean"] is not None]
    if not known or known[0]["direction"] == "none":
        return None
    direction, target = known[0]["direction"], known[0]["target"]
    means = [row["mean"] for row in known]
    if direction == "target":
        best: float = min(means, key=lambda mean: abs(mean - target))
    else:
        best = min(means) if direction == "lower" else max(means)
    return best


def _value(row: dict[str, Any] | None, best: float | None) -> Text:
    if row is None:
        return Text("")
    if row["mean"] is None:
        return Text("failed" if row["failed"] else "skipped", style="dim")
    from reports.tables import number

    shown = _bytes(row["mean"]) if row["unit"] == "B" else number(row["mean"])
    return Text(f"{shown} ({row['n']})", style="bold" if row["mean"] == best else "")


def claims_table(table: pd.DataFrame) -> Table:
    """The claims with their tests and verdicts."""
    from reports.claims.evidence import FAILS, HOLDS
    from reports.claims.table import effect, p_value

    shown = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for name, ratio in (("claim", 4), ("test", 4), ("effect", None), ("p", None), ("verdict", 3)):
        shown.add_column(name, overflow="fold", ratio=ratio)
    row: Any
    for paper, group in table.groupby("paper", sort=False):
        shown.add_section()
        shown.add_row(Text(str(paper), style="bold"))
        previous = ""
        for row in group.itertuples():
            style = {HOLDS: "green", FAILS: "red"}.get(row.verdict, "dim")
            verdict = Text(row.verdict, style=style)
            if row.why:
                verdict.append(f": {row.why}", style="dim")
            said = str(row.statement) if row.claim != previous else ""
            previous = row.claim
            shown.add_row(Text(said), Text(str(row.test)), Text(effect(row)), Text(p_value(row.p_holm)), verdict)
    return shown


def _bytes(value: float) -> str:
    for unit in ("B", "kB", "MB"):
        if value < 1000:
            return f"{value:.3g} {unit}"
        value /= 1000
    return f"{value:.3g} GB"


def make_console() -> Console:
    """A console for results; wide where there is no terminal to say how wide, so that tables in logs are not folded."""
    console = Console(highlight=False, emoji=False)  # "adult:child:" is a task, not a picture
    return console if console.is_terminal else Console(highlight=False, emoji=False, width=160)
