"""The same motion on another skeleton.

Rotations
    Between skeletons of the same joints and rest directions local rotations are copied. Otherwise each joint that has a
    counterpart gets the world orientation of that counterpart, corrected for the difference between the rest poses so that
    the bone to the next counterpart down the chain points the same way. Joints are paired by name where both skeletons
    have the same tree, by role elsewhere. Joints without a counterpart (second spines, twist joints, fingers) keep the
    rest rotation relative to their parent, except for collar bones that do not point sideways at rest (rigs without a
    T-pose), which are made to; counterparts that are missing in the target hand their turn to the next joint
    below, since orientations are matched in the world.
Root
    The path of the hips is scaled by the ratio of leg lengths about the floor ``y = 0`` (Froude scaling without its change
    of tempo: root policy B). Then one vertical shift for the whole clip sets the stance foot as high above the floor, in
    leg lengths, as it was.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import SkeletonError
from benchmark.motion import quat
from benchmark.motion.clip import MotionClip
from benchmark.motion.ik import match_directions
from benchmark.motion.kinematics import fk, local_from_world
from benchmark.motion.skeleton import CORE_ROLES, SIDES, Skeleton

Array = NDArray[np.float64]

#: Two rest directions are the same when their unit vectors differ by no more than this.
_SAME_DIRECTION = 1e-9

#: Metres below which a bone has no direction.
_SHORTEST = 1e-9

#: Radians off sideways beyond which the rest direction of a collar bone is the rig's whim and no posture.
COLLAR_CONE = np.radians(45.0)

#: Share of the frames, those with the lowest foot, that count as stance.
STANCE_SHARE = 0.25


def retarget(clip: MotionClip, skeleton: Skeleton, *, ground: bool = True) -> MotionClip:
    """Put a motion on another skeleton.

    Parameters
    ----------
    clip
        The source motion, its floor at ``y = 0``.
    skeleton
        The target.
    ground
        Whether to set the stance foot on the floor; scaled hips alone leave it in the air or in the ground when the
        target's legs and feet have other proportions.

    Returns
    -------
    A clip on ``skeleton`` with the rate and meta of ``clip``. Frame-by-frame translations, residuals and raw channels
    belong to the source skeleton and are dropped.

    Raises
    ------
    SkeletonError
        Naming the roles that either skeleton lacks: those of the legs and ``hips`` always, all of
        :data:`benchmark.motion.skeleton.CORE_ROLES` where joints are paired by role.
    """
    source = clip.skeleton
    by_name = source.same_topology(skeleton)
    legs = ("hips", *(f"{side}_{part}" for side in SIDES for part in ("hip", "knee", "ankle")))
    for which, figure in (("source", source), ("target", skeleton)):
        missing = [role for role in (legs if by_name else CORE_ROLES) if not figure.has(role)]
        if missing:
            raise SkeletonError(
                f"cannot retarget: the {which} skeleton lacks the roles {', '.join(missing)} "
                f"(joints: {', '.join(figure.names)}); name them in a role map"
            )
    if by_name and _same_rest(source, skeleton):
        rotations = clip.rotations
    else:
        pairs = (
            {joint: joint for joint in range(len(skeleton))}
            if by_name
            else {skeleton.roles[role]: source.roles[role] for role in skeleton.roles if role in source.roles}
        )
        rotations = _matched(clip, skeleton, pairs)
    scale = skeleton.leg_length / source.leg_length
    root = _root(skeleton, rotations, scale * clip.positions[:, source.joint("hips")])
    put = MotionClip(skeleton, rotations, root, clip.fps, meta=clip.meta)
    return put.with_root(put.root + [0.0, _lift(clip, put, scale), 0.0]) if ground else put


def _same_rest(a: Skeleton, b: Skeleton) -> bool:
    la, lb = a.bone_lengths[:, None], b.bone_lengths[:, None]
    both = ((la > _SHORTEST) & (lb > _SHORTEST))[:, 0]
    both[0] = False
    return bool(np.all(np.abs(a.offsets[both] / la[both] - b.offsets[both] / lb[both]) <= _SAME_DIRECTION))


def _rest_positions(skeleton: Skeleton) -> Array:
    """(J, 3) joint positions at rest, the root at the origin."""
    joints = len(skeleton)
    return fk(skeleton, quat.identity(1, joints), np.zeros((1, 3)))[1][0]


def _matched(clip: MotionClip, skeleton: Skeleton, pairs: dict[int, int]) -> Array:
    """(T, J, 4) local rotations that give paired joints their counterparts' orientations."""
    corrections, collars = _rest_turns(clip.skeleton, skeleton, tuple(sorted(pairs.items())))
    frames, joints = len(clip), list(corrections)
    world = quat.identity(frames, len(skeleton))
    rotations = quat.identity(frames, len(skeleton))
    turned = clip.world[0][:, [pairs[joint] for joint in joints]]
    world[:, joints] = quat.mul(turned, np.array([corrections[joint] for joint in joints]))
    for joint in range(len(skeleton)):
        if joint in pairs:
            continue
        parent = int(skeleton.parents[joint])
        rotations[:, joint] = collars.get(joint, quat.identity())
        above = world[:, parent] if parent >= 0 else quat.identity(frames)
        world[:, joint] = quat.mul(above, rotations[:, joint])
    rotations[:, joints] = local_from_world(skeleton, world)[:, joints]
    return quat.normalize(quat.unroll(rotations))


