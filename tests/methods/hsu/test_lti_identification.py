"""Identification against systems that are known: Markov parameters and poles, never the matrices themselves."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.errors import BenchmarkError, ContractError, DataError
from methods.hsu.lti import (
    IdentificationWarning,
    RankDeficientWarning,
    Records,
    StateSpace,
    fit_lti,
    identify,
    longest_radius,
)
from methods.hsu.lti.covariance import covariance_factor
from methods.hsu.lti.input_matrices import InputProblems, IteratedProblem, lagged_problem, reduced_problem
from methods.hsu.lti.lags import lag_factor
from methods.hsu.lti.order import order_grid, simulation_error, split_off
from methods.hsu.lti.stability import WAYS, output_normal, radius, stabilised
from methods.hsu.lti.subspace import identify_subspace

RHO = longest_radius()


def system(order: int, inputs: int = 3, outputs: int = 3, *, rho: float = 0.9, seed: int = 0) -> StateSpace:
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(order, order))
    a *= rho / np.abs(np.linalg.eigvals(a)).max()
    return StateSpace(
        a, rng.normal(size=(order, inputs)), rng.normal(size=(outputs, order)), rng.normal(size=(outputs, inputs))
    )


def recorded(truth: StateSpace, lengths, *, noise: float = 0.0, seed: int = 1, smooth: bool = False):
    rng = np.random.default_rng(seed)
    inputs = [rng.normal(size=(length, truth.inputs)) for length in lengths]
    if smooth:
        inputs = [0.2 * np.cumsum(u, axis=0) for u in inputs]
    outputs = [truth.simulate(u) for u in inputs]
    size = np.concatenate(outputs).std(axis=0)
    return inputs, [y + noise * size * rng.normal(size=y.shape) for y in outputs]


def markov_error(model: StateSpace, truth: StateSpace, count: int = 40) -> float:
    wanted = truth.markov(count)
    return float(np.abs(model.markov(count) - wanted).max() / np.abs(wanted).max())


def jump(rng: np.random.Generator, frames: int = 45) -> np.ndarray:
    """Three smooth channels that crouch, rise and settle, like a joint in a jump."""
    t = np.linspace(0.0, 1.0, frames)[:, None]
    centre, width = rng.uniform(0.3, 0.6, 3), rng.uniform(0.06, 0.15, 3)
    dip = np.exp(-(((t - centre) / width) ** 2))
    rise = np.exp(-(((t - centre - 0.2) / (1.3 * width)) ** 2))
    return rng.uniform(0.5, 1.5, 3) * dip - rng.uniform(0.3, 1.0, 3) * rise + 0.02 * rng.normal(size=(frames, 3))


@pytest.mark.parametrize("transition", ["state", "shift"])
@pytest.mark.parametrize("weight", ["moesp", "n4sid"])
@pytest.mark.parametrize("lengths", [[1500], [300, 700, 150, 61, 39, 1, 20, 450]])
def test_a_sixth_order_system_is_recovered_to_rounding(weight, lengths, transition):
    truth = system(6)
    found = identify(*recorded(truth, lengths), 6, weight=weight, transition=transition)
    assert found.transition == transition
    assert markov_error(found.model, truth) < 1e-12
    np.testing.assert_allclose(found.model.poles(), truth.poles(), atol=1e-10)
    assert found.singular_values[5] / found.singular_values[6] > 1e10
    assert found.rank == found.rank_needed == 2 * 20 * 3 + 6
    assert not found.stabilised
    assert found.ridge == 0.0
    assert found.train_error < 1e-12


@pytest.mark.parametrize("transition", ["state", "shift"])
@pytest.mark.parametrize("weight", ["moesp", "n4sid"])
def test_one_per_cent_of_noise(weight, transition):
    truth = system(6)
    found = identify(*recorded(truth, [3000], noise=0.01), 6, weight=weight, transition=transition)
    assert markov_error(found.model, truth) < 2e-3
    assert found.singular_values[5] / found.singular_values[6] > 10.0


def test_several_channels_of_other_units_change_nothing():
    truth = system(5, inputs=2, outputs=4)
    inputs, outputs = recorded(truth, [400, 300], noise=0.01)
    u_scale, y_scale = np.array([1e-3, 50.0]), np.array([1e4, 1.0, 1e-6, 3.0])
    plain = fit_lti(inputs, outputs, 5)
    other = fit_lti([u * u_scale for u in inputs], [y * y_scale for y in outputs], 5)
    np.testing.assert_allclose(other.rescaled(1.0 / u_scale, 1.0 / y_scale).markov(30), plain.markov(30), atol=1e-10)


def test_the_regression_for_b_and_d_is_the_least_squares_solution():
    truth = system(4, inputs=2, outputs=3)
    records = Records.of(*recorded(truth, [60, 25, 90], noise=0.1))
    a, c = output_normal(truth.A, truth.C)
    b, d = reduced_problem(records, a, c).solve()
    # Each unknown by itself, set to one, gives a column of the plain dense problem.
    columns = []
    for index in range(4 * 2 + 3 * 2):
        unit = np.zeros(14)
        unit[index] = 1.0
        model = StateSpace(a, unit[:8].reshape(4, 2), c, unit[8:].reshape(3, 2))
        columns.append(np.concatenate([model.simulate(u).ravel() for u in records.inputs]))
    target = np.concatenate([y.ravel() for y in records.outputs])
    dense = np.linalg.lstsq(np.stack(columns, axis=1), target, rcond=None)[0]
    np.testing.assert_allclose(np.concatenate([b.ravel(), d.ravel()]), dense, atol=1e-10)
    smaller, gain = reduced_problem(records, a, c).solve(ridge=0.1)
    assert np.linalg.norm(smaller) < np.linalg.norm(b)
    # The same from the lag factor, and by iteration.
    lagged = lagged_problem(lag_factor(records, 90), 2, a, c)
    np.testing.assert_allclose(lagged.solve()[0], b, atol=1e-10)
    np.testing.assert_allclose(lagged.solve()[1], d, atol=1e-10)
    np.testing.assert_allclose(lagged.solve(0.1)[0], smaller, atol=1e-10)
    np.testing.assert_allclose(lagged.solve(0.1)[1], gain, atol=1e-10)
    iterated = IteratedProblem(records, a, c)
    np.testing.assert_allclose(iterated.solve()[0], b, atol=1e-5)
    np.testing.assert_allclose(iterated.solve()[1], d, atol=1e-5)
    assert np.linalg.norm(iterated.solve(0.1)[0]) < np.linalg.norm(b)


def test_a_long_record_in_pieces_gives_the_same_regression(monkeypatch):
    truth = system(7, inputs=2, outputs=2)
    records = Records.of(*recorded(truth, [700, 30, 400], noise=0.1))
    a, c = output_normal(truth.A, truth.C)
    whole = reduced_problem(records, a, c).solve()
    monkeypatch.setattr("methods.hsu.lti.input_matrices._ROOM", 28 * 300)
    for part, full in zip(reduced_problem(records, a, c).solve(), whole, strict=True):
        np.testing.assert_allclose(part, full, atol=1e-10)


def test_the_form_of_the_regression_follows_its_size(monkeypatch):
    truth = system(4)
    records = Records.of(*recorded(truth, [80] * 20))
    assert isinstance(InputProblems(records).of(truth.A, truth.C).solve()[0], np.ndarray)
    monkeypatch.setattr("methods.hsu.lti.input_matrices._MANY", 1.0)
    assert isinstance(InputProblems(records).of(truth.A, truth.C), IteratedProblem)
    assert not isinstance(InputProblems(records, many=True).of(truth.A, truth.C), IteratedProblem)


def test_the_covariance_gives_the_factor_of_the_reflections(monkeypatch):
    truth = system(6)
    noisy = Records.of(*recorded(truth, [300, 50, 20, 90], noise=0.02))
    plain = identify_subspace(noisy, 12)
    monkeypatch.setattr("methods.hsu.lti.subspace._WIDE", 1)
    quick = identify_subspace(noisy, 12)
    np.testing.assert_allclose(quick.singular_values, plain.singular_values, rtol=1e-7)
    assert quick.rank == plain.rank == 2 * 12 * 6
    for way in ("shift", "state"):
        mine, theirs = (StateSpace(*both(sub.transition(6, way))).markov(20) for sub in (quick, plain))
        np.testing.assert_allclose(mine, theirs, atol=1e-6)
    # Without noise it is singular, and reflections take over.
    clean = Records.of(*recorded(truth, [300, 50, 20, 90]))
    assert covariance_factor(clean, 12) is None
    assert identify_subspace(clean, 12).rank == 2 * 12 * 3 + 6


def both(pair: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A pair with an input that does not depend on its basis: the first outputs back."""
    a, c = pair
    return a, np.linalg.pinv(np.concatenate([c, c @ a]))[:, :3], c, np.zeros((3, 3))


