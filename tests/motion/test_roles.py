"""Roles in the naming conventions of the field, and none where there is no sense."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.errors import ConfigError, SkeletonError, UnknownNameError
from benchmark.motion.roles import apply_role_map, find_roles, load_role_map
from benchmark.motion.skeleton import CORE_ROLES, Skeleton

# Each convention: joints as "name parent", left side only where a name holds a side mark that has a mirror; and what the
# roles of centre and left must be. "{" marks stand for the side in the convention's own spelling.
LIMB_PARTS = ("clavicle", "shoulder", "elbow", "wrist", "hand", "hip", "knee", "ankle", "toe")

CONVENTIONS: dict[str, tuple[tuple[str, str], str, dict[str, str]]] = {
    "cmu-bvh": (
        ("Left", "Right"),
        "Hips - | {0}HipJoint Hips | {}UpLeg {0}HipJoint | {}Leg {}UpLeg | {}Foot {}Leg | {}ToeBase {}Foot | LowerBack Hips"
        " | Spine LowerBack | Spine1 Spine | Neck Spine1 | Neck1 Neck | Head Neck1 | {}Shoulder Spine1 | {}Arm {}Shoulder"
        " | {}ForeArm {}Arm | {}Hand {}ForeArm | {}FingerBase {}Hand | {}HandIndex1 {}FingerBase | {0}Thumb {}Hand",
        {
            "hips": "Hips",
            "spine": "LowerBack",
            "chest": "Spine1",
            "neck": "Neck",
            "head": "Head",
            "clavicle": "{}Shoulder",
        }
        | {
            "shoulder": "{}Arm",
            "elbow": "{}ForeArm",
            "wrist": "{}Hand",
            "hand": "{}HandIndex1",
            "hip": "{}UpLeg",
            "knee": "{}Leg",
        }
        | {"ankle": "{}Foot", "toe": "{}ToeBase"},
    ),
    "cmu-daz": (
        ("l", "r"),
        "hip - | {}Buttock hip | {}Thigh {}Buttock | {}Shin {}Thigh | {}Foot {}Shin | abdomen hip | chest abdomen | neck chest"
        " | head neck | leftEye head | rightEye head | {}Collar chest | {}Shldr {}Collar | {}ForeArm {}Shldr | {}Hand {}ForeArm"
        " | {}Thumb1 {}Hand | {}Index1 {}Hand | {}Mid1 {}Hand",
        {
            "hips": "hip",
            "spine": "abdomen",
            "chest": "chest",
            "neck": "neck",
            "head": "head",
            "clavicle": "{}Collar",
            "shoulder": "{}Shldr",
        }
        | {
            "elbow": "{}ForeArm",
            "wrist": "{}Hand",
            "hand": "{}Index1",
            "hip": "{}Thigh",
            "knee": "{}Shin",
            "ankle": "{}Foot",
        },
    ),
    "cmu-asf": (
        ("l", "r"),
        "root - | {}hipjoint root | {}femur {}hipjoint | {}tibia {}femur | {}foot {}tibia | {}toes {}foot | lowerback root"
        " | upperback lowerback | thorax upperback | lowerneck thorax | upperneck lowerneck | head upperneck"
        " | {}clavicle thorax | {}humerus {}clavicle | {}radius {}humerus | {}wrist {}radius | {}hand {}wrist"
        " | {}fingers {}hand | {}thumb {}wrist",
        {
            "hips": "root",
            "spine": "lowerback",
            "chest": "thorax",
            "neck": "lowerneck",
            "head": "head",
            "clavicle": "{}clavicle",
        }
        | {
            "shoulder": "{}humerus",
            "elbow": "{}radius",
            "wrist": "{}wrist",
            "hand": "{}hand",
            "hip": "{}femur",
            "knee": "{}tibia",
        }
        | {"ankle": "{}foot", "toe": "{}toes"},
    ),
    "mixamo": (
        ("Left", "Right"),
        "mixamorig:Hips - | mixamorig:Spine mixamorig:Hips | mixamorig:Spine1 mixamorig:Spine"
        " | mixamorig:Spine2 mixamorig:Spine1 | mixamorig:Neck mixamorig:Spine2 | mixamorig:Head mixamorig:Neck"
        " | mixamorig:HeadTop_End mixamorig:Head | mixamorig:{}Shoulder mixamorig:Spine2 | mixamorig:{}Arm mixamorig:{}Shoulder"
        " | mixamorig:{}ForeArm mixamorig:{}Arm | mixamorig:{}Hand mixamorig:{}ForeArm"
        " | mixamorig:{}HandThumb1 mixamorig:{}Hand | mixamorig:{}HandIndex1 mixamorig:{}Hand"
        " | mixamorig:{}HandMiddle1 mixamorig:{}Hand | mixamorig:{}HandMiddle2 mixamorig:{}HandMiddle1"
        " | mixamorig:{}UpLeg mixamorig:Hips | mixamorig:{}Leg mixamorig:{}UpLeg | mixamorig:{}Foot mixamorig:{}Leg"
        " | mixamorig:{}ToeBase mixamorig:{}Foot | mixamorig:{}Toe_End mixamorig:{}ToeBase",
        {
            role: f"mixamorig:{name}"
            for role, name in {
                "hips": "Hips",
                "spine": "Spine",
                "chest": "Spine2",
                "neck": "Neck",
                "head": "Head",
                "clavicle": "{}Shoulder",
                "shoulder": "{}Arm",
            }.items()
            | {
                "elbow": "{}ForeArm",
                "wrist": "{}Hand",
                "hand": "{}HandMiddle1",
                "hip": "{}UpLeg",
                "knee": "{}Leg",
            }.items()
            | {"ankle": "{}Foot", "toe": "{}ToeBase"}.items()
        },
    ),
    "kinect-v1": (
        ("Left", "Right"),
        "HipCenter - | Spine HipCenter | ShoulderCenter Spine | Head ShoulderCenter | Shoulder{} ShoulderCenter"
        " | Elbow{} Shoulder{} | Wrist{} Elbow{} | Hand{} Wrist{} | Hip{} HipCenter | Knee{} Hip{} | Ankle{} Knee{}"
        " | Foot{} Ankle{}",
        {
            "hips": "HipCenter",
            "spine": "Spine",
            "chest": "ShoulderCenter",
            "head": "Head",
            "shoulder": "Shoulder{}",
            "elbow": "Elbow{}",
        }
        | {"wrist": "Wrist{}", "hand": "Hand{}", "hip": "Hip{}", "knee": "Knee{}", "ankle": "Ankle{}", "toe": "Foot{}"},
    ),
    "kinect-v2": (
        ("Left", "Right"),
        "SpineBase - | SpineMid SpineBase | SpineShoulder SpineMid | Neck SpineShoulder | Head Neck"
        " | Shoulder{} SpineShoulder | Elbow{} Shoulder{} | Wrist{} Elbow{} | Hand{} Wrist{} | HandTip{} Hand{}"
        " | Thumb{} Wrist{} | Hip{} SpineBase | Knee{} Hip{} | Ankle{} Knee{} | Foot{} Ankle{}",
        {
            "hips": "SpineBase",
            "spine": "SpineMid",
            "chest": "SpineShoulder",
            "neck": "Neck",
            "head": "Head",
            "shoulder": "Shoulder{}",
        }
        | {
            "elbow": "Elbow{}",
            "wrist": "Wrist{}",
            "hand": "Hand{}",
            "hip": "Hip{}",
            "knee": "Knee{}",
            "ankle": "Ankle{}",
            "toe": "Foot{}",
        },
    ),
    "bandai-namco": (
        ("L", "R"),
        "joint_Root - | Hips joint_Root | Spine Hips | Chest Spine | Neck Chest | Head Neck | Shoulder_{} Chest"
        " | UpperArm_{} Shoulder_{} | LowerArm_{} UpperArm_{} | Hand_{} LowerArm_{} | UpperLeg_{} Hips"
        " | LowerLeg_{} UpperLeg_{}"
        " | Foot_{} LowerLeg_{} | Toes_{} Foot_{}",
        {"hips": "Hips", "spine": "Spine", "chest": "Chest", "neck": "Neck", "head": "Head", "clavicle": "Shoulder_{}"}
        | {
            "shoulder": "UpperArm_{}",
            "elbow": "LowerArm_{}",
            "wrist": "Hand_{}",
            "hip": "UpperLeg_{}",
            "knee": "LowerLeg_{}",
        }
        | {"ankle": "Foot_{}", "toe": "Toes_{}"},
    ),
    "xsens": (
        ("Left", "Right"),
        "Pelvis - | L5 Pelvis | L3 L5 | T12 L3 | T8 T12 | Neck T8 | Head Neck | {}Shoulder T8 | {}UpperArm {}Shoulder"
        " | {}ForeArm {}UpperArm | {}Hand {}ForeArm | {}UpperLeg Pelvis | {}LowerLeg {}UpperLeg"
        " | {}Foot {}LowerLeg | {}Toe {}Foot",
        {
            "hips": "Pelvis",
            "spine": "L5",
            "chest": "T8",
            "neck": "Neck",
            "head": "Head",
            "clavicle": "{}Shoulder",
            "shoulder": "{}UpperArm",
        }
        | {
            "elbow": "{}ForeArm",
            "wrist": "{}Hand",
            "hip": "{}UpperLeg",
            "knee": "{}LowerLeg",
            "ankle": "{}Foot",
            "toe": "{}Toe",
        },
    ),
    "lafan1": (
        ("Left", "Right"),
        "Hips - | {}UpLeg Hips | {}Leg {}UpLeg | {}Foot {}Leg | {}Toe {}Foot | Spine Hips | Spine1 Spine | Spine2 Spine1"
        " | Neck Spine2 | Head Neck | {}Shoulder Spine2 | {}Arm {}Shoulder | {}ForeArm {}Arm | {}Hand {}ForeArm",
        {
            "hips": "Hips",
            "spine": "Spine",
            "chest": "Spine2",
            "neck": "Neck",
            "head": "Head",
            "clavicle": "{}Shoulder",
            "shoulder": "{}Arm",
        }
        | {
            "elbow": "{}ForeArm",
            "wrist": "{}Hand",
            "hip": "{}UpLeg",
            "knee": "{}Leg",
            "ankle": "{}Foot",
            "toe": "{}Toe",
        },
    ),
    "biovision": (
        ("Left", "Right"),
        "Hips - | {}Hip Hips | {}Knee {}Hip | {}Ankle {}Knee | Chest Hips | {}Collar Chest | {}Shoulder {}Collar"
        " | {}Elbow {}Shoulder | {}Wrist {}Elbow | Neck Chest | Head Neck",
        {
            "hips": "Hips",
            "chest": "Chest",
            "neck": "Neck",
            "head": "Head",
            "clavicle": "{}Collar",
            "shoulder": "{}Shoulder",
        }
        | {"elbow": "{}Elbow", "wrist": "{}Wrist", "hip": "{}Hip", "knee": "{}Knee", "ankle": "{}Ankle"},
    ),
    "smpl": (
        ("L", "R"),
        "Pelvis - | {}_Hip Pelvis | Spine1 Pelvis | {}_Knee {}_Hip | Spine2 Spine1 | {}_Ankle {}_Knee | Spine3 Spine2"
        " | {}_Foot {}_Ankle | Neck Spine3 | {}_Collar Spine3 | Head Neck | {}_Shoulder {}_Collar | {}_Elbow {}_Shoulder"
        " | {}_Wrist {}_Elbow | {}_Hand {}_Wrist",
        {
            "hips": "Pelvis",
            "spine": "Spine1",
            "chest": "Spine3",
            "neck": "Neck",
            "head": "Head",
            "clavicle": "{}_Collar",
        }
        | {
            "shoulder": "{}_Shoulder",
            "elbow": "{}_Elbow",
            "wrist": "{}_Wrist",
            "hand": "{}_Hand",
            "hip": "{}_Hip",
            "knee": "{}_Knee",
        }
        | {"ankle": "{}_Ankle", "toe": "{}_Foot"},
    ),
    "blender": (
        ("L", "R"),
        "spine - | spine.001 spine | spine.002 spine.001 | spine.003 spine.002 | neck spine.003 | head neck | pelvis.{} spine"
        " | shoulder.{} spine.003 | upper_arm.{} shoulder.{} | forearm.{} upper_arm.{} | hand.{} forearm.{} | thigh.{} spine"
        " | shin.{} thigh.{} | foot.{} shin.{} | toe.{} foot.{} | heel.02.{} foot.{}",
        {
            "hips": "spine",
            "spine": "spine.001",
            "chest": "spine.003",
            "neck": "neck",
            "head": "head",
            "clavicle": "shoulder.{}",
        }
        | {"shoulder": "upper_arm.{}", "elbow": "forearm.{}", "wrist": "hand.{}", "hip": "thigh.{}", "knee": "shin.{}"}
        | {"ankle": "foot.{}", "toe": "toe.{}"},
    ),
    "unreal": (
        ("l", "r"),
        "root - | pelvis root | spine_01 pelvis | spine_02 spine_01 | spine_03 spine_02 | neck_01 spine_03 | head neck_01"
        " | clavicle_{} spine_03 | upperarm_{} clavicle_{} | upperarm_twist_01_{} upperarm_{} | lowerarm_{} upperarm_{}"
        " | hand_{} lowerarm_{} | middle_01_{} hand_{} | thigh_{} pelvis | thigh_twist_01_{} thigh_{} | calf_{} thigh_{}"
        " | foot_{} calf_{} | ball_{} foot_{} | ik_foot_{} root",
        {
            "hips": "pelvis",
            "spine": "spine_01",
            "chest": "spine_03",
            "neck": "neck_01",
            "head": "head",
            "clavicle": "clavicle_{}",
        }
        | {
            "shoulder": "upperarm_{}",
            "elbow": "lowerarm_{}",
            "wrist": "hand_{}",
            "hand": "middle_01_{}",
            "hip": "thigh_{}",
        }
        | {"knee": "calf_{}", "ankle": "foot_{}", "toe": "ball_{}"},
    ),
    "biped": (
        ("L", "R"),
        "Bip01 - | Bip01_Pelvis Bip01 | Bip01_Spine Bip01_Pelvis | Bip01_Spine1 Bip01_Spine | Bip01_Neck Bip01_Spine1"
        " | Bip01_Head Bip01_Neck | Bip01_{}_Clavicle Bip01_Neck | Bip01_{}_UpperArm Bip01_{}_Clavicle"
        " | Bip01_{}_Forearm Bip01_{}_UpperArm | Bip01_{}_Hand Bip01_{}_Forearm | Bip01_{}_Finger0 Bip01_{}_Hand"
        " | Bip01_{}_Thigh Bip01_Spine | Bip01_{}_Calf Bip01_{}_Thigh | Bip01_{}_Foot Bip01_{}_Calf"
        " | Bip01_{}_Toe0 Bip01_{}_Foot",
        {
            role: f"Bip01_{name}"
            for role, name in {
                "hips": "Pelvis",
                "spine": "Spine",
                "chest": "Spine1",
                "neck": "Neck",
                "head": "Head",
                "clavicle": "{}_Clavicle",
            }.items()
            | {
                "shoulder": "{}_UpperArm",
                "elbow": "{}_Forearm",
                "wrist": "{}_Hand",
                "hip": "{}_Thigh",
                "knee": "{}_Calf",
            }.items()
            | {"ankle": "{}_Foot", "toe": "{}_Toe0"}.items()
        },
    ),
}


def build(convention: str) -> tuple[list[str], list[int], dict[str, int]]:
    """Names, parents (parents first) and expected roles."""
    sides, text, expected = CONVENTIONS[convention]
    names, parents = [], []
    for joint in text.split(" | "):
        name, parent = joint.rsplit(" ", 1)
        for side in sides if "{" in name else ("",):
            names.append(fill(name, side))
            parents.append(fill(parent, side))
    roles = {}
    for role, name in expected.items():
        if role in LIMB_PARTS:
            for which, side in zip(("left", "right"), sides, strict=True):
                roles[f"{which}_{role}"] = names.index(fill(name, side))
        else:
            roles[role] = names.index(name)
    return names, [-1 if parent == "-" else names.index(parent) for parent in parents], roles


def fill(name: str, side: str) -> str:
    return name.replace("{0}", side[:1]).replace("{}", side)


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_convention(convention: str) -> None:
    names, parents, expected = build(convention)
    found = find_roles(names, parents)
    assert {role: names[j] for role, j in found.items()} == {role: names[j] for role, j in expected.items()}
    assert set(CORE_ROLES) <= set(found)


def test_biped_as_3ds_max_writes_it() -> None:
    names, parents, expected = build("biped")
    names = [name.replace("_", " ") for name in names]
    assert find_roles(names, parents) == expected


def test_shoulder_means_what_hangs_from_it() -> None:
    """The trap: one word for the collar bone here and for the upper arm there."""
    for convention, role in (("cmu-bvh", "left_clavicle"), ("kinect-v1", "left_shoulder"), ("smpl", "left_shoulder")):
        names, parents, _ = build(convention)
        joint = next(
            i for i, name in enumerate(names) if "Shoulder" in name and name.startswith(("Left", "L_", "ShoulderL"))
        )
        found = find_roles(names, parents)
        assert found[role] == joint
        assert list(found.values()).count(joint) == 1


@settings(max_examples=40, deadline=None)
@given(
    st.sampled_from(sorted(CONVENTIONS)),
    st.from_regex(r"[A-Za-z][A-Za-z0-9]{0,9}[:_ |]", fullmatch=True),
    st.sampled_from(["as is", "upper", "lower"]),
)
def test_prefix_and_case_change_nothing(convention: str, prefix: str, case: str) -> None:
    names, parents, expected = build(convention)
    names = [prefix + (name if case == "as is" else getattr(name, case)()) for name in names]
    assert find_roles(names, parents) == expected


@settings(max_examples=150, deadline=None)
@given(st.sampled_from(sorted(CONVENTIONS)), st.integers(0, 2**32 - 1))
def test_shuffled_names_have_no_roles(convention: str, seed: int) -> None:
    names, parents, _ = build(convention)
    shuffled = [names[i] for i in np.random.default_rng(seed).permutation(len(names))]
    assert find_roles(shuffled, parents) == {}


@settings(max_examples=30, deadline=None)
@given(st.lists(st.text(min_size=1, max_size=12), min_size=1, max_size=25, unique=True), st.integers(0, 2**32 - 1))
def test_any_text_is_survived(names: list[str], seed: int) -> None:
    rng = np.random.default_rng(seed)
    parents = [-1, *(int(rng.integers(0, i)) for i in range(1, len(names)))]
    found = find_roles(names, parents)
    assert all(0 <= joint < len(names) for joint in found.values())


def test_numbered_joints_have_no_roles() -> None:
    assert find_roles([f"joint{i}" for i in range(20)], [-1, *range(19)]) == {}


def test_order_of_joints_does_not_matter() -> None:
    names, parents, expected = build("lafan1")
    order = sorted(range(len(names)), key=lambda j: (depth(parents, j), -j))
    where = {old: new for new, old in enumerate(order)}
    found = find_roles([names[j] for j in order], [-1 if parents[j] < 0 else where[parents[j]] for j in order])
    assert found == {role: where[joint] for role, joint in expected.items()}


def depth(parents: list[int], joint: int) -> int:
    return 0 if parents[joint] < 0 else 1 + depth(parents, parents[joint])


def test_a_limb_on_one_side_only_is_left_out() -> None:
    names, parents, expected = build("lafan1")
    names[names.index("RightForeArm")] = "Elephant"
    found = find_roles(names, parents)
    assert not {role for role in found if role.endswith(("shoulder", "elbow", "wrist", "clavicle"))}
    assert {"left_knee", "right_knee", "hips", "head"} <= set(found)
    assert all(expected[role] == joint for role, joint in found.items() if role != "chest")


def test_knee_above_the_hip_is_left_out() -> None:
    names, parents, _ = build("lafan1")
    for side in ("Left", "Right"):
        a, b = names.index(f"{side}UpLeg"), names.index(f"{side}Leg")
        names[a], names[b] = names[b], names[a]
    found = find_roles(names, parents)
    assert not {role for role in found if role.endswith(("hip", "knee", "ankle", "toe"))}
    assert "hips" not in found, "hips are known by the legs that hang from them"
    assert names[found["left_elbow"]] == "LeftForeArm"


def test_an_arm_without_a_hand_is_left_out_whole() -> None:
    names, parents, _ = build("lafan1")
    names = [name.replace("Hand", "Paw") for name in names]
    found = find_roles(names, parents)
    assert not {role for role in found if role.endswith(("clavicle", "shoulder", "elbow", "wrist", "hand"))}
    assert {"left_hip", "right_ankle", "hips", "head"} <= set(found)


def test_two_elbows_on_one_arm_are_left_out() -> None:
    names, parents, _ = build("lafan1")
    for side in ("Left", "Right"):
        names.append(f"{side}Elbow")
        parents.append(names.index(f"{side}ForeArm"))
    found = find_roles(names, parents)
    assert "left_elbow" not in found and "left_shoulder" not in found
    assert found["left_knee"] == names.index("LeftLeg")


def test_two_heads_are_left_out() -> None:
    names, parents, _ = build("kinect-v2")
    names.append("x:Head")
    parents.append(names.index("Neck"))
    found = find_roles(names, parents)
    assert "head" not in found and "hips" in found


def test_foot_under_an_ankle_is_a_toe() -> None:
    names, parents, _ = build("kinect-v1")
    found = find_roles(names, parents)
    assert names[found["left_ankle"]] == "AnkleLeft" and names[found["left_toe"]] == "FootLeft"
    names, parents, _ = build("cmu-bvh")
    assert names[find_roles(names, parents)["left_ankle"]] == "LeftFoot"


# Role maps.


def skeleton() -> Skeleton:
    names, parents, roles = build("lafan1")
    return Skeleton(tuple(names), np.array(parents), np.zeros((len(names), 3)), roles=roles)


def test_role_map_round_trip(tmp_path: Path) -> None:
    path = tmp_path / "roles.toml"
    path.write_text('[roles]\nhead = "Neck"\nneck = ""\nleft_hand = "LeftToe"\n')
    mapping = load_role_map(path)
    assert mapping == {"head": "Neck", "neck": "", "left_hand": "LeftToe"}
    before, after = skeleton(), apply_role_map(skeleton(), mapping)
    assert after.roles["head"] == before.names.index("Neck")
    assert "neck" not in after.roles
    assert after.roles["left_hand"] == before.names.index("LeftToe") and "left_toe" not in after.roles
    assert after.roles["left_knee"] == before.roles["left_knee"]
    assert before.roles["head"] == before.names.index("Head")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('[roles]\nleft_nee = "LeftLeg"\n', r"left_nee.*did you mean 'left_knee'"),
        ("[roles]\nleft_knee = 3\n", r"left_knee: expected a joint name in quotes, not 3"),
        ('roles = "x"\n', r"needs a table \[roles\]"),
        ("", r"needs a table \[roles\]"),
        ("[roles\n", "is not TOML"),
    ],
)
def test_bad_role_map_names_file_and_key(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=words) as caught:
        load_role_map(path)
    assert str(path) in str(caught.value)


def test_absent_or_binary_role_map(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nowhere\.toml: cannot be read"):
        load_role_map(tmp_path / "nowhere.toml")
    (tmp_path / "b.toml").write_bytes(b"\xff\xfe[")
    with pytest.raises(ConfigError, match=r"b\.toml: is not TOML"):
        load_role_map(tmp_path / "b.toml")


def test_map_to_unknown_joint_or_role() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'LeftLeg'"):
        apply_role_map(skeleton(), {"left_knee": "LeftLegg"})
    with pytest.raises(UnknownNameError, match="joint role"):
        apply_role_map(skeleton(), {"tail": "Hips"})


def test_one_joint_cannot_have_two_mapped_roles() -> None:
    with pytest.raises(SkeletonError, match="'Head' two roles, 'head' and 'neck'"):
        apply_role_map(skeleton(), {"head": "Head", "neck": "Head"})


@pytest.mark.real_data
def test_bandai_namco_file(bandai_namco: Path) -> None:
    path = sorted(bandai_namco.rglob("*.bvh"))[0]
    names, parents, stack = [], [], [-1]
    for line in path.read_text().split("MOTION")[0].splitlines():
        words = line.split()
        if words[0] in ("ROOT", "JOINT"):
            names.append(words[1])
            parents.append(stack[-1])
            pushed = len(names) - 1
        elif words[0] == "End":
            pushed = -2
        elif words[0] == "{":
            stack.append(pushed)
        elif words[0] == "}":
            stack.pop()
    assert {role: names[j] for role, j in find_roles(names, parents).items()} == {
        role: build("bandai-namco")[0][j] for role, j in build("bandai-namco")[2].items()
    }