@lru_cache(maxsize=256)
def _rest_turns(
    source: Skeleton, target: Skeleton, pairs: tuple[tuple[int, int], ...]
) -> tuple[dict[int, Array], dict[int, Array]]:
    """What :func:`_matched` needs of the two rest poses. All clips of a performer share it; it takes as long as one."""
    return _corrections(source, target, dict(pairs)), _collars(target, dict(pairs))


def _corrections(source: Skeleton, target: Skeleton, pairs: dict[int, int]) -> dict[int, Array]:
    """Per paired target joint, the rotation (4,) from the target's rest directions to the source's.

    Hips and chest are turned as whole bodies: the line through both hip joints (shoulders) exactly, and the trunk as nearly
    as that allows. One bone takes the shortest arc from where the correction of the joint above leaves it. A joint
    with no paired joint below follows the one above.
    """
    rest_source, rest_target = _rest_positions(source), _rest_positions(target)
    above = {joint: _paired_above(target, joint, pairs) for joint in pairs}
    corrections: dict[int, Array] = {}
    for joint in sorted(pairs):
        upper = above[joint]
        start = corrections[upper] if upper is not None else quat.identity()
        frame = _body_frames(source, target, joint, pairs, rest_source, rest_target)
        if frame is not None:
            corrections[joint] = frame
            continue
        below = [
            other
            for other in sorted(pairs)
            if above[other] == joint and _hangs_from(source, pairs[other], pairs[joint])
        ]
        wanted = rest_source[[pairs[other] for other in below]] - rest_source[pairs[joint]]
        given = rest_target[below] - rest_target[joint]
        usable = np.minimum(np.linalg.norm(wanted, axis=-1), np.linalg.norm(given, axis=-1)) > _SHORTEST
        wanted, given = wanted[usable], given[usable]
        if len(given) == 0:
            corrections[joint] = start
        elif len(given) == 1:
            corrections[joint] = quat.mul(quat.between(quat.rotate(start, given[0]), wanted[0]), start)
        else:
            turned = quat.rotate(start, given)
            corrections[joint] = quat.mul(
                match_directions(turned, wanted, weights=np.linalg.norm(given, axis=-1)), start
            )
    return corrections


def _collars(target: Skeleton, pairs: dict[int, int]) -> dict[int, Array]:
    """Local rotations (4,) of collar bones without counterpart that do not point sideways at rest: made to do so."""
    if not target.has("chest"):
        return {}
    rest = _rest_positions(target)
    chest, left, right = target.joints("chest", "left_shoulder", "right_shoulder")
    across = _across(target, rest, chest, left, right)
    rotations = {}
    for side, outward, shoulder in (("left", across, left), ("right", -across, right)):
        collar = target.roles.get(f"{side}_clavicle")
        if collar is None or collar in pairs or int(target.parents[shoulder]) != collar:
            continue
        arc = quat.between(target.offsets[shoulder], outward)
        if quat.angle(arc, quat.identity()) > COLLAR_CONE:
            rotations[collar] = arc
    return rotations


