"""Sphericity of repeated measures: Mauchly's test and the corrections of the degrees of freedom."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray


class Sphericity(NamedTuple):
    """Mauchly's test and three estimates of epsilon.

    ``W``, ``chi2`` and ``p`` are NaN where the test is undefined: with one contrast (sphericity then holds trivially and
    every epsilon is 1) or with fewer error degrees of freedom than contrasts.
    """

    W: float
    chi2: float
    df: int
    p: float
    eps_gg: float
    eps_hf: float
    eps_lb: float


def helmert(levels: int) -> NDArray[np.float64]:
    """Orthonormal Helmert contrasts, (levels, levels - 1): columns of unit length that sum to 0."""
    matrix = np.zeros((levels, levels - 1))
    for column in range(levels - 1):
        matrix[: column + 1, column] = -1.0
        matrix[column + 1, column] = column + 1.0
    return matrix / np.linalg.norm(matrix, axis=0)


def pooled_covariance(values: NDArray[np.float64], groups: NDArray[np.intp] | None = None) -> NDArray[np.float64]:
    """Covariance (k, k) of the columns of ``values`` (n, k), pooled within groups when group codes (n,) are given.

    The divisor is n minus the number of groups.
    """
    codes = np.zeros(len(values), dtype=np.intp) if groups is None else groups
    count = int(codes.max()) + 1
    residual = values.copy()
    for group in range(count):
        residual[codes == group] -= values[codes == group].mean(axis=0)
    return residual.T @ residual / (len(values) - count)


def sphericity_of_contrasts(covariance: NDArray[np.float64], nu: int) -> Sphericity:
    """Mauchly's test and epsilons from the covariance T (p, p) of orthonormal contrasts with ``nu`` degrees of freedom.

    Notes
    -----
    With ``p`` contrasts: ``W = det T / (tr T / p)^p``; ``chi2 = -(nu - (2 p^2 + p + 2) / (6 p)) ln W`` on
    ``p (p + 1) / 2 - 1`` degrees of freedom (Mauchly, Annals of Mathematical Statistics 11, 1940; Anderson,
    *An Introduction to Multivariate Statistical Analysis*, section 10.7). ``eps_gg = (tr T)^2 / (p tr T^2)``
    (Greenhouse & Geisser, Psychometrika 24, 1959; Box 1954). ``eps_hf = ((nu + 1) p eps_gg - 2) / (p (nu - p eps_gg))``,
    at most 1: Huynh & Feldt (1976) as corrected by Lecoutre (Journal of Educational Statistics 16, 1991) for groups.
    ``eps_lb = 1 / p``.
    """
    p = len(covariance)
    trace = float(np.trace(covariance))
    if p == 1 or trace <= 0.0:
        # One contrast, or no error at all: nothing can be unequal.
        return Sphericity(1.0 if p == 1 else float("nan"), float("nan"), 0, float("nan"), 1.0, 1.0, 1.0 / p)
    gg = trace**2 / (p * float(np.sum(covariance * covariance)))
    room = nu - p * gg
    hf = min(1.0, ((nu + 1) * p * gg - 2.0) / (p * room)) if room > 0 else 1.0
    df = p * (p + 1) // 2 - 1
    sign, logdet = np.linalg.slogdet(covariance)
    if nu < p or sign <= 0:
        return Sphericity(float("nan"), float("nan"), df, float("nan"), gg, max(hf, gg), 1.0 / p)
    from scipy.stats import chi2 as chi2_law

    log_w = min(0.0, float(logdet) - p * float(np.log(trace / p)))
    chi2 = -(nu - (2 * p * p + p + 2) / (6 * p)) * log_w
    return Sphericity(float(np.exp(log_w)), chi2, df, float(chi2_law.sf(chi2, df)), gg, hf, 1.0 / p)


def mauchly(values: ArrayLike, groups: ArrayLike | None = None) -> Sphericity:
    """Mauchly's test and epsilons of one within-subject factor.

    Parameters
    ----------
    values
        (n, k): subjects by conditions, finite.
    groups
        n labels of a between-subject factor; the covariance is then pooled within groups.

    Raises
    ------
    ValueError
        If the matrix is not finite, has fewer than two columns, or no more subjects than groups.
    """
    matrix = np.asarray(values, dtype=np.float64)
    if matrix.ndim != 2 or matrix.shape[1] < 2 or not np.isfinite(matrix).all():
        raise ValueError(f"needs a finite matrix of subjects by at least 2 conditions, got shape {matrix.shape}")
    codes = None
    count = 1
    if groups is not None:
        labels, found = np.unique(np.asarray(groups), return_inverse=True)
        codes, count = found.astype(np.intp), len(labels)
        if len(codes) != len(matrix):
            raise ValueError(f"{len(codes)} group labels for {len(matrix)} subjects")
    if len(matrix) <= count:
        raise ValueError(f"{len(matrix)} subjects in {count} groups leave no error term")
    contrasts = matrix @ helmert(matrix.shape[1])
    return sphericity_of_contrasts(pooled_covariance(contrasts, codes), len(matrix) - count)
