from __future__ import annotations

import stat
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest

from benchmark.errors import ConfigError, MotionFileError
from benchmark.motion import bvh, quat, rotations
from benchmark.motion.clip import MotionClip
from benchmark.motion.skeleton import EndSite, Skeleton

# Three joints in a row with different channel orders; positions below are worked out by hand.
TINY = """HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Arm
  {
    OFFSET 0 10 0
    CHANNELS 3 Xrotation Yrotation Zrotation
    JOINT Hand
    {
      OFFSET 0 0 5
      CHANNELS 1 Yrotation
      End Site
      {
        OFFSET 2 0 0
      }
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.04
1 2 3 90 0 0 90 0 0 0
1 2 3 90 90 0 0 0 0 90
"""


def write(folder: Path, text: str | bytes, name: str = "clip.bvh") -> Path:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def tiny(folder: Path, **kwargs: object) -> MotionClip:
    return bvh.load(write(folder, TINY), unit="m", **kwargs)  # type: ignore[arg-type]


def test_world_positions_are_those_worked_out_by_hand(tmp_path: Path) -> None:
    clip = tiny(tmp_path)
    # Frame 0. Rz(90) takes y to -x: the arm is at (1-10, 2, 3). In the arm's frame Rx(90) takes z to -y, and Rz(90) takes
    # that to +x: the hand is 5 further along x.
    np.testing.assert_allclose(clip.positions[0], [[1, 2, 3], [-9, 2, 3], [-4, 2, 3]], atol=1e-12)
    # Frame 1. R = Rz Rx: Rx(90) takes y to z, which Rz leaves: the arm is 10 along z. (Rx Rz would put it at -10 x.)
    # z goes to -y by Rx, then to +x by Rz: the hand is 5 along x.
    np.testing.assert_allclose(clip.positions[1], [[1, 2, 3], [1, 2, 13], [6, 2, 13]], atol=1e-12)
    # The tip hangs 2 along the hand's x. Ry(90) takes x to -z, which Rz Rx takes to -x.
    world, position = clip.world
    np.testing.assert_allclose(position[1, 2] + quat.rotate(world[1, 2], clip.skeleton.end_sites[0].offset), [4, 2, 13])


def test_what_a_clip_holds(tmp_path: Path) -> None:
    clip = tiny(tmp_path)
    assert clip.skeleton.names == ("Hips", "Arm", "Hand")
    assert clip.skeleton.parents.tolist() == [-1, 0, 1]
    assert clip.skeleton.orders == ("ZXY", "XYZ", "YZX")
    assert clip.skeleton.end_sites == (EndSite(2, (2.0, 0.0, 0.0)),)
    assert clip.fps == 25.0
    assert clip.meta.source.endswith("clip.bvh")
    assert clip.translations is None
    assert clip.source is not None
    assert clip.source.channels[2] == ("Yrotation",)
    assert clip.source.values.tolist()[1] == [1, 2, 3, 90, 90, 0, 0, 0, 0, 90]
    assert not clip.source.values.flags.writeable


@pytest.mark.parametrize(
    ("unit", "metres"), [("m", 1.0), ("cm", 0.01), ("mm", 0.001), ("cmu", 0.0254 / 0.45), ("inch", 0.0254), (0.5, 0.5)]
)
def test_units(tmp_path: Path, unit: str | float, metres: float) -> None:
    clip = bvh.load(write(tmp_path, TINY), unit=unit)
    np.testing.assert_allclose(clip.root[0], np.array([1, 2, 3]) * metres)
    np.testing.assert_allclose(clip.skeleton.offsets[1], [0, 10 * metres, 0])
    np.testing.assert_allclose(clip.skeleton.end_sites[0].offset, [2 * metres, 0, 0])


@pytest.mark.parametrize("unit", ["furlong", 0.0, -1.0, float("nan"), float("inf")])
def test_unknown_units_are_refused(tmp_path: Path, unit: str | float) -> None:
    with pytest.raises(ConfigError, match="unit must be"):
        bvh.load(write(tmp_path, TINY), unit=unit)


