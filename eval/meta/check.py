"""Every metric on every grade of a corruption: the numbers from which :mod:`eval.meta.ordering` judges."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any
from zlib import crc32

import numpy as np

from benchmark.api import Metric, NotApplicableError, Sample
from benchmark.motion.clip import MotionClip
from eval.meta.cases import Case
from eval.meta.corruptions import Corruption

#: Name under which the uncorrupted performances are evaluated, once for all corruptions.
CLEAN = "none"

#: Into how many groups the clips are dealt for the delete-a-group jackknife of metrics of a set.
GROUPS = 5

#: Metric that needs a translation there and back.
_ROUND_TRIP = "content/round-trip-error"

Report = Callable[[float, str], None]


@dataclass(frozen=True)
class Value:
    """One number.

    Attributes
    ----------
    corruption, grade
        What was done to the clips; grade 0 of every corruption is stored once, under :data:`CLEAN`.
    metric
        Its name.
    unit_of_observation
        A case's name for metrics of a clip; for those of a set ``"set"``, or ``"without K"``: the K-th group of clips left out.
    value
        NaN where the metric has no value.
    """

    corruption: str
    grade: int
    metric: str
    unit_of_observation: str
    value: float


def evaluate(
    cases: Sequence[Case],
    corruption: Corruption | None,
    metrics: Mapping[str, Metric],
    *,
    seed: int = 0,
    report: Report = lambda fraction, message: None,
) -> list[Value]:
    """All metrics on all grades of one corruption but grade 0; of the uncorrupted performances for ``None``.

    A clip that two cases or grades hand in alike is measured once for each case.
    """
    name = CLEAN if corruption is None else corruption.name
    grades = [0] if corruption is None else list(range(1, len(corruption.amounts)))
    stream = crc32(f"{seed} {name}".encode())
    by_clip = {key: metric for key, metric in metrics.items() if metric.info.scope == "clip"}
    by_set = {key: metric for key, metric in metrics.items() if metric.info.scope == "set"}
    known: dict[tuple[int, MotionClip], dict[str, float]] = {}
    values: list[Value] = []
    for grade in grades:
        samples = []
        for index, case in enumerate(cases):
            done = (grades.index(grade) + index / len(cases)) / len(grades)
            report(done, f"{name} {grade}: {case.name}")
            sample = _sample(cases, index, corruption, grade, stream, _ROUND_TRIP in metrics)
            samples.append(sample)
            swapped = corruption is not None and corruption.shuffles
            numbers = known.get((index, sample.clip)) if swapped else None
            if numbers is None:
                numbers = {key: _number(partial(metric.compute, sample)) for key, metric in by_clip.items()}
            if swapped:
                known[index, sample.clip] = numbers
            values += [Value(name, grade, key, case.name, number) for key, number in numbers.items()]
        for key, metric in by_set.items():
            report((grades.index(grade) + 1.0) / len(grades), f"{name} {grade}: {key}")
            values.append(Value(name, grade, key, "set", _number(partial(metric.compute_set, samples))))
            for group in range(min(GROUPS, len(samples))):
                rest = [sample for index, sample in enumerate(samples) if index % GROUPS != group]
                number = _number(partial(metric.compute_set, rest))
                values.append(Value(name, grade, key, f"without {group}", number))
    return values


def _sample(
    cases: Sequence[Case], index: int, corruption: Corruption | None, grade: int, stream: int, both_ways: bool
) -> Sample:
    case = cases[index]
    if corruption is None:
        return case.sample(case.performance, case.source if both_ways else None)
    back = corruption.round_trip(cases, index, grade, stream) if both_ways else None
    return case.sample(corruption.result(cases, index, grade, stream), back)


def _number(compute: Callable[[], Any]) -> float:
    try:
        return float(compute())
    except NotApplicableError:
        return float("nan")


def table(values: Sequence[Value], corruptions: Sequence[Corruption]) -> dict[tuple[str, str], dict[str, np.ndarray]]:
    """``values`` as arrays: for each (metric, corruption), for each unit of observation, (G,) values by grade.

    The uncorrupted value is grade 0 of every corruption.
    """
    sizes = {corruption.name: len(corruption.amounts) for corruption in corruptions}
    found: dict[tuple[str, str], dict[str, np.ndarray]] = {}
    for entry in values:
        names = list(sizes) if entry.corruption == CLEAN else [entry.corruption]
        for name in names:
            rows = found.setdefault((entry.metric, name), {})
            row = rows.setdefault(entry.unit_of_observation, np.full(sizes[name], np.nan))
            row[entry.grade] = entry.value
    return found
