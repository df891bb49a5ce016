from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import kendalltau

from benchmark.api import MetricInfo
from benchmark.errors import ContractError
from eval.meta.corruptions import CORRUPTIONS
from eval.meta.expectations import COLUMNS, DECLARED, Expectation, _read, expected, verdict
from eval.meta.ordering import MOST_EFFECT, kendall, order_clips, order_sets


def info(direction: str, target: float | None = None, scope: str = "clip") -> MetricInfo:
    return MetricInfo("group/metric", "a metric", "1", direction, target=target, scope=scope)  # type: ignore[arg-type]


def clips(
    *means: float, rng: np.random.Generator, count: int = 30, spread: float = 1.0, own: float = 0.1
) -> np.ndarray:
    """(N, G) values: every clip has its own level, and a little noise at every grade."""
    level = spread * rng.standard_normal((count, 1))
    return level + np.array(means) + own * rng.standard_normal((count, len(means)))


def test_kendall_is_that_of_scipy(rng: np.random.Generator) -> None:
    for _ in range(20):
        values = np.round(rng.standard_normal(5), 0)
        expected_tau = kendalltau(np.arange(5), values).statistic
        assert kendall(values) == pytest.approx(0.0 if np.isnan(expected_tau) else expected_tau)
    many = rng.standard_normal((7, 5))
    assert np.allclose(kendall(many), [kendall(row) for row in many])


@pytest.mark.parametrize(
    ("direction", "target", "means", "observed"),
    [
        ("lower", None, (0, 1, 2, 3, 4), "ordered"),
        ("lower", None, (0, -1, -2, -3, -4), "fooled"),
        ("higher", None, (0, -1, -2, -3, -4), "ordered"),
        ("higher", None, (0, 1, 2, 3, 4), "fooled"),
        ("lower", None, (0, 2, 1, 3, 4), "seen"),
        ("lower", None, (0, 0, 0, 0, 0), "blind"),
        ("target", 1.0, (1, 2, 3, 4, 5), "ordered"),
        ("target", 1.0, (1, 0.5, 0, -0.5, -1), "ordered"),
        ("target", 1.0, (3, 2.5, 2, 1.5, 1), "fooled"),
        ("none", None, (0, -1, -2, -3, -4), "ordered"),
    ],
)
def test_what_is_observed(rng: np.random.Generator, direction: str, target, means, observed: str) -> None:
    found = order_clips(clips(*means, rng=rng), info(direction, target))
    assert found.observed == observed
    assert found.clips == 30
    if observed == "ordered":
        assert (found.tau, found.tau_low, found.tau_high, found.ordered_share) == (1.0, 1.0, 1.0, 1.0)
        assert found.first_seen == 1
    assert (found.effect > 0) == (observed in ("ordered", "seen")) or observed == "blind"


def test_effect_is_in_standard_deviations_between_clips(rng: np.random.Generator) -> None:
    values = clips(0, 1, 2, 3, rng=rng, count=400, spread=2.0, own=0.0)
    assert order_clips(values, info("lower")).effect == pytest.approx(3.0 / values[:, 0].std(ddof=1))
    constant = np.tile([0.0, 0.1, 0.2], (10, 1))
    assert order_clips(constant, info("lower")).effect == MOST_EFFECT


def test_the_smallest_grade_seen(rng: np.random.Generator) -> None:
    found = order_clips(clips(0, 0, 0, 0.5, 1, rng=rng), info("lower"))
    assert found.first_seen == 3
    assert found.lows[3] > 0.0 > found.lows[1]
    # A grade that is seen before one that is not does not count: it says nothing of smaller faults.
    found = order_clips(clips(0, 1, 0, 0, 1, rng=rng), info("lower"))
    assert (found.observed, found.first_seen) == ("seen", 4)


def test_rounding_is_no_reaction(rng: np.random.Generator) -> None:
    values = clips(5, 5, 5, rng=rng, own=0.0)
    values[:, 1:] += 1e-9
    found = order_clips(values, info("lower"))
    assert (found.observed, found.effect) == ("blind", 0.0)


