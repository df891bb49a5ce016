"""The conformance suite over every registered metric."""

from __future__ import annotations

from functools import cache

import pytest

from benchmark.commands.conformance import METRIC_CHECKS, Check, run_check
from benchmark.commands.conformance.metrics import MetricBench
from benchmark.registry import METRICS


@cache
def bench(name: str) -> MetricBench:
    return MetricBench(METRICS.get(name))


@pytest.mark.parametrize("check", METRIC_CHECKS, ids=lambda check: check.name)
@pytest.mark.parametrize("name", METRICS.names())
def test_metric(name: str, check: Check) -> None:
    outcome = run_check(check, bench(name))
    assert outcome.status != "failed", outcome.message


@pytest.mark.parametrize("name", METRICS.names())
def test_the_registered_name_is_the_metrics_own(name: str) -> None:
    assert METRICS.get(name).info.name == name