def test_hankel_columns_never_straddle_a_seam():
    truth = system(6)
    inputs, outputs = recorded(truth, [200, 120, 39])
    apart = identify_subspace(Records.of(inputs, outputs), 20)
    assert apart.columns == 161 + 81
    joined = identify_subspace(Records.of(np.concatenate(inputs), np.concatenate(outputs)), 20)
    assert apart.singular_values[6] < 1e-10 * apart.singular_values[0]
    # Over the seam the state jumps, and the joined record is of no sixth-order system.
    assert joined.singular_values[6] > 1e-3 * joined.singular_values[0]


def tiled(seed: int, frames: int = 45) -> tuple[np.ndarray, np.ndarray]:
    """A clip and what a short impulse response makes of it, each repeated 28 times, as in the poster."""
    u = jump(np.random.default_rng(seed), frames)
    y = np.stack([np.convolve(u[:, k], [0.5, 0.4, -0.2, 0.1])[:frames] for k in range(3)], axis=1)
    return np.tile(u, (28, 1)), np.tile(y, (28, 1))


@pytest.mark.parametrize("weight", ["moesp", "n4sid"])
@pytest.mark.parametrize("seed", range(3))
def test_a_tiled_clip_that_has_no_states_gets_an_impulse_response(seed, weight):
    """45 frames are fewer than the 60 rows of future inputs: these alone say everything of the record."""
    u, y = tiled(seed)
    with pytest.warns(RankDeficientWarning, match=r"rank \d+ < 2im\+n = 160 .* there are no states"):
        found = identify(u, y, 40, weight=weight)
    assert found.method == "kernel-fir"
    assert found.model.spectral_radius <= RHO
    assert np.isfinite(found.model.simulate(np.tile(u, (4, 1)))).all()
    assert found.train_error < 0.2


