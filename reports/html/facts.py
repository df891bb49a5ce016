"""What was run, on what and how: data set card, split, settings, machine, and the commands that do it again."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.data.cards import Card, load_card
from benchmark.errors import UnknownNameError
from reports.run import RunView
from reports.tables import number

Facts = list[tuple[str, str]]


def card_of(run: RunView) -> Card | None:
    """The card of the run's data set, or ``None`` where the suite has none."""
    try:
        return load_card(run.dataset.partition(":")[0])
    except UnknownNameError:
        return None


@dataclass(frozen=True)
class Warnings:
    """What a reader has to know before anything else; empty where it does not apply."""

    synthetic: bool
    limited: str
    redistribution: str
    never: bool = False


def warnings(run: RunView, limit: int | None) -> Warnings:
    """The warnings of a run of which ``limit`` clips were transferred (``None`` for all)."""
    card = card_of(run)
    quick = f"Only {limit} test clips were transferred (limit = {limit}): a quick look, not a result." if limit else ""
    if card is None:
        return Warnings(False, quick, "No card says whether these recordings may be passed on.")
    if card.licence.redistribution.startswith("free"):
        return Warnings(run.dataset == "synthetic", quick, "")
    return Warnings(
        run.dataset == "synthetic",
        quick,
        f"Licence: {card.licence.name}. Redistribution: {card.licence.redistribution}.",
        card.licence.redistribution.startswith("never"),
    )


def card_facts(run: RunView) -> Facts:
    """The data set's card: title, content, licence, citation, traps."""
    card = card_of(run)
    if card is None:
        return [("data set", run.dataset), ("licence", "unknown: the suite has no card of this set")]
    commercial = {True: "allowed", False: "not allowed", None: "nobody says"}[card.licence.commercial]
    facts = [
        ("data set", run.dataset if card.id == "folder" else f"{card.id}, version {card.version}: {card.title}"),
        ("content", card.summary),
        ("capture", card.capture),
        ("licence", f"{card.licence.name}{f' ({card.licence.url})' if card.licence.url else ''}"),
        ("redistribution", card.licence.redistribution),
        ("commercial use", commercial if run.dataset != "synthetic" else ""),
        ("licence notes", card.licence.notes),
        ("cite", card.citation.text),
        ("source", f"{card.source.repository}, commit {card.source.commit}" if card.source else ""),
        ("how to get it", card.how_to_get),
        ("digest", str(run.results["dataset_digest"].iloc[0])),
        *_rigid_fit(run),
    ]
    return [(name, text) for name, text in facts if text]


def card_notes(run: RunView) -> tuple[str, tuple[str, ...]]:
    """BibTeX of the data set, and what a reader of the data must know."""
    card = card_of(run)
    return ("", ()) if card is None else (card.citation.bibtex.strip(), card.traps)


def _rigid_fit(run: RunView) -> Facts:
    fits = run.fit_residuals()
    if not fits:
        return []
    median = float(np.median([fit["median"] for fit in fits.values()]))
    worst = max(fits, key=lambda clip_id: fits[clip_id]["p95"])
    return [
        (
            "rigid fit",
            f"the capture holds joint positions; rotations were fitted on rigid bones. Median distance of a joint to "
            f"its measured place: {1e3 * median:.0f} mm over {len(fits)} test clips; worst clip {worst}, "
            f"95th percentile {1e3 * fits[worst]['p95']:.0f} mm",
        )
    ]


