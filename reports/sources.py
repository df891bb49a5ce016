"""The clips that were transferred, as they were performed: read from the data set, since a run stores results only."""

from __future__ import annotations

from weakref import WeakKeyDictionary

from benchmark.config import read_config
from benchmark.data.base import Dataset
from benchmark.data.catalog import open_dataset
from benchmark.errors import BenchmarkError
from benchmark.motion.clip import MotionClip
from reports.run import RunView

_opened: WeakKeyDictionary[RunView, Dataset | None] = WeakKeyDictionary()


def source_clip(run: RunView, clip_id: str) -> MotionClip | None:
    """A real clip on its performer's own body, or ``None`` where the data set that the run was made on cannot be read."""
    if run not in _opened:
        _opened[run] = _open(run)
    dataset = _opened[run]
    try:
        return None if dataset is None else dataset.load(clip_id)
    except BenchmarkError:
        return None


def _open(run: RunView) -> Dataset | None:
    try:
        config = read_config(run.folder / "config.toml")
        dataset = open_dataset(config.dataset.name, root=config.dataset.root, **config.dataset.options)
        return dataset if dataset.digest == str(run.results["dataset_digest"].iloc[0]) else None
    except BenchmarkError:
        return None