@pytest.mark.parametrize("weight", ["moesp", "n4sid"])
@pytest.mark.parametrize("seed", range(3))
def test_a_tiled_clip_warns_is_stable_and_does_not_depend_on_rounding(seed, weight):
    u, y = tiled(seed, 81)
    with (
        pytest.warns(RankDeficientWarning, match=r"rank \d+ < 2im\+n = 160"),
        pytest.warns(IdentificationWarning, match=r"order 40 was asked for, but .* has only \d+ directions"),
    ):
        found = identify(u, y, 40, weight=weight)
    assert found.rank < found.rank_needed == 160
    # A record of period 81 has rank 81 at most, of which future inputs take 60.
    assert 0 < found.order == found.model.order <= 21
    assert (found.transition, found.ridge) == ("shift", 1e-2)
    assert found.model.spectral_radius <= RHO
    assert np.isfinite(found.model.simulate(np.tile(u, (4, 1)))).all()
    assert found.train_error < 0.2
    rng = np.random.default_rng(seed)
    with pytest.warns(RankDeficientWarning), pytest.warns(IdentificationWarning):
        again = identify(*(x * (1.0 + 1e-15 * rng.normal(size=x.shape)) for x in (u, y)), 40, weight=weight)
    assert again.order == found.order
    np.testing.assert_allclose(again.model.markov(30), found.model.markov(30), atol=1e-6)


