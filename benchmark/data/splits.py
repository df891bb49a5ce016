"""Splits as frozen manifests: which clips train, which are transferred, and which real clips they are compared with.

Clips are held out by performer, take, block of takes or action, never by window: windows of one clip on both sides of a split
would make every learned method look better than it is.

Protocols
---------
``paper``
    The protocol of Dong et al. 2020 (MIG, section 5.1): 90 % of the clips of ``n_train`` performers of each style train, the
    rest are the *seen-actor* test; ``n_unseen`` further performers of each style are the *unseen-actor* test.
``actors-kfold``
    Performers of both styles are dealt into ``folds`` groups; the group ``fold`` is held out.
``take-block``
    Of each performer's takes of an action, one of ``blocks`` contiguous blocks is held out: for recordings whose consecutive
    takes resemble each other.
``action``
    Actions are dealt into ``folds`` groups; the group ``fold`` is held out in both styles.
``named``
    For published experiments, which say who was recorded and not how they were drawn: all clips of the performers ``train``
    train, in whichever of the two styles they are; the source clips of the performers ``test`` are transferred; the target
    clips of all performers outside training are the references. ``actions`` narrows all three to the actions listed;
    without it every action takes part. Nothing is drawn, so neither seed nor fold has a part in it.
``auto``
    The one that the data set's card names, or that suits the two styles.

Every choice is made by ordering names by the SHA-256 of seed and name, so that a split is the same on every platform and with
every version of every library.
"""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import ClassVar

from pydantic import ConfigDict, TypeAdapter, ValidationError

from benchmark.data.base import ClipRecord, Dataset
from benchmark.data.leakage import find_leak, natural
from benchmark.digest import digest as json_digest
from benchmark.errors import DataError, LeakageError, UnknownNameError

FORMAT = 1

#: A parameter of a protocol: a number, or names of performers or actions.
Parameter = float | int | tuple[str, ...]


@dataclass(frozen=True)
class TestItem:
    """A clip to transfer, and whether other clips of its performer train."""

    __test__: ClassVar[bool] = False
    clip_id: str
    seen_actor: bool


@dataclass(frozen=True)
class Split:
    """A frozen split.

    Attributes
    ----------
    dataset
        Id of the data set's card.
    source_style, target_style
        The task.
    protocol, fold, seed, parameters
        What made it.
    train
        Ids of the training clips, sorted.
    test
        The source-style clips to transfer, sorted.
    references
        Ids of target-style clips outside the training set, sorted: only ever compared with.
    files
        SHA-256 of every clip named above.
    """

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid")
    dataset: str
    source_style: str
    target_style: str
    protocol: str
    fold: int
    seed: int
    train: tuple[str, ...]
    test: tuple[TestItem, ...]
    references: tuple[str, ...]
    files: Mapping[str, str]
    parameters: Mapping[str, Parameter] = field(default_factory=dict)

    @cached_property
    def digest(self) -> str:
        """Hex SHA-256 of everything in the manifest."""
        return json_digest({"format": FORMAT, **asdict(self)})

    @property
    def clip_ids(self) -> tuple[str, ...]:
        """Every clip of the split."""
        return (*self.train, *(item.clip_id for item in self.test), *self.references)

    def to_json(self, path: Path | str) -> None:
        """Write the manifest with its digest."""
        from benchmark.data.cache import atomic_path

        text = json.dumps({"format": FORMAT, "digest": self.digest, **asdict(self)}, indent=2, sort_keys=True)
        with atomic_path(Path(path)) as temporary:
            temporary.write_text(text + "\n", encoding="utf-8")

    @classmethod
    def from_json(cls, path: Path | str) -> Split:
        """Read a manifest; a :class:`~benchmark.errors.DataError` says what is wrong with it.

        Check it against the data set with :func:`check` before use; the views do so.
        """
        path = Path(path)
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            raise DataError(f"there is no split manifest {path}") from None
        except (OSError, ValueError) as error:
            raise DataError(f"{path} is not a split manifest ({error})") from error
        if not isinstance(content, dict) or content.get("format") != FORMAT:
            raise DataError(f"{path} is not a split manifest of format {FORMAT}")
        stated = content.pop("digest", None)
        del content["format"]
        try:
            split: Split = TypeAdapter(cls).validate_json(json.dumps(content), strict=True)
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(str(part) for part in first["loc"])
            raise DataError(f"{path}: {where}: {first['msg']}") from error
        if split.digest != stated:
            raise DataError(
                f"{path} was changed after it was written: its digest is not the one it states; make it again"
            )
        return split


