"""What a worker process is handed: plain data from which it opens everything itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

from benchmark.api import Method, Metric
from benchmark.data.base import Dataset
from benchmark.data.splits import Split
from benchmark.digest import digest, source_digest
from benchmark.registry import load_target
from benchmark.runner.plan import Cell
from benchmark.runner.selection import MetricChoice, make_metric

#: ``report(stage, fraction, message)``: what the cell does, for the progress display and the time limit.
Report = Callable[[str, float, str], None]

#: Code outside metrics that can change a score.
SCORING = ("benchmark.motion", "benchmark.api", "benchmark.data.views", "benchmark.runner.score")


class Unit(Protocol):
    """What a backend runs and a progress display shows: a cell, or a probe to fit."""

    @property
    def key(self) -> str:
        """Its name in the store."""

    @property
    def title(self) -> str:
        """Its name for people."""

    @property
    def device(self) -> str:
        """``cpu`` or ``cuda``."""


@dataclass(frozen=True)
class DatasetSource:
    """How to open the data set; ``opener`` is ``"module:function"`` called with the rest."""

    name: str
    root: Path | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    opener: str = "benchmark.data.catalog:open_dataset"

    def absolute(self) -> DatasetSource:
        """The same, wherever the process goes."""
        return self if self.root is None else replace(self, root=self.root.absolute())

    def open(self) -> Dataset:
        """Open it."""
        dataset: Dataset = load_target(self.opener, f"data set {self.name}")(self.name, root=self.root, **self.options)
        return dataset


@dataclass(frozen=True)
class ProbeRef:
    """Where a run's probe is: its key in the store of probes, and its class as ``"module:Class"``."""

    key: str
    target: str


@dataclass(frozen=True)
class MetricJob:
    """One metric to compute; ``digest`` covers everything that can change its values, ``error`` says why it cannot be.

    ``probe`` is the name of the probe it looks through, or empty.
    """

    name: str
    target: str
    digest: str
    version: str = ""
    unit: str = ""
    error: str | None = None
    value: bytes | None = None
    probe: str = ""

    @classmethod
    def of(cls, choice: MetricChoice, scoring: str, value: bytes | None = None) -> MetricJob:
        """The job of a chosen metric; ``scoring`` is :func:`scoring_digest`."""
        info = choice.info
        return cls(
            choice.name,
            choice.target,
            digest({"metric": choice.digest, "scoring": scoring, "error": choice.error}),
            info.version if info else "",
            info.unit if info else "",
            choice.error,
            value,
            choice.probe.name if choice.probe else "",
        )

    def load(self) -> Metric:
        """Import and make the metric."""
        return make_metric(_unpack(self.value) or load_target(self.target, f"metric {self.name!r}"), self.name)


@dataclass(frozen=True)
class CellJob:
    """One cell's work.

    Attributes
    ----------
    cell
        The cell.
    folder
        The run folder.
    dataset, split_file
        Where the clips and the split come from.
    variants, limit, seed
        As in :class:`~benchmark.config.RunConfig`.
    threads
        Threads of the numerical libraries.
    execute
        Whether to fit and transfer, or only to score what is stored.
    metrics
        The metrics that the cell should have.
    poisoned
        Metrics that ended the process before, with what happened; they are recorded as failed and not tried.
    method_value
        The class itself, where it was defined in a notebook and cannot be imported.
    probes
        Where the probes are that the metrics name.
    """

    cell: Cell
    folder: Path
    dataset: DatasetSource
    split_file: Path
    variants: tuple[str, ...]
    limit: int | None
    seed: int
    threads: int
    execute: bool
    metrics: tuple[MetricJob, ...]
    poisoned: Mapping[str, str] = field(default_factory=dict)
    method_value: bytes | None = None
    probes: Mapping[str, ProbeRef] = field(default_factory=dict)

    def load_method(self) -> type[Method]:
        """Import the method's class."""
        cls: type[Method] = _unpack(self.method_value) or load_target(self.cell.target, f"method {self.cell.name!r}")
        return cls

    def load_split(self) -> Split:
        """Read the split."""
        return Split.from_json(self.split_file)


def scoring_digest() -> str:
    """Digest of the code outside metrics that can change a score."""
    return source_digest(*SCORING)


def pack(value: Any) -> bytes:
    """A class defined in a notebook as bytes for a worker process of this run; never written to a file."""
    import cloudpickle

    packed: bytes = cloudpickle.dumps(value)
    return packed


def _unpack(value: bytes | None) -> Any:
    if value is None:
        return None
    import cloudpickle

    # Bytes that the parent process packed and sent through a pipe; no file is ever read this way.
    return cloudpickle.loads(value)
