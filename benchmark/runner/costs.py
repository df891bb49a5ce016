"""What a run will cost, from what earlier cells did cost.

Every cell that a run executes leaves a line in a ledger in the cache: its method and settings, how many clips it had, and the
time, memory and disk that it took. An estimate for a cell looks for lines of the same method, best of the same settings, and
carries them over to its own number of clips by a power law. Nothing is guessed for a method that was never measured.
"""

from __future__ import annotations

import heapq
import json
import logging
import math
import os
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from itertools import combinations
from pathlib import Path
from statistics import median
from typing import Any

from benchmark.data.cache import atomic_path, cache_root, locked
from benchmark.runner.backends import Observer
from benchmark.runner.job import Unit
from benchmark.runner.probes import probe_store, probe_unit
from benchmark.runner.run import Prepared, shard_cells, to_execute
from benchmark.runner.store import CellStatus, RunStore

_log = logging.getLogger(__name__)

#: Lines that the ledger keeps, and that one run may add for one method with one setting.
KEPT, EACH = 4000, 20
#: The narrowest range that is stated, as a factor: other loads of the machine alone make so much.
LEAST = 1.3
#: How much wider a range is where only other settings of the method were measured, or another machine.
OTHER_SETTINGS, OTHER_MACHINE = 3.0, 2.0


@dataclass(frozen=True)
class Record:
    """What one cell cost.

    Attributes
    ----------
    method, params
        The method's registered name and the digest of its parameters.
    train, test
        Clips it could learn from, and clips it transferred.
    variants
        How many variants of each result were stored and scored.
    device, threads, processor
        Where it ran.
    fit_seconds, other_seconds
        Of fitting, and of all the rest: reading, transferring, scoring, storing.
    memory, disk
        Peak resident memory and size of the cell's folder, bytes; 0 where it was not measured.
    """

    method: str
    params: str
    train: int
    test: int
    variants: int
    device: str
    threads: int
    processor: str
    fit_seconds: float
    other_seconds: float
    memory: float
    disk: float


@dataclass(frozen=True)
class Guess:
    """A number with the range it is thought to lie in."""

    value: float
    low: float
    high: float

    @classmethod
    def of(cls, value: float, factor: float) -> Guess:
        """``value``, and a ``factor`` in either direction."""
        return cls(value, value / factor, value * factor)

    def __add__(self, other: Guess) -> Guess:
        return Guess(self.value + other.value, self.low + other.low, self.high + other.high)


NOTHING = Guess(0.0, 0.0, 0.0)


@dataclass(frozen=True)
class WorkEstimate:
    """Seconds, and bytes of memory and disk, of one work; ``basis`` says from how many measurements of what."""

    seconds: Guess
    memory: Guess
    disk: Guess
    basis: str


@dataclass(frozen=True)
class Estimate:
    """What a run will cost.

    Attributes
    ----------
    works
        By key, of what is to be run; ``None`` where its like was never measured.
    wall
        Seconds for ``jobs`` cells at a time; of the measured ones alone.
    memory
        Bytes of the ``jobs`` largest cells together.
    disk
        Bytes of all cells together.
    unknown
        How many of them there is no estimate for.
    """

    works: Mapping[str, WorkEstimate | None]
    jobs: int
    wall: Guess
    memory: Guess
    disk: Guess
    unknown: int


def ledger_path() -> Path:
    """Where the ledger is."""
    return cache_root() / "costs.jsonl"


def read_ledger() -> list[Record]:
    """Every line that can be read; a line that cannot be is as if it were not there."""
    try:
        lines = ledger_path().read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return []
    names = {field.name: field.type for field in fields(Record)}
    found = []
    for line in lines:
        try:
            entry = json.loads(line)
            if set(entry) == set(names) and all(
                isinstance(entry[name], str) if kind == "str" else math.isfinite(entry[name])
                for name, kind in names.items()
            ):
                found.append(Record(**entry))
        except (ValueError, TypeError):
            continue
    return found


def keep(records: Sequence[Record]) -> None:
    """Add lines to the ledger, few of each kind; the oldest give way."""
    seen: Counter[tuple[str, str, int, int]] = Counter()
    new = []
    for record in records:
        kind = record.method, record.params, record.train, record.test
        seen[kind] += 1
        if seen[kind] <= EACH:
            new.append(record)
    if not new:
        return
    path = ledger_path()
    try:
        with locked(path.with_suffix(".lock")):
            lines = [json.dumps(asdict(record), sort_keys=True) for record in [*read_ledger(), *new]]
            with atomic_path(path) as temporary:
                temporary.write_text("\n".join(lines[-KEPT:]) + "\n", encoding="utf-8")
    except OSError as error:
        _log.warning("what this run cost is not kept for estimates: cannot write %s (%s)", path, error)