def check(split: Split, dataset: Dataset) -> None:
    """Whether ``split`` can be used with ``dataset``: called on every load.

    Raises
    ------
    DataError
        A clip is missing or its file is not the one that was split; the message names it.
    LeakageError
        A clip, file, take, performer, block or action is on both sides.
    """
    if split.dataset != dataset.card.id:
        raise DataError(f"the split was made for data set {split.dataset!r}, not for {dataset.card.id!r}")
    known = {record.clip_id: record for record in dataset.records}
    for clip_id in split.clip_ids:
        if clip_id not in known:
            raise DataError(
                f"clip {clip_id!r} of the split is not in data set {dataset.id}: restore it or make a new split"
            )
        if clip_id not in split.files:
            raise DataError(f"the split names clip {clip_id!r} without the digest of its file; make it again")
        if split.files[clip_id] != known[clip_id].sha256:
            raise DataError(
                f"clip {clip_id!r} was altered since the split was made "
                f"({split.files[clip_id][:12]}… then, {known[clip_id].sha256[:12]}… now): restore it or make a new split"
            )
    leak = find_leak(split, known)
    if leak is not None:
        raise LeakageError(leak)


def load_split(path: Path | str, dataset: Dataset) -> Split:
    """Read a manifest and :func:`check` it."""
    split = Split.from_json(path)
    check(split, dataset)
    return split


def make_split(
    dataset: Dataset,
    source_style: str,
    target_style: str,
    /,
    *,
    protocol: str = "auto",
    fold: int = 0,
    seed: int = 0,
    **parameters: float | Sequence[str],
) -> Split:
    """Split a data set for one task.

    Parameters
    ----------
    protocol
        See the module's notes.
    fold
        Which group is held out; for ``paper``, which of endlessly many draws of performers.
    seed
        Orders performers, actions and takes.
    parameters
        ``paper``: ``n_train=3``, ``n_unseen=1``, ``held_out=0.1``; ``actors-kfold`` and ``action``: ``folds`` (5 and 3, or
        fewer where there are fewer performers or actions); ``take-block``: ``blocks=3``; ``named``: ``train`` and ``test``
        (lists of performers) and ``actions=()`` (a list of actions, all where it is empty).

    Raises
    ------
    DataError
        The data set has too few performers, takes or actions; the message says what there is and what would work. Or a
        parameter has no sensible value.
    UnknownNameError
        No such style, protocol, parameter, performer or action; the message suggests the nearest.
    LeakageError
        One recording lies in the data set under two names.
    """
    records = dataset.task_records(source_style, target_style)
    pool = _Pool(records, source_style, target_style, dataset.id)
    if fold < 0:
        raise DataError(f"fold must be 0 or more, not {fold}")
    if protocol == "auto":
        protocol = dataset.default_protocol(source_style, target_style)
        if protocol == "auto":
            protocol, found = _suited(pool)
            parameters = {**found, **parameters}
    if protocol not in _PROTOCOLS:
        raise UnknownNameError("split protocol", protocol, [*_PROTOCOLS, "auto"])
    make, defaults = _PROTOCOLS[protocol]
    for name in parameters:
        if name not in defaults:
            raise UnknownNameError(f"parameter of protocol {protocol}", name, defaults)
    chosen = {**defaults, **{name: _checked(protocol, name, value, defaults) for name, value in parameters.items()}}
    train, test, references, used = make(pool, chosen, fold, seed)
    if not test:
        raise DataError(f"protocol {protocol!r} leaves nothing to transfer in {dataset.id}; {pool.advice()}")
    for style in (source_style, target_style):
        if not any(record.style == style for record in train):
            raise DataError(
                f"protocol {protocol!r} leaves no {style!r} clip to learn from in {dataset.id}; {pool.advice()}"
            )
    trained = {record.actor for record in train}
    items = tuple(
        TestItem(record.clip_id, record.actor in trained and not (protocol == "take-block" and record.actor == ""))
        for record in _sorted(test)
    )
    everything = [*train, *test, *references]
    split = Split(
        dataset=dataset.card.id,
        source_style=source_style,
        target_style=target_style,
        protocol=protocol,
        fold=fold,
        seed=seed,
        train=tuple(record.clip_id for record in _sorted(train)),
        test=items,
        references=tuple(record.clip_id for record in _sorted(references)),
        files={record.clip_id: record.sha256 for record in _sorted(everything)},
        parameters=used,
    )
    check(split, dataset)
    return split


