"""The conformance suite over every registered method and each of its test settings."""

from __future__ import annotations

import json
from functools import cache

import pytest

from benchmark.commands.conformance import METHOD_CHECKS, Check, MethodBench, run_check
from benchmark.registry import METHODS


def settings() -> list[tuple[str, str]]:
    """Names and parameters; a method that cannot even be imported is one failing case, not an error of the collection."""
    cases = []
    for name in METHODS.names():
        try:
            cases += [(name, json.dumps(params, sort_keys=True)) for params in METHODS.get(name).test_params()]
        except Exception as error:
            cases.append((name, f"cannot be loaded: {error}"))
    return cases


@cache
def bench(name: str, params: str) -> MethodBench:
    return MethodBench(METHODS.get(name), json.loads(params))


@pytest.mark.parametrize("check", METHOD_CHECKS, ids=lambda check: check.name)
@pytest.mark.parametrize(("name", "params"), settings())
def test_method(name: str, params: str, check: Check) -> None:
    outcome = run_check(check, bench(name, params))
    assert outcome.status != "failed", outcome.message


@pytest.mark.parametrize("name", METHODS.names())
def test_the_registered_name_is_the_methods_own(name: str) -> None:
    assert METHODS.get(name).info.name == name
