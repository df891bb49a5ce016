"""The losses by hand and on real motion, and the update that lowers them."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from benchmark.commands.conformance.figures import ADULT, CHILD, perform
from benchmark.motion import quat
from benchmark.motion.retarget import retarget
from methods._torch.word_bank import WordBank
from methods.cyclegan_kc.losses import (
    Kinematics,
    cycle_loss,
    generator_loss,
    judge_loss,
    mean_squared_acceleration,
    style_loss,
)
from methods.cyclegan_kc.network import Discriminator, Generator
from methods.cyclegan_kc.training import KinematicCycleStep, PairSampler, Weights
from methods.holden.channels import Layout, Scaling
from methods.holden.network import Autoencoder

BODY = perform("walk", CHILD, 1).skeleton
LAYOUT = Layout.of(BODY)
CLIPS = [
    retarget(perform(action, style, take, fps=30.0), BODY)
    for style in (ADULT, CHILD)
    for action in ("walk", "wave")
    for take in (1, 2)
]
ACTIONS = [action for _ in (ADULT, CHILD) for action in ("walk", "wave") for _ in (1, 2)]
ARRAYS = [LAYOUT.encode(clip) for clip in CLIPS]
SCALING = Scaling.fit(LAYOUT, ARRAYS)


def kinematics(weights: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0), mode: str = "match") -> Kinematics:
    return Kinematics.of(
        LAYOUT,
        SCALING,
        acceleration=mean_squared_acceleration(LAYOUT, ARRAYS),
        fps=30.0,
        mode=mode,
        weights=weights,
        dtype=torch.float64,
    )


def normalised(number: int = 0, frames: int = 48) -> torch.Tensor:
    return torch.from_numpy(SCALING.apply(ARRAYS[number][:frames]).T.copy())[None]


def everywhere(x: torch.Tensor) -> torch.Tensor:
    return torch.ones(x.shape[0], x.shape[2], dtype=torch.bool)


def noise(x: torch.Tensor, seed: int = 0) -> torch.Tensor:
    return 0.1 * torch.randn(x.shape, generator=torch.Generator().manual_seed(seed), dtype=x.dtype)


def test_adversarial_losses_by_hand() -> None:
    real, fake = torch.tensor([2.0, -1.0]), torch.tensor([0.5])
    sigmoid = lambda x: 1.0 / (1.0 + math.exp(-x))  # noqa: E731
    expected = -0.5 * (math.log(sigmoid(2.0)) + math.log(sigmoid(-1.0))) - math.log(1.0 - sigmoid(0.5))
    assert float(judge_loss(real, fake, "log")) == pytest.approx(expected, rel=1e-6)
    assert float(generator_loss(fake, "log")) == pytest.approx(-math.log(sigmoid(0.5)), rel=1e-6)
    assert float(judge_loss(real, fake, "lsgan")) == pytest.approx(0.5 * ((1 + 4) / 2 + 0.25))
    assert float(generator_loss(fake, "lsgan")) == pytest.approx(0.125)


def test_a_sure_discriminator_still_teaches_the_generator() -> None:
    """The printed log(1 - D) is flat where D is sure that a motion is generated; this is steepest there."""
    fake = torch.tensor([-20.0], requires_grad=True)
    generator_loss(fake, "log").backward()
    assert fake.grad is not None and float(fake.grad) == pytest.approx(-1.0, abs=1e-6)


def test_style_loss_is_relative_and_zero_for_the_style_itself() -> None:
    wanted = torch.randn((2, 3, 3), generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    assert float(style_loss(wanted, wanted)) == 0.0
    assert float(style_loss(torch.zeros_like(wanted), wanted)) == pytest.approx(1.0)
    assert float(style_loss(9.0 * wanted, 3.0 * wanted)) == pytest.approx(4.0)


def test_cycle_loss_is_a_mean_square_over_the_frames_that_count() -> None:
    x, valid = torch.zeros(1, 4, 10), torch.zeros(1, 10, dtype=torch.bool)
    valid[:, 2:6] = True
    back = x.clone()
    back[..., 2:6], back[..., 8:] = 2.0, 100.0
    assert float(cycle_loss(back, x, valid)) == pytest.approx(4.0)


@pytest.mark.parametrize("mode", ["match", "abs"])
def test_smoothness_is_zero_for_the_content_and_never_negative(mode: str) -> None:
    content, terms = normalised(), kinematics(mode=mode)
    valid = everywhere(content)
    assert float(terms.smooth(content, content, valid)) == 0.0
    frozen = content[..., :1].expand_as(content)
    # As printed, a frozen motion would score below zero, and a wild one without bound.
    for x in (content + noise(content), frozen, 3.0 * content):
        assert float(terms.smooth(x, content, valid)) > 0.0
    # A constant offset and a steady drift change no acceleration.
    drift = content + 0.3 + 0.01 * torch.arange(content.shape[2], dtype=content.dtype)
    assert float(terms.smooth(drift, content, valid)) < 1e-12


def test_smoothness_has_the_training_clips_own_acceleration_for_unit() -> None:
    still = [normalised(n, len(ARRAYS[n])) for n in range(len(ARRAYS))]
    values = [float(kinematics().smooth(x[..., :1].expand_as(x), x, everywhere(x))) for x in still]
    frames = np.array([x.shape[2] - 2 for x in still])
    assert np.sum(values * frames) / frames.sum() == pytest.approx(1.0, rel=1e-9)


def test_bones_of_real_motion_have_their_lengths() -> None:
    content = normalised()
    terms, valid = kinematics(), everywhere(content)
    assert float(terms.bone(content, valid)) < 1e-10
    assert float(terms.bone_error(content, valid)) < 1e-6
    # Every position a tenth further from the point below the hips: bones a tenth longer.
    values = SCALING.invert(content[0].T.numpy())
    values[:, LAYOUT.positions] *= 1.1
    longer = torch.from_numpy(SCALING.apply(values).T.copy())[None]
    assert float(terms.bone_error(longer, valid)) == pytest.approx(0.1, abs=1e-6)
    lengths = BODY.bone_lengths[1:] / BODY.leg_length
    expected = np.mean((0.1 * lengths) ** 2) / SCALING.scale[0] ** 2
    assert float(terms.bone(longer, valid)) == pytest.approx(expected, rel=1e-4)


def test_trajectory_is_the_root_s_velocity_and_turn_alone() -> None:
    content = normalised()
    terms, valid = kinematics(), everywhere(content)
    other = content + noise(content)
    other[:, LAYOUT.velocity] = content[:, LAYOUT.velocity]
    assert float(terms.trajectory(other, content, valid)) == 0.0
    other[:, LAYOUT.velocity] += 0.5
    assert float(terms.trajectory(other, content, valid)) == pytest.approx(3 * 0.25)


def test_a_standing_foot_that_slides_counts_by_its_speed_and_others_do_not() -> None:
    still = perform("wave", CHILD, 3, fps=30.0)
    still = still.replace(
        rotations=np.repeat(still.rotations[:1], 40, axis=0), root=np.repeat(still.root[:1], 40, axis=0)
    )
    values = LAYOUT.encode(still)
    values[:, LAYOUT.contacts] = 1.0
    content = torch.from_numpy(SCALING.apply(values).T.copy())[None]
    terms, valid = kinematics(), everywhere(content)
    assert float(terms.foot(content, content, valid)) < 1e-15
    values[:, LAYOUT.velocity] = [0.3, 0.4, 0.0]
    sliding = torch.from_numpy(SCALING.apply(values).T.copy())[None]
    assert float(terms.foot(sliding, content, valid)) == pytest.approx(0.25)
    lifted = content.clone()
    lifted[:, LAYOUT.contacts] = -1.0
    assert float(terms.foot(sliding, lifted, valid)) == 0.0


def test_padding_has_no_say_in_any_kinematic_term() -> None:
    content = normalised(frames=40)
    x, valid = content + noise(content), everywhere(content)
    valid[:, :6] = valid[:, 31:] = False
    other = x.clone()
    other[..., :6] += 5.0
    other[..., 31:] -= 5.0
    for name, value in kinematics().terms(x, content, valid).items():
        torch.testing.assert_close(kinematics().terms(other, content, valid)[name], value)


def test_each_constraint_can_be_alone_and_the_total_is_their_weighted_sum() -> None:
    content = normalised()
    x, valid = content + noise(content), everywhere(content)
    every = kinematics().terms(x, content, valid)
    assert list(every) == ["smooth", "bone", "traj", "foot"]
    for index, name in enumerate(every):
        weights: list[float] = [0.0] * 4
        weights[index] = 3.0
        alone = kinematics(tuple(weights))  # type: ignore[arg-type]
        assert list(alone.terms(x, content, valid)) == [name]
        torch.testing.assert_close(alone.total(x, content, valid), 3.0 * every[name])
    assert float(kinematics((0.0, 0.0, 0.0, 0.0)).total(x, content, valid)) == 0.0


def test_gradients_of_the_kinematic_terms_are_right() -> None:
    content = normalised(frames=6)
    x = (content + noise(content)).requires_grad_(True)
    terms = replace(kinematics(), acceleration=1.0)
    assert torch.autograd.gradcheck(lambda y: terms.total(y, content, everywhere(content)), x)


# Pairs and updates


def test_pairs_are_of_one_action_and_every_content_has_its_turn() -> None:
    clip = np.repeat(np.arange(8), [3, 1, 2, 1, 4, 1, 1, 2])
    sampler = PairSampler(clip, ACTIONS, 4)
    pairs = sampler.draw(20, np.random.default_rng(0))
    assert sampler.conditional and len(sampler) == 7 and pairs.shape == (20, 2)
    for content, style in clip[pairs]:
        assert content < 4 <= style and ACTIONS[content] == ACTIONS[style]
    assert sorted(pairs[:7, 0]) == list(range(7))
    counts = np.bincount(clip[sampler.draw(4000, np.random.default_rng(1))[:, 1]], minlength=8)[4:6]
    assert abs(counts[0] / counts.sum() - 0.5) < 0.05  # clips, not words, have equal chances


def test_contents_without_a_partner_are_left_out_and_styles_without_a_common_action_pair_freely() -> None:
    clip = np.arange(4)
    some = PairSampler(clip, ["walk", "jump", "walk", "wave"], 2)
    assert {tuple(pair) for pair in some.draw(8, np.random.default_rng(0))} == {(0, 2)}
    none = PairSampler(clip, ["walk", "jump", "kick", "wave"], 2)
    assert not none.conditional and len(none) == 2
    assert {int(word) for word in none.draw(40, np.random.default_rng(0))[:, 1]} == {2, 3}


def step(**changes: Any) -> KinematicCycleStep:
    with torch.random.fork_rng():
        torch.manual_seed(0)
        network = Autoencoder(LAYOUT.dim, 8, 5)
        judge = Discriminator(network, [1.0] * LAYOUT.dim, head="mean", share=changes.pop("share", False))
    settings: dict[str, Any] = {
        "kinematics": Kinematics.of(
            LAYOUT, SCALING, acceleration=1e-3, fps=30.0, mode="match", weights=(0.1, 1.0, 1.0, 0.1)
        ),
        "weights": Weights(1.0, 1.0, 10.0, 1.0),
        "gan": "log",
        "symmetric": False,
        "dropout": 0.0,
        "lr": 1e-3,
        "lr_judge": 1e-3,
    }
    bank = WordBank([SCALING.apply(array) for array in ARRAYS], 32, 16)
    return KinematicCycleStep(Generator(network, residual=True), judge, bank, **{**settings, **changes})


def batch(seed: int = 0) -> Any:
    import contextlib

    each = step()
    sampler = PairSampler(each.bank.clip, ACTIONS, 4)
    index = sampler.draw(6, np.random.default_rng(seed))
    return SimpleNamespace(
        index=index, generator=torch.Generator().manual_seed(seed), autocast=lambda: contextlib.nullcontext()
    )


def test_the_total_is_equation_14_with_its_weights() -> None:
    one = step(weights=Weights(2.0, 3.0, 5.0, 7.0))
    losses = {name: torch.tensor(1.0 + n) for n, name in enumerate(("gan", "style", "cycle", "smooth", "bone", "traj"))}
    kinematic = 0.1 * 4.0 + 1.0 * 5.0 + 1.0 * 6.0
    assert float(one.total(losses)) == pytest.approx(2.0 * 1.0 + 3.0 * 2.0 + 5.0 * 3.0 + 7.0 * kinematic)


@pytest.mark.parametrize("share", [False, True])
def test_the_verdict_reaches_the_encoder_only_where_it_is_shared(share: bool) -> None:
    one = step(share=share, lr=0.0)
    before = one.generator.autoencoder.encoder.weight.detach().clone()
    head = one.judge.unit.weight.detach().clone()
    one(batch())
    moved = float((one.generator.autoencoder.encoder.weight.detach() - before).abs().max())
    assert (moved > 0) == share
    assert float((one.judge.unit.weight.detach() - head).abs().max()) > 0


@pytest.mark.parametrize("changes", [{}, {"gan": "lsgan"}, {"symmetric": True}])
def test_updates_lower_the_total(changes: dict[str, Any]) -> None:
    one = step(weights=Weights(0.0, 1.0, 10.0, 1.0), **changes)
    values = [float(one.total(one(batch()))) for _ in range(40)]
    assert values[-1] < 0.8 * values[0]


def test_the_measure_of_style_stays_as_it_was_pretrained() -> None:
    one = step()
    before = {name: value.clone() for name, value in one.measure.state_dict().items()}
    for seed in range(3):
        one(batch(seed))
    assert all(torch.equal(value, before[name]) for name, value in one.measure.state_dict().items())
    assert not torch.equal(one.generator.autoencoder.encoder.weight, before["encoder.weight"])


def test_a_turned_source_has_the_same_channels() -> None:
    """Losses see nothing of where a clip is, or which way it faces."""
    clip = CLIPS[0]
    turn = quat.from_axis_angle([0.0, 1.0, 0.0], 1.0)
    rotations = clip.rotations.copy()
    rotations[:, 0] = quat.mul(turn, rotations[:, 0])
    moved = LAYOUT.encode(clip.replace(rotations=rotations, root=quat.rotate(turn, clip.root)))
    np.testing.assert_allclose(moved, ARRAYS[0], atol=1e-9)
