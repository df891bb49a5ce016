"""Impulse responses by kernel-regularised least squares (a Gaussian process with the TC kernel).

Chen, Ohlsson and Ljung (2012), "On the estimation of transfer functions, regularizations and Gaussian processes - revisited";
the tuned-correlated kernel ``K_ij = c lam^max(i, j)`` says that a response dies out like ``lam^(k/2)`` and is smooth. The three
hyper-parameters of an output, ``c``, ``lam`` and the noise ``sigma^2``, maximise the marginal likelihood of its record.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from methods.hsu.lti.lags import lag_factor
from methods.hsu.lti.records import Records

Array = NDArray[np.float64]

#: Decay rates tried before the best is polished; per frame.
DECAYS = (0.30, 0.50, 0.65, 0.75, 0.82, 0.87, 0.91, 0.94, 0.96, 0.98)

#: Noise variance over ``c``, relative to the mean squared regressor.
_NOISES = np.logspace(-10.0, 4.0, 57)


@dataclass(frozen=True)
class KernelFir:
    """Estimated impulse responses.

    Attributes
    ----------
    markov
        (taps, l, m) ``D, C B, C A B, …``.
    decay
        (l,) ``lam`` of each output.
    noise
        (l,) estimated standard deviation of the noise of each output.
    """

    markov: Array
    decay: Array
    noise: Array


def usual_taps(records: Records) -> int:
    """Between 40 and 90, three quarters of the longest recording if that lies between; never more than the longest."""
    longest = max(records.lengths)
    return max(1, min(longest, min(90, max(40, (3 * longest) // 4))))


def kernel_fir(records: Records, taps: int | None = None) -> KernelFir:
    """Estimate every impulse response of a system at rest before each recording.

    Frames before a recording count as zero, which is exact for ``x0 = 0``. The regression is reduced to one triangle shared by
    all outputs, and for each decay one singular value decomposition gives the marginal likelihood for every noise level.

    Parameters
    ----------
    records
        Recordings from rest, channels of about unit size.
    taps
        Length of the responses; :func:`usual_taps` if omitted.
    """
    from scipy.optimize import minimize_scalar

    m, p = records.channels
    count = usual_taps(records) if taps is None else max(1, taps)
    triangle = lag_factor(records, count)
    width = m * count
    regressors, targets = triangle[:width, :width], triangle[:width, width:]
    residual = np.sum(triangle[width:, width:] ** 2, axis=0)
    frames = records.frames
    scored = [_Likelihood(regressors, targets, residual, frames, count, m, decay) for decay in DECAYS]
    table = np.stack([likelihood.best() for likelihood in scored])
    markov = np.zeros((count, p, m))
    decay, noise = np.zeros(p), np.zeros(p)
    for o in range(p):
        if not np.any(targets[:, o]):
            decay[o] = DECAYS[0]
            continue
        place = int(np.argmin(table[:, o]))
        chosen = scored[place]
        low, high = DECAYS[max(0, place - 1)], DECAYS[min(len(DECAYS) - 1, place + 1)]
        polished: dict[float, _Likelihood] = {}

        def value(rate: float, o: int = o, polished: dict[float, _Likelihood] = polished) -> float:
            polished[rate] = _Likelihood(regressors, targets[:, [o]], residual[[o]], frames, count, m, float(rate))
            return float(polished[rate].best()[0])

        found = minimize_scalar(value, bounds=(low, high), method="bounded", options={"xatol": 0.01, "maxiter": 6})
        if found.fun < table[place, o]:
            chosen, column = polished[found.x], 0
        else:
            column = o
        markov[:, o], noise[o] = chosen.response(column)
        decay[o] = chosen.decay
    return KernelFir(markov, decay, noise)


class _Likelihood:
    """Negative log marginal likelihood of each output for one decay, over a grid of noise levels.

    With ``Phi K^(1/2) = U S V^T`` the covariance of the record is ``c (U S^2 U^T + gamma I)``; the best ``c`` is known in
    closed form, so that only ``gamma = sigma^2 / c`` is left to search.
    """

    def __init__(
        self, regressors: Array, targets: Array, residual: Array, frames: int, taps: int, inputs: int, decay: float
    ) -> None:
        from scipy.linalg import svd

        self.decay, self.taps, self.inputs, self.frames = decay, taps, inputs, frames
        self._factor = tc_factor(taps, decay)
        shaped = regressors.reshape(len(regressors), taps, inputs).transpose(0, 2, 1) @ self._factor
        left, self.strengths, self._right = svd(
            shaped.reshape(len(regressors), -1), full_matrices=False, check_finite=False
        )
        self.parts = left.T @ targets
        # What of the record no response can explain: outside the regressors, plus rounding of the reduction.
        self.outside = residual + np.maximum(np.sum(targets**2, axis=0) - np.sum(self.parts**2, axis=0), 0.0)
        scale = float(np.mean(self.strengths**2)) or 1.0
        self.noises = _NOISES * scale
        spread = self.strengths[:, None] ** 2 + self.noises
        explained = np.einsum("ko,kg->og", self.parts**2, 1.0 / spread)
        quadratic = explained + self.outside[:, None] / self.noises
        log_determinant = np.sum(np.log(spread), axis=0) + (frames - len(self.strengths)) * np.log(self.noises)
        self.quadratic = np.maximum(quadratic, np.finfo(float).tiny)
        self.values = frames * np.log(self.quadratic / frames) + log_determinant

    def best(self) -> Array:
        """(l,) lowest value of each output."""
        return self.values.min(axis=1)

    def response(self, output: int) -> tuple[Array, float]:
        """(taps, m) posterior mean of one output, and the standard deviation of its noise."""
        place = int(np.argmin(self.values[output]))
        gamma = self.noises[place]
        weights = self.strengths / (self.strengths**2 + gamma) * self.parts[:, output]
        coefficients = (weights @ self._right).reshape(self.inputs, self.taps)
        variance = gamma * self.quadratic[output, place] / self.frames
        return self._factor @ coefficients.T, float(np.sqrt(variance))


def tc_factor(taps: int, decay: float) -> Array:
    """(taps, taps) ``F`` with ``F F^T = decay^max(i, j)``, in closed form.

    A response with that covariance is a sum of independent increments counted from the far end, of variance
    ``decay^k - decay^(k + 1)``.
    """
    rates = decay ** np.arange(1, taps + 1, dtype=np.float64)
    steps = np.sqrt(np.append(rates[:-1] - rates[1:], rates[-1]))
    return np.triu(np.ones((taps, taps))) * steps
