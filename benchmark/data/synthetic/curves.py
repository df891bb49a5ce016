"""Smooth curves in closed form, from which every synthetic motion is built.

All of them are twice continuously differentiable, so no velocity or acceleration jumps, and none depends on the sampling
rate: the same motion sampled at 60 or 120 frames per second agrees wherever the times agree.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def smoothstep(u: ArrayLike) -> Array:
    """Minimum-jerk step from 0 at ``u <= 0`` to 1 at ``u >= 1`` (Flash and Hogan 1985, eq. for a point-to-point reach)."""
    u = np.clip(np.asarray(u, dtype=np.float64), 0.0, 1.0)
    return u * u * u * (10.0 + u * (6.0 * u - 15.0))


def submovements(t: Array, start: float, moves: Sequence[tuple[float, float, float]]) -> Array:
    """A value that changes by overlapping minimum-jerk steps.

    Parameters
    ----------
    t
        (T,) times in seconds.
    start
        Value before the first step.
    moves
        ``(onset, duration, change)`` of each step; durations are positive and steps may overlap.

    Returns
    -------
    Array
        (T,).
    """
    value = np.full(len(t), float(start))
    for onset, duration, change in moves:
        value += change * smoothstep((t - onset) / duration)
    return value


def soft_polyline(t: Array, knots: ArrayLike, values: ArrayLike, width: float) -> Array:
    """The line through ``values`` at ``knots``, constant beyond both ends, with every corner rounded.

    It is the polyline convolved with a bell of ``width`` seconds, in closed form: straight stretches longer than the bell
    stay exactly straight, and nothing overshoots.

    Parameters
    ----------
    t
        (T,) times in seconds.
    knots
        (K,) increasing times.
    values
        (K,) or (K, D) values.
    width
        Seconds over which a corner is rounded, half of it on either side.

    Returns
    -------
    Array
        (T,) or (T, D).
    """
    knots = np.asarray(knots, dtype=np.float64)
    values = np.asarray(values, dtype=np.float64)
    flat = values[:, None] if values.ndim == 1 else values
    slopes = np.zeros((len(knots) + 1, flat.shape[1]))
    slopes[1:-1] = np.diff(flat, axis=0) / np.diff(knots)[:, None]
    bends = np.diff(slopes, axis=0)
    u = (t[:, None] - (knots - 0.5 * width)) / width
    inside = np.clip(u, 0.0, 1.0)
    # Integral of the minimum-jerk step, continued linearly.
    ramps = width * (inside**4 * (2.5 + inside * (inside - 3.0)) + np.maximum(u - 1.0, 0.0))
    # einsum rather than a matrix product: the order of additions must not depend on a BLAS library.
    out = flat[0] + np.einsum("tk,kd->td", ramps, bends)
    return out[:, 0] if values.ndim == 1 else out


def quintic(t: Array, nodes: ArrayLike) -> Array:
    """Piecewise quintic through nodes with given velocity and acceleration, constant beyond both ends.

    A segment whose two nodes lie on one parabola reproduces that parabola, so a ballistic flight is exact.

    Parameters
    ----------
    t
        (T,) times in seconds.
    nodes
        (K, 4) rows of time, value, velocity and acceleration, times increasing.

    Returns
    -------
    Array
        (T,).
    """
    nodes = np.asarray(nodes, dtype=np.float64)
    times = nodes[:, 0]
    inner = np.clip(t, times[0], times[-1])
    segment = np.clip(np.searchsorted(times, inner, side="right") - 1, 0, len(nodes) - 2)
    duration = np.diff(times)
    p0, p1 = nodes[:-1, 1], nodes[1:, 1]
    v0, v1 = nodes[:-1, 2] * duration, nodes[1:, 2] * duration
    a0, a1 = nodes[:-1, 3] * duration**2, nodes[1:, 3] * duration**2
    gap = p1 - p0 - v0 - 0.5 * a0
    slope = v1 - v0 - a0
    curve = a1 - a0
    coefficients = np.stack(
        [
            p0,
            v0,
            0.5 * a0,
            10.0 * gap - 4.0 * slope + 0.5 * curve,
            -15.0 * gap + 7.0 * slope - curve,
            6.0 * gap - 3.0 * slope + 0.5 * curve,
        ]
    )
    c = coefficients[:, segment]
    u = (inner - times[segment]) / duration[segment]
    return c[0] + u * (c[1] + u * (c[2] + u * (c[3] + u * (c[4] + u * c[5]))))


def remembered(shape: Callable[[Array], Array]) -> Callable[[Array], Array]:
    """``shape``, computed once for each array of times it is asked for in a row.

    Several channels follow one phase; all of them are evaluated at the same array, which is recognised by identity.
    """
    last: list[Array] = []

    def value(t: Array) -> Array:
        if not last or last[0] is not t:
            last[:] = [t, shape(t)]
        return last[1]

    return value


def bump(u: ArrayLike, skew: float = 0.0) -> Array:
    """A hump of height 1 on ``0 < u < 1`` that starts and ends with zero velocity and acceleration.

    ``skew`` in (-1, 1) moves its peak earlier (negative) or later (positive) than the middle.
    """
    u = np.clip(np.asarray(u, dtype=np.float64), 0.0, 1.0)
    rise, fall = 3.0 + 2.0 * max(skew, 0.0), 3.0 + 2.0 * max(-skew, 0.0)
    peak = rise / (rise + fall)
    return (u / peak) ** rise * ((1.0 - u) / (1.0 - peak)) ** fall


def hop_arc(t: Array, start: float, end: float, ramp: float) -> Array:
    """A parabola of height 1 between ``start`` and ``end`` whose ends are eased over ``ramp`` seconds.

    It is the path of a foot that leaves the floor with the body: the body takes off with a speed, a planted foot has none.
    """
    u = np.clip((t - start) / (end - start), 0.0, 1.0)
    ramp = min(ramp, 0.5 * (end - start))
    return 4.0 * u * (1.0 - u) * smoothstep((t - start) / ramp) * smoothstep((end - t) / ramp)
