"""What several metrics need: values kept per clip, thinning to a common rate, differences over a fixed time."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import wraps
from typing import TypeVar
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from benchmark.api import NotApplicableError, Sample
from benchmark.motion.clip import MotionClip
from benchmark.motion.contacts import GRAVITY

#: Seconds over which motion is differenced and frames a second at which poses are compared. Fixed in time, not in frames,
#: so that a value means the same at 30, 60 and 120 frames a second; captures of the field are rarely slower than 30.
STEP = 1.0 / 30.0

Value = TypeVar("Value")


def per_clip(function: Callable[[MotionClip], Value]) -> Callable[[MotionClip], Value]:
    """Remember ``function``'s value for each clip as long as the clip lives.

    A real clip serves as reference for many results; clips are immutable, so its values are too.
    """
    known: WeakKeyDictionary[MotionClip, Value] = WeakKeyDictionary()

    @wraps(function)
    def remembered(clip: MotionClip) -> Value:
        if clip not in known:
            known[clip] = function(clip)
        return known[clip]

    return remembered


def speed_unit(clip: MotionClip) -> float:
    """``sqrt(g leg)`` in m/s: speeds divided by it do not depend on a figure's size (Froude)."""
    return float(np.sqrt(GRAVITY * clip.skeleton.leg_length))


def stride(fps: float) -> int:
    """Frames in :data:`STEP` seconds, at least one."""
    return max(1, round(fps * STEP))


def difference(values: NDArray[np.float64], fps: float, order: int = 1) -> NDArray[np.float64]:
    """The ``order``-th time derivative (T - order * k, ...) by forward differences over k = :func:`stride` frames.

    Differencing over a fixed time keeps capture noise, which a difference of order n over one frame multiplies by
    ``fps^n``, from deciding the value.
    """
    step = stride(fps)
    for _ in range(order):
        values = (values[step:] - values[:-step]) * (fps / step)
    return values


def references(sample: Sample) -> tuple[MotionClip, ...]:
    """The real target clips of the same action; :class:`~benchmark.api.NotApplicableError` if there are none."""
    if not sample.references:
        raise NotApplicableError(
            f"no real {sample.task.target_style} clip of {sample.source.meta.action!r} outside training"
        )
    return sample.references


def over_references(sample: Sample, value: Callable[[MotionClip], float]) -> float:
    """Median of ``value`` over the real target clips of the same action.

    Clips for which ``value`` raises :class:`~benchmark.api.NotApplicableError` do not count; if none is left it is raised.
    """
    values = []
    reason: NotApplicableError | None = None
    for reference in references(sample):
        try:
            values.append(value(reference))
        except NotApplicableError as error:
            reason = error
    if not values:
        raise NotApplicableError(f"no reference has a value: {reason}")
    return float(np.median(values))


def real_set(samples: Iterable[Sample]) -> list[MotionClip]:
    """The real target clips that a set of results is compared with: every reference of any of them, by clip id.

    Clips that a result is a copy of are left out, so that the row of real performers is held against other performances.
    :class:`~benchmark.api.NotApplicableError` if none is left.
    """
    samples = list(samples)
    copied = {sample.copied_from for sample in samples}
    found = {clip.meta.clip_id: clip for sample in samples for clip in sample.references}
    left = [found[name] for name in sorted(found) if name not in copied]
    if not left:
        raise NotApplicableError("there is no real target clip outside the training set to compare with")
    return left
