"""The kernel-regularised impulse response, its realisation, and output-error refinement."""

from __future__ import annotations

import numpy as np
import pytest

from methods.hsu.lti import Records, StateSpace, fit_lti, identify, kernel_fir, longest_radius, realize
from methods.hsu.lti.kernel_fir import tc_factor, usual_taps
from methods.hsu.lti.order import simulation_error, split_off
from methods.hsu.lti.refine import IllConditionedError, OutputError, refine

RHO = longest_radius()


def system(order: int, *, rho: float = 0.85, seed: int = 0) -> StateSpace:
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(order, order))
    a *= rho / np.abs(np.linalg.eigvals(a)).max()
    return StateSpace(a, rng.normal(size=(order, 3)), rng.normal(size=(3, order)), rng.normal(size=(3, 3)))


def recorded(truth: StateSpace, lengths, *, noise: float = 0.0, seed: int = 1, walk: bool = False) -> Records:
    rng = np.random.default_rng(seed)
    inputs = [rng.normal(size=(length, 3)) for length in lengths]
    if walk:
        inputs = [0.2 * np.cumsum(u, axis=0) for u in inputs]
    outputs = [truth.simulate(u) for u in inputs]
    size = np.concatenate(outputs).std()
    return Records(inputs, [y + noise * size * rng.normal(size=y.shape) for y in outputs])


def test_the_kernel_factor():
    lags = np.arange(1, 8)
    wanted = 0.7 ** np.maximum(lags[:, None], lags[None])
    np.testing.assert_allclose(tc_factor(7, 0.7) @ tc_factor(7, 0.7).T, wanted, atol=1e-14)


def test_a_finite_response_is_found_with_zero_initial_conditions():
    rng = np.random.default_rng(0)
    taps = 0.6 ** np.arange(10)[:, None, None] * rng.normal(size=(10, 2, 3))
    inputs = [rng.normal(size=(length, 3)) for length in (60, 80, 45, 90)]
    outputs = [sum(np.concatenate([np.zeros((k, 3)), u[: len(u) - k]]) @ taps[k].T for k in range(10)) for u in inputs]
    found = kernel_fir(Records(inputs, outputs), taps=40)
    np.testing.assert_allclose(found.markov[:10], taps, atol=1e-3)
    np.testing.assert_allclose(found.markov[10:], 0.0, atol=1e-3)
    noisy = [y + 0.05 * y.std() * rng.normal(size=y.shape) for y in outputs]
    estimated = kernel_fir(Records(inputs, noisy), taps=40)
    np.testing.assert_allclose(estimated.noise, 0.05 * np.concatenate(outputs).std(), rtol=0.3)
    # Plain least squares with as many taps is far worse: that is what the prior is for.
    rows = np.concatenate(
        [
            np.stack([np.concatenate([np.zeros((k, 3)), u])[: len(u)] for k in range(40)], axis=1).reshape(len(u), -1)
            for u in inputs
        ]
    )
    plain = np.linalg.lstsq(rows, np.concatenate(noisy), rcond=None)[0].reshape(40, 3, 2).transpose(0, 2, 1)
    wanted = np.concatenate([taps, np.zeros((30, 2, 3))])
    assert np.linalg.norm(estimated.markov - wanted) < 0.5 * np.linalg.norm(plain - wanted)


def test_the_likelihood_is_that_of_the_dense_covariance():
    from methods.hsu.lti.kernel_fir import _Likelihood
    from methods.hsu.lti.lags import lag_factor

    rng = np.random.default_rng(2)
    inputs, outputs = [rng.normal(size=(30, 2))], [rng.normal(size=(30, 1))]
    triangle = lag_factor(Records(inputs, outputs), 5)
    got = _Likelihood(triangle[:10, :10], triangle[:10, 10:], np.sum(triangle[10:, 10:] ** 2, axis=0), 30, 5, 2, 0.8)
    regressors = np.stack([np.concatenate([np.zeros((k, 2)), inputs[0]])[:30] for k in range(5)], axis=1)
    kernel = np.kron(tc_factor(5, 0.8) @ tc_factor(5, 0.8).T, np.eye(2))
    flat = regressors.reshape(30, 10)
    y = outputs[0][:, 0]
    for place in (0, 20, 40, 56):
        covariance = flat @ kernel @ flat.T + got.noises[place] * np.eye(30)
        quadratic = y @ np.linalg.solve(covariance, y)
        wanted = 30 * np.log(quadratic / 30) + np.linalg.slogdet(covariance)[1]
        assert got.values[0, place] == pytest.approx(wanted, rel=1e-6)
    best = int(np.argmin(got.values[0]))
    mean = kernel @ flat.T @ np.linalg.solve(flat @ kernel @ flat.T + got.noises[best] * np.eye(30), y)
    np.testing.assert_allclose(got.response(0)[0].ravel(), mean, atol=1e-10)


