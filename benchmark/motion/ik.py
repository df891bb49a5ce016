"""Joint rotations from joint positions: the inverse of forward kinematics for captures that hold positions only.

A position says where a bone points and nothing about its turn around its own axis, so the answer is not unique. The rules
here make it a function of the pose wherever they can:

* A joint with several children is turned so that its rest bones lie on the measured ones in the least-squares sense,
  weighted by bone length (Wahba's problem, SIAM Review 1965, solved as the leading eigenvector of Davenport's 4 x 4 matrix).
* A joint with one child takes the shortest arc from the direction its bone would have if it moved rigidly with its parent.
  The plane in which a knee or an elbow bends is *not* used to recover the twist of the thigh or the upper arm: on nearly
  straight limbs, which is most of everyday motion, that plane is noise and the twist would be too.
* The shortest arc turns ever faster as a bone nears the opposite of its rest direction. Within :data:`FOLD_CONE` of it the
  twist is carried over from frame to frame by parallel transport instead, and what is left over when the bone comes out is
  spread evenly over those frames. The direction of the bone is untouched.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmark.errors import ContractError
from benchmark.motion import quat
from benchmark.motion.kinematics import fk, local_from_world
from benchmark.motion.skeleton import Skeleton

Array = NDArray[np.float64]

#: Radians from the opposite of the rest direction within which twist follows time rather than the pose. Knees and elbows
#: fold to about 150 degrees, so a healthy limb stays outside.
FOLD_CONE = np.radians(25.0)

#: Bones shorter than this, in metres, have no direction.
_SHORTEST = 1e-9

#: Twice one plus the cosine of an arc, below which its length is lost in rounding.
_WIDE = 0.02

#: Weight of the parent's orientation in Wahba's problem, relative to the bones. It decides only what the bones leave open
#: (they all lie on one line) and is far below what 1e-9 m can show.
_PRIOR = 1e-13

#: Wahba's problem with weights that sum to 1 is solved without LAPACK after so many steps of Newton's method, if the last was
#: shorter than ``_SETTLED``, the product of the distances to the other eigenvalues is at least ``_APART``, and the square of
#: the cosine of half of the turn is at least ``_NARROW``.
_NEWTON, _SETTLED, _APART, _NARROW = 5, 1e-9, 0.05, 0.1


def rotations_from_positions(skeleton: Skeleton, positions: ArrayLike) -> tuple[Array, Array, Array]:
    """Local rotations that put a rigid skeleton on measured joint positions.

    Bones are matched by direction, from the root to the leaves; lengths are the skeleton's. Joints without children and
    joints whose bones have no length keep the rest rotation relative to their parent.

    Parameters
    ----------
    skeleton
        J joints with rest offsets in metres.
    positions
        (T, J, 3) measured world positions, metres.

    Returns
    -------
    rotations
        (T, J, 4) local unit quaternions, sign-continuous in time.
    root
        (T, 3) position of joint 0: as measured.
    residual
        (T, J) distance in metres between the measured joints and those of the posed skeleton.

    Raises
    ------
    ContractError
        If ``positions`` is not finite or not of shape (T, J, 3) with T > 0.
    """
    measured = np.asarray(positions, dtype=np.float64)
    joints = len(skeleton)
    if measured.ndim != 3 or measured.shape[1:] != (joints, 3) or len(measured) == 0:
        raise ContractError(
            f"positions must have shape (T, {joints}, 3) with T > 0 on this skeleton, not {measured.shape}"
        )
    if not np.all(np.isfinite(measured)):
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(measured))[0])
        raise ContractError(f"positions hold {measured[where]} at index {where}")

    rotations = quat.identity(len(measured), joints)
    world = quat.identity(len(measured), joints)
    for joint in range(joints):
        parent = int(skeleton.parents[joint])
        above = world[:, parent] if parent >= 0 else quat.identity(len(measured))
        children = [child for child in skeleton.children(joint) if skeleton.bone_lengths[child] > _SHORTEST]
        if children:
            bones = quat.inv_rotate(above[:, None], measured[:, children] - measured[:, joint, None])
            rotations[:, joint] = _local(skeleton.offsets[children], bones)
        world[:, joint] = quat.mul(above, rotations[:, joint])
    rotations = quat.normalize(quat.unroll(rotations))
    root = measured[:, 0].copy()
    residual = np.linalg.norm(fk(skeleton, rotations, root)[1] - measured, axis=-1)
    return rotations, root, residual


def aim_bones(skeleton: Skeleton, rotations: ArrayLike, positions: ArrayLike) -> Array:
    """Turn a posed skeleton's bones to where joint positions say they point, and keep everything else of the pose.

    From the root to the leaves each joint is turned, in the world, by the smallest rotation that brings its bones onto the
    wanted directions: the shortest arc for one bone, the least-squares rotation weighted by bone length for several. What
    positions do not say, the twist of a limb and the rotations of joints at the ends of chains, stays that of ``rotations``.
    For positions that a method has computed from a motion whose rotations are known; :func:`rotations_from_positions` is for
    positions with no such motion behind them.

    Parameters
    ----------
    skeleton
        J joints with rest offsets in metres.
    rotations
        (T, J, 4) local rotations to start from.
    positions
        (T, J, 3) wanted joint positions in the world, in any unit: only directions between joints are used. A bone whose two
        joints coincide keeps its direction relative to its parent.

    Returns
    -------
    (T, J, 4) local unit quaternions, sign-continuous in time.

    Raises
    ------
    ContractError
        If the shapes do not belong together or a value is not finite.
    """
    given, wanted = np.asarray(rotations, dtype=np.float64), np.asarray(positions, dtype=np.float64)
    frames, joints = len(given), len(skeleton)
    for name, array, shape in (("rotations", given, (frames, joints, 4)), ("positions", wanted, (frames, joints, 3))):
        if array.shape != shape:
            raise ContractError(f"{name} must have shape {shape} on this skeleton, not {array.shape}")
        if not np.all(np.isfinite(array)):
            where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
            raise ContractError(f"{name} holds {array[where]} at index {where}")
    world = quat.identity(frames, joints)
    aims = _aims(skeleton)
    bones, known = _bones(skeleton, wanted)
    rest, aimed_at = _unit(skeleton.offsets), _unit(bones)
    for aim in aims:
        turned = given[:, aim.joints] if aim.root else quat.mul(world[:, aim.parents], given[:, aim.joints])
        if len(aim.one):
            start = turned[:, aim.one]
            now, then = quat.rotate(start, rest[aim.ends]), aimed_at[:, aim.ends]
            if not known:
                then = _wanted(then, now)
            turned[:, aim.one] = quat.mul(_arc(now, then), start)
        for at, children in aim.several:
            now = quat.rotate(turned[:, at, None], rest[children])
            then = aimed_at[:, children]
            if not known:
                then = _wanted(then, now)
            turned[:, at] = quat.mul(_match(now, then, skeleton.bone_lengths[children]), turned[:, at])
        world[:, aim.joints] = turned
    aimed = given.copy()
    turning = np.concatenate([aim.turning for aim in aims]).astype(np.int64)
    local = local_from_world(skeleton, world)
    aimed[:, turning] = local[:, turning]
    return quat.normalize(quat.unroll(aimed))


@dataclass(frozen=True, eq=False)
class _Aim:
    """The joints of one depth that have children, which :func:`aim_bones` turns together.

    Attributes
    ----------
    joints, parents
        (L,) the joints and what they hang on.
    one, ends
        Which of the L have one bone, and the joints at its end.
    several
        Which have more bones, and the joints at their ends.
    """

    joints: NDArray[np.int64]
    parents: NDArray[np.int64]
    one: NDArray[np.int64]
    ends: NDArray[np.int64]
    several: tuple[tuple[int, list[int]], ...]

    @property
    def root(self) -> bool:
        """Whether this is the root's level."""
        return bool(self.joints[0] == 0)

    @property
    def turning(self) -> NDArray[np.int64]:
        """The joints that are turned."""
        return self.joints[[*self.one, *(at for at, _ in self.several)]]


