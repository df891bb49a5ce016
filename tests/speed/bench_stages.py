"""The default run from end to end, by stage: where its time goes."""

from __future__ import annotations

import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

from benchmark.config import load_config
from benchmark.registry import load_target
from benchmark.runner.probes import ProbeUnit
from benchmark.runner.run import prepare
from benchmark.runner.run import run as run_all

#: What workers report, by the name of the stage here.
STAGES = {"prepare": "reading", "fit": "fitting", "transfer": "transferring", "save": "storing", "score": "scoring"}


class Stages:
    """An observer that adds up, over all workers, how long each stage took."""

    def __init__(self) -> None:
        self.seconds: Counter[str] = Counter()
        self._now: dict[str, tuple[str, float]] = {}

    def _enter(self, key: str, stage: str) -> None:
        now = time.perf_counter()
        before, since = self._now.get(key, ("", now))
        if before:
            self.seconds[before] += now - since
        self._now[key] = stage, now

    def cell_started(self, cell: Any) -> None:
        self._enter(cell.key, "probes" if isinstance(cell, ProbeUnit) else "starting processes")

    def cell_progress(self, cell: Any, stage: str, fraction: float, message: str) -> None:
        if not isinstance(cell, ProbeUnit) and stage in STAGES:
            self._enter(cell.key, STAGES[stage])

    def cell_finished(self, cell: Any, state: str, reason: str, seconds: float) -> None:
        self._enter(cell.key, "")


def run(console: Any, **settings: Any) -> list[dict[str, Any]]:
    """Run all methods on the embedded data once, two at a time; seconds of workers, then those in which one process works."""
    stages = Stages()
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        prepared = prepare(load_config(flags={"jobs": 2, **settings, "out": Path(folder) / "run"}))
        stages.seconds["planning"] = time.perf_counter() - start
        outcome = run_all(prepared, stages)
        stages.seconds["all cells, by the clock"] = time.perf_counter() - start
        for name, target in (("report", "reports.build:build_report"), ("statistics", "reports.analysis:analyse_run")):
            began = time.perf_counter()
            load_target(target, name)(outcome.folder)
            stages.seconds[name] = time.perf_counter() - began
        stages.seconds["in all, by the clock"] = time.perf_counter() - start
        if outcome.failures:
            console.print(f"cells that failed: {outcome.failures}")
    return [
        {"task": f"Default run, {name}", "what": "ours", "value": seconds, "unit": "s", "ratio": None}
        for name, seconds in stages.seconds.items()
    ]
