"""The contract between the suite and everything that plugs into it.

A method author writes a class with ``info``, a constructor that only stores its keywords, :meth:`Method.fit` and
:meth:`Method.transfer`. A metric author writes ``info`` and :meth:`Metric.compute`. Neither sees files, splits or the runner.
Change :data:`CONTRACT_VERSION` whenever the meaning of anything here changes: it is part of every cell's key.
"""

from __future__ import annotations

import inspect
import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, ClassVar, Literal, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import ContractError
from benchmark.motion.clip import MotionClip
from benchmark.motion.skeleton import CORE_ROLES, Skeleton

CONTRACT_VERSION = 1


class Supervision(StrEnum):
    """What a method needs from the training clips."""

    NONE = "none"
    UNPAIRED = "unpaired"
    PAIRED = "paired"


@dataclass(frozen=True)
class Capabilities:
    """What a method needs and does; the planner decides from these, and the conformance suite checks that they are true.

    Attributes
    ----------
    supervision
        ``none``: ignores the training clips; ``unpaired``: needs clips of both styles; ``paired``: needs clips of both
        styles for the same actions.
    representation
        What it works on, first preferred; for the record.
    changes_timing
        Whether an output may differ from its source in frame count.
    changes_proportions
        Whether outputs are on ``task.target_skeleton`` rather than on the source's skeleton.
    output
        ``rotations``, or ``positions`` if the rotations were fitted to joint positions.
    min_frames
        Shortest clip it accepts.
    fps
        The only frame rate it accepts, or ``None`` for any.
    required_roles
        Joint roles without which it cannot work.
    device
        ``cpu``, ``gpu_preferred`` or ``gpu_required``.
    stochastic_fit, stochastic_transfer
        Whether the generator passed in changes the result; deterministic methods are run once, whatever the repetitions.
    fit_scope
        ``none``: fitting learns nothing; ``per_task``: one fit for each pair of styles.
    uses_reference
        A ceiling row that is handed the real target clip. It is marked as such wherever it is shown.
    """

    supervision: Supervision = Supervision.UNPAIRED
    representation: tuple[str, ...] = ("rotations",)
    changes_timing: bool = False
    changes_proportions: bool = True
    output: Literal["rotations", "positions"] = "rotations"
    min_frames: int = 2
    fps: float | None = None
    required_roles: tuple[str, ...] = CORE_ROLES
    device: Literal["cpu", "gpu_preferred", "gpu_required"] = "cpu"
    stochastic_fit: bool = False
    stochastic_transfer: bool = False
    fit_scope: Literal["none", "per_task"] = "per_task"
    uses_reference: bool = False


@dataclass(frozen=True)
class MethodInfo:
    """What a method is.

    ``version`` is raised when results change for a reason outside its source file; ``code_deps`` names the modules besides
    its own (for example ``"methods.hsu.lti"``) whose source is part of its cells' keys; a package stands for all its modules.
    """

    name: str
    summary: str
    capabilities: Capabilities
    version: str = "1"
    citation: str = ""
    code_deps: tuple[str, ...] = ()


@dataclass(frozen=True)
class StyleTask:
    """From which style to which, and onto whom.

    Attributes
    ----------
    source_style, target_style
        For example ``adult`` and ``child``.
    target_skeleton
        The skeleton to put results on: a real actor of the target style from the training clips, the same for every method.
        ``None`` keeps the source's.
    reference
        The real target clip of the same action, for methods that declare ``uses_reference``; ``None`` for all others.
    """

    source_style: str
    target_style: str
    target_skeleton: Skeleton | None = None
    reference: MotionClip | None = None

    def __str__(self) -> str:
        return f"{self.source_style}:{self.target_style}"


class TrainView(Protocol):
    """The training clips, and nothing else of the data set. All clips are canonical and at one frame rate."""

    @property
    def fps(self) -> float:
        """Frames per second of every clip."""

    @property
    def actions(self) -> tuple[str, ...]:
        """The actions present, sorted."""

    def clips(
        self, style: str | None = None, *, action: str | None = None, actor: str | None = None
    ) -> Sequence[MotionClip]:
        """The clips that match, in a fixed order."""

    def pairs(self, source_style: str, target_style: str) -> Iterator[tuple[MotionClip, MotionClip]]:
        """Every pair of takes of the same action, source style first, in a fixed order."""

    def validation(self, fraction: float = 0.1) -> tuple[TrainView, TrainView]:
        """The view cut in two by clip, the larger part first; for choices that must not touch the test clips."""