def test_states_beyond_the_truth_s_are_left_out():
    truth = system(6)
    data = recorded(truth, [400])
    with pytest.warns(RankDeficientWarning), pytest.warns(IdentificationWarning, match="order 10 was asked for"):
        found = identify(*data, 10)
    assert found.order == 6
    np.testing.assert_allclose(found.model.markov(40), truth.markov(40), atol=1e-9)


def test_an_unstable_truth_gives_a_stable_model():
    truth = system(6, rho=1.03)
    found = identify(*recorded(truth, [90] * 12), 6)
    assert found.spectral_radius_found == pytest.approx(1.03, abs=1e-6)
    assert found.stabilised
    assert found.stabilised_by in WAYS
    assert found.ridge == 1e-4
    assert found.model.spectral_radius <= RHO
    assert found.train_error < 1.0


def test_a_stable_model_is_not_touched():
    truth = system(6, rho=0.98)
    data = recorded(truth, [800], noise=0.01)
    free, bounded = identify(*data, 6, rho_max=0.999999), identify(*data, 6)
    assert not bounded.stabilised
    np.testing.assert_array_equal(free.model.A, bounded.model.A)
    np.testing.assert_array_equal(free.model.markov(50), bounded.model.markov(50))
    a = truth.A
    assert all(stabilised(a, 0.99, way) is a for way in WAYS)


def test_clipping_leaves_the_poles_inside_alone():
    a = system(8, rho=1.2, seed=3).A
    before = np.linalg.eigvals(a)
    clipped = np.linalg.eigvals(stabilised(a, 0.95, "clip"))
    for pole in before[np.abs(before) < 0.95]:
        assert np.abs(clipped - pole).min() < 1e-10
    outside = before[np.abs(before) > 0.95]
    for pole in outside:
        assert np.abs(clipped - 0.95 * pole / abs(pole)).min() < 1e-10
    scaled = np.linalg.eigvals(stabilised(a, 0.95, "scale"))
    np.testing.assert_allclose(np.sort(np.abs(scaled)), np.sort(np.abs(before)) * 0.95 / 1.2, atol=1e-10)


def test_the_order_is_that_of_the_truth_or_simulates_as_well():
    truth = system(6, seed=4)
    inputs, outputs = recorded(truth, [100] * 30, noise=0.02, smooth=True)
    fresh = Records.of(*recorded(truth, [100] * 5, seed=9, smooth=True))
    known, chosen = fit_lti(inputs, outputs, 6), identify(inputs, outputs, None)
    assert set(chosen.scores) == set(order_grid())
    assert simulation_error(chosen.model, fresh) <= 1.05 * simulation_error(known, fresh)
    assert 5 <= chosen.order <= 10
    assert chosen.refitted
    assert chosen.held_out_error == pytest.approx(0.02, abs=0.02)


def test_a_static_gain_is_found_and_never_lost_to():
    rng = np.random.default_rng(0)
    gain = rng.normal(size=(3, 3))
    inputs = [rng.normal(size=(80, 3)) for _ in range(12)]
    outputs = [u @ gain.T + 0.05 * rng.normal(size=u.shape) for u in inputs]
    found = identify(inputs, outputs, "auto", method="auto")
    assert (found.method, found.order) == ("static", 0)
    np.testing.assert_allclose(found.model.D, gain, atol=0.01)
    assert fit_lti(inputs, outputs, 0).order == 0
    # Outputs that have nothing to do with the inputs: dynamics could only harm.
    unrelated = [rng.normal(size=(80, 3)) for _ in range(12)]
    held = (inputs[:3], unrelated[:3])
    chosen = identify(inputs[3:], unrelated[3:], None, validation=held, method="auto")
    static = identify(inputs[3:], unrelated[3:], 0, validation=held)
    assert chosen.held_out_error <= static.held_out_error * (1.0 + 1e-9)


