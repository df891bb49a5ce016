"""The method from training clips to transferred ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from benchmark.api import FitContext, StyleTask
from benchmark.commands.conformance.figures import ADULT, CHILD, SmallView, perform, small_view
from benchmark.errors import ConfigError, DataError, UnknownNameError
from benchmark.motion import quat
from methods.cyclegan.method import CycleGan

BODY = perform("walk", CHILD, 1).skeleton
TASK = StyleTask(ADULT, CHILD, BODY)
TINY = {"preset": "smoke", "epochs": 1, "pairs": 4, "batch": 2}


def fitted(view: SmallView | None = None, *, task: StyleTask = TASK, seed: int = 0, **params: object) -> CycleGan:
    rng = np.random.default_rng(seed)
    return CycleGan(**{**TINY, **params}).fit(view or small_view(), task, rng=rng, ctx=FitContext())


@pytest.fixture(scope="module")
def small() -> CycleGan:
    return fitted()


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


@pytest.mark.parametrize(
    "params",
    [
        {"convolution": "joint2d", "norm": "none"},
        {"convolution": "overall", "width": 4, "norm": "instance", "skip": False, "whiten": False},
        {"transition": 5.0, "order": "joint", "identity": 1.0},
        {"coherence": 0.0, "pool": 0, "cross_joint": True, "blend": "hann"},
        {"coherence_mode": "second", "whiten": False, "length": 32, "hop": 16, "peaks": False, "cutoff": 0.0},
        {"coherence_mode": "excess", "order": "joint", "judge_norm": "instance", "transition": 1.0, "batch": 3},
    ],
)
def test_every_choice_trains_and_transfers(params):
    method = fitted(**params)
    source = perform("walk", ADULT, 3)
    result = method.transfer(source, TASK, rng=rng())
    assert len(result.clip) == len(source)
    assert result.clip.skeleton == BODY
    losses = {"cycle", "adversarial", "coherence", "d_source", "d_target"}
    losses |= {"transition"} if params.get("transition") else set()
    losses |= {"identity"} if params.get("identity") else set()
    assert losses <= set(method.history_.columns)


def test_paper_preset_is_the_papers():
    chosen = CycleGan(preset="paper")._chosen()
    expected = {"cycle": 15.0, "coherence": 30.0, "lr": 2e-4, "batch": 1, "epochs": 180, "pool": 50, "blocks": 9}
    expected |= {"length": 60, "hop": 20, "fps": 60.0, "cutoff": 7.0, "order": "sequential", "transition": 0.0}
    assert {name: chosen[name] for name in expected} == expected


def test_rate_falls_by_a_hundredth_per_epoch_after_the_hundredth():
    from methods._torch.schedule import linear_decay, stepwise

    chosen = CycleGan(preset="paper")._chosen()
    factor = stepwise(linear_decay(start=chosen["decay_from"], length=chosen["decay_over"]))
    rates = [2e-4 * factor(epoch) for epoch in (0, 99.5, 100, 101, 180)]
    assert rates == pytest.approx([2e-4, 2e-4, 2e-4, 1.98e-4, 4e-5])


@pytest.mark.parametrize(
    ("params", "complaint"),
    [
        ({"length": 62}, "multiple of 4"),
        ({"hop": 61}, "hop must be at most length"),
        ({"norm": "batch"}, "norm must be one of"),
        ({"cycle": -1.0}, "cycle must be at least"),
        ({"lr": 0.0}, "lr must be above 0"),
        ({"convolution": "overall", "cross_joint": True}, "joint-wise"),
        ({"width": 2.5}, "width must be a int"),
    ],
)
def test_settings_that_cannot_be_are_refused(params, complaint):
    with pytest.raises(ConfigError, match=complaint):
        fitted(**params)


def test_an_unknown_preset_is_refused():
    with pytest.raises(UnknownNameError, match="preset"):
        fitted(preset="medium")


def test_without_clips_of_a_style_it_says_so():
    adults = SmallView(tuple(clip for clip in small_view().held if clip.meta.style == ADULT))
    with pytest.raises(DataError, match="'child'"):
        fitted(adults)


def test_styles_without_a_common_action_are_not_paired_by_action():
    held = small_view().held
    view = SmallView(tuple(c for c in held if (c.meta.style == ADULT) == (c.meta.action == "walk")))
    method = fitted(view)
    assert method.facts_["pairs"] == "any action"
    assert fitted().facts_["pairs"] == "same action"


@pytest.mark.parametrize("fps", [25.0, 30.0, 120.0])
def test_other_rates_keep_their_clock(small, fps):
    source = perform("walk", ADULT, 3, fps=fps)
    result = small.transfer(source, TASK, rng=rng())
    assert (len(result.clip), result.clip.fps) == (len(source), fps)
    assert float(np.abs(np.linalg.norm(result.clip.rotations, axis=-1) - 1.0).max()) < 1e-9


def test_training_data_of_mixed_bodies_and_another_rate():
    mixed = tuple(
        perform(clip.meta.action, clip.meta.style, 1, fps=30.0, roles="core") for clip in small_view().held[::2]
    )
    task = replace(TASK, target_skeleton=perform("walk", CHILD, 1, roles="core").skeleton)
    method = fitted(SmallView(mixed, 30.0), task=task)
    # Another body than the one trained on, both of the source and of the target.
    result = method.transfer(perform("walk", ADULT, 3), TASK, rng=rng())
    assert result.clip.skeleton == BODY


def test_path_is_the_sources_scaled_by_leg_length(small):
    source = perform("walk", ADULT, 3)
    result = small.transfer(source, TASK, rng=rng()).clip
    scale = BODY.leg_length / source.skeleton.leg_length
    assert np.allclose(result.root[:, [0, 2]], scale * source.root[:, [0, 2]], atol=1e-9)


def test_raw_and_smoothed_results_differ_by_the_filters_only(small):
    result = small.transfer(perform("walk", ADULT, 3), TASK, rng=rng())
    assert result.raw_clip is not None
    apart = quat.angle(result.clip.rotations, result.raw_clip.rotations)
    assert 0.0 < float(apart.mean()) < np.radians(3.0)


def test_a_longer_clip_than_goes_through_at_once(monkeypatch, small):
    source = perform("walk", ADULT, 3)
    whole = small.transfer(source, TASK, rng=rng()).clip
    monkeypatch.setattr("methods.cyclegan.method._AT_ONCE", 2)
    parts = small.transfer(source, TASK, rng=rng()).clip
    assert float(quat.angle(whole.rotations, parts.rotations).max()) < 1e-5


def test_there_and_back_uses_both_generators(small):
    source = perform("walk", ADULT, 3)
    there = small.transfer(source, TASK, rng=rng()).clip
    back, around = small.reverse(there), small.round_trip(source, BODY)
    assert len(back) == len(around) == len(source)
    assert float(quat.angle(there.rotations, back.rotations).max()) > 1e-4
    assert float(quat.angle(there.rotations, around.rotations).max()) > 1e-4


def test_the_return_trip_is_handed_out_when_asked_for(small, tmp_path):
    source = perform("walk", ADULT, 3)
    assert small.transfer(source, TASK, rng=rng()).round_trip is None
    small.save(tmp_path)
    asked = CycleGan.load(tmp_path)
    asked.settings_ = {**asked.settings_, "return_trip": True}
    result = asked.transfer(source, TASK, rng=rng())
    assert result.round_trip is not None
    assert result.round_trip.skeleton == source.skeleton
    assert np.array_equal(result.round_trip.rotations, small.round_trip(source).rotations)


def test_filtering_the_change_keeps_what_the_source_has(small, tmp_path, monkeypatch):
    small.save(tmp_path)
    method = CycleGan.load(tmp_path)
    monkeypatch.setattr(method, "_generated", lambda words, route: words)
    source = perform("walk", ADULT, 3, fps=60.0)
    tremor = quat.from_axis_angle(np.array([1.0, 0.0, 0.0]), 0.1 * np.where(np.arange(len(source)) % 2, 1.0, -1.0))
    rotations = source.rotations.copy()
    rotations[:, 4] = quat.mul(rotations[:, 4], tremor)
    shaking = source.replace(rotations=rotations)
    angles = {}
    for smooth in ("output", "change"):
        method.settings_ = {**method.settings_, "smooth": smooth}
        out = method.transfer(shaking, StyleTask(ADULT, CHILD, None), rng=rng()).clip
        angles[smooth] = float(quat.angle(out.rotations[:, 4], shaking.rotations[:, 4]).mean())
    assert angles["change"] < 1e-3
    assert angles["output"] > 0.05


class Interrupted(Exception):
    pass


def test_interrupted_training_ends_with_the_same_weights(tmp_path):
    def fit(folder, stop: float) -> CycleGan:
        def report(fraction: float, message: str) -> None:
            if fraction >= stop:
                raise Interrupted

        context = FitContext(work_dir=folder, report=report)
        method = CycleGan(preset="smoke", epochs=2, pairs=8, batch=2, pool=3)
        return method.fit(small_view(), TASK, rng=rng(), ctx=context)

    whole = fit(tmp_path / "whole", 2.0)
    from methods._torch import train

    original = train.Settings
    often = lambda *args, **rest: original(*args, **{**rest, "checkpoint_steps": 1})  # noqa: E731
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(train, "Settings", often)
        with pytest.raises(Interrupted):
            fit(tmp_path / "cut", 0.6)
        assert (tmp_path / "cut" / "cyclegan.safetensors").exists()
        resumed = fit(tmp_path / "cut", 2.0)
    for name in ("forth", "back"):
        for one, two in zip(whole.generators_[name].parameters(), resumed.generators_[name].parameters(), strict=True):
            assert torch.equal(one, two)


def test_it_learns_a_style_that_is_a_posture():
    """Children hold their arms 0.25 radians further out, and that is all: the way there must be found from unpaired words."""
    body = perform("walk", CHILD, 1).skeleton
    held = []
    for clip in small_view().held:
        other = perform(clip.meta.action, ADULT, int(clip.meta.take))
        rotations = other.rotations.copy()
        if clip.meta.style == CHILD:
            rotations = _arms_out(other.skeleton, rotations, 0.25)
        held.append(other.replace(rotations=rotations, meta=clip.meta))
    small_one = {"width": 4, "blocks": 1, "judge_width": 16, "lr": 1e-3, "lr_judge": 1e-3}
    short = {"epochs": 4, "pairs": 128, "batch": 4, "decay_from": 2.0, "decay_over": 3.0}
    method = CycleGan(preset="quick", **small_one, **short)  # type: ignore[arg-type]
    task = StyleTask(ADULT, CHILD, body)
    method.fit(SmallView(tuple(held)), task, rng=rng(), ctx=FitContext())
    source = perform("walk", ADULT, 3)
    truth = _arms_out(source.skeleton, source.rotations.copy(), 0.25)
    got = method.transfer(source, task, rng=rng()).clip.rotations
    still = fitted().transfer(source, task, rng=rng()).clip.rotations
    shoulders = list(body.joints("left_shoulder", "right_shoulder"))
    before = float(quat.angle(source.rotations, truth)[:, shoulders].mean())
    after = float(quat.angle(got, truth)[:, shoulders].mean())
    assert before == pytest.approx(0.25, abs=1e-6)
    assert after < 0.5 * before
    # It is learned, not a by-product of the blending and smoothing.
    assert float(quat.angle(still, truth)[:, shoulders].mean()) > 1.5 * after
    losses = method.history_.column("cycle")
    assert np.mean(losses[-10:]) < 0.7 * np.mean(losses[10:40])


def _arms_out(skeleton, rotations: np.ndarray, angle: float) -> np.ndarray:
    for side, sign in (("left", 1.0), ("right", -1.0)):
        joint = skeleton.joint(f"{side}_shoulder")
        out = quat.from_axis_angle(np.array([0.0, 0.0, 1.0]), np.array(sign * angle))
        rotations[:, joint] = quat.mul(out, rotations[:, joint])
    return rotations
