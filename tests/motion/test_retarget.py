"""Retargeting: nothing changes on the same figure, everything scales on a scaled one, limbs point alike on any other."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmark.errors import SkeletonError
from benchmark.motion import bvh, kinect, quat
from benchmark.motion.clip import ClipMeta, MotionClip
from benchmark.motion.kinematics import fk
from benchmark.motion.retarget import retarget
from benchmark.motion.skeleton import SIDES, Skeleton

BONES = (
    # joint, parent, rest direction, length, role
    ("Hips", None, (0, 0, 0), 0.0, "hips"),
    ("Spine", "Hips", (0, 1, -0.2), 0.12, "spine"),
    ("Chest", "Spine", (0, 1, 0.1), 0.3, "chest"),
    ("Neck", "Chest", (0, 1, 0), 0.15, "neck"),
    ("Head", "Neck", (0, 1, 0.2), 0.12, "head"),
    ("L_Shoulder", "Chest", (1, 0.3, 0), 0.18, "left_shoulder"),
    ("L_Elbow", "L_Shoulder", (1, 0, 0), 0.28, "left_elbow"),
    ("L_Wrist", "L_Elbow", (1, 0, 0), 0.25, "left_wrist"),
    ("L_Hip", "Hips", (1, -0.7, 0), 0.12, "left_hip"),
    ("L_Knee", "L_Hip", (0, -1, 0), 0.42, "left_knee"),
    ("L_Ankle", "L_Knee", (0, -1, 0), 0.41, "left_ankle"),
    ("L_Toe", "L_Ankle", (0, -0.5, 1), 0.14, "left_toe"),
)


def figure(
    scale: dict[str, float] | None = None, turn: dict[str, tuple[float, float, float]] | None = None
) -> Skeleton:
    """The figure of BONES, both sides; ``scale`` and ``turn`` change the length and rest direction by unsided name."""
    names, parents, offsets, roles = [], [], [], {}
    for joint, parent, direction, length, role in BONES:
        plain = joint.removeprefix("L_")
        unit = np.array((turn or {}).get(plain, direction), dtype=float)
        unit = unit / max(np.linalg.norm(unit), 1e-12)
        for side in "LR" if joint.startswith("L_") else "-":
            other = joint.replace("L_", "R_") if side == "R" else joint
            above = parent.replace("L_", "R_") if parent and side == "R" else parent
            names.append(other)
            parents.append(-1 if above is None else names.index(above))
            offsets.append(unit * length * (scale or {}).get(plain, 1.0) * ([-1, 1, 1] if side == "R" else [1, 1, 1]))
            roles[role.replace("left", "right") if side == "R" else role] = len(names) - 1
    return Skeleton(tuple(names), np.array(parents), np.array(offsets), roles=roles)


def walk(skeleton: Skeleton, rng: np.random.Generator, frames: int = 90) -> MotionClip:
    """Smooth motion whose lowest foot touches the floor at its lowest."""
    time = np.linspace(0, 1, frames)[:, None, None]
    joints = len(skeleton)
    rotations = quat.exp(
        rng.normal(scale=0.35, size=(joints, 3)) * np.sin(2 * np.pi * (2 * time + rng.uniform(size=(joints, 3))))
    )
    root = np.stack(
        [np.linspace(0, 1, frames), 0.9 + 0.05 * np.sin(9 * time[:, 0, 0]), np.linspace(0, 2, frames)], axis=-1
    )
    low = fk(skeleton, rotations, root)[1][..., 1].min()
    return MotionClip(
        skeleton,
        rotations,
        root - [0, low, 0],
        30.0,
        meta=ClipMeta("7", "adult", "walk", "1", "made"),
        residual=np.zeros((frames, joints)),
    )


@pytest.fixture
def clip(rng: np.random.Generator) -> MotionClip:
    return walk(figure(), rng)


def direction(clip: MotionClip, start: str, end: str) -> np.ndarray:
    skeleton = clip.skeleton
    bone = clip.positions[:, skeleton.joint(end)] - clip.positions[:, skeleton.joint(start)]
    return bone / np.linalg.norm(bone, axis=-1, keepdims=True)


LIMBS = [
    (f"{side}_{a}", f"{side}_{b}")
    for side in SIDES
    for a, b in (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"), ("ankle", "toe"))
]


def test_onto_itself_is_the_identity(clip: MotionClip) -> None:
    result = retarget(clip, clip.skeleton)
    np.testing.assert_array_equal(result.rotations, clip.rotations)
    np.testing.assert_allclose(result.root, clip.root, atol=1e-12)
    np.testing.assert_allclose(result.positions, clip.positions, atol=1e-12)
    assert result.meta == clip.meta and result.fps == clip.fps
    assert result.residual is None and result.translations is None and result.source is None


@pytest.mark.parametrize("factor", [0.5, 0.7, 1.3])
@pytest.mark.parametrize("ground", [True, False])
def test_scaled_figure_scales_every_position(clip: MotionClip, factor: float, ground: bool) -> None:
    result = retarget(clip, clip.skeleton.scaled(factor), ground=ground)
    np.testing.assert_allclose(result.positions, factor * clip.positions, atol=1e-12)


def test_root_not_in_the_hips_scales_too(rng: np.random.Generator) -> None:
    base = figure()
    skeleton = Skeleton(
        ("World", *base.names),
        np.concatenate([[-1], base.parents + 1]),
        np.concatenate([[[0.0, 0.0, 0.0]], [[0.1, 0.9, 0.2]], base.offsets[1:]]),
        roles={role: joint + 1 for role, joint in base.roles.items()},
    )
    clip = walk(skeleton, rng)
    np.testing.assert_allclose(retarget(clip, skeleton).positions, clip.positions, atol=1e-12)
    np.testing.assert_allclose(retarget(clip, skeleton.scaled(0.7)).positions, 0.7 * clip.positions, atol=1e-12)


def test_moving_bones_of_the_source_are_not_lost(rng: np.random.Generator) -> None:
    """A file that moves the hips by translations below a fixed root."""
    base = figure()
    skeleton = Skeleton(
        ("World", *base.names),
        np.concatenate([[-1], base.parents + 1]),
        np.concatenate([[[0.0, 0.0, 0.0]], base.offsets]),
        roles={role: joint + 1 for role, joint in base.roles.items()},
    )
    plain = walk(base, rng)
    rotations = np.concatenate([quat.identity(len(plain), 1), plain.rotations], axis=1)
    translations = np.broadcast_to(skeleton.offsets, (len(plain), len(skeleton), 3)).copy()
    translations[:, 1] = plain.root
    clip = MotionClip(skeleton, rotations, np.zeros((len(plain), 3)), 30.0, translations=translations)
    np.testing.assert_allclose(retarget(clip, skeleton).positions[:, 1:], plain.positions, atol=1e-12)


def test_other_proportions_copy_rotations_and_keep_the_stance_on_the_floor(clip: MotionClip) -> None:
    child = figure({"Knee": 0.5, "Ankle": 0.6, "Head": 1.1, "Toe": 0.9, "Hip": 0.7})
    result = retarget(clip, child)
    np.testing.assert_array_equal(result.rotations, clip.rotations)
    scale = child.leg_length / clip.skeleton.leg_length
    np.testing.assert_allclose(result.root[:, [0, 2]], scale * clip.root[:, [0, 2]], atol=1e-12)
    shift = result.root[:, 1] - scale * clip.root[:, 1]
    np.testing.assert_allclose(shift, shift[0], atol=1e-12)
    feet = [clip.skeleton.roles[f"{side}_{part}"] for side in SIDES for part in ("ankle", "toe")]
    was, now = (c.positions[:, feet, 1].min(axis=1) for c in (clip, result))
    stance = was <= np.quantile(was, 0.25)
    assert np.median(now[stance] - scale * was[stance]) == pytest.approx(0.0, abs=1e-12)
    floating = retarget(clip, child, ground=False)
    assert abs(shift[0]) > 1e-3
    np.testing.assert_allclose(floating.root[:, 1], scale * clip.root[:, 1], atol=1e-12)


def other(extra: bool, hang: bool) -> Skeleton:
    """The same roles under other names, with more joints, and at rest with arms hanging and legs apart."""
    turn = {
        "Elbow": (0, -1, 0.1),
        "Wrist": (0.1, -1, 0),
        "Knee": (0.3, -1, 0),
        "Ankle": (0.2, -1, -0.1),
        "Toe": (0, 0, 1),
    }
    base = figure({"Knee": 0.8, "Elbow": 0.9}, turn if hang else None)
    names, parents, offsets, roles = ["Reference"], [-1], [np.array([0.0, 0.0, 0.0])], {}
    index = {}
    of_role = {joint: role for role, joint in base.roles.items()}
    for j, name in enumerate(base.names):
        parent = 0 if j == 0 else index[int(base.parents[j])]
        offset = base.offsets[j]
        if extra and name in ("Chest", "L_Elbow", "R_Elbow", "L_Knee", "R_Knee", "L_Hip", "R_Hip"):
            names.append(f"twist_{j}")
            parents.append(parent)
            offsets.append(0.5 * offset)
            parent, offset = len(names) - 1, 0.5 * offset
        names.append(f"bone_{j}")
        parents.append(parent)
        offsets.append(offset)
        index[j] = len(names) - 1
        roles[of_role[j]] = index[j]
        if extra and name.endswith("Wrist"):
            for finger in range(3):
                names.append(f"{name}_finger{finger}")
                parents.append(index[j])
                offsets.append(np.array([0.08, 0.0, 0.02 * finger]))
    return Skeleton(tuple(names), np.array(parents), np.array(offsets), roles=roles)


@pytest.mark.parametrize("extra", [False, True])
@pytest.mark.parametrize("hang", [False, True])
def test_other_skeleton_has_the_same_limb_directions(clip: MotionClip, extra: bool, hang: bool) -> None:
    result = retarget(clip, other(extra, hang))
    for start, end in LIMBS:
        np.testing.assert_allclose(direction(result, start, end), direction(clip, start, end), atol=1e-6)
    if not hang:
        for start, end in (("spine", "chest"), ("neck", "head"), ("hips", "left_hip"), ("chest", "left_shoulder")):
            np.testing.assert_allclose(direction(result, start, end), direction(clip, start, end), atol=1e-6)
    joints = [j for j, name in enumerate(result.skeleton.names) if "twist" in name or "finger" in name]
    if extra:
        np.testing.assert_allclose(np.abs(result.rotations[:, joints, 0]), 1.0, atol=1e-12)
    assert np.sum(result.rotations[1:] * result.rotations[:-1], axis=-1).min() > 0.0


def test_same_joints_with_another_rest_pose(clip: MotionClip) -> None:
    hanging = figure(None, {"Elbow": (0, -1, 0.1), "Wrist": (0.1, -1, 0), "Toe": (0, 0, 1), "Spine": (0, 1, 0)})
    result = retarget(clip, hanging)
    for start, end in (*LIMBS, ("spine", "chest"), ("neck", "head")):
        np.testing.assert_allclose(direction(result, start, end), direction(clip, start, end), atol=1e-6)
    assert quat.angle(result.rotations, clip.rotations).max() > 0.5, "other rest directions need other rotations"


def test_there_and_back_again(clip: MotionClip) -> None:
    there = retarget(clip, other(extra=False, hang=False))
    back = retarget(there, clip.skeleton)
    np.testing.assert_allclose(back.root, clip.root, atol=1e-9)
    np.testing.assert_allclose(back.positions, clip.positions, atol=1e-9)


def test_a_rest_frame_on_its_side_gives_the_same_pose(clip: MotionClip) -> None:
    """Some rigs are built lying down: their whole rest figure is turned."""
    base = clip.skeleton
    turn = quat.from_axis_angle([0.0, 0.0, 1.0], np.array(-np.pi / 2))
    lying = Skeleton(
        tuple(f"j{i}" for i in range(len(base))), base.parents, quat.rotate(turn, base.offsets), roles=dict(base.roles)
    )
    np.testing.assert_allclose(retarget(clip, lying).positions, clip.positions, atol=1e-9)


def test_hips_turn_as_a_body_whatever_the_rest_pose_of_the_spine(clip: MotionClip) -> None:
    """A rig whose first spine joint lies behind the pelvis, as in depth sensors, must not pitch the pelvis."""
    base = figure()
    offsets = np.array(base.offsets)
    spine, chest = base.joints("spine", "chest")
    above = offsets[spine] + offsets[chest]
    offsets[spine] = [0.0, 0.06, -0.06]
    offsets[chest] = above - offsets[spine]
    names = tuple(f"j{i}" for i in range(len(base)))
    result = retarget(clip, Skeleton(names, base.parents, offsets, roles=dict(base.roles)))
    assert quat.angle(result.rotations[:, 0], clip.rotations[:, 0]).max() < 1e-6


def test_collar_bones_of_a_mirrored_rig_do_not_tilt_the_chest(clip: MotionClip) -> None:
    """At zero rotation the left collar bone of some rigs points up and the right one down."""
    base = figure()
    order = [j for j in range(len(base)) if base.names[j] not in ("L_Shoulder", "R_Shoulder")]
    names, parents, offsets = ["Hips"], [-1], [np.zeros(3)]
    chest = base.joint("chest")
    for j in range(1, len(base)):
        name, parent = base.names[j], base.names[base.parents[j]]
        if j not in order:
            up = 1.0 if name.startswith("L") else -1.0
            names.append(name.replace("Shoulder", "Clavicle"))
            parents.append(names.index("Chest"))
            offsets.append(np.array([0.05 * up, 0.05, 0.0]))
            parent = names[-1]
            offset = np.array([0.0, 0.1 * up, 0.0])
        else:
            offset = np.array(base.offsets[j])
        names.append(name)
        parents.append(names.index(parent))
        offsets.append(offset)
    roles = {role: names.index(base.names[joint]) for role, joint in base.roles.items()}
    roles |= {f"{side}_clavicle": names.index(f"{side[0].upper()}_Clavicle") for side in SIDES}
    rig = Skeleton(tuple(names), np.array(parents), np.array(offsets), roles=roles)
    result = retarget(clip, rig)
    turned = result.world[0][:, rig.joint("chest")]
    assert quat.angle(turned, clip.world[0][:, chest]).max() < 1e-6
    shoulders = [direction(c, "right_shoulder", "left_shoulder") for c in (result, clip)]
    np.testing.assert_allclose(shoulders[0], shoulders[1], atol=1e-6)


def test_clavicle_that_the_source_lacks_stays_at_rest(clip: MotionClip) -> None:
    base = figure()
    names, parents, offsets = list(base.names), [int(p) for p in base.parents], [np.array(o) for o in base.offsets]
    chest = names.index("Chest")
    order = [(f"{side}_Clavicle", names.index(f"{side}_Shoulder")) for side in "LR"]
    new_names, new_parents, new_offsets, moved, roles = [], [], [], {}, {}
    for j, name in enumerate(names):
        clavicle = next((c for c, shoulder in order if shoulder == j), None)
        if clavicle:
            new_names.append(clavicle)
            new_parents.append(moved[chest])
            new_offsets.append(0.4 * offsets[j])
            roles["left_clavicle" if clavicle[0] == "L" else "right_clavicle"] = len(new_names) - 1
        new_names.append(name)
        new_parents.append(len(new_names) - 2 if clavicle else (-1 if parents[j] < 0 else moved[parents[j]]))
        new_offsets.append(0.6 * offsets[j] if clavicle else offsets[j])
        moved[j] = len(new_names) - 1
    roles.update({role: moved[joint] for role, joint in base.roles.items()})
    result = retarget(clip, Skeleton(tuple(new_names), np.array(new_parents), np.array(new_offsets), roles=roles))
    clavicles = result.skeleton.joints("left_clavicle", "right_clavicle")
    np.testing.assert_allclose(np.abs(result.rotations[:, clavicles, 0]), 1.0, atol=1e-12)
    for start, end in LIMBS:
        np.testing.assert_allclose(direction(result, start, end), direction(clip, start, end), atol=1e-6)


def test_missing_roles_are_named(clip: MotionClip) -> None:
    target = other(extra=False, hang=False)
    lacking = {role: j for role, j in target.roles.items() if role not in ("head", "left_wrist")}
    with pytest.raises(SkeletonError, match=r"target skeleton lacks the roles head, left_wrist"):
        retarget(clip, target.with_roles(lacking))
    bare = clip.replace(skeleton=clip.skeleton.with_roles({}))
    with pytest.raises(SkeletonError, match=r"source skeleton lacks the roles hips, left_hip"):
        retarget(bare, clip.skeleton)


@pytest.mark.real_data
def test_real_captures_on_each_others_skeleton(kinder_gator: Path, bandai_namco: Path) -> None:
    """A depth sensor's stick figure and a studio rig without a T-pose, in both directions."""
    stick = kinect.load(sorted(kinder_gator.glob("Children/*p644*-Walk-in-place-1*.csv"))[0])
    floor = np.quantile(stick.positions[..., 1].min(axis=1), 0.05)
    stick = stick.replace(root=stick.root - [0.0, floor, 0.0])
    rig = bvh.load(sorted(bandai_namco.rglob("*walk_normal*.bvh"))[0])
    for source, target in ((stick, rig.skeleton), (rig, stick.skeleton)):
        result = retarget(source, target)
        for start, end in (*LIMBS, ("right_hip", "left_hip")):
            np.testing.assert_allclose(direction(result, start, end), direction(source, start, end), atol=1e-6)
        shoulders = [direction(c, "right_shoulder", "left_shoulder") for c in (result, source)]
        assert np.median(np.sum(shoulders[0] * shoulders[1], axis=-1)) > np.cos(np.radians(15.0))
        assert np.all(direction(result, "hips", "head")[:, 1] > 0.8), "they walk upright"
