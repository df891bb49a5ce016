"""The conformance suite itself: every check fails on a method or metric that breaks what it checks."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import pytest

from benchmark.api import Capabilities, Method, MethodInfo, Metric, MetricInfo, Sample, Supervision, TransferResult
from benchmark.commands.conformance import (
    METHOD_CHECKS,
    METRIC_CHECKS,
    MethodBench,
    check_method,
    check_metric,
    run_check,
)
from benchmark.commands.conformance.metrics import MetricBench
from benchmark.errors import BenchmarkError, DataError
from benchmark.motion import quat
from benchmark.motion.retarget import retarget


def info(**changes: Any) -> MethodInfo:
    capabilities = {"supervision": Supervision.NONE, "fit_scope": "none", **changes}
    return MethodInfo("good", "does as it says", Capabilities(**capabilities))


class Good(Method):
    info = info()

    def fit(self, train, task, *, rng, ctx):
        return self

    def transfer(self, source, task, *, rng):
        return TransferResult(source if task.target_skeleton is None else retarget(source, task.target_skeleton))


class Learner(Good):
    """Learns the number of training clips and turns the elbow by it."""

    info = info(supervision=Supervision.PAIRED, fit_scope="per_task")

    def fit(self, train, task, *, rng, ctx):
        pairs = list(train.pairs(task.source_style, task.target_style))
        if not pairs:
            raise DataError("needs pairs")
        self.angle_ = 0.01 * len(pairs)
        return self

    def transfer(self, source, task, *, rng):
        clip = super().transfer(source, task, rng=rng).clip
        rotations = clip.rotations.copy()
        turn = quat.from_axis_angle(np.array([1.0, 0.0, 0.0]), np.array(self.angle_))
        rotations[:, 3] = quat.mul(rotations[:, 3], turn)
        return TransferResult(clip.replace(rotations=rotations))

    def save(self, folder: Path) -> None:
        folder.mkdir(parents=True)
        (folder / "model.json").write_text(json.dumps(self.angle_))

    @classmethod
    def load(cls, folder: Path) -> Self:
        method = cls()
        method.angle_ = json.loads((folder / "model.json").read_text())
        return method


class NoInfo(Good):
    info = None


class BadName(Good):
    info = MethodInfo("Bad Name", "x", Capabilities())


class AlteringConstructor(Good):
    def __init__(self, *, size: float = 1.0) -> None:
        self.size = 2.0 * size


class BusyConstructor(Good):
    def __init__(self) -> None:
        self.cache = {}


class TakesAnything(Good):
    def __init__(self, **anything: Any) -> None:
        self.anything = anything

    @classmethod
    def param_defaults(cls) -> dict[str, Any]:
        return {}


class ReturnsNothing(Good):
    def fit(self, train, task, *, rng, ctx):
        pass


class StrayName(Learner):
    def fit(self, train, task, *, rng, ctx):
        self.stray = 1
        return super().fit(train, task, rng=rng, ctx=ctx)


class Hoarder(Learner):
    def fit(self, train, task, *, rng, ctx):
        before = getattr(self, "angle_", 0.0)
        super().fit(train, task, rng=rng, ctx=ctx)
        self.angle_ += before
        return self


class WrongBody(Good):
    def transfer(self, source, task, *, rng):
        return TransferResult(source)


class IgnoresMissingBody(Good):
    def transfer(self, source, task, *, rng):
        return TransferResult(retarget(source, task.target_skeleton or source.skeleton.scaled(0.5)))


class DropsFrames(Good):
    def transfer(self, source, task, *, rng):
        clip = super().transfer(source, task, rng=rng).clip
        return TransferResult(clip.frames(0, len(clip) - 1))


class BackwardClock(Good):
    def transfer(self, source, task, *, rng):
        clip = super().transfer(source, task, rng=rng).clip
        return TransferResult(clip, time_map=clip.times[::-1])


class NeedsToes(Good):
    def transfer(self, source, task, *, rng):
        source.skeleton.joint("left_toe")
        return super().transfer(source, task, rng=rng)


class WritesToSource(Good):
    def transfer(self, source, task, *, rng):
        result = super().transfer(source, task, rng=rng)
        root = source.root.base if source.root.base is not None else source.root
        root[0] += 1.0
        return result


class WritesToBody(Good):
    def transfer(self, source, task, *, rng):
        if task.target_skeleton is not None:
            offsets = task.target_skeleton.offsets
            for array in (offsets.base, offsets):
                if array is not None:
                    array.flags.writeable = True
            # The same each time, so that no other check sees it.
            offsets[-1] = 0.3
        return super().transfer(source, task, rng=rng)


class Remembers(Good):
    calls: ClassVar[list] = []

    def transfer(self, source, task, *, rng):
        self.calls.append(1)
        clip = super().transfer(source, task, rng=rng).clip
        return TransferResult(clip.replace(root=clip.root + [0.0, 0.0, 0.001 * len(self.calls)]))


class KeepsTheFirst(Good):
    def transfer(self, source, task, *, rng):
        if not hasattr(self, "height"):
            self.height = float(source.root[:, 1].mean())
        clip = super().transfer(source, task, rng=rng).clip
        return TransferResult(clip.replace(root=clip.root + [0.0, 0.0, self.height]))


class Secretive(Good):
    def transfer(self, source, task, *, rng):
        clip = super().transfer(source, task, rng=rng).clip
        return TransferResult(clip.replace(root=clip.root + [0.0, 0.0, rng.random()]))


class Boasts(Good):
    info = info(stochastic_transfer=True)


class GlobalDraws(Good):
    def transfer(self, source, task, *, rng):
        np.random.random()  # noqa: NPY002 - the fault under test
        return super().transfer(source, task, rng=rng)


class Forgets(Learner):
    @classmethod
    def load(cls, folder: Path) -> Self:
        method = cls()
        method.angle_ = 0.5
        return method


class LearnsOnTheClass(Learner):
    angle_ = 0.0

    def fit(self, train, task, *, rng, ctx):
        super().fit(train, task, rng=rng, ctx=ctx)
        type(self).angle_ = vars(self).pop("angle_")
        return self

    def save(self, folder: Path) -> None:
        folder.mkdir(parents=True)

    @classmethod
    def load(cls, folder: Path) -> Self:
        return cls()


class SavesPickle(Learner):
    def save(self, folder: Path) -> None:
        super().save(folder)
        (folder / "model.pkl").write_bytes(b"")


class TakesUnpaired(Learner):
    def fit(self, train, task, *, rng, ctx):
        if not train.clips(task.target_style):
            raise DataError("needs target clips")
        self.angle_ = 0.01 * len(train.clips(task.target_style))
        return self


class StumblesUnpaired(Learner):
    def fit(self, train, task, *, rng, ctx):
        self.angle_ = 0.01 / len(list(train.pairs(task.source_style, task.target_style)))
        return self


class ClaimsReference(Good):
    info = info(uses_reference=True)


FAULTS = [
    (NoInfo, "info", "MethodInfo"),
    (BadName, "info", "lower-case words"),
    (AlteringConstructor, "constructor", "alters 'size'"),
    (BusyConstructor, "constructor", "sets cache"),
    (TakesAnything, "parameters", "unknown keyword"),
    (ReturnsNothing, "fit-returns-self", "return self"),
    (StrayName, "fit-returns-self", "stray"),
    (Hoarder, "refit", "forget"),
    (WrongBody, "transfer", "task.target_skeleton"),
    (IgnoresMissingBody, "no-target-skeleton", "source's skeleton"),
    (DropsFrames, "transfer", "changes_timing"),
    (BackwardClock, "transfer", "non-decreasing"),
    (NeedsToes, "required-roles", "left_toe"),
    (WritesToSource, "inputs-unchanged", "adult/adult3/walk_3"),
    (WritesToBody, "inputs-unchanged", "task.target_skeleton"),
    (Remembers, "no-hidden-state", "keep nothing"),
    (KeepsTheFirst, "no-hidden-state", "first transfer"),
    (Remembers, "same-seed", "two results"),
    (Secretive, "other-seed", "stochastic_transfer=True"),
    (Boasts, "other-seed", "declare it False"),
    (GlobalDraws, "global-random-state", "generator passed in"),
    (Forgets, "save-load", "another result"),
    (LearnsOnTheClass, "save-load", "another result"),
    (SavesPickle, "save-load", "model.pkl"),
    (TakesUnpaired, "supervision", "without pairs"),
    (StumblesUnpaired, "supervision", "ZeroDivisionError"),
    (ClaimsReference, "reference", "without a reference"),
]


@pytest.mark.parametrize(("method", "name", "message"), FAULTS, ids=lambda value: getattr(value, "__name__", None))
def test_a_fault_is_found_and_named(method: type[Method], name: str, message: str) -> None:
    (check,) = [check for check in METHOD_CHECKS if check.name == name]
    outcome = run_check(check, MethodBench(method))
    assert outcome.status == "failed"
    assert message in outcome.message


def test_every_check_but_the_import_has_a_fault_that_it_finds() -> None:
    # A class defined in a test module cannot be imported by another process, so that check is tested by itself below.
    assert {name for _, name, _ in FAULTS} == {check.name for check in METHOD_CHECKS} - {"light-import"}


@pytest.mark.parametrize("method", [Good, Learner])
def test_sound_methods_pass(method: type[Method]) -> None:
    assert [outcome for outcome in check_method(method) if outcome.status == "failed"] == []


def test_a_heavy_import_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "heavy_method.py").write_text(
        "import pandas\nfrom methods.identity import Identity\nclass Heavy(Identity):\n    pass\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    from importlib import import_module

    (check,) = [check for check in METHOD_CHECKS if check.name == "light-import"]
    outcome = run_check(check, MethodBench(import_module("heavy_method").Heavy))
    assert outcome.status == "failed"
    assert "pandas" in outcome.message


def test_the_parameters_that_fail_are_named() -> None:
    class OneBad(Good):
        def __init__(self, *, body: bool = True) -> None:
            self.body = body

        @classmethod
        def test_params(cls) -> list[dict[str, Any]]:
            return [{}, {"body": False}]

        def transfer(self, source, task, *, rng):
            return super().transfer(source, task, rng=rng) if self.body else TransferResult(source)

    failed = {outcome.check.name: outcome.message for outcome in check_method(OneBad) if outcome.status == "failed"}
    assert failed["transfer"].startswith("with {'body': False}")


def test_no_test_params_is_an_error() -> None:
    class Empty(Good):
        @classmethod
        def test_params(cls) -> list[dict[str, Any]]:
            return []

    with pytest.raises(BenchmarkError, match="test_params"):
        check_method(Empty)


def measure(**changes: Any) -> MetricInfo:
    return MetricInfo(**{"name": "style/good", "summary": "x", "unit": "m", "direction": "lower", **changes})


class Height(Metric):
    info = measure()

    def compute(self, sample: Sample) -> float:
        return float(sample.clip.positions[..., 1].mean())


class TargetWithout(Height):
    info = measure(direction="target")


class NaN(Height):
    def compute(self, sample: Sample) -> float:
        return float("nan")


class ShortNaN(Height):
    def compute(self, sample: Sample) -> float:
        return 1.0 if len(sample.clip) > 2 else float("inf")


class Counter(Height):
    count = 0

    def compute(self, sample: Sample) -> float:
        type(self).count += 1
        return float(self.count)


class UndeclaredNeed(Height):
    def compute(self, sample: Sample) -> float:
        return super().compute(sample) + len(sample.references)


class NeedlessNeed(Height):
    info = measure(needs="reference")


class Writes(Height):
    def compute(self, sample: Sample) -> float:
        root = sample.clip.root.base if sample.clip.root.base is not None else sample.clip.root
        root[0] += 1.0
        return 1.0


class SignBound(Height):
    def compute(self, sample: Sample) -> float:
        return float(sample.clip.rotations[..., 0].mean())


class PlaceBound(Height):
    def compute(self, sample: Sample) -> float:
        return float(sample.clip.root[..., 0].mean())


METRIC_FAULTS = [
    (TargetWithout, "info", "info.target"),
    (NaN, "finite", "NotApplicableError"),
    (ShortNaN, "short", "NotApplicableError"),
    (Counter, "repeatable", "two values"),
    (UndeclaredNeed, "needs", "does not ask for"),
    (NeedlessNeed, "needs", "without a reference"),
    (Writes, "inputs-unchanged", "writes to the clips"),
    (SignBound, "sign-flip", "opposite sign"),
    (PlaceBound, "place-and-facing", "stands and faces"),
]


@pytest.mark.parametrize(
    ("metric", "name", "message"), METRIC_FAULTS, ids=lambda value: getattr(value, "__name__", None)
)
def test_a_fault_of_a_metric_is_found_and_named(metric: type[Metric], name: str, message: str) -> None:
    (check,) = [check for check in METRIC_CHECKS if check.name == name]
    outcome = run_check(check, MetricBench(metric))
    assert outcome.status == "failed"
    assert message in outcome.message


def test_every_metric_check_has_a_fault_that_it_finds() -> None:
    assert {name for _, name, _ in METRIC_FAULTS} == {check.name for check in METRIC_CHECKS}


def test_a_sound_metric_passes() -> None:
    assert {outcome.status for outcome in check_metric(Height)} == {"passed"}
