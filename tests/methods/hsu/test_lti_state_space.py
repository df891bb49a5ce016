"""Simulation of a state-space model: whole clips, frame by frame, saved and read back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.errors import ContractError
from methods.hsu.lti import StateSpace
from methods.hsu.lti.scan import powers, propagate
from methods.hsu.lti.stability import observability_gramian, output_normal


def system(order: int, inputs: int = 3, outputs: int = 2, *, rho: float = 0.95, seed: int = 0) -> StateSpace:
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(order, order))
    if order:
        a *= rho / np.abs(np.linalg.eigvals(a)).max()
    return StateSpace(
        a, rng.normal(size=(order, inputs)), rng.normal(size=(outputs, order)), rng.normal(size=(outputs, inputs))
    )


def naive(model: StateSpace, u: np.ndarray, x0: np.ndarray | None = None) -> np.ndarray:
    x = np.zeros(model.order) if x0 is None else x0
    result = []
    for frame in u:
        result.append(model.C @ x + model.D @ frame)
        x = model.A @ x + model.B @ frame
    return np.array(result).reshape(len(u), model.outputs)


@settings(max_examples=60, deadline=None)
@given(
    order=st.integers(0, 41),
    frames=st.one_of(st.integers(0, 20), st.integers(20, 900)),
    seed=st.integers(0, 2**31),
    rho=st.sampled_from([0.0, 0.5, 0.98, 0.9999]),
)
def test_blocks_equal_the_plain_recurrence(order, frames, seed, rho):
    model = system(order, rho=rho, seed=seed)
    rng = np.random.default_rng(seed)
    u, x0 = rng.normal(size=(frames, 3)), rng.normal(size=order)
    wanted = naive(model, u, x0)
    size = np.abs(wanted).max(initial=1.0)
    np.testing.assert_allclose(model.simulate(u, x0), wanted, rtol=0.0, atol=1e-12 * size)


@pytest.mark.parametrize("batch", [1, 5, 60])
def test_batches_are_independent_sequences(batch):
    model = system(7)
    rng = np.random.default_rng(1)
    u, x0 = rng.normal(size=(2, batch, 150, 3)), rng.normal(size=(2, batch, 7))
    got = model.simulate(u, x0)
    assert got.shape == (2, batch, 150, 2)
    for place in np.ndindex(2, batch):
        np.testing.assert_allclose(got[place], naive(model, u[place], x0[place]), atol=1e-11)


def test_a_record_longer_than_one_piece_is_the_same(monkeypatch):
    model = system(40)
    u = np.random.default_rng(2).normal(size=(2000, 3))
    whole = model.simulate(u)
    monkeypatch.setattr("methods.hsu.lti.state_space._ROOM", 40 * 300)
    np.testing.assert_allclose(model.simulate(u), whole, atol=1e-12 * np.abs(whole).max())


def test_several_lengths_together():
    model = system(5)
    rng = np.random.default_rng(3)
    inputs = [rng.normal(size=(length, 3)) for length in (90, 1, 120, 0, 77)]
    for u, got in zip(inputs, model.simulate_each(inputs), strict=True):
        np.testing.assert_allclose(got, naive(model, u), atol=1e-12)
    uneven = [rng.normal(size=(length, 3)) for length in (20_000, 3, 3, 3)]
    for u, got in zip(uneven, model.simulate_each(uneven), strict=True):
        np.testing.assert_allclose(got, naive(model, u), atol=1e-12)


@pytest.mark.parametrize("order", [0, 1, 6, 40])
def test_streaming_equals_batch(order):
    model = system(order)
    u = np.random.default_rng(4).normal(size=(400, 3))
    wanted = model.simulate(u)
    for _ in range(2):
        streamed = np.array([model.step(frame) for frame in u])
        np.testing.assert_allclose(streamed, wanted, rtol=0.0, atol=1e-12 * np.abs(wanted).max())
        # Simulating in between leaves the stream alone, and resetting starts it anew.
        model.simulate(u)
        model.reset()
    x0 = np.arange(order, dtype=float)
    model.reset(x0)
    x0 += 1.0
    np.testing.assert_allclose(model.step(u[0]), naive(model, u[:1], x0 - 1.0)[0], atol=1e-12)


def test_markov_parameters_are_the_impulse_response():
    model = system(6)
    markov = model.markov(30)
    assert markov.shape == (30, 2, 3)
    np.testing.assert_array_equal(markov[0], model.D)
    for channel in range(3):
        impulse = np.zeros((30, 3))
        impulse[0, channel] = 1.0
        np.testing.assert_allclose(markov[:, :, channel], model.simulate(impulse), atol=1e-12)
    assert model.markov(0).shape == (0, 2, 3)
    np.testing.assert_array_equal(StateSpace.static(np.ones((2, 3))).markov(4)[1:], 0.0)


def test_poles_and_radius():
    turn = 0.9 * np.array([[np.cos(0.3), np.sin(0.3)], [-np.sin(0.3), np.cos(0.3)]])
    a = np.zeros((3, 3))
    a[:2, :2], a[2, 2] = turn, -0.4
    model = StateSpace(a, np.ones((3, 1)), np.ones((1, 3)), np.zeros((1, 1)))
    np.testing.assert_allclose(model.poles(), [0.9 * np.exp(-0.3j), 0.9 * np.exp(0.3j), -0.4], atol=1e-14)
    assert model.spectral_radius == pytest.approx(0.9)
    static = StateSpace.static([[1.0, 2.0]])
    assert (static.order, static.inputs, static.outputs, static.spectral_radius) == (0, 2, 1, 0.0)


def test_other_bases_and_units_are_the_same_map():
    model = system(5)
    rng = np.random.default_rng(6)
    moved = model.transformed(rng.normal(size=(5, 5)))
    np.testing.assert_allclose(moved.markov(20), model.markov(20), atol=1e-10)
    u, y = np.array([2.0, 0.5, 10.0]), np.array([3.0, 0.1])
    other = model.rescaled(u, y)
    inputs = rng.normal(size=(50, 3))
    np.testing.assert_allclose(other.simulate(inputs * u), model.simulate(inputs) * y, atol=1e-12)
    a, c = output_normal(model.A, model.C)
    np.testing.assert_allclose(observability_gramian(a, c), np.eye(5), atol=1e-10)


def test_saved_and_read_back(tmp_path):
    model = system(6)
    np.savez(tmp_path / "model.npz", **model.to_arrays())
    with np.load(tmp_path / "model.npz", allow_pickle=False) as arrays:
        again = StateSpace.from_arrays(arrays)
    for name in "ABCD":
        np.testing.assert_array_equal(getattr(again, name), getattr(model, name))
    with pytest.raises(ContractError, match="lacks C"):
        StateSpace.from_arrays({"A": model.A, "B": model.B, "D": model.D})


def test_wrong_shapes_are_named():
    good = system(4)
    with pytest.raises(ContractError, match="B has shape"):
        StateSpace(good.A, good.B[:2], good.C, good.D)
    with pytest.raises(ContractError, match="C must be a matrix"):
        StateSpace(good.A, good.B, good.C[0], good.D)
    with pytest.raises(ContractError, match="A holds values that are not finite"):
        StateSpace(good.A * np.nan, good.B, good.C, good.D)
    with pytest.raises(ContractError, match=r"u must have shape \(..., frames, 3\)"):
        good.simulate(np.zeros((5, 2)))
    with pytest.raises(ContractError, match="x0 must have 4"):
        good.simulate(np.zeros((5, 3)), np.zeros(3))
    with pytest.raises(ContractError, match=r"u must have shape \(3,\)"):
        good.step(np.zeros(2))
    with pytest.raises(ValueError, match="read-only"):
        good.A[0, 0] = 1.0


def test_powers_and_the_last_state():
    a = system(4).A
    for count in (0, 1, 2, 3, 7, 16):
        wanted = [np.linalg.matrix_power(a, k) for k in range(count)]
        np.testing.assert_allclose(powers(a, count), np.array(wanted).reshape(count, 4, 4), atol=1e-12)
    drive = np.random.default_rng(0).normal(size=(3, 57, 4))
    states, last = propagate(a, drive)
    np.testing.assert_allclose(last, states[:, -1] @ a.T + drive[:, -1], atol=1e-12)
    pieces, state = [], None
    for begin in range(0, 57, 13):
        part, state = propagate(a, drive[:, begin : begin + 13], state)
        pieces.append(part)
    np.testing.assert_allclose(np.concatenate(pieces, axis=1), states, atol=1e-12)
    np.testing.assert_allclose(state, last, atol=1e-12)