@lru_cache(maxsize=64)
def _aims(skeleton: Skeleton) -> tuple[_Aim, ...]:
    """From the root to the leaves; joints at the ends of chains are not among them, since they turn nothing."""
    depth = np.zeros(len(skeleton), dtype=np.int64)
    for joint in range(1, len(skeleton)):
        depth[joint] = depth[skeleton.parents[joint]] + 1
    inner = np.isin(np.arange(len(skeleton)), skeleton.parents)
    aims = []
    for level in range(int(depth.max()) + 1):
        joints = np.flatnonzero(inner & (depth == level))
        if not len(joints):
            continue
        bones = [
            [child for child in skeleton.children(int(joint)) if skeleton.bone_lengths[child] > _SHORTEST]
            for joint in joints
        ]
        one = np.array([at for at, children in enumerate(bones) if len(children) == 1], dtype=np.int64)
        ends = np.array([bones[at][0] for at in one], dtype=np.int64)
        several = tuple((at, children) for at, children in enumerate(bones) if len(children) > 1)
        aims.append(_Aim(joints, skeleton.parents[joints], one, ends, several))
    return tuple(aims)


def _bones(skeleton: Skeleton, positions: Array) -> tuple[Array, bool]:
    """Bones (T, J, 3) that end at each joint, between ``positions``, and whether all that the skeleton has have a length."""
    bones = positions - positions[:, np.maximum(skeleton.parents, 0)]
    aimed = bones[:, 1:][:, skeleton.bone_lengths[1:] > _SHORTEST]
    return bones, bool(np.einsum("tki,tki->tk", aimed, aimed).min(initial=np.inf) > _SHORTEST**2)


