"""Dynamic scaling: a figure L times as long moves sqrt(L) times as long, so that gravity stays gravity."""

from __future__ import annotations

from typing import Any, Self

import numpy as np

from benchmark.api import (
    Capabilities,
    FitContext,
    Method,
    MethodInfo,
    StyleTask,
    Supervision,
    TrainView,
    TransferResult,
)
from benchmark.errors import ConfigError
from benchmark.motion.canonical import foot_points
from benchmark.motion.clip import MotionClip
from benchmark.motion.skeleton import SIDES, Skeleton

SCALES = ("length", "time", "both")
RATIOS = ("leg", "height", "limb")

#: Share of the frames, those with the lowest foot, that count as stance.
STANCE_SHARE = 0.25


class DynamicScaling(Method):
    """Scale adult motion to a child's body by dimensional analysis; nothing is learned.

    With geometric similarity and the same gravity, a body ``L`` times as long has lengths ``L``, times ``sqrt(L)``,
    velocities ``sqrt(L)``, accelerations and angles 1 (Raibert and Hodgins 1991; Hodgins and Pollard 1997); equivalently the
    Froude number ``v^2 / (g * leg)`` is kept. On a skeleton:

    - joint angles are unchanged, ``angle'(t') = angle(t)`` with ``t' = sqrt(L) t``;
    - the root's path over the floor is scaled by ``L``, its height by ``L`` about the floor, and then the whole clip is shifted
      up or down by one constant so that the stance foot of a child whose proportions are not the adult's meets the floor;
    - the result is resampled at the source's frame rate: ``round(sqrt(L) (T - 1)) + 1`` frames. Where that raises
      frequencies (``L < 1``) a zero-phase low-pass at ``sqrt(L)`` of the Nyquist frequency comes first.

    Dong, Aloba, Anthony and Jain (2017) showed observers adult motion scaled in length, in time and in both, as point
    lights; ``scale`` gives the same three, adapted to a suite that shows every method on one target body:

    - ``length``: lengths scaled, the adult's clock. With ``ratio="leg"`` this is what retargeting does, hence the same
      motion as the ``identity`` row: a check that the two agree, and the difference to ``both`` is what the clock adds.
    - ``time``: the clock scaled, and the one length that the body leaves free, the path over the floor, kept in the adult's
      metres. (On shorter legs the same angles put the hips lower, whatever one wishes; height therefore always follows the
      body.) A figure that travels then slides: the row shows what the length law is for. In place it equals ``both``.
    - ``both``: the law.

    Parameters
    ----------
    scale
        ``length``, ``time`` or ``both``.
    ratio
        What ``L`` is, target over source: ``leg`` (hip to ankle; keeps the Froude number and the feet still), ``height``
        (leg, trunk and head along the bones; close to Dong et al., whose exact choice is not published) or ``limb``
        (mean over both arms and both legs of the ratio of their lengths).
    """

    info = MethodInfo(
        name="dynamic-scaling",
        summary="lengths by L and times by sqrt(L), gravity kept; no learning",
        capabilities=Capabilities(supervision=Supervision.NONE, changes_timing=True, fit_scope="none"),
        citation="Raibert & Hodgins 1991; Hodgins & Pollard 1997; Dong, Aloba, Anthony & Jain 2017",
        code_deps=("benchmark.motion.retarget", "benchmark.motion.resample", "benchmark.motion.canonical"),
    )

    def __init__(self, *, scale: str = "both", ratio: str = "leg") -> None:
        self.scale = scale
        self.ratio = ratio

    @classmethod
    def variants(cls) -> dict[str, dict[str, Any]]:
        """Length only, time only, and both."""
        return {scale: {"scale": scale} for scale in SCALES}

    @classmethod
    def test_params(cls) -> list[dict[str, Any]]:
        """Every variant, and the other two ratios."""
        return [*({"scale": scale} for scale in SCALES), {"ratio": "height"}, {"ratio": "limb"}]

    def fit(self, train: TrainView, task: StyleTask, *, rng: np.random.Generator, ctx: FitContext) -> Self:
        """Learn nothing; a :class:`~benchmark.errors.ConfigError` names a setting that does not exist."""
        self._check()
        return self

    def transfer(self, source: MotionClip, task: StyleTask, *, rng: np.random.Generator) -> TransferResult:
        """Scale ``source`` to ``task.target_skeleton``; without one, ``L`` is 1 and the source comes back."""
        self._check()
        from benchmark.motion.resample import low_pass, sample_at
        from benchmark.motion.retarget import retarget

        skeleton = source.skeleton if task.target_skeleton is None else task.target_skeleton
        legs = skeleton.leg_length / source.skeleton.leg_length
        length = size_ratio(source.skeleton, skeleton, self.ratio)
        placed = source if task.target_skeleton is None else retarget(source, skeleton)
        # Retargeting has scaled the root by the ratio of the legs; the rest of what is wanted is put in here.
        if self.scale == "time":
            placed = _rescaled(placed, 1.0 / legs, 1.0)
        else:
            placed = _rescaled(placed, length / legs, length / legs)
        diagnostics = {"length_ratio": length, "leg_ratio": legs, "duration_ratio": 1.0}
        if self.scale == "length" or length == 1.0:
            return TransferResult(placed, diagnostics=diagnostics)

        stretch = float(np.sqrt(length))
        frames = round(stretch * (len(source) - 1)) + 1
        times = np.minimum(np.arange(frames) / source.fps / stretch, source.duration)
        if stretch < 1.0:
            placed = low_pass(placed, stretch * 0.5 * source.fps)
        clip = sample_at(placed, times, fps=source.fps)
        return TransferResult(clip, time_map=times, diagnostics={**diagnostics, "duration_ratio": stretch})

    def _check(self) -> None:
        if self.scale not in SCALES:
            raise ConfigError(f"dynamic-scaling: scale must be one of {', '.join(SCALES)}, not {self.scale!r}")
        if self.ratio not in RATIOS:
            raise ConfigError(f"dynamic-scaling: ratio must be one of {', '.join(RATIOS)}, not {self.ratio!r}")


