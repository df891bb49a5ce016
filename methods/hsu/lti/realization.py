"""State-space models from impulse responses: Ho-Kalman, with the shift padded by zeros.

Ho and Kalman (1966), "Effective construction of linear state-variable models from input/output functions"; Kung (1978) takes
the singular value decomposition, which makes it the eigensystem realisation algorithm. With zeros beyond the last tap the
Hankel matrix is that of a finite impulse response, whose balanced truncations are all stable.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from methods.hsu.lti.state_space import StateSpace

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Realization:
    """A balanced realisation that any number of its leading states may be kept of.

    Attributes
    ----------
    singular_values
        (k,) Hankel singular values, falling.
    a, b, c, d
        The realisation with all ``k`` states.
    """

    singular_values: Array
    a: Array
    b: Array
    c: Array
    d: Array

    def model(self, order: int) -> StateSpace:
        """The first ``order`` states."""
        n = min(order, len(self.a))
        return StateSpace(self.a[:n, :n], self.b[:n], self.c[:, :n], self.d)


def effective_order(singular_values: Array, cap: int, threshold: float = 1e-6) -> int:
    """Number of singular values above ``threshold`` times the first, at most ``cap``."""
    if not len(singular_values) or singular_values[0] <= 0.0:
        return 0
    return min(cap, int(np.sum(singular_values > threshold * singular_values[0])))


def realize(markov: Array, cap: int) -> Realization:
    """Balanced realisation of an impulse response that is zero after its last tap.

    Parameters
    ----------
    markov
        (taps, l, m) ``D`` first.
    cap
        States to keep at most.
    """
    from scipy.linalg import svd

    taps, p, m = markov.shape
    span = taps - 1
    if span < 1 or cap < 1:
        return Realization(np.zeros(0), np.zeros((0, 0)), np.zeros((0, m)), np.zeros((p, 0)), markov[0])
    lags = np.arange(span)[:, None] + np.arange(span)[None]
    padded = np.concatenate([markov[1:], np.zeros((span, p, m))])
    hankel = padded[lags].transpose(0, 2, 1, 3).reshape(span * p, span * m)
    shifted = padded[lags + 1].transpose(0, 2, 1, 3).reshape(span * p, span * m)
    left, strengths, right = svd(hankel, full_matrices=False, check_finite=False)
    kept = effective_order(strengths, min(cap, len(strengths)), threshold=1e-13)
    roots = np.sqrt(strengths[:kept])
    observe, control = left[:, :kept], right[:kept]
    a = (observe.T @ shifted @ control.T) / np.outer(roots, roots)
    return Realization(strengths, a, roots[:, None] * control[:, :m], observe[:p] * roots, markov[0])
