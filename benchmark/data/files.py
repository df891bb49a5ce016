"""What data sets of motion files have in common: read, make canonical, keep."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmark.data.archive import upstream
from benchmark.data.base import ClipRecord, Dataset
from benchmark.data.cache import cached_clip, cached_skeleton, canonical_version
from benchmark.data.cards import Card
from benchmark.digest import digest as json_digest
from benchmark.errors import DataError, SkeletonError
from benchmark.motion.clip import ClipMeta, MotionClip
from benchmark.motion.skeleton import Skeleton


class FileDataset(Dataset):
    """A data set whose clips are files; canonical clips are kept in the cache by the content of their files."""

    @abstractmethod
    def read(self, record: ClipRecord) -> MotionClip:
        """Read a file and make it canonical; called where the cache has no such clip."""

    def reading(self, record: ClipRecord) -> Mapping[str, Any]:
        """JSON-ready facts, besides the file's content, that :meth:`read` depends on."""
        return self.options

    def load(self, clip_id: str) -> MotionClip:
        """The canonical clip, from the cache where it is there."""
        record = self.record(clip_id)
        key = json_digest(
            {
                "canonical": canonical_version(),
                "reader": type(self).__name__,
                "file": record.sha256,
                "fps": self.fps,
                "reading": dict(self.reading(record)),
            }
        )

        def make() -> MotionClip:
            try:
                return self.read(record)
            except SkeletonError as error:
                raise DataError(f"{record.path}: {error}") from error

        return cached_clip(key, make, record.meta)


def unique(records: Iterable[ClipRecord], name: str) -> tuple[ClipRecord, ...]:
    """The records sorted by id; a :class:`~benchmark.errors.DataError` names two files with one id."""
    by_id: dict[str, ClipRecord] = {}
    for record in records:
        other = by_id.setdefault(record.clip_id, record)
        if other is not record:
            raise DataError(
                f"two files of {name} are the clip {record.clip_id!r}: {other.path} and {record.path}; rename one, or let the "
                "pattern tell them apart"
            )
    return tuple(by_id[clip_id] for clip_id in sorted(by_id))


def kinect_skeleton_key(records: Sequence[ClipRecord]) -> str:
    """What a skeleton measured over the files of ``records`` depends on."""
    files = sorted(record.sha256 for record in records)
    return json_digest({"skeleton": "kinect", "canonical": canonical_version(), "files": files})


def kinect_skeleton(records: Sequence[ClipRecord]) -> Skeleton:
    """The rigid skeleton of one actor, measured over all of the actor's files; kept in the cache."""

    def measure() -> Skeleton:
        from benchmark.motion import kinect

        return kinect.measure_skeleton(record.path for record in records if record.path is not None)

    return cached_skeleton(kinect_skeleton_key(records), measure)


def kinect_floor(records: Sequence[ClipRecord], skeleton: Skeleton) -> float:
    """Height of the floor before one actor's sensor, metres: the median over the actor's files; kept in the cache.

    The sensor stands still while an actor is recorded, but loses sight of the feet in some actions, where the floor found
    from that file alone is up to 0.25 m off.
    """

    def measure() -> MotionClip:
        import numpy as np

        from benchmark.motion import kinect, quat
        from benchmark.motion.canonical import floor_height

        clips = [kinect.load(record.path, skeleton=skeleton) for record in records if record.path is not None]
        height = float(np.median([floor_height(clip) for clip in clips]))
        # A figure at rest whose root is at the floor's height: the cache holds clips.
        return MotionClip(skeleton, quat.identity(1, len(skeleton)), np.array([[0.0, height, 0.0]]), 1.0)

    key = json_digest({"floor": "kinect", "of": kinect_skeleton_key(records)})
    return float(cached_clip(key, measure, ClipMeta()).root[0, 1])


def require_unaltered(card: Card, digests: Mapping[str, str], folder: Path) -> None:
    """Raise a :class:`~benchmark.errors.DataError` for the first file whose content is not upstream's."""
    upstream(card)
    table = card.digests()
    for name, digest in digests.items():
        if name not in table:
            raise DataError(
                f"{folder / name} is not a file of data set {card.id} at commit {card.version}: remove it, or use the folder "
                "as folder:PATH"
            )
        if digest != table[name]:
            raise DataError(
                f"{folder / name} was altered: its SHA-256 is {digest[:16]}…, upstream's is {table[name][:16]}…. Restore it, "
                f"or run `python -m benchmark data fetch {card.id} --again`"
            )