def size_ratio(source: Skeleton, target: Skeleton, ratio: str) -> float:
    """``L``, the size of ``target`` over that of ``source``, by ``leg``, ``height`` or ``limb``.

    Measured along the bones, so that the pose at rest does not matter.
    """
    if ratio == "leg":
        return target.leg_length / source.leg_length
    if ratio == "height":
        return _stature(target) / _stature(source)
    pairs = [
        (
            _chain_length(target, f"{side}_{start}", f"{side}_{end}"),
            _chain_length(source, f"{side}_{start}", f"{side}_{end}"),
        )
        for side in SIDES
        for start, end in (("shoulder", "wrist"), ("hip", "ankle"))
    ]
    return float(np.mean([one / other for one, other in pairs]))


def _chain_length(skeleton: Skeleton, start: str, end: str) -> float:
    joints = skeleton.chain(skeleton.joint(start), skeleton.joint(end))
    return float(skeleton.bone_lengths[joints[1:]].sum())


def _stature(skeleton: Skeleton) -> float:
    return skeleton.leg_length + _chain_length(skeleton, "hips", "head")


def _rescaled(clip: MotionClip, path: float, height: float) -> MotionClip:
    """The root's path over the floor and its height times these factors, then one shift back to the floor."""
    if path == height == 1.0:
        return clip
    root = clip.root * [path, height, path]
    lowest = foot_points(clip)[..., 1].min(axis=1)
    stance = lowest <= np.quantile(lowest, STANCE_SHARE)
    root[:, 1] -= np.median(root[stance, 1] - clip.root[stance, 1])
    return clip.replace(root=root, source=None)
