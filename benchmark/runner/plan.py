"""The plan: every cell of a run with its complete key, and what will become of it.

Planning reads no clip and runs nothing, so it can be printed and tested.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Literal, Protocol, get_args

from benchmark.api import CONTRACT_VERSION, Capabilities, Supervision
from benchmark.config import RunConfig
from benchmark.data.base import Dataset
from benchmark.data.splits import Split
from benchmark.digest import VaryingDigest, digest, source_digest
from benchmark.errors import ConfigError
from benchmark.runner.selection import MethodChoice
from benchmark.seeding import Seeds

#: Code outside methods and data sets that can change an output.
PIPELINE = (
    "benchmark.motion",
    "benchmark.api",
    "benchmark.data.views",
    "benchmark.seeding",
    "benchmark.runner.execute",
)

Fate = Literal["run", "skipped", "failed"]


@dataclass(frozen=True)
class Cell:
    """One data set x split x task x method(params) x repetition.

    Attributes
    ----------
    key
        SHA-256 of ``ingredients``: of everything that can change an output, and of nothing else.
    method
        The label of its rows.
    name, target, params, params_digest, method_version
        The method's registry entry, parameters and version.
    task
        ``source:target``.
    repetition, seed
        Which repetition, and the cell's seed.
    device
        ``cpu`` or ``cuda``.
    fate, reason
        ``run``, or ``skipped``/``failed`` before running, with the reason.
    ingredients
        What the key is made of.
    """

    key: str
    method: str
    name: str
    target: str
    params: Mapping[str, Any]
    params_digest: str
    method_version: str
    dataset: str
    dataset_digest: str
    split: str
    split_digest: str
    task: str
    repetition: int
    seed: int
    device: str
    fate: Fate
    reason: str
    ingredients: Mapping[str, Any]

    @property
    def styles(self) -> tuple[str, str]:
        """Source and target style."""
        source, _, target = self.task.partition(":")
        return source, target

    @property
    def title(self) -> str:
        """For progress bars: method, task and repetition."""
        return f"{self.method} {self.task}" + (f" #{self.repetition}" if self.repetition else "")

    def to_json(self) -> dict[str, Any]:
        """The cell as JSON-ready data."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


_TABLES, _NUMBERS = ("params", "ingredients"), ("repetition", "seed")
_KEY = re.compile(r"[0-9a-f]{64}")


def _checked(cell: Cell) -> Cell:
    """The cell; a ``ValueError`` or ``TypeError`` names the field that cannot be one's."""
    for name, value in vars(cell).items():
        kind = dict if name in _TABLES else int if name in _NUMBERS else str
        if not isinstance(value, kind) or isinstance(value, bool):
            raise TypeError(f"{name} of a cell cannot be {value!r:.60}")
    if not _KEY.fullmatch(cell.key):  # it becomes the name of a folder
        raise ValueError(f"{cell.key[:80]!r} is no key of a cell")
    if cell.fate not in get_args(Fate):
        raise ValueError(f"fate of a cell is one of {', '.join(get_args(Fate))}, not {cell.fate[:60]!r}")
    return cell


class GpuProbe(Protocol):
    """Says whether there is a GPU that can be used; asked only if a method wants one."""

    def __call__(self) -> bool:
        """Look."""


def make_plan(
    config: RunConfig, dataset: Dataset, splits: Sequence[Split], methods: Iterable[MethodChoice], *, gpu: GpuProbe
) -> Iterator[Cell]:
    """Yield every cell: tasks in order, methods in order, repetitions in order. Equal cells are yielded once.

    Parameters
    ----------
    config
        The settings.
    dataset
        Opened, not read.
    splits
        One for each task.
    methods
        As chosen.
    gpu
        Asked at most once.
    """
    pipeline = source_digest(*PIPELINE)
    has_gpu: bool | None = None
    seen: set[str] = set()
    chosen = list(methods)
    for split in splits:
        task = f"{split.source_style}:{split.target_style}"
        for choice in chosen:
            capabilities = choice.capabilities
            device = "cpu"
            fate, reason = capability_fate(capabilities, dataset, split)
            if choice.error is not None:
                fate, reason = "failed", choice.error
            elif fate == "run" and capabilities.device != "cpu" and config.device != "cpu":
                has_gpu = gpu() if has_gpu is None else has_gpu
                if config.device == "cuda" and not has_gpu:
                    raise ConfigError("device is 'cuda', but no GPU can be used here: leave it at 'auto', or use 'cpu'")
                device = "cuda" if has_gpu else "cpu"
            if fate == "run" and capabilities.device == "gpu_required" and device == "cpu":
                fate, reason = "skipped", "needs a GPU"
            for cell in _repetitions(config, dataset, split, task, choice, device, fate, reason, pipeline):
                if cell.key not in seen:
                    seen.add(cell.key)
                    yield cell


