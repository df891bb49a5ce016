"""Kinect files: read strictly, put on a clock and on a skeleton."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from benchmark.errors import ConfigError, MotionFileError
from benchmark.motion import quat
from benchmark.motion.ik import rotations_from_positions
from benchmark.motion.kinect import (
    JOINTS,
    MAX_BYTES,
    KinectRecord,
    load,
    measure_skeleton,
    read,
    repair_clock,
)
from benchmark.motion.kinematics import fk
from benchmark.motion.roles import find_roles
from benchmark.motion.skeleton import CORE_ROLES, Skeleton

HEADER = ",".join(("Timestamp", *(f"{joint}{axis}" for joint in JOINTS for axis in "XYZ"), "User-ID", "Action", ""))
NAME = "POSE-p{actor}_03-Wave-your-hand-1466764269111.csv"
Write = Callable[..., Path]


def lengths_of(height: float) -> np.ndarray:
    """(20,) bone lengths of an actor."""
    by_part = {
        "Spine": 0.05,
        "ShoulderCenter": 0.22,
        "Head": 0.12,
        "Shoulder": 0.12,
        "Elbow": 0.16,
        "Wrist": 0.14,
        "Hand": 0.05,
    }
    by_part |= {"Hip": 0.07, "Knee": 0.28, "Ankle": 0.23, "Foot": 0.06, "HipCenter": 0.0}
    return height * np.array(
        [by_part.get(name, by_part.get(name.removesuffix("Left").removesuffix("Right"))) for name in JOINTS]
    )


def actor(height: float) -> Skeleton:
    """A rigid actor built by scaling the bones of a measured one."""
    some = np.random.default_rng(3).normal(size=(4, 20, 3)) * 0.1
    record = _skeleton_of(some)
    unit = record.offsets / np.maximum(record.bone_lengths, 1e-9)[:, None]
    unit[0] = 0.0
    return record.with_offsets(unit * lengths_of(height)[:, None])


def _skeleton_of(positions: np.ndarray) -> Skeleton:
    from benchmark.motion.kinect import _skeleton

    return _skeleton(positions)


def motion(frames: int, *, seed: int = 0, height: float = 1.6) -> np.ndarray:
    """(frames, 20, 3) world positions of an actor facing +Z, 3 m before the sensor."""
    rng = np.random.default_rng(seed)
    time = np.arange(frames)[:, None, None] / 30.0
    swing = rng.normal(scale=0.25, size=(20, 3)) * np.sin(2 * np.pi * (0.5 * time + rng.uniform(size=(20, 3))))
    root = np.array([0.1, 0.2, -3.0]) + 0.02 * np.sin(2 * np.pi * time[:, 0] * [0.4, 0.8, 0.3])
    return fk(actor(height), quat.exp(swing), root)[1]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def make(
        positions: np.ndarray,
        *,
        stamps: np.ndarray | None = None,
        folder: str = "Children",
        name: str | None = None,
        number: str = "337",
        action: str = "Wave-your-hand",
    ) -> Path:
        stamps = 37861731.775 + np.arange(len(positions)) * 100.0 / 3.0 if stamps is None else stamps
        raw = positions * [-1.0, 1.0, -1.0]
        rows = [
            ",".join([repr(float(stamp)), *(repr(float(x)) for x in frame.ravel()), number, action, ""])
            for stamp, frame in zip(stamps, raw, strict=True)
        ]
        path = tmp_path / folder / (name or NAME.format(actor=number))
        path.parent.mkdir(exist_ok=True)
        path.write_text("\n".join([HEADER, *rows]) + "\n")
        return path

    return make


def edit(path: Path, line: int, change: Callable[[str], str]) -> Path:
    lines = path.read_text().splitlines()
    lines[line - 1] = change(lines[line - 1])
    path.write_text("\n".join(lines) + "\n")
    return path


def field(column: int, value: str) -> Callable[[str], str]:
    def change(line: str) -> str:
        fields = line.split(",")
        fields[column] = value
        return ",".join(fields)

    return change


# Reading.


def test_read(write: Write) -> None:
    positions = motion(40)
    record = read(write(positions))
    assert isinstance(record, KinectRecord)
    np.testing.assert_allclose(record.positions, positions, atol=1e-15)
    assert record.timestamps[0] == pytest.approx(37861.731775)
    assert (record.actor, record.style, record.action, record.names) == ("337", "child", "wave-your-hand", JOINTS)
    assert record.meta.clip_id == "child/337/wave-your-hand_1"
    assert record.meta.source == "Children/POSE-p337_03-Wave-your-hand-1466764269111.csv"


def test_half_turn_about_y_is_a_rotation_not_a_mirror(write: Write) -> None:
    """In the sensor's frame the toes point at the sensor (-Z) and the left is at -X."""
    path = write(motion(30))
    raw = np.array([float(x) for x in path.read_text().splitlines()[1].split(",")[1:61]]).reshape(20, 3)
    read_back = read(path).positions[0]
    turn = read_back.T @ np.linalg.pinv(raw.T)
    assert np.linalg.det(turn) == pytest.approx(1.0)
    left, right = JOINTS.index("HipLeft"), JOINTS.index("HipRight")
    assert raw[left, 0] < raw[right, 0] and read_back[left, 0] > read_back[right, 0]
    assert read_back[JOINTS.index("FootLeft"), 2] > read_back[JOINTS.index("AnkleLeft"), 2]