def _ignore(fraction: float, message: str) -> None:
    pass


@dataclass(frozen=True)
class FitContext:
    """What the suite offers a method while it learns.

    Attributes
    ----------
    device
        ``cpu`` or ``cuda``.
    work_dir
        A folder that survives interruption, for checkpoints; ``None`` where there is none.
    report
        ``report(fraction, message)`` moves the progress bar; call it often, it is cheap.
    """

    device: str = "cpu"
    work_dir: Path | None = None
    report: Callable[[float, str], None] = _ignore


@dataclass(frozen=True)
class TransferResult:
    """Everything a transfer gives back.

    Attributes
    ----------
    clip
        The result, on the target's skeleton.
    time_map
        (T,) non-decreasing: the source time in seconds that each output frame shows. ``None`` where the output keeps the
        source's clock, or follows none (then ``copied_from`` says whose).
    raw_clip
        The result before the method's own post-processing, if it has any.
    contacts
        (T, F) foot contacts the method states, or ``None``.
    diagnostics
        JSON-ready facts about this transfer.
    copied_from
        Clip id of the real clip that the result is a copy of; that clip is then not used as its reference.
    round_trip
        The result translated back to the source style by the method itself, for methods that learn both ways.
    """

    clip: MotionClip
    time_map: NDArray[np.float64] | None = None
    raw_clip: MotionClip | None = None
    contacts: NDArray[np.bool_] | None = None
    diagnostics: Mapping[str, Any] = field(default_factory=dict)
    copied_from: str | None = None
    round_trip: MotionClip | None = None


