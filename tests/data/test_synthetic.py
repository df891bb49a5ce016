"""The synthetic corpus against what it promises: contacts, gravity, smoothness, determinism, and nothing made in advance."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmark.data.splits import check, make_split
from benchmark.data.synthetic import SyntheticDataset
from benchmark.data.synthetic import dataset as dataset_module
from benchmark.data.synthetic.actions import write_score
from benchmark.data.synthetic.body import NAMES, Anatomy, Body, proportions
from benchmark.data.synthetic.content import ACTIONS, KINDS
from benchmark.data.synthetic.perform import perform
from benchmark.errors import ConfigError, DataError, UnknownNameError
from benchmark.motion import quat
from benchmark.motion.canonical import heading, tpose_frames
from benchmark.motion.clip import MotionClip

STYLES = ("adult", "child")
CASES = [(action, style) for action in ACTIONS for style in STYLES]


@pytest.fixture(scope="module")
def small() -> SyntheticDataset:
    return SyntheticDataset(seed=3, adults=2, children=2, takes=1)


def _id(action: str, style: str, actor: int = 1) -> str:
    return f"{style}/{style}{actor:03d}/{action}_1"


@pytest.fixture(scope="module")
def clean(small: SyntheticDataset) -> dict[tuple[str, str], MotionClip]:
    return {(action, style): small.raw(_id(action, style), noise=False) for action, style in CASES}


def _sole(clip: MotionClip) -> np.ndarray:
    """(T, 2, 2, 3) heel and ball of both feet, without the height of the toe joint over a flat sole."""
    body = Body(clip.skeleton)
    rotations, positions = clip.world
    feet = []
    for side in ("left", "right"):
        ankle, toe = clip.skeleton.joints(f"{side}_ankle", f"{side}_toe")
        heel = positions[:, ankle] + quat.rotate(rotations[:, ankle], body.heel)
        ball = positions[:, toe] - [0.0, body.ankle_height + body.ball[1], 0.0]
        feet.append(np.stack([heel, ball], axis=1))
    return np.stack(feet, axis=1)


def _airborne(clip: MotionClip) -> np.ndarray:
    """(T,) whether heels and balls are all off the floor by more than 4 mm, the frame before and after included."""
    off = _sole(clip)[..., 1].min(axis=(1, 2)) > 0.004
    off[1:-1] &= off[2:] & off[:-2]
    return off


@pytest.mark.parametrize(("action", "style"), CASES)
def test_clip_is_sound(clean: dict, action: str, style: str) -> None:
    clip = clean[action, style]
    assert np.isfinite(clip.rotations).all() and np.isfinite(clip.root).all()
    np.testing.assert_allclose(np.linalg.norm(clip.rotations, axis=-1), 1.0, atol=1e-12)
    assert len(clip.skeleton) == 25 and clip.fps == 120.0
    assert 2.0 < clip.duration < 16.0
    assert clip.meta.source == "synthetic"


@pytest.mark.parametrize(("action", "style"), CASES)
def test_planted_feet_stand_still(small: SyntheticDataset, clean: dict, action: str, style: str) -> None:
    clip = clean[action, style]
    actor = small.actors[f"{style}001"]
    content = small.content(_id(action, style))
    score = write_score(content, Body(actor.skeleton), actor.parameters)
    t = clip.times - content.tpose - content.blend
    stances = 0
    for side, name in (("L", "left"), ("R", "right")):
        ankle, toe = (clip.positions[:, clip.skeleton.joint(f"{name}_{part}")] for part in ("ankle", "toe"))
        for plant in score.feet[side]:
            # From when the foot has settled until the toes leave, the toe joint stays; until the heel rises, the ankle does.
            stance = (t >= plant.on + plant.settle) & (t <= plant.off)
            for onset, _, release, fall, _, _ in score.holds.get(side, []):
                stance &= (t <= onset) | (t >= release + fall)
            if stance.sum() < 3:
                continue
            stances += 1
            assert np.ptp(toe[stance], axis=0).max() < 1e-6
            length = plant.off - plant.on
            peel = plant.peel * (length if np.isfinite(length) else 1.0)
            flat = stance & (t <= plant.off - min(peel, 0.35))
            if flat.sum() > 2 and side not in score.holds:
                assert np.ptp(ankle[flat], axis=0).max() < 1e-6
    assert stances >= 2


@pytest.mark.parametrize(("action", "style"), CASES)
def test_someone_always_stands_or_flies(clean: dict, action: str, style: str) -> None:
    """Found from the motion alone: outside flights some point of a sole rests on the floor, and nothing goes below it."""
    clip = clean[action, style]
    sole = _sole(clip)
    assert sole[..., 1].min() > -0.015
    assert clip.positions[..., 1].min() > 0.0
    lowest = sole[..., 1].min(axis=(1, 2))
    grounded = lowest < 0.001
    ballistic = np.abs(np.diff(clip.root[:, 1], 2) * clip.fps**2 + 9.81) < 0.05
    neither = ~grounded[1:-1] & ~ballistic
    assert neither.mean() < 0.02


@pytest.mark.parametrize(("action", "style"), CASES)
def test_flight_is_ballistic(clean: dict, action: str, style: str) -> None:
    clip = clean[action, style]
    airborne = _airborne(clip)[1:-1]
    acceleration = np.diff(clip.root[:, 1], 2) * clip.fps**2
    if "jump" in action or "run" in action or action in ("jog", "hop-scotch", "skip"):
        assert airborne.sum() >= 4
    if airborne.any():
        np.testing.assert_allclose(acceleration[airborne], -9.81, atol=0.01)
    if "walk" in action or action in ("idle", "kick", "punch") or "throw" in action:
        assert not airborne.any()


@pytest.mark.parametrize(("action", "style"), CASES)
def test_no_pops(clean: dict, action: str, style: str) -> None:
    rotations = clean[action, style].rotations
    step = np.rad2deg(quat.angle(rotations[1:], rotations[:-1]))
    assert step.max() < 20.0
    assert np.abs(np.diff(step, axis=0)).max() < 17.0


@pytest.mark.parametrize(
    "action", ["walk", "kick", "jump", "hop-scotch", "throw-a-ball-with-left-arm", "5-jumping-jacks"]
)
def test_velocity_is_continuous(small: SyntheticDataset, action: str) -> None:
    """Where the velocity jumps, the second difference grows with the frame rate; where it is smooth, it converges."""
    actor = small.actors["child001"]
    score = write_score(small.content(_id(action, "child")), Body(actor.skeleton), actor.parameters)
    worst = []
    for fps in (240.0, 960.0):
        clip = perform(score, fps=fps)
        worst.append(np.linalg.norm(np.diff(clip.positions, 2, axis=0), axis=-1).max() * fps**2)
    assert worst[1] < 1.3 * worst[0]


@pytest.mark.parametrize(("action", "style"), CASES)
def test_joints_bend_the_right_way(clean: dict, action: str, style: str) -> None:
    clip = clean[action, style]
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        knee = clip.rotations[:, NAMES.index(f"{side}Leg")]
        assert (knee[:, 1] * np.sign(knee[:, 0])).min() >= 0.0
        elbow = clip.rotations[:, NAMES.index(f"{side}ForeArm")]
        assert (-sign * elbow[:, 2] * np.sign(elbow[:, 0])).min() > -np.sin(0.1)


@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("action", ACTIONS)
def test_cyclic_clips_turn_about(clean: dict, action: str, style: str) -> None:
    turned = heading(clean[action, style])
    change = abs(turned[-1] - turned[0])
    expected = np.pi if action in KINDS["cyclic"] else 0.0
    assert change == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("action", ["walk", "walk-as-fast-as-you-can", "happy-walk", "jog", "run-as-fast-as-you-can"])
def test_arms_swing_against_legs(clean: dict, action: str, style: str) -> None:
    clip = clean[action, style]
    forward = np.stack([np.sin(heading(clip)), np.zeros(len(clip)), np.cos(heading(clip))], axis=-1)

    def apart(role: str) -> np.ndarray:
        left, right = clip.skeleton.joints(f"left_{role}", f"right_{role}")
        return np.sum((clip.positions[:, left] - clip.positions[:, right]) * forward, axis=-1)

    assert np.corrcoef(apart("ankle"), apart("wrist"))[0, 1] < -0.5


@pytest.mark.parametrize(("action", "style"), CASES)
def test_tpose_is_in_the_capture_and_not_in_the_clip(small: SyntheticDataset, action: str, style: str) -> None:
    clip_id = _id(action, style)
    raw, loaded, content = small.raw(clip_id), small.load(clip_id), small.content(clip_id)
    hold = int(content.tpose * raw.fps)
    assert 0.3 <= content.tpose <= 1.0
    arms = raw.positions[:hold, raw.skeleton.joints("left_wrist", "left_shoulder", "right_shoulder", "right_wrist")]
    assert np.ptp(arms[..., 1], axis=1).max() < 0.07  # capture noise over the length of an arm
    assert tpose_frames(raw) >= hold
    assert tpose_frames(loaded) == 0
    assert loaded.fps == 60.0
    assert loaded.duration < raw.duration - content.tpose
    assert loaded.root[0, [0, 2]] == pytest.approx([0.0, 0.0], abs=1e-9)
    assert small.load(clip_id) is loaded


@pytest.mark.parametrize(("action", "style"), CASES)
def test_standing_is_upright(clean: dict, action: str, style: str) -> None:
    """No plan asks for more than the legs reach: where one did, the whole performance would be lowered."""
    clip = clean[action, style]
    body = Body(clip.skeleton)
    hip = clip.root[0, 1] - body.hips_above_hip - body.ankle_height
    assert 0.94 < hip / body.leg < 0.995


def test_noise_is_small_and_there(small: SyntheticDataset, clean: dict) -> None:
    noisy, pure = small.raw(_id("walk", "adult")), clean["walk", "adult"]
    angles = np.rad2deg(quat.angle(noisy.rotations, pure.rotations))
    assert 0.2 < np.sqrt(np.mean(angles**2)) < 0.8
    assert angles.min(axis=0).max() < 0.5 and angles.max() < 3.0
    assert 2e-4 < np.std(noisy.root - pure.root) < 1e-3


def test_same_seed_same_bytes(small: SyntheticDataset) -> None:
    again = SyntheticDataset(seed=3, adults=2, children=2, takes=1)
    other = SyntheticDataset(seed=4, adults=2, children=2, takes=1)
    for action, style in CASES[::5]:
        clip_id = _id(action, style, 2)
        first, second, third = (data.raw(clip_id) for data in (small, again, other))
        assert first.rotations.tobytes() == second.rotations.tobytes()
        assert first.root.tobytes() == second.root.tobytes()
        assert first.skeleton == second.skeleton
        assert first.rotations.shape != third.rotations.shape or not np.array_equal(first.rotations, third.rotations)
    assert small.digest == again.digest != other.digest


def test_bytes_do_not_depend_on_the_process() -> None:
    program = (
        "import hashlib\n"
        "from benchmark.data.synthetic import SyntheticDataset\n"
        "d = SyntheticDataset(seed=3, adults=2, children=2, takes=1)\n"
        "ids = ['child/child002/skip_1', 'adult/adult001/punch_1']\n"
        "print(d.digest, *(hashlib.sha256(d.raw(i).rotations.tobytes()).hexdigest() for i in ids))\n"
    )
    outputs = {
        subprocess.run(
            [sys.executable, "-c", program],
            env={"PYTHONHASHSEED": seed, "OMP_NUM_THREADS": seed},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for seed in ("1", "2")
    }
    assert len(outputs) == 1 and len(outputs.pop().split()) == 3


def test_records_cost_no_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*args: object, **kwargs: object) -> None:
        raise AssertionError("motion was generated")

    monkeypatch.setattr(dataset_module, "perform", refuse)
    monkeypatch.setattr(dataset_module, "write_score", refuse)
    data = SyntheticDataset()
    assert {record.action for record in data.records} == set(ACTIONS) and len(ACTIONS) == 21
    assert set(ACTIONS) == set(data.card.actions)
    assert 420 <= len(data.records) <= 840
    takes = {}
    for record in data.records:
        takes.setdefault((record.actor, record.action), []).append(record.take)
    assert {len(numbers) for numbers in takes.values()} == {2, 3, 4}
    assert len({record.sha256 for record in data.records}) == len(data.records)
    assert [record.clip_id for record in data.records] == sorted(record.clip_id for record in data.records)
    assert data.digest == SyntheticDataset().digest
    assert data.has_truth(data.records[0].clip_id, "child")
    split = make_split(data, "adult", "child")
    check(split, data)
    assert len(split.train) > 100 and len(split.test) > 20


def test_options_change_the_digest() -> None:
    digests = [
        SyntheticDataset(**options).digest  # type: ignore[arg-type]
        for options in ({}, {"seed": 1}, {"adults": 6}, {"takes": 2}, {"actions": ["walk"]}, {"fps_working": 30.0})
    ]
    assert len(set(digests)) == len(digests)


def test_actors_differ_and_fit_their_style() -> None:
    data = SyntheticDataset(adults=8, children=8, takes=1, actions=["idle"])
    for style, low, high in (("adult", 1.52, 1.85), ("child", 1.05, 1.35)):
        cast = [actor for actor in data.actors.values() if actor.style == style]
        assert len(cast) == 8
        assert all(low <= actor.anatomy.stature <= high for actor in cast)
        assert len({actor.parameters for actor in cast}) == 8
        assert len({actor.skeleton.offsets.tobytes() for actor in cast}) == 8
        assert np.ptp([actor.anatomy.stature for actor in cast]) > 0.5 * (high - low)
    children = [actor.anatomy.age for actor in data.actors.values() if actor.style == "child"]
    assert min(children) >= 5.0 and max(children) <= 9.0
    tempo = {s: np.mean([a.parameters.tempo for a in data.actors.values() if a.style == s]) for s in STYLES}
    assert tempo["child"] > tempo["adult"]


def test_proportions_follow_age() -> None:
    ages = np.arange(5.0, 19.0)
    for name, sign in (("head", -1), ("hip_height", 1), ("upper_arm", 1), ("forearm", 1), ("shoulder_height", 1)):
        values = [proportions(age)[name] for age in ages]
        assert np.all(sign * np.diff(values) > 0), name
    assert proportions(18.0) == proportions(40.0)
    for anatomy in (Anatomy(5.0, 1.09), Anatomy(9.0, 1.33), Anatomy(30.0, 1.75)):
        skeleton = anatomy.skeleton
        rest = MotionClip(skeleton, quat.identity(1, 25), np.array([[0.0, skeleton.offsets[0, 1], 0.0]]), 1.0)
        top = next(end for end in skeleton.end_sites if end.parent == NAMES.index("Head"))
        assert rest.positions[0, top.parent, 1] + top.offset[1] == pytest.approx(anatomy.stature, abs=1e-9)
        sole = _sole(rest)[0, ..., 1]
        np.testing.assert_allclose(sole, 0.0, atol=1e-9)
        assert 0.46 < skeleton.leg_length / (0.52 * anatomy.stature) < 1.0


def test_bvh_round_trip(tmp_path: Path) -> None:
    from benchmark.motion import bvh

    data = SyntheticDataset(seed=1, adults=1, children=1, takes=1, actions=["walk", "kick"])
    seen: list[tuple[float, str]] = []
    files = data.write_bvh(tmp_path, progress=lambda done, name: seen.append((done, name)))
    assert [path.relative_to(tmp_path).as_posix() for path in files] == [
        f"{record.style}/{record.actor}/{record.action}_{record.take}.bvh" for record in data.records
    ]
    assert [done for done, _ in seen] == sorted(done for done, _ in seen) and seen[-1][0] == 1.0
    for record, path in zip(data.records, files, strict=True):
        raw, back = data.raw(record.clip_id), bvh.load(path)
        assert back.fps == pytest.approx(120.0, rel=1e-5)
        assert back.skeleton.names == raw.skeleton.names
        assert dict(back.skeleton.roles) == dict(raw.skeleton.roles)
        np.testing.assert_allclose(back.positions, raw.positions, atol=1e-5)


def test_wrong_settings_are_named() -> None:
    with pytest.raises(ConfigError, match="adults is 0"):
        SyntheticDataset(adults=0)
    with pytest.raises(ConfigError, match="takes"):
        SyntheticDataset(takes=(4, 2))
    with pytest.raises(ConfigError, match="takes"):
        SyntheticDataset(takes=(1, 2, 3))
    with pytest.raises(ConfigError, match="fps_working"):
        SyntheticDataset(fps_working=240.0)
    with pytest.raises(UnknownNameError, match="did you mean 'walk'"):
        SyntheticDataset(actions=["wlak"])
    data = SyntheticDataset(adults=1, children=1, takes=1)
    with pytest.raises(DataError):
        data.load("adult/adult001/fly_1")
    with pytest.raises(UnknownNameError, match="elder"):
        data.truth("adult/adult001/walk_1", "elder")