def test_unconventional_name_uses_the_columns(write: Write) -> None:
    record = read(write(motion(10), folder="anything", name="some.csv", action="Throw-a-ball-"))
    assert (record.actor, record.style, record.action) == ("337", "", "throw-a-ball")


def test_windows_line_ends(write: Write) -> None:
    path = write(motion(10))
    expected = read(path).positions
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    np.testing.assert_array_equal(read(path).positions, expected)


@pytest.mark.parametrize(
    ("line", "change", "words"),
    [
        (3, field(1, "abc"), r"line 3: field HipCenterX is 'abc'"),
        (3, field(60, "nan"), r"line 3: field FootRightZ is 'nan'"),
        (4, field(0, "inf"), r"line 4: field Timestamp is 'inf'"),
        (4, field(0, ""), r"line 4: field Timestamp is ''"),
        (5, field(7, "1_0"), r"line 5: field ShoulderCenterX is '1_0'"),
        (5, field(7, "1e400"), r"line 5: field ShoulderCenterX is '1e400'"),
        (6, field(8, "1650.2"), r"line 6: field ShoulderCenterY is 1650.2 m, beyond"),
        (7, field(61, "338"), r"line 7: field User-ID is '338' here and '337' on line 2"),
        (7, field(62, "Bow"), r"line 7: field Action is 'Bow' here"),
        (2, field(62, ""), r"line 2: field Action is empty"),
        (8, lambda line: line.rsplit(",", 3)[0], r"line 8: expected 63 fields and a trailing comma, found 61"),
        (8, lambda line: line + "7", r"line 8: expected 63 fields and a trailing comma"),
        (8, lambda line: "", r"line 8: expected 63 fields and a trailing comma, found 1"),
        (
            1,
            field(4, "Spine_X"),
            r"line 1: column 5 of the header should be 'SpineX', not 'Spine_X'; missing columns: SpineX",
        ),
        (1, lambda line: line.replace("KneeLeftY,", ""), r"missing columns: KneeLeftY"),
        (1, lambda line: line + "more", r"line 1: column 64 .* not 'more'"),
        (1, lambda line: "", r"line 1: .*empty"),
    ],
)
def test_faults_are_named_with_line_and_field(
    write: Write, line: int, change: Callable[[str], str], words: str
) -> None:
    path = edit(write(motion(12)), line, change)
    with pytest.raises(MotionFileError, match=words) as caught:
        read(path)
    assert str(path) in str(caught.value)