class Method(ABC):
    """A style transfer method.

    Constructor keywords are the hyper-parameters: store them under their own names and do nothing else. ``fit`` forgets what
    was learned before and stores what it learns in attributes whose names end in an underscore. ``transfer`` changes nothing.
    """

    info: ClassVar[MethodInfo]

    @abstractmethod
    def fit(self, train: TrainView, task: StyleTask, *, rng: np.random.Generator, ctx: FitContext) -> Self:
        """Learn from the training clips and return ``self``.

        A :class:`NotApplicableError` says that there is nothing to learn from, and the cell is skipped.
        """

    @abstractmethod
    def transfer(self, source: MotionClip, task: StyleTask, *, rng: np.random.Generator) -> TransferResult:
        """Turn ``source`` into the target style; a :class:`NotApplicableError` skips this clip."""

    @classmethod
    def param_defaults(cls) -> dict[str, Any]:
        """Hyper-parameter names and defaults, read off the constructor."""
        parameters = list(inspect.signature(cls.__init__).parameters.values())[1:]
        for parameter in parameters:
            if parameter.kind is not parameter.KEYWORD_ONLY or parameter.default is parameter.empty:
                if (
                    parameter.kind in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL)
                    and cls.__init__ is object.__init__
                ):
                    continue
                raise ContractError(f"{cls.__name__}.__init__: {parameter.name!r} must be keyword-only with a default")
        return {p.name: p.default for p in parameters if p.kind is p.KEYWORD_ONLY}

    def params(self) -> dict[str, Any]:
        """The hyper-parameters of this instance."""
        return {name: getattr(self, name) for name in self.param_defaults()}

    def learned(self) -> list[str]:
        """Names of the attributes that ``fit`` set."""
        return sorted(name for name in vars(self) if name.endswith("_") and not name.startswith("_"))

    def save(self, folder: Path) -> None:
        """Write the fitted method; override together with :meth:`load` if ``fit`` learns anything."""
        if self.learned():
            raise ContractError(
                f"{type(self).__name__} learns {', '.join(self.learned())} and must override save and load"
            )
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "params.json").write_text(json.dumps(self.params(), indent=2, sort_keys=True))

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read what :meth:`save` wrote."""
        return cls(**json.loads((folder / "params.json").read_text()))

    @classmethod
    def test_params(cls) -> list[dict[str, Any]]:
        """Settings that finish in seconds, for the conformance suite."""
        return [{}]

    @classmethod
    def variants(cls) -> dict[str, dict[str, Any]]:
        """Named settings that ``--methods all`` runs as rows of their own, shown as ``name[variant]``.

        The name ``""`` is the plain method.
        """
        return {"": {}}

    @classmethod
    def presets(cls) -> dict[str, dict[str, Any]]:
        """Further named settings, run only when asked for as ``name[preset]``: they cost more, or answer other questions."""
        return {}


@dataclass(frozen=True)
class ProbeInfo:
    """What a probe is; ``version`` and ``code_deps`` as in :class:`MethodInfo`."""

    name: str
    summary: str
    version: str = "1"
    citation: str = ""
    code_deps: tuple[str, ...] = ()


class Probe(ABC):
    """A trained evaluator that metrics look through: a classifier, a feature extractor, limits of joints.

    It is fitted once for each run and task, on the training clips alone, and handed to the metrics that name it. The
    constructor takes no arguments; learned attributes end in an underscore. The same generator gives the same probe.
    """

    info: ClassVar[ProbeInfo]

    @abstractmethod
    def fit(self, train: TrainView, task: StyleTask, *, rng: np.random.Generator, ctx: FitContext) -> Self:
        """Learn from the training clips and return ``self``.

        A :class:`NotApplicableError` says that there is nothing to learn from; metrics that need the probe are then skipped.
        """

    @abstractmethod
    def save(self, folder: Path) -> None:
        """Write what was learned, without pickle."""

    @classmethod
    @abstractmethod
    def load(cls, folder: Path) -> Self:
        """Read what :meth:`save` wrote."""


@dataclass(frozen=True)
class MetricInfo:
    """What a metric is.

    Attributes
    ----------
    name
        ``group/name``, for example ``physics/foot-skate-ratio``.
    unit
        ``m/s``, ``deg``, ``1`` …
    direction
        ``lower`` or ``higher`` is better, ``target`` where the value ``target`` is best, ``none`` where it only describes.
    needs
        ``none``, ``reference`` (a real target clip of the same action) or ``truth`` (the true target performance of the same
        content, which only synthetic data has). Where it is missing the row is ``skipped``, with the reason.
    scope
        ``clip``, or ``set`` for a value over all clips of a cell.
    probe
        Name of the :class:`Probe` it uses, found in ``sample.probes``, or ``""``.
    """

    name: str
    summary: str
    unit: str
    direction: Literal["lower", "higher", "target", "none"]
    target: float | None = None
    needs: Literal["none", "reference", "truth"] = "none"
    scope: Literal["clip", "set"] = "clip"
    probe: str = ""
    version: str = "1"
    citation: str = ""
    code_deps: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Sample:
    """One transferred clip and all it may be compared with. Clips compute their world positions once and keep them.

    Attributes
    ----------
    clip
        The result.
    source
        The real clip it was made from, on its own skeleton.
    references
        Real target clips of the same action that no training used and that ``clip`` is not a copy of.
    truth
        The true target performance of the source's content, or ``None``.
    task
        The task, with the target skeleton.
    time_map
        As in :class:`TransferResult`.
    contacts, copied_from, round_trip
        As in :class:`TransferResult`.
    probes
        The fitted probes that metrics of this run name.
    """

    clip: MotionClip
    source: MotionClip
    references: tuple[MotionClip, ...]
    truth: MotionClip | None
    task: StyleTask
    time_map: NDArray[np.float64] | None = None
    contacts: NDArray[np.bool_] | None = None
    copied_from: str | None = None
    round_trip: MotionClip | None = None
    probes: Mapping[str, Probe] = field(default_factory=dict)


class NotApplicableError(Exception):
    """Raised where something cannot be done for a reason that is no fault; the message is stored as the reason.

    By a metric that has no value for a sample: that row is skipped. By :meth:`Method.transfer`, for a clip of a kind that the
    method cannot transfer (an action it has not learned): that clip is skipped. By :meth:`Method.fit`, where the training clips
    hold nothing to learn from: the cell is skipped.
    """


class Metric(ABC):
    """A number for each transferred clip (scope ``clip``) or for all of a cell's (scope ``set``)."""

    info: ClassVar[MetricInfo]

    @abstractmethod
    def compute(self, sample: Sample) -> float:
        """The value for one clip, in ``info.unit``."""

    def compute_set(self, samples: Sequence[Sample]) -> float:
        """The value for a set, for metrics of scope ``set``."""
        raise ContractError(f"metric {self.info.name} has scope {self.info.scope!r} and no compute_set")