def available_protocols(dataset: Dataset, source_style: str, target_style: str) -> tuple[str, ...]:
    """The protocols, with settings, that the data set has enough performers, takes and actions for."""
    pool = _Pool(dataset.task_records(source_style, target_style), source_style, target_style, dataset.id)
    return tuple(pool.possible())


_Parts = tuple[list[ClipRecord], list[ClipRecord], list[ClipRecord], dict[str, Parameter]]
_Parameters = Mapping[str, Parameter]


class _Pool:
    """The clips of a task, counted in the ways that protocols need."""

    def __init__(self, records: Sequence[ClipRecord], source_style: str, target_style: str, name: str) -> None:
        self.name = name
        self.source_style, self.target_style = source_style, target_style
        self.records = records
        self.source = [record for record in records if record.style == source_style]
        self.target = [record for record in records if record.style == target_style]
        self.source_actors = sorted({record.actor for record in self.source if record.actor})
        self.target_actors = sorted({record.actor for record in self.target if record.actor})
        self.actions = sorted({record.action for record in self.source} & {record.action for record in self.target})

    def fewest_actors(self) -> int:
        return min(len(self.source_actors), len(self.target_actors))

    def most_takes(self) -> int:
        """Takes of one action by one performer: the smaller of the two styles' largest counts."""
        return min(max(len(takes) for takes in _sequences(side).values()) for side in (self.source, self.target))

    def possible(self) -> list[str]:
        found = []
        if self.fewest_actors() >= 2:
            n_train = min(3, self.fewest_actors() - 1)
            found += ["paper" if n_train == 3 else f"paper with n_train={n_train}", "actors-kfold"]
        if self.most_takes() >= 2:
            found.append("take-block" if self.most_takes() >= 3 else "take-block with blocks=2")
        if len(self.actions) >= 2:
            found.append("action")
        return found

    def advice(self) -> str:
        there = "; ".join(
            f"{style}: {len(side)} clips, {len(actors) or 'unknown'} performers"
            for style, side, actors in (
                (self.source_style, self.source, self.source_actors),
                (self.target_style, self.target, self.target_actors),
            )
        )
        possible = self.possible()
        would = (
            f"protocols that would work: {', '.join(possible)}" if possible else "no protocol can split so few clips"
        )
        return f"there are {there}; {len(self.actions)} actions in both; {would}"


def _suited(pool: _Pool) -> tuple[str, dict[str, float]]:
    if pool.fewest_actors() >= 2:
        return "paper", {"n_train": min(3, pool.fewest_actors() - 1)}
    if pool.most_takes() >= 2:
        return "take-block", {"blocks": min(3, pool.most_takes())}
    if len(pool.actions) >= 2:
        return "action", {}
    raise DataError(
        f"data set {pool.name} cannot be split for {pool.source_style}:{pool.target_style}: {pool.advice()}"
    )