@pytest.mark.parametrize(("scale", "metres"), [(1, 0.056444), (10, 0.01), (100, 0.001), (0.1, 1.0)])
def test_without_roles_the_longest_chain_tells_the_unit(tmp_path: Path, scale: float, metres: float) -> None:
    text = (
        TINY.replace("0 10 0", f"0 {10 * scale} 0")
        .replace("0 0 5", f"0 0 {5 * scale}")
        .replace("2 0 0", f"{2 * scale} 0 0")
    )
    clip = bvh.load(write(tmp_path, text.replace("Arm", "a1").replace("Hand", "a2").replace("Hips", "a0")))
    assert clip.source is not None
    np.testing.assert_allclose(clip.source.unit, metres, rtol=1e-4)


def test_one_lonely_joint_loads(tmp_path: Path) -> None:
    text = "HIERARCHY\nROOT a\n{\nOFFSET 0 0 0\nCHANNELS 1 Yrotation\n}\nMOTION\nFrames: 1\nFrame Time: 1\n90\n"
    clip = bvh.load(write(tmp_path, text))
    np.testing.assert_allclose(clip.rotations[0, 0], [np.sqrt(0.5), 0, np.sqrt(0.5), 0])


def test_a_unit_that_cannot_be_told_names_the_file(tmp_path: Path) -> None:
    def limb(side: str) -> str:
        return (
            f"JOINT {side}UpLeg\n{{\nOFFSET 1 0 0\nCHANNELS 0\nJOINT {side}Leg\n{{\nOFFSET 0 -16 0\nCHANNELS 0\n"
            f"JOINT {side}Foot\n{{\nOFFSET 0 -20 0\nCHANNELS 0\n}}\n}}\n}}\n"
        )

    text = "HIERARCHY\nROOT Hips\n{\nOFFSET 0 0 0\nCHANNELS 1 Yrotation\n" + limb("Left") + limb("Right")
    path = write(tmp_path, text + "}\nMOTION\nFrames: 1\nFrame Time: 1\n90\n")
    with pytest.raises(MotionFileError, match=r"clip\.bvh: .*unit") as caught:
        bvh.load(path)
    assert "36" in str(caught.value)
    assert bvh.load(path, unit="inch").skeleton.leg_length == pytest.approx(36 * 0.0254)


def test_role_map_names_joints(tmp_path: Path) -> None:
    clip = tiny(tmp_path, role_map={"head": "Hand"})
    assert clip.skeleton.joint("head") == 2


VARIANTS = {
    "CRLF": lambda text: text.replace("\n", "\r\n"),
    "CRLF converted twice": lambda text: text.replace("\n", "\r\r\n"),
    "CR": lambda text: text.replace("\n", "\r"),
    "BOM": lambda text: "\ufeff" + text,
    "tabs": lambda text: (
        text.replace("  ", "\t").replace(" ", "\t").replace("End\tSite", "End Site").replace("Frame\t", "Frame ")
    ),
    "no newline at the end": lambda text: text.rstrip("\n"),
    "blank lines": lambda text: text.replace("\n", "\n\n \n"),
    "blank lines at the end": lambda text: text + "\n\n  \n",
    "trailing blanks": lambda text: text.replace("\n", "  \n"),
    "leading blanks": lambda text: "\n".join("   " + line for line in text.split("\n")),
    "upper case": lambda text: text.upper().replace("HIPS", "Hips").replace("ARM", "Arm").replace("HAND", "Hand"),
    "lower case": lambda text: text.lower().replace("hips", "Hips").replace("arm", "Arm").replace("hand", "Hand"),
    "braces on the line of the name": lambda text: (
        text.replace("\n{", " {").replace("\n  {", "{").replace("\n    {", "  {")
    ),
    "EndSite in one word": lambda text: text.replace("End Site", "EndSite"),
    "no blank after the colon": lambda text: text.replace("Frames: ", "Frames:").replace("Time: ", "Time:"),
    "a blank before the colon": lambda text: text.replace("Frames: ", "Frames : ").replace("Time: ", "Time :\t"),
    "exponents": lambda text: text.replace("1 2 3 90", "1e0 +.2E+1 30.e-1 9.0e+001"),
    "decimals": lambda text: text.replace("1 2 3 90", "1.000000 2.0000000000 3.00000000000000000000 90."),
    "several blanks between values": lambda text: text.replace("90 90 0", "90   90 \t 0"),
    "channels over two lines": lambda text: text.replace("Zposition Zrotation", "Zposition\n    Zrotation"),
}


