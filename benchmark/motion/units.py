"""The unit of a motion file, from the length of a leg.

BVH files do not say their unit. A leg (hip to ankle along the bones) of a living person measures 0.30 to 1.10 m, which
separates metres, centimetres and millimetres from each other, but not everything:

======================  ==============  =============================================================
leg in file units       could be        verdict
======================  ==============  =============================================================
0.30 - 1.30             m               metres
5.31 - 19.49            CMU, inch       CMU units if the joints are CMU's, refused otherwise
19.49 - 30.00           inch            inches
30.00 - 43.31           inch, cm        refused: an adult in inches is as long as a child in centimetres
43.31 - 130.00          cm              centimetres
300.0 - 1300            mm              millimetres
anything else           nothing         refused
======================  ==============  =============================================================

Metres, centimetres and millimetres are allowed up to 1.30 m, for giants and stylised figures, because nothing else lies
there. A CMU unit is 1/0.45 inch (0.0564 m; the CMU leg of 7.15 + 7.49 units is 0.826 m). No length tells it from an inch,
so the joint names do: only CMU skeletons have both ``LHipJoint`` and ``LowerBack``. A CMU skeleton converted to inches with
its joint names kept, and shorter than 0.50 m in the leg, would be taken for CMU units; no other case is guessed wrong.
"""

from __future__ import annotations

import re

from benchmark.errors import SkeletonError
from benchmark.motion.skeleton import Skeleton

#: Metres per unit.
UNITS: dict[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254, "cmu": 0.0254 / 0.45}

#: Leg lengths in metres that each unit is believed to measure. Where two intervals overlap in file units, neither is.
LEGS: dict[str, tuple[float, float]] = {
    "m": (0.30, 1.30),
    "cm": (0.30, 1.30),
    "mm": (0.30, 1.30),
    "inch": (0.30, 1.10),
    "cmu": (0.30, 1.10),
}

#: Relative slack at the ends of the intervals, for rounding.
_SLACK = 1e-9

_CMU_JOINTS = ("lhipjoint", "lowerback")


def guess_unit(skeleton: Skeleton) -> float:
    """Metres per file unit.

    Parameters
    ----------
    skeleton
        With offsets still in file units, and the hip, knee and ankle roles of both sides.

    Returns
    -------
    One of the values of :data:`UNITS`.

    Raises
    ------
    SkeletonError
        If a leg role is missing, or the leg's length fits no unit or more than one; the message says to declare ``unit=``.
    """
    leg = skeleton.leg_length
    fitting = [
        unit
        for unit, (shortest, longest) in LEGS.items()
        if shortest * (1.0 - _SLACK) <= leg * UNITS[unit] <= longest * (1.0 + _SLACK)
    ]
    if "cmu" in fitting and _is_cmu(skeleton):
        return UNITS["cmu"]
    if len(fitting) == 1 and fitting != ["cmu"]:
        return UNITS[fitting[0]]
    listing = " or ".join(f"{unit} ({leg * UNITS[unit]:.2f} m)" for unit in fitting)
    reason = f"could be {listing}" if fitting else "is no person's in any known unit"
    raise SkeletonError(
        f"the unit of the file cannot be told: its leg of {leg:.4g} units (hip to ankle) {reason}; "
        f'declare it, for example unit="cm" or unit=0.01 (metres per unit; known: {", ".join(UNITS)})'
    )


def _is_cmu(skeleton: Skeleton) -> bool:
    bare = {re.sub(r"[^a-z0-9]", "", re.split(r"[:|]", name)[-1].lower()) for name in skeleton.names}
    return all(any(name.endswith(joint) for name in bare) for joint in _CMU_JOINTS)
