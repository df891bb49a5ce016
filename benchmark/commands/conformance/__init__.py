"""The conformance suite: what the contract asks of every method and metric, as checks that say what to do.

``python -m benchmark check-method NAME`` runs it for plugin authors; the suite's own tests run the same checks over every
registered method and metric.
"""

from __future__ import annotations

from benchmark.commands.conformance.methods import METHOD_CHECKS, MethodBench, check_method
from benchmark.commands.conformance.metrics import METRIC_CHECKS, check_metric
from benchmark.commands.conformance.outcome import Check, CheckFailedError, Outcome, run_check

__all__ = [
    "METHOD_CHECKS",
    "METRIC_CHECKS",
    "Check",
    "CheckFailedError",
    "MethodBench",
    "Outcome",
    "check_method",
    "check_metric",
    "run_check",
]
