"""The conformance suite over every registered probe."""

from __future__ import annotations

import subprocess
import sys
from functools import cache

import pytest

from benchmark.commands.conformance import Check, run_check
from benchmark.commands.conformance.probes import PROBE_CHECKS, ProbeBench
from benchmark.registry import PROBES


@cache
def bench(name: str) -> ProbeBench:
    return ProbeBench(PROBES.get(name))


@pytest.mark.parametrize("check", PROBE_CHECKS, ids=lambda check: check.name)
@pytest.mark.parametrize("name", PROBES.names())
def test_probe(name: str, check: Check) -> None:
    outcome = run_check(check, bench(name))
    assert outcome.status != "failed", outcome.message


@pytest.mark.parametrize("name", PROBES.names())
def test_the_registered_name_is_the_probes_own(name: str) -> None:
    assert PROBES.get(name).info.name == name


def test_choosing_all_metrics_and_their_probes_needs_no_learning_library() -> None:
    code = (
        "import sys\n"
        "from benchmark.registry import METRICS\n"
        "from benchmark.runner.selection import choose_metrics\n"
        "assert all(choice.error is None for choice in choose_metrics(METRICS, ['all']))\n"
        "print(sorted({'torch', 'sklearn', 'statsmodels', 'matplotlib'} & set(sys.modules)))\n"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"
