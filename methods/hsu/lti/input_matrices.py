"""``B`` and ``D`` of a model whose ``A`` and ``C`` are known, by least squares on its simulated output.

From rest the output is linear in ``B`` and ``D``. With ``r_oj[t] = sum_k (c_o A^(k-1)) u_j[t-k]``, n numbers per frame,
output ``o`` is ``sum_j r_oj[t] . b_j + d_o . u[t]``; and ``r_oj`` obeys the recurrence of the transposed system,
``r[t+1] = A^T r[t] + c_o u_j[t]``. So ``l m`` filters give every column of the regression, not ``n m``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from methods.hsu.lti.lags import lag_factor
from methods.hsu.lti.records import Records
from methods.hsu.lti.scan import propagate
from methods.hsu.lti.triangular import TriangularFactor

Array = NDArray[np.float64]

#: Floats that the filter outputs of one batch may take.
_ROOM = 200_000

#: Padded frames of a batch of the iteration, its most iterations, and the accuracy at which it stops.
_PADDED, _ITERATIONS, _CLOSE = 50_000, 200, 1e-7

#: Relative size below which a direction counts as not excited at all.
_CUT = 1e-13


#: Lagged input columns up to which recordings may be reduced to their lag factor.
_LAGS = 600

#: Operations from which on the regression is solved by iteration instead.
_MANY = 4e9


class InputProblems:
    """The regressions of one record for many pairs ``A``, ``C``, each in the form that suits its size.

    Parameters
    ----------
    records
        Recordings from rest.
    many
        Whether there will be so many pairs that it pays to reduce short recordings to their lag factor first.
    """

    def __init__(self, records: Records, *, many: bool = False) -> None:
        self._records = records
        taps = max(records.lengths)
        width = taps * records.channels[0]
        self._lags = lag_factor(records, taps) if many and width <= _LAGS and width < records.frames else None

    def of(self, a: Array, c: Array) -> InputProblem | IteratedProblem:
        """The regression for a stable pair (n, n) and (l, n).

        Best in the basis of :func:`methods.hsu.lti.stability.output_normal`.
        """
        if self._lags is not None:
            return lagged_problem(self._lags, self._records.channels[0], a, c)
        return input_problem(self._records, a, c)


def input_problem(records: Records, a: Array, c: Array) -> InputProblem | IteratedProblem:
    """The regression for one pair; see :meth:`InputProblems.of`."""
    m, p = records.channels
    if 2.0 * records.frames * p * (m * (len(a) + 1)) ** 2 > _MANY:
        return IteratedProblem(records, a, c)
    return reduced_problem(records, a, c)


@dataclass(frozen=True)
class IteratedProblem:
    """The same problem for many channels, where forming its columns costs more than simulating a few dozen times.

    LSMR (Fong and Saunders 2011) on the operator itself: forward a simulation, backward the adjoint one. With inputs made white
    and the pair in output-normal form the columns are nearly orthogonal, and the number of iterations hardly depends on the
    size.
    """

    records: Records
    a: Array
    c: Array

    def solve(self, ridge: float = 0.0) -> tuple[Array, Array]:
        """``B`` (n, m) and ``D`` (l, m), to about six digits of the best fit.

        Parameters
        ----------
        ridge
            As in :meth:`InputProblem.solve`, the mean squared column being that of white inputs of the same size.
        """
        from scipy.linalg import LinAlgError, cholesky, solve_triangular
        from scipy.sparse.linalg import LinearOperator, lsmr

        m, p = self.records.channels
        n = len(self.a)
        gram = np.sum([u.T @ u for u in self.records.inputs], axis=0)
        try:
            white = cholesky(gram + 1e-8 * np.trace(gram) / m * np.eye(m))
        except LinAlgError:
            white = np.eye(m)
        batches = [
            (solve_triangular(white, u.reshape(-1, m).T, trans="T").T.reshape(u.shape), y, real[..., None])
            for u, y, real in self.records.batches(_PADDED)
        ]
        penalty = np.sqrt(ridge * np.trace(gram) / m)

        def forward(unknowns: Array) -> Array:
            b, d = np.split(unknowns.ravel(), [n * m])
            b, d = b.reshape(n, m), d.reshape(p, m)
            parts = [((propagate(self.a, u @ b.T)[0] @ self.c.T + u @ d.T) * real).ravel() for u, _, real in batches]
            return np.concatenate([*parts, penalty * _unwhitened(b, white).ravel()])

        def backward(residual: Array) -> Array:
            of_b, of_d = np.zeros((n, m)), np.zeros((p, m))
            place = 0
            for u, y, real in batches:
                error = residual[place : place + y.size].reshape(y.shape) * real
                place += y.size
                after = propagate(self.a.T, (error @ self.c)[:, ::-1])[0][:, ::-1]
                of_b += after.reshape(-1, n).T @ u.reshape(-1, m)
                of_d += error.reshape(-1, p).T @ u.reshape(-1, m)
            last = residual[place:].reshape(n, m)
            of_b += penalty * solve_triangular(white, last.T, trans="T").T
            return np.concatenate([of_b.ravel(), of_d.ravel()])

        target = np.concatenate([*(y.ravel() for _, y, _ in batches), np.zeros(n * m)])
        operator = LinearOperator((len(target), n * m + p * m), matvec=forward, rmatvec=backward, dtype=np.float64)
        found = lsmr(operator, target, atol=_CLOSE, btol=_CLOSE, maxiter=_ITERATIONS)[0]
        b, d = np.split(found, [n * m])
        return _unwhitened(b.reshape(n, m), white), _unwhitened(d.reshape(p, m), white)


def _unwhitened(b: Array, white: Array) -> Array:
    """``B`` for inputs as they are, from that for ``u white^-1``."""
    from scipy.linalg import solve_triangular

    return solve_triangular(white, b.T).T


@dataclass(frozen=True)
class InputProblem:
    """The least-squares problem for ``B`` and ``D``, reduced to triangular form.

    Attributes
    ----------
    factor, target
        (q, n m) and (q,): the least-squares problem that is left for ``B`` (its columns one after the other) once ``D`` is
        eliminated; ``q <= n m + 1``.
    direct, coupling, rest
        (l, m, m), (l, m, n m) and (l, m): for output ``o``, ``direct d_o = rest - coupling b``.
    order
        ``n``.
    """

    factor: Array
    target: Array
    direct: Array
    coupling: Array
    rest: Array
    order: int

    def solve(self, ridge: float = 0.0) -> tuple[Array, Array]:
        """``B`` (n, m) and ``D`` (l, m).

        Parameters
        ----------
        ridge
            Penalty on the squared size of ``B`` as a share of the mean squared column of the regression. It enters as extra
            rows, not through normal equations.
        """
        from scipy.linalg import lstsq, qr, solve_triangular

        outputs, inputs = self.rest.shape
        unknowns = self.order * inputs
        solution = np.zeros(unknowns)
        if unknowns:
            factor, target = self.factor, self.target
            penalty = ridge * float(np.sum(factor**2)) / unknowns
            if penalty > 0.0:
                extended = np.concatenate([factor, np.sqrt(penalty) * np.eye(unknowns)])
                joined = np.concatenate([extended, np.append(target, np.zeros(unknowns))[:, None]], axis=1)
                reduced = qr(joined, mode="r", check_finite=False)[0]
                factor, target = reduced[:unknowns, :unknowns], reduced[:unknowns, unknowns]
            sizes = np.abs(np.diag(factor))
            if len(factor) >= unknowns and sizes.min() > 1e-10 * sizes.max():
                solution = solve_triangular(factor[:unknowns], target[:unknowns], check_finite=False)
            else:
                solution = lstsq(factor, target, cond=_CUT, lapack_driver="gelsd")[0]
        d = np.stack(
            [
                lstsq(self.direct[o], self.rest[o] - self.coupling[o] @ solution, cond=_CUT, lapack_driver="gelsd")[0]
                for o in range(outputs)
            ]
        )
        return solution.reshape(inputs, self.order).T, d


def reduced_problem(records: Records, a: Array, c: Array) -> InputProblem:
    """Reduce the regression to triangular form; memory does not grow with the length of the record.

    Each output has a triangular factor of its own over ``(u, regressors, y)``, inputs first: the rows below those of ``u``
    are the problem with ``D`` eliminated, and those of all outputs, stacked and factored again, are the problem for ``B``.

    Parameters
    ----------
    records
        Recordings from rest.
    a, c
        (n, n) and (l, n), ``a`` stable; best in the basis of :func:`methods.hsu.lti.stability.output_normal`.
    """
    m, p = records.channels
    n = len(a)
    factors = [TriangularFactor(m + n * m + 1) for _ in range(p)]
    per_frame = max(1, m * p * n)
    for u, y, real in records.batches(max(256, _ROOM // per_frame)):
        state = np.zeros((len(u) * m * p, n))
        span = max(256, _ROOM // (per_frame * len(u)))
        for begin in range(0, u.shape[1], span):
            piece = slice(begin, begin + span)
            part, kept = u[:, piece], real[:, piece]
            # (E, m, l, T, n): each input channel enters through the row of C of each output.
            drive = part.transpose(0, 2, 1)[:, :, None, :, None] * c[None, None, :, None, :]
            states, state = propagate(a.T, drive.reshape(len(state), part.shape[1], n), state)
            columns = states.reshape(len(u), m, p, part.shape[1], n).transpose(2, 0, 3, 1, 4)
            for o, factor in enumerate(factors):
                regressors = columns[o][kept].reshape(int(kept.sum()), m * n)
                factor.add(np.concatenate([part[kept], regressors, y[:, piece, o][kept][:, None]], axis=1))
    return _eliminated(np.stack([factor.factor() for factor in factors]), m, n)


def lagged_problem(lags: Array, inputs: int, a: Array, c: Array) -> InputProblem:
    """The same from the lag factor of a record: its rows stand for all frames, and filters become one product.

    Parameters
    ----------
    lags
        Factor of :func:`methods.hsu.lti.lags.lag_factor` with as many taps as the longest recording has frames.
    inputs
        ``m``.
    a, c
        (n, n) and (l, n), ``a`` stable.
    """
    p, n = c.shape
    rows = len(lags) - p
    taps = rows // inputs
    reach = np.empty((taps - 1, p, n))
    current = c
    for lag in range(taps - 1):
        reach[lag] = current
        current = current @ a
    delayed = lags[:rows, inputs:rows].reshape(rows, taps - 1, inputs).transpose(0, 2, 1)
    columns = delayed.reshape(rows * inputs, taps - 1) @ reach.reshape(taps - 1, p * n)
    columns = columns.reshape(rows, inputs, p, n).transpose(2, 0, 1, 3).reshape(p, rows, inputs * n)
    triangles = []
    for o in range(p):
        factor = TriangularFactor(inputs + n * inputs + 1)
        factor.add(np.concatenate([lags[:rows, :inputs], columns[o], lags[:rows, rows + o, None]], axis=1))
        triangles.append(factor.factor())
    return _eliminated(np.stack(triangles), inputs, n)


def _eliminated(triangles: Array, m: int, n: int) -> InputProblem:
    """The problem for ``B`` that is left of the factors of all outputs over ``(u, regressors, y)``."""
    below = TriangularFactor(n * m + 1)
    for triangle in triangles:
        below.add(triangle[m:, m:])
    reduced = below.factor()
    return InputProblem(
        factor=reduced[: n * m, : n * m],
        target=reduced[: n * m, -1],
        direct=triangles[:, :m, :m],
        coupling=triangles[:, :m, m:-1],
        rest=triangles[:, :m, -1],
        order=n,
    )
