"""From a pair of takes to a training record: the source's channels on the target's clock."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from methods.hsu.pairs import Pair
from methods.hsu.warping import iterative_motion_warping

Array = NDArray[np.float64]

WARPS = ("shared", "per-joint")


@dataclass(frozen=True)
class WarpSettings:
    """How pairs are aligned; see :class:`methods.hsu.method.Hsu` for what each means."""

    smooth: float
    band: float
    max_skip: int
    warp: str
    distance: str
    solver: str
    align_fps: float
    path_sigma: float


@dataclass(frozen=True, eq=False)
class Record:
    """A pair on one clock.

    Attributes
    ----------
    inputs, outputs
        (T', J, 3) standardised channels of the source, time-warped, and of the target.
    position
        (T',) the source frame that each target frame shows, with fractions; of the first joint if each has its own warp.
    energy
        What time and space warp leave of the difference, and how far they had to bend: the energy of equation 1 per frame and
        channel.
    """

    pair: Pair
    inputs: Array
    outputs: Array
    position: Array
    energy: float


def align(pair: Pair, fps: float, settings: WarpSettings) -> Record:
    """Find the time warp of a pair and put the source on the target's clock.

    What the models learn from is the time-warped *original* source; the space warp only helps to find the time warp and is
    then forgotten (poster, below equation 3).
    """
    source, target = pair.source.values, pair.target.values
    every = min(max(1, round(fps / settings.align_fps)), min(len(source), len(target)) - 1)
    if settings.warp == "shared":
        position, energy = _position(
            source.reshape(len(source), -1), target.reshape(len(target), -1), every, settings, fps
        )
        return Record(pair, sample(source, position), target, position, energy)
    found = [_position(source[:, joint], target[:, joint], every, settings, fps) for joint in range(source.shape[1])]
    inputs = np.stack([sample(source[:, joint], position) for joint, (position, _) in enumerate(found)], axis=1)
    return Record(pair, inputs, target, found[0][0], float(np.mean([energy for _, energy in found])))


def sample(values: Array, position: Array) -> Array:
    """Frames of ``values`` (T, ...) at ``position`` (T',), linear between frames."""
    low = np.minimum(position.astype(np.int64), len(values) - 1)
    high = np.minimum(low + 1, len(values) - 1)
    share = (position - low).reshape(-1, *(1,) * (values.ndim - 1))
    return values[low] * (1.0 - share) + values[high] * share


def _position(source: Array, target: Array, every: int, settings: WarpSettings, fps: float) -> tuple[Array, float]:
    moving = (np.ptp(source, axis=0) > 0) | (np.ptp(target, axis=0) > 0)
    if not moving.any():
        moving[0] = True
    u, v = source[::every, moving], target[::every, moving]
    # A source that is much the longer one can only be followed by larger steps, and in a short one a step is wider than a
    # fraction of the length.
    steps = max(settings.max_skip, -(-(len(u) - 1) // (len(v) - 1)) + 1)
    warp = iterative_motion_warping(
        u,
        v,
        smooth_scale=settings.smooth,
        smooth_offset=settings.smooth,
        band=max(settings.band, steps / len(u)),
        max_skip=steps,
        distance=settings.distance,
        solver=settings.solver,
    )
    last = len(source) - 1
    position = np.interp(np.arange(len(target)) / every, np.arange(len(warp.path)), np.minimum(warp.path * every, last))
    if settings.path_sigma > 0.0:
        from scipy.ndimage import gaussian_filter1d

        # The path moves in whole frames, now stopping and now skipping; the motion it stands for does not.
        position = gaussian_filter1d(position, settings.path_sigma * fps, mode="nearest")
    return np.clip(position, 0.0, last), warp.mean_energy
