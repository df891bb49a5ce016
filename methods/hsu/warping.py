"""Iterative motion warping: frame-by-frame correspondence of two performances of one action.

Hsu, Pulli and Popovic (2005), "Style translation for human motion"; used by Dong, Aloba, Anthony and Jain (2018) to align
an adult ``u`` with a child ``v``. A time warp ``W`` shared by all channels, and a smooth scale ``a`` and offset ``b`` per
channel, minimise ::

    E = sum over channels  ||W (u a + b) - v||^2                     data
                           + smooth_scale  ||D a||^2                 D: finite differences; their weights are the F and G of
                           + smooth_offset ||D b||^2                 the papers, squared
                           + ridge (||a - 1||^2 + ||b||^2)
        + sum over output frames of the price of the step of W

by block descent from ``a = 1, b = 0``: the time warp with ``a, b`` fixed (:mod:`methods.hsu.time_warp`), then ``a, b`` with the
time warp fixed (:mod:`methods.hsu.space_warp`). Both minimise the same ``E``, which therefore never rises.

The weights weigh squared differences against squared errors: give standardised channels. With small smoothness the scales and
offsets imitate any output and the time warp is arbitrary; as it grows, one affine map per channel is left. The fewer and slower
the channels, the more smoothness it takes to tell timing from shape: three channels of a few slow waves are aligned to about 2
frames at the customary weight of 10 and to 1 at 100.

Time per iteration is that of the band's cells times channels for the time warp and of frames times channels for the space warp.
Memory is a handful of (T, d) arrays, up to 64 MiB of accumulated costs, and for long clips the blocks described in
:mod:`methods.hsu.time_warp`: 0.4 GB beside the inputs for 100,000 frames of 60 channels in a band of 0.02.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmark.errors import ContractError
from methods.hsu.space_warp import SOLVERS, roughness, space_warp
from methods.hsu.time_warp import DISTANCES, Corridor, path_cost, time_warp


@dataclass(frozen=True, eq=False)
class Warp:
    """The correspondence of an input of T frames with an output of T' frames, d channels each.

    Attributes
    ----------
    path
        (T',) int64 input frame of each output frame, non-decreasing from 0 to T - 1.
    scale, offset
        (T, d) space warp of every input frame and channel.
    energy
        Value of the objective after each half-step: time warp, space warp, time warp, … There is none for the start, which has
        no time warp yet. Never rising, except with ``distance="l2"``.
    mean_residual
        Mean squared error of ``apply(u)`` against the output, per frame and channel: the data term alone.
    iterations
        Time warps made.
    converged
        Whether the path or the energy came to rest before the limit on iterations.
    """

    path: NDArray[np.int64]
    scale: NDArray[np.float64]
    offset: NDArray[np.float64]
    energy: NDArray[np.float64]
    mean_residual: float
    iterations: int
    converged: bool

    @property
    def mean_energy(self) -> float:
        """Last energy per output frame and channel: what ranks pairs of unequal length by how well they align.

        The residual alone would favour a pair whose space warp had to bend most.
        """
        return float(self.energy[-1]) / (len(self.path) * self.scale.shape[1])

    def time_warped(self, u: ArrayLike) -> NDArray:
        """``W u``: rows of ``u`` (T, …) at the output's frames (T', …)."""
        return self._rows(u)[self.path]

    def apply(self, u: ArrayLike) -> NDArray[np.float64]:
        """``W (u a + b)``: an input (T, d), or (T,) of one channel, warped in space and time to (T', d)."""
        u = self._rows(np.asarray(u, dtype=np.float64))
        u = u[:, np.newaxis] if u.ndim == 1 else u
        if u.shape != self.scale.shape:
            raise ContractError(f"this warp is of {self.scale.shape} frames and channels, not of {u.shape}")
        return (u * self.scale + self.offset)[self.path]

    def _rows(self, u: ArrayLike) -> NDArray:
        rows = np.asarray(u)
        if rows.ndim == 0 or len(rows) != len(self.scale):
            raise ContractError(
                f"this warp is of {len(self.scale)} input frames, not of an array of shape {rows.shape}"
            )
        return rows


def iterative_motion_warping(
    u: ArrayLike,
    v: ArrayLike,
    *,
    smooth_scale: float = 10.0,
    smooth_offset: float = 10.0,
    band: float | None = 0.2,
    max_skip: int = 3,
    difference_order: int = 1,
    step_penalty: float = 0.03,
    ridge: float = 1e-6,
    iterations: int = 100,
    tolerance: float = 1e-6,
    distance: str = "squared",
    solver: str = "banded",
) -> Warp:
    """Align ``u`` with ``v`` in time and space.

    Parameters
    ----------
    u, v
        (T, d) input and (T', d) output, or (T,) and (T',) of one channel; standardised units.
    smooth_scale, smooth_offset
        Weights lambda of the squared differences of scales and offsets, at least 0.
    band
        How far the path may be from the line between the corners, as a fraction of T; ``None`` for no limit.
    max_skip
        Largest advance of the input per output frame. With 1, frames are only repeated, as by Hsu et al.; needs T' >= T.
    difference_order
        Order of the differences that are kept small: 1 prefers constant scales and offsets, 2 prefers linear ones.
    step_penalty
        Price of advancing by ``k`` input frames is ``step_penalty * |k - 1|`` times the total variance of ``v`` (the mean
        squared distance of its frames from their mean, about d in standardised units). 0 for the papers' objective.
    ridge
        Weight of the pull to scale 1 and offset 0, above 0. The same whatever the time warp: were it tied to the matrix of the
        space warp, the half-steps would minimise different objectives.
    iterations
        Limit on the number of time warps.
    tolerance
        Ends when an iteration lowers the energy by no more than this fraction, or leaves the path as it was.
    distance
        ``squared``, or ``l2`` for the plain Euclidean distance that Dong et al. (2018) print for their time warp. It weighs
        large errors less than the objective does, so the energy may rise and the iteration may go round in circles until its
        limit.
    solver
        ``banded``, or ``dense`` for the LU factorisation of the matrix as printed (with its upper right block corrected). The
        same result for thousands of times the time at 2000 frames.

    Returns
    -------
    Warp

    Raises
    ------
    ContractError
        For arrays that are empty, not finite or do not fit each other, for settings out of range, and where no path satisfies
        ``band`` and ``max_skip``.
    """
    u, v = _channels("u", u), _channels("v", v)
    if u.shape[1] != v.shape[1]:
        raise ContractError(f"u has {u.shape[1]} channels and v {v.shape[1]}: they must agree")
    _check(smooth_scale, smooth_offset, band, max_skip, difference_order, step_penalty, ridge, iterations, tolerance)
    for name, choice, known in (("distance", distance, DISTANCES), ("solver", solver, SOLVERS)):
        if choice not in known:
            raise ContractError(f"{name} must be {' or '.join(known)}, not {choice!r}")
    corridor = Corridor.between(len(u), len(v), band=band, max_skip=max_skip)
    penalties = step_penalty * float(v.var(axis=0).sum()) * np.abs(np.arange(max_skip + 1.0) - 1.0)

    def objective(path: NDArray[np.int64]) -> float:
        return (
            path_cost(u * scale + offset, v, path, penalties=penalties)
            + smooth_scale * roughness(scale, difference_order)
            + smooth_offset * roughness(offset, difference_order)
            + ridge * (float(np.vdot(scale - 1.0, scale - 1.0)) + float(np.vdot(offset, offset)))
        )

    def warp_in_time() -> NDArray[np.int64]:
        return time_warp(u * scale + offset, v, corridor, penalties=penalties, distance=distance)

    scale, offset = np.ones_like(u), np.zeros_like(u)
    path = warp_in_time()
    energy = [objective(path)]
    converged = False
    for done in range(1, iterations + 1):
        scale, offset = space_warp(
            u,
            v,
            path,
            smooth_scale=smooth_scale,
            smooth_offset=smooth_offset,
            ridge=ridge,
            difference_order=difference_order,
            solver=solver,
        )
        energy.append(objective(path))
        converged = done > 1 and abs(energy[-3] - energy[-1]) <= tolerance * energy[-3]
        if converged or done == iterations:
            break
        found = warp_in_time()
        reached = objective(found)
        # Among paths that cost the same to rounding the one at hand stays, or ties would keep the iteration going.
        if distance == "squared" and reached >= energy[-1]:
            found, reached = path, energy[-1]
        energy.append(reached)
        converged = np.array_equal(found, path)
        if converged:
            break
        path = found
    for array in (path, scale, offset):
        array.flags.writeable = False
    residual = path_cost(u * scale + offset, v, path) / v.size
    return Warp(path, scale, offset, np.array(energy), residual, (len(energy) + 1) // 2, converged)


def _channels(name: str, values: ArrayLike) -> NDArray[np.float64]:
    array = np.asarray(values, dtype=np.float64, order="C")
    array = array[:, np.newaxis] if array.ndim == 1 else array
    if array.ndim != 2 or array.size == 0:
        raise ContractError(
            f"{name} must be a non-empty array of frames and channels, not one of shape {np.shape(values)}"
        )
    if not np.isfinite(array).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise ContractError(
            f"{name} holds {array[where]} at frame {where[0]}, channel {where[1]}: warping needs finite values"
        )
    return array


def _check(
    smooth_scale: float,
    smooth_offset: float,
    band: float | None,
    max_skip: int,
    difference_order: int,
    step_penalty: float,
    ridge: float,
    iterations: int,
    tolerance: float,
) -> None:
    at_least_zero = {
        "smooth_scale": smooth_scale,
        "smooth_offset": smooth_offset,
        "band": 0.0 if band is None else band,
        "step_penalty": step_penalty,
        "tolerance": tolerance,
    }
    for name, value in at_least_zero.items():
        if not (math.isfinite(value) and value >= 0.0):
            raise ContractError(f"{name} must be finite and at least 0, not {value}")
    if not (math.isfinite(ridge) and ridge > 0.0):
        raise ContractError(f"ridge must be finite and above 0, or the space warp is not unique; not {ridge}")
    for name, count in {
        "max_skip": max_skip,
        "difference_order": difference_order,
        "iterations": iterations,
    }.items():
        if count != int(count) or count < 1:
            raise ContractError(f"{name} must be a whole number of at least 1, not {count}")
