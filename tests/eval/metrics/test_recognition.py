from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from benchmark.api import FitContext, Metric, NotApplicableError, Sample, StyleTask
from benchmark.commands.conformance.figures import SmallView, perform
from benchmark.errors import ContractError
from benchmark.motion.clip import ClipMeta, MotionClip
from eval.metrics.recognition import (
    ActionAccuracyKinematic,
    ActionAccuracyTemporal,
    StyleAccuracyKinematic,
    StyleAccuracyTemporal,
    TargetProbabilityKinematic,
    TargetProbabilityTemporal,
)
from eval.probes.linear import KinematicRecogniser
from eval.probes.recogniser import Recogniser, Recognition
from eval.probes.temporal import TemporalRecogniser

TASK = StyleTask("adult", "child")
PROBABILITIES = (TargetProbabilityTemporal, TargetProbabilityKinematic)
STYLES = (StyleAccuracyTemporal, StyleAccuracyKinematic)
ACTIONS = (ActionAccuracyTemporal, ActionAccuracyKinematic)
ALL = (*PROBABILITIES, *STYLES, *ACTIONS)


def certain(
    family: type[Recogniser], verdict: Callable[[MotionClip], Recognition], actions: tuple[str, ...]
) -> Recogniser:
    """A recogniser that says what it is told to."""
    probe = type("Certain", (family,), {"recognise": lambda self, clip: verdict(clip)})()
    probe.styles_, probe.actions_ = ("adult", "child"), actions
    return probe


def probes(target: float, actions: dict[str, float]) -> dict[str, Recogniser]:
    def verdict(clip: MotionClip) -> Recognition:
        return Recognition(target, actions)

    return {
        family.info.name: certain(family, verdict, tuple(actions))
        for family in (TemporalRecogniser, KinematicRecogniser)
    }


def sample(clip: MotionClip, source: MotionClip, given: dict[str, Recogniser], task: StyleTask = TASK) -> Sample:
    return Sample(clip, source, (), None, task, probes=given)


CLIP = perform("walk", "child", 1)


@pytest.mark.parametrize("metric", PROBABILITIES)
def test_the_probability_is_the_recogniser_s(metric: type[Metric]) -> None:
    assert metric().compute(sample(CLIP, CLIP, probes(0.37, {"walk": 1.0}))) == 0.37


@pytest.mark.parametrize("metric", STYLES)
@pytest.mark.parametrize(("target", "expected"), [(0.51, 1.0), (0.5, 0.0), (0.49, 0.0)])
def test_style_is_recognised_if_more_probable_than_not(metric: type[Metric], target: float, expected: float) -> None:
    assert metric().compute(sample(CLIP, CLIP, probes(target, {"walk": 1.0}))) == expected


@pytest.mark.parametrize("metric", ACTIONS)
def test_the_action_is_the_source_s_whatever_the_result_is_called(metric: type[Metric]) -> None:
    given = probes(0.5, {"walk": 0.3, "wave": 0.6, "jump": 0.1})
    named = CLIP.replace(meta=ClipMeta("x", "child", "walk", "1", "test"))
    assert metric().compute(sample(named, perform("wave", "adult", 1), given)) == 1.0
    assert metric().compute(sample(named, perform("walk", "adult", 1), given)) == 0.0


@pytest.mark.parametrize("metric", ACTIONS)
def test_actions_that_nobody_taught_have_no_value(metric: type[Metric]) -> None:
    with pytest.raises(NotApplicableError, match="no training clip shows 'jump'"):
        metric().compute(sample(CLIP, perform("jump", "adult", 1), probes(0.5, {"walk": 0.5, "wave": 0.5})))
    with pytest.raises(NotApplicableError, match="the only action"):
        metric().compute(sample(CLIP, perform("walk", "adult", 1), probes(0.5, {"walk": 1.0})))


@pytest.mark.parametrize("metric", ALL)
def test_a_recogniser_must_be_there_and_of_the_task(metric: type[Metric]) -> None:
    with pytest.raises(ContractError, match="holds no fitted probe 'recogniser-"):
        metric().compute(sample(CLIP, CLIP, {}))
    given = probes(0.5, {"walk": 0.5, "wave": 0.5})
    with pytest.raises(ContractError, match="was fitted for adult:child, not for child:adult"):
        metric().compute(sample(CLIP, CLIP, given, StyleTask("child", "adult")))


@pytest.mark.parametrize("metric", ALL)
def test_each_family_asks_its_own_probe(metric: type[Metric]) -> None:
    family = metric.info.name.rsplit("-", 1)[1]
    assert metric.info.probe == f"recogniser-{family}"
    assert metric.info.direction == "higher"
    assert metric.info.scope == "clip"


def test_child_adult_and_the_unchanged_source_with_a_fitted_recogniser() -> None:
    clips = tuple(perform(a, s, t) for s in ("adult", "child") for a in ("walk", "wave") for t in (1, 2))
    probe = KinematicRecogniser().fit(SmallView(clips), TASK, rng=np.random.default_rng(1), ctx=FitContext())
    given = {probe.info.name: probe}
    source, child = perform("walk", "adult", 3), perform("walk", "child", 3)
    value, taken, action = TargetProbabilityKinematic(), StyleAccuracyKinematic(), ActionAccuracyKinematic()
    assert value.compute(sample(source, source, given)) < 0.5 < value.compute(sample(child, source, given))
    assert (taken.compute(sample(source, source, given)), taken.compute(sample(child, source, given))) == (0.0, 1.0)
    assert action.compute(sample(child, source, given)) == 1.0
    assert action.compute(sample(perform("wave", "child", 3), source, given)) == 0.0
