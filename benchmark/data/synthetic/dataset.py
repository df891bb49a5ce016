"""The data set: who there is, what each of them performs, and the true performance of it in the other style."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.data.base import ClipRecord, Dataset
from benchmark.data.cache import cached_clip, canonical_version
from benchmark.data.cards import Card, load_card
from benchmark.data.synthetic.actions import write_score
from benchmark.data.synthetic.body import Anatomy, Body, draw_anatomy
from benchmark.data.synthetic.content import ACTIONS, Content, draw_content
from benchmark.data.synthetic.perform import CAPTURE_FPS, capture_noise, perform
from benchmark.data.synthetic.styles import StyleParameters, individual, style_parameters
from benchmark.digest import digest, source_digest
from benchmark.errors import ConfigError, UnknownNameError
from benchmark.motion.canonical import canonicalise
from benchmark.motion.clip import ClipMeta, MotionClip
from benchmark.motion.skeleton import Skeleton

#: Streams of random numbers, so that what is drawn for one purpose never depends on another.
_ACTOR, _TAKES, _CONTENT, _NOISE = range(4)

_STYLE_NUMBER = {"adult": 0, "child": 1}


@dataclass(frozen=True)
class Actor:
    """One performer: a body and a way to move."""

    name: str
    style: str
    number: int
    anatomy: Anatomy
    parameters: StyleParameters

    @property
    def skeleton(self) -> Skeleton:
        """The actor's skeleton."""
        return self.anatomy.skeleton


@dataclass(frozen=True)
class TruthChange:
    """By which factors a true performance differs from the clip it answers.

    They are ratios of what the two performances were made with: exact before capture noise and sampling.

    Attributes
    ----------
    time
        Duration of everything but free flight: of steps, gestures, pauses. ``sqrt(leg ratio) / tempo ratio``.
    step_frequency
        Its inverse.
    step_length
        Metres per step: ``leg ratio * stride ratio``.
    arm_swing
        Angular amplitude of the arm swing in locomotion.
    amplitude
        Angular amplitude of deliberate limb movements.
    jump_rise
        Metres of rise of the hips in a jump: ``leg ratio * jump height ratio``.
    anticipation, landing
        Duration of preparations and of landings, ``time`` included. Depth limits of a landing may shorten it.
    """

    time: float
    step_frequency: float
    step_length: float
    arm_swing: float
    amplitude: float
    jump_rise: float
    anticipation: float
    landing: float