def _paired_above(skeleton: Skeleton, joint: int, pairs: dict[int, int]) -> int | None:
    """The nearest ancestor that is paired."""
    above = int(skeleton.parents[joint])
    while above >= 0 and above not in pairs:
        above = int(skeleton.parents[above])
    return above if above >= 0 else None


def _hangs_from(skeleton: Skeleton, joint: int, upper: int) -> bool:
    while joint > upper:
        joint = int(skeleton.parents[joint])
    return joint == upper


def _body_frames(
    source: Skeleton, target: Skeleton, joint: int, pairs: dict[int, int], rest_source: Array, rest_target: Array
) -> Array | None:
    """The correction (4,) of hips or chest from sideways and upward directions; ``None`` for other joints."""
    for role, ends, tops in (("hips", "hip", ("chest", "neck", "head")), ("chest", "shoulder", ("neck", "head"))):
        if not (target.has(role) and source.has(role)):
            continue
        if target.joint(role) != joint or source.joint(role) != pairs[joint]:
            continue
        sides = (f"left_{ends}", f"right_{ends}")
        top = next((name for name in tops if source.has(name) and target.has(name)), None)
        if top is None or not (source.has(*sides) and target.has(*sides)):
            return None
        frames = []
        for figure, rest in ((source, rest_source), (target, rest_target)):
            across = _across(figure, rest, figure.joint(role), *figure.joints(*sides))
            frames.append(_frame(across, rest[figure.joint(top)] - rest[figure.joint(role)]))
        if frames[0] is None or frames[1] is None:
            return None
        return match_directions(frames[1], frames[0])
    return None


def _across(skeleton: Skeleton, rest: Array, joint: int, left: int, right: int) -> Array:
    """The line (3,) from right to left through the first joints below ``joint`` that lie apart.

    Those are fixed to ``joint``; joints further out are where they are at rest only by the choice of the rig, which need
    not be symmetric (collar bones at zero rotation can point up on one side and down on the other).
    """
    if _hangs_from(skeleton, left, joint) and _hangs_from(skeleton, right, joint):
        for a, b in zip(skeleton.chain(joint, left)[1:], skeleton.chain(joint, right)[1:], strict=False):
            if np.linalg.norm(rest[a] - rest[b]) > _SHORTEST:
                return rest[a] - rest[b]
    return rest[left] - rest[right]


def _frame(across: Array, up: Array) -> Array | None:
    """Two orthonormal vectors (2, 3), the first along ``across``; ``None`` where the two do not span a plane."""
    width = np.linalg.norm(across)
    if width < _SHORTEST:
        return None
    across = across / width
    up = up - (up @ across) * across
    height = np.linalg.norm(up)
    return None if height < _SHORTEST else np.stack([across, up / height])


def _root(skeleton: Skeleton, rotations: Array, hips: Array) -> Array:
    """(T, 3) positions of joint 0 that put the joint in the role ``hips`` at ``hips`` (T, 3)."""
    joint = skeleton.joint("hips")
    if joint == 0:
        return hips
    return hips - fk(skeleton, rotations, np.zeros_like(hips))[1][:, joint]


def _lift(clip: MotionClip, put: MotionClip, scale: float) -> float:
    """Metres by which to raise the whole clip.

    In the frames in which the source's lowest foot joint is lowest, the target's should be at the same height in leg
    lengths; the median difference is made up.
    """
    source, skeleton = clip.skeleton, put.skeleton
    roles = [f"{side}_ankle" for side in SIDES]
    toes = [f"{side}_toe" for side in SIDES]
    if source.has(*toes) and skeleton.has(*toes):
        roles += toes
    was = clip.positions[:, source.joints(*roles), 1].min(axis=1)
    now = put.positions[:, skeleton.joints(*roles), 1].min(axis=1)
    stance = was <= np.quantile(was, STANCE_SHARE)
    return float(np.median(scale * was[stance] - now[stance]))
