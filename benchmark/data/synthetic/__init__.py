"""The embedded data set: adults and children made by rule, so that the true child performance of every adult clip is known.

A clip is a *content* (what is done), performed by a *body* (proportions by age) in a *style* (a few known numbers). For
every clip the same content can be performed with another body in the other style, which is the truth that real captures
lack. No human moved: results on this data show whether a method recovers a known style, not whether people find it
childlike. It is called synthetic wherever it appears.

Modules: :mod:`body` (skeletons by age), :mod:`styles` (parameters), :mod:`content` (what is done), :mod:`score` and
:mod:`actions` (planning feet, hips and upper body), :mod:`perform` (inverse kinematics, noise), :mod:`dataset`.
"""

from __future__ import annotations

from benchmark.data.synthetic.dataset import Actor, SyntheticDataset, TruthChange
from benchmark.data.synthetic.styles import STYLES, StyleParameters

__all__ = ["STYLES", "Actor", "StyleParameters", "SyntheticDataset", "TruthChange"]
