"""The method as a whole, on small figures whose adult and child differ in known ways."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from benchmark.api import FitContext, NotApplicableError, Sample, StyleTask, TransferResult
from benchmark.commands.conformance.figures import ADULT, CHILD, SmallView, figure, perform, small_view
from benchmark.errors import ConfigError, DataError
from benchmark.motion import quat
from benchmark.motion.clip import ClipMeta, MotionClip
from benchmark.motion.kinematics import fk
from eval.metrics.style import RangeOfMotionRatio, ReferenceDistance
from methods.hsu.method import Hsu
from methods.hsu.settings import FAITHFUL
from methods.identity import Identity

BODY = perform("walk", CHILD, 1).skeleton
TASK = StyleTask(ADULT, CHILD, BODY)
RNG = np.random.default_rng(0)

#: Cheap and without choices, for what does not concern identification.
QUICK = {"identification": "subspace", "order": 0}


def fitted(view: SmallView | None = None, **params) -> Hsu:
    return Hsu(**{**QUICK, **params}).fit(view or small_view(), TASK, rng=RNG, ctx=FitContext())


@cache
def quick() -> Hsu:
    return fitted()


def transfer(method: Hsu | Identity, source: MotionClip) -> TransferResult:
    return method.transfer(source, TASK, rng=RNG)


@pytest.mark.parametrize("action", ["walk", "wave"])
@pytest.mark.parametrize("params", [{}, {"coordinates": "hips"}])
def test_a_new_adult_becomes_more_like_the_child(action: str, params: dict) -> None:
    before, after = samples(fitted(**params), action)
    assert ReferenceDistance().compute(after) < 0.6 * ReferenceDistance().compute(before)
    gap = [abs(np.log(RangeOfMotionRatio().compute(sample))) for sample in (before, after)]
    assert gap[1] < 0.6 * gap[0]


def test_so_it_does_with_everything_chosen_from_the_data() -> None:
    """Four takes of 30 frames a second are little to choose from; the choice must do no harm."""
    method = fitted(small_view(fps=30.0), order="auto", identification="auto")
    for action in ("walk", "wave"):
        before, after = samples(method, action, fps=30.0)
        assert ReferenceDistance().compute(after) < 0.7 * ReferenceDistance().compute(before)
    orders = [fact["order"] for fact in method.facts_["groups"][""]["joints"]]
    assert max(orders) <= 4


def samples(method: Hsu, action: str, *, fps: float = 60.0) -> tuple[Sample, Sample]:
    """A new adult's take put on the child's body and translated, each beside the child's own."""
    source, truth = perform(action, ADULT, 3, fps=fps), perform(action, CHILD, 3, fps=fps)
    clips = (transfer(Identity(), source).clip, transfer(method, source).clip)
    return Sample(clips[0], source, (truth,), None, TASK), Sample(clips[1], source, (truth,), None, TASK)


def test_the_bones_are_the_targets_and_the_feet_on_the_floor() -> None:
    clip = transfer(quick(), perform("walk", ADULT, 3)).clip
    assert clip.skeleton == BODY
    ankles = clip.positions[:, BODY.joints("left_ankle", "right_ankle"), 1].min(axis=1)
    assert abs(np.median(ankles) - np.median(perform("walk", CHILD, 1).positions[:, BODY.joint("left_ankle"), 1])) < 0.1


def test_the_clock() -> None:
    source = perform("walk", ADULT, 3)
    kept = transfer(fitted(timing="none"), source)
    assert len(kept.clip) == len(source)
    np.testing.assert_allclose(kept.time_map, source.times)

    # The takes last as long in both styles; make the children's last 0.7 times as long.
    view = small_view()
    short = tuple(c.frames(0, round(0.7 * len(c))) if c.meta.style == CHILD else c for c in view.held)
    for timing in ("ratio", "rate"):
        result = transfer(fitted(SmallView(short), timing=timing), source)
        assert len(result.clip) == pytest.approx(0.7 * len(source), rel=0.1)
        assert result.time_map is not None
        assert len(result.time_map) == len(result.clip)
        assert np.all(np.diff(result.time_map) >= 0.0)
        assert result.time_map[-1] == pytest.approx(source.duration, abs=0.05)


def test_the_posters_preset_is_the_posters() -> None:
    view = SmallView(tuple(clip for clip in small_view(fps=30.0).held if clip.meta.action == "wave"), 30.0)
    method = Hsu(**FAITHFUL).fit(view, TASK, rng=RNG, ctx=FitContext())
    facts = method.facts_["groups"]["wave"]
    assert len(facts["pairs"]) == 1
    # One clip has fewer directions than the 40 states that are asked for.
    assert all(20 < fact["order"] < 40 for fact in facts["joints"])
    assert all(any("order 40 was asked for" in warning for warning in fact["warnings"]) for fact in facts["joints"])
    assert any("rank" in warning for fact in facts["joints"] for warning in fact["warnings"])
    assert all(np.abs(model.poles()).max() < 1.0 for model in method.models_["wave"].joints if model is not None)
    source = perform("wave", ADULT, 3, fps=30.0)
    result = transfer(method, source)
    assert len(result.clip) == len(source)
    assert np.all(np.isfinite(result.clip.root))