def _wanted(bones: Array, now: Array) -> Array:
    """Bones (T, K, 3); those of ``now`` where they have no length."""
    length = np.sqrt(np.einsum("tki,tki->tk", bones, bones))[..., None]
    return np.where(length > _SHORTEST, bones, now)


def _arc(now: Array, then: Array) -> Array:
    """:func:`benchmark.motion.quat.between` of unit vectors (T, K, 3), which need not be made so again."""
    double = 2.0 + 2.0 * np.einsum("tki,tki->tk", now, then)
    if double.min(initial=4.0) < _WIDE:
        return quat.between(now, then)
    scale = 1.0 / np.sqrt(double)
    arc = np.empty((*double.shape, 4))
    np.multiply(0.5 * double, scale, out=arc[..., 0])
    for i, (j, k) in enumerate(((1, 2), (2, 0), (0, 1)), start=1):
        np.multiply(now[..., j] * then[..., k] - now[..., k] * then[..., j], scale, out=arc[..., i])
    return arc


def match_directions(rest: ArrayLike, target: ArrayLike, *, weights: ArrayLike | None = None) -> Array:
    """The rotations that turn several directions onto others, in the least-squares sense.

    Minimises ``sum_k w_k |target_k - R rest_k|^2`` over rotations (Wahba 1965) by Davenport's q-method: the maximiser of
    ``q^T K q`` is the eigenvector of the largest eigenvalue of ``K``. A reflection is never returned. Where the directions
    leave a turn open, because they all lie on one line, the solution nearest the identity is taken.

    Parameters
    ----------
    rest
        (..., K, 3) vectors; their lengths do not matter and zero vectors count for nothing.
    target
        (..., K, 3) vectors, likewise.
    weights
        (..., K) non-negative weights; equal where ``None``.

    Returns
    -------
    (..., 4) unit quaternions with ``w >= 0``.
    """
    a, b = _unit(rest), _unit(target)
    return _match(a, b, np.ones(a.shape[-2]) if weights is None else np.asarray(weights, dtype=np.float64))


def _match(rest: Array, target: Array, weights: Array) -> Array:
    """:func:`match_directions` of vectors that are of unit length, or zero.

    The largest eigenvalue by Newton's method on the characteristic polynomial, from the sum of the weights, which it cannot
    exceed, and the eigenvector as a column of the adjugate (QUEST: Shuster & Oh 1981, "Three-axis attitude determination from
    vector observations"). Where another eigenvalue is near or the turn is wide, either loses digits, and LAPACK is asked.
    """
    profile = np.swapaxes(weights[..., None] * target, -1, -2) @ rest
    scale = np.maximum(np.sum(weights, axis=-1), _SHORTEST)
    profile = profile + (_PRIOR * scale)[..., None, None] * np.eye(3)
    shape = profile.shape[:-2]
    profile = (profile / scale[..., None, None]).reshape(-1, 3, 3)
    rotations, sure = _quest(profile)
    if not sure.all():
        rotations[~sure] = _davenport(profile[~sure])
    return rotations.reshape(*shape, 4)


