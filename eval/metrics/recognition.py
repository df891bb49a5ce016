"""Whether the target style and the action are recognised in the result, by classifiers that saw training clips alone.

Each question is put to two families of classifier that share neither input nor kind of model: a method that has learned to
please one need not please the other. Both see motion without the performer's size, so nothing is credited for a small
skeleton. No classifier is right about every stranger: values are to be read beside the row of real target performers, which is
the ceiling, and the row of the unchanged source, which is the floor; one minus the latter is how surely real performers of the
source style are told. A result above real performers is more typical of the style than people are, which is no virtue.
"""

from __future__ import annotations

from benchmark.api import Metric, MetricInfo, NotApplicableError, Sample
from benchmark.errors import ContractError
from eval.probes.recogniser import Recogniser, Recognition

_TEMPORAL, _KINEMATIC = "recogniser-temporal", "recogniser-kinematic"
_DEPS = ("eval.probes.recogniser",)


def recogniser(sample: Sample, name: str) -> Recogniser:
    """The recogniser ``name`` of a sample; a :class:`~benchmark.errors.ContractError` if it is not there or of another task."""
    probe = sample.probes.get(name)
    if not isinstance(probe, Recogniser):
        raise ContractError(f"the sample holds no fitted probe {name!r}: hand it over in Sample.probes")
    if probe.styles_ != (sample.task.source_style, sample.task.target_style):
        raise ContractError(f"the probe {name!r} was fitted for {':'.join(probe.styles_)}, not for {sample.task}")
    return probe


class _Recognised(Metric):
    """What the metrics share: the recogniser's verdict on the result."""

    def _recognition(self, sample: Sample) -> Recognition:
        return recogniser(sample, self.info.probe).recognise(sample.clip)


class _TargetProbability(_Recognised):
    def compute(self, sample: Sample) -> float:
        """The probability in [0, 1]."""
        return self._recognition(sample).target


class _StyleAccuracy(_Recognised):
    def compute(self, sample: Sample) -> float:
        """1 if the target style is more probable than the source style, else 0."""
        return float(self._recognition(sample).target > 0.5)


class _ActionAccuracy(_Recognised):
    def compute(self, sample: Sample) -> float:
        """1 if the source's action is the most probable of all, else 0; not applicable to actions not learned."""
        probe = recogniser(sample, self.info.probe)
        action = sample.source.meta.action
        if action not in probe.actions_:
            raise NotApplicableError(f"no training clip shows {action!r}, so no recogniser knows it")
        if len(probe.actions_) < 2:
            raise NotApplicableError(f"{action!r} is the only action trained, so there is nothing to take it for")
        return float(self._recognition(sample).action == action)


class TargetProbabilityTemporal(_TargetProbability):
    """Probability of the target style by temporal convolutions, mean over windows.

    Calibrated on training performers left out (:class:`~eval.probes.recogniser.Recogniser`); 0.5 says nothing either way.
    """

    info = MetricInfo(
        name="recognition/p-target-temporal",
        summary="probability of the target style by temporal convolutions (chance 0.5, ceiling: real performers)",
        unit="1",
        direction="higher",
        probe=_TEMPORAL,
        code_deps=_DEPS,
    )


class TargetProbabilityKinematic(_TargetProbability):
    """Probability of the target style by logistic regression on kinematic features, mean over windows, calibrated likewise."""

    info = MetricInfo(
        name="recognition/p-target-kinematic",
        summary="probability of the target style by kinematic features (chance 0.5, ceiling: real performers)",
        unit="1",
        direction="higher",
        probe=_KINEMATIC,
        code_deps=_DEPS,
    )


class StyleAccuracyTemporal(_StyleAccuracy):
    """Whether temporal convolutions take the result for the target style."""

    info = MetricInfo(
        name="recognition/style-accuracy-temporal",
        summary="share taken for the target style by temporal convolutions (chance 0.5, ceiling: real performers)",
        unit="1",
        direction="higher",
        probe=_TEMPORAL,
        code_deps=_DEPS,
    )


class StyleAccuracyKinematic(_StyleAccuracy):
    """Whether logistic regression on kinematic features takes the result for the target style."""

    info = MetricInfo(
        name="recognition/style-accuracy-kinematic",
        summary="share taken for the target style by kinematic features (chance 0.5, ceiling: real performers)",
        unit="1",
        direction="higher",
        probe=_KINEMATIC,
        code_deps=_DEPS,
    )


class ActionAccuracyTemporal(_ActionAccuracy):
    """Whether temporal convolutions recognise the source's action in the result."""

    info = MetricInfo(
        name="recognition/action-accuracy-temporal",
        summary="share whose action temporal convolutions recognise (chance: 1 in the number of actions trained)",
        unit="1",
        direction="higher",
        probe=_TEMPORAL,
        code_deps=_DEPS,
    )


class ActionAccuracyKinematic(_ActionAccuracy):
    """Whether logistic regression on kinematic features recognises the source's action in the result."""

    info = MetricInfo(
        name="recognition/action-accuracy-kinematic",
        summary="share whose action kinematic features show (chance: 1 in the number of actions trained)",
        unit="1",
        direction="higher",
        probe=_KINEMATIC,
        code_deps=_DEPS,
    )
