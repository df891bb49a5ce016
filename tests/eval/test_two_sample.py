from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eval.metrics.two_sample import (
    coverage,
    density,
    distances,
    expected_coverage,
    frechet,
    frechet_limit,
    frechet_of_moments,
    kernel_distance,
    over_draws,
    precision,
    radii,
    recall,
    spread,
)


def own(rows: np.ndarray) -> np.ndarray:
    """Every row a group of its own."""
    return np.arange(len(rows))


def test_frechet_of_shifted_and_stretched_gaussians(rng: np.random.Generator) -> None:
    d, n = 8, 100_000
    shift, stretch = rng.normal(size=d), rng.uniform(0.5, 2.0, d)
    exact = np.sum(shift**2) + np.sum((stretch - 1.0) ** 2)
    assert frechet_of_moments(np.zeros(d), np.eye(d), shift, np.diag(stretch**2)) == pytest.approx(exact)
    x, y = rng.normal(size=(n, d)), rng.normal(size=(n, d)) * stretch + shift
    assert frechet(x, y) == pytest.approx(exact, rel=0.02)


def test_frechet_of_covariances_that_do_not_commute() -> None:
    one, two = np.array([[2.0, 1.0], [1.0, 2.0]]), np.array([[3.0, -1.0], [-1.0, 1.0]])
    # In two dimensions tr sqrt(M) = sqrt(tr M + 2 sqrt(det M)), and M = S S' has the spectrum of the symmetric form.
    product = one @ two
    root = np.sqrt(np.trace(product) + 2.0 * np.sqrt(np.linalg.det(product)))
    expected = np.trace(one) + np.trace(two) - 2.0 * root
    assert frechet_of_moments(np.zeros(2), one, np.zeros(2), two) == pytest.approx(expected)
    assert frechet_of_moments(np.zeros(2), two, np.zeros(2), one) == pytest.approx(expected)


def test_frechet_of_a_few_rows_by_hand() -> None:
    # Means 1 and 2, variances 2 and 8: 1 + 2 + 8 - 2 * 4.
    assert frechet(np.array([[0.0], [2.0]]), np.array([[0.0], [4.0]])) == pytest.approx(3.0)


def test_frechet_of_singular_covariances() -> None:
    flat = np.diag([1.0, 0.0])
    assert frechet_of_moments(np.zeros(2), flat, np.array([0.0, 3.0]), flat) == pytest.approx(9.0)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), d=st.integers(1, 6))
def test_frechet_knows_no_axes_and_no_order(seed: int, d: int) -> None:
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=(30, d)), rng.normal(size=(40, d)) + 0.5
    turn = np.linalg.qr(rng.normal(size=(d, d)))[0]
    assert frechet(x @ turn, y @ turn) == pytest.approx(frechet(x, y), rel=1e-6, abs=1e-9)
    assert frechet(y, x[::-1]) == pytest.approx(frechet(x, y), rel=1e-6, abs=1e-9)
    assert frechet(x, x) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(("d", "n"), [(32, 128), (32, 400), (64, 256), (64, 600), (128, 512)])
def test_bias_of_frechet_between_equal_gaussians(d: int, n: int, rng: np.random.Generator) -> None:
    values = [frechet(rng.normal(size=(n, d)), rng.normal(size=(n, d))) for _ in range(8)]
    assert np.mean(values) == pytest.approx(0.53 * d * (d + 1) / n, rel=0.1)


def test_the_limit_takes_the_bias_away(rng: np.random.Generator) -> None:
    d, size = 10, 100
    limits, plain = [], []
    for _ in range(12):
        x, y = rng.normal(size=(200, d)), rng.normal(size=(200, d)) + 0.3
        limits.append(frechet_limit(x, y, size, draws=10, rng=rng))
        plain.append(over_draws(frechet, x, y, size, draws=10, rng=rng).mean())
    error = np.std(limits, ddof=1) / np.sqrt(len(limits))
    assert abs(np.mean(limits) - 0.09 * d) < 3.0 * error
    assert np.mean(plain) - 0.09 * d > 5.0 * error
    assert error < 0.1


def test_draws_are_of_equal_size_without_repetition(rng: np.random.Generator) -> None:
    x, y = np.arange(20.0)[:, None], np.arange(50.0)[:, None]
    seen = []
    over_draws(lambda a, b: float(seen.append((a, b)) or 0.0), x, y, 15, draws=5, rng=rng)
    for a, b in seen:
        assert len(np.unique(a)) == len(a) == len(np.unique(b)) == len(b) == 15


