"""Losses, pool and discriminator on inputs whose answers are known."""

from __future__ import annotations

import math

import pytest
import torch

from methods.cyclegan.discriminator import Discriminator
from methods.cyclegan.generator import CONVOLUTIONS, make_generator
from methods.cyclegan.losses import (
    coherence_loss,
    cycle_loss,
    discriminator_loss,
    generator_loss,
    transition_loss,
)
from methods.cyclegan.pool import ReplayPool


def unit(*shape: int, seed: int = 0) -> torch.Tensor:
    """Random unit quaternions (J, 4, T, B)."""
    x = torch.randn(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return torch.nn.functional.normalize(x, dim=1)


def test_least_squares_values_by_hand():
    one, zero = torch.ones(5, 2), torch.zeros(5, 2)
    assert float(discriminator_loss(one, zero)) == 0.0
    assert float(discriminator_loss(zero, one)) == 1.0
    assert float(generator_loss(zero)) == 0.5
    assert float(generator_loss(one)) == 0.0
    # Squared, hence bounded below: overshooting costs, too.
    assert float(generator_loss(3.0 * one)) == 2.0
    assert float(discriminator_loss(torch.tensor([1.0, 2.0]), torch.tensor([0.0, -2.0]))) == pytest.approx(1.25)


def test_cycle_loss_is_a_mean_over_everything():
    assert float(cycle_loss(torch.tensor([1.0, -1.0]), torch.tensor([0.0, 2.0]))) == 2.0
    word = unit(3, 4, 12, 2)
    assert float(cycle_loss(word.repeat(1, 1, 1, 5) + 0.25, word.repeat(1, 1, 1, 5))) == pytest.approx(0.25)


def test_coherence_modes():
    ramp = torch.linspace(0.0, 1.0, 11)[None, None, :, None].repeat(2, 4, 1, 3)
    assert float(coherence_loss(ramp)) == pytest.approx(0.1)
    assert float(coherence_loss(ramp, mode="second")) == pytest.approx(0.0, abs=1e-6)
    assert float(coherence_loss(ramp, ramp, mode="excess")) == 0.0
    assert float(coherence_loss(ramp, 0.5 * ramp, mode="excess")) == pytest.approx(0.05)
    assert float(coherence_loss(0.0 * ramp, ramp, mode="excess")) == 0.0
    with pytest.raises(ValueError, match="source word"):
        coherence_loss(ramp, mode="excess")


def test_transition_compares_the_forty_frames_that_both_words_show():
    """A6: with 60 frames and a hop of 20, y_i[20:60] against y_{i+1}[0:40]."""
    clip = unit(3, 4, 80, 2)
    earlier, later = clip[:, :, :60].clone(), clip[:, :, 20:].clone()
    assert float(transition_loss(earlier, later, hop=20)) == 0.0
    # What only one word shows is free; what both show is not.
    earlier[:, :, :20], later[:, :, 40:] = unit(3, 4, 20, 2, seed=1), unit(3, 4, 20, 2, seed=2)
    assert float(transition_loss(earlier, later, hop=20)) == 0.0
    for word, frame in ((earlier, 20), (earlier, 59), (later, 0), (later, 39)):
        before = word[0, 0, frame, 0].clone()
        word[0, 0, frame, 0] += 0.8
        assert float(transition_loss(earlier, later, hop=20)) == pytest.approx(0.8 / (3 * 4 * 40 * 2))
        word[0, 0, frame, 0] = before


def test_transition_undoes_the_headings_and_ignores_signs():
    clip = unit(3, 4, 80, 2)
    earlier, later = clip[:, :, :60].clone(), clip[:, :, 20:].clone()
    yaw = torch.tensor([0.7, -1.9], dtype=torch.float64)
    # Take the heading of the later word out of its root: a turn by -yaw about the vertical from the left.
    cos, sin = torch.cos(-0.5 * yaw), torch.sin(-0.5 * yaw)
    w, x, y, z = later[0].clone()
    later[0] = torch.stack((cos * w - sin * y, cos * x + sin * z, cos * y + sin * w, cos * z - sin * x))
    assert float(transition_loss(earlier, later, hop=20)) > 0.01
    assert float(transition_loss(earlier, -later, hop=20, yaw=yaw)) == pytest.approx(0.0, abs=1e-12)


def test_pool_keeps_the_first_words_and_then_swaps_half():
    generator = torch.Generator().manual_seed(3)
    pool = ReplayPool((1, 4, 2), 50)
    first = torch.arange(50.0).expand(1, 4, 2, 50)
    for part in first.split(7, dim=-1):
        assert torch.equal(pool.exchange(part, generator), part)
    assert torch.equal(pool.kept, first)
    swapped = 0
    for turn in range(200):
        words = torch.full((1, 4, 2, 3), 1000.0) + torch.arange(3 * turn, 3 * turn + 3)
        before = pool.kept.clone()
        shown = pool.exchange(words, generator)
        old = shown[0, 0, 0] != words[0, 0, 0]
        swapped += int(old.sum())
        for index in range(3):
            if old[index]:
                slot = (before[0, 0, 0] == shown[0, 0, 0, index]).nonzero().item()
                assert pool.kept[0, 0, 0, slot] == words[0, 0, 0, index]
            else:
                assert not bool((pool.kept == words[..., index : index + 1]).any())
    assert abs(swapped - 300) < 4 * math.sqrt(600 * 0.25)


def test_pool_of_any_batch_and_its_state():
    generator = torch.Generator().manual_seed(0)
    pool = ReplayPool((1, 4, 2), 4)
    assert pool.exchange(torch.rand(1, 4, 2, 11), generator).shape == (1, 4, 2, 11)
    other = ReplayPool((1, 4, 2), 4)
    other.load_state_dict(pool.state_dict())
    words = torch.rand(1, 4, 2, 3)
    one = pool.exchange(words, torch.Generator().manual_seed(5))
    assert torch.equal(one, other.exchange(words, torch.Generator().manual_seed(5)))
    nothing = ReplayPool((1, 4, 2), 0)
    assert nothing.exchange(words, generator) is words


@pytest.mark.parametrize("convolution", CONVOLUTIONS)
@pytest.mark.parametrize("skip", [False, True])
def test_generated_words_are_unit_quaternions_in_the_targets_units(convolution, skip):
    source, target = (0.1, 0.9), (-0.05, 1.04)
    generator = make_generator(5, convolution=convolution, width=2, blocks=1, skip=skip, source=source, target=target)
    generator.reset(torch.Generator().manual_seed(0))
    word = (unit(5, 4, 60, 3).float() - source[0]) / source[1]
    out = generator(word).detach()
    assert out.shape == word.shape
    length = (out * target[1] + target[0]).norm(dim=1)
    assert float((length - 1.0).abs().max()) < 1e-6
    if skip:
        # The way begins near what comes in.
        moved = (out * target[1] + target[0]) - (word * source[1] + source[0])
        assert float(moved.abs().mean()) < 0.2


@pytest.mark.parametrize("convolution", ["joint", "joint2d"])
def test_joints_do_not_see_each_other_unless_mixed(convolution):
    def reach(**options: bool) -> torch.Tensor:
        generator = make_generator(4, convolution=convolution, width=2, blocks=1, **options)
        generator.reset(torch.Generator().manual_seed(0))
        word = unit(4, 4, 24, 1).float().requires_grad_()
        rows = []
        for joint in range(4):
            (grad,) = torch.autograd.grad(generator(word)[joint].sum(), word)
            rows.append(grad.abs().sum(dim=(1, 2, 3)))
        return torch.stack(rows)

    alone, mixed = reach(), reach(cross_joint=True)
    assert torch.equal(alone > 0, torch.eye(4, dtype=torch.bool))
    assert bool((mixed > 0).all())


def test_every_verdict_sees_the_whole_word():
    judge = Discriminator(3, widths=(4, 8, 8, 8), norm="none")
    judge.reset(torch.Generator().manual_seed(0))
    word = unit(3, 4, 60, 2).float().requires_grad_()
    verdicts = judge(word)
    assert verdicts.shape == (5, 2)
    (grad,) = torch.autograd.grad(verdicts[2, 0], word)
    assert bool((grad[..., 0].abs().sum(dim=(0, 1)) > 0).all())
    assert float(grad[..., 1].abs().max()) == 0.0
