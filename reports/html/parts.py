"""Building a page of parts of which any may fail without taking the others along."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar

T = TypeVar("T")
U = TypeVar("U")


@dataclass
class Parts:
    """Runs the parts and remembers which failed and why.

    Attributes
    ----------
    failures
        What could not be made, with the reason, in the order in which it was tried.
    """

    failures: list[tuple[str, str]] = field(default_factory=list)

    def make(self, what: str, function: Callable[[], T], otherwise: U) -> T | U:
        """The function's result, or ``otherwise`` if it raises; with ``BENCHMARK_DEBUG`` set, the error goes through."""
        try:
            return function()
        except Exception as error:  # a plug-in's figure or a damaged file may raise anything
            if os.environ.get("BENCHMARK_DEBUG"):
                raise
            self.failures.append((what, f"{type(error).__name__}: {error}"))
            return otherwise
