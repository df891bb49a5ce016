"""Size-free channels of a motion over time: what learned evaluators are shown."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmark.motion import quat
from benchmark.motion.canonical import heading
from benchmark.motion.clip import MotionClip
from benchmark.motion.contacts import GRAVITY
from benchmark.motion.pose import SEGMENTS, heading_rotations, segment_directions
from benchmark.motion.resample import resample
from benchmark.motion.skeleton import SIDES
from eval.metrics.shared import per_clip

#: Frames a second at which motion is described, whatever it was captured at.
RATE = 30.0

#: Leg length in metres of the common body that motion is imagined on. It only sets the unit of speed: dividing by the
#: figure's own ``sqrt(leg)`` instead would let its size back in through the clock.
NOMINAL_LEG = 0.8

#: Seconds that ``sqrt(leg / g)`` is on the common body: rates times this are dimensionless.
TIME_UNIT = float(np.sqrt(NOMINAL_LEG / GRAVITY))

_AXES = ("left", "up", "forward")
_LINES = ("hip", "shoulder")

#: The channels of :func:`pose_sequence`, in order.
SEQUENCE_NAMES: tuple[str, ...] = (
    *(f"{start}-{end}/{axis}" for start, end in SEGMENTS for axis in _AXES),
    *(f"{line}-line/{axis}" for line in _LINES for axis in _AXES),
    *(f"hips/{axis}-velocity" for axis in _AXES),
    "hips/yaw-rate",
)


def pose_sequence(clip: MotionClip, fps: float = RATE) -> NDArray[np.float64]:
    """Pose and travel of a motion without place, facing, size and proportions, at a fixed frame rate.

    Segment directions and the lines across hips and shoulders are seen facing forward. Velocities of the hips are those of
    the motion on a common body: leg lengths a second, over ``sqrt(g / leg)`` of that body (:data:`NOMINAL_LEG`). The height of
    the hips is left out: in leg lengths it still tells how high an ankle is, which differs between bodies.

    Parameters
    ----------
    clip
        A clip of any length and frame rate, on a skeleton with the core roles.
    fps
        Frames per second of the result.

    Returns
    -------
    sequence
        (T, D) in the order of :data:`SEQUENCE_NAMES`, read-only; about ``T = duration * fps``. The same array for each call.
    """
    known = _known(clip)
    if fps not in known:
        known[fps] = _sequence(resample(clip, fps))
        known[fps].flags.writeable = False
    return known[fps]


@per_clip
def _known(clip: MotionClip) -> dict[float, NDArray[np.float64]]:
    return {}


def _sequence(clip: MotionClip) -> NDArray[np.float64]:
    joint = clip.skeleton.joint
    facing = heading_rotations(clip)
    lines = np.stack(
        [
            clip.positions[:, joint(f"{SIDES[0]}_{line}")] - clip.positions[:, joint(f"{SIDES[1]}_{line}")]
            for line in _LINES
        ],
        axis=1,
    )
    lines = lines / np.maximum(np.linalg.norm(lines, axis=-1, keepdims=True), 1e-9)
    hips = clip.positions[:, joint("hips")] / clip.skeleton.leg_length
    velocity = quat.inv_rotate(facing, rate(hips, clip.fps)) * TIME_UNIT
    yaw_rate = rate(heading(clip)[:, None], clip.fps) * TIME_UNIT
    parts = (segment_directions(clip), quat.inv_rotate(facing[:, None], lines), velocity, yaw_rate)
    return np.concatenate([part.reshape(len(clip), -1) for part in parts], axis=1)


def rate(values: NDArray[np.float64], fps: float) -> NDArray[np.float64]:
    """(T, ...) change a second by central differences, one-sided at the ends; zero for a single frame."""
    if len(values) < 2:
        return np.zeros_like(values)
    return np.gradient(values, 1.0 / fps, axis=0)
