"""What metrics mean, as the page explains them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from benchmark.registry import METRICS

#: What a group of metrics is about.
GROUPS: Mapping[str, str] = {
    "style": "how near results are to real performers of the target style",
    "recognition": "whom classifiers of the training clips take the performer for, and whether the action is still told",
    "distribution": "how the results as a set lie to the real clips of the target style",
    "truth": "distance to the true target performance of the same content, which only generated data has",
    "content": "how much of the source performance is kept",
    "timing": "how tempo and duration change",
    "physics": "whether feet, ground, joints and smoothness are right",
    "jump": "the landing of jumps; it describes and does not judge",
}


@dataclass(frozen=True)
class Meaning:
    """A metric in words."""

    name: str
    summary: str
    unit: str
    direction: str
    needs: str
    source: str


def meaning(metric: str, unit: str, direction: str, target: float | None) -> Meaning:
    """What a metric is; unit and direction as the run stored them, the rest as its source states it, where it is installed."""
    summary, facts = "this metric is not installed here, so that its description is not at hand", {}
    if metric in METRICS:
        found = METRICS.describe(metric)
        summary, facts = found.summary or "no description", dict(found.facts)
    return Meaning(
        metric,
        summary[:1].upper() + summary[1:],
        {"": "no unit", "1": "no unit", "leg": "leg lengths"}.get(unit, unit),
        in_words(direction, target),
        _needs(facts),
        str(facts.get("citation") or ""),
    )


def in_words(direction: str, target: float | None) -> str:
    """Which way is better."""
    if direction == "target":
        return "best at the value aimed at" if target is None or target != target else f"best at {target:g}"
    return {"lower": "lower is better", "higher": "higher is better"}.get(
        direction, "describes only: neither way is better"
    )


def _needs(facts: Mapping[str, Any]) -> str:
    needs = {
        "reference": "compares with real target clips of the same action",
        "truth": "compares with the true target performance",
    }.get(str(facts.get("needs", "")), "")
    whole = "one value for all clips together" if facts.get("scope") == "set" else ""
    probe = f"looks through {facts['probe']}, fitted on the training clips" if facts.get("probe") else ""
    return "; ".join(filter(None, (needs, whole, probe)))
