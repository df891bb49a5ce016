"""Quaternion algebra on arrays.

Quaternions are ``(..., 4)`` arrays in the order ``w, x, y, z``; vectors are ``(..., 3)``. Every function broadcasts over the
leading axes, expects unit quaternions where it rotates, and returns float64 unless told otherwise. ``q`` and ``-q`` are the
same rotation: put them on one hemisphere (:func:`unroll`, :func:`align`) before differences, averages and blends.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

_EPS = 1e-12


def identity(*shape: int) -> Array:
    """Identity quaternions of shape ``(*shape, 4)``."""
    q = np.zeros((*shape, 4))
    q[..., 0] = 1.0
    return q


def normalize(q: ArrayLike, *, eps: float = _EPS) -> Array:
    """Unit quaternions; those shorter than ``eps`` become the identity."""
    q = np.asarray(q, dtype=np.float64)
    length = np.sqrt(np.einsum("...i,...i->...", q, q))[..., None]
    safe = length > eps
    if safe.all():
        return np.asarray(q / length)
    return np.where(safe, q / np.where(safe, length, 1.0), identity())


def mul(a: ArrayLike, b: ArrayLike) -> Array:
    """Hamilton product ``a b``: the rotation ``b`` followed by ``a``."""
    # (a + b j)(c + d j) = (a c - b d*) + (a d + b c*) j on pairs of complex numbers: a third of the calls of four components.
    left = np.ascontiguousarray(a, dtype=np.float64).view(complex)
    right = np.ascontiguousarray(b, dtype=np.float64).view(complex)
    p, q, r, s = left[..., 0], left[..., 1], right[..., 0], right[..., 1]
    out = np.empty((*np.broadcast_shapes(p.shape, r.shape), 2), dtype=complex)
    np.subtract(p * r, q * s.conj(), out=out[..., 0])
    np.add(p * s, q * r.conj(), out=out[..., 1])
    return out.view(np.float64)


def inverse(q: ArrayLike) -> Array:
    """Inverse of unit quaternions (the conjugate)."""
    return np.asarray(q, dtype=np.float64) * np.array([1.0, -1.0, -1.0, -1.0])


def inv_mul(a: ArrayLike, b: ArrayLike) -> Array:
    """``a^-1 b``: the rotation from ``a`` to ``b`` in the frame of ``a``."""
    return mul(inverse(a), b)


def rotate(q: ArrayLike, v: ArrayLike) -> Array:
    """Vectors ``v`` (..., 3) turned by ``q`` (..., 4)."""
    q, v = np.asarray(q, dtype=np.float64), np.asarray(v, dtype=np.float64)
    w, x, y, z = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    a, b, c = v[..., 0], v[..., 1], v[..., 2]
    # By components: `np.cross` takes twice as long, most of it on axes and shapes.
    ta, tb, tc = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    out = np.empty((*ta.shape, 3))
    out[..., 0] = a + w * ta + (y * tc - z * tb)
    out[..., 1] = b + w * tb + (z * ta - x * tc)
    out[..., 2] = c + w * tc + (x * tb - y * ta)
    return out


def rotate_y(yaw: ArrayLike, v: ArrayLike) -> Array:
    """Vectors ``v`` (T, ..., 3) turned about +Y by ``yaw`` (T,) radians, in a fraction of the time of :func:`rotate`."""
    yaw, v = np.asarray(yaw, dtype=np.float64), np.asarray(v, dtype=np.float64)
    cos, sin = (each.reshape(-1, *[1] * (v.ndim - 2)) for each in (np.cos(yaw), np.sin(yaw)))
    x, z = v[..., 0], v[..., 2]
    out = np.empty_like(v)
    out[..., 0] = cos * x + sin * z
    out[..., 1] = v[..., 1]
    out[..., 2] = cos * z - sin * x
    return out


def inv_rotate(q: ArrayLike, v: ArrayLike) -> Array:
    """Vectors ``v`` turned by the inverse of ``q``."""
    return rotate(inverse(q), v)


def absolute(q: ArrayLike) -> Array:
    """The same rotations with ``w >= 0``."""
    q = np.asarray(q, dtype=np.float64)
    return np.where(q[..., :1] < 0.0, -q, q)


def align(q: ArrayLike, reference: ArrayLike) -> Array:
    """The same rotations on the hemisphere of ``reference`` (broadcast)."""
    q = np.asarray(q, dtype=np.float64)
    dot = np.einsum("...i,...i->...", q, np.asarray(reference, dtype=np.float64))
    return np.where(dot[..., None] < 0.0, -q, q)


def unroll(q: ArrayLike, *, axis: int = 0) -> Array:
    """The same rotations, sign-continuous along ``axis``; the first keeps its sign."""
    q = np.moveaxis(np.asarray(q, dtype=np.float64), axis, 0)
    if len(q) < 2:
        return np.moveaxis(q.copy(), 0, axis)
    flips = np.einsum("...i,...i->...", q[1:], q[:-1]) < 0.0
    if not flips.any():
        return np.moveaxis(q.copy(), 0, axis)
    sign = np.where(np.logical_xor.accumulate(flips, axis=0), -1.0, 1.0)
    out = q.copy()
    out[1:] *= sign[..., None]
    return np.moveaxis(out, 0, axis)


def log(q: ArrayLike) -> Array:
    """Rotation vectors (..., 3) in radians of length at most pi, from unit quaternions of either sign.

    Small angles use the series ``2 xyz / w``, so the map is smooth at zero; at pi the axis is whichever sign ``xyz`` has.
    """
    q = absolute(q)
    sin = np.sqrt(np.einsum("...i,...i->...", q[..., 1:], q[..., 1:]))
    small = sin < 1e-9
    angle = 2.0 * np.arctan2(sin, q[..., 0])
    scale = np.where(small, 2.0, angle / np.where(small, 1.0, sin))
    return scale[..., None] * q[..., 1:]


def exp(v: ArrayLike) -> Array:
    """Unit quaternions from rotation vectors (..., 3) in radians; inverse of :func:`log`."""
    v = np.asarray(v, dtype=np.float64)
    angle = np.sqrt(np.einsum("...i,...i->...", v, v))
    half = 0.5 * angle
    small = angle < 1e-9
    scale = np.where(small, 0.5, np.sin(half) / np.where(small, 1.0, angle))
    return np.concatenate([np.cos(half)[..., None], scale[..., None] * v], axis=-1)


def angle(a: ArrayLike, b: ArrayLike) -> Array:
    """Geodesic angle in radians in [0, pi] between the rotations ``a`` and ``b``, accurate near 0 and pi."""
    d = inv_mul(a, b)
    return 2.0 * np.arctan2(np.linalg.norm(d[..., 1:], axis=-1), np.abs(d[..., 0]))


def from_axis_angle(axis: ArrayLike, angle: ArrayLike) -> Array:
    """Quaternions that turn by ``angle`` (...) radians about the unit ``axis`` (..., 3)."""
    half = 0.5 * np.asarray(angle, dtype=np.float64)[..., None]
    vector = np.sin(half) * np.asarray(axis, dtype=np.float64)
    return np.concatenate([np.broadcast_to(np.cos(half), (*vector.shape[:-1], 1)), vector], axis=-1)


def between(a: ArrayLike, b: ArrayLike) -> Array:
    """Shortest-arc rotations that turn the directions ``a`` (..., 3) onto ``b`` (..., 3).

    Opposite directions turn half a circle about an arbitrary but fixed perpendicular axis; zero vectors give the identity.
    """
    u, v = np.broadcast_arrays(np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64))
    na = np.sqrt(np.einsum("...i,...i->...", u, u))[..., None]
    nb = np.sqrt(np.einsum("...i,...i->...", v, v))[..., None]
    usable = (na > _EPS) & (nb > _EPS)
    if usable.all():
        u, v = u / na, v / nb
    else:
        u = np.where(usable, u / np.where(usable, na, 1.0), [1.0, 0.0, 0.0])
        v = np.where(usable, v / np.where(usable, nb, 1.0), [1.0, 0.0, 0.0])
    dot = np.einsum("...i,...i->...", u, v)[..., None]
    q = np.empty((*dot.shape[:-1], 4))
    q[..., :1] = 1.0 + dot
    for i, (j, k) in enumerate(((1, 2), (2, 0), (0, 1)), start=1):
        q[..., i] = u[..., j] * v[..., k] - u[..., k] * v[..., j]
    q = normalize(q)
    opposite = dot < -1.0 + 1e-6
    if np.any(opposite):
        # Here 1 + dot and u x v are rounding noise; the sum of both directions is small and known to the last digit.
        both = u + v
        least = np.eye(3)[np.argmin(np.abs(u), axis=-1)]
        axis = np.cross(u, both)
        axis = np.where(np.linalg.norm(axis, axis=-1, keepdims=True) > 1e-15, axis, np.cross(u, least))
        axis = axis / np.linalg.norm(axis, axis=-1, keepdims=True)
        cos = 0.5 * np.linalg.norm(both, axis=-1, keepdims=True)
        turn = np.concatenate([cos, np.sqrt(np.maximum(1.0 - cos * cos, 0.0)) * axis], axis=-1)
        q = np.where(opposite, turn, q)
    return q


def slerp(a: ArrayLike, b: ArrayLike, t: ArrayLike) -> Array:
    """Spherical interpolation along the short arc; ``t`` (...) in [0, 1], ends exact up to sign and rounding."""
    a, b = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    t = np.asarray(t, dtype=np.float64)
    dot = np.einsum("...i,...i->...", a, b)
    # Of a small angle the cosine knows few digits, but then the weights hardly depend on it: they need its sine and the angle
    # to be of the same cosine, no more, and lose nothing even at 1e-8 radians.
    cos = np.minimum(np.abs(dot), 1.0)
    theta = np.arccos(cos)
    sin = np.sqrt((1.0 - cos) * (1.0 + cos))
    same = sin == 0.0
    safe = np.where(same, 1.0, sin)
    wa = np.where(same, 1.0 - t, np.sin((1.0 - t) * theta) / safe)
    wb = np.copysign(np.where(same, t, np.sin(t * theta) / safe), dot)
    return normalize(wa[..., None] * a + wb[..., None] * b)


def mean(q: ArrayLike, *, weights: ArrayLike | None = None, axis: int = 0) -> Array:
    """Average rotation along ``axis``: the leading eigenvector of ``sum w q q^T`` (Markley et al. 2007), with ``w >= 0``.

    It does not depend on the signs of the inputs.
    """
    q = np.moveaxis(np.asarray(q, dtype=np.float64), axis, 0)
    w = np.ones(len(q)) if weights is None else np.asarray(weights, dtype=np.float64)
    scatter = np.einsum("t,t...i,t...j->...ij", w, q, q)
    return absolute(np.linalg.eigh(scatter)[1][..., -1])