def test_other_faults(write: Write, tmp_path: Path) -> None:
    with pytest.raises(MotionFileError, match="holds 3 frames; a motion needs at least 4"):
        read(write(motion(3)))
    with pytest.raises(MotionFileError, match="not a regular file"):
        read(tmp_path)
    with pytest.raises(MotionFileError, match="cannot be read: No such file"):
        read(tmp_path / "absent.csv")
    with pytest.raises(MotionFileError, match="name says actor 337, its column User-ID says 12"):
        read(write(motion(8), number="12", name=NAME.format(actor=337)))
    (tmp_path / "binary.csv").write_bytes(b"Timestamp\n\xff\xfe")
    with pytest.raises(MotionFileError, match="line 2: byte 0xff"):
        read(tmp_path / "binary.csv")
    (tmp_path / "empty.csv").write_bytes(b"")
    with pytest.raises(MotionFileError, match="empty"):
        read(tmp_path / "empty.csv")
    with (tmp_path / "huge.csv").open("wb") as file:
        file.truncate(MAX_BYTES + 1)
    with pytest.raises(MotionFileError, match="the limit is"):
        read(tmp_path / "huge.csv")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes on this system")
def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.csv")
    with pytest.raises(MotionFileError, match="not a regular file"):
        read(tmp_path / "pipe.csv")


# The clock.


def test_regular_stamps_are_left_alone() -> None:
    clock = repair_clock(5.0 + np.arange(50) / 30.0)
    np.testing.assert_allclose(clock.times, np.arange(50) / 30.0, atol=1e-9)
    assert (clock.late, clock.swapped, clock.resets) == (0, 0, 0)
    assert clock.period == pytest.approx(1 / 30)


def test_jitter_is_kept() -> None:
    stamps = np.cumsum(np.random.default_rng(0).uniform(0.027, 0.038, 60))
    np.testing.assert_allclose(repair_clock(stamps).times, stamps - stamps[0], atol=1e-12)


@pytest.mark.parametrize("steps", [[78.0, 0.0], [62.4, 0.0, 31.2], [78.0, 15.6, 0.0], [64.4, 15.6, 0.0]])
def test_frames_delivered_together_are_spread_over_the_wait(steps: list[float]) -> None:
    """The step patterns are those of real files, in milliseconds."""
    before, after = [33.0] * 6, [33.0] * 6
    stamps = np.cumsum([0.0, *before, *steps, *after]) / 1000.0
    clock = repair_clock(stamps)
    gaps = np.diff(clock.times)
    assert gaps.min() > 0.75 * 0.033 - 1e-12
    np.testing.assert_allclose(clock.times[[5, -1]], stamps[[5, -1]], atol=1e-12)
    assert clock.late == sum(step < 16.5 for step in steps)
    assert len(clock.times) == len(stamps), "every frame is real: none is dropped"


def test_frames_delivered_together_at_the_start_move_back() -> None:
    stamps = np.cumsum([0.0, 0.0, 0.0, 0.033, 0.033, 0.033])
    np.testing.assert_allclose(np.diff(repair_clock(stamps).times), 0.033, atol=1e-12)


def test_swapped_rows_are_sorted() -> None:
    stamps = np.arange(20) / 30.0
    swapped = stamps[[0, 1, 2, 4, 3, *range(5, 20)]]
    clock = repair_clock(swapped)
    assert clock.order[3:5].tolist() == [4, 3] and clock.swapped == 1 and clock.resets == 0
    np.testing.assert_allclose(clock.times, stamps, atol=1e-12)


def test_clock_set_back_keeps_the_order_of_rows() -> None:
    stamps = 100.0 + np.arange(20) / 30.0
    stamps[12:] -= 40.0
    clock = repair_clock(stamps)
    assert clock.order.tolist() == list(range(20)) and clock.resets == 1 and clock.swapped == 0
    np.testing.assert_allclose(clock.times, np.arange(20) / 30.0, atol=1e-9)


