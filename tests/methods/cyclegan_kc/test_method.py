"""The method from training clips to transferred ones."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from benchmark.api import FitContext, StyleTask, TransferResult
from benchmark.commands.conformance.figures import ADULT, CHILD, SmallView, perform, small_view
from benchmark.errors import ConfigError, DataError, UnknownNameError
from benchmark.motion import quat
from benchmark.motion.canonical import foot_points
from benchmark.motion.clip import MotionClip
from benchmark.motion.resample import resample
from benchmark.motion.retarget import retarget
from methods.cyclegan_kc.method import CycleGanKc, _posed
from methods.cyclegan_kc.network import halved, statistics
from methods.cyclegan_kc.refinement import Padded, draw
from methods.holden.corpus import choose_examples

BODY = perform("walk", CHILD, 1).skeleton
TASK = StyleTask(ADULT, CHILD, BODY)
TINY: dict[str, Any] = {"preset": "smoke", "pretrain_epochs": 1, "epochs": 1, "pairs": 8, "batch": 4}


def fitted(view: SmallView | None = None, *, task: StyleTask = TASK, **params: Any) -> CycleGanKc:
    rng = np.random.default_rng(1)
    return CycleGanKc(**{**TINY, **params}).fit(view or small_view(), task, rng=rng, ctx=FitContext())


@cache
def trained() -> CycleGanKc:
    return fitted(pretrain_epochs=40, epochs=6, pairs=64, batch=8, lr=5e-4)


def transferred(method: CycleGanKc, source: MotionClip, task: StyleTask = TASK) -> TransferResult:
    return method.transfer(source, task, rng=np.random.default_rng(2))


def channels(method: CycleGanKc, source: MotionClip) -> np.ndarray:
    return method.scaling_.apply(method.layout_.encode(retarget(resample(source, 30.0), method.body_)))


def test_after_pretraining_a_clip_in_its_own_style_comes_back() -> None:
    """G(C, C) is near C, where the generator's own channels are the decoder's."""
    method = fitted(pretrain_epochs=40, residual=False, pairs=1, lr=1e-6)
    padded = Padded(channels(method, perform("walk", ADULT, 3)), method._margin())
    generator = method.generator_
    with torch.no_grad():
        own = statistics(generator.encode(padded.x), halved(padded.valid))
        back = generator(padded.x, padded.valid, own)[0, :, padded.inner]
    positions = method.layout_.positions
    x = padded.x[0, :, padded.inner]
    assert float((back - x)[positions].square().mean()) < 0.5 * float(x[positions].square().mean())


def test_losses_of_both_stages_are_kept_and_fall() -> None:
    method = trained()
    pretraining = method.pretraining_.column("loss")
    assert np.mean(pretraining[-5:]) < 0.7 * pretraining[0]
    assert {"cycle", "style", "gan", "smooth", "bone", "traj", "foot", "judge"} <= set(method.history_.columns)
    style = method.history_.column("style")
    assert np.mean(style[-8:]) < np.mean(style[:4])


def test_a_result_is_nearer_to_the_style_than_its_source() -> None:
    method, source = trained(), perform("walk", ADULT, 3)
    goal = np.mean(
        [
            method.layout_.encode(retarget(clip, BODY))[:, method.layout_.positions].std(axis=0)
            for clip in small_view().clips(CHILD, action="walk")
        ],
        axis=0,
    )

    def gap(clip: MotionClip) -> float:
        return float(np.linalg.norm(method.layout_.encode(clip)[:, method.layout_.positions].std(axis=0) - goal))

    assert gap(transferred(method, source).clip) < 0.8 * gap(retarget(source, BODY))


@pytest.mark.parametrize("iterations", [1, 10, 100])
@pytest.mark.parametrize("step", [0.01, 5.0])
def test_refinement_never_raises_the_kinematic_loss_and_lowers_it_with_sane_steps(iterations: int, step: float) -> None:
    method, source = trained(), perform("walk", ADULT, 3)
    picked, _ = choose_examples(method.examples_, source, method.settings_["exemplars"])
    drawn = draw(
        method.generator_,
        method.decoder_,
        Padded(channels(method, source), method._margin()),
        [method.styles_[index] for index in picked],
        method._kinematics("cpu"),
        iterations=iterations,
        step=step,
    )
    assert drawn.after <= drawn.before
    if step < 1:
        assert drawn.after < {1: 1.0, 10: 0.9, 100: 0.5}[iterations] * drawn.before


def test_each_constraint_lowers_its_own_error_against_none() -> None:
    presets = CycleGanKc.presets()
    source = perform("walk", ADULT, 3)
    free = fitted(**{**presets["unconstrained"], "pretrain_epochs": 20})
    bare = transferred(free, source)
    bones = transferred(fitted(**{**presets["bone-only"], "pretrain_epochs": 20}), source)
    assert bones.diagnostics["bone_length_error"] < 0.9 * bare.diagnostics["bone_length_error"]
    assert bare.diagnostics["kinematic_loss"] == [0.0, 0.0]

    followed = transferred(fitted(**{**presets["trajectory-only"], "pretrain_epochs": 20}), source)
    path = retarget(source, BODY).root[:, [0, 2]]
    apart = [np.linalg.norm(each.clip.root[:, [0, 2]] - path, axis=1).mean() for each in (followed, bare)]
    assert apart[0] < 0.7 * apart[1]


def test_the_root_goes_and_turns_as_the_channels_say() -> None:
    method = trained()
    own = retarget(perform("walk", ADULT, 3), BODY)
    values = method.layout_.encode(own)
    same = _posed(method.layout_, values, own)
    np.testing.assert_allclose(same.positions, own.positions, atol=1e-6)

    turning = values.copy()
    turning[:, method.layout_.velocity.start + 2] += 0.5
    seconds = own.times[-1]
    got = _posed(method.layout_, turning, own)
    along = np.diff(own.positions[[0, -1]][:, [0]], axis=0)
    # The pose is the same, seen half a radian per second further round, and the path bends with it.
    facing = quat.from_axis_angle([0.0, 1.0, 0.0], 0.5 * seconds)
    last = quat.rotate(facing, own.positions[-1] - own.root[-1])
    np.testing.assert_allclose(got.positions[-1] - got.root[-1], last, atol=0.03)
    steps = [np.linalg.norm(np.diff(clip.root[:, [0, 2]], axis=0), axis=1).sum() for clip in (own, got)]
    assert steps[1] == pytest.approx(steps[0], rel=1e-3)
    assert np.linalg.norm(along) > 0.5


@pytest.mark.parametrize(
    "params",
    [
        {"operator": "wct", "head": "patch", "gan": "lsgan"},
        {"operator": "transport", "symmetric": True, "mixing": 0},
        {"operator": "unrolled", "residual": False, "smooth_mode": "abs", "share_encoder": True},
        {"preset": "paper", "filters": 16, "refine_iterations": 5},
        *CycleGanKc.presets().values(),
    ],
)
def test_every_choice_trains_and_transfers(params: dict[str, Any]) -> None:
    method = fitted(**params)
    source = perform("walk", ADULT, 3)
    result = transferred(method, source)
    assert len(result.clip) == len(source) and result.clip.skeleton == BODY
    off = {name for name in ("smooth", "bone", "traj", "foot") if method.settings_[f"w_{name}"] == 0}
    assert not off & set(method.history_.columns)


@pytest.mark.parametrize("frames", [2, 3, 31, 150])
@pytest.mark.parametrize("fps", [24.0, 60.0, 120.0])
def test_clips_of_any_length_and_rate_keep_both(frames: int, fps: float) -> None:
    source = perform("walk", ADULT, 3, fps=fps).frames(0, frames)
    result = transferred(trained(), source).clip
    assert len(result) == len(source) and result.fps == fps


def test_the_rate_of_a_clip_hardly_matters() -> None:
    fast = transferred(trained(), perform("walk", ADULT, 3, fps=120.0)).clip
    slow = transferred(trained(), resample(perform("walk", ADULT, 3, fps=120.0), 60.0)).clip
    gap = np.linalg.norm(fast.positions[::2][: len(slow)] - slow.positions, axis=-1)
    assert gap.mean() < 0.03 * BODY.leg_length


def test_feet_stay_near_the_floor() -> None:
    result = transferred(trained(), perform("walk", ADULT, 3)).clip
    assert np.abs(foot_points(result)[..., 1].min(axis=1)).max() < 0.07 * BODY.leg_length


def test_an_action_without_examples_takes_the_style_of_another_and_says_so() -> None:
    assert transferred(trained(), perform("jump", ADULT, 3)).diagnostics["action_in_training"] is False
    assert transferred(trained(), perform("walk", ADULT, 3)).diagnostics["action_in_training"] is True


def test_training_data_of_mixed_bodies_and_another_rate() -> None:
    mixed = tuple(
        perform(clip.meta.action, clip.meta.style, 1, fps=30.0, roles="core") for clip in small_view().held[::2]
    )
    task = StyleTask(ADULT, CHILD, perform("walk", CHILD, 1, roles="core").skeleton)
    method = fitted(SmallView(mixed, 30.0), task=task)
    # Another body than the one trained on, both of the source and of the target.
    assert transferred(method, perform("walk", ADULT, 3)).clip.skeleton == BODY


def test_without_clips_of_a_style_it_says_so() -> None:
    adults = SmallView(tuple(clip for clip in small_view().held if clip.meta.style == ADULT))
    with pytest.raises(DataError, match="'child'"):
        fitted(adults)


def test_a_saved_method_is_the_same_and_has_its_loss_curves_beside_it(tmp_path: Path) -> None:
    method, source = trained(), perform("walk", ADULT, 3)
    method.save(tmp_path)
    names = {"cyclegan-kc.safetensors", "body.npz", "pretrain.parquet", "train.parquet"}
    assert {path.name for path in tmp_path.iterdir()} == names
    loaded = CycleGanKc.load(tmp_path)
    assert loaded.settings_ == method.settings_ and loaded.facts_ == method.facts_
    one, two = transferred(method, source), transferred(loaded, source)
    np.testing.assert_array_equal(one.clip.rotations, two.clip.rotations)
    np.testing.assert_array_equal(one.clip.root, two.clip.root)
    assert one.diagnostics == two.diagnostics


def test_the_same_seed_gives_the_same_weights_and_another_gives_others() -> None:
    one, two = fitted(), fitted()
    three = CycleGanKc(**TINY).fit(small_view(), TASK, rng=np.random.default_rng(9), ctx=FitContext())
    weights = [method.generator_.state_dict() for method in (one, two, three)]
    assert all(torch.equal(value, weights[1][name]) for name, value in weights[0].items())
    assert not torch.equal(weights[0]["autoencoder.encoder.weight"], weights[2]["autoencoder.encoder.weight"])


@pytest.mark.parametrize("at", [0.15, 0.7])
def test_a_fit_that_was_interrupted_ends_in_the_same_weights(tmp_path: Path, at: float) -> None:
    class _StoppedError(Exception):
        pass

    def stop(fraction: float, message: str) -> None:
        if fraction >= at:
            raise _StoppedError

    def fit(**context: Any) -> CycleGanKc:
        method = CycleGanKc(**{**TINY, "pretrain_epochs": 4, "epochs": 4})
        return method.fit(small_view(), TASK, rng=np.random.default_rng(1), ctx=FitContext(**context))

    from methods._torch import train

    original = train.Settings
    often = lambda *args, **rest: original(*args, **{**rest, "checkpoint_steps": 1})  # noqa: E731
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(train, "Settings", often)
        with pytest.raises(_StoppedError):
            fit(work_dir=tmp_path, report=stop)
        plain, resumed = fit(), fit(work_dir=tmp_path)
    for name, value in plain.generator_.state_dict().items():
        assert torch.equal(value, resumed.generator_.state_dict()[name])


def test_progress_goes_forward_only() -> None:
    seen: list[float] = []
    method = CycleGanKc(**TINY)
    context = FitContext(report=lambda fraction, message: seen.append(fraction))
    method.fit(small_view(), TASK, rng=np.random.default_rng(1), ctx=context)
    assert seen == sorted(seen) and seen[-1] == pytest.approx(1.0)


def test_the_paper_preset_is_the_papers() -> None:
    chosen = CycleGanKc(preset="paper")._settings()
    expected = {"filters": 256, "width": 25, "dropout": 0.25, "batch": 1, "epochs": 100, "refine_iterations": 100}
    expected |= {"refine_step": 0.01, "w_cyc": 10.0, "w_kc": 1.0, "w_foot": 0.0, "residual": False}
    assert {name: chosen[name] for name in expected} == expected
    assert chosen["fps"] * chosen["seconds"] == 240


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"width": 8}, "width must be odd"),
        ({"mixing": 2}, "mixing must be odd"),
        ({"operator": "affine"}, "operator must be one of"),
        ({"dropout": 1.0}, "dropout must be at least 0 and below 1"),
        ({"strength": 1.5}, "strength must be from 0 to 1"),
        ({"lr": 0.0}, "lr must be above 0"),
        ({"w_bone": -1.0}, "w_bone must not be negative"),
        ({"fps": "fast"}, "fps must be a float"),
    ],
)
def test_settings_out_of_range_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        fitted(**settings)


def test_an_unknown_preset_is_refused() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'paper'"):
        fitted(preset="papers")