@pytest.mark.parametrize("variant", VARIANTS)
def test_variants_seen_in_the_wild_read_the_same(tmp_path: Path, variant: str) -> None:
    expected = tiny(tmp_path)
    text = VARIANTS[variant](TINY)
    assert text != TINY
    clip = bvh.load(write(tmp_path, text, "variant.bvh"), unit="m")
    assert expected.source is not None
    assert clip.source is not None
    np.testing.assert_array_equal(clip.source.values, expected.source.values)
    assert clip.skeleton == expected.skeleton
    assert clip.fps == expected.fps


@pytest.mark.parametrize("name", ["Left Arm", "mixamorig:Arm", "腕", "arm.L", "a-b#c", "JOINT", "Arm OFFSET", "é"])
def test_odd_joint_names_survive(tmp_path: Path, name: str) -> None:
    clip = bvh.load(write(tmp_path, TINY.replace("Arm", name)), unit="m")
    assert clip.skeleton.names[1] == name
    bvh.save(clip, tmp_path / "again.bvh")
    assert bvh.load(tmp_path / "again.bvh", unit="m").skeleton.names[1] == name


def test_names_in_latin_1_are_read(tmp_path: Path) -> None:
    clip = bvh.load(write(tmp_path, TINY.replace("Arm", "Fuß").encode("latin-1")), unit="m")
    assert clip.skeleton.names[1] == "Fuß"


@pytest.mark.parametrize(
    ("printed", "fps"),
    [
        ("0.0333333", 30.0),
        ("0.033333", 30.0),
        ("0.0333", 30.0),
        ("0.00833", 120.0),
        ("0.008333", 120.0),
        ("0.016666", 60.0),
        ("0.016667", 60.0),
        ("0.04", 25.0),
        ("0.01", 100.0),
        ("1", 1.0),
        ("2", 0.5),
        ("0.6", 1.0 / 0.6),
        ("0.033367", 1.0 / 0.033367),
        ("0.041708", 1.0 / 0.041708),
        ("0.0083", 1.0 / 0.0083),
        ("8.3333e-3", 120.0),
    ],
)
def test_frame_times_become_the_rate_they_are_a_rounding_of(tmp_path: Path, printed: str, fps: float) -> None:
    clip = bvh.load(write(tmp_path, TINY.replace("0.04", printed)), unit="m")
    assert clip.fps == fps
    bvh.save(clip, tmp_path / "again.bvh")
    again = bvh.load(tmp_path / "again.bvh", unit="m")
    assert again.fps == fps
    assert again.source is not None
    assert again.source.frame_time == float(printed)
    bvh.save(clip.replace(fps=59.94), tmp_path / "faster.bvh")
    assert bvh.load(tmp_path / "faster.bvh", unit="m").fps == pytest.approx(59.94, rel=1e-14)


# ---- positions of joints other than the root

SLIDING = """HIERARCHY
ROOT Hips
{
OFFSET 7 7 7
CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
JOINT Spine
{
OFFSET 0 10 0
CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
JOINT Head
{
OFFSET 0 5 0
CHANNELS 4 Yposition Zrotation Xrotation Yrotation
}
}
}
MOTION
Frames: 3
Frame Time: 0.04
0 0 0 0 0 0  0 A 0 0 0 0  5 0 0 0
0 0 0 0 0 0  0 B 0 0 0 0  5 0 0 0
0 0 0 0 0 0  0 C 0 0 0 0  5 0 0 0
"""


def sliding(folder: Path, a: str, b: str, c: str) -> MotionClip:
    text = SLIDING.replace(" A ", f" {a} ").replace(" B ", f" {b} ").replace(" C ", f" {c} ")
    return bvh.load(write(folder, text), unit="m")