def test_kernel_distance_is_zero_on_average_and_its_error_is_right(rng: np.random.Generator) -> None:
    d = 8
    found = []
    for _ in range(60):
        x, y = rng.normal(size=(60, d)), rng.normal(size=(60, d))
        found.append(kernel_distance(x, y, own(x), own(y)))
    values, errors = np.array(found).T
    assert abs(values.mean()) < 3.0 * values.std(ddof=1) / np.sqrt(len(values))
    assert (values < 0.0).any(), "cut off at zero it would be biased"
    # Where nothing is different the jackknife counts the pairs twice and errs on the careful side.
    assert 1.0 < np.sqrt(np.mean(errors**2)) / values.std(ddof=1) < 2.0
    found = []
    for _ in range(60):
        x, y = rng.normal(size=(60, d)), rng.normal(size=(60, d)) + 0.5
        found.append(kernel_distance(x, y, own(x), own(y)))
    values, errors = np.array(found).T
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(values.std(ddof=1), rel=0.25)
    assert np.median(values / errors) > 3.0


def test_kernel_distance_by_its_definition(rng: np.random.Generator) -> None:
    x, y = rng.normal(size=(5, 3)), rng.normal(size=(4, 3))

    def kernel(a, b):
        return (a @ b / 3 + 1.0) ** 3

    within = [
        np.mean([kernel(rows[i], rows[j]) for i in range(len(rows)) for j in range(len(rows)) if i != j])
        for rows in (x, y)
    ]
    across = np.mean([kernel(a, b) for a in x for b in y])
    value = sum(within) - 2.0 * across
    assert kernel_distance(x, y, own(x), own(y)).value == pytest.approx(value)
    assert kernel_distance(y, x, own(y), own(x)).value == pytest.approx(value)


def test_rows_that_depend_on_one_another_do_not_bias_the_kernel_distance(rng: np.random.Generator) -> None:
    """Six windows of a clip that are nearly the same: the usual estimator calls two equal sets different."""
    grouped, usual = [], []
    for _ in range(80):
        clips = [np.repeat(rng.normal(size=(12, 4)), 6, axis=0) + 0.1 * rng.normal(size=(72, 4)) for _ in range(2)]
        labels = np.repeat(np.arange(12), 6)
        grouped.append(kernel_distance(*clips, labels, labels).value)
        usual.append(kernel_distance(*clips, own(clips[0]), own(clips[1])).value)
    error = np.std(grouped, ddof=1) / np.sqrt(len(grouped))
    assert abs(np.mean(grouped)) < 3.0 * error
    assert np.mean(usual) > 5.0 * error


def test_strata_do_not_bias_the_kernel_distance(rng: np.random.Generator) -> None:
    """Two clips of each of six actions that differ: without strata too few pairs within are of the same action."""
    centres = 2.0 * rng.normal(size=(6, 3))
    found: dict[str, list[float]] = {"with": [], "without": [], "apart": []}
    action, clip = np.repeat(np.arange(6), 6), np.repeat(np.arange(12), 3)
    few, first = np.repeat(np.arange(6), 12), np.repeat(np.arange(24), 3)
    for _ in range(80):
        x = centres[action] + rng.normal(size=(12, 3))[clip] + 0.1 * rng.normal(size=(36, 3))
        y = centres[few] + rng.normal(size=(24, 3))[first] + 0.1 * rng.normal(size=(72, 3))
        strata = {"x_strata": action, "y_strata": few}
        found["with"].append(kernel_distance(x, y, clip, first, **strata).value)
        found["without"].append(kernel_distance(x, y, clip, first).value)
        found["apart"].append(kernel_distance(x, y + 2.0, clip, first, **strata).value)
    mean, error = (f([found[name] for name in found], axis=1) for f in (np.mean, np.std))
    error = error / np.sqrt(80)
    assert abs(mean[0]) < 3.0 * error[0]
    assert mean[1] < -5.0 * error[1]
    assert mean[2] > 5.0 * error[2]


def test_strata_by_the_definition(rng: np.random.Generator) -> None:
    """Sum over pairs of strata of the products of their shares and the mean kernel of their rows."""
    x, y = rng.normal(size=(10, 2)), rng.normal(size=(8, 2))
    groups, strata = np.array([0, 0, 1, 1, 1, 2, 2, 3, 3, 3]), np.array([0] * 5 + [1] * 5)
    other_groups, other_strata = np.array([0, 1, 1, 2, 3, 3, 4, 4]), np.array([0, 0, 0, 0, 1, 1, 1, 1])

    def kernel(a, b):
        return (a @ b / 2 + 1.0) ** 3

    def within(rows, group, stratum):
        total = 0.0
        for a in (0, 1):
            for b in (0, 1):
                pairs = [
                    kernel(rows[i], rows[j])
                    for i in np.flatnonzero(stratum == a)
                    for j in np.flatnonzero(stratum == b)
                    if group[i] != group[j]
                ]
                total += np.mean(stratum == a) * np.mean(stratum == b) * np.mean(pairs)
        return total

    across = np.mean([kernel(a, b) for a in x for b in y])
    expected = within(x, groups, strata) + within(y, other_groups, other_strata) - 2.0 * across
    found = kernel_distance(x, y, groups, other_groups, x_strata=strata, y_strata=other_strata)
    assert found.value == pytest.approx(expected)

    # The jackknife leaves out one group after the other; rounds of the plain formula.
    variance = 0.0
    for rows, labels, layer, side in ((x, groups, strata, 0), (y, other_groups, other_strata, 1)):
        left = []
        for name in np.unique(labels):
            keep = labels != name
            pair = [(x, groups, strata), (y, other_groups, other_strata)]
            pair[side] = (rows[keep], labels[keep], layer[keep])
            (a, a_group, a_layer), (b, b_group, b_layer) = pair
            left.append(kernel_distance(a, b, a_group, b_group, x_strata=a_layer, y_strata=b_layer).value)
        variance += (len(left) - 1) / len(left) * np.sum((np.array(left) - np.mean(left)) ** 2)
    assert found.error == pytest.approx(np.sqrt(variance))