class Meter:
    """An observer that passes on what it is told, and notes how long each cell took."""

    def __init__(self, inner: Observer) -> None:
        self._inner = inner
        self.seconds: dict[str, float] = {}

    def cell_started(self, cell: Unit) -> None:
        """Pass on."""
        self._inner.cell_started(cell)

    def cell_progress(self, cell: Unit, stage: str, fraction: float, message: str) -> None:
        """Pass on."""
        self._inner.cell_progress(cell, stage, fraction, message)

    def cell_finished(self, cell: Unit, state: str, reason: str, seconds: float) -> None:
        """Note, and pass on."""
        if state == "ok":
            self.seconds[cell.key] = seconds
        self._inner.cell_finished(cell, state, reason, seconds)


@dataclass(frozen=True)
class Work:
    """One thing to be run, by what its cost depends on; the names are those of :class:`Record`. Probes go ``first``."""

    key: str
    method: str
    params: str
    train: int
    test: int
    variants: int
    device: str
    threads: int
    first: bool = False


def pending(prepared: Prepared, states: Mapping[str, CellStatus]) -> list[Work]:
    """What a run will execute, in the order in which it does: the probes that are not there, then the cells."""
    config = prepared.config
    cells = [cell for cell in shard_cells(prepared.cells, config.shard) if to_execute(config, cell, states[cell.key])]
    of_task = {f"{split.source_style}:{split.target_style}": split for split in prepared.splits}
    store, works = probe_store(prepared.folder), []
    for choice in {metric.probe.name: metric.probe for metric in prepared.metrics if metric.probe is not None}.values():
        for cell in {cell.task: cell for cell in cells}.values():
            unit = probe_unit(choice, cell, seed=config.seed, threads=config.threads)
            if choice.error is None and store.status(unit.key).state not in ("ok", "skipped"):
                train = len(of_task[cell.task].train)
                works.append(
                    Work(unit.key, f"probe {choice.name}", "", train, 0, 0, unit.device, config.threads, first=True)
                )
    for cell in cells:
        split = of_task[cell.task]
        test = len(split.test) if config.limit is None else min(config.limit, len(split.test))
        works.append(
            Work(
                *(cell.key, cell.name, cell.params_digest, len(split.train), test),
                *(len(config.variants), cell.device, config.threads),
            )
        )
    return works


def measured(
    works: Iterable[Work], folder: Path, states: Mapping[str, CellStatus], seconds: Mapping[str, float], processor: str
) -> list[Record]:
    """The records of what took ``seconds`` to run in the run ``folder``."""
    records = []
    for work in works:
        if work.key not in seconds:
            continue
        fit, memory, disk = seconds[work.key], 0.0, 0.0
        if not work.first:
            costs = states[work.key].facts.get("costs", {})
            place = RunStore(folder).cell(work.key)
            fit, memory = float(costs.get("fit_seconds") or 0.0), float(costs.get("peak_memory") or 0.0)
            disk = float(sum(path.stat().st_size for path in place.rglob("*") if path.is_file()))
        records.append(
            Record(
                *(work.method, work.params, work.train, work.test, work.variants, work.device, work.threads, processor),
                *(fit, max(0.0, seconds[work.key] - fit), memory, disk),
            )
        )
    return records


def estimate(works: Sequence[Work], records: Sequence[Record], *, jobs: int, processor: str) -> Estimate:
    """What it will cost to run ``works``, ``jobs`` at a time.

    Parameters
    ----------
    works
        What will be run.
    records
        What is known.
    jobs
        Cells at a time.
    processor
        Of this machine; records of another count where there are no others.
    """
    by_method: dict[str, list[Record]] = {}
    for record in records:
        by_method.setdefault(record.method, []).append(record)
    known: dict[Work, WorkEstimate | None] = {}
    found: dict[str, WorkEstimate | None] = {}
    stages: dict[bool, list[WorkEstimate]] = {True: [], False: []}
    for work in works:
        kind = replace(work, key="")
        if kind not in known:
            known[kind] = _work_estimate(work, by_method.get(work.method, []), processor)
        one = found[work.key] = known[kind]
        if one is not None:
            stages[work.first].append(one)
    good = [*stages[True], *stages[False]]
    largest = sorted((one.memory for one in good), key=lambda memory: memory.value, reverse=True)[:jobs]
    # Probes are waited for before the cells begin.
    walls = [
        sum(_wall([getattr(one.seconds, part) for one in stage], jobs) for stage in stages.values())
        for part in ("value", "low", "high")
    ]
    return Estimate(
        found,
        jobs,
        Guess(*walls),
        sum(largest, NOTHING),
        sum((one.disk for one in good), NOTHING),
        len(found) - len(good),
    )