@pytest.mark.parametrize("off", [-5.0, -0.2, 0.3, 5.0])
def test_a_single_wrong_stamp_moves_no_other_frame(off: float) -> None:
    true = np.arange(30) / 30.0
    stamps = true.copy()
    stamps[12] += off
    clock = repair_clock(stamps)
    assert (clock.strays, clock.resets, clock.swapped) == (1, 0, 0)
    assert clock.order.tolist() == list(range(30))
    np.testing.assert_allclose(clock.times, true, atol=1e-12)


def test_stopped_clock_is_refused(write: Write) -> None:
    with pytest.raises(ConfigError, match="never advance"):
        repair_clock(np.full(5, 3.0))
    with pytest.raises(MotionFileError, match="column Timestamp: the time stamps never advance"):
        load(write(motion(8), stamps=np.full(8, 3.0)))


@pytest.mark.parametrize("seed", range(20))
def test_any_stamps_give_increasing_times(seed: int) -> None:
    rng = np.random.default_rng(seed)
    stamps = np.cumsum(
        rng.choice([0.0, 0.0156, 0.031, 0.033, 0.078, -0.02, -3.0], size=80, p=[0.1, 0.1, 0.3, 0.3, 0.1, 0.05, 0.05])
    )
    clock = repair_clock(stamps)
    assert np.all(np.diff(clock.times) > 0.0)
    assert sorted(clock.order.tolist()) == list(range(80))


# Skeleton and clip.


def test_measured_skeleton_is_the_actor(write: Write) -> None:
    paths = [write(motion(40, seed=i), name=f"POSE-p337_0{i}-Bow-1{i}.csv", action="Bow") for i in range(1, 4)]
    skeleton = measure_skeleton(paths)
    np.testing.assert_allclose(skeleton.bone_lengths, lengths_of(1.6), atol=1e-9)
    assert skeleton.leg_length == pytest.approx(1.6 * 0.51)
    assert skeleton.has(*CORE_ROLES)


def test_bones_are_medians_and_symmetric(write: Write) -> None:
    positions = motion(41)
    hand, wrist = JOINTS.index("HandLeft"), JOINTS.index("WristLeft")
    positions[:5, hand] = positions[:5, wrist] + 9.0  # five wild frames
    skeleton = measure_skeleton([write(positions)])
    np.testing.assert_allclose(skeleton.bone_lengths, lengths_of(1.6), atol=1e-9)
    elbow, shoulder = JOINTS.index("ElbowRight"), JOINTS.index("ShoulderRight")
    longer = motion(41)
    longer[:, [elbow, elbow + 1, elbow + 2]] += 0.1 * (longer[:, elbow] - longer[:, shoulder])[:, None]
    left, right = measure_skeleton([write(longer)]).bone_lengths[[JOINTS.index("ElbowLeft"), elbow]]
    assert left == pytest.approx(right) == pytest.approx(1.05 * 1.6 * 0.16)


def test_rest_directions_do_not_depend_on_the_actor(write: Write) -> None:
    small, tall = (measure_skeleton([write(motion(20, height=height))]) for height in (1.05, 1.75))
    unit = [s.offsets[1:] / s.bone_lengths[1:, None] for s in (small, tall)]
    np.testing.assert_allclose(unit[0], unit[1], atol=1e-12)
    rest = fk(tall, quat.identity(20), tall.offsets[0])[1]
    at = dict(zip(JOINTS, rest, strict=True))
    assert at["ElbowLeft"][0] > at["ShoulderLeft"][0] > 0 > at["ShoulderRight"][0] > at["ElbowRight"][0]
    assert at["HandLeft"][1] == pytest.approx(at["ShoulderLeft"][1]), "a T-pose"
    assert at["FootLeft"][2] > at["AnkleLeft"][2] and rest[:, 1].min() == pytest.approx(0.0)
    np.testing.assert_allclose(at["KneeLeft"] * [-1, 1, 1], at["KneeRight"], atol=1e-12)


