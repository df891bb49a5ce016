"""Output-error refinement: the simulated error itself, minimised over poles, ``B``, ``C`` and ``D``.

The state is brought to modal form, one 2 x 2 block ``r [[cos, sin], [-sin, cos]]`` per pair of complex poles and one number per
real pole, and the moduli are ``rho_max`` times a squashing function of what is searched over, so that no step can leave the
circle. Gradients are exact: one simulation forward, one of the adjoint system backward (Ljung 1999, section 10.3, for the
criterion; the adjoint recurrence is ``p[t-1] = A^T p[t] + C^T e[t]``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from methods.hsu.lti.order import Split, judge
from methods.hsu.lti.records import Records
from methods.hsu.lti.scan import propagate
from methods.hsu.lti.state_space import StateSpace

Array = NDArray[np.float64]

#: Condition number of the modal basis beyond which the modal form is not trusted.
_WORST_BASIS = 1e8

#: Frames that are simulated together.
_ROOM = 50_000

#: Steps between looks at the held-out part.
_LOOK = 10


@dataclass(frozen=True)
class Refinement:
    """Result of :func:`refine`.

    Attributes
    ----------
    model
        The best model on the held-out part; the start if nothing was better.
    accepted
        Whether it is another one than the start.
    train_before, train_after
        Sum of squared simulated errors on the training part, at the start and where the search ended.
    """

    model: StateSpace
    accepted: bool
    train_before: float
    train_after: float


class IllConditionedError(ArithmeticError):
    """A model whose poles are too close together to be moved one by one."""


class OutputError:
    """Half the sum of squared simulated errors as a function of the parameters, with its gradient.

    Parameters
    ----------
    model
        Start, stable and with distinct poles.
    records
        Recordings from rest.
    rho_max
        Radius that no pole leaves.

    Raises
    ------
    IllConditionedError
        If the modal basis of ``model`` is too badly conditioned.
    """

    def __init__(self, model: StateSpace, records: Records, rho_max: float) -> None:
        self.rho_max = rho_max
        self._shape = (model.order, model.inputs, model.outputs)
        self._batches = list(records.batches(room=_ROOM))
        poles, basis = _modal_basis(model)
        self._pairs = int(np.sum(poles.imag > 0.0))
        self._real = model.order - 2 * self._pairs
        modal = model.transformed(basis)
        # States of one size: each block's part of the input matrix gets the size of its part of the output matrix.
        b, c = np.array(modal.B), np.array(modal.C)
        for block in self._blocks():
            into, out = np.linalg.norm(b[block]), np.linalg.norm(c[:, block])
            if into > 0.0 and out > 0.0:
                ratio = np.sqrt(out / into)
                b[block] *= ratio
                c[:, block] /= ratio
        share = np.clip(np.abs(poles) / rho_max, 1e-6, 1.0 - 1e-6)
        complex_share, real_share = share[: self._pairs], share[self._pairs :] * np.sign(poles[self._pairs :].real)
        self.start = np.concatenate(
            [
                np.log(complex_share / (1.0 - complex_share)),
                np.angle(poles[: self._pairs]),
                np.arctanh(real_share),
                b.ravel(),
                c.ravel(),
                model.D.ravel(),
            ]
        )

    def _blocks(self) -> list[slice]:
        pairs = [slice(2 * k, 2 * k + 2) for k in range(self._pairs)]
        return pairs + [slice(k, k + 1) for k in range(2 * self._pairs, self._shape[0])]

    def _unpack(self, parameters: Array) -> tuple[Array, Array, Array, Array, Array, Array, Array]:
        n, m, p = self._shape
        sizes = np.cumsum([self._pairs, self._pairs, self._real, n * m, p * n])
        logit, angle, squashed, b, c, d = np.split(parameters, sizes)
        return (
            logit,
            angle,
            squashed,
            self._a(logit, angle, squashed),
            b.reshape(n, m),
            c.reshape(p, n),
            d.reshape(p, m),
        )

    def _a(self, logit: Array, angle: Array, squashed: Array) -> Array:
        n = self._shape[0]
        a = np.zeros((n, n))
        modulus = self.rho_max * _sigmoid(logit)
        even = 2 * np.arange(self._pairs)
        a[even, even] = a[even + 1, even + 1] = modulus * np.cos(angle)
        a[even, even + 1] = modulus * np.sin(angle)
        a[even + 1, even] = -a[even, even + 1]
        rest = np.arange(2 * self._pairs, n)
        a[rest, rest] = self.rho_max * np.tanh(squashed)
        return a

    def model(self, parameters: Array) -> StateSpace:
        """The model of a parameter vector."""
        *_, a, b, c, d = self._unpack(parameters)
        return StateSpace(a, b, c, d)

    def __call__(self, parameters: Array) -> tuple[float, Array]:
        """Value and gradient."""
        logit, angle, squashed, a, b, c, d = self._unpack(parameters)
        value = 0.0
        of_a, of_b, of_c, of_d = np.zeros_like(a), np.zeros_like(b), np.zeros_like(c), np.zeros_like(d)
        for u, y, real in self._batches:
            states, _ = propagate(a, u @ b.T)
            error = (states @ c.T + u @ d.T - y) * real[..., None]
            value += 0.5 * float(np.vdot(error, error))
            # Backwards: after[t] is the gradient with respect to the state at t + 1.
            backward, _ = propagate(a.T, (error @ c)[:, ::-1])
            after = backward[:, ::-1]
            flat_after, flat_error = after.reshape(-1, len(a)), error.reshape(-1, len(c))
            flat_states, flat_u = states.reshape(-1, len(a)), u.reshape(-1, u.shape[-1])
            of_a += flat_after.T @ flat_states
            of_b += flat_after.T @ flat_u
            of_c += flat_error.T @ flat_states
            of_d += flat_error.T @ flat_u
        even = 2 * np.arange(self._pairs)
        along = of_a[even, even] + of_a[even + 1, even + 1]
        across = of_a[even, even + 1] - of_a[even + 1, even]
        share = _sigmoid(logit)
        of_modulus = along * np.cos(angle) + across * np.sin(angle)
        of_angle = self.rho_max * share * (across * np.cos(angle) - along * np.sin(angle))
        rest = np.arange(2 * self._pairs, len(a))
        gradient = np.concatenate(
            [
                of_modulus * self.rho_max * share * (1.0 - share),
                of_angle,
                of_a[rest, rest] * self.rho_max * (1.0 - np.tanh(squashed) ** 2),
                of_b.ravel(),
                of_c.ravel(),
                of_d.ravel(),
            ]
        )
        return value, gradient


def refine(model: StateSpace, split: Split, rho_max: float, *, iterations: int = 200) -> Refinement:
    """Search from a model for one with a smaller simulated error; take it only if it does better on what was held out.

    Every tenth iterate is simulated on the held-out part, and the best of them, the start included, is returned: the search is
    so stopped where it begins to fit the noise. Where nothing is held out the start is kept.

    Parameters
    ----------
    model
        Start, with a spectral radius of at most ``rho_max``.
    split
        What to fit and what to judge by; channels of about unit size.
    rho_max
        Radius that no pole leaves.
    iterations
        Iterations of L-BFGS.
    """
    from scipy.optimize import minimize

    if not split.held_out or not model.order:
        return Refinement(model, False, float("nan"), float("nan"))
    try:
        objective = OutputError(model, split.train, rho_max)
    except IllConditionedError:
        return Refinement(model, False, float("nan"), float("nan"))
    before, _ = objective(objective.start)
    size = max(before, np.finfo(float).tiny)
    best, best_score = model, judge(model, split)
    accepted = False
    seen = 0

    def look(xk: Array) -> None:
        nonlocal seen
        seen += 1
        if seen % _LOOK == 0:
            consider(xk)

    def consider(parameters: Array) -> None:
        nonlocal best, best_score, accepted
        candidate = objective.model(parameters)
        score = judge(candidate, split)
        if score < best_score and candidate.spectral_radius <= rho_max:
            best, best_score, accepted = candidate, score, True

    def scaled(parameters: Array) -> tuple[float, Array]:
        value, gradient = objective(parameters)
        return value / size, gradient / size

    found = minimize(
        scaled,
        objective.start,
        jac=True,
        method="L-BFGS-B",
        callback=look,
        options={"maxiter": iterations, "maxcor": 30, "ftol": 1e-9, "gtol": 1e-9},
    )
    if np.isfinite(found.x).all():
        consider(found.x)
    return Refinement(best, accepted, 2.0 * before, 2.0 * float(found.fun) * size)


def _sigmoid(values: Array) -> Array:
    return 0.5 * (1.0 + np.tanh(0.5 * values))


def _modal_basis(model: StateSpace) -> tuple[NDArray[np.complex128], Array]:
    """Poles, one of each complex pair first, and the real basis in which ``A`` is block diagonal."""
    values, vectors = np.linalg.eig(model.A)
    upper, real = np.flatnonzero(values.imag > 0.0), np.flatnonzero(values.imag == 0.0)
    columns = []
    for index in upper:
        columns += [vectors[:, index].real, vectors[:, index].imag]
    columns += [vectors[:, index].real for index in real]
    basis = np.stack(columns, axis=1)
    basis = basis / np.linalg.norm(basis, axis=0)
    # A pair of columns is scaled by one number, or the block would not keep its form.
    for pair in range(len(upper)):
        both = np.concatenate([vectors[:, upper[pair]].real, vectors[:, upper[pair]].imag])
        basis[:, 2 * pair : 2 * pair + 2] = both.reshape(2, -1).T / np.linalg.norm(both)
    if np.linalg.cond(basis) > _WORST_BASIS:
        raise IllConditionedError("the modal basis is too badly conditioned")
    poles = np.concatenate([values[upper], values[real]])
    return poles.astype(np.complex128), basis
