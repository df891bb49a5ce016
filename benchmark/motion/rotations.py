"""Other ways to write a rotation: Euler angles, matrices, and the first two columns of a matrix.

Everything converts to and from quaternions ``(..., 4)``, ``w, x, y, z``, and broadcasts over the leading axes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmark.errors import UnknownNameError
from benchmark.motion import quat

Array = NDArray[np.float64]

#: The six orders in which three different axes can follow one another.
EULER_ORDERS: tuple[str, ...] = ("XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX")

#: Below this length the sine and cosine that an angle is read from are rounding noise.
LOCKED = 1e-12
_AXES = {"X": 1, "Y": 2, "Z": 3}


def order_axes(order: str) -> tuple[int, int, int, float]:
    """Quaternion components 1 to 3 of the axes of ``order``, and +1.0 where they follow one another cyclically, else -1.0.

    Raises
    ------
    UnknownNameError
        If ``order`` is not one of :data:`EULER_ORDERS`.
    """
    if order not in EULER_ORDERS:
        raise UnknownNameError("rotation order", order, EULER_ORDERS)
    i, j, k = (_AXES[axis] for axis in order)
    return i, j, k, 1.0 if (j - i) % 3 == 1 else -1.0


def compose_half_angles(cosines: tuple[Array, ...], sines: tuple[Array, ...], order: str, out: Array) -> None:
    """Write into ``out`` (..., 4) the product of three turns given by cosine and sine of their half angles (...).

    The closed form of ``q_i(a) q_j(b) q_k(c)``: eight products of three factors, with signs that depend only on
    whether ``ijk`` is cyclic.
    """
    i, j, k, parity = order_axes(order)
    (ca, cb, cc), (sa, sb, sc) = cosines, sines
    cos_cos, sin_sin, sin_cos, cos_sin = ca * cb, sa * sb, sa * cb, ca * sb
    if parity < 0.0:
        sc = -sc
    np.subtract(cos_cos * cc, sin_sin * sc, out=out[..., 0])
    np.add(sin_cos * cc, cos_sin * sc, out=out[..., i])
    np.subtract(cos_sin * cc, sin_cos * sc, out=out[..., j])
    np.add(cos_cos * sc, sin_sin * cc, out=out[..., k])
    if parity < 0.0:
        np.negative(out[..., k], out=out[..., k])


def from_euler(angles: ArrayLike, order: str) -> Array:
    """Quaternions from Euler angles.

    Parameters
    ----------
    angles
        (..., 3) radians, in the sequence of ``order``.
    order
        Axes as a BVH file lists its channels: ``"ZXY"`` is ``R = Rz Rx Ry`` on column vectors, that is, intrinsic turns
        about z, then the new x, then the new y.

    Returns
    -------
    Array
        (..., 4) unit quaternions, continuous in the angles (a full turn of one angle flips the sign).
    """
    half = 0.5 * np.asarray(angles, dtype=np.float64)
    cosines, sines = np.cos(half), np.sin(half)
    out = np.empty((*half.shape[:-1], 4))
    compose_half_angles(
        (cosines[..., 0], cosines[..., 1], cosines[..., 2]), (sines[..., 0], sines[..., 1], sines[..., 2]), order, out
    )
    return out


def euler_halves(q: ArrayLike, order: str) -> tuple[Array, Array, Array, Array, Array]:
    """What the Euler angles of unit quaternions are read from.

    With half angles ``A``, ``C`` of the outer turns, ``b`` the middle one and parity ``e`` of the order, the components of
    a quaternion pair up to ``(w + q_j, q_i + e q_k) = u (cos, sin)(A + e C)`` and
    ``(w - q_j, q_i - e q_k) = v (cos, sin)(A - e C)`` with ``u = sqrt 2 sin(b/2 + pi/4)`` and
    ``v = sqrt 2 cos(b/2 + pi/4)``. Reading the angles from these pairs keeps the *rotation* exact right up to gimbal
    lock, where one pair vanishes: the angle that is then noise is weighted by the pair's length. (The idea is that of
    Bernardes & Viollet 2022, *Quaternion to Euler angles conversion: a direct, general and computationally efficient
    method*.)

    Returns
    -------
    total, difference, middle, plus, minus
        ``A + e C``, ``A - e C`` and ``b`` in radians, and the lengths ``u`` and ``v``; each (...).
    """
    i, j, k, parity = order_axes(order)
    q = np.asarray(q, dtype=np.float64)
    w, qi, qj, qk = q[..., 0], q[..., i], q[..., j], parity * q[..., k]
    plus_cos, plus_sin = w + qj, qi + qk
    minus_cos, minus_sin = w - qj, qi - qk
    plus, minus = np.hypot(plus_cos, plus_sin), np.hypot(minus_cos, minus_sin)
    total, difference = np.arctan2(plus_sin, plus_cos), np.arctan2(minus_sin, minus_cos)
    return total, difference, 2.0 * np.arctan2(plus, minus) - 0.5 * np.pi, plus, minus


def wrap(angles: ArrayLike) -> Array:
    """The same angles in [-pi, pi]; those that were there already are returned to the bit."""
    angles = np.asarray(angles, dtype=np.float64)
    return angles - (2.0 * np.pi) * np.rint(angles * (0.5 / np.pi))


def to_euler(q: ArrayLike, order: str) -> Array:
    """Euler angles (..., 3) in radians, in the sequence of ``order``, from unit quaternions of either sign.

    The outer angles lie in [-pi, pi], the middle one in [-pi/2, pi/2]. At gimbal lock (middle angle at +-pi/2) only the
    sum or the difference of the outer angles is defined; the last is then zero.
    """
    parity = order_axes(order)[3]
    total, difference, middle, plus, minus = euler_halves(q, order)
    difference = np.where(minus < LOCKED, total, difference)
    total = np.where(plus < LOCKED, difference, total)
    return np.stack([wrap(total + difference), middle, wrap(parity * (total - difference))], axis=-1)


def to_matrix(q: ArrayLike) -> Array:
    """Rotation matrices (..., 3, 3), for column vectors, from unit quaternions."""
    q = np.asarray(q, dtype=np.float64)
    w, x, y, z = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    out = np.empty((*q.shape[:-1], 3, 3))
    out[..., 0, 0] = 1.0 - 2.0 * (y * y + z * z)
    out[..., 0, 1] = 2.0 * (x * y - w * z)
    out[..., 0, 2] = 2.0 * (x * z + w * y)
    out[..., 1, 0] = 2.0 * (x * y + w * z)
    out[..., 1, 1] = 1.0 - 2.0 * (x * x + z * z)
    out[..., 1, 2] = 2.0 * (y * z - w * x)
    out[..., 2, 0] = 2.0 * (x * z - w * y)
    out[..., 2, 1] = 2.0 * (y * z + w * x)
    out[..., 2, 2] = 1.0 - 2.0 * (x * x + y * y)
    return out


def from_matrix(matrix: ArrayLike) -> Array:
    """Unit quaternions (..., 4) with ``w >= 0`` from rotation matrices (..., 3, 3).

    Of the four ways to start, the one that divides by the largest component is taken (Shepperd 1978, *Quaternion from
    rotation matrix*), so nothing is lost near half turns.
    """
    m = np.asarray(matrix, dtype=np.float64)
    xx, yy, zz = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    wx, wy, wz = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    xy, xz, yz = m[..., 0, 1] + m[..., 1, 0], m[..., 0, 2] + m[..., 2, 0], m[..., 1, 2] + m[..., 2, 1]
    # Rows of 4 q q^T: each is the quaternion times four times one of its components.
    outer = np.empty((*xx.shape, 4, 4))
    outer[..., 0, 0], outer[..., 1, 1] = 1.0 + xx + yy + zz, 1.0 + xx - yy - zz
    outer[..., 2, 2], outer[..., 3, 3] = 1.0 - xx + yy - zz, 1.0 - xx - yy + zz
    for (a, b), value in {(0, 1): wx, (0, 2): wy, (0, 3): wz, (1, 2): xy, (1, 3): xz, (2, 3): yz}.items():
        outer[..., a, b] = outer[..., b, a] = value
    largest = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(outer, largest[..., None, None], axis=-2)[..., 0, :]
    return quat.absolute(quat.normalize(q))


def to_sixd(q: ArrayLike) -> Array:
    """The first two columns of the rotation matrix, one after the other, (..., 6) (Zhou et al. 2019)."""
    matrix = to_matrix(q)
    return np.concatenate([matrix[..., :, 0], matrix[..., :, 1]], axis=-1)


def from_sixd(sixd: ArrayLike) -> Array:
    """Unit quaternions (..., 4) from two columns (..., 6) of any length and angle, by Gram-Schmidt (Zhou et al. 2019).

    Where a column is zero, or the two are parallel, any perpendicular direction is as good as another; a fixed one is
    taken, so the result is always a rotation.
    """
    sixd = np.asarray(sixd, dtype=np.float64)
    first = _unit_or(sixd[..., :3], np.array([1.0, 0.0, 0.0]))
    given = _unit_or(sixd[..., 3:], np.zeros(3))
    second = given - np.sum(first * given, axis=-1, keepdims=True) * first
    least = np.eye(3)[np.argmin(np.abs(first), axis=-1)]
    spare = least - np.sum(first * least, axis=-1, keepdims=True) * first
    second = np.where(np.linalg.norm(second, axis=-1, keepdims=True) > LOCKED, second, spare)
    # Once more, because what is left of nearly parallel columns is mostly rounding.
    second = _unit_or(second, np.zeros(3))
    second = _unit_or(second - np.sum(first * second, axis=-1, keepdims=True) * first, np.zeros(3))
    return from_matrix(np.stack([first, second, np.cross(first, second)], axis=-1))


def _unit_or(v: Array, fallback: Array) -> Array:
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    usable = length > LOCKED
    return np.where(usable, v / np.where(usable, length, 1.0), fallback)