def _wall(seconds: Sequence[float], jobs: int) -> float:
    """When the last cell ends if each goes, in order, to the first process that is free."""
    free = [0.0] * min(jobs, len(seconds))
    for one in seconds:
        heapq.heapreplace(free, free[0] + one)
    return max(free, default=0.0)


def _work_estimate(work: Work, records: Sequence[Record], processor: str) -> WorkEstimate | None:
    """The best records there are, carried over to this size."""
    chosen = [record for record in records if record.device == work.device]
    if not chosen:
        return None
    factor, basis = 1.0, "the same settings"
    same = [record for record in chosen if record.params == work.params]
    if same:
        chosen = same
    else:
        factor, basis = OTHER_SETTINGS, "other settings"
    here = [record for record in chosen if record.processor == processor]
    if here:
        chosen = here
    else:
        factor, basis = factor * OTHER_MACHINE, f"{basis}, another machine"
    fit = power_law([(record.train, record.fit_seconds) for record in chosen], work.train)
    other = power_law([(record.test, record.other_seconds) for record in chosen], work.test)
    memory = power_law([(record.train, record.memory) for record in chosen], work.train, slope=0.0)
    disk = power_law([(record.test * record.variants, record.disk) for record in chosen], work.test * work.variants)
    return WorkEstimate(
        _wider(fit + other, factor),
        _wider(memory, factor),
        _wider(disk, factor),
        f"{len(chosen)} measurement{'s'[: len(chosen) != 1]} of {basis}",
    )


def _wider(guess: Guess, factor: float) -> Guess:
    return Guess(guess.value, guess.low / factor, guess.high * factor)


def power_law(points: Sequence[tuple[float, float]], x: float, *, slope: float = 1.0) -> Guess:
    """``y`` at ``x`` by a line through logarithms that few wild points do not move.

    The slope is the median of those of all pairs (Theil 1950; Sen 1968), kept between 0 and 2; where all points have one ``x``
    it is ``slope``. The range is 1.64 robust standard deviations of the points about the line, never less than :data:`LEAST`,
    and grows with the distance to the measured ``x``.

    Parameters
    ----------
    points
        Pairs of size and cost.
    x
        The size asked for.
    slope
        Where the points do not tell.
    """
    logs = [(math.log(max(a, 1.0)), math.log(b)) for a, b in points if b > 0]
    if not logs:
        return NOTHING
    slopes = [(d - b) / (c - a) for (a, b), (c, d) in combinations(logs[-60:], 2) if a != c]
    known = bool(slopes)
    steep = min(2.0, max(0.0, median(slopes))) if known else slope
    middle = median(b - steep * a for a, b in logs)
    at = math.log(max(x, 1.0))
    spread = 1.64 * 1.4826 * median(abs(b - steep * a - middle) for a, b in logs)
    away = max(0.0, min(a for a, _ in logs) - at, at - max(a for a, _ in logs))
    width = math.log(LEAST) + spread + away * (0.25 if known else 0.75)
    return Guess.of(math.exp(middle + steep * at), math.exp(width))


def error_line(before: Estimate, seconds: float) -> str:
    """The estimate held against what the run took, in one line."""
    guess = before.wall
    if not guess.value:
        return f"took {seconds:.0f} s; there was no estimate, the next one starts from this"
    inside = "inside" if guess.low <= seconds <= guess.high else "outside"
    error = guess.value / seconds - 1.0 if seconds else 0.0
    left = f"; {before.unknown} of {len(before.works)} had no estimate" if before.unknown else ""
    return (
        f"took {seconds:.0f} s, estimated {guess.value:.0f} s ({error:+.0%}), {inside} the range of {guess.low:.0f} to "
        f"{guess.high:.0f} s{left}"
    )


def document(before: Estimate, seconds: float) -> dict[str, Any]:
    """What is kept of an estimate and its error beside the run."""
    wall = before.wall
    return {
        "works": len(before.works),
        "unknown": before.unknown,
        "jobs": before.jobs,
        "estimated_seconds": wall.value,
        "low_seconds": wall.low,
        "high_seconds": wall.high,
        "seconds": seconds,
        "relative_error": wall.value / seconds - 1.0 if seconds and wall.value else None,
        "load_average": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
    }
