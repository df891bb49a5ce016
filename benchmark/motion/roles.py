"""What each joint means: roles from joint names and hierarchy, or from a map in a file.

Names are taken apart (namespace, common prefix, side, part), looked up in the vocabulary of the field and then checked
against the hierarchy, because one word means different joints in different conventions: ``Shoulder`` is the collar bone in
Mixamo, CMU and Bandai-Namco skeletons and the upper arm's joint in Kinect and SMPL ones; ``Leg`` is a shin, ``Foot`` an
ankle or a toe. The rule is always the same: limbs are found from the elbow and the knee, the names with the least doubt,
outwards to the nearest joint that can be the next one. What stays in doubt gets no role: joints found on one side only,
limbs incomplete or in the wrong order, two joints of equal claim. A role map (:func:`load_role_map`) settles those.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path

from benchmark.errors import ConfigError, SkeletonError, UnknownNameError
from benchmark.motion.skeleton import ROLES, SIDES, Skeleton
from benchmark.toml import parse_toml

#: Words for joints of one side, best first, by the role they can stand for. One word may stand for several.
_LIMB_WORDS: dict[str, tuple[str, ...]] = {
    "clavicle": ("clavicle", "collar", "collarbone", "scapula", "shoulder"),
    "shoulder": ("upperarm", "uparm", "armupper", "humerus", "shldr", "arm", "shoulder", "glenohumeral"),
    "elbow": ("forearm", "lowerarm", "lowarm", "loarm", "armlower", "elbow", "radius"),
    "wrist": ("hand", "wrist"),
    "hand": ("hand", "fingers", "handtip", "handend", "handmiddle1", "middle1", "handindex1", "index1", "fingerbase"),
    "hip": ("upperleg", "upleg", "legupper", "thigh", "femur", "hip"),
    "knee": ("lowerleg", "lowleg", "loleg", "leglower", "knee", "shin", "calf", "tibia", "leg"),
    "ankle": ("foot", "ankle"),
    "toe": ("toebase", "toe", "toes", "ball", "toe0", "toe1", "foot", "toeend", "footend"),
}

_HIPS_WORDS = frozenset({"hips", "pelvis", "hip", "hipcenter", "hipcentre", "spinebase"})

_NECK = re.compile(r"(lower|upper)?neck\d*|neck(lower|upper)")

_TORSO = re.compile(
    r"(lower|upper|mid)?(spine|back|torso|chest|body)\d*|(spine|back|chest|torso)(lower|upper|mid|shoulder)\d*|thorax|sternum|ribs"
    r"|ribcage|abdomen|belly|waist|stomach|shoulder(center|centre)?|[lt]\d+"
)

_SIDE_WORDS = {"left": "left", "l": "left", "right": "right", "r": "right"}

#: Words that say nothing about which joint it is.
_EMPTY_WORDS = frozenset({"jnt", "joint", "jt", "bone", "bind", "def", "c", "m", "center", "centre"})

_TOKEN = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+")

#: A prefix is common when this share of the joints have it.
_COMMON = 0.8


def find_roles(names: Sequence[str], parents: Sequence[int]) -> dict[str, int]:
    """Roles of joints, by name and hierarchy.

    Knows the conventions of CMU (ASF and BVH exports), Mixamo, Kinect v1 and v2, Bandai-Namco, Xsens, MotionBuilder,
    LAFAN1, Biovision, SMPL, Unreal, Blender and 3ds Max Biped, with any namespace or prefix.

    Parameters
    ----------
    names
        J joint names.
    parents
        J parent indices, -1 for the root.

    Returns
    -------
    Role (see :data:`benchmark.motion.skeleton.ROLES`) to joint index. A role in doubt is left out.
    """
    tree = _Tree(list(names), [int(parent) for parent in parents])
    limbs = {side: {**_arm(tree, side), **_leg(tree, side)} for side in SIDES}
    left, right = limbs["left"], limbs["right"]
    pairs = {part: (left[part], right[part]) for part in left if part in right}
    pairs = {part: pair for part, pair in pairs.items() if tree.depth(pair[0]) == tree.depth(pair[1])}
    # A limb is known whole or not at all: one that breaks off in the middle is more likely a chance hit.
    for whole, ends in ((("shoulder", "elbow", "wrist"), ("clavicle", "hand")), (("hip", "knee", "ankle"), ("toe",))):
        if not all(part in pairs for part in whole):
            for part in (*whole, *ends):
                pairs.pop(part, None)
    roles = {f"{side}_{part}": pair[i] for part, pair in pairs.items() for i, side in enumerate(SIDES)}
    roles.update(_trunk(tree, pairs, taken=set(roles.values())))
    return {role: roles[role] for role in ROLES if role in roles}


class _Tree:
    """Joints with what their names can mean."""

    def __init__(self, names: list[str], parents: list[int]) -> None:
        self.parents = parents
        self.words = [_parse(name) for name in _without_prefix(names)]

    def ancestors(self, joint: int) -> list[int]:
        """Joints above ``joint``, nearest first."""
        path: list[int] = []
        while (joint := self.parents[joint]) >= 0 and len(path) < len(self.parents):
            path.append(joint)
        return path

    def depth(self, joint: int) -> int:
        return len(self.ancestors(joint))

    def below(self, joint: int) -> list[int]:
        """Joints hanging from ``joint`` at any depth."""
        return [other for other in range(len(self.parents)) if joint in self.ancestors(other)]

    def meet(self, a: int, b: int) -> int | None:
        """The lowest joint from which both hang."""
        above = set(self.ancestors(b))
        return next((joint for joint in self.ancestors(a) if joint in above), None)

    def rank(self, joint: int, side: str, part: str) -> int | None:
        """How well the joint's name says ``part`` of ``side``: 0 is best, ``None`` not at all."""
        words = [word for named, word in self.words[joint] if named == side and word in _LIMB_WORDS[part]]
        return min((_LIMB_WORDS[part].index(word) for word in words), default=None)

    def centre(self, joint: int) -> list[str]:
        """The joint's name, if it has no side."""
        return [word for side, word in self.words[joint] if side == ""]


