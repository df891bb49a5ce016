"""What the metrics are checked on: performances of which everything is known."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from benchmark.api import Probe, Sample, StyleTask
from benchmark.motion.clip import MotionClip


@dataclass(frozen=True, eq=False)
class Case:
    """One source clip and the true performance of its content in the target style.

    Attributes
    ----------
    name, actor, action
        Of the source clip.
    source
        The clip that a method would be given.
    truth
        The true performance, without noise.
    performance
        The true performance as it would have been captured: what a faultless method would hand in, and what is corrupted.
    references
        Real target clips of the same action.
    adult
        The source on the target skeleton, which is what a method that does nothing hands in.
    blend
        ``blend(share)``: the same content performed on the target skeleton with ``share`` of the source's style and the rest
        of the target's, captured likewise.
    task
        The task.
    probes
        Fitted probes.
    """

    name: str
    actor: str
    action: str
    source: MotionClip
    truth: MotionClip
    performance: MotionClip
    references: tuple[MotionClip, ...]
    adult: MotionClip
    blend: Callable[[float], MotionClip]
    task: StyleTask
    probes: Mapping[str, Probe] = field(default_factory=dict)

    def sample(self, clip: MotionClip, round_trip: MotionClip | None = None) -> Sample:
        """``clip`` as the result of a method for this case."""
        return Sample(
            clip,
            self.source,
            self.references,
            self.truth,
            self.task,
            round_trip=round_trip,
            probes=self.probes,
        )
