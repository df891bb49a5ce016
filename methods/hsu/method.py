"""The method ``hsu``: pairs, warps, one linear model per joint, and a child's skeleton that does what the models say."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from benchmark.api import (
    Capabilities,
    FitContext,
    Method,
    MethodInfo,
    NotApplicableError,
    StyleTask,
    Supervision,
    TrainView,
    TransferResult,
)
from benchmark.errors import DataError
from benchmark.motion.clip import ClipMeta, MotionClip
from benchmark.motion.skeleton import Skeleton
from methods.clips import training_clips
from methods.hsu.align import Record, WarpSettings, align
from methods.hsu.clock import ClockModel
from methods.hsu.joints import JointIdentification
from methods.hsu.lti import StateSpace
from methods.hsu.model import Scale, StyleModel, fit_style
from methods.hsu.pairs import Take, keep, rank
from methods.hsu.settings import FAITHFUL, check
from methods.hsu.timing import duration_ratio, retimed
from methods.hsu.track import channels, pose

Array = NDArray[np.float64]

#: The group that stands for all actions.
EVERYTHING = ""


class Hsu(Method):
    """Iterative motion warping and linear time-invariant models (Hsu et al. 2005, as used by Dong et al. 2018 for children).

    Takes of the same action by both styles are aligned in time by iterative motion warping. The source's channels, warped onto
    the target's clock, and the target's make records from which one state-space model per joint is identified,
    ``x' = A x + B u, v = C x + D u``, started from ``x = 0``. A new clip is standardised by the training source clips,
    run through the models, brought to the scale of the training target clips, and put on the target's skeleton by turning
    its bones to where the models say. Place and facing on the floor stay the source's, scaled by leg length.

    ``hsu`` is robust; ``hsu[faithful]``, run when asked for by name, follows the poster: order 40, records repeated
    28 times, one pair for each action, every joint warped alone by unsquared distances, the source's clock. Its departures are
    declared: the matrix of equation 2 is symmetric (as printed it is not the derivative of equation 1) and its equations are
    solved in linear time (``solver="dense"`` is the poster's LU, with the same numbers), unstable models are made stable, and
    of the 40 states those are left out that a record is too short to determine: they would be made of rounding, and results
    differ with the last bit of a recording. A clip whose action has no pair cannot be transferred by it.

    Parameters
    ----------
    scope
        ``all``: one group of models for all actions; ``action``: one for each action, and clips of other actions are
        skipped.
    coordinates
        What a joint's three channels are: ``parent``, the bone to it, or ``hips``, its position relative to the hips.
    body
        ``common``: all clips are put on the target skeleton first, so that proportions are not taken for style; ``own``: each
        performer's joints in metres, as in the poster.
    partners
        Target takes that each source take is paired with, its best aligned; 0 for all.
    pairs
        Pairs kept for each action, its best aligned; 0 for all.
    statistics
        Whose means and standard deviations standardise: those of ``all`` takes of the group, or of the takes in the ``pairs``
        that are kept.
    least_std
        Leg lengths that are added in quadrature to every standard deviation, so that people who stand a little differently
        are not many standard deviations apart; 0 in the poster.
    smooth
        Weight of the smoothness of space warps (the squares of F and G in equation 1), in standardised units. Towards 0 the
        space warp explains everything and the time warp nothing.
    band
        Half-width of the band for time warps, as a fraction of the length.
    max_skip
        Most source frames that one output frame advances.
    warp
        ``shared``: one time warp for the whole body; ``per-joint``: one for each joint, as the poster's text says, at the
        price of records in which the body's parts are out of step.
    distance
        ``squared``: time and space warps minimise the same energy; ``l2``: the poster's unsquared distance, at the price of
        an energy that may rise.
    solver
        ``banded``: space warps in linear time; ``dense``: the poster's LU, the same numbers at cubic cost.
    align_fps
        Frame rate at which pairs are aligned; the data's where that is lower.
    path_sigma
        Seconds over which the staircase of a time warp is smoothed; 0 leaves whole frames.
    identification
        ``subspace``, ``kernel-fir``, or ``auto``: what predicts held-out records better, at several times the cost. On none
        of the suite's data sets did ``auto`` or ``subspace`` come closer to held-out performers.
    order
        States of each model, or ``auto``: by held-out simulation.
    max_order
        Most states that ``auto`` considers, the poster's 40; fewer where there are not
        :data:`~methods.hsu.joints.PER_PARAMETER` independent numbers for each free parameter.
    choice_frames
        Frames of the records, evenly spread over all, on which method, order and ridge are chosen; 0 for all.
    repeat
        How often each record is repeated before identification, with a seam at every repetition.
    ridge
        Penalty on the energy of the response, see :func:`methods.hsu.lti.identify`; ``None``: the best on held-out records.
    refine
        Whether to refine by output-error minimisation where that predicts held-out records better.
    floor
        ``follow``: the hips are moved up and down, slowly, until the feet meet the floor where the source's do; ``clip``: by
        one constant for the whole clip, as the models of the poster leave it.
    spread
        ``source``: what the models leave unexplained of the target's motion is filled with the source's own, until results
        spread as much as the target's motion does; ``none``: it is left out, as in the poster. A least-squares model of loosely
        tied pairs answers with an average, which hardly moves.
    pre_roll
        Seconds for which the first frame is repeated before the clip; 0: the state starts from zero, as in the poster.
    timing
        ``none``: the source's clock; ``ratio``: durations scaled by the ratio of the training takes'; ``rate``: a
        rate that varies within the clip, by a model of its own.
    limit
        Standard deviations beyond the range of the training targets at which outputs are held.
    """

    info = MethodInfo(
        name="hsu",
        summary="iterative motion warping and one linear time-invariant model per joint",
        capabilities=Capabilities(
            supervision=Supervision.PAIRED,
            representation=("positions",),
            changes_timing=True,
            output="positions",
        ),
        citation="Hsu, Pulli & Popović 2005; Dong, Aloba, Anthony & Jain 2018",
        code_deps=(
            "methods.clips",
            "methods.hsu",
            "benchmark.motion.dtw",
            "benchmark.motion.ik",
            "benchmark.motion.retarget",
            "benchmark.motion.resample",
            "benchmark.motion.canonical",
        ),
    )

    def __init__(
        self,
        *,
        scope: str = "all",
        coordinates: str = "parent",
        floor: str = "follow",
        body: str = "common",
        partners: int = 1,
        pairs: int = 6,
        statistics: str = "all",
        least_std: float = 0.05,
        smooth: float = 10.0,
        band: float = 0.2,
        max_skip: int = 3,
        warp: str = "shared",
        distance: str = "squared",
        solver: str = "banded",
        align_fps: float = 30.0,
        path_sigma: float = 0.03,
        identification: str = "kernel-fir",
        order: int | str = "auto",
        max_order: int = 40,
        choice_frames: int = 3000,
        repeat: int = 1,
        ridge: float | None = None,
        refine: bool = False,
        spread: str = "source",
        pre_roll: float = 0.0,
        timing: str = "ratio",
        limit: float = 4.0,
    ) -> None:
        self.scope = scope
        self.coordinates = coordinates
        self.floor = floor
        self.body = body
        self.partners = partners
        self.pairs = pairs
        self.statistics = statistics
        self.least_std = least_std
        self.smooth = smooth
        self.band = band
        self.max_skip = max_skip
        self.warp = warp
        self.distance = distance
        self.solver = solver
        self.align_fps = align_fps
        self.path_sigma = path_sigma
        self.identification = identification
        self.order = order
        self.max_order = max_order
        self.choice_frames = choice_frames
        self.repeat = repeat
        self.ridge = ridge
        self.refine = refine
        self.spread = spread
        self.pre_roll = pre_roll
        self.timing = timing
        self.limit = limit

    @classmethod
    def presets(cls) -> dict[str, dict[str, Any]]:
        """``faithful``: the poster."""
        return {"faithful": dict(FAITHFUL)}

    @classmethod
    def test_params(cls) -> list[dict[str, Any]]:
        """Every choice once, with models of few states."""
        cheap = {"identification": "subspace", "order": 1}
        return [
            cheap,
            # The poster's reading in every respect but the sizes, which take minutes on clips of 60 frames a second.
            {**FAITHFUL, "order": 3, "repeat": 2, "align_fps": 15.0},
            {**cheap, "scope": "action", "coordinates": "hips", "timing": "rate", "pre_roll": 0.5},
            {**cheap, "timing": "none", "spread": "none", "partners": 0, "pairs": 0, "floor": "clip"},
        ]

    def fit(self, train: TrainView, task: StyleTask, *, rng: np.random.Generator, ctx: FitContext) -> Self:
        """Align pairs and identify a model per joint; a :class:`~benchmark.api.NotApplicableError` where there is no pair."""
        check(self.params())
        report = ctx.report
        sources, targets = self._training_clips(train, task)
        report(0.0, f"{len(sources)} and {len(targets)} takes of {len({clip.meta.action for clip in sources})} actions")
        self.fps_ = train.fps
        self.body_ = task.target_skeleton or targets[0].skeleton
        values = {clip.meta.clip_id: self._channels(clip) for clip in (*sources, *targets)}

        groups = self._groups(sources, targets)
        self.models_: dict[str, StyleModel] = {}
        self.facts_: dict[str, Any] = {"groups": {}}
        records: list[Record] = []
        for index, (name, (ours, theirs)) in enumerate(groups.items()):
            stage = _stage(report, index / len(groups), (index + 1) / len(groups), name or "all actions")
            model, found, facts = self._fit_group(ours, theirs, values, stage)
            self.models_[name] = model
            self.facts_["groups"][name] = facts
            records += found
        self.ratio_ = duration_ratio(_durations(sources), _durations(targets))
        self.rate_: ClockModel | None = None
        if self.timing == "rate":
            self.rate_, self.facts_["rate"] = ClockModel.fit(records, self._identification())
        return self

    def transfer(self, source: MotionClip, task: StyleTask, *, rng: np.random.Generator) -> TransferResult:
        """Translate ``source`` onto ``task.target_skeleton``, at the source's frame rate."""
        from benchmark.motion.resample import resample, sample_at
        from benchmark.motion.retarget import retarget

        name = EVERYTHING if self.scope == "all" else source.meta.action
        model = self.models_.get(name)
        if model is None:
            known = ", ".join(sorted(self.models_))
            raise NotApplicableError(f"no training pair performs the action {name!r}; there are pairs for {known}")
        skeleton = source.skeleton if task.target_skeleton is None else task.target_skeleton
        clip = source if source.fps == self.fps_ else resample(source, self.fps_)
        clip, times = self._retimed(clip, model)
        inputs = self._channels(clip)
        if inputs.shape[1] != len(model.joints):
            raise DataError(
                f"hsu with body='own' learned from skeletons of {len(model.joints)} joints, and this clip has "
                f"{inputs.shape[1]}: use body='common'"
            )
        outputs, limited = model.translate(inputs, pre_roll=round(self.pre_roll * self.fps_))
        unit = self._unit(self.body_)
        posed = pose(retarget(clip, self.body_), outputs, coordinates=self.coordinates, unit=unit, floor=self.floor)
        result = posed if skeleton == self.body_ else retarget(posed, skeleton)
        if source.fps != self.fps_:
            frames = int(np.floor(result.duration * source.fps + 1e-6)) + 1
            at = np.arange(frames) / source.fps
            result = sample_at(result, at, fps=source.fps)
            times = np.interp(at, np.arange(len(times)) / self.fps_, times)
        times = np.minimum(times, source.duration)
        diagnostics = {
            "duration_ratio": len(result) / len(source),
            "limited_share": limited,
            "group": name or "all actions",
        }
        return TransferResult(result, time_map=times, diagnostics=diagnostics)

    def save(self, folder: Path) -> None:
        """Write parameters and facts as JSON, arrays as ``.npz``."""
        from benchmark.motion import npz, quat

        folder.mkdir(parents=True, exist_ok=True)
        header = {
            "params": self.params(),
            "fps": self.fps_,
            "ratio": self.ratio_,
            "groups": list(self.models_),
            "rate_mean": None if self.rate_ is None else self.rate_.mean,
            "facts": self.facts_,
        }
        (folder / "hsu.json").write_text(json.dumps(header, indent=1, sort_keys=True))
        arrays = {
            f"group{index}.{name}": array
            for index, model in enumerate(self.models_.values())
            for name, array in model.arrays().items()
        }
        if self.rate_ is not None:
            arrays |= {f"rate.{name}": getattr(self.rate_.model, name) for name in "ABCD"}
            arrays |= {"rate.cue_mean": self.rate_.cue_mean, "rate.cue_std": self.rate_.cue_std}
        np.savez(folder / "models.npz", **arrays)  # type: ignore[arg-type]
        rest = MotionClip(self.body_, quat.identity(1, len(self.body_)), np.zeros((1, 3)), self.fps_, ClipMeta())
        npz.save(rest, folder / "body.npz")

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read what :meth:`save` wrote."""
        from benchmark.motion import npz

        header = json.loads((folder / "hsu.json").read_text())
        arrays = npz.read_arrays(folder / "models.npz")
        method = cls(**header["params"])
        method.fps_ = header["fps"]
        method.ratio_ = header["ratio"]
        method.facts_ = header["facts"]
        method.body_ = npz.load(folder / "body.npz").skeleton
        method.models_ = {
            name: StyleModel.from_arrays(_under(arrays, f"group{index}."))
            for index, name in enumerate(header["groups"])
        }
        method.rate_ = None
        if header["rate_mean"] is not None:
            rate = _under(arrays, "rate.")
            model = StateSpace(*(rate[name] for name in "ABCD"))
            method.rate_ = ClockModel(header["rate_mean"], rate["cue_mean"], rate["cue_std"], model)
        return method

    def _training_clips(self, train: TrainView, task: StyleTask) -> tuple[list[MotionClip], list[MotionClip]]:
        """The takes, of at least two frames, of the actions that both styles perform."""
        takes = training_clips("hsu", train, task)
        both = {clip.meta.action for clip in takes[0]} & {clip.meta.action for clip in takes[1]}
        if not both:
            raise NotApplicableError(
                f"hsu learns from pairs of takes of one action, and no action has training takes of both "
                f"{task.source_style!r} and {task.target_style!r}"
            )
        sources, targets = ([clip for clip in side if clip.meta.action in both] for side in takes)
        return sources, targets

    def _groups(
        self, sources: Sequence[MotionClip], targets: Sequence[MotionClip]
    ) -> dict[str, tuple[list[MotionClip], list[MotionClip]]]:
        if self.scope == "all":
            return {EVERYTHING: (list(sources), list(targets))}
        return {
            action: (
                [clip for clip in sources if clip.meta.action == action],
                [clip for clip in targets if clip.meta.action == action],
            )
            for action in sorted({clip.meta.action for clip in sources})
        }

    def _unit(self, skeleton: Skeleton) -> float:
        return skeleton.leg_length if self.body == "common" else 1.0

    def _channels(self, clip: MotionClip) -> Array:
        from benchmark.motion.retarget import retarget

        placed = retarget(clip, self.body_) if self.body == "common" else clip
        return channels(placed, coordinates=self.coordinates, unit=self._unit(placed.skeleton))

    def _fit_group(
        self,
        sources: Sequence[MotionClip],
        targets: Sequence[MotionClip],
        values: Mapping[str, Array],
        report: Callable[[float, str], None],
    ) -> tuple[StyleModel, list[Record], dict[str, Any]]:
        counts = {values[clip.meta.clip_id].shape[1] for clip in (*sources, *targets)}
        if len(counts) > 1:
            raise DataError(
                f"hsu with body='own' needs training skeletons with the same joints, not of {sorted(counts)}: "
                "use body='common'"
            )
        ours, theirs = (
            Scale.of([values[clip.meta.clip_id] for clip in side], self.least_std * self._unit(self.body_))
            for side in (sources, targets)
        )
        source_takes, target_takes = (
            [Take(c.meta.clip_id, c.meta.action, scale.standardise(values[c.meta.clip_id])) for c in side]
            for side, scale in ((sources, ours), (targets, theirs))
        )
        ranked = rank(source_takes, target_takes, self.fps_, lambda fraction: report(0.2 * fraction, "ranking pairs"))
        kept = keep(ranked, partners=self.partners, per_action=self.pairs)
        if self.statistics == "pairs":
            least = self.least_std * self._unit(self.body_)
            chosen = [{getattr(pair, side).clip_id for pair in kept} for side in ("source", "target")]
            ours, theirs = (Scale.of([values[name] for name in sorted(names)], least) for names in chosen)
            kept = [
                replace(
                    pair,
                    source=replace(pair.source, values=ours.standardise(values[pair.source.clip_id])),
                    target=replace(pair.target, values=theirs.standardise(values[pair.target.clip_id])),
                )
                for pair in kept
            ]
        settings = WarpSettings(
            self.smooth,
            self.band,
            self.max_skip,
            self.warp,
            self.distance,
            self.solver,
            self.align_fps,
            self.path_sigma,
        )
        records = []
        for index, pair in enumerate(kept):
            records.append(align(pair, self.fps_, settings))
            report(0.2 + 0.4 * (index + 1) / len(kept), f"warping pair {index + 1} of {len(kept)}")
        records.sort(key=lambda record: record.energy)
        model, joints = fit_style(
            [np.tile(record.inputs, (self.repeat, 1, 1)) for record in records],
            [np.tile(record.outputs, (self.repeat, 1, 1)) for record in records],
            ours,
            theirs,
            self._identification(),
            spread=self.spread,
            limit=self.limit,
            report=lambda fraction: report(0.6 + 0.4 * fraction, "identifying joints"),
        )
        facts = {
            "pairs_considered": len(ranked),
            "pairs": [
                {
                    "source": record.pair.source.clip_id,
                    "target": record.pair.target.clip_id,
                    "distance": record.pair.distance,
                    "energy": record.energy,
                }
                for record in records
            ],
            "joints": joints,
            "own": model.own.tolist(),
        }
        return model, records, facts

    def _identification(self) -> JointIdentification:
        return JointIdentification(
            method=self.identification,
            order=self.order,
            max_order=self.max_order,
            ridge=self.ridge,
            refine=self.refine,
            choice_frames=self.choice_frames,
            fps=self.fps_,
        )

    def _retimed(self, clip: MotionClip, model: StyleModel) -> tuple[MotionClip, Array]:
        """``clip`` on the target style's clock, and the source time that each of its frames shows.

        The clock comes first: the models have learned from motion on the target's clock.
        """
        from benchmark.motion.resample import low_pass, sample_at

        if self.timing == "none" or len(clip) < 2:
            return clip, clip.times
        if self.timing == "ratio":
            frames = round(self.ratio_ * (len(clip) - 1)) + 1
            times = np.minimum(np.arange(frames) / clip.fps / self.ratio_, clip.duration)
            if self.ratio_ < 1.0:
                clip = low_pass(clip, self.ratio_ * 0.5 * clip.fps)
            return sample_at(clip, times, fps=clip.fps), times
        assert self.rate_ is not None
        times = retimed(self.rate_.predict(model.source.standardise(self._channels(clip)), clip.fps), clip.fps)
        return sample_at(clip, times, fps=clip.fps), times


def _durations(clips: Sequence[MotionClip]) -> dict[str, list[float]]:
    found: dict[str, list[float]] = {}
    for clip in clips:
        found.setdefault(clip.meta.action, []).append(clip.duration)
    return found


def _under(arrays: Mapping[str, Array], prefix: str) -> dict[str, Array]:
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}


def _stage(report: Callable[[float, str], None], start: float, stop: float, name: str) -> Callable[[float, str], None]:
    """``report`` for one part of the work, from ``start`` to ``stop``, under a name."""
    return lambda fraction, message: report(start + (stop - start) * fraction, f"{name}: {message}")