def test_roles_agree_with_those_found_by_name(write: Write) -> None:
    skeleton = measure_skeleton([write(motion(10))])
    assert dict(skeleton.roles) == find_roles(skeleton.names, skeleton.parents)


def test_two_actors_have_no_common_skeleton(write: Write) -> None:
    paths = [write(motion(10)), write(motion(10), number="12")]
    with pytest.raises(MotionFileError, match="belongs to actor 12, not 337"):
        measure_skeleton(paths)
    with pytest.raises(ConfigError, match="no files"):
        measure_skeleton([])


def test_rigid_actor_on_a_regular_clock_is_recovered(write: Write) -> None:
    positions = motion(60)
    clip = load(write(positions))
    assert len(clip) == 60 and clip.fps == 30.0
    assert clip.residual is not None and clip.residual.max() < 1e-6
    np.testing.assert_allclose(clip.positions, positions, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(clip.rotations, axis=-1), 1.0, atol=1e-12)
    assert clip.meta.actor == "337" and clip.meta.style == "child"


def test_jittered_clock_is_resampled_to_the_truth(write: Write) -> None:
    rng = np.random.default_rng(5)
    stamps = np.cumsum(rng.uniform(0.028, 0.038, 90))
    exact = motion(2000)
    from scipy.interpolate import CubicSpline

    truth = CubicSpline(np.arange(2000) / 30.0, exact, axis=0)
    clip = load(write(truth(stamps), stamps=stamps * 1000.0), skeleton=actor(1.6))
    error = np.linalg.norm(clip.positions - truth(stamps[0] + clip.times), axis=-1)
    assert error.max() < 1e-3
    assert clip.times[-1] <= stamps[-1] - stamps[0] < clip.times[-1] + 1 / 30


def test_other_rates(write: Write) -> None:
    path = write(motion(60))
    assert len(load(path, fps=60.0)) == 119 and len(load(path, fps=15.0)) == 30
    np.testing.assert_allclose(load(path, fps=60.0).positions[::2], load(path).positions, atol=1e-9)
    for fps in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ConfigError, match="fps must be positive"):
            load(path, fps=fps)


def test_short_gap_is_bridged_and_long_gap_refused(write: Write) -> None:
    positions, stamps = motion(90), np.arange(90) * 100.0 / 3.0
    keep = np.r_[0:40, 44:90]
    clip = load(write(positions[keep], stamps=stamps[keep]))
    assert np.linalg.norm(clip.positions - positions, axis=-1).max() < 0.01
    assert read(write(positions[keep], stamps=stamps[keep])).clock.longest_gap == pytest.approx(5 / 30)
    keep = np.r_[0:40, 60:90]
    with pytest.raises(MotionFileError, match=r"line 42: no frame for 0\.70 s before this one"):
        load(write(positions[keep], stamps=stamps[keep]))


def test_residual_shows_bones_that_breathe(write: Write) -> None:
    positions = motion(60)
    breathing = positions.copy()
    for joint in (JOINTS.index("KneeLeft"), JOINTS.index("AnkleLeft"), JOINTS.index("FootLeft")):
        breathing[:, joint] += (0.02 * np.sin(np.arange(60)))[:, None] * [0.0, -1.0, 0.0]
    clip = load(write(breathing), skeleton=actor(1.6))
    assert clip.residual is not None
    assert 0.01 < clip.residual[:, JOINTS.index("KneeLeft")].max() < 0.03
    assert clip.residual[:, JOINTS.index("KneeRight")].max() < 1e-6


def test_foreign_skeleton_is_refused(write: Write) -> None:
    with pytest.raises(ConfigError, match="joints are not the sensor's"):
        load(write(motion(10)), skeleton=Skeleton(("a",), np.array([-1]), np.zeros((1, 3))))


# Real captures.