def test_the_number_of_taps_follows_the_recordings():
    def of(frames: int) -> Records:
        return Records([np.zeros((frames, 1))], [np.zeros((frames, 1))])

    assert [usual_taps(of(frames)) for frames in (1, 30, 50, 100, 500)] == [1, 30, 40, 75, 90]


def test_a_realisation_has_the_response_it_was_made_from():
    truth = system(5)
    markov = truth.markov(200)
    whole = realize(markov, 40)
    assert whole.singular_values[4] > 1e6 * whole.singular_values[5]
    np.testing.assert_allclose(whole.model(5).markov(60), markov[:60], atol=1e-9)
    finite = np.random.default_rng(0).normal(size=(6, 2, 2))
    model = realize(finite, 40).model(40)
    assert model.order == 10
    np.testing.assert_allclose(model.markov(12), np.concatenate([finite, np.zeros((6, 2, 2))]), atol=1e-12)
    # Every truncation is stable, whatever the response.
    for order in range(11):
        assert realize(finite, 40).model(order).spectral_radius < 1.0
    assert realize(finite[:1], 40).model(3).order == 0


def test_kernel_path_simulates_an_infinite_response():
    truth = system(6)
    records = recorded(truth, [100] * 20, noise=0.01)
    fresh = recorded(truth, [100] * 4, seed=7)
    found = identify(records.inputs, records.outputs, None, method="kernel-fir")
    assert found.method == "kernel-fir"
    assert simulation_error(found.model, fresh) < 0.02
    assert found.model.spectral_radius <= RHO
    # The same in other units.
    scaled = identify([1e3 * u for u in records.inputs], [1e-3 * y for y in records.outputs], None, method="kernel-fir")
    np.testing.assert_allclose(1e6 * scaled.model.markov(20), found.model.markov(20), atol=1e-8)


@pytest.mark.parametrize("order", [1, 4, 7])
def test_the_gradient_of_the_simulated_error(order):
    truth = system(6)
    records = recorded(truth, [40, 25, 60], noise=0.1)
    model = fit_lti(records.inputs, records.outputs, order, block_rows=7)
    objective = OutputError(model, records, RHO)
    np.testing.assert_allclose(objective.model(objective.start).markov(30), model.markov(30), atol=1e-9)
    value, gradient = objective(objective.start)
    residual = [y - model.simulate(u) for u, y in zip(records.inputs, records.outputs, strict=True)]
    assert value == pytest.approx(0.5 * sum(np.sum(part**2) for part in residual), rel=1e-9)
    rng = np.random.default_rng(3)
    for _ in range(4):
        direction = rng.normal(size=len(gradient))
        step = 1e-6 * direction
        slope = (objective(objective.start + step)[0] - objective(objective.start - step)[0]) / 2e-6
        assert gradient @ direction == pytest.approx(slope, rel=1e-5, abs=1e-6)
    # No parameter vector leaves the circle.
    for _ in range(10):
        assert objective.model(rng.normal(0.0, 50.0, len(gradient))).spectral_radius <= RHO + 1e-12


def test_refinement_improves_a_model_that_is_too_small_and_never_harms():
    truth = system(8, seed=4)
    gains = []
    for seed in range(4):
        records = recorded(truth, [100] * 15, noise=0.05, seed=seed, walk=True)
        split = split_off(records, 0.2)
        for order in (3, 5):
            start = fit_lti(split.train.inputs, split.train.outputs, order)
            result = refine(start, split, RHO, iterations=60)
            before, after = simulation_error(start, split.judged), simulation_error(result.model, split.judged)
            assert after <= before
            assert result.accepted == (after < before)
            assert result.train_after <= result.train_before * (1.0 + 1e-9)
            assert result.model.spectral_radius <= RHO
            gains.append(1.0 - after / before)
    assert np.median(gains) > 0.005
    assert max(gains) > 0.03


def test_refinement_through_identify():
    truth = system(8, seed=4)
    records = recorded(truth, [100] * 15, noise=0.05, walk=True)
    plain = identify(records.inputs, records.outputs, 3, validation=0.2, refit=False)
    refined = identify(records.inputs, records.outputs, 3, refine=True, refit=False)
    assert refined.held_out_error <= plain.held_out_error
    assert refined.refined
    assert refined.order == 3


def test_a_model_with_a_double_pole_is_left_alone():
    double = StateSpace(np.array([[0.5, 1.0], [0.0, 0.5]]), np.ones((2, 3)), np.ones((3, 2)), np.zeros((3, 3)))
    records = recorded(double, [50] * 5, noise=0.1)
    with pytest.raises(IllConditionedError):
        OutputError(double, records, RHO)
    result = refine(double, split_off(records, 0.2), RHO)
    assert result.model is double
    assert not result.accepted