def test_positions_replace_offsets(tmp_path: Path) -> None:
    clip = sliding(tmp_path, "10", "10", "10")
    assert clip.translations is None
    np.testing.assert_allclose(clip.positions, np.broadcast_to([[0, 0, 0], [0, 10, 0], [0, 15, 0]], (3, 3, 3)))


def test_constant_positions_become_the_rest_offset(tmp_path: Path) -> None:
    clip = sliding(tmp_path, "12", "12", "12")
    assert clip.translations is None
    np.testing.assert_allclose(clip.skeleton.offsets[1], [0, 12, 0])
    assert clip.source is not None
    np.testing.assert_allclose(clip.source.offsets[1], [0, 10, 0])
    bvh.save(clip, tmp_path / "again.bvh")
    assert "OFFSET 0 10 0" in (tmp_path / "again.bvh").read_text()
    assert bvh.load(tmp_path / "again.bvh", unit="m").skeleton == clip.skeleton


def test_printing_noise_is_no_motion(tmp_path: Path) -> None:
    clip = sliding(tmp_path, "10.000010", "9.999990", "10")
    assert clip.translations is None
    np.testing.assert_array_equal(clip.skeleton.offsets[1], [0, 10, 0])


def test_moving_positions_become_translations(tmp_path: Path) -> None:
    clip = sliding(tmp_path, "10", "11", "12")
    assert clip.translations is not None
    np.testing.assert_allclose(clip.translations[:, 1, 1], [10, 11, 12])
    np.testing.assert_allclose(clip.translations[:, 2], [[0, 5, 0]] * 3)
    np.testing.assert_allclose(clip.positions[:, 2, 1], [15, 16, 17])
    bvh.save(clip, tmp_path / "again.bvh")
    again = bvh.load(tmp_path / "again.bvh", unit="m")
    np.testing.assert_array_equal(again.translations, clip.translations)
    # The positions are kept when only rotations change, and the other way round.
    turned = clip.replace(rotations=quat.mul(clip.rotations, quat.exp([0.1, 0.2, 0.3])))
    bvh.save(turned, tmp_path / "turned.bvh")
    again = bvh.load(tmp_path / "turned.bvh", unit="m")
    np.testing.assert_array_equal(again.translations, clip.translations)
    moved = clip.replace(translations=clip.translations + 1.0)
    bvh.save(moved, tmp_path / "moved.bvh")
    again = bvh.load(tmp_path / "moved.bvh", unit="m")
    np.testing.assert_allclose(again.translations[:, 1:], moved.translations[:, 1:], atol=1e-8)
    assert again.source is not None
    assert again.source.channels[2][:3] == ("Xposition", "Yposition", "Zposition")


# ---- saving


def random_clip(rng: np.random.Generator, orders: tuple[str, ...], frames: int = 40, **kwargs: object) -> MotionClip:
    joints = len(orders)
    parents = np.array([-1, *(int(rng.integers(0, joint)) for joint in range(1, joints))])
    skeleton = Skeleton(
        tuple(f"joint {i}" for i in range(joints)),
        parents,
        rng.normal(0, 0.2, (joints, 3)),
        (EndSite(joints - 1, (0.0, 0.1, 0.0)), EndSite(joints - 1, (0.1, 0.0, 0.0))),
        orders,
    )
    steps = quat.exp(rng.normal(0, 0.3, (frames, joints, 3)))
    turns = np.empty((frames, joints, 4))
    turns[0] = quat.normalize(rng.normal(size=(joints, 4)))
    for t in range(1, frames):
        turns[t] = quat.mul(turns[t - 1], steps[t])
    return MotionClip(skeleton, quat.normalize(turns), rng.normal(size=(frames, 3)), 30.0, **kwargs)  # type: ignore[arg-type]


def by_name(clip: MotionClip, names: tuple[str, ...]) -> list[int]:
    return [clip.skeleton.names.index(name) for name in names]


