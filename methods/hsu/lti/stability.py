"""Bringing a transition matrix inside a circle, only when it is outside."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Energy of the response to a unit state beyond which no recording can have meant it.
_WILD = 1e10

#: Ways of :func:`stabilised`.
WAYS = ("clip", "scale")


def longest_radius(fps: float = 30.0, tau: float = 2.0) -> float:
    """``exp(-1 / (fps tau))``: the radius of a pole whose response falls to 1/e in ``tau`` seconds; .9835 by default."""
    return math.exp(-1.0 / (fps * tau))


def radius(a: Array) -> float:
    """Spectral radius; infinite if the matrix is not finite."""
    if not np.isfinite(a).all():
        return math.inf
    return float(np.abs(np.linalg.eigvals(a)).max(initial=0.0))


def stabilised(a: Array, rho_max: float, way: str) -> Array:
    """``a`` with no eigenvalue beyond ``rho_max``; ``a`` itself if it has none.

    Parameters
    ----------
    a
        (n, n) transition matrix.
    rho_max
        Radius of the circle, below 1.
    way
        ``scale``: the whole matrix by ``rho_max`` over its spectral radius, which shortens every mode. ``clip``: in the real
        Schur form only the diagonal blocks outside the circle, each scaled onto it; the other modes keep their poles, and the
        angles stay. Where rounding leaves a clipped matrix outside, it is scaled by the last bit.
    """
    from scipy.linalg import schur

    found = radius(a)
    if found <= rho_max:
        return a
    if not math.isfinite(found):
        return np.zeros_like(a)
    if way == "clip":
        form, vectors = schur(a, output="real")
        block = 0
        while block < len(form):
            size = 2 if block + 1 < len(form) and form[block + 1, block] != 0.0 else 1
            part = form[block : block + size, block : block + size]
            modulus = float(np.abs(np.linalg.eigvals(part)).max())
            if modulus > rho_max:
                part *= rho_max / modulus
            block += size
        a = vectors @ form @ vectors.T
    # Eigenvalues on the circle are computed with an error of their own; a hair of room keeps every later check content.
    shrink = 1.0
    while (found := radius(a * shrink)) > rho_max:
        shrink *= rho_max / found * (1.0 - 1e-12)
    return a * shrink


def observability_gramian(a: Array, c: Array) -> Array:
    """(n, n) ``sum_k (A^T)^k C^T C A^k`` of a stable pair, by doubling; not finite if that overflows."""
    gramian = c.T @ c
    power = a
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(64):
            more = power.T @ gramian @ power
            gramian = gramian + more
            if not np.isfinite(gramian).all() or np.abs(more).max() <= 1e-16 * np.abs(gramian).max():
                break
            power = power @ power
        return 0.5 * (gramian + gramian.T)


def calmed(a: Array, c: Array) -> Array:
    """``a``, halved until the response of no state grows beyond all measure before it dies out.

    A matrix may have all its poles inside the circle and still raise states by dozens of orders of magnitude for a while: what
    a record without information gives. ``c`` (l, n) is of about unit size; ``a`` itself comes back if there is nothing to do.
    """
    while len(a) and not np.trace(observability_gramian(a, c)) < _WILD:
        a = 0.5 * a
    return a


def output_normal(a: Array, c: Array) -> tuple[Array, Array]:
    """The pair in the basis in which the observability gramian is the identity.

    There the energy of the response to an impulse is the squared size of ``B``, whatever basis the pair came in: columns of the
    fit for ``B`` are of one size, and a ridge on ``B`` has a meaning of its own. A pair that is not observable enough for it
    comes back as it was.
    """
    from scipy.linalg import LinAlgError, cholesky, solve_triangular

    if not len(a):
        return a, c
    gramian = observability_gramian(a, c)
    if not np.isfinite(gramian).all():
        return a, c
    try:
        upper = cholesky(gramian)
    except LinAlgError:
        return a, c
    sizes = np.abs(np.diag(upper))
    if sizes.min() < 1e-7 * sizes.max():
        return a, c
    # z = U x with W = U^T U.
    moved = solve_triangular(upper, (upper @ a).T, trans="T").T
    return moved, solve_triangular(upper, c.T, trans="T").T
