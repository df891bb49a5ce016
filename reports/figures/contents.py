"""Contents by styles by methods: several sources as several methods render them, as in tables 2 and 3 of the 2021 paper."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from benchmark.api import NotApplicableError
from reports.drawing import Drawing
from reports.figures.families import families, representatives
from reports.figures.moments import PAPER_FPS, Row
from reports.figures.strips import poses_table, strip, strip_rows
from reports.run import FLOOR, RunView

if TYPE_CHECKING:
    import pandas as pd

#: Source clips side by side, poses of each, and paper frames between them; rows on a page.
_CONTENTS, _POSES, _STEP, _ROWS = 3, 4, 10, 11
#: Target styles below one another.
_BLOCKS = 3


def compared(run: RunView, task: str, count: int) -> list[str]:
    """The methods to set side by side, at most ``count``.

    The trained variants of one method, where there are several (with and without constraints, as in the paper); else the
    methods that train; else all but the floor and real performers.
    """
    trained = list(dict.fromkeys(cell.method for cell in run.cells(task) if (cell.folder / "train.parquet").is_file()))
    for members in families(trained).values():
        if len(members) > 1:
            return members[:count]
    others = [method for method in representatives(run.methods(task)) if method not in (FLOOR, run.real_method)]
    chosen = trained if len(trained) > 1 else others
    return representatives(chosen)[-count:]


def contents(run: RunView, tasks: Sequence[str], count: int = _CONTENTS) -> list[str]:
    """Source clips of different actions that all the tasks have results for; of those, the ones that move most."""
    common = set.intersection(*({name for cell in run.cells(task) for name in cell.results} for task in tasks))
    return run.showpieces(tasks[0], count, among=common)


def groups(run: RunView, tasks: Sequence[str]) -> list[list[str]]:
    """The tasks of one source style by figures, at most :data:`_BLOCKS` each: those tested on the same contents.

    Tasks with splits of their own may be tested on different clips, which cannot stand in the same columns.
    """
    found: list[list[str]] = []
    for task in tasks:
        for group in found:
            own = len(contents(run, group[:1]))
            if len(group) < _BLOCKS and own and len(contents(run, [*group, task])) == own:
                group.append(task)
                break
        else:
            found.append([task])
    return found


def comparison_strips(run: RunView) -> list[Drawing]:
    """A figure for each source style: contents side by side, and below them each target style with its methods."""
    sources: dict[str, list[str]] = {}
    for task in run.tasks:
        if run.cells(task):
            sources.setdefault(task.partition(":")[0], []).append(task)
    drawings = []
    for source, tasks in sources.items():
        parted = groups(run, tasks)
        for group in parted:
            most = max(2, (_ROWS - 1) // len(group) - 1)
            drawing = _compare(run, source, group, most, len(parted) > 1)
            if drawing is not None:
                drawings.append(drawing)
    if not drawings:
        raise NotApplicableError("no method has a result for any clip")
    return drawings


def _compare(run: RunView, source: str, tasks: list[str], most: int, many: bool) -> Drawing | None:
    chosen = contents(run, tasks)
    if not chosen:
        return None
    methods = {task: compared(run, task, most) for task in tasks}
    columns: list[list[Row | None]] = []
    for clip_id in chosen:
        column: list[Row | None] = []
        for task in tasks:
            rows = strip_rows(run, task, clip_id, methods[task], step=_STEP, poses=_POSES)
            found = {row.label: row for row in rows[1:]}
            target = task.partition(":")[2]
            if not column:
                column.append(_renamed(rows[0], f"content:\n{source}"))
            real = found.get(_label(run, run.real_method))
            column.append(None if real is None else _renamed(real, f"style:\n{target}"))
            column += [found.get(_label(run, method)) for method in methods[task]]
        columns.append(column)
    keep = [index for index in range(len(columns[0])) if any(column[index] is not None for column in columns)]
    if len(keep) < 2:
        return None
    starts = [1 + sum(1 + len(methods[task]) for task in tasks[:rank]) for rank in range(len(tasks))]
    ends = [*starts[1:], len(columns[0])]
    targets = [
        task.partition(":")[2]
        for task, start, end in zip(tasks, starts, ends, strict=True)
        if any(index in keep for index in range(start, end))
    ]
    shown = any(column[start] is not None for column in columns for start in starts)
    # A block begins with its first row that is drawn.
    rules = {next((keep.index(i) for i in range(start, len(columns[0])) if i in keep), 0) for start in starts} - {0}
    columns = [[column[index] for index in keep] for column in columns]
    actions = [run.clip_facts(clip_id)["action"].replace("-", " ") for clip_id in chosen]
    suffix = f"-to-{tasks[0].partition(':')[2]}" if many or len(run.tasks) == 1 else ""
    return Drawing(
        name=f"comparison-strip-{source}{suffix}",
        figure=strip(columns, heads=actions, rules=rules),
        caption=(
            f"{run.dataset_title}: n = {len(chosen)} contents ({', '.join(chosen)}) as methods render them in "
            f"{', '.join(targets)} style; raw results, first repetition. The first row is the input"
            + ("; a row named after a style is a real performer of it at the same action" if shown else "")
            + f". {_POSES} poses, {_STEP} frames at {PAPER_FPS:g} frames a second ({_STEP / PAPER_FPS:.2f} s) apart in "
            "the input, where it moves most; rows below show the same phase, other performances the stretch most like the "
            "input. All bodies are to one scale; left limbs are blue, right ones orange."
        ),
        data=_table(columns, chosen),
    )


def _table(columns: list[list[Row | None]], chosen: list[str]) -> pd.DataFrame:
    import pandas as pd

    parts = []
    for clip_id, column in zip(chosen, columns, strict=True):
        part = poses_table([row for row in column if row is not None])
        part.insert(0, "clip_id", clip_id)
        parts.append(part)
    return pd.concat(parts, ignore_index=True)


def _label(run: RunView, method: str) -> str:
    return run.label(method).replace("[", "\n[")


def _renamed(row: Row, label: str) -> Row:
    return Row(label, row.clip, row.times, row.how)