@pytest.mark.parametrize("order", rotations.EULER_ORDERS)
def test_a_clip_without_source_comes_back(tmp_path: Path, order: str, rng: np.random.Generator) -> None:
    clip = random_clip(rng, (order,) * 7)
    bvh.save(clip, tmp_path / "out.bvh")
    again = bvh.load(tmp_path / "out.bvh", unit="cm")
    at = by_name(again, clip.skeleton.names)
    assert quat.angle(again.rotations[:, at], clip.rotations).max() < 1e-9
    np.testing.assert_allclose(again.root, clip.root, atol=1e-9)
    np.testing.assert_allclose(again.skeleton.offsets[at], clip.skeleton.offsets, atol=1e-9)
    np.testing.assert_allclose(again.positions[:, at], clip.positions, atol=1e-8)
    assert set(again.skeleton.orders) == {order}
    assert again.fps == clip.fps
    assert again.source is not None
    assert [len(names) for names in again.source.channels] == [6, *[3] * 6]
    assert again.source.channels[0] == ("Xposition", "Yposition", "Zposition", *(f"{axis}rotation" for axis in order))
    # Curves run on: no step is longer than the motion itself makes it at these rates.
    bvh.save(again, tmp_path / "again.bvh")
    assert (tmp_path / "again.bvh").read_bytes() == (tmp_path / "out.bvh").read_bytes()


def test_different_orders_on_each_joint(tmp_path: Path, rng: np.random.Generator) -> None:
    clip = random_clip(rng, tuple("".join(order) for order in permutations("XYZ")))
    bvh.save(clip, tmp_path / "out.bvh")
    again = bvh.load(tmp_path / "out.bvh", unit="cm")
    at = by_name(again, clip.skeleton.names)
    assert quat.angle(again.rotations[:, at], clip.rotations).max() < 1e-9
    assert tuple(again.skeleton.orders[i] for i in at) == clip.skeleton.orders
    np.testing.assert_allclose(again.positions[:, at], clip.positions, atol=1e-8)


def test_translations_without_source_come_back(tmp_path: Path, rng: np.random.Generator) -> None:
    clip = random_clip(rng, ("ZXY",) * 4)
    clip = clip.replace(translations=clip.skeleton.offsets + rng.normal(0, 0.01, (len(clip), 4, 3)))
    bvh.save(clip, tmp_path / "out.bvh")
    again = bvh.load(tmp_path / "out.bvh", unit="cm")
    at = by_name(again, clip.skeleton.names)
    assert again.translations is not None
    np.testing.assert_allclose(again.translations[:, at[1:]], clip.translations[:, 1:], atol=1e-9)
    np.testing.assert_allclose(again.positions[:, at], clip.positions, atol=1e-8)


def test_curves_are_continuous(tmp_path: Path) -> None:
    """Three turns about one axis and a swing through gimbal lock: no jump, although principal angles would jump."""
    t = np.linspace(0.0, 1.0, 400)
    angles = np.stack([6 * np.pi * t, np.pi * np.sin(2 * np.pi * t), 2.5 * np.pi * t], axis=-1)
    for order in rotations.EULER_ORDERS:
        skeleton = Skeleton(("a",), np.array([-1]), np.zeros((1, 3)), orders=(order,))
        q = rotations.from_euler(angles, order)[:, None]
        bvh.save(MotionClip(skeleton, q, np.zeros((400, 3)), 60.0), tmp_path / "out.bvh")
        again = bvh.load(tmp_path / "out.bvh", unit="cm")
        assert again.source is not None
        written = again.source.values[:, 3:]
        assert np.abs(np.diff(written, axis=0)).max() < 1.05 * np.degrees(np.abs(np.diff(angles, axis=0)).max())
        assert np.abs(np.diff(np.degrees(rotations.to_euler(q[:, 0], order)), axis=0)).max() > 170.0
        assert quat.angle(again.rotations, q).max() < 1e-9


