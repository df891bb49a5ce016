"""The training loop of every learned method.

A method gives a *step*: a function that is handed a batch of item numbers, updates its weights with its own optimisers (one
or several, in its own order), and returns its losses. The loop does the rest: the order of items, learning rates, checkpoints
that a killed process resumes from in the middle of an epoch, loss curves, progress, and stopping at the first loss that is not
finite.

For a seed, results on a CPU are the same to the bit whether training was interrupted or not, because everything that can
change them is in the checkpoint or follows from it: weights, the optimisers' state, the generator's, and the position in an
order that is drawn anew for each epoch from the seed and the epoch's number alone.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.optim import Optimizer

from benchmark.errors import BenchmarkError, ContractError, StoreError
from methods._torch.device import low_precision
from methods._torch.history import History
from methods._torch.schedule import Schedule
from methods._torch.weights import read_tensors, under, write_tensors

Losses = Mapping[str, Tensor | float]
Sampler = Callable[[int, np.random.Generator], NDArray[np.int64]]

#: Folder of the events for TensorBoard beside the checkpoints, with one folder for each stage.
EVENTS = "tensorboard"

#: A loss above this multiple of the largest of 1 and its first value counts as diverged.
DIVERGED = 1e4


class DivergedError(BenchmarkError):
    """A loss or a weight that is not finite any more, or has grown out of all proportion."""


class Stateful(Protocol):
    """What a checkpoint holds: a ``torch.nn.Module``, or anything that gives its state as tensors and takes it back."""

    def state_dict(self) -> dict[str, Tensor]:
        """The state, as tensors by name."""

    def load_state_dict(self, state_dict: dict[str, Tensor]) -> Any:
        """Take over a state."""


@dataclass(frozen=True)
class Batch:
    """What a step is handed.

    Attributes
    ----------
    index
        (B, ...) the next rows of the epoch's order: item numbers, or what the sampler drew.
    step
        Steps done before this one, over the whole training.
    epoch
        Epochs done, fractions included.
    generator
        For all random numbers of the step; its state is in every checkpoint.
    autocast
        ``with batch.autocast():`` around forward passes and losses computes in bfloat16 where that helps, else changes nothing.
    """

    index: NDArray[np.int64]
    step: int
    epoch: float
    generator: torch.Generator
    autocast: Callable[[], AbstractContextManager]


@dataclass(frozen=True)
class EarlyStop:
    """The rule for stopping early: no epoch's mean of ``loss`` in the last ``patience`` was better than the best before them.

    Attributes
    ----------
    loss
        Name of a loss of the step or of ``validate``.
    patience
        Epochs.
    least
        What counts as better: a fraction of the best so far.
    """

    loss: str
    patience: int
    least: float = 0.0


@dataclass(frozen=True)
class Settings:
    """How long and how to train.

    Attributes
    ----------
    epochs
        Passes over the items.
    batch
        Items per step.
    drop_last
        Whether to leave out the last, smaller batch of an epoch, if there is any other.
    precision
        ``auto``, ``float32`` or ``bfloat16``; see :func:`methods._torch.device.low_precision`.
    stop
        The rule for stopping early, if there is to be one.
    checkpoint_seconds, checkpoint_steps
        A checkpoint is written when either has passed since the last; 0 switches that one off.
    rows
        About how many rows of losses to keep; each is the mean over the steps since the row before.
    """

    epochs: int
    batch: int
    drop_last: bool = False
    precision: str = "auto"
    stop: EarlyStop | None = None
    checkpoint_seconds: float = 20.0
    checkpoint_steps: int = 0
    rows: int = 1000


def train(
    step: Callable[[Batch], Losses],
    *,
    items: int | Sampler,
    states: Mapping[str, Stateful],
    optimizers: Mapping[str, Optimizer],
    settings: Settings,
    rng: np.random.Generator,
    device: torch.device,
    schedules: Mapping[str, Schedule] | None = None,
    validate: Callable[[], Losses] | None = None,
    folder: Path | None = None,
    name: str = "training",
    report: Callable[[float, str], None] | None = None,
    unit: str = "words",
) -> History:
    """Train, or go on where a checkpoint in ``folder`` left off.

    Parameters
    ----------
    step
        One update: computes losses on ``batch.index``, updates weights through the optimisers (``zero_grad``, ``backward``
        and ``step`` are its own), and returns its losses, always the same names, as scalars. It draws from
        ``batch.generator`` alone and keeps nothing between calls that is not in ``states``.
    items
        Number of items, taken in a new order each epoch; or a sampler ``(epoch, rng) -> (M, ...)`` whose rows are an
        epoch's items in order, the same for the same arguments. All epochs have the same M.
    states
        Modules and whatever else changes during training (a replay pool, an average of weights), by name.
    optimizers
        By name, over the parameters of the modules in ``states``.
    settings
        See :class:`Settings`.
    rng
        Three draws are taken, whether or not a checkpoint is found.
    device
        Of the modules and the step's generator.
    schedules
        Learning-rate factor of an optimiser by the epochs done; constant where none is named.
    validate
        Called after each epoch; its losses join the history as columns of their own. Must change nothing that is in ``states``.
    folder
        Where the checkpoint ``NAME.safetensors`` is kept, and ``tensorboard/NAME`` if asked for; ``None``: nowhere.
    name
        Of the checkpoint, for methods that train in several stages.
    report
        :attr:`benchmark.api.FitContext.report`.
    unit
        What items are called in the progress line.

    Returns
    -------
    History
        Columns ``step``, ``epoch``, ``seconds``, ``lr/OPTIMIZER`` and the losses. Save it as ``train.parquet``.

    Raises
    ------
    DivergedError
        If a loss or weight is not finite or has grown by :data:`DIVERGED`; the last checkpoint before that stays.
    StoreError
        If the checkpoint is damaged or of another training.
    """
    run = _Run(items, states, optimizers, settings, rng, device, schedules or {}, folder, name, report, unit)
    try:
        run.restore()
        while not run.at.finished:
            order = run.order(run.at.epoch)
            while run.at.position < run.steps_per_epoch:
                run.record(step(run.next_batch(order)))
                run.save_if_due()
            run.end_epoch(validate)
        run.save()
    finally:
        run.history.close()
    return run.history


@dataclass
class _At:
    """Where a training is: what a checkpoint holds besides tensors and the history.

    ``sums`` and ``counts`` are of the losses since the last row (``row``) and since the epoch began (``epoch``).
    """

    step: int = 0
    epoch: int = 0
    position: int = 0
    seconds: float = 0.0
    finished: bool = False
    first: dict[str, float] = field(default_factory=dict)
    sums: dict[str, dict[str, float]] = field(default_factory=lambda: {"row": {}, "epoch": {}})
    counts: dict[str, int] = field(default_factory=lambda: {"row": 0, "epoch": 0})
    best: float | None = None
    since_best: int = 0

    def means(self, which: str) -> dict[str, float]:
        """Mean losses, whose sums start again."""
        means = {name: total / self.counts[which] for name, total in self.sums[which].items()}
        self.sums[which], self.counts[which] = {}, 0
        return means


class _Run:
    """The parts of one training; :func:`train` says how they are put together."""

    def __init__(
        self,
        items: int | Sampler,
        states: Mapping[str, Stateful],
        optimizers: Mapping[str, Optimizer],
        settings: Settings,
        rng: np.random.Generator,
        device: torch.device,
        schedules: Mapping[str, Schedule],
        folder: Path | None,
        name: str,
        report: Callable[[float, str], None] | None,
        unit: str,
    ) -> None:
        self.states, self.optimizers, self.schedules = states, optimizers, schedules
        self.settings, self.report, self.unit = settings, report, unit
        self.sampler = _shuffled(items) if isinstance(items, int) else items
        self.order_seed, step_seed, label = (int(rng.integers(2**63)) for _ in range(3))
        self.generator = torch.Generator(device).manual_seed(step_seed)
        self.rates = {key: [float(group["lr"]) for group in each.param_groups] for key, each in optimizers.items()}

        self.items = len(self.order(0))
        whole, rest = divmod(self.items, settings.batch)
        self.steps_per_epoch = whole if whole and settings.drop_last else whole + bool(rest)
        if settings.epochs < 1 or settings.batch < 1 or self.steps_per_epoch < 1:
            raise ContractError(f"nothing to train on: {self.items} items, {settings}")
        self.total = settings.epochs * self.steps_per_epoch
        self.row_every = max(1, math.ceil(self.total / settings.rows))
        # Reading a loss makes the CPU wait for a GPU, so there it is done for several steps at a time.
        self.read_every = 1 if device.type == "cpu" else 20
        low = low_precision(device, settings.precision)
        self.autocast = lambda: torch.autocast(device.type, dtype=torch.bfloat16, enabled=low)

        self.at, self.history = _At(), History()
        self.unread: list[Losses] = []
        self.folder, self.name = folder, name
        self.path = None if folder is None else folder / f"{name}.safetensors"
        # Not whatever only says how often to write: that may differ from one attempt to the next.
        essential = {key: value for key, value in asdict(settings).items() if not key.startswith("checkpoint")}
        self.identity = {"label": label, "items": self.items, "settings": essential}
        self.began = self.saved = time.perf_counter()
        self.saved_step = self.first_step = 0
        self.seconds_before = 0.0

    def order(self, epoch: int) -> NDArray[np.int64]:
        """The rows of an epoch, which follow from the seed and its number alone."""
        return self.sampler(epoch, np.random.default_rng([self.order_seed, epoch]))

    def next_batch(self, order: NDArray[np.int64]) -> Batch:
        """The batch at this position; sets the learning rates for it."""
        at, size = self.at, self.settings.batch
        epoch = at.epoch + at.position / self.steps_per_epoch
        for name, schedule in self.schedules.items():
            for group, rate in zip(self.optimizers[name].param_groups, self.rates[name], strict=True):
                if isinstance(group["lr"], Tensor):
                    group["lr"].fill_(rate * schedule(epoch))
                else:
                    group["lr"] = rate * schedule(epoch)
        index = order[at.position * size : (at.position + 1) * size]
        return Batch(index, at.step, epoch, self.generator, self.autocast)

    def record(self, losses: Losses) -> None:
        """Count a step that is done, look at its losses, and add a row to the history when one is due."""
        at = self.at
        at.step += 1
        at.position += 1
        self.unread.append(
            {name: value.detach() if isinstance(value, Tensor) else value for name, value in losses.items()}
        )
        last = at.position == self.steps_per_epoch
        if last or at.step % self.read_every == 0 or at.step % self.row_every == 0:
            self.read_losses()
        if last or at.step % self.row_every == 0:
            rates = {f"lr/{name}": float(each.param_groups[0]["lr"]) for name, each in self.optimizers.items()}
            self.history.add({**self.clock(), **rates, **at.means("row")})
        if self.report is not None:
            self.report(at.step / self.total, self.progress())

    def read_losses(self) -> None:
        """Add the losses of the latest steps to the sums; a ``DivergedError`` if one of them cannot be right."""
        names = list(self.unread[0]) if self.unread else []
        for name in names:
            values = torch.stack(
                [torch.as_tensor(losses[name], dtype=torch.float64) for losses in self.unread]
            ).tolist()
            for value in values:
                first = self.at.first.setdefault(name, value)
                if not math.isfinite(value) or abs(value) > DIVERGED * max(1.0, abs(first)):
                    raise DivergedError(self._diverged(f"the loss {name!r} is {value:g} (it began at {first:g})"))
            for which in ("row", "epoch"):
                sums = self.at.sums[which]
                sums[name] = sums.get(name, 0.0)
                for value in values:
                    sums[name] += value
        for which in ("row", "epoch"):
            self.at.counts[which] += len(self.unread)
        self.unread = []

    def end_epoch(self, validate: Callable[[], Losses] | None) -> None:
        """Validate, apply the rule for stopping, and go on to the next epoch."""
        at, stop = self.at, self.settings.stop
        means = at.means("epoch")
        if validate is not None:
            found = {name: float(value) for name, value in validate().items()}
            self.history.add({**self.clock(), **found})
            means |= found
        at.epoch += 1
        at.position = 0
        at.finished = at.epoch == self.settings.epochs
        if stop is not None:
            value = means[stop.loss]
            better = at.best is None or value < at.best - stop.least * abs(at.best)
            at.best, at.since_best = (value, 0) if better else (at.best, at.since_best + 1)
            at.finished |= at.since_best >= stop.patience

    def clock(self) -> dict[str, float]:
        """The first columns of a row."""
        seconds = self.seconds_before + time.perf_counter() - self.began
        return {
            "step": self.at.step,
            "epoch": self.at.epoch + self.at.position / self.steps_per_epoch,
            "seconds": seconds,
        }

    def progress(self) -> str:
        """The line for the progress bar."""
        at = self.at
        pace = (time.perf_counter() - self.began) / (at.step - self.first_step)
        shown = self.history.rows[-1] if self.history.rows else {}
        losses = ", ".join(f"{name} {shown[name]:.4g}" for name in list(at.first)[:3] if name in shown)
        speed = min(self.settings.batch, self.items) / max(pace, 1e-9)
        left = pace * (self.total - at.step)
        epoch = min(at.epoch + 1, self.settings.epochs)
        parts = [f"epoch {epoch}/{self.settings.epochs}", losses, f"{speed:.3g} {self.unit}/s", f"{left:.0f} s left"]
        return ", ".join(part for part in parts if part)

    def save_if_due(self) -> None:
        """Write a checkpoint if one is due."""
        steps, seconds = self.settings.checkpoint_steps, self.settings.checkpoint_seconds
        due = bool(steps) and self.at.step - self.saved_step >= steps
        late = bool(seconds) and time.perf_counter() - self.saved >= seconds
        if due or late:
            self.save()

    def save(self) -> None:
        """Write a checkpoint, of sound weights only."""
        self.read_losses()
        tensors = {
            f"state/{name}/{key}": value
            for name, state in self.states.items()
            for key, value in state.state_dict().items()
        }
        bad = [name for name, value in tensors.items() if value.is_floating_point() and not torch.isfinite(value).all()]
        if bad:
            raise DivergedError(self._diverged(f"{bad[0].removeprefix('state/')!r} is not finite"))
        if self.path is None:
            return
        for name, optimizer in self.optimizers.items():
            for index, entries in optimizer.state_dict()["state"].items():
                tensors |= {f"optimizer/{name}/{index}/{key}": torch.as_tensor(value) for key, value in entries.items()}
        tensors["generator"] = self.generator.get_state()
        self.at.seconds = self.clock()["seconds"]
        write_tensors(
            self.path, tensors, {"identity": self.identity, "at": asdict(self.at), "history": self.history.rows}
        )
        self.saved, self.saved_step = time.perf_counter(), self.at.step

    def restore(self) -> None:
        """Go on from the checkpoint, if there is one."""
        if self.path is not None and self.path.exists():
            tensors, facts = read_tensors(self.path)
            if facts.get("identity") != self.identity:
                raise StoreError(
                    f"the checkpoint {self.path} is of a training with another seed or other settings: remove it"
                )
            for name, state in self.states.items():
                state.load_state_dict(under(tensors, f"state/{name}/"))
            for name, optimizer in self.optimizers.items():
                held: dict[int, dict[str, Tensor]] = {}
                for key, value in under(tensors, f"optimizer/{name}/").items():
                    index, entry = key.split("/")
                    held.setdefault(int(index), {})[entry] = value
                groups = optimizer.state_dict()["param_groups"]
                optimizer.load_state_dict({"state": held, "param_groups": groups})
            self.generator.set_state(tensors["generator"])
            self.at, self.history = _At(**facts["at"]), History(facts["history"])
            self.first_step = self.saved_step = self.at.step
            self.seconds_before = self.at.seconds
        if self.folder is not None:
            self.history.watch(self.folder / EVENTS / self.name, self.at.step)

    def _diverged(self, what: str) -> str:
        kept = ""
        if self.path is not None and self.path.exists():
            kept = f"; the checkpoint of step {self.saved_step} is kept"
        return f"training diverged at step {self.at.step}: {what}{kept}. Lower the learning rate."


def _shuffled(items: int) -> Sampler:
    return lambda epoch, rng: rng.permutation(items)
