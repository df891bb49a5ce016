"""What no metric may depend on: facing, place, frame rate, size, the sign of a quaternion.

Every registered metric is tried; those that do not claim an invariance stand in :data:`NOT_CLAIMED` with the reason, and are
shown to depend on it, so that the table cannot hide a claim.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest

from benchmark.api import FitContext, Metric, NotApplicableError, Probe, Sample, StyleTask
from benchmark.commands.conformance.figures import ADULT, CHILD, MEASURED_ACTIONS, perform, small_view
from benchmark.motion import quat
from benchmark.motion.clip import MotionClip
from benchmark.motion.resample import resample
from benchmark.motion.retarget import retarget
from benchmark.registry import METRICS, PROBES

UP = np.array([0.0, 1.0, 0.0])

#: Relative tolerance of each change: rounding for the exact ones; half the frames carry less of what is fast.
TOLERANCE = {"yaw": 1e-6, "place": 1e-6, "sign": 1e-6, "size": 1e-6, "rate": 0.05}

#: Relative and absolute tolerance at half the frame rate where a metric needs more: what is differenced three times,
#: thresholded or maximal; differences that are near 0; alignments, which know time to half a frame.
RATE_TOLERANCE = {
    "physics/foot-skate-ratio": (0.1, 0.01),
    "physics/foot-skate-common": (0.15, 0.02),
    "physics/foot-skate-speed": (0.1, 0.01),
    "physics/jerk-ratio": (0.1, 0.0),
    "physics/jerk-deviation": (0.1, 0.02),
    "physics/log-dimensionless-jerk": (0.1, 0.15),
    "physics/spectral-arc-length": (0.1, 0.03),
    "physics/largest-turn-ratio": (0.1, 0.0),
    "content/round-trip-jerk-ratio": (0.1, 0.0),
    "timing/warp-deviation": (0.05, 1.0 / 60.0),
}

_FROUDE = "speeds are measured in sqrt(g leg), which a scaling of lengths alone changes; it keeps a Froude scaling"
_METRES = "heights are in metres, as penetration of a floor is"
NOT_CLAIMED: dict[tuple[str, str], str] = {
    ("physics/foot-skate-ratio", "size"): _FROUDE,
    ("physics/foot-skate-speed", "size"): "a speed in metres a second",
    ("physics/foot-skate-common", "size"): "the definition in common use is in metres",
    ("physics/foot-sliding-factor", "size"): "a speed in metres a second",
    ("physics/floor-penetration", "size"): _METRES,
    ("physics/floating", "size"): _METRES,
    ("physics/bone-length-error", "size"): "it measures whether the body is the one that was asked for",
    ("style/speed-difference", "size"): _FROUDE,
    ("style/speed-ratio", "size"): _FROUDE,
}


def turned(clip: MotionClip) -> MotionClip:
    turn = quat.from_axis_angle(UP, np.array(2.1))
    rotations = np.array(clip.rotations)
    rotations[:, 0] = quat.normalize(quat.mul(turn, rotations[:, 0]))
    return clip.replace(rotations=rotations, root=quat.rotate(turn, clip.root))


def moved(clip: MotionClip) -> MotionClip:
    return clip.replace(root=clip.root + [3.0, 0.0, -1.5])


def flipped(clip: MotionClip) -> MotionClip:
    sign = np.where(np.random.default_rng(6).random(clip.rotations.shape[:2]) < 0.5, -1.0, 1.0)
    return clip.replace(rotations=clip.rotations * sign[..., None])


def shrunk(clip: MotionClip) -> MotionClip:
    """The same motion of a figure of 0.7 times the size, in the same time."""
    return MotionClip(clip.skeleton.scaled(0.7), clip.rotations, 0.7 * clip.root, clip.fps, clip.meta)


def halved(clip: MotionClip) -> MotionClip:
    """Every second frame, as a slower camera would have taken it."""
    return resample(clip, 0.5 * clip.fps, lowpass=False)


#: What is done to the result; ``rate`` is done to everything, since a run has one frame rate.
CHANGES: dict[str, Callable[[MotionClip], MotionClip]] = {
    "yaw": turned,
    "place": moved,
    "sign": flipped,
    "size": shrunk,
    "rate": halved,
}


@pytest.fixture(scope="session")
def probes() -> Callable[[str], Mapping[str, Probe]]:
    """Probes by name, each fitted when it is first asked for."""
    fitted: dict[str, Probe] = {}
    task = StyleTask(ADULT, CHILD, perform("walk", CHILD, 1).skeleton)

    def get(name: str) -> Mapping[str, Probe]:
        if not name:
            return {}
        if name not in PROBES:
            pytest.skip(f"there is no probe {name!r}")
        if name not in fitted:
            probe = PROBES.get(name)()
            try:
                fitted[name] = probe.fit(small_view(), task, rng=np.random.default_rng(1), ctx=FitContext())
            except NotApplicableError as reason:
                pytest.skip(f"the probe cannot learn from six small clips a style: {reason}")
        return {name: fitted[name]}

    return get


@pytest.fixture(scope="session")
def samples() -> tuple[Sample, ...]:
    """Adults' clips put on a child's body, with references, truth and a way back; all of a run of 60 frames a second."""
    found = []
    for action in MEASURED_ACTIONS:
        for take in (3, 4, 5, 6):
            source, target = perform(action, ADULT, take), perform(action, CHILD, 1).skeleton
            found.append(
                Sample(
                    clip=_lowered(retarget(source, target), 0.01 if action == "wave" else 0.0),
                    source=source,
                    references=tuple(perform(action, CHILD, other) for other in (2, 4, 5, 6)),
                    truth=retarget(perform(action, CHILD, 3), target),
                    task=StyleTask(ADULT, CHILD, target),
                    round_trip=retarget(perform(action, ADULT, take + 1), source.skeleton),
                )
            )
    return tuple(found)


def _lowered(clip: MotionClip, metres: float) -> MotionClip:
    """Something for the metrics of the floor to find."""
    return clip.replace(root=clip.root - [0.0, metres, 0.0])


def change(sample: Sample, name: str) -> Sample:
    apply = CHANGES[name]
    back = None if sample.round_trip is None else apply(sample.round_trip)
    if name == "size":
        # The way back is measured on the source's body: there is no other size it could have.
        return replace(sample, clip=apply(sample.clip))
    if name != "rate":
        return replace(sample, clip=apply(sample.clip), round_trip=back)
    return replace(
        sample,
        clip=apply(sample.clip),
        source=apply(sample.source),
        references=tuple(apply(clip) for clip in sample.references),
        truth=None if sample.truth is None else apply(sample.truth),
        round_trip=back,
    )


def values(metric: Metric, samples: tuple[Sample, ...]) -> np.ndarray:
    """The value of the set, or of every fourth sample; NaN where there is none."""
    if metric.info.scope == "set":
        groups: list[Callable[[], float]] = [lambda: metric.compute_set(samples)]
    else:
        groups = [lambda sample=sample: metric.compute(sample) for sample in samples[::4]]
    found = []
    for compute in groups:
        try:
            found.append(compute())
        except NotApplicableError:
            found.append(np.nan)
    return np.array(found)


#: Probes that take more than a few seconds to fit, however small the training set.
SLOW = ("motion-encoder", "recogniser-temporal", "recogniser-kinematic")


def _named(name: str):
    """A parameter for the metric; those whose probe is slow to fit are tried with the slow tests."""
    registered = METRICS.get(name)
    return pytest.param(name, marks=[pytest.mark.slow] if registered.info.probe in SLOW else [])


_known: dict[str, np.ndarray] = {}


@pytest.mark.parametrize("what", list(CHANGES))
@pytest.mark.parametrize("name", [_named(name) for name in METRICS.names()])
def test_invariance(name: str, what: str, samples, probes) -> None:
    registered = METRICS.get(name)
    metric = registered() if isinstance(registered, type) else registered
    seen = probes(metric.info.probe)
    samples = tuple(replace(sample, probes=seen) for sample in samples)
    if name not in _known:
        _known[name] = values(metric, samples)
    before, after = _known[name], values(metric, tuple(change(sample, what) for sample in samples))
    if np.isnan(before).all():
        pytest.skip("no value on these samples")
    assert np.array_equal(np.isnan(before), np.isnan(after))
    usable = ~np.isnan(before)
    before, after = before[usable], after[usable]
    relative, absolute = TOLERANCE[what], TOLERANCE[what] * max(1e-3, np.abs(before).max())
    if what == "rate":
        relative, absolute = RATE_TOLERANCE.get(name, (relative, absolute))
    same = np.allclose(after, before, rtol=relative, atol=absolute)
    if (name, what) in NOT_CLAIMED:
        assert not same, f"{name} keeps its value under a change of {what}: take it out of NOT_CLAIMED"
    else:
        assert same, f"{name} under a change of {what}: {before} and {after}"


def test_what_is_not_claimed_names_metrics_that_exist() -> None:
    assert {name for name, _ in NOT_CLAIMED} <= set(METRICS.names())
    assert {what for _, what in NOT_CLAIMED} <= set(CHANGES)
    assert set(RATE_TOLERANCE) <= set(METRICS.names())


def test_speeds_keep_a_froude_scaling(samples) -> None:
    """Lengths times 0.64 and times times 0.8: the same motion to gravity. 48 and 60 frames a second have the same step."""
    names = [name for (name, what), why in NOT_CLAIMED.items() if what == "size" and why is _FROUDE]
    assert len(names) == 3
    base = [replace(sample, clip=resample(sample.clip, 48.0)) for sample in samples[::4]]
    for name in names:
        metric = METRICS.get(name)()
        for sample in base:
            clip = sample.clip
            small = MotionClip(clip.skeleton.scaled(0.64), clip.rotations, 0.64 * clip.root, 60.0, clip.meta)
            assert metric.compute(replace(sample, clip=small)) == pytest.approx(metric.compute(sample), rel=1e-6)
