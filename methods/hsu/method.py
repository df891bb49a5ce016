"""The method ``hsu``: pairs, warps, one linear model per joint, and a child's skeleton that does what the models say."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
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
from benchmark.errors import ConfigError, DataError
from benchmark.motion.clip import ClipMeta, MotionClip
from benchmark.motion.skeleton import Skeleton
from methods.clips import training_clips
from methods.hsu.align import WARPS, Record, WarpSettings, align
from methods.hsu.lti import Identification, StateSpace, identify
from methods.hsu.model import SPREADS, Scale, StyleModel, fit_style
from methods.hsu.pairs import Take, keep, rank
from methods.hsu.timing import TIMINGS, cues, duration_ratio, rate_of, retimed
from methods.hsu.track import COORDINATES, FLOORS, channels, pose

Array = NDArray[np.float64]

SCOPES = ("all", "action")
BODIES = ("common", "own")
IDENTIFICATIONS = ("auto", "subspace", "kernel-fir")

#: The group that stands for all actions.
EVERYTHING = ""

#: Independent numbers for each free parameter of a model whose order is chosen, and how many a second of a channel holds: most
#: of human motion lies below 5 Hz, and recording it at 60 frames a second says no more of it.
PER_PARAMETER, PER_SECOND = 10, 10

#: The poster's settings where it states them, and the most literal reading where it does not.
FAITHFUL: Mapping[str, Any] = {
    "scope": "action",
    "coordinates": "hips",
    "floor": "clip",
    "body": "own",
    "partners": 1,
    "pairs": 1,
    "statistics": "pairs",
    "least_std": 0.0,
    "distance": "l2",
    "warp": "per-joint",
    "align_fps": 1000.0,
    "path_sigma": 0.0,
    "identification": "subspace",
    "order": 40,
    "repeat": 28,
    "ridge": 0.0,
    "spread": "none",
    "timing": "none",
}


@dataclass(frozen=True, eq=False)
class _Rate:
    """A model of the clock: mean log rate, how its cues are standardised, and their response."""

    mean: float
    cue_mean: Array
    cue_std: Array
    model: StateSpace

    def predict(self, values: Array, fps: float) -> Array:
        return self.mean + self.model.simulate((cues(values, fps) - self.cue_mean) / self.cue_std)[:, 0]


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
    solved in linear time (``solver="dense"`` is the poster's LU, with the same numbers), and unstable models are made
    stable. A clip whose action has no pair cannot be transferred by it.

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
        Most states that ``auto`` considers, the poster's 40; fewer where there are not :data:`PER_PARAMETER` independent
        numbers for each free parameter.
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
        self._check()
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
        self.rate_ = self._fit_rate(records) if self.timing == "rate" else None
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
            method.rate_ = _Rate(header["rate_mean"], rate["cue_mean"], rate["cue_std"], model)
        return method

    def _check(self) -> None:
        choices = {
            "scope": SCOPES,
            "coordinates": COORDINATES,
            "floor": FLOORS,
            "spread": SPREADS,
            "body": BODIES,
            "statistics": ("all", "pairs"),
            "warp": WARPS,
            "distance": ("squared", "l2"),
            "solver": ("banded", "dense"),
            "identification": IDENTIFICATIONS,
            "timing": TIMINGS,
        }
        for name, allowed in choices.items():
            if getattr(self, name) not in allowed:
                raise ConfigError(f"hsu: {name} must be one of {', '.join(allowed)}, not {getattr(self, name)!r}")
        if self.order != "auto" and (not isinstance(self.order, int) or isinstance(self.order, bool) or self.order < 0):
            raise ConfigError(f"hsu: order must be 'auto' or a whole number of at least 0, not {self.order!r}")
        least = {
            "partners": 0,
            "pairs": 0,
            "least_std": 0.0,
            "band": 0.0,
            "max_skip": 1,
            "path_sigma": 0.0,
            "max_order": 0,
            "choice_frames": 0,
            "repeat": 1,
            "pre_roll": 0.0,
            "limit": 0.0,
        }
        for name, bound in least.items():
            if not getattr(self, name) >= bound:
                raise ConfigError(f"hsu: {name} must be at least {bound}, not {getattr(self, name)!r}")
        for name in ("smooth", "align_fps"):
            if not getattr(self, name) > 0:
                raise ConfigError(f"hsu: {name} must be above 0, not {getattr(self, name)!r}")

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
            self._identify,
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

    def _identify(self, inputs: Sequence[Array], outputs: Sequence[Array]) -> tuple[StateSpace, dict[str, Any]]:
        """One joint: the model, and what is worth keeping of how it was found.

        What is to be chosen is chosen on some of the records where there are many, and then fitted to all.
        """
        some = _spread_out(inputs, self.choice_frames)
        chosen = self._identified(
            [inputs[k] for k in some], [outputs[k] for k in some], self.order, self.identification
        )
        found = chosen
        if len(some) < len(inputs) and not chosen[0].refined:
            kind = "kernel-fir" if chosen[0].method == "kernel-fir" else "subspace"
            found = self._identified(inputs, outputs, chosen[0].order, kind)
        return found[0].model, {
            "method": found[0].method,
            "order": found[0].order,
            "held_out_error": _number(chosen[0].held_out_error),
            "train_error": _number(found[0].train_error),
            "spectral_radius_found": _number(found[0].spectral_radius_found),
            "stabilised": found[0].stabilised,
            "rank": found[0].rank,
            "rank_needed": found[0].rank_needed,
            "refined": found[0].refined,
            "warnings": found[1],
        }

    def _identified(
        self, inputs: Sequence[Array], outputs: Sequence[Array], order: int | str, method: str
    ) -> tuple[Identification, list[str]]:
        """The identification, and the warnings it gave: they belong into the facts of 25 joints, not on the screen."""
        import warnings

        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            found = identify(
                list(inputs),
                list(outputs),
                order,
                method=method,
                ridge=self.ridge,
                refine=self.refine,
                max_order=_supported(inputs, outputs, self.max_order, self.fps_),
                fps=self.fps_,
            )
        return found, sorted({str(warning.message) for warning in caught})

    def _fit_rate(self, records: Sequence[Record]) -> _Rate:
        """A model of how fast the target's clock runs, from what the time warps of all records say."""
        given = [cues(record.pair.source.values, self.fps_) for record in records]
        rates = [rate_of(record.position, len(record.pair.source.values), self.fps_)[:, None] for record in records]
        frames = np.concatenate(given)
        mean, std = frames.mean(axis=0), np.maximum(frames.std(axis=0), 1e-6)
        level = float(np.concatenate(rates).mean())
        model, facts = self._identify([(cue - mean) / std for cue in given], [rate - level for rate in rates])
        self.facts_["rate"] = facts
        return _Rate(level, mean, std, model)

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