def _repetitions(
    config: RunConfig,
    dataset: Dataset,
    split: Split,
    task: str,
    choice: MethodChoice,
    device: str,
    fate: Fate,
    reason: str,
    pipeline: str,
) -> Iterator[Cell]:
    """The cells of one method and task: what they have in common is digested once, as there may be very many."""
    params, params_digest = dict(choice.params), digest(choice.params)
    shared = {
        "contract": CONTRACT_VERSION,
        "pipeline": pipeline,
        "method": choice.name,
        "method_version": choice.version,
        "method_source": choice.source,
        "params": params,
        "dataset": dataset.id,
        "dataset_digest": dataset.digest,
        "split_digest": split.digest,
        "task": task,
        "reference_seed": config.seed if choice.capabilities.uses_reference else None,
        "device": device,
        "threads": config.threads,
        "limit": config.limit,
        "variants": list(config.variants),
    }
    key = VaryingDigest(shared, ("repetition", "seed"))
    axes: dict[str, str | int] = {"seed": config.seed, "dataset": dataset.id, "task": task, "method": choice.name}
    seeds = Seeds(("repetition",), **axes)
    random = choice.capabilities.stochastic_fit or choice.capabilities.stochastic_transfer
    for repetition in range(config.repetitions if random else 1):
        seed = seeds(repetition=repetition)
        yield Cell(
            key(repetition=repetition, seed=seed),
            choice.label,
            choice.name,
            choice.target,
            params,
            params_digest,
            choice.version,
            dataset.id,
            dataset.digest,
            split_name(split),
            split.digest,
            task,
            repetition,
            seed,
            device,
            fate,
            reason,
            {**shared, "repetition": repetition, "seed": seed},
        )


def plan_text(cells: Iterable[Cell]) -> str:
    """The plan as JSON, one line for each cell: what many have in common is written once, under ``shared``.

    A line holds the number of its entry in ``shared``, the key, the repetition and the seed.
    """
    numbers: dict[tuple, int] = {}
    shared: list[str] = []
    lines: list[str] = []
    for cell in cells:
        rest = (
            *(cell.method, cell.target, cell.params_digest, cell.method_version, cell.dataset_digest),
            *(cell.split_digest, cell.task, cell.device, cell.fate, cell.reason),
        )
        number = numbers.setdefault(rest, len(shared))
        if number == len(shared):
            common = {name: value for name, value in cell.to_json().items() if name not in _OWN}
            common["ingredients"] = {k: v for k, v in cell.ingredients.items() if k not in _OWN}
            shared.append(json.dumps(common, sort_keys=True, ensure_ascii=False))
        lines.append(f'[{number},"{cell.key}",{cell.repetition},{cell.seed}]')
    return '{{"shared": [\n{}\n],\n"cells": [\n{}\n]}}\n'.format(",\n".join(shared), ",\n".join(lines))


#: What tells apart the cells of one method and task.
_OWN = ("key", "repetition", "seed")


def read_plan(document: Any) -> tuple[Cell, ...]:
    """The cells of a :func:`plan_text`, parsed.

    Raises
    ------
    KeyError, TypeError, ValueError, IndexError
        If it is something else.
    """
    cells = []
    for number, key, repetition, seed in document["cells"]:
        common = document["shared"][number]
        own = {"repetition": repetition, "seed": seed}
        cells.append(_checked(Cell(key=key, **{**common, **own, "ingredients": {**common["ingredients"], **own}})))
    return tuple(cells)


def split_name(split: Split) -> str:
    """The split in a word: its protocol, and which fold where that is not the first."""
    fold = getattr(split, "fold", 0)
    return f"{split.protocol}-{fold}" if fold else str(split.protocol)


def capability_fate(capabilities: Capabilities, dataset: Dataset, split: Split) -> tuple[Fate, str]:
    """``run``, or ``skipped`` with the reason, from what can be known without reading a clip.

    Clip lengths and joint roles are known only when clips are read: those decide in the cell itself.
    """
    source, target = split.source_style, split.target_style
    if not split.test:
        return "skipped", "the split has no test clip"
    if capabilities.fps is not None and abs(capabilities.fps - dataset.fps) > 1e-6:
        return (
            "skipped",
            f"works at {capabilities.fps:g} frames per second only; data set {dataset.id} has {dataset.fps:g}",
        )
    actions: dict[str, set[str]] = {source: set(), target: set()}
    for clip_id in split.train:
        record = dataset.record(clip_id)
        if record.style in actions:
            actions[record.style].add(record.action)
    if capabilities.supervision != Supervision.NONE:
        for style, found in actions.items():
            if not found:
                return "skipped", f"needs training clips of both styles; there are none of {style!r}"
    if capabilities.supervision == Supervision.PAIRED and not actions[source] & actions[target]:
        return "skipped", f"needs pairs; no action has training clips of both {source!r} and {target!r}"
    if capabilities.uses_reference and not split.references:
        return "skipped", f"needs real {target!r} clips outside the training set; the split has none"
    return "run", ""


def limited(items: Sequence[Any], limit: int | None) -> list[Any]:
    """``limit`` of ``items``, spread evenly over their order; all of them for ``None``."""
    if limit is None or limit >= len(items):
        return list(items)
    return [items[(2 * index + 1) * len(items) // (2 * limit)] for index in range(limit)]
