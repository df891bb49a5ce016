"""The operators on hidden units, the generator around them, and the discriminator."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.linalg import sqrtm

from methods.cyclegan_kc.network import (
    Discriminator,
    Generator,
    Style,
    adain,
    halved,
    recoloured,
    statistics,
    unrolled,
)
from methods.holden.descent import gram
from methods.holden.network import Autoencoder


def _random(seed: int, *shape: int) -> torch.Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def _all(hidden: torch.Tensor) -> torch.Tensor:
    return torch.ones(hidden.shape[0], hidden.shape[-1], dtype=torch.float64)


def _network(seed: int = 0, channels: int = 7, filters: int = 6) -> Autoencoder:
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        return Autoencoder(channels, filters, 5).double()


def test_statistics_are_numpys_and_padding_has_no_say() -> None:
    hidden = _random(0, 2, 3, 9)
    found = statistics(hidden, _all(hidden))
    for row in range(2):
        np.testing.assert_allclose(found.mean[row], hidden[row].mean(dim=1), atol=1e-12)
        np.testing.assert_allclose(found.covariance[row], np.cov(hidden[row].numpy(), bias=True), atol=1e-12)
    padded = torch.nn.functional.pad(hidden, (2, 3), value=7.0)
    counted = torch.zeros(2, 14, dtype=torch.float64)
    counted[:, 2:11] = 1.0
    for one, two in zip(found, statistics(padded, counted), strict=True):
        torch.testing.assert_close(one, two)


def test_the_gram_matrix_is_the_one_of_holden() -> None:
    hidden = _random(1, 2, 4, 11)
    torch.testing.assert_close(statistics(hidden, _all(hidden)).gram, gram(hidden))


def test_hidden_frames_count_where_one_of_their_frames_does() -> None:
    valid = torch.tensor([[False, False, False, True, True, True, True, False]])
    assert halved(valid).tolist() == [[0.0, 1.0, 1.0, 1.0]]


def test_adain_gives_every_unit_the_mean_and_nearly_the_deviation_of_the_style() -> None:
    content, other = 2.0 * _random(2, 1, 4, 400) + 1.0, 0.5 * _random(3, 1, 4, 300) - 2.0
    own, style = statistics(content, _all(content)), statistics(other, _all(other))
    got = adain(content, own, style)
    found = statistics(got, _all(got))
    torch.testing.assert_close(found.mean, style.mean)
    # Both variances have the same floor added, so the deviation comes out within a few per cent.
    torch.testing.assert_close(found.variance, style.variance, rtol=0.06, atol=0)
    by_hand = (content - content.mean(2, keepdim=True)) * (
        (other.var(2, unbiased=False) + 0.05 * style.variance.mean())
        / (content.var(2, unbiased=False) + 0.05 * style.variance.mean())
    ).sqrt()[:, :, None] + other.mean(2, keepdim=True)
    torch.testing.assert_close(got, by_hand)


def test_a_unit_that_is_still_in_the_content_is_moved_and_not_blown_up() -> None:
    content, other = _random(4, 1, 3, 50), _random(5, 1, 3, 50)
    content[:, 1] = 0.7 + 1e-6 * content[:, 1]
    got = adain(content, statistics(content, _all(content)), statistics(other, _all(other)))
    assert float(got[:, 1].std()) < 1e-4
    torch.testing.assert_close(got[:, 1].mean(), other[:, 1].mean(), atol=1e-9, rtol=0)


@pytest.mark.parametrize("nearest", [False, True])
def test_recoloured_units_have_the_covariance_of_the_style(nearest: bool) -> None:
    mixing = _random(6, 4, 4)
    content, other = _random(7, 2, 4, 500), mixing @ _random(8, 2, 4, 500) + 3.0
    own, style = statistics(content, _all(content)), statistics(other, _all(other))
    got = recoloured(content, own, style, nearest=nearest)
    found = statistics(got, _all(got))
    torch.testing.assert_close(found.mean, style.mean)
    # The floor keeps it from being exact.
    gap = (found.covariance - style.covariance).norm() / style.covariance.norm()
    assert float(gap) < 0.25 * float((own.covariance - style.covariance).norm() / style.covariance.norm())


def test_recolouring_is_the_formula_that_scipy_computes() -> None:
    content, other = _random(9, 1, 3, 200), 2.0 * _random(10, 1, 3, 200)
    own, style = statistics(content, _all(content)), statistics(other, _all(other))
    floor = 0.05 * float(style.variance.mean()) * np.eye(3)
    c, s = (each.covariance[0].numpy() + floor for each in (own, style))
    inverse = np.linalg.inv(sqrtm(c))
    expected = {False: sqrtm(s) @ inverse, True: inverse @ sqrtm(sqrtm(c) @ s @ sqrtm(c)) @ inverse}
    centred = (content - own.mean[:, :, None])[0].numpy()
    for nearest, matrix in expected.items():
        got = recoloured(content, own, style, nearest=nearest)[0].numpy()
        np.testing.assert_allclose(got, matrix @ centred + style.mean[0].numpy()[:, None], atol=1e-9)


def test_the_transport_changes_the_content_less_than_whitening_and_colouring() -> None:
    content, other = (_random(seed, 5, 5) @ _random(seed + 10, 1, 5, 300) for seed in (11, 12))
    c, s = (statistics(each, _all(each)).covariance for each in (content, other))
    nowhere, identity = torch.zeros(1, 5, dtype=torch.float64), torch.eye(5, dtype=torch.float64)[None]
    floored = c + 0.05 * s.diagonal(dim1=1, dim2=2).mean() * identity
    moved = []
    for nearest in (True, False):
        matrix = recoloured(identity, Style(nowhere, c), Style(nowhere, s), nearest=nearest)
        change = matrix - identity
        moved.append(float((change @ floored @ change.transpose(1, 2)).diagonal(dim1=1, dim2=2).sum()))
    assert moved[0] < 0.99 * moved[1]


def test_unrolled_steps_are_the_gradient_of_their_objective_and_lower_it() -> None:
    content, other = _random(14, 1, 4, 30), 2.0 * _random(15, 1, 4, 30)
    style, strength = statistics(other, _all(other)), 0.6
    size, frames = style.gram.diagonal(dim1=1, dim2=2).sum(), content.shape[-1]

    def objective(hidden: torch.Tensor) -> torch.Tensor:
        apart = (gram(hidden) - style.gram).square().sum() * frames / (4 * size)
        return strength * apart + 0.5 * (1 - strength) * (hidden - content).square().sum()

    start = content.clone().requires_grad_(True)
    (slope,) = torch.autograd.grad(objective(start), start)
    once = unrolled(content, _all(content), style, strength=strength, steps=1)
    torch.testing.assert_close(once, content - slope)
    values = [
        float(objective(unrolled(content, _all(content), style, strength=strength, steps=steps)))
        for steps in (0, 1, 2, 4, 8)
    ]
    assert values == sorted(values, reverse=True) and values[-1] < values[0]


@pytest.mark.parametrize("operator", ["adain", "wct", "transport", "unrolled"])
@pytest.mark.parametrize("residual", [False, True])
def test_a_motion_in_its_own_style_is_what_the_autoencoder_makes_of_it(operator: str, residual: bool) -> None:
    network = _network()
    generator = Generator(network, operator=operator, residual=residual).double()
    x, valid = _random(16, 2, 7, 24), torch.ones(2, 24, dtype=torch.bool)
    own = statistics(generator.encode(x), halved(valid))
    got = generator(x, valid, own)
    assert got.shape == x.shape
    expected = x if residual else network.decode(network.encode(x))
    torch.testing.assert_close(got, expected, atol=1e-8, rtol=0)


def test_with_a_residual_what_the_decoder_adds_is_the_difference_of_two_decodings() -> None:
    network = _network()
    x, before, after = _random(17, 2, 7, 20), _random(18, 2, 6, 10), _random(19, 2, 6, 10)
    got = Generator(network, residual=True).double().decode(after, x, before)
    torch.testing.assert_close(got, x + network.decode(after) - network.decode(before))


def test_strength_goes_from_the_content_to_the_style() -> None:
    x, valid = _random(20, 1, 7, 24), torch.ones(1, 24, dtype=torch.bool)
    other = _random(21, 1, 6, 12)
    style = statistics(other, _all(other))
    moves = []
    for strength in (0.0, 0.5, 1.0):
        generator = Generator(_network(), strength=strength, residual=True).double()
        moves.append(generator(x, valid, style).detach() - x)
    assert float(moves[0].abs().max()) < 1e-12
    torch.testing.assert_close(moves[1], 0.5 * moves[2])


def test_the_papers_shapes() -> None:
    """73 channels and 240 frames to 256 units and 120, and back; Table 1's first and last rows are transposed in print."""
    with torch.random.fork_rng():
        generator = Generator(Autoencoder(73, 256, 25))
    x = torch.zeros(1, 73, 240)
    hidden = generator.encode(x)
    assert hidden.shape == (1, 256, 120)
    assert generator.decode(hidden, x, hidden).shape == (1, 73, 240)


