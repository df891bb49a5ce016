"""Transfer by ``cyclegan-kc`` as it is by default, from clip to clip, against real time; and the same without refinement."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from timing import Job, interleaved, rows

from benchmark.api import FitContext, StyleTask
from benchmark.commands.conformance.figures import ADULT, CHILD, SmallView, perform, walk
from methods.cyclegan_kc.method import CycleGanKc

#: Takes of the action by each style: those of the target style are compared with the source, to choose whose style it takes.
TAKES = 15


def _view(takes: int) -> SmallView:
    return SmallView(tuple(perform("walk", style, take + 1) for style in (ADULT, CHILD) for take in range(takes)))


def _job(method: CycleGanKc, iterations: int, seconds: float) -> Job:
    task = StyleTask(ADULT, CHILD, method.body_)
    source = perform("walk", ADULT, 1)
    clip = walk(source.skeleton, seconds=seconds).replace(meta=source.meta)

    def job() -> object:
        method.settings_["refine_iterations"] = iterations
        # A clip of its own, of which no kinematics are known yet.
        return method.transfer(clip.replace(), task, rng=np.random.default_rng(0))

    return job


def run(
    console: Any,
    *,
    sizes: Mapping[float, int] = {2.0: 15, 5.0: 15, 10.0: 9},
    takes: int = TAKES,
    params: Mapping[str, Any] | None = None,
) -> list[dict[str, Any]]:
    """Time transfers of walks of so many seconds, each so many times; ``params`` are of the method."""
    view = _view(takes)
    # What is learned does not change the time, so next to nothing is.
    method = CycleGanKc(**{"pretrain_epochs": 1, "epochs": 1, "pairs": 1, **(params or {})})
    task = StyleTask(ADULT, CHILD, perform("walk", CHILD, 1).skeleton)
    method.fit(view, task, rng=np.random.default_rng(0), ctx=FitContext())
    iterations = method.settings_["refine_iterations"]
    result = []
    for seconds, repeats in sizes.items():
        jobs = {
            "ours": _job(method, iterations, seconds),
            "ours, without refinement": _job(method, 0, seconds),
        }
        taken = interleaved(jobs, repeats=repeats)
        result += rows(f"cyclegan-kc transfer, {seconds:g} s", taken, {}, work=seconds, unit="times real time")
    return result
