"""Identification and simulation of discrete linear time-invariant models.

``x[t+1] = A x[t] + B u[t]``, ``y[t] = C x[t] + D u[t]``, ``x[0] = 0``, fitted for their simulated output: when a new clip is
translated there is no measured output to correct the state with. Only numpy and scipy are used.
"""

from __future__ import annotations

from methods.hsu.lti.identify import Identification, fit_lti, identify
from methods.hsu.lti.kernel_fir import KernelFir, kernel_fir
from methods.hsu.lti.realization import Realization, realize
from methods.hsu.lti.records import IdentificationWarning, RankDeficientWarning, Records
from methods.hsu.lti.stability import longest_radius
from methods.hsu.lti.state_space import StateSpace

__all__ = [
    "Identification",
    "IdentificationWarning",
    "KernelFir",
    "RankDeficientWarning",
    "Realization",
    "Records",
    "StateSpace",
    "fit_lti",
    "identify",
    "kernel_fir",
    "longest_radius",
    "realize",
]