class SyntheticDataset(Dataset):
    """Procedural adults and children; see :mod:`benchmark.data.synthetic` for what is true about them.

    Parameters
    ----------
    seed
        The same seed gives the same bytes on one platform. Other platforms may differ in the last bits, where their
        mathematical functions do.
    adults, children
        How many actors of each style.
    takes
        How many takes of each action each actor performs: a number, or the lowest and highest of a number drawn for each.
    actions
        Which of the 21 actions, or ``None`` for all.
    fps_working
        Frames per second of the clips that :meth:`load` returns. Captures are at 120.

    Raises
    ------
    ConfigError
        A number out of range.
    UnknownNameError
        No such action.
    """

    def __init__(
        self,
        *,
        seed: int = 0,
        adults: int = 5,
        children: int = 5,
        takes: int | Sequence[int] = (2, 4),
        actions: Sequence[str] | None = None,
        fps_working: float = 60.0,
    ) -> None:
        self._seed = _whole("seed", seed, 0)
        self._cast = {"adult": _whole("adults", adults, 1), "child": _whole("children", children, 1)}
        low, high = (takes, takes) if isinstance(takes, int) else _pair(takes)
        self._takes = (_whole("takes", low, 1), _whole("takes", high, int(low)))
        for action in actions or ():
            if action not in ACTIONS:
                raise UnknownNameError("synthetic action", action, ACTIONS)
        self._actions = ACTIONS if actions is None else tuple(action for action in ACTIONS if action in actions)
        if not self._actions:
            raise ConfigError("actions is empty: name at least one, or leave it out for all 21")
        if not (0.0 < fps_working <= CAPTURE_FPS):
            raise ConfigError(
                f"fps_working is {fps_working}: synthetic captures are at 120 fps, so it must be in (0, 120]"
            )
        self._fps = float(fps_working)
        self._clips: dict[str, MotionClip] = {}

    @property
    def id(self) -> str:
        """``synthetic``."""
        return "synthetic"

    @cached_property
    def card(self) -> Card:
        """Licence, citation, and what is in it."""
        return load_card("synthetic")

    @property
    def fps(self) -> float:
        """Frames per second of the clips of :meth:`load` and :meth:`truth`."""
        return self._fps

    @property
    def options(self) -> Mapping[str, Any]:
        """The settings it was made with."""
        return {
            "seed": self._seed,
            "adults": self._cast["adult"],
            "children": self._cast["child"],
            "takes": list(self._takes),
            "actions": list(self._actions),
            "fps_working": self._fps,
        }

    @cached_property
    def actors(self) -> Mapping[str, Actor]:
        """Every performer by name, for example ``adult001``."""
        cast = {}
        for style, count in self._cast.items():
            for index in range(count):
                rng = self._rng(_ACTOR, _STYLE_NUMBER[style], index)
                name = f"{style}{index + 1:03d}"
                anatomy = draw_anatomy(style, index, count, rng)
                cast[name] = Actor(name, style, index, anatomy, individual(style, rng))
        return cast

    @cached_property
    def records(self) -> tuple[ClipRecord, ...]:
        """Every clip, sorted by id; nothing is generated for it."""
        generator = source_digest("benchmark.data.synthetic")
        records = []
        for actor in self.actors.values():
            for action in self._actions:
                rng = self._rng(_TAKES, _STYLE_NUMBER[actor.style], actor.number, ACTIONS.index(action))
                for take in range(1, int(rng.integers(self._takes[0], self._takes[1] + 1)) + 1):
                    made_from = {
                        "generator": generator,
                        "seed": self._seed,
                        "cast": self._cast,
                        "actor": actor.name,
                        "action": action,
                        "take": take,
                    }
                    records.append(
                        ClipRecord.of(
                            actor=actor.name,
                            style=actor.style,
                            action=action,
                            take=str(take),
                            path=None,
                            sha256=digest(made_from),
                        )
                    )
        return tuple(sorted(records, key=lambda record: record.clip_id))

    def load(self, clip_id: str) -> MotionClip:
        """The canonical clip, noise included, made when first asked for and then kept in memory and in the cache folder."""
        if clip_id not in self._clips:
            record = self.record(clip_id)
            key = digest({"synthetic": record.sha256, "fps": self._fps, "canonical": canonical_version()})
            meta = replace(record.meta, source="synthetic")
            self._clips[clip_id] = cached_clip(key, lambda: canonicalise(self.raw(clip_id), fps=self._fps), meta)
        return self._clips[clip_id]

    def raw(self, clip_id: str, *, noise: bool = True) -> MotionClip:
        """The clip as captured: 120 fps, T-pose first, facing anywhere; without ``noise`` the performance itself."""
        record = self.record(clip_id)
        actor = self.actors[record.actor]
        clip = self._perform(record, actor.skeleton, actor.parameters)
        return capture_noise(clip, self._rng(_NOISE, *self._numbers(record))) if noise else clip

    def content(self, clip_id: str) -> Content:
        """What is performed in a clip, which is what its truth shares with it."""
        record = self.record(clip_id)
        return draw_content(record.action, self._rng(_CONTENT, *self._numbers(record)))

    def parameters(self, actor_or_style: str) -> StyleParameters:
        """The true style parameters of an actor (``child003``) or of the average performer of a style (``child``)."""
        if actor_or_style in self.actors:
            return self.actors[actor_or_style].parameters
        if actor_or_style in self._cast:
            return style_parameters(actor_or_style)
        raise UnknownNameError("actor or style", actor_or_style, [*self._cast, *self.actors])

    def median_actor(self, style: str) -> Actor:
        """The actor of ``style`` with the median leg length (the shorter of the two middle ones)."""
        style_parameters(style)
        cast = sorted(
            (a for a in self.actors.values() if a.style == style), key=lambda a: (a.skeleton.leg_length, a.name)
        )
        return cast[(len(cast) - 1) // 2]

    def truth(
        self,
        clip_id: str,
        target_style: str,
        skeleton: Skeleton | None = None,
        *,
        parameters: StyleParameters | None = None,
    ) -> MotionClip:
        """The same content as it is performed in ``target_style``, without noise, canonical and at :attr:`fps`.

        Shared with the source: the action, which hand, foot and way of the turn, how often, how far it is meant in leg
        lengths, the order of events, the T-pose before it, and the random numbers that make cycles uneven. Different: the
        body, and every style parameter. So durations change by :attr:`TruthChange.time` (preparations and landings by
        their own factors on top), lengths with the leg and the stride, angles with the amplitudes, postures by the
        parameters that are angles; free flight obeys gravity in both. :meth:`change` gives the factors.

        Parameters
        ----------
        clip_id
            The source.
        target_style
            ``adult`` or ``child``. The source's own style gives its own noise-free performance, by its own actor.
        skeleton
            The body to perform with: any skeleton of this data set's joints. By default that of :meth:`median_actor`.
        parameters
            The style parameters; by default those of the average performer of ``target_style``.

        Raises
        ------
        DataError
            If there is no such clip, or the skeleton has other joints.
        UnknownNameError
            If there is no such style.
        """
        record = self.record(clip_id)
        body, style = self._target(record, target_style, skeleton, parameters)
        clip = self._perform(record, body, style)
        meta = ClipMeta("truth", target_style, record.action, record.take, f"synthetic truth of {clip_id}")
        return canonicalise(clip.replace(meta=meta), fps=self._fps)

    def has_truth(self, clip_id: str, target_style: str) -> bool:
        """Whether the clip exists and the style is one of the two."""
        self.record(clip_id)
        return target_style in self._cast

    def change(
        self,
        clip_id: str,
        target_style: str,
        skeleton: Skeleton | None = None,
        *,
        parameters: StyleParameters | None = None,
    ) -> TruthChange:
        """In which respects, and by how much, the truth differs from the clip; parameters as in :meth:`truth`."""
        record = self.record(clip_id)
        body, after = self._target(record, target_style, skeleton, parameters)
        actor = self.actors[record.actor]
        before = actor.parameters
        leg = Body(body).leg / Body(actor.skeleton).leg
        ratio = after.ratio(before)
        time = float(np.sqrt(leg)) / ratio["tempo"]
        return TruthChange(
            time=time,
            step_frequency=1.0 / time,
            step_length=leg * ratio["stride"],
            arm_swing=ratio["arm_swing"],
            amplitude=ratio["amplitude"],
            jump_rise=leg * ratio["jump_height"],
            anticipation=time * ratio["anticipation"],
            landing=time * ratio["landing"],
        )

    def write_bvh(
        self, folder: Path | str, *, progress: Callable[[float, str], None] = lambda done, name: None
    ) -> list[Path]:
        """Write every raw clip to ``{style}/{actor}/{action}_{take}.bvh`` below ``folder``, which ``folder:PATH`` reads back.

        Parameters
        ----------
        folder
            Created if need be; files of the same names are replaced.
        progress
            Called with the fraction done and the clip's id before each clip.

        Returns
        -------
        list of Path
            The files, in the order of :attr:`records`.
        """
        from benchmark.motion import bvh

        files = []
        for index, record in enumerate(self.records):
            progress(index / len(self.records), record.clip_id)
            path = Path(folder) / record.style / record.actor / f"{record.action}_{record.take}.bvh"
            path.parent.mkdir(parents=True, exist_ok=True)
            bvh.save(self.raw(record.clip_id), path)
            files.append(path)
        progress(1.0, "")
        return files

    def _target(
        self, record: ClipRecord, style: str, skeleton: Skeleton | None, parameters: StyleParameters | None
    ) -> tuple[Skeleton, StyleParameters]:
        average = style_parameters(style)
        own = self.actors[record.actor]
        if style == record.style:
            return skeleton or own.skeleton, parameters or own.parameters
        return skeleton or self.median_actor(style).skeleton, parameters or average

    def _perform(self, record: ClipRecord, skeleton: Skeleton, style: StyleParameters) -> MotionClip:
        meta = ClipMeta(record.actor, record.style, record.action, record.take, "synthetic")
        return perform(write_score(self.content(record.clip_id), Body(skeleton), style), meta=meta)

    def _numbers(self, record: ClipRecord) -> tuple[int, ...]:
        actor = self.actors[record.actor]
        return (_STYLE_NUMBER[actor.style], actor.number, ACTIONS.index(record.action), int(record.take))

    def _rng(self, *stream: int) -> np.random.Generator:
        return np.random.Generator(np.random.PCG64(np.random.SeedSequence([self._seed, *stream])))


def _whole(name: str, value: object, least: int) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < least:
        raise ConfigError(f"{name} is {value!r}: it must be a whole number of at least {least}")
    return value


def _pair(takes: Sequence[int]) -> tuple[int, int]:
    values = tuple(takes)
    if len(values) != 2:
        raise ConfigError(f"takes is {takes!r}: give one number, or the lowest and the highest")
    return values
