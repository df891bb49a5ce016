"""Side by side from a finished run: the input, every method's result, and a real performer."""

from __future__ import annotations

from collections.abc import Sequence
from difflib import get_close_matches
from fnmatch import fnmatchcase

from benchmark.data.cards import card_ids, load_card
from benchmark.errors import ConfigError, UnknownNameError
from reports.run import FLOOR, RunView
from reports.video.scene import Panel

#: Clips named in an error at most.
_NAMED = 6


def credit(dataset: str) -> str:
    """The line that names a data set and its licence, for the picture's footer; ``dataset`` is its id in a run."""
    name = dataset.partition(":")[0]
    if name not in card_ids():
        return dataset
    card = load_card(name)
    title = "Own recordings" if name == "folder" else card.title
    return f"{title} \u00b7 licence: {card.licence.name}"


def clip_ids(run: RunView, task: str) -> list[str]:
    """The source clips of a task that any method has a result for, sorted."""
    cells = run.cells(task)
    return sorted({item["clip_id"] for cell in cells for item in cell.items if item["state"] == "ok"})


def find_clip(known: Sequence[str], name: str) -> str:
    """The clip of that id, or the only one whose id holds ``name``.

    Raises
    ------
    ConfigError
        Naming those that could be meant.
    """
    if name in known:
        return name
    holding = [clip_id for clip_id in known if name in clip_id]
    if len(holding) == 1:
        return holding[0]
    if holding:
        named = ", ".join(holding[:_NAMED]) + (" \u2026" if len(holding) > _NAMED else "")
        raise ConfigError(f"{len(holding)} clips of the run have {name!r} in their name: {named}")
    # An id without its style and actor is what is remembered, so that is what is compared, too.
    short = {clip_id.rsplit("/", 1)[-1]: clip_id for clip_id in reversed(known)}
    close = get_close_matches(name, known, n=3) + [
        short[found] for found in get_close_matches(name, short, n=3, cutoff=0.4)
    ]
    named = ", ".join(dict.fromkeys(close or known[:_NAMED]))
    word = "did you mean" if close else f"the first of {len(known)}:"
    raise ConfigError(f"the run has no clip {name!r}; {word} {named}{'?' if close else ''}")


def run_panels(
    run: RunView, task: str, clip_id: str, *, methods: Sequence[str] = (), variant: str = "raw"
) -> list[Panel]:
    """One panel for each method's result for a source clip, the input first and a real performer last.

    Parameters
    ----------
    run, task
        The run and one of its tasks, ``source:target``.
    clip_id
        A source clip.
    methods
        Names or patterns of the methods to show between input and real performer; all if empty.
    variant
        ``"raw"``, or ``"cleaned"`` for results with their feet locked.

    Raises
    ------
    UnknownNameError
        If a pattern fits no method of the run.
    ConfigError
        If nothing was made of the clip.
    """
    there = run.methods(task)
    always = (FLOOR, run.real_method)
    shown = set()
    for pattern in methods or ["*"]:
        # A bracket is part of a method's name.
        fitting = [name for name in there if name == pattern or fnmatchcase(name, pattern.replace("[", "[[]"))]
        if not fitting:
            raise UnknownNameError("method of this run", pattern, there)
        shown.update(fitting)
    source = task.partition(":")[0]
    panels, seen = [], set()
    for cell in run.cells(task):
        clip = cell.clip(clip_id, variant) if cell.method in (*shown, *always) and cell.method not in seen else None
        if clip is not None:
            seen.add(cell.method)
            title = f"{source} input" if cell.method == FLOOR else run.label(cell.method)
            panels.append(Panel(clip, title))
    if not panels:
        raise ConfigError(f"the run {run.folder} has no {variant} result for the clip {clip_id}")
    return panels
