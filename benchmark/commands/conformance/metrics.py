"""What the contract asks of a metric."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from importlib.util import find_spec

import numpy as np

from benchmark.api import Metric, MetricInfo, NotApplicableError, Probe, Sample, StyleTask
from benchmark.commands.conformance.figures import ADULT, CHILD, MEASURED_ACTIONS, perform
from benchmark.commands.conformance.methods import fingerprint
from benchmark.commands.conformance.outcome import (
    Check,
    CheckFailedError,
    NotConcernedError,
    Outcome,
    require,
    run_check,
)
from benchmark.motion.clip import MotionClip
from benchmark.motion.retarget import retarget
from benchmark.registry import PROBES

#: The suite's own groups of metrics.
_GROUPS = ("physics", "content", "timing", "style", "recognition", "distribution", "jump", "truth")

_NAME = re.compile(r"[a-z][a-z0-9-]*/[a-z0-9][a-z0-9-]*")


class MetricBench:
    """A metric class, and small samples to try it on."""

    def __init__(self, metric: type[Metric]) -> None:
        self.metric = metric

    @cached_property
    def samples(self) -> tuple[Sample, ...]:
        """An adult's clip of each action put on a child's body, with references and truth."""
        return self.fresh_samples()

    @cached_property
    def probes(self) -> Mapping[str, Probe]:
        """The probe that the metric names, fitted to a handful of clips."""
        from benchmark.commands.conformance.probes import fitted

        name = self.metric.info.probe
        return {name: fitted(name)} if name else {}

    def fresh_samples(self) -> tuple[Sample, ...]:
        """The samples again, of clips that nothing is remembered of."""
        return tuple(sample_of(action, self.probes) for action in MEASURED_ACTIONS)

    def value(self, *samples: Sample) -> float:
        """The value for one sample, or for all in a set."""
        metric = self.metric()
        return metric.compute_set(samples) if self.metric.info.scope == "set" else metric.compute(samples[0])

    def values(self, samples: Sequence[Sample]) -> list[float]:
        """The value of every sample, or the one of the set; those not applicable are left out."""
        groups = [tuple(samples)] if self.metric.info.scope == "set" else [(sample,) for sample in samples]
        found = []
        for group in groups:
            try:
                found.append(self.value(*group))
            except NotApplicableError:
                continue
        return found


def sample_of(action: str, probes: Mapping[str, Probe] | None = None) -> Sample:
    """An adult's take on a child's body, two real takes of other children, a truth, and another take for the way back."""
    source = perform(action, ADULT, 3)
    target = perform(action, CHILD, 1).skeleton
    return Sample(
        clip=retarget(source, target),
        source=source,
        references=(perform(action, CHILD, 2), perform(action, CHILD, 4)),
        truth=retarget(perform(action, CHILD, 3), target),
        task=StyleTask(ADULT, CHILD, target),
        round_trip=retarget(perform(action, ADULT, 4), source.skeleton),
        probes=probes or {},
    )


def check_metric(metric: type[Metric]) -> list[Outcome]:
    """Run every check on a metric class."""
    bench = MetricBench(metric)
    return [run_check(check, bench) for check in METRIC_CHECKS]


def _info(bench: MetricBench) -> None:
    info = getattr(bench.metric, "info", None)
    if not isinstance(info, MetricInfo):
        raise CheckFailedError("set the class attribute info = MetricInfo(name=…, summary=…, unit=…, direction=…)")
    require(bool(_NAME.fullmatch(info.name)), f"info.name {info.name!r} must look like group/name")
    require(bool(info.summary.strip()) and "\n" not in info.summary, "info.summary must be one line")
    require(bool(info.unit), "info.unit must not be empty; '1' for a pure number")
    directions = ("lower", "higher", "target", "none")
    require(info.direction in directions, f"info.direction {info.direction!r} is none of {', '.join(directions)}")
    require(
        (info.direction == "target") == (info.target is not None),
        "info.target goes with direction='target', and only with it",
    )
    require(
        info.needs in ("none", "reference", "truth"), f"info.needs {info.needs!r} is none of none, reference, truth"
    )
    require(info.scope in ("clip", "set"), f"info.scope {info.scope!r} is neither clip nor set")
    require(not info.probe or info.probe in PROBES, f"info.probe {info.probe!r} is no registered probe")
    for module in info.code_deps:
        try:
            found = find_spec(module) is not None
        except ModuleNotFoundError:
            found = False
        require(found, f"code_deps names {module!r}, which cannot be imported")
    bench.metric()


def _finite(bench: MetricBench) -> None:
    values = bench.values(bench.samples)
    require(bool(values), "it has no value for plain walking, waving and jumping: it raises NotApplicableError for all")
    for value in values:
        require(isinstance(value, float), f"it returned a {type(value).__name__}: return a float")
        require(bool(np.isfinite(value)), f"it returned {value}: raise NotApplicableError where there is no value")


def _short(bench: MetricBench) -> None:
    short = [
        replace(sample, clip=sample.clip.frames(0, frames), source=sample.source.frames(0, frames))
        for sample in bench.samples
        for frames in (1, 2)
    ]
    for value in bench.values(short):
        require(bool(np.isfinite(value)), f"one or two frames give {value}: raise NotApplicableError instead")


def _repeatable(bench: MetricBench) -> None:
    first, second = bench.values(bench.samples), bench.values(bench.fresh_samples())
    require(first == second, "the same sample gives two values")


def _needs(bench: MetricBench) -> None:
    needs = bench.metric.info.needs
    bare = tuple(
        replace(
            sample,
            references=sample.references if needs == "reference" else (),
            truth=sample.truth if needs == "truth" else None,
        )
        for sample in bench.samples
    )
    require(
        bench.values(bare) == bench.values(bench.samples),
        f"info.needs is {needs!r}, but the value changes when what it does not ask for is missing",
    )
    if needs == "none":
        return
    for sample in bench.samples:
        lacking = replace(sample, references=()) if needs == "reference" else replace(sample, truth=None)
        try:
            value = bench.value(lacking)
        except NotApplicableError:
            continue
        raise CheckFailedError(
            f"without a {needs} it returns {value}: raise NotApplicableError, or do not declare the need"
        )


def _inputs_unchanged(bench: MetricBench) -> None:
    clips = [
        clip
        for sample in bench.samples
        for clip in (sample.clip, sample.source, sample.truth, *sample.references)
        if clip is not None
    ]
    before = [fingerprint(clip) for clip in clips]
    bench.values(bench.samples)
    require(before == [fingerprint(clip) for clip in clips], "it writes to the clips it measures")


def _sign_flip(bench: MetricBench) -> None:
    flipped = _altered(bench.samples, _flipped)
    _agree(bench, flipped, "quaternions of the opposite sign, which are the same rotations, change the value", 1e-7)


def _place_and_facing(bench: MetricBench) -> None:
    if bench.metric.info.name.partition("/")[0] in _GROUPS:
        _agree(bench, _altered(bench.samples, _placed), "where the figure stands and faces changes the value", 1e-6)
        return
    raise NotConcernedError("only the suite's own groups promise not to depend on place and facing")


def _agree(bench: MetricBench, other: Sequence[Sample], complaint: str, tolerance: float) -> None:
    first, second = bench.values(bench.samples), bench.values(other)
    require(
        len(first) == len(second) and np.allclose(first, second, rtol=tolerance, atol=tolerance),
        f"{complaint}: {first} and {second}",
    )


def _altered(samples: Sequence[Sample], change: object) -> tuple[Sample, ...]:
    return tuple(
        replace(
            sample,
            clip=change(sample.clip),  # type: ignore[operator]
            references=tuple(change(clip) for clip in sample.references),  # type: ignore[operator]
            truth=change(sample.truth),  # type: ignore[operator]
        )
        for sample in samples
    )


def _flipped(clip: MotionClip) -> MotionClip:
    sign = np.where(np.random.default_rng(6).random(clip.rotations.shape[:2]) < 0.5, -1.0, 1.0)
    return clip.replace(rotations=clip.rotations * sign[..., None])


def _placed(clip: MotionClip) -> MotionClip:
    from benchmark.motion import quat

    turn = quat.from_axis_angle(np.array([0.0, 1.0, 0.0]), np.array(2.1))
    rotations = clip.rotations.copy()
    rotations[:, 0] = quat.normalize(quat.mul(turn, rotations[:, 0]))
    return clip.replace(rotations=rotations, root=quat.rotate(turn, clip.root) + [3.0, 0.0, -1.5])


METRIC_CHECKS: Sequence[Check] = (
    Check("info", "info is complete", _info),
    Check("finite", "plain motion gets a finite value", _finite),
    Check("short", "one or two frames get a finite value or none", _short),
    Check("repeatable", "the same sample gets the same value", _repeatable),
    Check("needs", "what it declares to need is what it uses", _needs),
    Check("inputs-unchanged", "no clip handed in is written to", _inputs_unchanged),
    Check("sign-flip", "the sign of a quaternion does not matter", _sign_flip),
    Check("place-and-facing", "where a figure stands and faces does not matter", _place_and_facing),
)
