"""Which moment of the clips each frame of a video shows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Seconds that the card between two showings of a clip stands.
CARD_SECONDS = 1.0

#: A clip is not shown again for less than this; the last pose is held instead.
_LEAST_REPEAT = 1.0


def schedule(duration: float, fps: float, seconds: float | None, *, card: bool = True) -> NDArray[np.float64]:
    """Time in the clip of every frame of the video; NaN where the card stands.

    Parameters
    ----------
    duration
        Seconds from the clip's first frame to its last.
    fps
        Frames per second of the video.
    seconds
        Length of the video; ``None`` for the clip once through. A longer clip is cut, a shorter one starts again.
    card
        Whether a card stands between two showings.

    Returns
    -------
    times
        (N,), ``N = round(seconds * fps)``. What is left when less than a second of the clip could be shown again, shows its
        last moment.
    """
    once = np.arange(int(np.floor(duration * fps + 1e-6)) + 1) / fps
    if seconds is None:
        return once
    total = max(round(seconds * fps), 1)
    if len(once) < 2:
        return np.zeros(total)
    pause = np.full(round(CARD_SECONDS * fps) if card else 0, np.nan)
    least = len(pause) + min(len(once), round(_LEAST_REPEAT * fps))
    times = once[:total]
    while len(times) < total:
        left = total - len(times)
        if left < least:
            return np.concatenate([times, np.full(left, once[-1])])
        times = np.concatenate([times, pause, once])[:total]
    return times
