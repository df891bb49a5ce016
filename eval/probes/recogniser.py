"""Recognisers: which style and which action a clip shows, judged by a classifier that has seen the training clips alone.

What the families of classifier share is here: who is left out while it is found out how far a classifier can be trusted, how
clips are weighted, how scores become probabilities, and how all of it is stored. A family adds what it looks at and how it
learns.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from benchmark.api import FitContext, NotApplicableError, Probe, StyleTask, TrainView
from benchmark.errors import ContractError, StoreError
from benchmark.motion.clip import MotionClip
from benchmark.motion.resample import low_pass
from eval.probes.storage import read_arrays, write_arrays

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Weights = dict[str, NDArray]

#: Most groups of performers to leave out in turn. Each costs one training.
MOST_FOLDS = 5

#: Groups of clips where performers are unknown.
_CLIP_FOLDS = 3

#: Hertz below which nearly all of human movement lies (Winter 2009), and above which most capture noise does.
CUTOFF = 6.0

#: Range of the calibrated temperature. Scores that say nothing about performers not seen are flattened to even odds.
_TEMPERATURES = (0.1, 1e3)


@dataclass(frozen=True, eq=False)
class Examples:
    """Clips as a classifier learns from them.

    Attributes
    ----------
    features
        N arrays (T_i, D): rows are frames or windows of a clip.
    style
        (N,) 0 for the source style, 1 for the target style.
    action
        (N,) index of the action.
    """

    features: Sequence[Array]
    style: Indices
    action: Indices

    def __len__(self) -> int:
        return len(self.features)

    def take(self, chosen: Indices) -> Examples:
        """Those at the positions ``chosen``."""
        return Examples([self.features[i] for i in chosen], self.style[chosen], self.action[chosen])

    @property
    def shared(self) -> NDArray[np.bool_]:
        """(N,) whether the clip's action is there in both styles. Others would tell the style by what is done."""
        both = set(self.action[self.style == 0]) & set(self.action[self.style == 1])
        return np.isin(self.action, sorted(both))

    @property
    def action_weights(self) -> Array:
        """(N,) weights of sum 1 under which every action counts the same, and within an action every style and every clip."""
        weights = np.zeros(len(self))
        for action in np.unique(self.action):
            styles = np.unique(self.style[self.action == action])
            for style in styles:
                cell = (self.action == action) & (self.style == style)
                weights[cell] = 1.0 / (len(styles) * cell.sum())
        return weights / weights.sum()

    @property
    def style_weights(self) -> Array:
        """(N,) weights of sum 1 under which an action says nothing about the style: 0 for actions that only one style has."""
        weights = np.where(self.shared, self.action_weights, 0.0)
        return weights / weights.sum()


@dataclass(frozen=True, eq=False)
class Scores:
    """What a classifier says about the W windows of one clip, before the softmax.

    Attributes
    ----------
    style
        (W, 2) source style, target style.
    action
        (W, A).
    """

    style: Array
    action: Array


@dataclass(frozen=True, eq=False)
class Recognition:
    """What a recogniser sees in a clip.

    Attributes
    ----------
    target
        Probability of the target style, mean over windows.
    actions
        Probability of each action, mean over windows.
    """

    target: float
    actions: Mapping[str, float]

    @property
    def action(self) -> str:
        """The most probable action."""
        return max(self.actions, key=lambda name: self.actions[name])