def _quest(profile: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Rotations (N, 4) that maximise the trace with profiles (N, 3, 3) of weights that sum to 1, and which are exact."""
    both = profile + profile.transpose(0, 2, 1)
    (a, d, e), (_, b, f), (_, _, c) = both.transpose(1, 2, 0)
    trace = 0.5 * (a + b + c)
    skew = profile[:, [2, 0, 1], [1, 2, 0]] - profile[:, [1, 2, 0], [2, 0, 1]]
    once = np.einsum("nij,nj->ni", both, skew)
    twice = np.einsum("nij,nj->ni", both, once)
    squared = trace * trace
    minors = 2.0 * squared - 0.5 * np.einsum("nij,nij->n", both, both)
    determinant = a * (b * c - f * f) - d * (d * c - e * f) + e * (d * f - e * b)
    first, second = squared - minors, squared + np.einsum("ni,ni->n", skew, skew)
    quadratic, linear = first + second, determinant + np.einsum("ni,ni->n", skew, once)
    constant = first * second + linear * trace - np.einsum("ni,ni->n", skew, twice)
    largest = np.full(len(profile), 1.0 + 3.0 * _PRIOR)
    for _ in range(_NEWTON):
        square = largest * largest
        slope = (4.0 * square - 2.0 * quadratic) * largest - linear
        step = ((square - quadratic) * largest - linear) * largest + constant
        step /= np.where(slope > _APART, slope, 1.0)
        largest = largest - step
    alpha = largest * largest - squared + minors
    rotations = np.empty((len(profile), 4))
    rotations[:, 0] = (largest + trace) * alpha - determinant
    rotations[:, 1:] = alpha[:, None] * skew + (largest - trace)[:, None] * once + twice
    sure = (slope > _APART) & (rotations[:, 0] > _NARROW * slope) & (np.abs(step) < _SETTLED)
    return quat.normalize(rotations), sure


def _davenport(profile: Array) -> Array:
    """:func:`_quest` by the eigenvectors of Davenport's matrices, for any profile."""
    trace = np.trace(profile, axis1=-2, axis2=-1)
    davenport = np.empty((*profile.shape[:-2], 4, 4))
    davenport[..., 0, 0] = trace
    for i, (j, k) in enumerate(((1, 2), (2, 0), (0, 1))):
        davenport[..., 0, i + 1] = davenport[..., i + 1, 0] = profile[..., k, j] - profile[..., j, k]
    davenport[..., 1:, 1:] = profile + np.swapaxes(profile, -1, -2) - trace[..., None, None] * np.eye(3)
    return quat.absolute(np.linalg.eigh(davenport)[1][..., -1])


def _unit(vectors: ArrayLike) -> Array:
    vectors = np.asarray(vectors, dtype=np.float64)
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > _SHORTEST, vectors / np.where(length > _SHORTEST, length, 1.0), 0.0)


def _local(offsets: Array, bones: Array) -> Array:
    """Rotations (T, 4) of a joint in its parent's frame from its rest (K, 3) and measured (T, K, 3) bones in that frame."""
    lengths = np.linalg.norm(offsets, axis=-1)
    rest = offsets / lengths[:, None]
    if np.linalg.svd(rest, compute_uv=False)[1:].max(initial=0.0) > 1e-6:
        return match_directions(rest, bones, weights=lengths)
    # One bone, or several along one line: only a direction is known.
    axis = rest[0]
    along = np.einsum("k,k,tki->ti", lengths, np.sign(rest @ axis), _unit(bones))
    return _swing(axis, _unit(along))


def _swing(axis: Array, directions: Array) -> Array:
    """Rotations (T, 4) from the unit ``axis`` (3,) to unit or zero ``directions`` (T, 3) with a steady twist."""
    swing = quat.between(axis, directions)
    folded = directions @ axis < -np.cos(FOLD_CONE)
    if not np.any(folded):
        return swing
    # Twist about the axis that turns the shortest arc of each frame into the transport of the one before it.
    step = quat.inv_mul(swing[1:], quat.mul(quat.between(directions[:-1], directions[1:]), swing[:-1]))
    step = np.where(step[:, :1] < 0.0, -step, step)
    drift = 2.0 * np.arctan2(step[:, 1:] @ axis, step[:, 0])
    twist = np.zeros(len(directions))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], folded, [False]]).astype(np.int8)))
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        if start == 0 and stop == len(directions):
            twist[1:] = np.cumsum(drift)
        elif start == 0:
            twist[:stop] = -np.cumsum(drift[:stop][::-1])[::-1]
        elif stop == len(directions):
            twist[start:] = np.cumsum(drift[start - 1 :])
        else:
            path = np.cumsum(drift[start - 1 : stop])
            surplus = path[-1] - 2.0 * np.pi * np.round(path[-1] / (2.0 * np.pi))
            ramp = np.arange(1, len(path) + 1) / len(path)
            twist[start:stop] = (path - surplus * ramp)[:-1]
    return quat.mul(swing, quat.from_axis_angle(axis, twist))
