"""What makes a synthetic motion an adult's or a child's: a handful of numbers, all known.

The directions follow what is reported of children: higher cadence at a similar step length for their legs, a wider base and
more variable steps, larger and less coordinated arm and trunk movements (Adult2child 2020, section 3 and appendix), and a
longer preparation for a jump (Dong et al. 2018). The sizes are choices of this data set, not measurements.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields, replace

import numpy as np

from benchmark.errors import UnknownNameError


@dataclass(frozen=True)
class StyleParameters:
    """How somebody moves, apart from what they do and how they are built.

    Multipliers are 1 for the average adult. Times are first scaled to the body (by the square root of its leg length, which
    keeps the Froude number), then by these.

    Attributes
    ----------
    tempo
        Rate of everything but free flight: step frequency, speed of gestures.
    stride
        Step length in relation to the leg.
    amplitude
        Range of deliberate limb movements: punch, kick, throw, jumping jack.
    jump_height
        Rise of the pelvis in flight, in relation to the leg, for jumps (not for the flight phases of running).
    arm_swing
        Amplitude of the arm swing in locomotion.
    arm_spread
        How far the arms stand off the body, radians.
    elbow_bend
        Additional elbow flexion, radians.
    spine_bend
        Forward bend of the trunk, radians.
    spine_sway
        Amplitude of the sideways sway of the trunk in locomotion, radians.
    trunk_rotation
        Counter-rotation of pelvis and thorax.
    head_motion
        Movement of the head.
    bounce
        Additional rise and fall of the pelvis in each step.
    knee_bend
        How far the hips stay below full leg extension, as a fraction of the leg.
    step_width
        Distance between the tracks of the feet, in relation to that between the hip joints.
    anticipation
        Duration of the preparation of jumps, throws, punches and kicks.
    landing
        Duration of absorbing a landing and of recovery.
    variability
        Coefficient of variation from cycle to cycle and from take to take.
    asymmetry
        Relative difference between the left and the right arm swing, half of it on either side.
    fidget
        Size of small idle movements.
    """

    tempo: float = 1.0
    stride: float = 1.0
    amplitude: float = 1.0
    jump_height: float = 1.0
    arm_swing: float = 1.0
    arm_spread: float = 0.08
    elbow_bend: float = 0.0
    spine_bend: float = 0.03
    spine_sway: float = 0.03
    trunk_rotation: float = 1.0
    head_motion: float = 1.0
    bounce: float = 1.0
    knee_bend: float = 0.006
    step_width: float = 1.0
    anticipation: float = 1.0
    landing: float = 1.0
    variability: float = 0.02
    asymmetry: float = 0.02
    fidget: float = 1.0

    def ratio(self, other: StyleParameters) -> dict[str, float]:
        """``self / other``, parameter by parameter, without those that are 0 in ``other``."""
        return {name: value / getattr(other, name) for name, value in asdict(self).items() if getattr(other, name)}


#: The average performer of each style.
STYLES: dict[str, StyleParameters] = {
    "adult": StyleParameters(),
    "child": StyleParameters(
        tempo=1.10,
        stride=0.95,
        amplitude=1.12,
        jump_height=0.85,
        arm_swing=1.35,
        arm_spread=0.24,
        elbow_bend=0.22,
        spine_bend=0.09,
        spine_sway=0.065,
        trunk_rotation=1.4,
        head_motion=1.8,
        bounce=1.3,
        knee_bend=0.020,
        step_width=1.3,
        anticipation=1.35,
        landing=1.3,
        variability=0.055,
        asymmetry=0.06,
        fidget=2.2,
    ),
}

#: Coefficient of variation between the actors of a style.
SPREAD: dict[str, float] = {"adult": 0.05, "child": 0.07}

#: Parameters that differ little between people, as a fraction of ``SPREAD``; the others take all of it.
_STEADY = {"tempo": 0.6, "stride": 0.6, "amplitude": 0.6}


def style_parameters(style: str) -> StyleParameters:
    """The average performer of ``style``; :class:`~benchmark.errors.UnknownNameError` for any but ``adult`` and ``child``."""
    if style not in STYLES:
        raise UnknownNameError("style", style, STYLES)
    return STYLES[style]


def individual(style: str, rng: np.random.Generator) -> StyleParameters:
    """One actor's parameters: the average of ``style``, each multiplied by a log-normal factor cut off at two deviations."""
    mean = style_parameters(style)
    draws = np.clip(rng.standard_normal(len(fields(StyleParameters))), -2.0, 2.0)
    changes = {
        name: value * float(np.exp(SPREAD[style] * _STEADY.get(name, 1.0) * draw))
        for (name, value), draw in zip(asdict(mean).items(), draws, strict=True)
    }
    return replace(mean, **changes)
