"""Cells of other run folders taken into one: parts of a run that were computed on machines without a common disk."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmark.errors import StoreError
from benchmark.runner.probes import probe_store
from benchmark.runner.run import IDENTITY, identity, read_run
from benchmark.runner.store import RunStore


@dataclass(frozen=True)
class Merged:
    """How many cells were taken, were there already, and were left because they are missing, damaged or failed."""

    taken: int
    kept: int
    left: int


def merge(folder: Path, others: Sequence[Path]) -> Merged:
    """Copy into a run the finished cells of its plan that it lacks, each compared with its digests.

    Parameters
    ----------
    folder
        The run.
    others
        Run folders of the same data set, tasks and split; they stay as they are.

    Raises
    ------
    StoreError
        If a folder is no run, is in use, or is a run of something else.
    """
    config, cells = read_run(folder)
    for other in others:
        settings, _ = read_run(other)
        for name, ours, theirs in zip(IDENTITY, identity(config), identity(settings), strict=True):
            if ours != theirs:
                raise StoreError(
                    f"{other} is a run with {name} {theirs}, and {folder} one with {ours}: they do not go together"
                )
    store = RunStore(folder)
    taken = kept = 0
    with store.lock():
        store.sweep()
        for cell in cells:
            if store.status(cell.key).state in ("ok", "skipped"):
                kept += 1
            elif any(_take(store, RunStore(other), cell.key) for other in others):
                taken += 1
        for other in others:
            probes = probe_store(other)
            for path in sorted(probes.cells.glob("[0-9a-f]*")):
                if probe_store(folder).status(path.name).state not in ("ok", "skipped"):
                    _take(probe_store(folder), probes, path.name)
    return Merged(taken, kept, sum(cell.fate == "run" for cell in cells) - taken - kept)


def _take(store: RunStore, other: RunStore, key: str) -> bool:
    """Copy one cell if the other run has it whole."""
    if other.status(key).state not in ("ok", "skipped"):
        return False
    with store.writing(key) as temporary:
        shutil.copytree(other.cell(key), temporary / "cells" / key)
        try:
            store.adopt(key, temporary / "cells" / key)
        except StoreError:
            return False
    return True
