from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from benchmark.api import StyleTask
from benchmark.commands.conformance.figures import ADULT, CHILD, perform
from benchmark.motion import quat
from benchmark.motion.clip import MotionClip
from benchmark.motion.retarget import retarget
from eval.meta.cases import Case
from eval.meta.corruptions import CORRUPTIONS

BY_NAME = {corruption.name: corruption for corruption in CORRUPTIONS}
CHANGES = [corruption.name for corruption in CORRUPTIONS if corruption.change is not None]


@pytest.fixture(scope="module")
def cases() -> list[Case]:
    found = []
    for number, action in enumerate(("walk", "wave", "jump", "walk", "wave", "jump")):
        source, truth = perform(action, ADULT, number + 1), perform(action, CHILD, number + 1)
        found.append(
            Case(
                name=f"{action}{number}",
                actor="a",
                action=action,
                source=source,
                truth=truth,
                performance=truth,
                references=(perform(action, CHILD, 9),),
                adult=retarget(source, truth.skeleton),
                blend=lambda share, clip=truth: clip.replace(root=clip.root * (1.0 + share)),
                task=StyleTask(ADULT, CHILD, truth.skeleton),
            )
        )
    return found


def same(a: MotionClip, b: MotionClip) -> bool:
    return len(a) == len(b) and np.array_equal(a.rotations, b.rotations) and np.array_equal(a.positions, b.positions)


@pytest.mark.parametrize("name", list(BY_NAME))
def test_grades(name: str, cases: list[Case]) -> None:
    corruption = BY_NAME[name]
    assert len(corruption.amounts) == len(corruption.labels) == len(set(corruption.labels))
    assert corruption.amounts[0] == 0.0
    assert all(np.diff(np.abs(corruption.amounts)) > 0.0)
    for index, case in enumerate(cases):
        assert corruption.result(cases, index, 0, 1) is case.performance
        last = corruption.result(cases, index, len(corruption.amounts) - 1, 1)
        again = corruption.result(cases, index, len(corruption.amounts) - 1, 1)
        assert same(last, again)
    changed = [
        not same(corruption.result(cases, i, len(corruption.amounts) - 1, 1), cases[i].performance) for i in range(6)
    ]
    assert sum(changed) >= 5


@pytest.mark.parametrize("name", CHANGES)
def test_a_higher_grade_is_the_same_fault_larger(name: str, cases: list[Case]) -> None:
    corruption = BY_NAME[name]
    if name == "time-stretch":
        lengths = [len(corruption.result(cases, 0, grade, 1)) for grade in range(5)]
        assert lengths == sorted(set(lengths))
        assert lengths[-1] == pytest.approx(1.4 * lengths[0], abs=1)
        return
    clean = cases[0].performance
    gaps = []
    for grade in range(5):
        clip = corruption.result(cases, 0, grade, 1)
        gaps.append(float(np.linalg.norm(clip.positions - clean.positions, axis=-1).mean()))
    assert all(np.diff(gaps) > 0.0)


def test_noise_has_the_size_it_says(cases: list[Case]) -> None:
    clean, noisy = cases[0].performance, BY_NAME["noise"].result(cases, 0, 4, 1)
    angles = np.degrees(quat.angle(clean.rotations, noisy.rotations))
    # The length of three independent normal numbers of 2 degrees.
    assert angles.mean() == pytest.approx(2.0 * np.sqrt(8.0 / np.pi), rel=0.02)


def test_a_slide_has_the_speed_it_says(cases: list[Case]) -> None:
    clean, clip = cases[0].performance, BY_NAME["foot-slide"].result(cases, 0, 3, 1)
    drift = np.diff(clip.root - clean.root, axis=0) * clean.fps
    assert np.allclose(np.linalg.norm(drift, axis=1), 0.3)
    assert np.allclose(drift[:, 1], 0.0)


def test_lag_leaves_the_legs_alone_and_the_arms_late(cases: list[Case]) -> None:
    clean, clip = cases[1].performance, BY_NAME["arm-lag"].result(cases, 1, 4, 1)
    legs = clean.skeleton.joints("left_hip", "left_knee", "right_ankle", "hips")
    assert np.array_equal(clip.rotations[:, legs], clean.rotations[:, legs])
    elbow, frames = clean.skeleton.joint("right_elbow"), round(8.0 / 30.0 * clean.fps)
    assert quat.angle(clip.rotations[frames:, elbow], clean.rotations[:-frames, elbow]).max() < 1e-6


def test_a_frozen_clip_holds_its_last_pose(cases: list[Case]) -> None:
    clip = BY_NAME["frozen-pose"].result(cases, 0, 4, 1)
    held = clip.frames(int(0.25 * len(clip)), len(clip))
    assert np.ptp(held.positions, axis=0).max() < 1e-9


def test_smoothing_halves_the_power_at_its_cutoff(cases: list[Case]) -> None:
    t = np.arange(1200) / 60.0
    root = np.stack([0.0 * t, 1.0 + 0.0 * t, 0.1 * np.sin(2.0 * np.pi * 2.0 * t)], axis=1)
    clip = cases[0].performance
    clip = MotionClip(clip.skeleton, quat.identity(len(t), len(clip.skeleton)), root, 60.0)
    smoothed = BY_NAME["over-smoothing"].change(clip, 0.5, np.random.default_rng(0))
    middle = slice(300, 900)
    gain = np.std(smoothed.root[middle, 2]) / np.std(clip.root[middle, 2])
    assert gain**2 == pytest.approx(0.5, rel=0.02)


def test_a_higher_share_of_wrong_clips_contains_the_lower(cases: list[Case]) -> None:
    for name in ("wrong-action", "one-for-all"):
        wrong = [
            {i for i in range(6) if BY_NAME[name].result(cases, i, grade, 5) is not cases[i].performance}
            for grade in range(5)
        ]
        assert all(lower <= higher for lower, higher in pairwise(wrong))
        assert len(wrong[2]) == 3
    assert len(wrong[4]) == 5, "the one that stands for all is right for itself"
    for index in range(6):
        clip = BY_NAME["wrong-action"].result(cases, index, 4, 5)
        assert clip.meta.action != cases[index].action


def test_the_way_back_has_the_same_fault(cases: list[Case]) -> None:
    back = BY_NAME["noise"].round_trip(cases, 0, 3, 1)
    assert back is not None
    assert back.skeleton == cases[0].source.skeleton
    assert not same(back, cases[0].source)
    assert BY_NAME["noise"].round_trip(cases, 0, 0, 1) is cases[0].source
    assert BY_NAME["half-style"].round_trip(cases, 0, 2, 1) is None
