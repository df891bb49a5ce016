"""What must never lie on both sides of a split, and whether it does."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping
from typing import TYPE_CHECKING

from benchmark.data.base import ClipRecord

if TYPE_CHECKING:
    from benchmark.data.splits import Split


def find_leak(split: Split, records: Mapping[str, ClipRecord]) -> str | None:
    """The first leak of ``split`` in words, naming the clips; ``None`` where there is none.

    Looks for a clip, a take or a file's content on two sides; for a training clip of a third style, a test clip that is not
    of the source style and a reference that is not of the target style; and, by protocol, for a performer, a block of takes
    or an action on both sides. Windows are cut from clips after the split, so a window can leak only where its clip does.

    Parameters
    ----------
    split
        The split.
    records
        The data set's records by clip id; every clip of the split must be among them.
    """
    sides = {
        "training": [records[clip_id] for clip_id in split.train],
        "test": [records[item.clip_id] for item in split.test],
        "reference": [records[clip_id] for clip_id in split.references],
    }
    return (
        _wrong_style(split, sides)
        or _twice(sides)
        or _seen_flags(split, sides, records)
        or _PROTOCOL_CHECKS.get(split.protocol, _no_check)(split, sides)
    )


_Sides = Mapping[str, list[ClipRecord]]


def _wrong_style(split: Split, sides: _Sides) -> str | None:
    allowed = {
        "training": (split.source_style, split.target_style),
        "test": (split.source_style,),
        "reference": (split.target_style,),
    }
    for side, records in sides.items():
        for record in records:
            if record.style not in allowed[side]:
                return f"{side} clip {record.clip_id!r} has style {record.style!r}, not {' or '.join(allowed[side])}"
    return None


def _twice(sides: _Sides) -> str | None:
    clips: dict[str, str] = {}
    takes: dict[tuple[str, ...], tuple[str, ClipRecord]] = {}
    contents: dict[str, tuple[str, ClipRecord]] = {}
    for side, records in sides.items():
        for record in records:
            if record.clip_id in clips:
                return f"clip {record.clip_id!r} is listed under {clips[record.clip_id]} and under {side}"
            clips[record.clip_id] = side
            take = (record.style, record.actor, record.action, record.take)
            other_side, other = takes.setdefault(take, (side, record))
            if other_side != side:
                return f"take {other.clip_id!r} ({other_side}) and {record.clip_id!r} ({side}) are the same take"
            other_side, other = contents.setdefault(record.sha256, (side, record))
            if other_side != side:
                return (
                    f"clips {other.clip_id!r} ({other_side}) and {record.clip_id!r} ({side}) are the same file under two "
                    "names: remove one of them"
                )
    return None


def _seen_flags(split: Split, sides: _Sides, records: Mapping[str, ClipRecord]) -> str | None:
    trained = {record.actor: record for record in sides["training"]}
    for item in split.test:
        actor = records[item.clip_id].actor
        if actor and not item.seen_actor and actor in trained:
            return (
                f"test clip {item.clip_id!r} is marked as of an unseen performer, "
                f"but {actor!r} is in training with {trained[actor].clip_id!r}"
            )
        if item.seen_actor and actor not in trained:
            return f"test clip {item.clip_id!r} is marked as of a seen performer, but {actor!r} is not in training"
    return None


def _no_check(split: Split, sides: _Sides) -> str | None:
    return None


def _actors_apart(split: Split, sides: _Sides) -> str | None:
    trained = {record.actor: record for record in sides["training"]}
    for side in ("test", "reference"):
        for record in sides[side]:
            if record.actor in trained:
                return (
                    f"performer {record.actor!r} is in training ({trained[record.actor].clip_id!r}) "
                    f"and held out ({record.clip_id!r})"
                )
    return None


def _as_named(split: Split, sides: _Sides) -> str | None:
    """Every clip is on the side, and of an action, that the split's own parameters say."""
    names = {name: value for name, value in split.parameters.items() if isinstance(value, tuple)}
    for side, role in (("training", "train"), ("test", "test")):
        for record in sides[side]:
            if record.actor not in names.get(role, ()):
                return f"{side} clip {record.clip_id!r} is by performer {record.actor!r}, whom the split does not name for it"
    actions = names.get("actions", ())
    for side, records in sides.items():
        for record in records:
            if actions and record.action not in actions:
                return f"{side} clip {record.clip_id!r} is of action {record.action!r}, which the split does not name"
    return _actors_apart(split, sides)


def _references_apart(split: Split, sides: _Sides) -> str | None:
    """Of performers in training only held-out takes of the same style may be references."""
    trained: dict[str, set[str]] = defaultdict(set)
    for record in sides["training"]:
        trained[record.actor].add(record.style)
    for record in sides["reference"]:
        if record.actor in trained and record.style not in trained[record.actor]:
            return f"performer {record.actor!r} is in training in one style and a reference in another ({record.clip_id!r})"
    return None


def _actions_apart(split: Split, sides: _Sides) -> str | None:
    trained = {record.action: record for record in sides["training"]}
    for side in ("test", "reference"):
        for record in sides[side]:
            if record.action in trained:
                return (
                    f"action {record.action!r} is in training ({trained[record.action].clip_id!r}) "
                    f"and held out ({record.clip_id!r})"
                )
    return None


def _blocks_whole(split: Split, sides: _Sides) -> str | None:
    """Held-out takes of a performer's action form one run: no training take lies between two of them."""
    sequences: dict[tuple[str, str, str], list[tuple[ClipRecord, bool]]] = defaultdict(list)
    for side, records in sides.items():
        for record in records:
            sequences[record.style, record.actor, record.action].append((record, side != "training"))
    for takes in sequences.values():
        takes.sort(key=lambda pair: natural(pair[0].take))
        held = [place for place, (_, out) in enumerate(takes) if out]
        for record, out in takes[held[0] : held[-1] + 1] if held else []:
            if not out:
                return f"training take {record.clip_id!r} lies between held-out takes of its block"
    return None


_PROTOCOL_CHECKS = {
    "paper": _references_apart,
    "actors-kfold": _actors_apart,
    "action": _actions_apart,
    "take-block": _blocks_whole,
    "named": _as_named,
}


def natural(take: str) -> tuple[tuple[int, str], ...]:
    """A sort key that puts take 10 after take 9."""
    return tuple((int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", take) if part)
