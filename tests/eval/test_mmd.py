"""Gaussian-kernel discrepancy: closed form, definition, uniform p under the null, power, clips as units."""

from __future__ import annotations

import numpy as np
import pytest

from eval.metrics.mmd import TwoSample, median_bandwidth, two_sample


def own(rows: np.ndarray) -> np.ndarray:
    return np.arange(len(rows))


def compared(x: np.ndarray, y: np.ndarray, bandwidth: float = 1.0, **more) -> TwoSample:
    return two_sample(x, y, own(x), own(y), bandwidth=bandwidth, **more)


def exact(shift: np.ndarray, bandwidth: float) -> float:
    """Squared discrepancy of N(0, I) and N(shift, I): the kernel's mean is that of a Gaussian convolved with both."""
    d, wide = len(shift), bandwidth**2 + 2.0
    return float(2.0 * (bandwidth**2 / wide) ** (d / 2) * (1.0 - np.exp(-(shift @ shift) / (2.0 * wide))))


def test_gaussians_have_a_closed_form(rng) -> None:
    shift, bandwidth = np.array([0.8, -0.3, 0.0]), 1.7
    values = [
        float(compared(rng.normal(size=(150, 3)), rng.normal(size=(200, 3)) + shift, bandwidth).discrepancy())
        for _ in range(40)
    ]
    error = np.std(values, ddof=1) / np.sqrt(len(values))
    assert abs(np.mean(values) - exact(shift, bandwidth)) < 3.5 * error
    assert error < 0.05 * exact(shift, bandwidth)


def test_it_is_without_bias_where_nothing_differs(rng) -> None:
    values = [
        float(compared(rng.normal(size=(30, 4)), rng.normal(size=(40, 4)), 2.0).discrepancy()) for _ in range(150)
    ]
    assert abs(np.mean(values)) < 3.5 * np.std(values, ddof=1) / np.sqrt(len(values))
    assert min(values) < 0.0


def test_by_its_definition(rng) -> None:
    x, y = rng.normal(size=(5, 2)), rng.normal(size=(4, 2))

    def kernel(a, b):
        return np.exp(-np.sum((a - b) ** 2) / (2 * 1.3**2))

    def mean(p, q, without_self):
        pairs = [(i, j) for i in range(len(p)) for j in range(len(q)) if not (without_self and i == j)]
        return np.mean([kernel(p[i], q[j]) for i, j in pairs])

    expected = mean(x, x, True) + mean(y, y, True) - 2.0 * mean(x, y, False)
    assert float(compared(x, y, 1.3).discrepancy()) == pytest.approx(expected)
    # Arrangements are what they say: dealing out the same groups otherwise is the same as handing in other samples.
    both = compared(x, y, 1.3)
    rows = np.concatenate([x, y])
    dealt = np.array([[True, False, True, True, False, True, False, False, True], both.first])
    found = both.discrepancy(dealt)
    assert found[0] == pytest.approx(float(compared(rows[dealt[0]], rows[~dealt[0]], 1.3).discrepancy()))
    assert found[1] == pytest.approx(expected)


def test_it_agrees_with_the_polynomial_machinery_on_strata(rng, monkeypatch) -> None:
    from eval.metrics import mmd
    from eval.metrics.two_sample import kernel_distance

    x, y = rng.normal(size=(24, 3)), rng.normal(size=(30, 3)) + 0.2
    x_groups, y_groups = np.repeat(np.arange(8), 3), np.repeat(np.arange(10), 3)
    x_strata, y_strata = x_groups % 3, y_groups % 4
    expected = kernel_distance(x, y, x_groups, y_groups, x_strata=x_strata, y_strata=y_strata).value
    monkeypatch.setattr(mmd, "gaussian_kernel", lambda rows, _: (rows @ rows.T / rows.shape[1] + 1.0) ** 3)
    found = two_sample(x, y, x_groups, y_groups, bandwidth=1.0, x_strata=x_strata, y_strata=y_strata)
    assert float(found.discrepancy()) == pytest.approx(expected)


def p_values(rng, runs: int, shift: float, *, clip_sd: float = 0.0, by_clip: bool = True) -> np.ndarray:
    """12 and 15 clips of four windows each in three actions that differ; windows of one clip are alike where clips vary."""
    found = []
    for _ in range(runs):
        sets = []
        for clips, moved in ((12, 0.0), (15, shift)):
            groups = np.repeat(np.arange(clips), 4)
            strata = groups % 3
            rows = rng.normal(size=(len(groups), 3)) + clip_sd * rng.normal(size=(clips, 3))[groups]
            sets.append((rows + 3.0 * strata[:, None] + moved, groups if by_clip else own(groups), strata))
        (x, x_groups, x_strata), (y, y_groups, y_strata) = sets
        test = two_sample(
            x,
            y,
            x_groups,
            y_groups,
            bandwidth=median_bandwidth(x, x_groups),
            x_strata=x_strata,
            y_strata=y_strata,
        )
        found.append(test.p(permutations=99, rng=rng))
    return np.array(found)


def test_p_is_uniform_where_nothing_differs_though_windows_of_a_clip_hang_together(rng) -> None:
    p = p_values(rng, 300, 0.0, clip_sd=1.5)
    for level in (0.05, 0.1, 0.25, 0.5, 0.75):
        # Four standard errors of a share.
        assert abs(np.mean(p <= level) - level) < 4.0 * np.sqrt(level * (1 - level) / len(p))
    # Windows exchanged one by one would be an error: they make any two sets of clips look different.
    assert np.mean(p_values(rng, 60, 0.0, clip_sd=1.5, by_clip=False) <= 0.05) > 0.3


def test_p_is_small_where_something_differs(rng) -> None:
    assert np.mean(p_values(rng, 40, 1.0) <= 0.05) > 0.95
    weak, strong = (np.mean(p_values(rng, 60, shift) <= 0.05) for shift in (0.2, 0.5))
    assert weak < strong


def test_p_never_is_zero_and_the_seed_decides(rng) -> None:
    x, y = rng.normal(size=(20, 2)), rng.normal(size=(20, 2)) + 4.0
    test = compared(x, y, 2.0)
    assert test.p(permutations=199, rng=np.random.default_rng(1)) == pytest.approx(1 / 200)
    near = compared(x, x + 0.3, 2.0)
    first, again = (near.p(permutations=300, rng=np.random.default_rng(2)) for _ in range(2))
    assert first == again
    assert test.arrangements() == 137846528820
    # Every arrangement of a set against its copy in one stratum each is as far apart as any other.
    pair = two_sample(x[:2], x[:2], own(x[:2]), own(x[:2]), bandwidth=1.0, x_strata=[0, 1], y_strata=[0, 1])
    assert pair.arrangements() == 4 and pair.p(permutations=20, rng=rng) == 1.0


def test_the_bandwidth_is_the_scale_of_the_first_sample_between_groups() -> None:
    x = np.array([[0.0], [0.1], [3.0], [3.2]])
    assert median_bandwidth(x, np.array([0, 0, 1, 1])) == pytest.approx(3.05)
    assert median_bandwidth(x[:2], np.array([0, 0])) == 0.0
    with pytest.raises(ValueError, match="above 0"):
        compared(x, x, 0.0)
