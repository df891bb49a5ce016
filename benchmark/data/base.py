"""What a data set is: records that say who did what, and clips that are read when they are asked for."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from benchmark.data.cards import Card
from benchmark.digest import digest as json_digest
from benchmark.errors import DataError, UnknownNameError
from benchmark.motion.clip import ClipMeta, MotionClip
from benchmark.motion.skeleton import Skeleton


@dataclass(frozen=True)
class ClipRecord:
    """One clip of a data set, without its motion.

    Attributes
    ----------
    clip_id
        Unique in the data set: ``style/actor/action_take`` without the parts that are unknown.
    actor
        Who moved, or the recording block that stands in for an unknown performer; ``""`` where neither is known.
    style
        The domain: ``adult``, ``child``, ``normal``, ``old`` …
    action
        What was done.
    take
        Which repetition.
    path
        The file, or ``None`` for a clip that is generated.
    sha256
        Hex digest of the file's bytes, or of what a generated clip is generated from.
    """

    clip_id: str
    actor: str
    style: str
    action: str
    take: str
    path: Path | None
    sha256: str

    @classmethod
    def of(cls, *, actor: str, style: str, action: str, take: str, path: Path | None, sha256: str) -> ClipRecord:
        """A record whose id is made of its parts, as :class:`~benchmark.motion.clip.ClipMeta` makes it."""
        meta = ClipMeta(actor=actor, style=style, action=action, take=take)
        return cls(meta.clip_id, actor, style, action, take, path, sha256)

    @property
    def meta(self) -> ClipMeta:
        """The record as a clip carries it; ``source`` is the file's name."""
        source = "" if self.path is None else self.path.name
        return ClipMeta(actor=self.actor, style=self.style, action=self.action, take=self.take, source=source)


class Dataset(ABC):
    """A set of clips of at least two styles, all at one frame rate.

    A subclass gives :attr:`id`, :attr:`card`, :attr:`fps`, :attr:`records` and :meth:`load`. Records are sorted by clip id and
    cost no more than a look at the files; motion is read in :meth:`load` only.
    """

    @property
    @abstractmethod
    def id(self) -> str:
        """The name under which results are kept."""

    @property
    @abstractmethod
    def card(self) -> Card:
        """Licence, citation, and what is in it."""

    @property
    @abstractmethod
    def fps(self) -> float:
        """Frames per second of every clip that :meth:`load` returns."""

    @property
    @abstractmethod
    def records(self) -> tuple[ClipRecord, ...]:
        """Every clip, sorted by id."""

    @abstractmethod
    def load(self, clip_id: str) -> MotionClip:
        """The canonical clip: rigid bones, floor at ``y = 0``, first frame at the origin facing +Z, :attr:`fps`."""

    @property
    def options(self) -> Mapping[str, Any]:
        """JSON-ready settings that change what :meth:`load` returns."""
        return {}

    @cached_property
    def digest(self) -> str:
        """Hex SHA-256 over ids, file digests, options and the code that makes clips canonical. Loads no clip."""
        from benchmark.data.cache import canonical_version

        return json_digest(
            {
                "dataset": self.card.id,
                "version": self.card.version,
                "fps": self.fps,
                "options": dict(self.options),
                "canonical": canonical_version(),
                "records": [
                    {key: value for key, value in asdict(record).items() if key != "path"} for record in self.records
                ],
            }
        )

    @cached_property
    def _by_id(self) -> dict[str, ClipRecord]:
        return {record.clip_id: record for record in self.records}

    def record(self, clip_id: str) -> ClipRecord:
        """The record of ``clip_id``; an :class:`~benchmark.errors.UnknownNameError` suggests the nearest."""
        if clip_id not in self._by_id:
            if len(self.records) > 40:
                raise DataError(
                    f"data set {self.id} has no clip {clip_id!r} (`data index {self.id}` lists all of them)"
                )
            raise UnknownNameError("clip", clip_id, self._by_id)
        return self._by_id[clip_id]

    @property
    def styles(self) -> tuple[str, ...]:
        """The styles present, sorted."""
        return tuple(sorted({record.style for record in self.records}))

    def task_records(self, source_style: str, target_style: str) -> tuple[ClipRecord, ...]:
        """The clips that take part in transferring one style to another, sorted by id.

        Both styles' clips; a data set made of several recordings narrows them to the recording that holds both styles.
        """
        for style in (source_style, target_style):
            if style not in self.styles:
                raise UnknownNameError(f"style of data set {self.id}", style, self.styles)
        if source_style == target_style:
            raise DataError(f"source and target style are both {source_style!r}; a task needs two different styles")
        return tuple(record for record in self.records if record.style in (source_style, target_style))

    def default_protocol(self, source_style: str, target_style: str) -> str:
        """The split protocol that ``auto`` stands for; see :mod:`benchmark.data.splits`."""
        return self.card.default_protocol

    def truth(self, clip_id: str, target_style: str, skeleton: Skeleton | None = None) -> MotionClip | None:
        """The true performance of a clip's content in another style, which only generated data has.

        Performed by ``skeleton``, or by a typical performer of that style.
        """
        return None

    def has_truth(self, clip_id: str, target_style: str) -> bool:
        """Whether :meth:`truth` has an answer for this clip."""
        return type(self).truth is not Dataset.truth and self.truth(clip_id, target_style) is not None
