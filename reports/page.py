"""``report/index.html``: one self-contained page that opens from disk without a network."""

from __future__ import annotations

import base64
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmark.errors import BenchmarkError
from reports.drawing import SavedDrawing
from reports.run import RunView
from reports.tables import arrow, by_group, column_names, number

if TYPE_CHECKING:
    import pandas as pd


def write_page(run: RunView, drawings: Sequence[SavedDrawing]) -> Path:
    """Write the page into ``run.folder/report`` and return its path."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("reports", "templates"), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    page = environment.get_template("report.html.j2").render(
        title=f"Motion style benchmark: {run.dataset_title}",
        subtitle=f"{', '.join(task.replace(':', ' to ') for task in run.tasks)}; run {run.folder.name}",
        synthetic=run.dataset == "synthetic",
        limited=_limited(run),
        boards=[board for task in run.tasks for variant in run.variants(task) for board in _boards(run, task, variant)],
        figures=[_figure(drawing) for drawing in drawings],
        cells=_cells(run),
        holes=_holes(run),
        data_facts=_data_facts(run),
        machine_facts=_machine_facts(run),
        config=(run.folder / "config.toml").read_text() if (run.folder / "config.toml").is_file() else "",
    )
    path = run.folder / "report" / "index.html"
    path.parent.mkdir(exist_ok=True)
    path.write_text(page, encoding="utf-8")
    return path


def _limited(run: RunView) -> str:
    path = run.folder / "config.toml"
    limit = tomllib.loads(path.read_text()).get("limit") if path.is_file() else None
    return f"Only {limit} test clips were transferred (limit = {limit}): a quick look, not a result." if limit else ""


#: The group of metrics that the common foot lock is for; of others the page shows results without it only.
_LOCKED = "physics"


def _boards(run: RunView, task: str, variant: str) -> list[dict[str, Any]]:
    """One leaderboard for each group of metrics."""
    groups = by_group(run.leaderboard(task, variant=variant))
    return [
        _board(run, task, variant, group, table)
        for group, table in groups.items()
        if variant == "raw" or group == _LOCKED
    ]


def _board(run: RunView, task: str, variant: str, group: str, table: pd.DataFrame) -> dict[str, Any]:
    entries: dict[tuple[str, str], Any] = {}
    first: dict[str, Any] = {}
    entry: Any
    for entry in table.itertuples():
        entries[entry.method, entry.metric] = entry
        first.setdefault(entry.metric, entry)
    columns = []
    names = column_names(first)
    for metric in first:
        row = first[metric]
        unit = "" if row.unit in ("", "1") else row.unit
        columns.append({"name": names[metric], "arrow": arrow(row.direction, row.target), "hint": unit})
    rows = [
        {
            "label": run.label(method),
            "real": method == run.real_method,
            "cells": [_entry(entries.get((method, metric))) for metric in first],
        }
        for method in run.methods(task)
    ]
    how = "as each method returns them" if variant == "raw" else "after the same foot lock for every method"
    caption = (
        f"Means over clips, results {how}; in brackets 95 % intervals from resampling actors and then their clips. ↓ lower is "
        "better, ↑ higher is better, → the value aimed at. The shaded row is the same metric on held-out performers of the "
        "target style. Hover over a value for n, or for why there is none."
    )
    title = f"{group}: {task.replace(':', ' to ')}" + ("" if variant == "raw" else f", {variant}")
    return {"title": title, "columns": columns, "rows": rows, "caption": caption}


def _entry(row: Any) -> dict[str, str]:
    if row is None or not np.isfinite(row.mean):
        reason = "not scored" if row is None else row.reason
        return {"value": "", "text": "–", "interval": "", "title": reason}
    interval = f"[{number(row.low)}, {number(row.high)}]" if row.n > 1 else ""
    return {
        "value": repr(float(row.mean)),
        "text": number(row.mean),
        "interval": interval,
        "title": f"n = {row.n} clips" if row.n > 1 else "one value for all clips together",
    }


def _figure(drawing: SavedDrawing) -> dict[str, str]:
    picture = base64.b64encode(drawing.png.read_bytes()).decode()
    return {
        "src": f"data:image/png;base64,{picture}",
        "alt": drawing.caption,
        "caption": drawing.caption.rstrip("."),
        "pdf": f"../figures/{drawing.pdf.name}",
        "csv": f"../figures/{drawing.csv.name}",
    }


def _cells(run: RunView) -> list[dict[str, Any]]:
    rows = []
    keys = ["cell_key", "method", "task", "repetition"]
    names: Any
    for names, group in run.results.groupby(keys, sort=False):
        _, method, task, repetition = names
        costs = group[group["metric"].str.startswith("cost/")]
        good = costs[costs["status"] == "ok"].groupby("metric")["value"].mean()
        whole = costs[costs["metric"] == "cost/fit_seconds"].iloc[0]
        memory = good.get("cost/peak_memory", float("nan"))
        rows.append(
            {
                "method": method,
                "task": task.replace(":", " to "),
                "repetition": repetition,
                "status": whole["status"],
                "reason": whole["reason"],
                "fit": number(good.get("cost/fit_seconds")),
                "transfer": number(good.get("cost/transfer_seconds")),
                "memory": number(memory / 2**20),
            }
        )
    return rows


def _holes(run: RunView) -> list[dict[str, Any]]:
    rows = run.results
    # Cells without any result are listed above, each with its reason.
    rows = rows[~rows["metric"].str.startswith("cost/") & ~rows["cell_key"].isin(run.empty_cells)]
    totals = rows.groupby("metric").size()
    empty = rows[rows["status"] != "ok"]
    found = empty.groupby(["metric", "status", "reason"], sort=True).size().sort_values(ascending=False)
    return [
        {**{str(key): value for key, value in row.items()}, "total": int(totals[row["metric"]])}
        for row in found.reset_index(name="count").astype({"count": int}).to_dict("records")
    ]


def _data_facts(run: RunView) -> list[tuple[str, str]]:
    from benchmark.data.cards import load_card

    facts = []
    name = run.dataset.partition(":")[0]
    try:
        card = load_card(name)
    except BenchmarkError:
        card = None
    if card is not None:
        facts += [
            ("data set", f"{card.id}: {card.title}"),
            ("content", card.summary),
            ("licence", f"{card.licence.name}; redistribution: {card.licence.redistribution}"),
            ("cite", card.citation.text),
        ]
    rows = run.results
    clips = rows.loc[rows["clip_id"] != "", ["clip_id", "actor", "action", "seen_actor"]].drop_duplicates()
    seen = int(clips["seen_actor"].fillna(False).astype(bool).sum())
    split = str(rows["split"].iloc[0])
    facts += [
        ("split", f"{split}, digest {str(rows['split_digest'].iloc[0])[:12]} (split.json holds every clip)"),
        (
            "test clips",
            f"{len(clips)}: {seen} by actors seen in training, {len(clips) - seen} by others; "
            f"{clips['actor'].nunique()} actors, {clips['action'].nunique()} actions",
        ),
        ("data set digest", str(rows["dataset_digest"].iloc[0])),
    ]
    fits = run.fit_residuals()
    if fits:
        median = float(np.median([fit["median"] for fit in fits.values()]))
        worst = max(fits, key=lambda clip_id: fits[clip_id]["p95"])
        facts.append(
            (
                "rigid fit",
                f"the capture holds joint positions; rotations were fitted on rigid bones. Median distance of a joint to "
                f"its measured place: {1e3 * median:.0f} mm over {len(fits)} test clips; worst clip {worst}, "
                f"95th percentile {1e3 * fits[worst]['p95']:.0f} mm",
            )
        )
    return facts


def _machine_facts(run: RunView) -> list[tuple[str, str]]:
    environment = run.document("environment.json") or {}
    git = environment.get("git") or {}
    commit = str(git.get("commit", "unknown"))[:12] + (" with uncommitted changes" if git.get("dirty") else "")
    hardware = environment.get("hardware", {})
    return [
        ("made", str(environment.get("time", "unknown"))),
        ("code", commit),
        ("Python", str(environment.get("python", "unknown"))),
        ("libraries", ", ".join(f"{name} {version}" for name, version in environment.get("versions", {}).items())),
        ("machine", ", ".join(f"{name} {value}" for name, value in hardware.items())),
        ("threads a cell", str(environment.get("threads", "unknown"))),
    ]
