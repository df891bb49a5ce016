"""The truth of a synthetic clip: same content, other body and style, by exactly the known parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from benchmark.data.synthetic import STYLES, SyntheticDataset
from benchmark.data.synthetic.body import NAMES, Body
from benchmark.errors import DataError
from benchmark.motion import quat
from benchmark.motion.canonical import heading
from benchmark.motion.clip import MotionClip
from benchmark.motion.skeleton import Skeleton

GAITS = ["walk", "walk-as-fast-as-you-can", "happy-walk", "jog"]


@pytest.fixture(scope="module")
def data() -> SyntheticDataset:
    return SyntheticDataset(seed=5, adults=2, children=3, takes=1)


def _touch_downs(clip: MotionClip) -> np.ndarray:
    """Times at which the feet touch down, found from the heights of heel and ball; sub-frame by linear interpolation."""
    body = Body(clip.skeleton)
    rotations, positions = clip.world
    times = []
    for side in ("left", "right"):
        ankle, toe = clip.skeleton.joints(f"{side}_ankle", f"{side}_toe")
        heel = (positions[:, ankle] + quat.rotate(rotations[:, ankle], body.heel))[:, 1]
        ball = positions[:, toe, 1] - body.ankle_height - body.ball[1]
        height = np.minimum(heel, ball) - np.percentile(np.minimum(heel, ball), 20)
        down = np.flatnonzero((height[:-1] >= 0.005) & (height[1:] < 0.005))
        times += list((down + (height[down] - 0.005) / (height[down] - height[down + 1])) / clip.fps)
    return np.sort(times)


def _arm_swing(clip: MotionClip) -> float:
    """Root mean square of half the difference between the flexion of both upper arms, seen from the chest."""
    chest = clip.world[0][:, NAMES.index("Spine3")]
    flexion = []
    for side in ("left", "right"):
        shoulder, elbow = clip.skeleton.joints(f"{side}_shoulder", f"{side}_elbow")
        arm = quat.inv_rotate(chest, clip.positions[:, elbow] - clip.positions[:, shoulder])
        flexion.append(np.arctan2(arm[:, 2], -arm[:, 1]))
    touch = _touch_downs(clip)
    within = (clip.times >= touch[1]) & (clip.times <= touch[-2])
    return float(np.sqrt(np.mean((0.5 * (flexion[0] - flexion[1])[within]) ** 2)))


@pytest.mark.parametrize("action", GAITS)
@pytest.mark.parametrize(("source", "target"), [("adult", "child"), ("child", "adult")])
def test_tempo_and_arm_swing_change_as_known(data: SyntheticDataset, action: str, source: str, target: str) -> None:
    clip_id = f"{source}/{source}001/{action}_1"
    own, truth = data.truth(clip_id, source), data.truth(clip_id, target)
    change = data.change(clip_id, target)
    before, after = _touch_downs(own), _touch_downs(truth)
    assert len(before) > 8 and len(after) > 8
    measured = (after[-1] - after[0]) / (before[-1] - before[0])
    assert measured == pytest.approx(change.time, rel=0.03)
    assert abs(change.time - 1.0) > 0.05
    assert _arm_swing(truth) / _arm_swing(own) == pytest.approx(change.arm_swing, rel=0.03)
    assert abs(change.arm_swing - 1.0) > 0.05


def test_on_the_same_body_the_tempo_ratio_is_the_parameter_ratio(data: SyntheticDataset) -> None:
    clip_id = "adult/adult002/walk_1"
    skeleton = data.actors["adult002"].skeleton
    own, truth = data.truth(clip_id, "adult"), data.truth(clip_id, "child", skeleton)
    before, after = (_touch_downs(clip) for clip in (own, truth))
    ratio = (before[-1] - before[0]) / (after[-1] - after[0])
    assert ratio == pytest.approx(data.parameters("child").tempo / data.parameters("adult002").tempo, rel=0.03)


@pytest.mark.parametrize(
    ("parameter", "factor", "measure"),
    [
        ("arm_swing", 1.5, _arm_swing),
        ("tempo", 1.25, lambda clip: 1.0 / np.ptp(_touch_downs(clip))),
        ("stride", 0.8, lambda clip: np.max(clip.root[:, 2])),
    ],
)
def test_one_parameter_moves_one_measure(
    data: SyntheticDataset, parameter: str, factor: float, measure: Callable[[MotionClip], float]
) -> None:
    clip_id = "adult/adult001/walk_1"
    base = replace(STYLES["adult"], variability=0.0, asymmetry=0.0)
    changed = replace(base, **{parameter: factor * getattr(base, parameter)})
    before = measure(data.truth(clip_id, "adult", parameters=base))
    after = measure(data.truth(clip_id, "adult", parameters=changed))
    assert after / before == pytest.approx(factor, rel=0.03)


def test_preparation_and_jump_height_change_as_known(data: SyntheticDataset) -> None:
    clip_id = "adult/adult001/jump-as-high-as-you-can-in-place_1"
    base = replace(STYLES["adult"], variability=0.0)
    fine = SyntheticDataset(seed=5, adults=2, children=3, takes=1, fps_working=120.0)

    def phases(**changes: float) -> tuple[float, float]:
        clip = fine.truth(clip_id, "adult", parameters=replace(base, **changes))
        height = clip.root[:, 1]
        falls = np.abs(np.diff(height, 2) * clip.fps**2 + 9.81) < 0.05
        top = int(np.argmax(height))
        start = top - int(np.argmin(falls[:top][::-1]))
        end = top + int(np.argmin(falls[top:]))
        bottom = int(np.argmin(height[:start]))
        begin = int(np.flatnonzero(height[:bottom] > height[0] - 0.002)[-1])
        return (bottom - begin) / clip.fps, 9.81 * ((end - start) / clip.fps) ** 2 / 8.0

    slow, rise = phases()
    slower, _ = phases(anticipation=1.5)
    _, lower = phases(jump_height=0.7)
    assert slower / slow == pytest.approx(1.5, rel=0.08)
    assert lower / rise == pytest.approx(0.7, rel=0.08)


@pytest.mark.parametrize("action", ["punch", "kick", "hop-scotch", "5-jumping-jacks", "skip"])
def test_content_is_shared(data: SyntheticDataset, action: str) -> None:
    clip_id = f"adult/adult001/{action}_1"
    own, truth = data.truth(clip_id, "adult"), data.truth(clip_id, "child")
    if action in ("hop-scotch", "skip"):
        turns = [heading(clip)[-1] - heading(clip)[0] for clip in (own, truth)]
        assert np.sign(turns[0]) == np.sign(turns[1])
    elif action == "5-jumping-jacks":
        for clip in (own, truth):
            wrist = clip.positions[:, clip.skeleton.joint("left_wrist"), 1]
            above = wrist > clip.positions[:, clip.skeleton.joint("head"), 1]
            assert np.sum(above[1:] & ~above[:-1]) == 5
    else:
        limb = "wrist" if action == "punch" else "ankle"
        reach = []
        for clip in (own, truth):
            sides = [
                clip.positions[:, clip.skeleton.joint(f"{side}_{limb}"), 2] - clip.root[:, 2]
                for side in ("left", "right")
            ]
            reach.append(
                int(np.argmax([side.max() for side in sides]))
                if action == "kick"
                else int(np.argmax(sides[0]) > np.argmax(sides[1]))
            )
        assert reach[0] == reach[1]


def test_truth_is_noise_free_on_the_body_asked_for(data: SyntheticDataset) -> None:
    clip_id = "adult/adult001/walk_1"
    median = data.median_actor("child")
    legs = sorted(a.skeleton.leg_length for a in data.actors.values() if a.style == "child")
    assert median.skeleton.leg_length == legs[1]
    truth = data.truth(clip_id, "child")
    assert truth.meta.style == "child" and truth.meta.action == "walk" and "synthetic" in truth.meta.source
    np.testing.assert_allclose(truth.skeleton.offsets[1:], median.skeleton.offsets[1:])
    again = data.truth(clip_id, "child")
    assert truth.rotations.tobytes() == again.rotations.tobytes()
    tall = data.actors["child003"].skeleton
    np.testing.assert_allclose(data.truth(clip_id, "child", tall).skeleton.offsets[1:], tall.offsets[1:])
    # The canonical skeleton of a loaded clip does as well.
    loaded = data.load("child/child003/walk_1").skeleton
    np.testing.assert_array_equal(
        data.truth(clip_id, "child", loaded).rotations, data.truth(clip_id, "child", tall).rotations
    )
    with pytest.raises(DataError, match="25 joints"):
        data.truth(clip_id, "child", Skeleton(("Hips",), np.array([-1]), np.zeros((1, 3))))


def test_own_truth_is_the_clip_without_noise(data: SyntheticDataset) -> None:
    clip_id = "child/child002/kick_1"
    clip, own = data.load(clip_id), data.truth(clip_id, "child")
    frames = min(len(clip), len(own))
    assert abs(len(clip) - len(own)) <= 2
    error = np.linalg.norm(clip.positions[-frames:] - own.positions[-frames:], axis=-1)
    assert np.median(error) < 0.01


def test_parameters_are_accessible(data: SyntheticDataset) -> None:
    assert data.parameters("child") == STYLES["child"]
    assert data.parameters("child001") == data.actors["child001"].parameters
    ratio = STYLES["child"].ratio(STYLES["adult"])
    assert ratio["tempo"] > 1 and ratio["arm_swing"] > 1 and ratio["anticipation"] > 1 and ratio["jump_height"] < 1
    change = data.change("adult/adult001/walk_1", "child")
    assert change.step_frequency * change.time == pytest.approx(1.0)
    assert change.step_length < 1.0 and change.step_frequency > 1.0