@pytest.mark.parametrize("method", ["subspace", "kernel-fir", "auto"])
def test_each_method_beats_half_a_static_gain_on_a_synthetic_jump(method):
    rng = np.random.default_rng(5)
    taps = 0.9 ** np.arange(12)[:, None, None] * rng.normal(size=(12, 3, 3)) / 3.0
    clips = [jump(rng) for _ in range(18)]

    def respond(u: np.ndarray) -> np.ndarray:
        return sum(np.concatenate([np.zeros((k, 3)), u[: len(u) - k]]) @ taps[k].T for k in range(12))

    outputs = [respond(u) for u in clips]
    noisy = [y + 0.01 * y.std() * rng.normal(size=y.shape) for y in outputs]
    fresh = Records.of(clips[10:], outputs[10:])
    model = fit_lti(clips[:10], noisy[:10], None, method=method)
    assert simulation_error(model, fresh) <= 0.5 * simulation_error(fit_lti(clips[:10], noisy[:10], 0), fresh)


def test_a_validation_set_that_is_given_is_never_fitted_to():
    truth = system(4)
    inputs, outputs = recorded(truth, [100] * 8, noise=0.05)
    held = (inputs[6:], outputs[6:])
    found = identify(inputs[:6], outputs[:6], None, validation=held)
    assert not found.refitted
    unscaled = simulation_error(found.model, Records.of(*held))
    assert found.held_out_error == pytest.approx(unscaled, rel=0.3)
    kept = fit_lti(inputs[:6], outputs[:6], found.order, ridge=found.ridge, transition=found.transition)
    np.testing.assert_allclose(found.model.markov(20), kept.markov(20), atol=1e-12)


def test_what_is_held_out():
    many = Records([np.zeros((5, 1))] * 10, [np.zeros((5, 1))] * 10)
    split = split_off(many, 0.2)
    assert (len(split.train), len(split.judged), split.skip, split.held_out) == (8, 2, 0, True)
    one = Records([np.arange(200.0)[:, None]], [np.zeros((200, 1))])
    split = split_off(one, 0.2)
    assert (split.train.frames, split.judged.frames, split.skip) == (160, 200, 160)
    short = split_off(Records([np.zeros((30, 1))], [np.zeros((30, 1))]), 0.2)
    assert not short.held_out


def test_a_single_recording_has_its_tail_held_out_and_a_short_one_goes_by_bic():
    truth = system(4, seed=2)
    long = identify(*recorded(truth, [600], noise=0.02), None)
    assert np.isfinite(long.held_out_error)
    assert 3 <= long.order <= 10
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        short = identify(*recorded(truth, [45], noise=0.02), None)
    assert np.isnan(short.held_out_error)
    assert short.order < 40