def test_staying_at_gimbal_lock_does_not_jump(tmp_path: Path) -> None:
    angles = np.zeros((30, 3))
    angles[:, 0] = np.linspace(0.0, 0.3, 30)
    angles[:, 1] = np.minimum(np.linspace(1.2, 1.8, 30), np.pi / 2)
    angles[:, 2] = 0.7
    skeleton = Skeleton(("a",), np.array([-1]), np.zeros((1, 3)), orders=("YXZ",))
    q = rotations.from_euler(angles, "YXZ")[:, None]
    bvh.save(MotionClip(skeleton, q, np.zeros((30, 3)), 60.0), tmp_path / "out.bvh")
    again = bvh.load(tmp_path / "out.bvh", unit="cm")
    assert again.source is not None
    assert np.abs(np.diff(again.source.values[:, 3:], axis=0)).max() < 2.0
    assert quat.angle(again.rotations, q).max() < 1e-9


JUMPING = TINY.replace("Frames: 2", "Frames: 5").split("1 2 3")[0] + (
    "1 2 3 179.5 10 20 0 0 0 0\n"
    "1 2 3 -179.5 10 20 5 0 0 0\n"
    "1 2 3 541.25 10 20 5 90 7 0\n"
    "1 2 3 1.25 170 200 5 90 7 -400\n"
    "1 2 3 0.1234567890123 1e-9 20 5 -0 7 0\n"
)


def test_unchanged_channels_come_back_to_the_bit(tmp_path: Path) -> None:
    clip = bvh.load(write(tmp_path, JUMPING), unit="m")
    bvh.save(clip, tmp_path / "again.bvh")
    again = bvh.load(tmp_path / "again.bvh", unit="m")
    assert clip.source is not None
    assert again.source is not None
    np.testing.assert_array_equal(again.source.values, clip.source.values)
    np.testing.assert_array_equal(np.signbit(again.source.values), np.signbit(clip.source.values))
    np.testing.assert_array_equal(again.rotations, clip.rotations)
    flipped = clip.replace(rotations=-clip.rotations)
    bvh.save(flipped, tmp_path / "flipped.bvh")
    assert (tmp_path / "flipped.bvh").read_bytes() == (tmp_path / "again.bvh").read_bytes()


def test_only_what_changed_is_written_anew(tmp_path: Path) -> None:
    clip = bvh.load(write(tmp_path, JUMPING), unit="m")
    turned = clip.rotations.copy()
    turned[3, 0] = quat.mul(quat.exp([0.0, 1e-6, 0.0]), turned[3, 0])
    turned[4, 0] = quat.mul(quat.exp([0.0, 0.0, 0.1]), turned[4, 0])
    bvh.save(clip.replace(rotations=turned), tmp_path / "again.bvh")
    again = bvh.load(tmp_path / "again.bvh", unit="m")
    assert clip.source is not None
    assert again.source is not None
    old, new = clip.source.values, again.source.values
    np.testing.assert_array_equal(new[:3], old[:3])
    np.testing.assert_array_equal(new[:, 6:], old[:, 6:])
    assert quat.angle(again.rotations, turned).max() < 1e-9
    # The first changed frame stays on the turn of the frame before it, which was written as 541 degrees.
    assert abs(new[3, 3] - old[2, 3]) <= 180.0
    assert not np.array_equal(new[3, 3:6], old[3, 3:6])


def test_layout_survives_resampling_and_edits_of_length(tmp_path: Path) -> None:
    clip = bvh.load(write(tmp_path, JUMPING), unit="m")
    bvh.save(clip.frames(1, 4), tmp_path / "cut.bvh")
    cut = bvh.load(tmp_path / "cut.bvh", unit="m")
    assert clip.source is not None
    assert cut.source is not None
    np.testing.assert_array_equal(cut.source.values, clip.source.values[1:4])
    shorter = clip.replace(rotations=clip.rotations[::2], root=clip.root[::2], fps=12.5)
    bvh.save(shorter, tmp_path / "shorter.bvh")
    again = bvh.load(tmp_path / "shorter.bvh", unit="m")
    assert again.source is not None
    assert again.source.channels == clip.source.channels
    assert again.fps == 12.5
    assert quat.angle(again.rotations, shorter.rotations).max() < 1e-9


