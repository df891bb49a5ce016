from __future__ import annotations

import pickle

import numpy as np
import pytest

from benchmark.errors import SkeletonError, UnknownNameError
from benchmark.motion.skeleton import CORE_ROLES, ROLES, EndSite, Skeleton


def biped(scale: float = 1.0) -> Skeleton:
    names = ("hips", "l_hip", "l_knee", "l_ankle", "r_hip", "r_knee", "r_ankle", "head")
    offsets = scale * np.array(
        [[0, 9, 0], [0.1, 0, 0], [0, -0.4, 0], [0.0, -0.3, 0.4], [-0.1, 0, 0], [0, -0.5, 0], [0, -0.5, 0], [0, 0.6, 0]]
    )
    roles = {
        "hips": 0,
        "left_hip": 1,
        "left_knee": 2,
        "left_ankle": 3,
        "right_hip": 4,
        "right_knee": 5,
        "right_ankle": 6,
    }
    return Skeleton(names, np.array([-1, 0, 1, 2, 0, 4, 5, 0]), offsets, (EndSite(7, (0, 0.1, 0)),), roles=roles)


def test_leg_length_is_the_mean_of_both_legs_along_the_bones() -> None:
    assert biped().leg_length == pytest.approx((0.4 + 0.5 + 0.5 + 0.5) / 2)


def test_bone_lengths_ignore_where_the_root_is() -> None:
    np.testing.assert_allclose(biped().bone_lengths, [0, 0.1, 0.4, 0.5, 0.1, 0.5, 0.5, 0.6])


def test_scaling_scales_everything_and_nothing_else() -> None:
    child = biped().scaled(0.5)
    assert child.leg_length == pytest.approx(biped().leg_length / 2)
    assert child.end_sites == (EndSite(7, (0, 0.05, 0)),)
    assert child.same_topology(biped())
    assert dict(child.roles) == dict(biped().roles)
    assert child != biped()


def test_chains_and_children() -> None:
    skeleton = biped()
    assert skeleton.chain(0, 3) == [0, 1, 2, 3]
    assert skeleton.chain(2, 2) == [2]
    assert skeleton.children(0) == [1, 4, 7]
    with pytest.raises(SkeletonError, match="'r_knee' does not hang below 'l_hip'"):
        skeleton.chain(1, 5)


def test_roles() -> None:
    skeleton = biped()
    assert skeleton.joint("left_knee") == 2
    assert skeleton.joints("hips", "right_ankle") == [0, 6]
    assert skeleton.has("hips", "left_hip")
    assert not skeleton.has("hips", "head")
    with pytest.raises(SkeletonError, match=r"no joint in the role 'head'.*l_knee.*role map"):
        skeleton.joint("head")
    with pytest.raises(UnknownNameError, match=r"unknown joint role 'left_nee'; did you mean 'left_knee'\?"):
        skeleton.joint("left_nee")
    assert skeleton.with_roles({"head": 7}).roles == {"head": 7}
    assert set(CORE_ROLES) <= set(ROLES)
    assert len(set(ROLES)) == len(ROLES)


def test_equality_and_hash() -> None:
    assert biped() == biped()
    assert hash(biped()) == hash(biped())
    assert biped() != biped().with_roles({})
    assert biped() != "biped"
    moved = biped().offsets.copy()
    moved[3, 0] += 1e-12
    assert biped().with_offsets(moved) != biped()


def test_it_is_frozen() -> None:
    skeleton = biped()
    with pytest.raises(ValueError, match="read-only"):
        skeleton.offsets[0] = 1.0
    with pytest.raises(TypeError):
        skeleton.roles["hips"] = 3  # type: ignore[index]
    with pytest.raises(AttributeError):
        skeleton.names = ()  # type: ignore[misc]


def test_later_changes_of_the_arguments_do_not_reach_it() -> None:
    offsets, roles = np.zeros((1, 3)), {"hips": 0}
    skeleton = Skeleton(("a",), np.array([-1]), offsets, roles=roles)
    offsets += 1.0
    roles["head"] = 0
    assert not skeleton.offsets.any()
    assert dict(skeleton.roles) == {"hips": 0}


def test_it_survives_pickling() -> None:
    skeleton = biped()
    assert pickle.loads(pickle.dumps(skeleton)) == skeleton  # noqa: S301


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"names": (), "parents": [], "offsets": np.zeros((0, 3))}, "at least one joint"),
        ({"names": ("a", "a")}, "two joints are named 'a'"),
        ({"parents": [-1]}, "parents of shape"),
        ({"offsets": np.zeros((2, 2))}, "offsets of shape"),
        ({"parents": [0, 0]}, "start with -1"),
        ({"parents": [-1, -1]}, "point to an earlier joint"),
        ({"parents": [-1, 1]}, "point to an earlier joint"),
        ({"offsets": np.array([[0, 0, 0], [0, np.nan, 0]])}, "'b' is not finite"),
        ({"orders": ("ZXY",)}, "2 joints need 2 rotation orders"),
        ({"orders": ("ZXY", "ZXZ")}, "joint 'b'.*'ZXZ'"),
        ({"roles": {"hips": 2}}, "points to joint 2 of 2"),
        ({"end_sites": (EndSite(2, (0.0, 0.0, 0.0)),)}, "end site.*joint 2 of 2"),
        ({"end_sites": (EndSite(0, (0.0, np.inf, 0.0)),)}, "end site.*not finite"),
    ],
)
def test_malformed_skeletons_are_refused(change: dict, message: str) -> None:
    good = {"names": ("a", "b"), "parents": [-1, 0], "offsets": np.zeros((2, 3))}
    Skeleton(**good)  # type: ignore[arg-type]
    with pytest.raises(SkeletonError, match=message):
        Skeleton(**{**good, **change})  # type: ignore[arg-type]


def test_unknown_roles_are_refused() -> None:
    with pytest.raises(UnknownNameError, match="tail"):
        Skeleton(("a",), np.array([-1]), np.zeros((1, 3)), roles={"tail": 0})