def test_short_recordings_take_fewer_block_rows_or_another_method():
    truth = system(4)
    with pytest.warns(IdentificationWarning, match="block rows instead of 20"):
        fewer = identify(*recorded(truth, [30] * 20), 4)
    assert 3 <= fewer.block_rows < 20
    assert markov_error(fewer.model, truth, 20) < 1e-10
    with pytest.warns(IdentificationWarning, match="too short for a subspace method of order 40"):
        other = identify(*recorded(truth, [20] * 20), 40)
    assert other.method == "kernel-fir"
    assert other.model.spectral_radius <= RHO
    assert other.train_error < 0.3


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 2**31),
    lengths=st.lists(st.integers(1, 70), min_size=1, max_size=4),
    order=st.sampled_from([None, 0, 1, 7, 40]),
    kind=st.sampled_from(["noise", "walk", "growing", "constant", "zero", "huge", "tiny", "tiled", "one channel"]),
    method=st.sampled_from(["subspace", "kernel-fir", "auto"]),
)
def test_whatever_the_record_the_model_is_stable(seed, lengths, order, kind, method):
    rng = np.random.default_rng(seed)
    inputs = [rng.normal(size=(length, 3)) for length in lengths]
    outputs = [rng.normal(size=(length, 3)) for length in lengths]
    if kind == "walk":
        inputs, outputs = [np.cumsum(u, 0) for u in inputs], [np.cumsum(y, 0) for y in outputs]
    elif kind == "growing":
        outputs = [y * 1.3 ** np.arange(len(y))[:, None] for y in outputs]
    elif kind == "constant":
        inputs, outputs = [np.ones_like(u) for u in inputs], [np.full_like(y, 2.0) for y in outputs]
    elif kind == "zero":
        inputs, outputs = [0.0 * u for u in inputs], [0.0 * y for y in outputs]
    elif kind in ("huge", "tiny"):
        factor = 1e150 if kind == "huge" else 1e-150
        inputs, outputs = [factor * u for u in inputs], [factor * y for y in outputs]
    elif kind == "tiled":
        inputs, outputs = [np.tile(u, (5, 1)) for u in inputs], [np.tile(y, (5, 1)) for y in outputs]
    elif kind == "one channel":
        inputs, outputs = [u * [1, 0, 0] for u in inputs], [y * [0, 1, 0] for y in outputs]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        found = identify(inputs, outputs, order, method=method)
    assert found.model.spectral_radius <= RHO
    assert found.order == found.model.order
    if order is not None:
        assert found.order <= order
    assert np.isfinite(found.train_error)
    assert all(np.isfinite(found.model.simulate(u)).all() for u in inputs)


def test_bad_input_is_named():
    u, y = np.zeros((50, 3)), np.zeros((50, 3))
    with pytest.raises(ContractError, match="50 input but 49 output frames"):
        fit_lti(u, y[:49], 2)
    with pytest.raises(ContractError, match="2 recordings of inputs but 1 of outputs"):
        fit_lti([u, u], [y], 2)
    with pytest.raises(ContractError, match="other channels than recording 0"):
        fit_lti([u, u[:, :2]], [y, y], 2)
    with pytest.raises(ContractError, match=r"must be \(frames, channels\)"):
        fit_lti(u[:, 0], y, 2)
    with pytest.raises(DataError, match="no frame"):
        fit_lti(u[:0], y[:0], 2)
    with pytest.raises(DataError, match="no inputs"):
        fit_lti([], [], 2)
    broken = y.copy()
    broken[7, 1] = np.nan
    with pytest.raises(DataError, match="outputs 0 holds nan at frame 7, channel 1"):
        fit_lti(u, broken, 2)
    for options in (
        {"order": -1},
        {"order": 2.5},
        {"order": "many"},
        {"method": "arx"},
        {"weight": "cva"},
        {"transition": "jump"},
        {"ridge": -1.0},
        {"rho_max": 1.0},
        {"max_order": -1},
        {"block_rows": 0},
        {"validation": 1.5},
        {"validation": (u[:, :2], y)},
    ):
        with pytest.raises(ContractError):
            fit_lti(u, y, **options)
    assert issubclass(ContractError, BenchmarkError)


def test_degenerate_but_meaningful_records():
    one = identify(np.ones((1, 2)), np.array([[3.0, 0.0]]), None)
    np.testing.assert_allclose(one.model.simulate(np.ones((1, 2))), [[3.0, 0.0]], atol=1e-12)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        silent = identify(np.zeros((100, 2)), np.zeros((100, 2)), 4)
        nested = fit_lti([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]], [[1.0], [2.0], [3.0]], 0)
    np.testing.assert_array_equal(silent.model.markov(5), 0.0)
    assert (nested.inputs, nested.outputs) == (2, 1)
    assert radius(np.array([[np.nan]])) == np.inf
