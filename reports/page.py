"""``report/index.html``: one self-contained page that opens from disk without a network."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from reports.drawing import SavedDrawing
from reports.html import boards, facts, motion, outcome, pictures, statistics
from reports.html.parts import Parts
from reports.html.safety import inline_json, policy
from reports.run import FLOOR, RunView

if TYPE_CHECKING:
    from markupsafe import Markup

#: A page is made without pictures before it gets larger than this, in bytes.
LARGEST = 25_000_000

_SCRIPTS = ("page.js", "viewer.js")
_STYLES = ("page.css",)


def write_page(
    run: RunView,
    drawings: Sequence[SavedDrawing],
    *,
    failures: Sequence[tuple[str, str]] = (),
    moving: bool = True,
) -> Path:
    """Write the page into ``run.folder/report`` and return its path.

    A part that cannot be made is named on the page with the reason, and the others stand.

    Parameters
    ----------
    run
        The finished run.
    drawings
        Its figures.
    failures
        What could not be made before, as (what, reason).
    moving
        Whether the page holds moving pictures: joint positions of the clips, which some data sets' licences let nobody pass on.

    """
    content = _content(run, drawings, failures)
    page = ""
    # Figures and moving pictures keep to their budgets; only the tables of very many tasks leave too little room for them.
    for share in (1.0, 0.5, 0.25, 0.0):
        page = _render(run, drawings, content, share if moving else None, figures=share > 0.0)
        if len(page.encode()) <= LARGEST:
            break
    path = run.folder / "report" / "index.html"
    path.parent.mkdir(exist_ok=True)
    path.write_text(page, encoding="utf-8", newline="\n")
    return path


@dataclass(frozen=True)
class _Content:
    """Everything but pictures."""

    values: dict[str, Any]
    failures: tuple[tuple[str, str], ...]


def _content(run: RunView, drawings: Sequence[SavedDrawing], failures: Sequence[tuple[str, str]]) -> _Content:
    parts = Parts(list(failures))
    tables: list[dict[str, Any]] = []
    for task in run.tasks:
        tables += parts.make(f"the leaderboard of {task}", partial(boards.task_boards, run, task), [])
    cells = parts.make("the list of cells", lambda: outcome.cells(run), [])
    holes = parts.make("the list of metrics without a value", lambda: outcome.holes(run), [])
    bibtex, traps = parts.make("the data set's notes", lambda: facts.card_notes(run), ("", ()))
    values = {
        "title": f"Motion style benchmark: {run.dataset_title}",
        "subtitle": f"{', '.join(task.replace(':', ' to ') for task in run.tasks)}; run {run.folder.name}",
        "warnings": parts.make(
            "the warnings",
            lambda: facts.warnings(run, _limit(run)),
            facts.Warnings(False, "", "The card cannot be read."),
        ),
        "boards": tables,
        "groups": boards.group_names(tables),
        "variants": list(dict.fromkeys(board["variant"] for board in tables)),
        "tasks": run.tasks,
        "floor": FLOOR if any(FLOOR in run.methods(task) for task in run.tasks) else "",
        "real": run.label(run.real_method) if any(run.real_method in run.methods(task) for task in run.tasks) else "",
        "meanings": parts.make("what metrics mean", lambda: boards.meanings(run, run.tasks), {}),
        "comparison": parts.make("the comparison of methods", lambda: statistics.comparison(run), []),
        "ratings": parts.make("the ratings", lambda: statistics.ratings(run), []),
        "claims": parts.make("the claims", lambda: statistics.claims(run), None),
        "cells": cells,
        "holes": holes,
        "alarms": parts.make("the list of failures", lambda: outcome.alarms(cells, holes), []),
        "card_facts": parts.make("the data set's card", lambda: facts.card_facts(run), []),
        "bibtex": bibtex,
        "traps": traps,
        "splits": parts.make("the split", lambda: facts.splits(run), []),
        "methods": parts.make("the list of methods", lambda: facts.methods(run), []),
        "machine_facts": parts.make("the facts of the machine", lambda: facts.machine_facts(run), []),
        "commands": parts.make("how to run it again", lambda: facts.commands(run), []),
        "config": parts.make("the settings", lambda: _config(run), ""),
    }
    return _Content(values, tuple(parts.failures))


def _render(
    run: RunView, drawings: Sequence[SavedDrawing], content: _Content, share: float | None, *, figures: bool
) -> str:
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup

    parts = Parts(list(content.failures))
    room = pictures.BUDGET if figures else 0
    gallery = parts.make("the figures", lambda: pictures.gallery(drawings, room), pictures.Gallery({}, []))
    reel = motion.Reel()
    if share is not None:
        reel = parts.make(
            "the moving pictures", lambda: motion.make_reel(run, int(share * motion.BUDGET)), motion.Reel()
        )
    folder = resources.files("reports") / "templates"
    # A script or style sheet works only if its text is, byte for byte, the one that the policy was made of.
    scripts = ["\n" + (folder / name).read_text(encoding="utf-8") for name in _SCRIPTS]
    styles = ["\n" + (folder / name).read_text(encoding="utf-8") for name in _STYLES]
    environment = Environment(
        loader=PackageLoader("reports", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["breakable"] = _breakable
    return environment.get_template("report.html.j2").render(
        **content.values,
        policy=policy(scripts=scripts, styles=styles),
        scripts=[Markup(text) for text in scripts],
        styles=[Markup(text) for text in styles],
        gallery=gallery,
        moving=share is not None,
        reel_notes=reel.notes,
        reel_index=Markup(inline_json(reel.index)) if reel.clips else "",
        reel_clips=[Markup(inline_json(clip)) for clip in reel.clips],
        reel_titles=_titles(reel),
        broken=parts.failures,
    )


def _breakable(name: str) -> Markup:
    """A name of a method that may break before its variant: ``dynamic-scaling[both]``."""
    from markupsafe import Markup, escape

    return Markup("<wbr>[").join(escape(part) for part in name.split("["))


def _titles(reel: motion.Reel) -> dict[str, list[tuple[int, str]]]:
    """Number and title of each clip by task, as the page's list of clips shows them."""
    found: dict[str, list[tuple[int, str]]] = {}
    for number, clip in enumerate(reel.clips):
        found.setdefault(clip["task"], []).append((number, clip["title"]))
    return found


def _config(run: RunView) -> str:
    path = run.folder / "config.toml"
    return path.read_text(encoding="utf-8") if path.is_file() else ""


def _limit(run: RunView) -> int | None:
    limit = tomllib.loads(_config(run)).get("limit")
    return int(limit) if limit else None