def _without_prefix(names: list[str]) -> list[str]:
    """Names without namespace and without the prefix that most of them share."""
    bare = [re.split(r"[:|]", name)[-1].strip() for name in names]
    enough = _COMMON * len(bare)
    prefix = ""
    while True:
        following: dict[str, int] = {}
        for name in bare:
            if name.startswith(prefix) and len(name) > len(prefix):
                key = name[: len(prefix) + 1]
                following[key] = following.get(key, 0) + 1
        best = max(following, key=lambda key: following[key], default="")
        if not best or following[best] < enough or len(bare) < 3:
            return [name.removeprefix(prefix) for name in bare]
        prefix = best


def _parse(name: str) -> list[tuple[str, str]]:
    """The readings of a name: (side or nothing, part in lower case without separators), most literal first."""
    tokens = [str(int(token)) if token.isdigit() else token.lower() for token in _TOKEN.findall(name)]
    tokens = [token for i, token in enumerate(tokens) if token not in _EMPTY_WORDS or len(tokens) == 1]
    if not tokens:
        return []
    readings: list[tuple[str, str]] = []
    known = {word for words in _LIMB_WORDS.values() for word in words}
    for at in (0, len(tokens) - 1):
        side = _SIDE_WORDS.get(tokens[at])
        rest = "".join(tokens[:at] + tokens[at + 1 :])
        if side and rest in known:
            readings.append((side, rest))
    whole = "".join(tokens)
    if not readings:
        for word, side in _SIDE_WORDS.items():
            if whole.startswith(word) and whole[len(word) :] in known:
                readings.append((side, whole[len(word) :]))
            # A lone letter at the end of a run-together name is too weak a sign.
            elif len(word) > 1 and whole.endswith(word) and whole[: -len(word)] in known:
                readings.append((side, whole[: -len(word)]))
    if not readings:
        # CMU's LowerBack and Xsens' L5 start with a letter that is no side.
        readings.append(("", whole))
    return list(dict.fromkeys(readings))


def _nearest(tree: _Tree, candidates: Sequence[int], steps: Mapping[int, int], side: str, part: str) -> int | None:
    """The nearest candidate that can be ``part``; of equally near ones that with the best word; none if two are equal."""
    ranked = sorted(
        (steps[joint], rank, joint) for joint in candidates if (rank := tree.rank(joint, side, part)) is not None
    )
    if not ranked or (len(ranked) > 1 and ranked[0][:2] == ranked[1][:2]):
        return None
    return ranked[0][2]


def _above(tree: _Tree, joint: int, side: str, part: str) -> int | None:
    path = tree.ancestors(joint)
    return _nearest(tree, path, {other: i for i, other in enumerate(path)}, side, part)


def _beneath(tree: _Tree, joint: int, side: str, part: str) -> int | None:
    below = tree.below(joint)
    return _nearest(tree, below, {other: tree.depth(other) for other in below}, side, part)


def _anchor(tree: _Tree, side: str, part: str) -> int | None:
    """The only joint that can be ``part``; none if several can."""
    found = [joint for joint in range(len(tree.parents)) if tree.rank(joint, side, part) is not None]
    return found[0] if len(found) == 1 else None


def _arm(tree: _Tree, side: str) -> dict[str, int]:
    elbow = _anchor(tree, side, "elbow")
    if elbow is None:
        return {}
    found = {"elbow": elbow, "shoulder": _above(tree, elbow, side, "shoulder")}
    if found["shoulder"] is not None:
        found["clavicle"] = _above(tree, found["shoulder"], side, "clavicle")
    found["wrist"] = _beneath(tree, elbow, side, "wrist")
    if found["wrist"] is not None:
        found["hand"] = _best_tip(tree, found["wrist"], side, "hand")
    return {part: joint for part, joint in found.items() if joint is not None}


