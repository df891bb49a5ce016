"""What the runner and the methods see of a split."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from hashlib import sha256
from math import ceil

from benchmark.data.base import ClipRecord, Dataset
from benchmark.data.splits import Split, check
from benchmark.errors import DataError
from benchmark.motion.clip import MotionClip
from benchmark.motion.skeleton import Skeleton


class ClipTrainView:
    """The training clips of a split: the concrete :class:`benchmark.api.TrainView`.

    Clips are read when first asked for and kept, so that every caller gets the same object. Nothing here leads back to the
    data set's other clips: a method can reach its training clips only.

    Parameters
    ----------
    dataset
        Where the clips are read.
    records
        The training clips, sorted by id.
    """

    def __init__(self, dataset: Dataset, records: Sequence[ClipRecord]) -> None:
        self._records = tuple(sorted(records, key=lambda record: record.clip_id))
        self._fps = dataset.fps
        allowed = frozenset(record.clip_id for record in self._records)
        clips: dict[str, MotionClip] = {}

        def read(clip_id: str) -> MotionClip:
            if clip_id not in allowed:
                raise DataError(f"clip {clip_id!r} is not one of the training clips")
            if clip_id not in clips:
                clips[clip_id] = dataset.load(clip_id)
            return clips[clip_id]

        self._read = read

    def __len__(self) -> int:
        return len(self._records)

    @property
    def fps(self) -> float:
        """Frames per second of every clip."""
        return self._fps

    @property
    def actions(self) -> tuple[str, ...]:
        """The actions present, sorted."""
        return tuple(sorted({record.action for record in self._records}))

    @property
    def styles(self) -> tuple[str, ...]:
        """The styles present, sorted."""
        return tuple(sorted({record.style for record in self._records}))

    @property
    def clip_ids(self) -> tuple[str, ...]:
        """The ids of the training clips, sorted."""
        return tuple(record.clip_id for record in self._records)

    def _select(self, style: str | None, action: str | None, actor: str | None) -> list[ClipRecord]:
        return [
            record
            for record in self._records
            if style in (None, record.style) and action in (None, record.action) and actor in (None, record.actor)
        ]

    def clips(
        self, style: str | None = None, *, action: str | None = None, actor: str | None = None
    ) -> Sequence[MotionClip]:
        """The clips that match, sorted by id; an empty list where none does."""
        return [self._read(record.clip_id) for record in self._select(style, action, actor)]

    def pairs(self, source_style: str, target_style: str) -> Iterator[tuple[MotionClip, MotionClip]]:
        """Every pair of takes of the same action, source style first, sorted by the two ids."""
        for source in self._select(source_style, None, None):
            for target in self._select(target_style, source.action, None):
                yield self._read(source.clip_id), self._read(target.clip_id)

    def validation(self, fraction: float = 0.1) -> tuple[ClipTrainView, ClipTrainView]:
        """The view cut in two by clip, the larger part first.

        Of each style, the clips whose ids hash lowest go to the smaller part: ``fraction`` of them, at least one where there
        are two or more. The cut depends on the ids and on nothing else.
        """
        if not 0.0 < fraction <= 0.5:
            raise ValueError(f"fraction must be above 0 and at most 0.5, not {fraction}")
        held: set[str] = set()
        for style in self.styles:
            ids = sorted((r.clip_id for r in self._select(style, None, None)), key=_hashed)
            count = min(max(1, round(fraction * len(ids))), len(ids) - 1)
            held.update(ids[:count])
        return self._part(lambda clip_id: clip_id not in held), self._part(lambda clip_id: clip_id in held)

    def _part(self, keep: Callable[[str], bool]) -> ClipTrainView:
        part = object.__new__(ClipTrainView)
        part._records = tuple(record for record in self._records if keep(record.clip_id))
        part._fps, part._read = self._fps, self._read
        return part


def _hashed(text: str) -> str:
    return sha256(text.encode()).hexdigest()


@dataclass(frozen=True)
class EvalItem:
    """One clip to transfer.

    Attributes
    ----------
    record
        The source clip.
    seen_actor
        Whether its performer's other clips are in the training set.
    reference_ids
        Clips of the target style and the same action that are outside the training set.
    has_truth
        Whether the data set knows the true target performance of this clip.
    """

    record: ClipRecord
    seen_actor: bool
    reference_ids: tuple[str, ...]
    has_truth: bool


def train_view(dataset: Dataset, split: Split, source_style: str, target_style: str) -> ClipTrainView:
    """The training clips of both styles, after :func:`~benchmark.data.splits.check`."""
    check(split, dataset)
    _same_task(split, source_style, target_style)
    records = [dataset.record(clip_id) for clip_id in split.train]
    return ClipTrainView(dataset, records)


def eval_items(dataset: Dataset, split: Split, source_style: str, target_style: str) -> list[EvalItem]:
    """The clips to transfer, in the split's order, after :func:`~benchmark.data.splits.check`."""
    check(split, dataset)
    _same_task(split, source_style, target_style)
    references: dict[str, list[str]] = {}
    for clip_id in split.references:
        references.setdefault(dataset.record(clip_id).action, []).append(clip_id)
    items = []
    for test in split.test:
        record = dataset.record(test.clip_id)
        items.append(
            EvalItem(
                record,
                test.seen_actor,
                tuple(references.get(record.action, ())),
                dataset.has_truth(test.clip_id, target_style),
            )
        )
    return items


def target_skeleton(dataset: Dataset, split: Split, style: str) -> Skeleton:
    """The skeleton to put results on: of the training actors of ``style``, the one whose leg length is the median.

    Of an even number the shorter of the middle two is taken. An actor's skeleton is that of its first training clip. Where
    performers are unknown, clips stand in for them.
    """
    first: dict[str, str] = {}
    for clip_id in sorted(split.train):
        record = dataset.record(clip_id)
        if record.style == style:
            first.setdefault(record.actor or record.clip_id, clip_id)
    if not first:
        raise DataError(f"the split has no training clip of style {style!r}")
    if all(dataset.record(clip_id).actor == "" for clip_id in first.values()):
        # One body plays every clip; a handful is enough to be sure of the median, and reading all of them is not.
        first = dict(list(first.items())[:5])
    skeletons = sorted(
        ((dataset.load(clip_id).skeleton, clip_id) for clip_id in first.values()),
        key=lambda pair: (pair[0].leg_length, pair[1]),
    )
    return skeletons[ceil(len(skeletons) / 2) - 1][0]


def _same_task(split: Split, source_style: str, target_style: str) -> None:
    if (split.source_style, split.target_style) != (source_style, target_style):
        raise DataError(
            f"the split is for {split.source_style}:{split.target_style}, not for {source_style}:{target_style}; "
            "make one for this task"
        )
