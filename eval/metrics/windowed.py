"""Windows of fixed length, so that a spectrum or a smoothness does not depend on how long a performer was recorded."""

from __future__ import annotations


def windows(frames: int, fps: float, seconds: float) -> list[tuple[int, int]]:
    """First frame and one past the last of windows of ``seconds`` that overlap by half; the whole clip if it is shorter.

    The last window ends with the clip, so that every frame is in one.
    """
    length = round(seconds * fps) + 1
    if frames <= length:
        return [(0, frames)]
    hop = max(1, length // 2)
    starts = list(range(0, frames - length, hop)) + [frames - length]
    return [(start, start + length) for start in starts]