def test_too_few_channels_grow_to_hold_the_motion(tmp_path: Path) -> None:
    clip = tiny(tmp_path)
    turned = clip.rotations.copy()
    turned[:, 2] = quat.exp([0.1, 0.2, 0.3])
    bvh.save(clip.replace(rotations=turned), tmp_path / "out.bvh")
    again = bvh.load(tmp_path / "out.bvh", unit="m")
    assert again.source is not None
    assert again.source.channels[2] == ("Yrotation", "Zrotation", "Xrotation")
    assert quat.angle(again.rotations, turned).max() < 1e-9
    turned[:, 2] = quat.exp([0.0, 0.5, 0.0])
    bvh.save(clip.replace(rotations=turned), tmp_path / "out.bvh")
    again = bvh.load(tmp_path / "out.bvh", unit="m")
    assert again.source is not None
    assert again.source.channels[2] == ("Yrotation",)
    assert quat.angle(again.rotations, turned).max() < 1e-9


def test_a_root_without_position_channels_gets_them_when_it_moves(tmp_path: Path) -> None:
    text = "HIERARCHY\nROOT a\n{\nOFFSET 1 2 3\nCHANNELS 1 Yrotation\n}\nMOTION\nFrames: 1\nFrame Time: 1\n90\n"
    clip = bvh.load(write(tmp_path, text), unit="m")
    np.testing.assert_array_equal(clip.root, [[1, 2, 3]])
    bvh.save(clip, tmp_path / "same.bvh")
    assert "CHANNELS 1 Yrotation" in (tmp_path / "same.bvh").read_text()
    bvh.save(clip.replace(root=clip.root + 1.0), tmp_path / "moved.bvh")
    np.testing.assert_allclose(bvh.load(tmp_path / "moved.bvh", unit="m").root, [[2, 3, 4]])


def test_other_bone_lengths_are_written(tmp_path: Path) -> None:
    clip = tiny(tmp_path)
    child = clip.replace(skeleton=clip.skeleton.scaled(0.7), root=clip.root * 0.7)
    bvh.save(child, tmp_path / "child.bvh")
    again = bvh.load(tmp_path / "child.bvh", unit="m")
    np.testing.assert_allclose(again.positions, child.positions, atol=1e-8)
    np.testing.assert_allclose(again.skeleton.end_sites[0].offset, [1.4, 0, 0], atol=1e-8)


def test_a_source_of_another_skeleton_is_ignored(tmp_path: Path, rng: np.random.Generator) -> None:
    clip = random_clip(rng, ("XYZ",) * 3).replace(source=tiny(tmp_path).source)
    bvh.save(clip, tmp_path / "out.bvh")
    again = bvh.load(tmp_path / "out.bvh", unit="cm")
    np.testing.assert_allclose(again.positions[:, by_name(again, clip.skeleton.names)], clip.positions, atol=1e-8)


@pytest.mark.parametrize("name", ["", " a", "a\n", "a{", "}", "a\x00", "\ud800"])
def test_names_that_would_not_read_back_are_refused(tmp_path: Path, name: str) -> None:
    skeleton = Skeleton((name,), np.array([-1]), np.zeros((1, 3)))
    with pytest.raises(MotionFileError, match="joint name"):
        bvh.save(MotionClip(skeleton, quat.identity(1, 1), np.zeros((1, 3)), 30.0), tmp_path / "out.bvh")
    assert list(tmp_path.iterdir()) == []


def test_positions_that_would_not_read_back_are_refused(tmp_path: Path) -> None:
    clip = tiny(tmp_path)
    with pytest.raises(MotionFileError, match=r"at most 1e\+12 can be read back"):
        bvh.save(clip.replace(root=clip.root + 1e13), tmp_path / "far.bvh")


def test_saving_is_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clip = tiny(tmp_path)
    path = write(tmp_path, "precious", "out.bvh")

    def fail(self: Path, target: Path) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", fail)
    with pytest.raises(MotionFileError, match="No space left"):
        bvh.save(clip, path)
    assert path.read_text() == "precious"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["clip.bvh", "out.bvh"]


