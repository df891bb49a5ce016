"""The plan: every cell of a run with its complete key, and what will become of it.

Planning reads no clip and runs nothing, so it can be printed and tested.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal, Protocol

from benchmark.api import CONTRACT_VERSION, Capabilities, Supervision
from benchmark.config import RunConfig
from benchmark.data.base import Dataset
from benchmark.data.splits import Split
from benchmark.digest import digest, source_digest
from benchmark.errors import ConfigError
from benchmark.runner.selection import MethodChoice
from benchmark.seeding import seed_for

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
        return asdict(self)


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
            random = capabilities.stochastic_fit or capabilities.stochastic_transfer
            for repetition in range(config.repetitions if random else 1):
                cell = _cell(config, dataset, split, task, choice, repetition, device, fate, reason, pipeline)
                if cell.key not in seen:
                    seen.add(cell.key)
                    yield cell


def _cell(
    config: RunConfig,
    dataset: Dataset,
    split: Split,
    task: str,
    choice: MethodChoice,
    repetition: int,
    device: str,
    fate: Fate,
    reason: str,
    pipeline: str,
) -> Cell:
    seed = seed_for(seed=config.seed, dataset=dataset.id, task=task, method=choice.name, repetition=repetition)
    params_digest = digest(choice.params)
    ingredients = {
        "contract": CONTRACT_VERSION,
        "pipeline": pipeline,
        "method": choice.name,
        "method_version": choice.version,
        "method_source": choice.source,
        "params": dict(choice.params),
        "dataset": dataset.id,
        "dataset_digest": dataset.digest,
        "split_digest": split.digest,
        "task": task,
        "repetition": repetition,
        "seed": seed,
        "reference_seed": config.seed if choice.capabilities.uses_reference else None,
        "device": device,
        "threads": config.threads,
        "limit": config.limit,
        "variants": list(config.variants),
    }
    return Cell(
        digest(ingredients),
        choice.label,
        choice.name,
        choice.target,
        dict(choice.params),
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
        ingredients,
    )


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
