"""Sets of results and of real motion as sets of windows, and metrics over them."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from benchmark.api import Metric, NotApplicableError, Sample
from benchmark.errors import ContractError
from benchmark.motion.clip import MotionClip
from eval.features.kinematic import SHORTEST, window_spans
from eval.features.sequence import RATE
from eval.metrics import two_sample
from eval.metrics.shared import real_set
from eval.probes.encoder import FeatureSet, MotionEncoder

Array = NDArray[np.float64]

#: Parts of the sources' and of the real windows that a subsample takes. Every method's value is for the same number of windows,
#: and some have fewer: one that shortens motions, and of real ones the row of real performers, whose own are left out.
SOURCE_SHARE, REAL_SHARE = 1 / 2, 1 / 3

#: Subsamples over which a value is averaged.
DRAWS = 50

#: Windows for each dimension that a Fréchet distance is taken in.
WINDOWS_PER_AXIS = 10

#: Nearest neighbours that make a neighbourhood, and windows there must be for each.
NEIGHBOURS, WINDOWS_PER_NEIGHBOUR = 5, 8

#: Fewest windows in a subsample.
FEWEST = 4

#: Seed of the subsamples: the same for all methods.
SEED = 20210731


@dataclass(frozen=True, eq=False)
class Windows:
    """Features of windows, and the clip that each is of.

    Attributes
    ----------
    features
        (N, K).
    clips
        (N,) numbers of clips.
    actions
        (N,) what is done in them.
    """

    features: Array
    clips: NDArray[np.int64]
    actions: NDArray[np.str_]


def windows_of(
    clips: Iterable[MotionClip], probe: MotionEncoder, which: FeatureSet, actions: Iterable[str] | None = None
) -> Windows:
    """The windows of all clips; those of fewer than 4 frames at 30 a second have none.

    ``actions`` says what is done in each clip, where that is not what the clips say themselves.
    """
    clips = list(clips)
    named = [clip.meta.action for clip in clips] if actions is None else list(actions)
    long = [(clip, action) for clip, action in zip(clips, named, strict=True) if _window_count(clip)]
    found = [np.zeros((0, len(probe.projection(which).variances))), *(probe.features(clip, which) for clip, _ in long)]
    counts = [len(each) for each in found[1:]]
    return Windows(
        np.concatenate(found),
        np.repeat(np.arange(len(long)), counts),
        np.repeat(np.array([action for _, action in long], dtype=np.str_), counts),
    )


def sample_size(samples: Sequence[Sample]) -> int:
    """Windows in a subsample: the same for every method that is given the same sources and references.

    Half the windows of the sources or a third of those of real motion, whichever are fewer. Real motion is all references
    and, because each is left out of the references of its own copy, all copies.
    """
    real = {clip.meta.clip_id: _window_count(clip) for sample in samples for clip in sample.references}
    real |= {sample.copied_from: _window_count(sample.clip) for sample in samples if sample.copied_from is not None}
    sources = sum(_window_count(sample.source) for sample in samples)
    return int(min(SOURCE_SHARE * sources, REAL_SHARE * sum(real.values())))


def _window_count(clip: MotionClip) -> int:
    frames = int(np.floor(clip.duration * RATE + 1e-6)) + 1
    return len(window_spans(frames)) if frames >= SHORTEST else 0


class DistributionMetric(Metric):
    """A value over all clips of a cell, seen in windows of 2 s through the probe ``motion-encoder``.

    Real motion is that of all references of the set, without clips that a result is a copy of. Windows of one clip overlap and
    depend on one another, and so do clips of one performer: intervals must be drawn over clips or performers, and the floor
    that dependence and finite numbers leave is the value of the row of real performers, not that of a formula.
    """

    which: ClassVar[FeatureSet] = "kinematic"

    def compute(self, sample: Sample) -> float:
        """Not for one clip; see :meth:`compute_set`."""
        raise ContractError(f"metric {self.info.name} has scope 'set': call compute_set")

    def compute_set(self, samples: Sequence[Sample]) -> float:
        """The value for the results of a set; not applicable where there are too few windows."""
        if not samples:
            raise NotApplicableError("there are no results")
        probe = samples[0].probes["motion-encoder"]
        if not isinstance(probe, MotionEncoder):
            raise ContractError(f"the probe 'motion-encoder' is a {type(probe).__name__}, not a MotionEncoder")
        real = windows_of(real_set(samples), probe, self.which)
        # A result is of the action of its source, whatever a method writes beside it.
        actions = [sample.source.meta.action for sample in samples]
        ours = windows_of([sample.clip for sample in samples], probe, self.which, actions)
        size = sample_size(samples)
        for count, what in (
            (size, "to compare"),
            (len(real.features), "of real motion"),
            (len(ours.features), "of results"),
        ):
            if count < max(size, FEWEST):
                raise NotApplicableError(f"{count} windows of 2 s {what} are too few: {max(size, FEWEST)} are needed")
        return self.value(real, ours, size)

    @abstractmethod
    def value(self, real: Windows, ours: Windows, size: int) -> float:
        """The value for two sets of windows, ``size`` of them in a subsample."""


def mean_over_draws(
    value: Callable[[Array, Array], float], real: Windows, ours: Windows, size: int, *, draws: int = DRAWS
) -> float:
    """Mean of ``value(real, ours)`` over subsamples of ``size`` windows each."""
    rng = np.random.default_rng(SEED)
    return float(two_sample.over_draws(value, real.features, ours.features, size, draws=draws, rng=rng).mean())


def capped(windows: Windows, size: int) -> Windows:
    """The windows on the first axes only, at most one for ten windows of a subsample."""
    return replace(windows, features=windows.features[:, : max(1, size // WINDOWS_PER_AXIS)])


def neighbours(size: int) -> int:
    """Neighbours that make a neighbourhood: 5, and fewer in subsamples of under 40 windows."""
    return min(NEIGHBOURS, max(1, size // WINDOWS_PER_NEIGHBOUR))