class Recogniser(Probe):
    """A style and action classifier with calibrated probabilities.

    Fitting goes through the training clips twice. First performers are left out in turn, one of each style at a time (at
    most :data:`MOST_FOLDS` groups; clips instead of performers where fewer than two are known of a style), and a classifier
    trained without them judges them: that gives :attr:`facts_`, an honest account of how far it can be trusted with strangers,
    and the temperature that makes its probabilities mean something (Guo et al. 2017). Then the classifiers that are used are
    trained on all. Every action counts the same in both styles, so that a style cannot be told from what is performed.

    Attributes
    ----------
    styles_
        Source and target style.
    actions_
        The actions learned, sorted.
    members_
        Parameters of the classifiers whose probabilities are averaged.
    temperatures_
        For style and action: what scores are divided by before the softmax.
    facts_
        JSON-ready: ``style_accuracy`` and ``action_accuracy`` on those left out (the mean over the styles or actions of each
        one's share), ``style_p_target`` by style, ``chance_style``, ``chance_action``, ``left_out`` (``performers`` or
        ``clips``), ``folds``, ``clips``. An accuracy is ``None`` where nobody could be left out.
    """

    #: How many classifiers are averaged.
    members: ClassVar[int] = 1

    styles_: tuple[str, str]
    actions_: tuple[str, ...]
    members_: list[Weights]
    temperatures_: dict[str, float]
    facts_: dict[str, Any]

    @abstractmethod
    def features(self, clip: MotionClip) -> Array:
        """What the classifier looks at: (T, D) rows of frames or windows, free of size, place and facing."""

    @abstractmethod
    def learn(self, examples: Examples, rng: np.random.Generator) -> Weights:
        """Train one classifier and return its parameters, normalisation included."""

    @abstractmethod
    def scores(self, weights: Weights, features: Array) -> Scores:
        """What a classifier says about the features of a clip."""

    def fit(self, train: TrainView, task: StyleTask, *, rng: np.random.Generator, ctx: FitContext) -> Self:
        """Learn to tell the styles of ``task``, and the actions, from the training clips of both styles.

        Raises
        ------
        NotApplicableError
            If the styles are the same, one has no clip, or no action is performed in both.
        """
        _seen.pop(self, None)
        self.members_, self.temperatures_, self.facts_ = [], {}, {}
        self.styles_ = (task.source_style, task.target_style)
        if task.source_style == task.target_style:
            raise NotApplicableError(f"{task.source_style!r} cannot be told from itself")
        given = [*train.clips(task.source_style), *train.clips(task.target_style)]
        described = [(clip, features) for clip in given if (features := self._described(clip)) is not None]
        clips = [clip for clip, _ in described]
        self.actions_ = tuple(sorted({clip.meta.action for clip in clips}))
        examples = Examples(
            [features for _, features in described],
            np.array([clip.meta.style == task.target_style for clip in clips], dtype=np.int64),
            np.array([self.actions_.index(clip.meta.action) for clip in clips], dtype=np.int64),
        )
        if not examples.shared.any():
            raise NotApplicableError(
                f"no action is performed in both {task.source_style!r} and {task.target_style!r} by the training "
                "performers, so a style cannot be told from what is performed"
            )
        fold, by_performer = deal(clips, examples)
        rounds = int(fold.max()) + 2
        held: list[Scores | None] = [None] * len(examples)
        known = np.zeros(len(examples), dtype=bool)
        for number in range(int(fold.max()) + 1):
            ctx.report(number / rounds, "judging those left out")
            rest = examples.take(np.flatnonzero(fold != number))
            if not rest.shared.any():
                continue
            judges = [self.learn(rest, rng) for _ in range(self.members)]
            for index in np.flatnonzero(fold == number).tolist():
                held[index] = self._joint_scores(judges, examples.features[index])
                known[index] = examples.action[index] in rest.action
        self._trust(examples, held, known)
        self.facts_ |= {
            "left_out": "performers" if by_performer else "clips",
            "folds": int(fold.max()) + 1,
            "clips": len(examples),
        }
        ctx.report((rounds - 1) / rounds, "learning to recognise")
        self.members_ = [self.learn(examples, rng) for _ in range(self.members)]
        return self

    def recognise(self, clip: MotionClip) -> Recognition:
        """Style and action of a clip: calibrated probabilities, averaged over windows and classifiers. Kept while it lives."""
        if not getattr(self, "members_", None):
            raise ContractError(f"{self.info.name} was not fitted")
        seen = _seen.setdefault(self, WeakKeyDictionary())
        if clip not in seen:
            judged = self._joint_scores(self.members_, self.features(clip))
            target = softmax(judged.style, self.temperatures_["style"])[:, 1].mean()
            actions = softmax(judged.action, self.temperatures_["action"]).mean(axis=0)
            seen[clip] = Recognition(float(target), dict(zip(self.actions_, map(float, actions), strict=True)))
        return seen[clip]

    def _described(self, clip: MotionClip) -> Array | None:
        """The features of a training clip, or nothing where it is too short to have any."""
        try:
            return self.features(clip)
        except NotApplicableError:
            return None

    def _joint_scores(self, members: Sequence[Weights], features: Array) -> Scores:
        """The scores of all classifiers as if each looked at windows of its own: the mean over rows is over both."""
        each = [self.scores(weights, features) for weights in members]
        return Scores(np.concatenate([one.style for one in each]), np.concatenate([one.action for one in each]))

    def save(self, folder: Path) -> None:
        """Write the parameters as ``.npz`` and everything else as JSON."""
        arrays = {
            f"{number}/{name}": array for number, each in enumerate(self.members_) for name, array in each.items()
        }
        facts = {
            "probe": self.info.name,
            "styles": self.styles_,
            "actions": self.actions_,
            "members": len(self.members_),
            "temperatures": self.temperatures_,
            "facts": self.facts_,
        }
        write_arrays(folder, arrays, facts)

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read what :meth:`save` wrote; a :class:`~benchmark.errors.StoreError` says what is wrong with it."""
        arrays, stored = read_arrays(folder)
        if not isinstance(stored, dict) or stored.get("probe") != cls.info.name:
            raise StoreError(f"{folder} holds no {cls.info.name}: remove it and fit again")
        probe = cls()
        probe.styles_ = (stored["styles"][0], stored["styles"][1])
        probe.actions_ = tuple(stored["actions"])
        probe.temperatures_, probe.facts_ = stored["temperatures"], stored["facts"]
        probe.members_ = [
            {name.removeprefix(f"{number}/"): array for name, array in arrays.items() if name.startswith(f"{number}/")}
            for number in range(stored["members"])
        ]
        return probe

    def _trust(self, examples: Examples, held: Sequence[Scores | None], known: NDArray[np.bool_]) -> None:
        """Temperatures and accuracies from the scores of clips by those left out; ``known`` ones do an action trained on."""
        judged = np.array([scores is not None for scores in held])
        for kind, labels, weights, counted in (
            ("style", examples.style, examples.style_weights, judged & examples.shared),
            ("action", examples.action, examples.action_weights, judged & known),
        ):
            chosen = np.flatnonzero(counted & (weights > 0.0))
            count = 2 if kind == "style" else len(self.actions_)
            self.facts_[f"chance_{kind}"] = 1.0 / count
            if len(chosen) == 0:
                self.temperatures_[kind] = 1.0
                self.facts_[f"{kind}_accuracy"] = None
                continue
            scores: list[Array] = [getattr(held[index], kind) for index in chosen.tolist()]
            temperature = calibrate(scores, labels[chosen], weights[chosen])
            means = np.array([softmax(each, temperature).mean(axis=0) for each in scores])
            right = means.argmax(axis=1) == labels[chosen]
            self.temperatures_[kind] = temperature
            self.facts_[f"{kind}_accuracy"] = float(
                np.mean([right[labels[chosen] == label].mean() for label in np.unique(labels[chosen])])
            )
            if kind == "style":
                self.facts_["style_p_target"] = {
                    style: float(means[labels[chosen] == number, 1].mean())
                    for number, style in enumerate(self.styles_)
                    if np.any(labels[chosen] == number)
                }


def smoothed(clip: MotionClip) -> MotionClip:
    """What a recogniser may see of a clip: nothing above :data:`CUTOFF` hertz.

    Capture noise in metres is larger in angles on a small body than on a large one. A classifier that sees it tells children by
    how rough their capture is, and then calls whatever is smoother than a depth camera an adult.

    The latest is kept: one recogniser after the other looks at a result, and what they describe of it is kept with the clip.
    """
    if clip not in _smoothed:
        _smoothed.clear()
        _smoothed[clip] = low_pass(clip, CUTOFF)
    return _smoothed[clip]


_smoothed: WeakKeyDictionary[MotionClip, MotionClip] = WeakKeyDictionary()


def softmax(scores: Array, temperature: float = 1.0) -> Array:
    """Probabilities (..., K) of scores (..., K) divided by ``temperature``."""
    scaled = np.asarray(scores, dtype=np.float64) / temperature
    exp = np.exp(scaled - scaled.max(axis=-1, keepdims=True))
    return exp / exp.sum(axis=-1, keepdims=True)


def calibrate(scores: Sequence[Array], labels: Indices, weights: Array) -> float:
    """The temperature under which the mean probabilities of clips are most likely (Guo et al. 2017).

    Parameters
    ----------
    scores
        N arrays (W_i, K) of clips that the classifier was not trained on.
    labels
        (N,) what they are.
    weights
        (N,) non-negative.

    Returns
    -------
    float
        ``argmin_T -sum_i w_i sum_k y_ik log mean_w softmax(s_iw / T)_k``. The targets ``y`` are 1 less ``(K - 1) / (N + K)``
        for the label and ``1 / (N + K)`` for the others, after Platt 1999: no number of clips judged rightly makes certain.
    """
    from scipy.optimize import minimize_scalar

    count, classes = len(scores), scores[0].shape[-1]
    targets = np.full((count, classes), 1.0 / (count + classes))
    targets[np.arange(count), labels] = 1.0 - (classes - 1.0) / (count + classes)
    share = weights / weights.sum()
    windows = np.concatenate([np.asarray(each, dtype=np.float64) for each in scores])
    starts = np.cumsum([0, *(len(each) for each in scores)])[:-1]
    lengths = np.array([len(each) for each in scores], dtype=np.float64)

    def loss(log_temperature: float) -> float:
        sums = np.add.reduceat(softmax(windows, float(np.exp(log_temperature))), starts, axis=0)
        likely = np.log(np.maximum(sums / lengths[:, None], 1e-300))
        return float(-np.sum(share[:, None] * targets * likely))

    low, high = np.log(_TEMPERATURES)
    return float(np.exp(minimize_scalar(loss, bounds=(low, high), method="bounded").x))


def deal(clips: Sequence[MotionClip], examples: Examples) -> tuple[Indices, bool]:
    """Who is left out together.

    Parameters
    ----------
    clips, examples
        The N training clips, and what they are.

    Returns
    -------
    fold
        (N,) number of the group. Performers are dealt in the order of their names, each style by itself, so that a group has
        one or more of each style while there are any.
    by_performer
        False where a style has fewer than two performers known: then the clips of each action and style are dealt in blocks.
    """
    actors = [clip.meta.actor for clip in clips]
    casts = [sorted({actors[i] for i in np.flatnonzero(examples.style == style)}) for style in (0, 1)]
    if "" not in actors and min(map(len, casts)) >= 2:
        # Who performs in both styles must be left out of both.
        common = bool(set(casts[0]) & set(casts[1]))
        lists = [sorted({*casts[0], *casts[1]})] if common else casts
        place = {name: index for names in lists for index, name in enumerate(names)}
        folds = min(MOST_FOLDS, max(map(len, lists)))
        return np.array([place[name] % folds for name in actors], dtype=np.int64), True
    fold = np.zeros(len(clips), dtype=np.int64)
    for style in (0, 1):
        for action in np.unique(examples.action):
            cell = np.flatnonzero((examples.style == style) & (examples.action == action))
            # Takes in a row resemble one another: blocks leak less than every third clip.
            fold[cell] = (np.arange(len(cell)) * _CLIP_FOLDS // max(len(cell), 1) + action) % _CLIP_FOLDS
    return fold, False


_seen: WeakKeyDictionary[Recogniser, WeakKeyDictionary[MotionClip, Recognition]] = WeakKeyDictionary()