def test_a_stratum_of_a_single_group_counts_as_alike(rng: np.random.Generator) -> None:
    x, y = rng.normal(size=(30, 2)), rng.normal(size=(30, 2))
    strata = np.repeat([0, 1], 15)
    groups = np.where(strata == 0, np.arange(30), 99)
    x[strata == 1] += 5.0
    estimate = kernel_distance(x, y, groups, groups, x_strata=strata, y_strata=strata)
    assert np.isfinite(estimate.value) and np.isfinite(estimate.error)
    only_here = kernel_distance(x, y, groups, groups, x_strata=strata, y_strata=np.zeros(30, dtype=int))
    assert only_here.value > 0.0


def test_kernel_distance_of_two_groups_has_no_error(rng: np.random.Generator) -> None:
    x = rng.normal(size=(6, 2))
    labels = np.array([0, 0, 0, 1, 1, 1])
    estimate = kernel_distance(x, x + 1.0, labels, labels)
    assert np.isfinite(estimate.value) and np.isnan(estimate.error)


def test_coverage_of_equal_distributions_is_the_closed_form(rng: np.random.Generator) -> None:
    n, k = 100, 5
    assert expected_coverage(n, n, k) == pytest.approx(0.9711, abs=5e-4)
    values = [coverage(rng.normal(size=(n, 6)), rng.normal(size=(n, 6)), k) for _ in range(40)]
    assert abs(np.mean(values) - expected_coverage(n, n, k)) < 3.0 * np.std(values, ddof=1) / np.sqrt(40)
    few = [coverage(rng.normal(size=(50, 2)), rng.normal(size=(10, 2)), 3) for _ in range(200)]
    assert abs(np.mean(few) - expected_coverage(50, 10, 3)) < 3.0 * np.std(few, ddof=1) / np.sqrt(200)


def test_density_of_equal_distributions_is_one(rng: np.random.Generator) -> None:
    values = [density(rng.normal(size=(150, 4)), rng.normal(size=(150, 4)), 5) for _ in range(40)]
    assert abs(np.mean(values) - 1.0) < 3.0 * np.std(values, ddof=1) / np.sqrt(40)


def test_neighbourhoods_of_planted_points() -> None:
    """Real motion at 0, 1, 2 and 10, 11, 12; ours covers the first three and strays once."""
    real = np.array([[0.0], [1.0], [2.0], [10.0], [11.0], [12.0]])
    ours = np.array([[0.1], [1.1], [1.9], [100.0]])
    np.testing.assert_allclose(radii(real, 1), np.ones(6))
    np.testing.assert_allclose(radii(real, 2), [2.0, 1.0, 2.0, 2.0, 1.0, 2.0])
    assert precision(real, ours, 1) == 0.75
    assert coverage(real, ours, 1) == 0.5
    # 0.1 lies within 1 of 0 and 1, 1.1 of 1 and 2, 1.9 of 1 and 2.
    assert density(real, ours, 1) == 6 / 4
    # The neighbourhood of the stray point reaches to 1.9 and so holds 2 and all that is above.
    assert recall(real, ours, 1) == 1.0
    assert recall(real, ours[:3], 1) == 0.5


def test_a_collapsed_set_is_precise_and_covers_little(rng: np.random.Generator) -> None:
    real = rng.normal(size=(100, 3))
    ours = 0.01 * rng.normal(size=(100, 3))
    assert precision(real, ours, 5) == 1.0
    assert recall(real, ours, 5) < 0.05
    assert coverage(real, ours, 5) < 0.3


def test_distances_and_spread() -> None:
    x = np.array([[0.0, 0.0], [3.0, 4.0], [0.0, 1e-9]])
    np.testing.assert_allclose(distances(x, x)[0], [0.0, 5.0, 1e-9], atol=1e-8)
    assert spread(x[:2], np.array([0, 1])) == pytest.approx(5.0)
    # Windows of one clip are not compared.
    assert spread(np.array([[0.0], [100.0], [51.0]]), np.array([0, 0, 1])) == pytest.approx(50.0)
