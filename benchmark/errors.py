"""Every error a user may meet.

Each message names the offending thing and what to do about it. The command line prints these without a traceback and
ends with the error's ``exit_code``; any other exception is a fault of the suite and is shown in full.
"""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path


class BenchmarkError(Exception):
    """Base of all errors that a user can cause and mend."""

    exit_code = 2


class ConfigError(BenchmarkError):
    """A setting that does not exist or has a value out of range."""


class UnknownNameError(BenchmarkError):
    """A name that no registry entry, actor, joint role or field answers to.

    Parameters
    ----------
    kind
        What was looked up, for example ``"method"``.
    name
        The name as given.
    known
        The names that would have been right.
    """

    def __init__(self, kind: str, name: str, known: Iterable[str]) -> None:
        self.kind, self.name, self.known = kind, name, sorted(known)
        close = get_close_matches(name, self.known, n=1, cutoff=0.5)
        hint = f"; did you mean {close[0]!r}?" if close else ""
        listing = ", ".join(self.known) if self.known else "none"
        super().__init__(f"unknown {kind} {name!r}{hint} (known: {listing})")

    def __reduce__(self) -> tuple:
        return type(self), (self.kind, self.name, self.known)


class RegistryError(BenchmarkError):
    """Two things under one name, or an entry that cannot be imported."""


class MotionFileError(BenchmarkError):
    """A motion file that cannot be read as what it claims to be.

    Parameters
    ----------
    path
        The file.
    message
        What was expected and what was found.
    line
        1-based line number, where there is one.
    """

    def __init__(self, path: Path | str, message: str, *, line: int | None = None) -> None:
        self.path, self.message, self.line = Path(path), message, line
        super().__init__(f"{path}{'' if line is None else f', line {line}'}: {message}")

    def __reduce__(self) -> tuple:
        return _rebuild_motion_file_error, (type(self), self.path, self.message, self.line)


def _rebuild_motion_file_error(cls: type, path: Path, message: str, line: int | None) -> MotionFileError:
    return cls(path, message, line=line)


class SkeletonError(BenchmarkError):
    """A skeleton that is malformed or lacks a joint role that an operation needs."""


class DataError(BenchmarkError):
    """A data set that is absent, altered, or cannot be split as asked."""


class LeakageError(DataError):
    """An actor, take or window on both sides of a split."""


class ContractError(BenchmarkError):
    """A method or metric that broke the contract of :mod:`benchmark.api`."""


class StoreError(BenchmarkError):
    """A run folder that is damaged or belongs to other settings."""
