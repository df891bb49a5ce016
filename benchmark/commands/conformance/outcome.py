"""Checks and their outcomes."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

from benchmark.errors import BenchmarkError


class CheckFailedError(Exception):
    """A broken promise; the message says what was found and what to do."""


class NotConcernedError(Exception):
    """A check that this method or metric makes no promise about; the message says why."""


@dataclass(frozen=True)
class Check:
    """One promise of the contract.

    Attributes
    ----------
    name
        Short and unique, for tables and test ids.
    promise
        What is promised, one sentence.
    run
        Raises :class:`CheckFailedError` where it is broken, :class:`NotConcernedError` where it does not apply.
    """

    name: str
    promise: str
    run: Callable[[Any], None]


@dataclass(frozen=True)
class Outcome:
    """What came of a check; ``message`` is empty where it passed."""

    check: Check
    status: Literal["passed", "failed", "not concerned"]
    message: str = ""


def run_check(check: Check, subject: Any) -> Outcome:
    """Run one check; whatever the code under check raises makes it fail, and is reported with its place."""
    try:
        check.run(subject)
    except NotConcernedError as reason:
        return Outcome(check, "not concerned", str(reason))
    except (CheckFailedError, BenchmarkError) as error:
        return Outcome(check, "failed", str(error))
    except Exception as error:
        frame = traceback.extract_tb(error.__traceback__)[-1]
        return Outcome(check, "failed", f"{type(error).__name__}: {error} ({frame.filename}, line {frame.lineno})")
    return Outcome(check, "passed")


def require(condition: bool, message: str) -> None:
    """Fail the check with ``message`` unless ``condition`` holds."""
    if not condition:
        raise CheckFailedError(message)
