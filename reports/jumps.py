"""The jumps of a run: the source, the real performers trained on, and each method's result, with what is measured of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Literal
from weakref import WeakKeyDictionary

import numpy as np

from benchmark.api import NotApplicableError
from benchmark.config import read_config
from benchmark.data.catalog import open_dataset
from benchmark.data.splits import load_split
from benchmark.errors import BenchmarkError
from benchmark.motion.clip import MotionClip
from benchmark.runner.run import split_path
from eval.metrics.jump import (
    Jump,
    arm_swing,
    find_jump,
    landing_duration,
    lowest_knee_bend,
    names_a_jump,
    recovery_duration,
)
from reports.markdown import markdown_escape
from reports.run import RunView
from reports.tables import number

if TYPE_CHECKING:
    import pandas as pd

    from benchmark.data.base import Dataset
    from benchmark.data.splits import Split

Role = Literal["source", "trained on", "method", "not trained on"]

#: What the poster of Dong et al. 2018 compares, in the columns of the table, and in words.
CLAIMS: Mapping[str, str] = {
    "landing_knee_angle_deg": "lowest knee bend",
    "arm_swing_deg": "arm swing",
    "landing_duration_s": "landing duration",
}


@dataclass(frozen=True, eq=False)
class JumpRow:
    """One performance of a jump.

    Attributes
    ----------
    role
        The clip transferred, a real performer of the target style in or outside training, or a method's result for the clip.
    label
        As figures and tables name it.
    clip_id
        Of the real clip; of the clip transferred, for a result.
    clip
        The motion.
    """

    role: Role
    label: str
    clip_id: str
    clip: MotionClip

    @cached_property
    def jump(self) -> Jump | None:
        """Its phases, or ``None`` where no jump is seen."""
        return find_jump(self.clip)

    @cached_property
    def measures(self) -> dict[str, float]:
        """What is measured of it, by the table's columns; NaN where there is no value."""
        if self.jump is None:
            knee = swing = landing = recovery = float("nan")
        else:
            knee, swing = lowest_knee_bend(self.clip, self.jump), arm_swing(self.clip, self.jump)
            landing = landing_duration(self.clip, self.jump)
            try:
                recovery = recovery_duration(self.clip, self.jump)
            except NotApplicableError:
                recovery = float("nan")
        return {
            "landing_knee_angle_deg": knee,
            "landing_knee_flexion_deg": 180.0 - knee,
            "arm_swing_deg": swing,
            "landing_duration_s": landing,
            "recovery_duration_s": recovery,
        }


@dataclass(frozen=True, eq=False)
class JumpCase:
    """One transferred clip of a jump and all that it is compared with.

    Attributes
    ----------
    clip_id, action
        Of the clip transferred.
    rows
        The source, real performers in training, the methods in the run's order, and real performers outside training.
    problem
        Why real clips are missing, or ``""``.
    """

    clip_id: str
    action: str
    rows: tuple[JumpRow, ...]
    problem: str = ""

    def of(self, role: Role) -> list[JumpRow]:
        """The rows of one role."""
        return [row for row in self.rows if row.role == role]

    @cached_property
    def aim(self) -> dict[str, float]:
        """Median of each measure over the real performers in training; NaN where there is none with a value."""
        rows = [row.measures for row in self.of("trained on") if row.jump is not None]
        return {claim: float(np.median([row[claim] for row in rows])) if rows else float("nan") for claim in CLAIMS}

    def nearer(self, row: JumpRow) -> dict[str, bool | None]:
        """For each claim, whether ``row`` is nearer than the source to the performers trained on; ``None`` if unknown."""
        source = self.of("source")
        verdict: dict[str, bool | None] = {}
        for claim, aim in self.aim.items():
            before = abs(source[0].measures[claim] - aim) if source else float("nan")
            after = abs(row.measures[claim] - aim)
            verdict[claim] = bool(after < before) if np.isfinite(before) and np.isfinite(after) else None
        return verdict

    def towards(self, row: JumpRow) -> dict[str, bool | None]:
        """For each claim, whether ``row`` differs from the source in the sense in which those trained on do, however far."""
        source = self.of("source")
        verdict: dict[str, bool | None] = {}
        for claim, aim in self.aim.items():
            before = source[0].measures[claim] if source else float("nan")
            moved = (row.measures[claim] - before) * (aim - before)
            verdict[claim] = bool(moved > 0.0) if np.isfinite(moved) else None
        return verdict


def jump_cases(run: RunView, task: str) -> list[JumpCase]:
    """The transferred clips whose action's name says that it is a jump, sorted; none for a run without jumps.

    The clips compared with are read from the data set that the run's settings name. Where it cannot be opened, or is not the
    one that was used, the methods' stored results are all there is, and :attr:`JumpCase.problem` says why. Two figures and a
    table ask for them; they are found once for a run.
    """
    known = _found.setdefault(run, {})
    if task not in known:
        known[task] = _find_cases(run, task)
    return known[task]


_found: WeakKeyDictionary[RunView, dict[str, list[JumpCase]]] = WeakKeyDictionary()