@pytest.mark.parametrize(("head", "shape"), [("mean", (2, 1)), ("patch", (2, 12))])
def test_discriminators_begin_as_the_encoder_and_own_their_weights(head: str, shape: tuple[int, int]) -> None:
    network = _network()
    judge = Discriminator(network, [1.0] * 7, head=head, share=False).double()
    x, valid = _random(22, 2, 7, 24), torch.ones(2, 24, dtype=torch.bool)
    logits = judge(x, valid, 0.0, torch.Generator())
    assert logits.shape == shape
    hidden = network.encode(x)
    hidden = hidden.mean(dim=2, keepdim=True) if head == "mean" else hidden
    torch.testing.assert_close(logits, judge.unit(hidden.transpose(1, 2))[..., 0])
    logits.sum().backward()
    assert all(parameter.grad is None for parameter in network.parameters())
    assert judge.trunk.weight.grad is not None and float(judge.trunk.weight.grad.abs().sum()) > 0


def test_a_shared_encoder_learns_from_the_verdict_and_is_not_saved_twice() -> None:
    network = _network()
    judge = Discriminator(network, [1.0] * 7, head="mean", share=True).double()
    judge(_random(23, 2, 7, 24), torch.ones(2, 24, dtype=torch.bool), 0.0, torch.Generator()).sum().backward()
    assert network.encoder.weight.grad is not None and float(network.encoder.weight.grad.abs().sum()) > 0
    assert {name.split(".")[0] for name in judge.state_dict()} == {"unit", "seen"}


def test_discriminators_are_blind_to_the_channels_they_must_not_see_and_to_padding() -> None:
    judge = Discriminator(_network(), [1.0] * 5 + [0.0] * 2, head="mean", share=False).double()
    x, valid = _random(24, 1, 7, 40), torch.ones(1, 40, dtype=torch.bool)
    valid[:, 20:] = False
    changed = x.clone()
    changed[:, 5:] += 3.0
    changed[..., 24:] -= 5.0  # out of the filters' reach of the frames that count
    generator = torch.Generator()
    torch.testing.assert_close(judge(x, valid, 0.0, generator), judge(changed, valid, 0.0, generator))


def test_styles_are_averaged_part_by_part() -> None:
    hidden = _random(25, 3, 4, 10)
    each = statistics(hidden, _all(hidden))
    mean = each.averaged()
    assert isinstance(mean, Style) and mean.mean.shape == (1, 4)
    torch.testing.assert_close(mean.covariance[0], each.covariance.mean(0))