def _paper(pool: _Pool, parameters: _Parameters, fold: int, seed: int) -> _Parts:
    n_train, n_unseen = _count(parameters, "n_train", 1), _count(parameters, "n_unseen", 0)
    held_out = float(_number(parameters, "held_out"))
    if not 0.0 <= held_out < 0.5:
        raise DataError(f"held_out must be at least 0 and below 0.5, not {held_out}")
    order = _ordering("paper", seed, fold)
    # One order for both styles: someone who performs both is chosen for both or for neither.
    sources, targets = sorted(pool.source_actors, key=order), sorted(pool.target_actors, key=order)
    train_actors = {*sources[:n_train], *targets[:n_train]}
    unseen_sources = [actor for actor in sources if actor not in train_actors][:n_unseen]
    unseen_targets = [actor for actor in targets if actor not in train_actors]
    if min(len(sources), len(targets)) < n_train or min(len(unseen_sources), len(unseen_targets)) < n_unseen:
        raise DataError(
            f"protocol 'paper' with n_train={n_train} and n_unseen={n_unseen} needs {n_train + n_unseen} performers of each "
            f"style in {pool.name}: {pool.advice()}"
        )
    train_source = [record for record in pool.source if record.actor in sources[:n_train]]
    train_target = [record for record in pool.target if record.actor in targets[:n_train]]
    held = _held_out_pairs(train_source, train_target, sources[:n_train], targets[:n_train], held_out, order)
    held_ids = {record.clip_id for pair in held for record in pair}
    train = [record for record in (*train_source, *train_target) if record.clip_id not in held_ids]
    test = [source for source, _ in held] + [record for record in pool.source if record.actor in unseen_sources]
    references = [target for _, target in held] + [record for record in pool.target if record.actor in unseen_targets]
    return train, test, references, {"n_train": n_train, "n_unseen": n_unseen, "held_out": held_out}


def _held_out_pairs(
    train_source: Sequence[ClipRecord],
    train_target: Sequence[ClipRecord],
    sources: Sequence[str],
    targets: Sequence[str],
    fraction: float,
    order: Callable[[str], str],
) -> list[tuple[ClipRecord, ClipRecord]]:
    """Seen-actor test clips, each with the real target clip of its action that is kept out of training beside it.

    The i-th performers of both styles give up the same (action, take) combinations, each i others, so that an action that
    is tested is still learned from the other performers. A clip whose action would vanish from training stays in it.
    """
    left = Counter((record.style, record.action) for record in (*train_source, *train_target))
    used: set[tuple[str, str]] = set()
    used_actions: set[str] = set()
    pairs = []
    for index, (source_actor, target_actor) in enumerate(zip(sources, targets, strict=True)):
        mine = [record for record in train_source if record.actor == source_actor]
        theirs: dict[str, list[ClipRecord]] = defaultdict(list)
        for record in train_target:
            if record.actor == target_actor:
                theirs[record.action].append(record)
        fewest = min(len(mine), sum(map(len, theirs.values())))
        wanted = max(1, round(fraction * fewest)) if fraction > 0 and fewest > 1 else 0
        candidates = sorted(
            (record for record in mine if theirs.get(record.action)),
            key=lambda record, index=index: order(f"{index}/{record.action}/{record.take}"),  # type: ignore[misc]
        )
        taken: set[str] = set()
        given = 0
        for fresh in ("action", "combination", "any"):
            for source in candidates:
                if given == wanted:
                    break
                combination = (source.action, source.take)
                stale = (
                    source.action in used_actions
                    if fresh == "action"
                    else fresh == "combination" and combination in used
                )
                if source.clip_id in taken or stale:
                    continue
                options = [record for record in theirs[source.action] if record.clip_id not in taken]
                keys = [(record.style, record.action) for record in (source, *options[:1])]
                if not options or any(left[key] < 2 for key in keys):
                    continue
                target = min(options, key=lambda r: (r.take != source.take, order(r.clip_id)))
                pairs.append((source, target))
                taken |= {source.clip_id, target.clip_id}
                given += 1
                used.add(combination)
                used_actions.add(source.action)
                left.subtract(keys)
    return pairs