def _supported(inputs: Sequence[Array], outputs: Sequence[Array], cap: int, fps: float) -> int:
    """The highest order, up to ``cap``, whose ``n (m + l) + l m`` free parameters the recorded outputs can settle."""
    m, p = inputs[0].shape[1], outputs[0].shape[1]
    seconds = sum(len(record) for record in outputs) / fps
    parameters = PER_SECOND * p * seconds / PER_PARAMETER
    return int(np.clip((parameters - p * m) // (m + p), 0, cap))


def _spread_out(records: Sequence[Array], frames: int) -> list[int]:
    """Indices of records, evenly spread, that have about so many frames; of all where there are no more."""
    total = sum(len(record) for record in records)
    if frames == 0 or total <= frames:
        return list(range(len(records)))
    count = max(5, round(len(records) * frames / total))
    return sorted(set(np.linspace(0, len(records) - 1, min(count, len(records))).round().astype(int).tolist()))


def _number(value: float) -> float | None:
    """``value`` for JSON, which has no not-a-number."""
    return float(value) if np.isfinite(value) else None


def _under(arrays: Mapping[str, Array], prefix: str) -> dict[str, Array]:
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}


def _stage(report: Callable[[float, str], None], start: float, stop: float, name: str) -> Callable[[float, str], None]:
    """``report`` for one part of the work, from ``start`` to ``stop``, under a name."""
    return lambda fraction, message: report(start + (stop - start) * fraction, f"{name}: {message}")
