"""Clips to draw, of the synthetic corpus."""

from __future__ import annotations

import pytest

from benchmark.data.synthetic import SyntheticDataset
from benchmark.motion.clip import MotionClip


@pytest.fixture(scope="session")
def corpus() -> SyntheticDataset:
    return SyntheticDataset()


@pytest.fixture(scope="session")
def walk(corpus: SyntheticDataset) -> MotionClip:
    """Two seconds of an adult's walk."""
    clip_id = next(record.clip_id for record in corpus.records if record.style == "adult" and record.action == "walk")
    return corpus.load(clip_id).frames(60, 181)


@pytest.fixture(scope="session")
def jump(corpus: SyntheticDataset) -> MotionClip:
    """A child's high jump."""
    return corpus.load(
        next(r.clip_id for r in corpus.records if r.style == "child" and r.action.startswith("jump-as-high"))
    )
