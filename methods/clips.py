"""The clips that methods train on."""

from __future__ import annotations

from benchmark.api import StyleTask, TrainView
from benchmark.errors import DataError
from benchmark.motion.clip import MotionClip


def training_clips(method: str, train: TrainView, task: StyleTask) -> tuple[list[MotionClip], list[MotionClip]]:
    """The clips of the source and of the target style that have a motion: two frames or more.

    Raises
    ------
    DataError
        In the name of ``method``, where a style has none.
    """
    found = []
    for style in (task.source_style, task.target_style):
        found.append([clip for clip in train.clips(style) if len(clip) > 1])
        if not found[-1]:
            raise DataError(
                f"{method} needs training clips of the style {style!r} with two frames or more; there are none"
            )
    return found[0], found[1]