def test_saving_where_it_cannot(tmp_path: Path) -> None:
    clip = tiny(tmp_path)
    with pytest.raises(MotionFileError, match="folder does not exist"):
        bvh.save(clip, tmp_path / "nowhere" / "out.bvh")
    with pytest.raises(MotionFileError, match="a folder"):
        bvh.save(clip, tmp_path)


def test_a_link_stays_a_link_and_modes_follow_the_umask(tmp_path: Path) -> None:
    clip = tiny(tmp_path)
    (tmp_path / "link.bvh").symlink_to(tmp_path / "real.bvh")
    bvh.save(clip, tmp_path / "link.bvh")
    assert (tmp_path / "link.bvh").is_symlink()
    plain = write(tmp_path, "x", "plain")
    assert stat.S_IMODE((tmp_path / "real.bvh").stat().st_mode) == stat.S_IMODE(plain.stat().st_mode)


def test_a_chain_of_thousands_of_joints(tmp_path: Path) -> None:
    joints = 5000
    skeleton = Skeleton(tuple(f"j{i}" for i in range(joints)), np.arange(-1, joints - 1), np.ones((joints, 3)))
    clip = MotionClip(skeleton, quat.identity(2, joints), np.zeros((2, 3)), 30.0)
    bvh.save(clip, tmp_path / "deep.bvh")
    again = bvh.load(tmp_path / "deep.bvh", unit="cm")
    assert again.skeleton.parents.tolist() == skeleton.parents.tolist()


# ---- real captures


@pytest.mark.real_data
def test_every_bandai_namco_file_comes_back(bandai_namco: Path, tmp_path: Path) -> None:
    files = sorted(bandai_namco.rglob("*.bvh"))
    assert len(files) == 144
    for path in files:
        clip = bvh.load(path)
        assert clip.source is not None
        assert clip.source.unit == 0.01
        assert clip.fps == 30.0
        assert 0.79 < clip.skeleton.leg_length < 0.81  # doubled bones would give 1.6
        bvh.save(clip, tmp_path / "again.bvh")
        again = bvh.load(tmp_path / "again.bvh")
        assert again.source is not None
        np.testing.assert_array_equal(again.source.values, clip.source.values)
        np.testing.assert_array_equal(again.rotations, clip.rotations)
        np.testing.assert_array_equal(again.source.offsets, clip.source.offsets)
        assert again.source.channels == clip.source.channels
        assert again.source.frame_time == clip.source.frame_time
        assert again.skeleton == clip.skeleton


@pytest.mark.real_data
def test_bandai_namco_stands_on_its_feet(bandai_namco: Path) -> None:
    clip = bvh.load(next(bandai_namco.rglob("dataset-1_walk-left_tired_001.bvh")))
    hips, head, *ankles = clip.skeleton.joints("hips", "head", "left_ankle", "right_ankle")
    height = clip.positions[:, :, 1]
    assert np.all(height[:, head] > height[:, hips])
    assert 0.0 < height[:, ankles].min() < 0.2
    assert 1.2 < (height[:, head] - height[:, ankles].min()).max() < 1.8
    assert clip.translations is not None
    moving = np.ptp(clip.translations, axis=0).max(axis=-1) > 0
    assert [clip.skeleton.names[i] for i in np.flatnonzero(moving)] == ["Hips"]


@pytest.mark.real_data
def test_bandai_namco_rewritten_from_quaternions(bandai_namco: Path, tmp_path: Path) -> None:
    for path in sorted(bandai_namco.rglob("*.bvh"))[::24]:
        clip = bvh.load(path)
        bvh.save(clip.replace(source=None), tmp_path / "bare.bvh")
        again = bvh.load(tmp_path / "bare.bvh", unit="cm")
        assert quat.angle(again.rotations, clip.rotations).max() < 1e-9
        np.testing.assert_allclose(again.positions, clip.positions, atol=1e-8)
        assert again.source is not None
        columns = np.concatenate([np.arange(3, 6) + 6 * joint for joint in range(22)])
        assert np.abs(np.diff(again.source.values[:, columns], axis=0)).max() < 180.0 + 1e-6
