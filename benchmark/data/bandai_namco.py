"""Bandai-Namco-Research-Motiondataset 1 and 2: acted styles on one body."""

from __future__ import annotations

import re
from functools import cached_property
from pathlib import Path

from benchmark.data.archive import data_files, upstream
from benchmark.data.base import ClipRecord
from benchmark.data.cache import file_digests
from benchmark.data.cards import Card, load_card
from benchmark.data.files import FileDataset, require_unaltered, unique
from benchmark.data.locate import locate
from benchmark.digest import digest as json_digest
from benchmark.errors import ConfigError, DataError
from benchmark.motion.clip import MotionClip

_NAME = re.compile(r"dataset-(?P<part>[12])_(?P<action>[^_]+)_(?P<style>[^_]+)_(?P<take>\d{3})\.bvh")


class BandaiNamco(FileDataset):
    """Two recordings of acted styles.

    They are never mixed in one task: clips of a style that both have (``normal``, ``active``, ``feminine``) are told apart by
    their take, ``1-001`` and ``2-001``, and :meth:`task_records` keeps to one recording. Performers are unknown, so
    ``actor`` is empty; in dataset-2 neighbouring takes resemble each other, so that blocks of takes are held out.

    Parameters
    ----------
    root
        The unpacked folder, an archive, or a folder that holds either; see :func:`benchmark.data.locate.locate`.
    part
        Use only dataset-1 or dataset-2. Without it a task uses the one that has both styles, dataset-2 where both have.
    """

    def __init__(self, root: Path | None = None, part: int | None = None) -> None:
        if part not in (None, 1, 2):
            raise ConfigError(f"part of bandai-namco must be 1 or 2, not {part!r}")
        self.part = part
        self.folder = locate(self.card, root)

    @property
    def id(self) -> str:
        """``bandai-namco``."""
        return "bandai-namco"

    @property
    def card(self) -> Card:
        """Licence, citation, styles and traps."""
        return load_card("bandai-namco")

    @property
    def fps(self) -> float:
        """30, as captured."""
        return 30.0

    @cached_property
    def records(self) -> tuple[ClipRecord, ...]:
        """Every clip, or those of one part."""
        files = data_files(self.folder, upstream(self.card)[1])
        digests = file_digests(files.values(), memo=f"bandai-namco-{json_digest(str(self.folder.resolve()))[:12]}")
        require_unaltered(self.card, {name: digests[path] for name, path in files.items()}, self.folder)
        records = []
        for path in files.values():
            match = _NAME.fullmatch(path.name)
            if match is None:
                raise DataError(f"{path} is not named as this data set's files are (dataset-N_ACTION_STYLE_TAKE.bvh)")
            if self.part is None or int(match["part"]) == self.part:
                records.append(
                    ClipRecord.of(
                        actor="",
                        style=match["style"],
                        action=match["action"],
                        take=f"{match['part']}-{match['take']}",
                        path=path,
                        sha256=digests[path],
                    )
                )
        return unique(records, self.id)

    def task_records(self, source_style: str, target_style: str) -> tuple[ClipRecord, ...]:
        """The clips of both styles in the recording that has both."""
        records = super().task_records(source_style, target_style)
        part = self._part_of(records, source_style, target_style)
        return tuple(record for record in records if record.take.startswith(part))

    def default_protocol(self, source_style: str, target_style: str) -> str:
        """Blocks of takes in dataset-2; actions in dataset-1, which has one take of each."""
        records = super().task_records(source_style, target_style)
        return "take-block" if self._part_of(records, source_style, target_style) == "2-" else "action"

    def _part_of(self, records: tuple[ClipRecord, ...], source_style: str, target_style: str) -> str:
        for part in ("2-", "1-"):
            if {record.style for record in records if record.take.startswith(part)} == {source_style, target_style}:
                return part
        held = {
            style: sorted({r.take[0] for r in records if r.style == style}) for style in (source_style, target_style)
        }
        raise DataError(
            f"no recording of bandai-namco has both styles: {source_style!r} is in dataset-{held[source_style][0]}, "
            f"{target_style!r} in dataset-{held[target_style][0]}"
        )

    def read(self, record: ClipRecord) -> MotionClip:
        """Read one file. Zero rotation is not a T-pose here, and no clip begins with one: nothing is cut."""
        from benchmark.motion import bvh
        from benchmark.motion.canonical import canonicalise

        assert record.path is not None
        return canonicalise(bvh.load(record.path, unit="cm"), fps=self.fps, trim=False)
