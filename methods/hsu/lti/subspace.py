"""Subspace identification of ``A`` and ``C``: PO-MOESP and N4SID over several recordings.

Van Overschee and De Moor (1994), "N4SID: subspace algorithms for the identification of combined deterministic-stochastic
systems"; Verhaegen (1994), "Identification of the deterministic part of MIMO state space models given in innovations form
from input-output data" (past inputs and outputs as instruments). ``B`` and ``D`` are not taken from the same factorisation but
fitted to the simulated output (:mod:`methods.hsu.lti.input_matrices`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from methods.hsu.lti.covariance import covariance_factor
from methods.hsu.lti.records import Records
from methods.hsu.lti.triangular import TriangularFactor

Array = NDArray[np.float64]

#: Hankel rows from which on the factor is taken from the covariance.
_WIDE = 200

#: Singular values of the past below this share of the first count as zero.
_CUT = 1e-11

#: Ways of :meth:`Subspace.transition`.
TRANSITIONS = ("state", "shift")

WEIGHTS = ("moesp", "n4sid")


@dataclass(frozen=True)
class Subspace:
    """What the block Hankel matrices of a record say about the observability matrix.

    Attributes
    ----------
    basis
        (i l, k) orthonormal basis of the column space of the extended observability matrix, strongest direction first.
    singular_values
        (k,) the strengths; a gap after the n-th says that the order is n.
    block_rows
        ``i``.
    columns
        Number of Hankel columns.
    rank
        Numerical rank of the stacked Hankel matrices of inputs and outputs.
    directions
        How many of the strengths are more than rounding. Directions beyond are of no meaning and differ with the last bit of a
        record; a record of period P has fewer than P.
    channels
        ``(m, l)``.
    factor
        Triangular factor of the Hankel matrices, rows and columns in the order future inputs, past inputs, past outputs,
        future outputs; the last rows may be missing.
    """

    basis: Array
    singular_values: Array
    block_rows: int
    columns: int
    rank: int
    directions: int
    channels: tuple[int, int]
    factor: Array

    def rank_needed(self, order: int) -> int:
        """``2 i m + n``: what a record must have for the order to be determined by it."""
        return 2 * self.block_rows * self.channels[0] + order

    @property
    def highest_order(self) -> int:
        """Largest order for which the shift equations are not underdetermined."""
        return min(self.basis.shape[1], (self.block_rows - 1) * self.channels[1])

    def transition(self, order: int, way: str = "state") -> tuple[Array, Array]:
        """``A`` (n, n) and ``C`` (l, n) of a given order.

        Parameters
        ----------
        order
            ``n``, at most :attr:`highest_order`.
        way
            ``shift``: by the shift invariance of the observability matrix. ``state``: by regression of the next state and the
            output on state and input, the states being what the past predicts of the future outputs. All four of these lie in
            the row space of the Hankel matrices, so that the regression is done on the triangular factor and no state
            sequence is formed.
        """
        from scipy.linalg import lstsq

        m, outputs = self.channels
        i = self.block_rows
        gamma = self.basis[:, :order]
        if not order:
            return np.zeros((0, 0)), np.zeros((outputs, 0))
        if way == "state":
            to_state = _predicted(gamma.T, self.factor, i, m, outputs)
            future_u, past_u, past_y, future_y = np.split(self.factor, np.cumsum([i * m, i * m, i * outputs]), axis=1)
            past = np.concatenate([past_u, past_y], axis=1)
            later = np.concatenate([past_u[:, m:], future_u[:, :m], past_y[:, outputs:], future_y[:, :outputs]], axis=1)
            known = np.concatenate([past @ to_state.T, future_u[:, :m]], axis=1)
            wanted = np.concatenate([later @ to_state.T, future_y[:, :outputs]], axis=1)
            solved = lstsq(known, wanted, cond=1e-9, lapack_driver="gelsd")[0][:order].T
            return solved[:order], solved[order:]
        a = lstsq(gamma[:-outputs], gamma[outputs:], cond=1e-9, lapack_driver="gelsd")[0]
        return a, gamma[:outputs].copy()


def usual_block_rows(order: int, outputs: int) -> int:
    """``max(20, ceil(n / l) + 2)``."""
    return max(20, -(-order // outputs) + 2)


def least_block_rows(order: int, outputs: int) -> int:
    """``ceil(n / l) + 1``, with which the shift equations can just be solved; never below 2."""
    return max(2, -(-order // outputs) + 1)


def hankel_columns(lengths: list[int], block_rows: int) -> int:
    """Number of Hankel columns that lie inside one recording."""
    return sum(max(0, length - 2 * block_rows + 1) for length in lengths)


def choose_block_rows(records: Records, order: int, wanted: int | None = None) -> int | None:
    """Block rows for a record: the usual number, fewer if the recordings are too short for it, ``None`` if for any.

    Fewer are taken, down to the least number that the order allows, until there are as many Hankel columns as rows. Where even
    that cannot be had, the least number is used as long as it leaves more columns than the order.
    """
    m, p = records.channels
    least = least_block_rows(order, p)
    usual = usual_block_rows(order, p) if wanted is None else max(wanted, least)
    for rows in range(usual, least - 1, -1):
        if hankel_columns(records.lengths, rows) >= 2 * rows * (m + p):
            break
    else:
        rows = least
    if hankel_columns(records.lengths, rows) <= order:
        return None
    return rows


def identify_subspace(records: Records, block_rows: int, weight: str = "moesp") -> Subspace:
    """Factor the block Hankel matrices of all recordings.

    Columns of every recording stand side by side; none straddles a seam. Only the triangular factor is kept. It is built by
    reflections a batch of columns at a time; of many channels, where that is slow, from the covariance, if that is conditioned
    well enough.

    Parameters
    ----------
    records
        Recordings, channels of about unit size.
    block_rows
        ``i``, block rows of past and of future.
    weight
        ``moesp`` (singular values of ``R32``) or ``n4sid`` (of the oblique projection ``R32 R22^+ W_p``).
    """
    from scipy.linalg import eigh, lapack, svd

    m, p = records.channels
    i = block_rows
    columns = hankel_columns(records.lengths, i)
    wide = 2 * i * (m + p) >= _WIDE
    r = covariance_factor(records, i) if wide else None
    squared = r is not None
    if r is None:
        r = _reflected(records, i)
    future, past = i * m, i * (m + p)
    r32 = r[future : future + past, future + past :].T
    weighted = r32
    if weight == "n4sid":
        weighted = _predicted(np.eye(i * p), r, i, m, p) @ r[: future + past, future : future + past].T
    if squared:
        energies, vectors = eigh(weighted @ weighted.T, check_finite=False)
        left, strengths = vectors[:, ::-1], np.sqrt(np.maximum(energies[::-1], 0.0))
    else:
        left, strengths, _ = svd(_compressed(weighted), full_matrices=False, check_finite=False, overwrite_a=True)

    # The condition number costs nothing beside a factorisation; only a doubtful one is looked at closely.
    if squared or (columns >= len(r) and lapack.dtrcon(r)[0] > 1e-11):
        rank, directions = r.shape[1], len(strengths)
    else:
        values = svd(r, compute_uv=False, check_finite=False)
        rounding = values[0] * len(r) * np.finfo(float).eps
        rank = int(np.sum(values > rounding))
        # The oblique projection has no directions that this has not, but rounding that its inverse has blown up.
        known = strengths if weight == "moesp" else svd(r32, compute_uv=False, check_finite=False)
        directions = int(np.sum(known > rounding))
    return Subspace(left, strengths, i, columns, rank, directions, (m, p), r)


def _predicted(rows: Array, factor: Array, i: int, m: int, p: int) -> Array:
    """``rows R32 R22^+``: what past inputs and outputs say of future outputs.

    The pseudo-inverse is only needed where the past is rank-deficient; what is rounding beside the whole factor counts as zero.
    """
    from scipy.linalg import lapack, pinv, solve_triangular

    past = slice(i * m, i * (2 * m + p))
    triangle, wanted = factor[past, past], rows @ factor[past, past.stop :].T
    largest = float(np.abs(factor).max(initial=0.0))
    rounding = factor.shape[1] * np.finfo(float).eps * largest
    if np.abs(np.diag(triangle)).min() > rounding and lapack.dtrcon(triangle)[0] > _CUT:
        return solve_triangular(triangle, wanted.T, check_finite=False).T
    return wanted @ pinv(triangle.T, atol=rounding, rtol=_CUT)


def _reflected(records: Records, i: int) -> Array:
    """Triangular factor by Householder reflections, a batch of columns at a time."""
    m, p = records.channels
    factor = TriangularFactor(2 * i * (m + p))
    span = factor.batch
    for u, y in zip(records.inputs, records.outputs, strict=True):
        count = len(u) - 2 * i + 1
        for begin in range(0, count, span):
            stop = min(count, begin + span)
            factor.add(_rows(u[begin : stop + 2 * i - 1], y[begin : stop + 2 * i - 1], i))
    return factor.factor()


def _rows(u: Array, y: Array, i: int) -> Array:
    """Hankel columns of one stretch, one a row: future inputs, past inputs, past outputs, future outputs."""
    from numpy.lib.stride_tricks import sliding_window_view

    count = len(u) - 2 * i + 1
    # (count, channels, 2 i) to (count, 2 i, channels): the channels of one frame side by side.
    windows = [sliding_window_view(x, 2 * i, axis=0).transpose(0, 2, 1) for x in (u, y)]
    parts = (windows[0][:, i:], windows[0][:, :i], windows[1][:, :i], windows[1][:, i:])
    return np.concatenate([part.reshape(count, -1) for part in parts], axis=1)


def _compressed(wide: Array) -> Array:
    """A square matrix with the left singular vectors and the singular values of a wide one."""
    from scipy.linalg import lapack

    if wide.shape[1] <= wide.shape[0]:
        return np.array(wide, order="F")
    factored, _, _, _ = lapack.dgeqrf(np.array(wide.T, order="F"), lwork=32 * wide.shape[0], overwrite_a=1)
    return np.asfortranarray(np.triu(factored[: wide.shape[0]]).T)
