"""Units from leg lengths: right or refused, never wrong."""

from __future__ import annotations

import numpy as np
import pytest

from benchmark.errors import SkeletonError
from benchmark.motion.skeleton import Skeleton
from benchmark.motion.units import UNITS, guess_unit

PARTS = ("UpLeg", "Leg", "Foot")


def figure(leg: float, *, cmu: bool = False, thigh: float = 0.52) -> Skeleton:
    """A pair of legs of ``leg`` file units each."""
    names, parents, offsets, roles = ["Hips"], [-1], [[0.0, 0.0, 0.0]], {}
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        parent = 0
        if cmu:
            names.append(f"{side[0]}HipJoint")
            parents.append(0)
            offsets.append([0.0, 0.0, 0.0])
            parent = len(names) - 1
        for part, offset in zip(
            PARTS, ([sign * 0.1 * leg, 0.0, 0.0], [0.0, -thigh * leg, 0.0], [0.0, -(1 - thigh) * leg, 0.0]), strict=True
        ):
            names.append(side + part)
            parents.append(parent)
            offsets.append(offset)
            parent = len(names) - 1
        roles.update({f"{side.lower()}_{r}": parent - 2 + i for i, r in enumerate(("hip", "knee", "ankle"))})
    if cmu:
        names.append("LowerBack")
        parents.append(0)
        offsets.append([0.0, 0.0, 0.0])
    return Skeleton(tuple(names), np.array(parents), np.array(offsets), roles=roles)


@pytest.mark.parametrize(
    ("leg", "unit"),
    [(0.30, "m"), (0.85, "m"), (1.30, "m"), (43.4, "cm"), (85.0, "cm"), (130.0, "cm"), (300.0, "mm"), (1300.0, "mm")]
    + [(19.6, "inch"), (29.9, "inch")],
)
def test_clear_lengths(leg: float, unit: str) -> None:
    assert guess_unit(figure(leg)) == UNITS[unit]


def test_cmu_leg_is_826_millimetres() -> None:
    unit = guess_unit(figure(7.15 + 7.49, cmu=True))
    assert unit == pytest.approx(0.0564, rel=1e-3)
    assert unit * 14.64 == pytest.approx(0.826, abs=1e-3)


def test_cmu_joints_in_other_units_are_not_mistaken() -> None:
    assert guess_unit(figure(82.6, cmu=True)) == UNITS["cm"]
    assert guess_unit(figure(0.826, cmu=True)) == UNITS["m"]


@pytest.mark.parametrize("leg", [0.0, 0.29, 1.31, 5.0, 5.4, 14.64, 19.4, 30.1, 35.0, 43.2, 131.0, 299.0, 1301.0, 1e6])
def test_lengths_in_doubt_are_refused(leg: float) -> None:
    with pytest.raises(SkeletonError, match="declare it, for example unit="):
        guess_unit(figure(leg))


def test_refusal_names_what_it_could_be() -> None:
    with pytest.raises(SkeletonError, match=r"35 units.*cm \(0\.35 m\) or inch \(0\.89 m\)"):
        guess_unit(figure(35.0))


@pytest.mark.parametrize("unit", sorted(UNITS))
def test_every_person_in_every_unit_is_right_or_refused(unit: str) -> None:
    """From the smallest child to the tallest adult."""
    right = 0
    for metres in np.linspace(0.35, 1.05, 281):
        try:
            found = guess_unit(figure(metres / UNITS[unit], cmu=unit == "cmu"))
        except SkeletonError:
            continue
        assert found == UNITS[unit], f"a leg of {metres:.3f} m in {unit} was taken for {found} m per unit"
        right += 1
    assert right >= {"m": 281, "mm": 281, "cmu": 281, "cm": 240, "inch": 90}[unit]


def test_missing_roles_are_named() -> None:
    bare = figure(0.8).with_roles({})
    with pytest.raises(SkeletonError, match="left_hip"):
        guess_unit(bare)


def test_uneven_legs_use_the_mean() -> None:
    skeleton = figure(0.8)
    offsets = np.array(skeleton.offsets)
    offsets[skeleton.roles["left_knee"]] *= 1.02
    assert guess_unit(skeleton.with_offsets(offsets)) == 1.0