def splits(run: RunView) -> list[dict[str, Any]]:
    """The split of each task: its protocol, and the performers of each part with how many clips each has."""
    found = []
    for task in run.tasks:
        rows = run.results[run.results["task"] == task]
        document = run.document("split.json" if len(run.tasks) == 1 else f"split-{task.replace(':', '-')}.json")
        facts = [("protocol", str(rows["split"].iloc[0])), ("digest", str(rows["split_digest"].iloc[0]))]
        parts = []
        if document is not None:
            parameters = ", ".join(f"{key} = {value}" for key, value in sorted(document["parameters"].items()))
            facts[:1] = [("protocol", f"{document['protocol']}{f' ({parameters})' if parameters else ''}")]
            facts[1:1] = [("fold, seed", f"{document['fold']}, {document['seed']}")]
            test = document["test"]
            parts = [
                _part("training", document["train"]),
                _part("test, performers seen in training", [i["clip_id"] for i in test if i["seen_actor"]]),
                _part("test, performers not seen", [i["clip_id"] for i in test if not i["seen_actor"]]),
                _part("real target clips, only ever compared with", document["references"]),
            ]
        clips = rows.loc[rows["clip_id"] != "", ["clip_id", "actor", "action", "seen_actor"]].drop_duplicates()
        seen = int(clips["seen_actor"].fillna(False).astype(bool).sum())
        facts.append(
            (
                "transferred",
                f"{len(clips)} clips: {seen} by actors seen in training, {len(clips) - seen} by others; "
                f"{clips['actor'].nunique()} actors, {clips['action'].nunique()} actions",
            )
        )
        found.append({"task": task.replace(":", " to "), "facts": facts, "parts": [p for p in parts if p["clips"]]})
    return found


def _part(name: str, clip_ids: Iterable[str]) -> dict[str, Any]:
    """The performers of a part: ``style/actor/take`` is how ids are made; one without an actor counts as unnamed."""
    performers: dict[str, Counter[str]] = {}
    for clip_id in clip_ids:
        style, *rest = clip_id.split("/")
        performers.setdefault(style, Counter())[rest[0] if len(rest) > 1 else "unnamed"] += 1
    return {
        "name": name,
        "clips": sum(sum(counts.values()) for counts in performers.values()),
        "styles": [
            {"style": style, "actors": ", ".join(f"{actor} ({count})" for actor, count in counts.items())}
            for style, counts in performers.items()
        ],
    }


def methods(run: RunView) -> list[dict[str, str]]:
    """Every row of the plan: method, version, parameters and what it is."""
    from benchmark.registry import METHODS
    from benchmark.runner.plan import read_plan

    plan = run.document("plan.json")
    found: dict[str, dict[str, str]] = {}
    for cell in read_plan(plan) if plan else ():
        summary = METHODS.describe(cell.name).summary if cell.name in METHODS else "not installed here"
        parameters = ", ".join(f"{name} = {value}" for name, value in sorted(cell.params.items()))
        found.setdefault(
            cell.method,
            {
                "method": cell.method,
                "version": str(cell.method_version),
                "summary": summary,
                "parameters": parameters or "none",
            },
        )
    return list(found.values())


def machine_facts(run: RunView) -> Facts:
    """When, with which code and on which machine."""
    environment = run.document("environment.json") or {}
    hardware = dict(environment.get("hardware", {}))
    memory = hardware.pop("memory_bytes", None)
    machine = [f"{name} {value}" for name, value in hardware.items()]
    if memory:
        machine.append(f"{number(memory / 2**30)} GiB memory")
    return [
        ("made", str(environment.get("time", "unknown"))),
        ("code", _commit(environment)),
        ("Python", f"{environment.get('python', 'unknown')} on {environment.get('platform', 'an unknown platform')}"),
        ("libraries", ", ".join(f"{name} {version}" for name, version in environment.get("versions", {}).items())),
        ("machine", ", ".join(machine)),
        ("GPU", str(environment.get("gpu") or "none")),
        ("threads a cell", str(environment.get("threads", "unknown"))),
    ]


def _commit(environment: dict[str, Any]) -> str:
    git = environment.get("git") or {}
    return str(git.get("commit", "unknown")) + (" with uncommitted changes" if git.get("dirty") else "")


def commands(run: RunView) -> list[tuple[str, str]]:
    """What to type to make the run again, and the parts of it: a purpose and a command each."""
    environment = run.document("environment.json") or {}
    git = environment.get("git") or {}
    given = [str(word) for word in environment.get("command", [])[1:]]
    folder = shlex.quote(str(run.folder))
    found = []
    if git.get("commit"):
        found.append(("the same code", f"git checkout {shlex.quote(str(git['commit']))}"))
    if given:
        found.append(("the command as it was given", shlex.join(["python", "-m", "benchmark", *given])))
    config = shlex.quote(str(Path(run.folder) / "config.toml"))
    found += [
        ("the same settings, all of them written out", f"python -m benchmark run --config {config}"),
        ("this page again", f"python -m benchmark report {folder}"),
    ]
    return found
