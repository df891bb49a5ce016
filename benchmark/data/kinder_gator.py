"""Kinder-Gator (Aloba et al. 2018): adults and children before a Kinect v1."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

from benchmark.data.archive import data_files, upstream
from benchmark.data.base import ClipRecord
from benchmark.data.cache import file_digests
from benchmark.data.cards import Card, load_card
from benchmark.data.files import (
    FileDataset,
    kinect_floor,
    kinect_skeleton,
    kinect_skeleton_key,
    require_unaltered,
    unique,
)
from benchmark.data.locate import locate
from benchmark.digest import digest as json_digest
from benchmark.errors import DataError
from benchmark.motion.clip import MotionClip
from benchmark.motion.skeleton import Skeleton

_NAME = re.compile(r"POSE-p(?P<actor>\d{3})_(?P<order>\d{2})-(?P<action>.+)-(?P<time>\d{13})\.csv")
#: Metres between a file's floor and its actor's beyond which the file's is not believed.
_FEET_LOST = 0.12
_STYLES = {"Adults": "adult", "Children": "child"}


class KinderGator(FileDataset):
    """Adults and children doing the same 58 actions, once each.

    Joint positions become clips on one rigid skeleton for each actor, of the median bone lengths over all of that actor's
    files that are there.

    Parameters
    ----------
    root
        The unpacked folder, an archive, or a folder that holds either; see :func:`benchmark.data.locate.locate`.
    """

    def __init__(self, root: Path | None = None) -> None:
        self.folder = locate(self.card, root)

    @property
    def id(self) -> str:
        """``kinder-gator``."""
        return "kinder-gator"

    @property
    def card(self) -> Card:
        """Licence, citation, actors and traps."""
        return load_card("kinder-gator")

    @property
    def fps(self) -> float:
        """30: the sensor's nominal rate."""
        return 30.0

    @cached_property
    def records(self) -> tuple[ClipRecord, ...]:
        """Every clip; the take is always ``1``."""
        files = data_files(self.folder, upstream(self.card)[1])
        digests = file_digests(files.values(), memo=f"kinder-gator-{json_digest(str(self.folder.resolve()))[:12]}")
        require_unaltered(self.card, {name: digests[path] for name, path in files.items()}, self.folder)
        records = []
        for name, path in files.items():
            match = _NAME.fullmatch(path.name)
            if match is None:
                raise DataError(f"{path} is not named as Kinder-Gator's files are (POSE-pPID_ORDER-ACTION-TIME.csv)")
            records.append(
                ClipRecord.of(
                    actor=match["actor"],
                    style=_STYLES[name.split("/")[0]],
                    action=match["action"].strip("-").lower(),
                    take="1",
                    path=path,
                    sha256=digests[path],
                )
            )
        return unique(records, self.id)

    @cached_property
    def _by_actor(self) -> dict[str, list[ClipRecord]]:
        actors: dict[str, list[ClipRecord]] = defaultdict(list)
        for record in self.records:
            actors[record.actor].append(record)
        return actors

    @cached_property
    def _skeletons(self) -> dict[str, Skeleton]:
        return {}

    def skeleton(self, actor: str) -> Skeleton:
        """The actor's rigid skeleton, measured over all of their files that are there."""
        if actor not in self._skeletons:
            self._skeletons[actor] = kinect_skeleton(self._by_actor[actor])
        return self._skeletons[actor]

    @cached_property
    def _floors(self) -> dict[str, float]:
        return {}

    def floor(self, actor: str) -> float:
        """Height of the floor in the actor's recordings, metres above the sensor (so below zero)."""
        if actor not in self._floors:
            self._floors[actor] = kinect_floor(self._by_actor[actor], self.skeleton(actor))
        return self._floors[actor]

    def reading(self, record: ClipRecord) -> Mapping[str, Any]:
        """The files that the actor's skeleton and floor are measured from."""
        return {"skeleton": kinect_skeleton_key(self._by_actor[record.actor])}

    def read(self, record: ClipRecord) -> MotionClip:
        """Read one file on its actor's skeleton and floor, and cut the T-pose that most recordings begin with.

        Where the floor found in the file is further than 0.12 m from the actor's, the sensor had lost the feet and the
        actor's floor is taken. Smaller differences are real: the sensor is tilted, and actors stand nearer or further away.
        """
        from benchmark.motion import kinect
        from benchmark.motion.canonical import canonicalise, floor_height

        assert record.path is not None
        clip = kinect.load(record.path, skeleton=self.skeleton(record.actor), fps=self.fps)
        usual = self.floor(record.actor)
        lost = abs(floor_height(clip) - usual) > _FEET_LOST
        return canonicalise(clip, fps=self.fps, floor=usual if lost else True)