def test_paired_differences_see_what_spread_would_hide(rng: np.random.Generator) -> None:
    values = clips(0, 0.1, 0.2, 0.3, rng=rng, spread=3.0, own=0.02)
    assert order_clips(values, info("lower")).first_seen == 1
    shuffled = np.stack([rng.permutation(column) for column in values.T], axis=1)
    assert order_clips(shuffled, info("lower")).observed == "blind"


def test_clips_without_a_value(rng: np.random.Generator) -> None:
    values = clips(0, 1, 2, 3, 4, rng=rng)
    values[:5] = np.nan
    values[20:, 4] = np.nan
    found = order_clips(values, info("lower"))
    assert (found.observed, found.clips) == ("ordered", 15)
    values[8:, 4] = np.nan
    found = order_clips(values, info("lower"))
    assert (found.observed, found.clips) == ("ordered", 25)
    assert np.isnan(found.means[4])
    assert not np.isnan(found.means[3])
    values[2:, 0] = np.nan
    assert order_clips(values, info("lower")).observed == "no value"


def test_false_alarms_are_rare() -> None:
    alarms = 0
    for seed in range(200):
        values = clips(0, 0, 0, 0, 0, rng=np.random.default_rng(seed), count=20, own=0.5)
        alarms += order_clips(values, info("lower")).observed != "blind"
    # 5 % are promised; a percentile bootstrap of 20 clips keeps it to within a few percent.
    assert alarms <= 24


def test_sets_by_the_jackknife(rng: np.random.Generator) -> None:
    values = clips(0, 1, 2, 3, rng=rng, count=60)
    groups = np.arange(60) % 6
    without = np.stack([values[groups != group].mean(axis=0) for group in range(6)])
    found = order_sets(values.mean(axis=0), without, info("lower", scope="set"), clips=60)
    assert (found.observed, found.first_seen) == ("ordered", 1)
    # For a mean the jackknife's spread is that between clips, up to the noise of six groups.
    assert found.effect == pytest.approx(order_clips(values, info("lower")).effect, rel=0.7)
    flat = np.zeros((6, 4))
    assert order_sets(np.zeros(4), flat, info("lower", scope="set"), clips=60).observed == "blind"
    assert order_sets(np.full(4, np.nan), flat, info("lower", scope="set"), clips=60).observed == "no value"


def test_expectations_name_what_exists() -> None:
    from benchmark.registry import METRICS

    assert set(COLUMNS.values()) == {corruption.name for corruption in CORRUPTIONS}
    assert all(METRICS.select(name) for name in DECLARED)
    assert expected("truth/pose-distance", "noise").sign == "+"
    assert expected("nobody/knows", "noise").sign == "."


def test_a_row_of_the_wrong_length_is_refused() -> None:
    with pytest.raises(ContractError, match="must be one row of 2 signs"):
        _read("metric noi bur\na/b + + +")
    with pytest.raises(ContractError, match="must be one row of 2 signs"):
        _read("metric noi bur\na/b + ?")


@pytest.mark.parametrize(
    ("sign", "means", "holds"),
    [
        ("+", (0, 1, 2), True),
        ("+", (0, 2, 1), False),
        ("+", (0, 0, 0), False),
        ("s", (0, 2, 1), True),
        ("s", (0, 0, 0), False),
        ("0", (0, 0, 0), True),
        ("0", (0, 1, 2), False),
        ("-", (0, -1, -2), True),
        ("-", (0, 1, 2), False),
        (".", (0, 1, 2), None),
    ],
)
def test_verdicts(rng: np.random.Generator, sign: str, means, holds) -> None:
    found = order_clips(clips(*means, rng=rng), info("lower"))
    assert verdict(Expectation(sign), found) is holds


def test_nothing_is_said_where_there_is_no_value() -> None:
    assert verdict(Expectation("+"), order_clips(np.full((5, 3), np.nan), info("lower"))) is None