@pytest.fixture(scope="session")
def some_files(kinder_gator: Path) -> dict[str, list[Path]]:
    """Five actions of each actor."""
    wanted = ("_03-Wave", "-Bow-", "-Walk-in-place-1", "-Jump-1", "-Draw-a-circle")
    files: dict[str, list[Path]] = {}
    for path in sorted(kinder_gator.glob("*/POSE-*.csv")):
        if any(word in path.name for word in wanted):
            files.setdefault(path.name.split("_")[0].removeprefix("POSE-p"), []).append(path)
    return files


@pytest.mark.real_data
def test_real_actors_have_plausible_legs(some_files: dict[str, list[Path]]) -> None:
    assert len(some_files) == 14
    legs = {actor: measure_skeleton(paths).leg_length for actor, paths in some_files.items()}
    style = {actor: read(paths[0]).style for actor, paths in some_files.items()}
    children = [leg for actor, leg in legs.items() if style[actor] == "child"]
    adults = [leg for actor, leg in legs.items() if style[actor] == "adult"]
    assert (len(children), len(adults)) == (7, 7)
    assert min(children) > 0.42 and max(children) < 0.70
    assert min(adults) > 0.70 and max(adults) < 1.0


@pytest.mark.real_data
def test_real_actors_face_forward_and_fit_their_skeleton(some_files: dict[str, list[Path]]) -> None:
    residuals, ahead, toes = [], [], []
    for paths in some_files.values():
        skeleton = measure_skeleton(paths)
        for path in paths:
            clip = load(path, skeleton=skeleton)
            at = dict(zip(JOINTS, clip.positions.swapaxes(0, 1), strict=True))
            across = at["HipLeft"] - at["HipRight"] + at["ShoulderLeft"] - at["ShoulderRight"]
            forward = np.cross(across, [0.0, 1.0, 0.0])
            ahead.append(np.median(forward[:, 2] / np.linalg.norm(forward, axis=-1)))
            foot = at["FootLeft"] - at["AnkleLeft"] + at["FootRight"] - at["AnkleRight"]
            toes.append(np.mean(np.sum(foot * forward, axis=-1) > 0.0))
            residuals.append(clip.residual)
    assert np.median(ahead) > 0.97 and min(ahead) > 0.7, "actors face +Z"
    assert np.median(toes) == 1.0 and np.mean(toes) > 0.95, "toes point where the body faces"
    residual = np.median(np.concatenate([r for r in residuals if r is not None]), axis=0)
    assert residual.max() < 0.05, dict(zip(JOINTS, residual.round(3), strict=True))


@pytest.mark.real_data
def test_left_and_right_are_the_actors_own(some_files: dict[str, list[Path]]) -> None:
    """The data set's tables say who is right-handed; a mirrored sensor would turn them all into left-handers."""
    ambidextrous, left_handed = {"337", "595"}, "921"
    moved = {}
    for actor, paths in some_files.items():
        (circle,) = [read(path).positions for path in paths if "Draw-a-circle" in path.name]
        travel = {
            side: np.abs(np.diff(circle[:, JOINTS.index(f"Wrist{side}")] - circle[:, 2], axis=0)).sum()
            for side in ("Left", "Right")
        }
        moved[actor] = travel["Right"] / travel["Left"]
    assert all(moved[actor] > 1.5 for actor in moved.keys() - ambidextrous - {left_handed}), moved
    assert moved[left_handed] < 0.67, "the left-handed adult draws with the joints called Left"


@pytest.mark.real_data
def test_real_measured_positions_go_through_the_same_solver(some_files: dict[str, list[Path]]) -> None:
    path = some_files["577"][0]
    skeleton = measure_skeleton(some_files["577"])
    record = read(path)
    clip = load(path, skeleton=skeleton)
    direct = rotations_from_positions(skeleton, record.positions)[0]
    assert quat.angle(direct[0], clip.rotations[0]).max() < 1e-9, "the first frame is not moved in time"