def test_an_action_without_a_pair_is_not_applicable() -> None:
    method = fitted(scope="action")
    unknown = perform("walk", ADULT, 3).replace(meta=ClipMeta("adult3", ADULT, "hop"))
    with pytest.raises(NotApplicableError, match=r"no training pair performs the action 'hop'; .* walk, wave"):
        transfer(method, unknown)
    assert len(transfer(quick(), unknown).clip) > 1


def test_views_without_pairs() -> None:
    view = small_view()
    apart = tuple(c for c in view.held if (c.meta.style == ADULT) == (c.meta.action == "walk"))
    with pytest.raises(NotApplicableError, match="no action has training takes of both 'adult' and 'child'"):
        fitted(SmallView(apart))
    with pytest.raises(DataError, match="training clips of the style 'child'"):
        fitted(SmallView(tuple(view.clips(ADULT))))


def test_takes_of_one_frame_are_left_out() -> None:
    view = small_view()
    frozen = view.held[0].frames(0, 1).replace(meta=ClipMeta("adult9", ADULT, "walk", "9"))
    method = fitted(SmallView((*view.held, frozen)))
    sources = {pair["source"] for pair in method.facts_["groups"][""]["pairs"]}
    assert frozen.meta.clip_id not in sources
    assert sources


def test_bodies_that_stand_still() -> None:
    """Channels that never change have no standard deviation to divide by."""
    held = []
    for style, leg in ((ADULT, 0.8), (CHILD, 0.5)):
        body = figure(leg)
        root = np.tile([0.0, 1.25 * leg, 0.0], (40, 1))
        clip = MotionClip(body, quat.identity(40, len(body)), root, 60.0, ClipMeta(style, style, "stand", "1"))
        held.append(clip)
    result = transfer(fitted(SmallView(tuple(held))), held[0])
    assert np.all(np.isfinite(result.clip.rotations))
    assert quat.angle(result.clip.rotations[0], result.clip.rotations[-1]).max() < 1e-6


def test_clips_of_very_unequal_length_and_of_two_frames() -> None:
    view = small_view()
    odd = (
        view.held[0].frames(0, 2).replace(meta=ClipMeta("adult8", ADULT, "walk", "8")),
        perform("walk", CHILD, 1).frames(0, 9).replace(meta=ClipMeta("child8", CHILD, "walk", "8")),
    )
    method = fitted(SmallView((*view.held, *odd)), partners=0, pairs=0)
    for frames in (2, 3, 5):
        result = transfer(method, perform("walk", ADULT, 3).frames(0, frames))
        assert len(result.clip) >= 1
        assert np.all(np.isfinite(result.clip.root))


def test_other_frame_rates_and_other_skeletons() -> None:
    for source in (perform("walk", ADULT, 3, fps=30.0), perform("walk", ADULT, 3, roles="core")):
        result = transfer(quick(), source)
        assert result.clip.fps == source.fps
        assert result.clip.skeleton == BODY
        reference = transfer(quick(), perform("walk", ADULT, 3))
        assert result.clip.duration == pytest.approx(reference.clip.duration, abs=0.05)
    with pytest.raises(DataError, match="use body='common'"):
        transfer(fitted(body="own"), perform("walk", ADULT, 3, roles="core"))


def test_wild_inputs_are_held_at_the_limits() -> None:
    source = perform("walk", ADULT, 3)
    rotations = source.rotations.copy()
    rotations[50:60, source.skeleton.joint("left_knee")] = [0.0, 1.0, 0.0, 0.0]
    wild = source.replace(rotations=rotations)
    assert transfer(fitted(limit=0.0), wild).diagnostics["limited_share"] > 0.0
    assert transfer(fitted(limit=4.0), source).diagnostics["limited_share"] == 0.0


def test_a_pre_roll_starts_from_the_first_pose() -> None:
    """Without it the state starts from the mean pose; with it from the pose that the clip begins with."""
    params = {"order": 6, "timing": "none"}
    source = perform("walk", ADULT, 3)
    cold, warm = (transfer(fitted(**params, pre_roll=seconds), source).clip for seconds in (0.0, 2.0))
    assert len(cold) == len(warm) == len(source)
    difference = np.abs(fk(BODY, cold.rotations, cold.root)[1] - fk(BODY, warm.rotations, warm.root)[1]).max(
        axis=(1, 2)
    )
    assert difference[:10].max() > 3.0 * difference[-30:].max()


@pytest.mark.parametrize(
    ("params", "message"),
    [
        ({"scope": "clip"}, "scope must be one of all, action, not 'clip'"),
        ({"order": "many"}, "order must be 'auto' or a whole number"),
        ({"order": True}, "order must be 'auto' or a whole number"),
        ({"smooth": 0.0}, "smooth must be above 0"),
        ({"repeat": 0}, "repeat must be at least 1"),
        ({"timing": "child"}, "timing must be one of none, ratio, rate"),
    ],
)
def test_settings_that_do_not_exist(params: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        fitted(**params)
