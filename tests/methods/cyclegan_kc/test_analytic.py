"""The kinematic loss and its gradient written out, against torch's automatic ones."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import nn

from benchmark.commands.conformance.figures import ADULT, CHILD, perform
from benchmark.errors import ContractError
from benchmark.motion.retarget import retarget
from methods.cyclegan_kc.analytic import KinematicDescent, PairDecoder
from methods.cyclegan_kc.losses import Kinematics, mean_squared_acceleration
from methods.cyclegan_kc.refinement import Padded
from methods.holden.channels import Layout, Scaling
from methods.holden.descent import descend
from methods.holden.network import unpool

BODY = perform("walk", CHILD, 1).skeleton
LAYOUT = Layout.of(BODY)
ARRAYS = [LAYOUT.encode(retarget(perform("walk", style, 1, fps=30.0), BODY)) for style in (ADULT, CHILD)]
SCALING = Scaling.fit(LAYOUT, ARRAYS)
FILTERS = 5
WEIGHTS = [
    (1.0, 0.0, 0.0, 0.0),
    (0.0, 1.0, 0.0, 0.0),
    (0.0, 0.0, 1.0, 0.0),
    (0.0, 0.0, 0.0, 1.0),
    (0.1, 20.0, 1.0, 0.1),
]


def kinematics(weights: tuple[float, float, float, float], mode: str = "match", dtype: torch.dtype = torch.float64):
    acceleration = mean_squared_acceleration(LAYOUT, ARRAYS)
    return Kinematics.of(LAYOUT, SCALING, acceleration=acceleration, fps=30.0, mode=mode, weights=weights, dtype=dtype)


class Case:
    """A decoder with random weights, a clip, and hidden units; what torch makes of them, and what is written out."""

    def __init__(
        self,
        weights,
        *,
        mode: str = "match",
        width: int = 7,
        frames: int = 31,
        residual: bool = True,
        dtype=torch.float64,
    ) -> None:
        draws = torch.Generator().manual_seed(width + frames)
        self.layer = nn.Conv1d(FILTERS, LAYOUT.dim, width, padding=width // 2, dtype=dtype)
        with torch.no_grad():
            self.layer.weight.copy_(0.1 * torch.randn(self.layer.weight.shape, generator=draws))
            self.layer.bias.copy_(0.3 * torch.randn(LAYOUT.dim, generator=draws))
        self.layer.requires_grad_(False)
        self.decoder = PairDecoder(self.layer)
        self.terms = kinematics(weights, mode, dtype)
        own = SCALING.apply(ARRAYS[0][:frames])
        self.clip = Padded(own, 2 * (width // 2 + 1))
        self.clip.x = self.clip.x.to(dtype)
        self.own = self.clip.x[0, :, self.clip.inner].T.numpy()
        self.residual = residual
        self.hidden = torch.randn((1, FILTERS, self.clip.x.shape[2] // 2), generator=draws).to(dtype)
        self.descent = KinematicDescent(
            self.terms, self.decoder, self.own, self.own if residual else self.layer.bias.numpy()
        )

    def torch_loss(self, hidden: torch.Tensor) -> torch.Tensor:
        made = self.layer(unpool(hidden))
        if self.residual:
            made = made - self.layer.bias[:, None] + self.clip.x
        return self.terms.total(made, self.clip.x, self.clip.valid)

    def kept(self, hidden: torch.Tensor) -> np.ndarray:
        return self.clip.hidden_frames(hidden[0].T.numpy(), self.decoder.reach)


def check(case: Case) -> None:
    hidden = case.hidden.clone().requires_grad_(True)
    expected = case.torch_loss(hidden)
    expected.backward()
    value, gradient = case.descent.value(case.kept(case.hidden))
    assert value == pytest.approx(float(expected.detach()), rel=1e-10)
    assert hidden.grad is not None
    np.testing.assert_allclose(gradient, case.kept(hidden.grad), atol=1e-10 * float(hidden.grad.abs().max()))
    # The frames that were left out have no part in the loss.
    assert float(hidden.grad.abs().sum()) == pytest.approx(float(np.abs(gradient).sum()), rel=1e-10)


@pytest.mark.parametrize("mode", ["match", "abs"])
@pytest.mark.parametrize("weights", WEIGHTS)
@pytest.mark.parametrize("residual", [True, False])
def test_value_and_gradient_are_those_of_autograd(weights, mode: str, residual: bool) -> None:
    case = Case(weights, mode=mode, residual=residual)
    check(case)
    assert np.abs(case.descent.value(case.kept(case.hidden))[1]).max() > 1e-6


@settings(max_examples=25, deadline=None)
@given(width=st.sampled_from([1, 3, 5, 9, 13, 25]), frames=st.integers(2, 40))
def test_any_width_and_length(width: int, frames: int) -> None:
    check(Case(WEIGHTS[-1], width=width, frames=frames))


def test_a_pair_decoder_is_the_decoder() -> None:
    case = Case(WEIGHTS[-1], width=13, residual=False)
    made = case.descent.channels(case.kept(case.hidden))
    np.testing.assert_allclose(made.T, case.layer(unpool(case.hidden))[0, :, case.clip.inner].numpy(), atol=1e-12)


def test_bone_error_is_that_of_the_terms() -> None:
    case = Case(WEIGHTS[-1])
    made = case.descent.channels(case.kept(case.hidden))
    expected = case.terms.bone_error(torch.from_numpy(made.T[None]), torch.ones((1, len(made)), dtype=torch.bool))
    assert float(expected) > 0.01
    assert case.descent.bone_error(made) == pytest.approx(float(expected), rel=1e-10)


def test_descent_ends_where_that_of_torch_ends() -> None:
    for dtype, near in ((torch.float64, 1e-9), (torch.float32, 1e-3)):
        case = Case(WEIGHTS[-1], dtype=dtype)
        end = descend(case.torch_loss, case.hidden, iterations=12, step=0.02)
        lowest, before, after = case.descent.lowest(case.kept(case.hidden), iterations=12, step=0.02)
        np.testing.assert_allclose(lowest, case.kept(end), atol=near)
        assert before == pytest.approx(float(case.torch_loss(case.hidden)), rel=near)
        assert after == pytest.approx(float(case.torch_loss(end)), rel=near)
        assert after < 0.9 * before


def test_steps_out_of_range_leave_the_start() -> None:
    case = Case(WEIGHTS[-1], dtype=torch.float32)
    start = case.kept(case.hidden)
    lowest, before, after = case.descent.lowest(start, iterations=3, step=1e30)
    assert np.array_equal(lowest, start)
    assert after == before


def test_a_margin_within_the_filters_reach_is_refused() -> None:
    clip = Padded(SCALING.apply(ARRAYS[0][:20]), 2)
    with pytest.raises(ContractError, match="a margin of 2 frames"):
        clip.hidden_frames(np.zeros((12, FILTERS), dtype=np.float32), 3)
