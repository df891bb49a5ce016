"""One frame of reference for every clip: hips first, rigid bones, Y up, floor at zero, facing +Z from the origin.

Nothing here changes what the body does: joint angles stay as they are, but for frames cut and for resampling.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import ConfigError
from benchmark.motion import quat
from benchmark.motion.clip import MotionClip
from benchmark.motion.kinematics import fk
from benchmark.motion.resample import resample
from benchmark.motion.skeleton import SIDES, EndSite, Skeleton
from benchmark.motion.tpose import tpose_frames, trim_tpose

Array = NDArray[np.float64]

__all__ = [
    "AXES",
    "HEADING_SIGMA",
    "canonicalise",
    "collapse_root",
    "floor_height",
    "foot_points",
    "heading",
    "rigid",
    "to_y_up",
    "tpose_frames",
    "trim_tpose",
    "up_axis",
]

#: Standard deviation in seconds of the Gaussian that smooths the facing direction: 20 frames at 60 fps, as in the exporter
#: of Holden et al. 2016.
HEADING_SIGMA = 20 / 60

#: Speed below which a foot may be standing, in sqrt(g * leg); the threshold of :mod:`benchmark.motion.contacts`.
_STANDING_SPEED = 0.266
_GRAVITY = 9.81

#: Height of the ankle above the sole by leg length (hip to ankle), for skeletons whose legs end there: 0.039 and 0.491 of
#: body height (Winter 2009, after Drillis and Contini 1966).
_ANKLE_HEIGHT = 0.039 / 0.491

#: The floor is where the feet spend this share of their standing time within a band this high, in leg lengths: above the
#: jitter of depth cameras (2 to 6 mm) and the play of a sole, below any step.
_FLOOR_SHARE, _FLOOR_BAND = 0.2, 0.03

AXES = {
    "X": (1.0, 0.0, 0.0),
    "-X": (-1.0, 0.0, 0.0),
    "Y": (0.0, 1.0, 0.0),
    "-Y": (0.0, -1.0, 0.0),
    "Z": (0.0, 0.0, 1.0),
    "-Z": (0.0, 0.0, -1.0),
}


def canonicalise(
    clip: MotionClip,
    *,
    fps: float | None = None,
    trim: bool = True,
    face: bool = True,
    floor: bool | float = True,
    up: str | None = None,
) -> MotionClip:
    """The clip in the frame of reference of the suite. Applying it again changes nothing.

    In this order: joints above the hips folded into the hips (:func:`collapse_root`), bones made rigid (:func:`rigid`), Y
    up (:func:`to_y_up`), T-pose prefix cut (:func:`trim_tpose`), resampled, floor moved to y = 0 (:func:`floor_height`), and
    the first frame turned to face +Z (smoothed :func:`heading`) with its root over the origin.

    Parameters
    ----------
    clip
        T frames of a skeleton with the core roles.
    fps
        Frame rate wanted; ``None`` keeps the clip's.
    trim, face
        Whether to cut the T-pose prefix, to place and turn the first frame.
    floor
        Whether to find the floor and move it to zero; a number is its height in metres where it is known, for example from
        other clips of a fixed camera. (A known floor is moved every time this is called.)
    up
        The clip's up axis, a key of :data:`AXES`, or ``None`` to find it (:func:`up_axis`).

    Returns
    -------
    MotionClip
        With rotations sign-continuous from ``w >= 0`` and without the raw channels of the source file.

    Raises
    ------
    SkeletonError
        If a role that a step needs is missing.
    ConfigError
        If ``up`` is not an axis.
    """
    clip = to_y_up(rigid(collapse_root(clip)), up)
    offsets = clip.skeleton.offsets.copy()
    offsets[0] = 0.0  # Never used by kinematics, and an artefact of the file in some captures.
    clip = clip.replace(skeleton=clip.skeleton.with_offsets(offsets), source=None)
    if trim:
        clip = trim_tpose(clip)
    if fps is not None:
        clip = resample(clip, fps)
    if floor is not False:
        height = floor_height(clip) if floor is True else float(floor)
        clip = _moved(clip, np.array([0.0, -height, 0.0]))
    if face:
        clip = _moved(clip, -clip.root[0] * np.array([1.0, 0.0, 1.0]))
        yaw = heading(clip, sigma=HEADING_SIGMA)[0]
        turn = quat.from_axis_angle([0.0, 1.0, 0.0], -yaw)
        clip = _turned(clip, turn)
    rotations = clip.rotations.copy()
    rotations[0] = quat.absolute(rotations[0])
    return clip.replace(rotations=quat.unroll(rotations))


def heading(clip: MotionClip, *, sigma: float = 0.0) -> Array:
    """Direction the body faces, as yaw about +Y.

    ``across = (left hip - right hip) + (left shoulder - right shoulder)``, each pair where the skeleton has it, and
    ``forward = across x up``, flattened onto the floor (Holden et al. 2016).

    Parameters
    ----------
    clip
        T frames with both hip roles or both shoulder roles, Y up.
    sigma
        Standard deviation in seconds of a Gaussian over the forward vectors; :data:`HEADING_SIGMA` smooths away the twist
        of a stride, 0 nothing.

    Returns
    -------
    ndarray
        (T,) radians, 0 facing +Z, pi/2 facing +X, continuous in time from a first value in (-pi, pi]. While nothing of
        ``across`` is horizontal (lying on one side) the last direction holds.

    Raises
    ------
    SkeletonError
        If neither pair of roles is known.
    """
    # Several stages of a method ask for it. A clip does not change, and keeps what it is asked for like its world positions.
    known: dict[float, Array] = clip.__dict__.setdefault("_headings", {})
    if sigma not in known:
        known[sigma] = _heading(clip, sigma)
    return known[sigma].copy()


def _heading(clip: MotionClip, sigma: float) -> Array:
    skeleton, positions = clip.skeleton, clip.positions
    across = np.zeros((len(clip), 3))
    pairs = [pair for pair in (("left_hip", "right_hip"), ("left_shoulder", "right_shoulder")) if skeleton.has(*pair)]
    for left, right in pairs or [("left_hip", "right_hip")]:
        across += positions[:, skeleton.joint(left)] - positions[:, skeleton.joint(right)]
    width = np.sqrt(np.einsum("ti,ti->t", across, across))
    # across x up with up = (0, 1, 0). Not normalised: frames seen nearly side-on from above count for less when smoothed.
    forward = across[:, [2, 0]] * [-1.0, 1.0] / np.where(width > 0, width, 1.0)[:, None]
    usable = np.einsum("ti,ti->t", forward, forward) > 1e-12
    if not usable.all():
        last = np.maximum.accumulate(np.where(usable, np.arange(len(clip)), -1))
        first = int(np.argmax(usable)) if usable.any() else 0
        forward = forward[np.where(last < 0, first, last)]
        if not usable.any():
            forward = np.broadcast_to([0.0, 1.0], forward.shape)
    if sigma > 0 and len(clip) > 1:
        from scipy.ndimage import gaussian_filter1d

        smooth = gaussian_filter1d(forward, sigma * clip.fps, axis=0, mode="nearest")
        # Opposite directions cancel in a fast spin: there the plain direction is all there is.
        weak = np.einsum("ti,ti->t", smooth, smooth) <= 1e-6
        if weak.any():
            smooth[weak] = forward[weak]
        forward = smooth
    yaw = np.arctan2(forward[:, 0], forward[:, 1])
    # Most clips never face backwards, where angles jump.
    return yaw if np.ptp(yaw) < np.pi else np.unwrap(yaw)


def floor_height(clip: MotionClip) -> float:
    """Height of the floor that the feet stand on, metres.

    The lowest point of both feet (ankles, toes, whatever hangs below them, tips of chains) is followed through the clip;
    where the legs end at the ankles, the sole is 0.08 leg lengths further down. Frames count in which that point is slow
    enough to be standing (0.266 sqrt(g leg); all frames if none is), so flight and swing do not raise the floor. The floor
    is the median of the lowest band of 0.03 leg lengths in which the feet spend a fifth of that time. Where a camera loses
    the feet their heights scatter and fill no band; jitter about the floor averages out instead of lowering it to its lowest
    excursion; and steps or pedestals above the floor do not count.

    Parameters
    ----------
    clip
        T frames with the hip, knee and ankle roles, Y up.
    """
    points = foot_points(clip)
    leg = clip.skeleton.leg_length
    frames = np.arange(len(clip))
    lowest = np.argmin(points[..., 1], axis=1)
    height = points[frames, lowest, 1]
    if len(clip) > 1:
        speed = np.linalg.norm(np.gradient(points, axis=0), axis=-1)[frames, lowest] * clip.fps
        standing = speed < _STANDING_SPEED * np.sqrt(_GRAVITY * leg)
        height = height[standing] if standing.any() else height
    height = np.sort(height)
    share = max(1, int(np.ceil(_FLOOR_SHARE * len(height))))
    width = height[share - 1 :] - height[: len(height) - share + 1]
    dense = width <= _FLOOR_BAND * leg
    base = height[int(np.argmax(dense)) if dense.any() else int(np.argmin(width))]
    return float(np.median(height[(height >= base) & (height <= base + _FLOOR_BAND * leg)]))


def foot_points(clip: MotionClip) -> Array:
    """(T, P, 3) world positions of everything below the ankles, the ankles included; of the soles where that is nothing."""
    skeleton = clip.skeleton
    rotations, positions = clip.world
    points = []
    for side in SIDES:
        ankle = skeleton.joint(f"{side}_ankle")
        foot = {ankle}
        for joint in range(ankle + 1, len(skeleton)):
            if int(skeleton.parents[joint]) in foot:
                foot.add(joint)
        tips = [end for end in skeleton.end_sites if end.parent in foot and np.linalg.norm(end.offset) > 0]
        points += [positions[:, joint] for joint in sorted(foot)]
        points += [positions[:, end.parent] + quat.rotate(rotations[:, end.parent], end.offset) for end in tips]
        if len(foot) == 1 and not tips:
            points.append(positions[:, ankle] - [0.0, _ANKLE_HEIGHT * skeleton.leg_length, 0.0])
    return np.stack(points, axis=1)


def collapse_root(clip: MotionClip) -> MotionClip:
    """The clip with its hips as joint 0.

    Joints above the hips (a reference node, a trajectory) are folded into them: world positions and rotations of all that
    hangs on the hips stay exactly as they were. Joints beside the hips go, unless one has a role: such hips are not the
    root of the body, and the clip is returned as it is.

    Raises
    ------
    SkeletonError
        If the skeleton has no hips role.
    """
    skeleton = clip.skeleton
    hips = skeleton.joint("hips")
    if hips == 0:
        return clip
    below = [hips]
    for joint in range(hips + 1, len(skeleton)):
        if int(skeleton.parents[joint]) in below:
            below.append(joint)
    if any(joint not in below for joint in skeleton.roles.values()):
        return clip
    new = {old: i for i, old in enumerate(below)}
    smaller = Skeleton(
        tuple(skeleton.names[joint] for joint in below),
        np.array([-1] + [new[int(skeleton.parents[joint])] for joint in below[1:]]),
        skeleton.offsets[below],
        tuple(replace(end, parent=new[end.parent]) for end in skeleton.end_sites if end.parent in new),
        tuple(skeleton.orders[joint] for joint in below),
        {role: new[joint] for role, joint in skeleton.roles.items()},
    )
    world_rotations, positions = clip.world
    rotations = clip.rotations[:, below]
    rotations[:, 0] = world_rotations[:, hips]
    return clip.replace(
        skeleton=smaller,
        rotations=rotations,
        root=positions[:, hips],
        translations=None if clip.translations is None else clip.translations[:, below],
        residual=None if clip.residual is None else clip.residual[:, below],
        source=None,
    )


def rigid(clip: MotionClip, *, tolerance: float = 1e-4) -> MotionClip:
    """The clip with bones of constant length.

    Per-frame translations that are constant to ``tolerance`` become the offsets (their median). Otherwise each bone gets
    the median of its length along the median of its direction, rotations are kept, and the distance by which each joint
    moves is stored as the clip's ``residual`` (T, J). Call :func:`collapse_root` first where a joint below the root carries
    the trajectory.

    Parameters
    ----------
    clip
        T frames; returned as it is if its bones are rigid already.
    tolerance
        Metres that a translation may differ from its median in any frame and still count as constant.
    """
    if clip.translations is None:
        return clip
    offsets = np.median(clip.translations, axis=0)
    offsets[0] = clip.skeleton.offsets[0]
    moved = np.linalg.norm(clip.translations[:, 1:] - offsets[1:], axis=-1)
    if moved.size == 0 or moved.max() <= tolerance:
        return clip.replace(skeleton=clip.skeleton.with_offsets(offsets), translations=None, source=None)
    lengths = np.median(np.linalg.norm(clip.translations, axis=-1), axis=0)
    now = np.linalg.norm(offsets, axis=-1)
    offsets[1:] *= (lengths / np.where(now > 0, now, 1.0))[1:, None]
    stiff = clip.replace(skeleton=clip.skeleton.with_offsets(offsets), translations=None, source=None)
    residual = np.linalg.norm(stiff.positions - clip.positions, axis=-1)
    return stiff.replace(residual=residual if clip.residual is None else residual + clip.residual)


def up_axis(clip: MotionClip) -> str:
    """Which way is up, as a key of :data:`AXES`.

    The axis along which the head is above the ankles, to within 45 degrees and in at least three quarters of the frames.
    A figure that lies through a whole clip looks like one that stands in a file with another axis up, so an axis other than
    Y needs a second witness: the skeleton at rest stands along it too, or stands along no axis, or the hips travel further
    than a leg along Y and less along the axis found. ``"Y"`` wherever there is doubt.

    Parameters
    ----------
    clip
        T frames with the head and ankle roles.
    """
    found = _vote(clip.skeleton, clip.positions)
    if found in (None, "Y"):
        return "Y"
    rest = _rest_axis(clip.skeleton)
    if rest in (found, None):
        return found
    travel = np.ptp(clip.root, axis=0)
    leg = clip.skeleton.leg_length
    along = float(travel @ np.abs(AXES[found]))
    return found if travel[1] > leg > along else "Y"


def _vote(skeleton: Skeleton, positions: Array) -> str | None:
    head = positions[:, skeleton.joint("head")]
    feet = positions[:, skeleton.joints("left_ankle", "right_ankle")].mean(axis=1)
    body = head - feet
    length = np.maximum(np.linalg.norm(body, axis=-1), 1e-12)
    for name, axis in AXES.items():
        if np.mean(body @ np.array(axis) > np.cos(np.pi / 4) * length) >= 0.75:
            return name
    return None


def _rest_axis(skeleton: Skeleton) -> str | None:
    _, positions = fk(skeleton, quat.identity(1, len(skeleton)), np.zeros((1, 3)))
    return _vote(skeleton, positions)


def to_y_up(clip: MotionClip, up: str | None = None) -> MotionClip:
    """The clip with Y up.

    Where the skeleton stands along the up axis at rest too, the whole file is expressed in turned coordinates, offsets
    included; otherwise the motion alone is turned.

    Parameters
    ----------
    clip
        T frames.
    up
        Its up axis, a key of :data:`AXES`, or ``None`` to find it with :func:`up_axis`.

    Raises
    ------
    ConfigError
        If ``up`` is not an axis.
    """
    if up is not None and up not in AXES:
        raise ConfigError(f"up axis {up!r} is none of {', '.join(AXES)}")
    up = up_axis(clip) if up is None else up
    if up == "Y":
        return clip
    turn = quat.between(AXES[up], AXES["Y"])
    if _rest_axis(clip.skeleton) != up:
        return _turned(clip, turn)
    skeleton = clip.skeleton
    ends = [EndSite(end.parent, tuple(quat.rotate(turn, end.offset).tolist())) for end in skeleton.end_sites]
    return clip.replace(
        skeleton=skeleton.with_offsets(quat.rotate(turn, skeleton.offsets), ends),
        rotations=quat.normalize(quat.mul(quat.mul(turn, clip.rotations), quat.inverse(turn))),
        root=quat.rotate(turn, clip.root),
        translations=None if clip.translations is None else quat.rotate(turn, clip.translations),
        source=None,
    )


def _moved(clip: MotionClip, by: Array) -> MotionClip:
    return clip.replace(root=clip.root + by, source=None)


def _turned(clip: MotionClip, turn: Array) -> MotionClip:
    rotations = clip.rotations.copy()
    rotations[:, 0] = quat.normalize(quat.mul(turn, rotations[:, 0]))
    return clip.replace(rotations=rotations, root=quat.rotate(turn, clip.root), source=None)