def _leg(tree: _Tree, side: str) -> dict[str, int]:
    knee = _anchor(tree, side, "knee")
    if knee is None:
        return {}
    found = {"knee": knee, "hip": _above(tree, knee, side, "hip"), "ankle": _beneath(tree, knee, side, "ankle")}
    if found["ankle"] is not None:
        found["toe"] = _best_tip(tree, found["ankle"], side, "toe")
    return {part: joint for part, joint in found.items() if joint is not None}


def _best_tip(tree: _Tree, joint: int, side: str, part: str) -> int | None:
    """The joint below with the best word, however far; none if two have it."""
    ranked = sorted((rank, other) for other in tree.below(joint) if (rank := tree.rank(other, side, part)) is not None)
    if not ranked or (len(ranked) > 1 and ranked[0][0] == ranked[1][0]):
        return None
    return ranked[0][1]


def _trunk(tree: _Tree, pairs: Mapping[str, tuple[int, int]], *, taken: set[int]) -> dict[str, int]:
    """Hips, spine, chest, neck and head, from where the limbs meet."""
    crotch = tree.meet(*pairs["hip"]) if "hip" in pairs else None
    if crotch is None or crotch in taken:
        return {}
    # The joint named so where the legs meet or nearest above (a 3ds Max biped's legs hang from the spine); else that point.
    named = [joint for joint in (crotch, *tree.ancestors(crotch)) if _HIPS_WORDS & set(tree.centre(joint))]
    hips = named[0] if named else crotch
    roles = {"hips": hips}

    heads = [
        joint
        for joint in tree.below(hips)
        if "head" in tree.centre(joint) and not taken.intersection(tree.ancestors(joint))
    ]
    upper = pairs.get("clavicle") or pairs.get("shoulder")
    girdle = tree.meet(*upper) if upper else None
    top = girdle if girdle is not None else heads[0] if len(heads) == 1 else None
    if top is None or hips not in (top, *tree.ancestors(top)):
        return roles
    path = [top, *tree.ancestors(top)]
    trunk = path[: path.index(hips)]
    torso = [joint for joint in trunk if any(_TORSO.fullmatch(word) for word in tree.centre(joint))]
    if torso:
        roles["chest"] = torso[0]
        if len(torso) > 1:
            roles["spine"] = torso[-1]
    # A head sits on the trunk that carries the arms.
    if len(heads) == 1 and (not trunk or set(trunk) & set(tree.ancestors(heads[0]))):
        roles["head"] = heads[0]
        above = tree.ancestors(heads[0])
        necks = [joint for joint in above if any(_NECK.fullmatch(word) for word in tree.centre(joint))]
        if necks and hips in tree.ancestors(necks[-1]):
            roles["neck"] = necks[-1]
    return roles


def load_role_map(path: Path | str) -> dict[str, str]:
    """Read a role map: a TOML file with a table ``[roles]`` of role = "joint name".

    An empty name says that the skeleton has no such joint, whatever its names suggest.

    Raises
    ------
    ConfigError
        Naming the file and the key, if the file cannot be read, is not TOML, has no such table, or a key is not a role or
        a value not a string.
    """
    path = Path(path)
    try:
        document = parse_toml(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: is not TOML: {error}") from error
    table = document.get("roles")
    if not isinstance(table, dict):
        raise ConfigError(f'{path}: needs a table [roles] with lines such as left_knee = "LeftLeg"')
    for key, value in table.items():
        if key not in ROLES:
            raise ConfigError(f"{path}: [roles] {UnknownNameError('joint role', key, ROLES)}")
        if not isinstance(value, str):
            raise ConfigError(f"{path}: [roles] {key}: expected a joint name in quotes, not {value!r}")
    return dict(table)


def apply_role_map(skeleton: Skeleton, mapping: Mapping[str, str]) -> Skeleton:
    """The skeleton with the roles of a map laid over its own.

    A joint named in the map loses the role it had; a role mapped to an empty name is removed.

    Raises
    ------
    UnknownNameError
        If a role or a joint does not exist.
    SkeletonError
        If the map gives one joint two roles.
    """
    mapped: dict[str, int] = {}
    for role, name in mapping.items():
        if role not in ROLES:
            raise UnknownNameError("joint role", role, ROLES)
        if not name:
            continue
        if name not in skeleton.names:
            raise UnknownNameError(f"joint (for the role {role!r})", name, skeleton.names)
        joint = skeleton.names.index(name)
        twice = next((other for other, index in mapped.items() if index == joint), None)
        if twice:
            raise SkeletonError(f"the role map gives joint {name!r} two roles, {twice!r} and {role!r}")
        mapped[role] = joint
    kept = {
        role: joint for role, joint in skeleton.roles.items() if role not in mapping and joint not in mapped.values()
    }
    return skeleton.with_roles({role: {**kept, **mapped}[role] for role in ROLES if role in kept or role in mapped})
