"""Translation of a clip by ``hsu``, from a source clip to the child's, as a multiple of real time."""

from __future__ import annotations

from typing import Any

import numpy as np
from timing import interleaved, rows

from benchmark.api import FitContext, StyleTask
from benchmark.commands.conformance.figures import ADULT, CHILD, figure, perform, small_view, walk
from methods.hsu.method import Hsu

SECONDS, REPEATS = 20.0, 7


def run(
    console: Any, *, seconds: float = SECONDS, order: int = 40, fps: float = 30.0, repeats: int = REPEATS
) -> list[dict[str, Any]]:
    """Time the whole transfer of a walk: retargeting, models of ``order`` for every joint, bones aimed, feet on the floor."""
    rng = np.random.default_rng(0)
    task = StyleTask(ADULT, CHILD, perform("walk", CHILD, 1).skeleton)
    method = Hsu(identification="subspace", order=order, timing="none")
    method.fit(small_view(fps=fps), task, rng=rng, ctx=FitContext())
    clip = walk(figure(0.85), seconds=seconds, fps=fps)

    def transfer() -> None:
        # A fresh clip each time: world positions are kept with the clip they were computed for.
        method.transfer(clip.replace(), task, rng=rng)

    name = f"Translation by hsu, {len(task.target_skeleton or ())} joints, order {order}, {fps:g} fps"
    return rows(name, interleaved({"ours": transfer}, repeats=repeats), {}, work=seconds, unit="times real time")