def _actors_kfold(pool: _Pool, parameters: _Parameters, fold: int, seed: int) -> _Parts:
    if pool.fewest_actors() < 2:
        raise DataError(f"protocol 'actors-kfold' needs two performers of each style in {pool.name}: {pool.advice()}")
    folds = _folds(parameters, 5, pool.fewest_actors(), fold, "performers of each style")
    order = _ordering("actors-kfold", seed)
    both = set(pool.source_actors) & set(pool.target_actors)
    # People who perform both styles are dealt first, so that a group holds the same ones of either style.
    group: dict[str, int] = {}
    for part in (both, set(pool.source_actors) - both, set(pool.target_actors) - both):
        start = len(both) if part is not both else 0
        group |= {actor: (start + place) % folds for place, actor in enumerate(sorted(part, key=order))}
    train = [record for record in pool.records if group.get(record.actor, fold) != fold]
    test = [record for record in pool.source if group.get(record.actor) == fold]
    references = [record for record in pool.target if group.get(record.actor) == fold]
    return train, test, references, {"folds": folds}


def _take_block(pool: _Pool, parameters: _Parameters, fold: int, seed: int) -> _Parts:
    blocks = _count(parameters, "blocks", 2)
    if fold >= blocks:
        raise DataError(f"fold {fold} of protocol 'take-block' does not exist: there are blocks 0 to {blocks - 1}")
    if pool.most_takes() < 2:
        raise DataError(
            f"protocol 'take-block' needs two takes of an action in both styles of {pool.name}: {pool.advice()}"
        )
    held = []
    for takes in _sequences(pool.records).values():
        if len(takes) > 1:
            held += takes[len(takes) * fold // blocks : len(takes) * (fold + 1) // blocks]
    ids = {record.clip_id for record in held}
    train = [record for record in pool.records if record.clip_id not in ids]
    test = [record for record in held if record.style == pool.source_style]
    references = [record for record in held if record.style == pool.target_style]
    return train, test, references, {"blocks": blocks}


def _action(pool: _Pool, parameters: _Parameters, fold: int, seed: int) -> _Parts:
    if len(pool.actions) < 2:
        raise DataError(f"protocol 'action' needs two actions that both styles have in {pool.name}: {pool.advice()}")
    folds = _folds(parameters, 3, len(pool.actions), fold, "actions in both styles")
    ordered = sorted(pool.actions, key=_ordering("action", seed))
    held = set(ordered[fold::folds])
    train = [record for record in pool.records if record.action not in held]
    test = [record for record in pool.source if record.action in held]
    references = [record for record in pool.target if record.action in held]
    return train, test, references, {"folds": folds}


def _named(pool: _Pool, parameters: _Parameters, fold: int, seed: int) -> _Parts:
    if fold:
        raise DataError(
            f"fold {fold} of protocol 'named' does not exist: it names its performers, so there is fold 0 only"
        )
    train_actors, test_actors, actions = (_names(parameters, name) for name in ("train", "test", "actions"))
    performers = sorted({*pool.source_actors, *pool.target_actors})
    for role, actors in (("train", train_actors), ("test", test_actors)):
        if not actors:
            raise DataError(
                f"protocol 'named' needs the parameter {role!r}, a list of performers of {pool.name}: {', '.join(performers)}"
            )
        for actor in actors:
            if actor not in performers:
                raise UnknownNameError(f"performer of data set {pool.name}", actor, performers)
    for actor in test_actors:
        if actor in train_actors:
            raise DataError(f"performer {actor!r} is named under both 'train' and 'test': who trains cannot be tested")
    there = sorted({record.action for record in pool.records})
    for action in actions:
        if action not in there:
            raise UnknownNameError(f"action of data set {pool.name}", action, there)
    records = [record for record in pool.records if not actions or record.action in actions]
    train = [record for record in records if record.actor in train_actors]
    test = [record for record in records if record.actor in test_actors and record.style == pool.source_style]
    references = [
        record for record in records if record.actor not in train_actors and record.style == pool.target_style
    ]
    either = f"{pool.source_style!r} or {pool.target_style!r}"
    for actors, side, style in ((train_actors, train, either), (test_actors, test, repr(pool.source_style))):
        for actor in actors:
            if not any(record.actor == actor for record in side):
                of_actions = f" of {', '.join(actions)}" if actions else ""
                raise DataError(f"performer {actor!r} has no clip in style {style}{of_actions} in {pool.name}")
    used: dict[str, Parameter] = {"train": train_actors, "test": test_actors, "actions": actions}
    return train, test, references, used


_PROTOCOLS: dict[str, tuple[Callable[[_Pool, _Parameters, int, int], _Parts], dict[str, Parameter]]] = {
    "paper": (_paper, {"n_train": 3, "n_unseen": 1, "held_out": 0.1}),
    "actors-kfold": (_actors_kfold, {"folds": 0}),
    "take-block": (_take_block, {"blocks": 3}),
    "action": (_action, {"folds": 0}),
    "named": (_named, {"train": (), "test": (), "actions": ()}),
}

PROTOCOLS: tuple[str, ...] = (*_PROTOCOLS, "auto")


def _checked(protocol: str, name: str, value: float | Sequence[str], defaults: _Parameters) -> Parameter:
    """``value``, if it is of the kind that the parameter takes: a number, or a list of names as a tuple."""
    takes_names = isinstance(defaults[name], tuple)
    if takes_names and isinstance(value, list | tuple) and all(isinstance(item, str) for item in value):
        return tuple(value)
    if not takes_names and isinstance(value, int | float):
        return value
    wanted = f'a list of names, for example {name} = ["one", "two"]' if takes_names else "a number"
    raise DataError(f"parameter {name!r} of protocol {protocol!r} must be {wanted}, not {value!r}")


def _number(parameters: _Parameters, name: str) -> float:
    value = parameters[name]
    assert not isinstance(value, tuple), name
    return value


def _names(parameters: _Parameters, name: str) -> tuple[str, ...]:
    value = parameters[name]
    assert isinstance(value, tuple), name
    return tuple(sorted(set(value)))


def _count(parameters: _Parameters, name: str, least: int) -> int:
    value = _number(parameters, name)
    if value != int(value) or value < least:
        raise DataError(f"{name} must be a whole number of at least {least}, not {value}")
    return int(value)


def _folds(parameters: _Parameters, usual: int, most: int, fold: int, what: str) -> int:
    folds = _count(parameters, "folds", 0) or min(usual, most)
    if not 2 <= folds <= most:
        raise DataError(f"folds must be between 2 and {most}, the number of {what}, not {folds}")
    if fold >= folds:
        raise DataError(f"fold {fold} does not exist: there are folds 0 to {folds - 1}")
    return folds


def _ordering(protocol: str, *seeds: int) -> Callable[[str], str]:
    prefix = ":".join([protocol, *map(str, seeds)])
    return lambda name: sha256(f"{prefix}:{name}".encode()).hexdigest()


def _sorted(records: Iterable[ClipRecord]) -> list[ClipRecord]:
    return sorted(records, key=lambda record: record.clip_id)


def _sequences(records: Iterable[ClipRecord]) -> dict[tuple[str, str, str], list[ClipRecord]]:
    """Each performer's takes of each action, in order of take."""
    sequences: dict[tuple[str, str, str], list[ClipRecord]] = defaultdict(list)
    for record in records:
        sequences[record.style, record.actor, record.action].append(record)
    return {key: sorted(takes, key=lambda record: natural(record.take)) for key, takes in sorted(sequences.items())}