def _find_cases(run: RunView, task: str) -> list[JumpCase]:
    cells = run.cells(task)
    actions = {
        item["clip_id"]: item["action"]
        for cell in cells
        for item in cell.items
        if item["state"] == "ok" and names_a_jump(item["action"])
    }
    if not actions:
        return []
    problem, data = "", None
    try:
        data = _open(run, task)
    except BenchmarkError as error:
        problem = str(error)
    cases = []
    for clip_id, action in sorted(actions.items()):
        results = [
            JumpRow("method", run.label(method), clip_id, clip) for method, clip in run.renderings(task, clip_id)
        ]
        before: list[JumpRow] = []
        after: list[JumpRow] = []
        if data is not None:
            try:
                before, after = _real(*data, clip_id, action)
            except BenchmarkError as error:
                problem = str(error)
        cases.append(JumpCase(clip_id, action, (*before, *results, *after), problem))
    return cases


def _open(run: RunView, task: str) -> tuple[Dataset, Split]:
    config = read_config(run.folder / "config.toml")
    dataset = open_dataset(config.dataset.name, root=config.dataset.root, **config.dataset.options)
    return dataset, load_split(split_path(run.folder, config.tasks, task), dataset)


def _real(dataset: Dataset, split: Split, clip_id: str, action: str) -> tuple[list[JumpRow], list[JumpRow]]:
    """The source and the target performers trained on, and the target performers not trained on."""

    def row(role: Role, name: str) -> JumpRow:
        record = dataset.record(name)
        return JumpRow(role, " ".join(filter(None, (record.style, record.actor))), name, dataset.load(name))

    def fits(name: str) -> bool:
        record = dataset.record(name)
        return record.style == split.target_style and record.action == action

    trained = [row("trained on", name) for name in split.train if fits(name)]
    others = [row("not trained on", name) for name in split.references if fits(name)]
    return [row("source", clip_id), *trained], others


def jump_table(cases: list[JumpCase]) -> pd.DataFrame:
    """One row for each performance of each case.

    Columns ``clip_id, role, row``, the measures, and for each of :data:`CLAIMS` two columns that hold ``yes``, ``no``, or
    nothing where that cannot be said: ``nearer_…``, whether the row is nearer than the source to the performers trained on,
    and ``towards_…``, whether it differs from the source in the same sense as they do. What goes too far does only the latter.
    """
    import pandas as pd

    table: list[dict[str, object]] = []
    for case in cases:
        for row in case.rows:
            judged = _judged(row)
            told = {
                f"{name}_{claim.rpartition('_')[0]}": _word(value)
                for name, verdict in (("nearer", case.nearer), ("towards", case.towards))
                for claim, value in (verdict(row) if judged else dict.fromkeys(CLAIMS)).items()
            }
            table.append({"clip_id": case.clip_id, "role": row.role, "row": _name(row), **row.measures, **told})
    return pd.DataFrame(table)


def _judged(row: JumpRow) -> bool:
    """Whether it is asked of a row if it is nearer: not of the source and those trained on themselves."""
    return row.role in ("method", "not trained on")


def _name(row: JumpRow) -> str:
    return row.label if row.role == "method" else row.clip_id


def _word(value: bool | None) -> str:
    return "" if value is None else "yes" if value else "no"


def markdown_jumps(cases: list[JumpCase]) -> str:
    """The table of :func:`jump_table` in Markdown; ``+``: nearer to the performers trained on than the source, ``-``: not."""
    lines = [
        "| transferred | performance | role | lowest knee angle, deg | arm swing, deg | landing, s | recovery, s | nearer on |",
        "| --- | --- | --- | ---: | ---: | ---: | ---: | --- |",
    ]
    for case in cases:
        for row in case.rows:
            verdict: dict[str, bool | None] = case.nearer(row) if _judged(row) else dict.fromkeys(CLAIMS)
            marks = {claim: {True: " +", False: " -", None: ""}[value] for claim, value in verdict.items()}
            told = [value for value in verdict.values() if value is not None]
            values = [f"{number(row.measures[claim])}{marks[claim]}" for claim in CLAIMS]
            score = f"{sum(told)} of {len(told)}" if told else ""
            cells = [
                markdown_escape(case.clip_id),
                markdown_escape(_name(row)),
                row.role,
                *values,
                number(row.measures["recovery_duration_s"]),
                score,
            ]
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def write_jump_tables(run: RunView) -> list[Path]:
    """Write ``tables/jump-landing-TASK.{csv,md}`` for each task with jumps; return their paths."""
    written = []
    for task in run.tasks:
        cases = jump_cases(run, task)
        if not cases:
            continue
        folder = run.folder / "tables"
        folder.mkdir(exist_ok=True)
        csv, markdown = (folder / f"jump-landing-{task.replace(':', '-to-')}.{kind}" for kind in ("csv", "md"))
        jump_table(cases).to_csv(csv, index=False)
        markdown.write_text(markdown_jumps(cases), encoding="utf-8")
        written += [csv, markdown]
    return written
