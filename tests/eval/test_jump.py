"""Jumps whose phases, knee angles and arm swings are planted, generated or read off the curves of real captures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from benchmark.api import NotApplicableError, Sample, StyleTask
from benchmark.commands.conformance.figures import figure, walk, wave
from benchmark.data.catalog import open_dataset
from benchmark.data.synthetic import SyntheticDataset
from benchmark.data.synthetic.actions import write_score
from benchmark.data.synthetic.body import Body
from benchmark.data.synthetic.perform import perform
from benchmark.motion import quat
from benchmark.motion.clip import ClipMeta, MotionClip
from benchmark.motion.contacts import GRAVITY
from benchmark.motion.skeleton import SIDES, Skeleton
from benchmark.registry import METRICS
from eval.metrics.jump import (
    ArmSwing,
    LandingDuration,
    LandingKneeAngle,
    RecoveryDuration,
    arm_swing,
    find_jump,
    knee_angle,
    landing_duration,
    lowest_knee_bend,
    names_a_jump,
    recovery_duration,
)

X, Y, Z = np.eye(3)
#: The share of a leg at which a foot counts as down.
NEAR = 0.04


@dataclass(frozen=True)
class Plan:
    """A jump: when what happens in seconds, knee angles and arm angles in degrees, take-off speed in sqrt(g leg)."""

    crouch: float = 0.62
    deepest: float = 0.93
    take_off: float = 1.21
    speed: float = 0.7
    absorb: float = 0.21
    recover: float = 0.44
    standing: float = 175.0
    bottom: float = 105.0
    straight: float = 178.0
    landing: float = 131.0
    tuck: float = 178.0
    back: float = -35.0
    front: float = 110.0
    after: float = 0.8

    def air(self, leg: float) -> float:
        """Seconds in the air."""
        return 2.0 * self.speed * float(np.sqrt(leg / GRAVITY))

    def seen_down(self, leg: float) -> float:
        """When the falling feet come within :data:`NEAR` of the floor."""
        speed = self.speed * np.sqrt(GRAVITY * leg)
        return self.take_off + self.air(leg) - float((speed - np.sqrt(speed**2 - 2 * GRAVITY * NEAR * leg)) / GRAVITY)

    def seen_up(self, leg: float) -> float:
        """When the rising feet are that far from it."""
        return 2.0 * self.take_off + self.air(leg) - self.seen_down(leg)


def eased(t, nodes):
    """Through the nodes (time, value), at rest in each of them."""
    times, values = np.array(nodes).T
    place = np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(times) - 2)
    u = np.clip((t - times[place]) / (times[place + 1] - times[place]), 0.0, 1.0)
    return values[place] + (values[place + 1] - values[place]) * u * u * (3.0 - 2.0 * u)


def planted(plan: Plan, *, leg: float = 0.8, fps: float = 60.0, skeleton: Skeleton | None = None) -> MotionClip:
    """The plan as a motion: feet flat below the hips, knees bent as planned, a flight that obeys gravity."""
    skeleton = skeleton or figure(leg)
    thigh, shank = 0.52 * leg, 0.48 * leg
    down = plan.take_off + plan.air(leg)
    lowest, over = down + plan.absorb, down + plan.absorb + plan.recover
    t = np.arange(round((over + plan.after) * fps)) / fps
    knee = np.deg2rad(
        eased(
            t,
            [
                (0.0, plan.standing),
                (plan.crouch, plan.standing),
                (plan.deepest, plan.bottom),
                (plan.take_off, plan.straight),
                (0.5 * (plan.take_off + down), plan.tuck),
                (down, plan.straight),
                (lowest, plan.landing),
                (over, plan.standing),
                (t[-1] + 1.0, plan.standing),
            ],
        )
    )
    arm = np.deg2rad(
        eased(
            t, [(0.0, 0.0), (plan.crouch, 0.0), (plan.deepest, plan.back), (plan.take_off, plan.front), (lowest, 0.0)]
        )
    )
    reach = np.sqrt(thigh**2 + shank**2 - 2.0 * thigh * shank * np.cos(knee))
    lean = np.arcsin(np.clip(shank * np.sin(knee) / reach, -1.0, 1.0))
    rotations = quat.identity(len(t), len(skeleton))

    def turn(role, axis, angle):
        joint = skeleton.joint(role)
        rotations[:, joint] = quat.mul(quat.from_axis_angle(axis, angle), rotations[:, joint])

    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        turn(f"{side}_hip", X, -lean)
        turn(f"{side}_knee", X, np.pi - knee)
        turn(f"{side}_ankle", X, lean - (np.pi - knee))
        turn(f"{side}_shoulder", Z, np.full(len(t), -0.5 * np.pi * sign))
        turn(f"{side}_shoulder", X, -arm)
    clip = MotionClip(skeleton, rotations, np.zeros((len(t), 3)), fps)
    feet = clip.positions[:, skeleton.joints(*(r for r in ("left_ankle", "left_toe") if skeleton.has(r)))][..., 1]
    root = np.zeros((len(t), 3))
    root[:, 1] = -feet.min(axis=1) + 0.03 * leg
    flying = (t > plan.take_off) & (t < down)
    since = t[flying] - plan.take_off
    speed = plan.speed * np.sqrt(GRAVITY * leg)
    root[flying, 1] += speed * since - 0.5 * GRAVITY * since**2
    return clip.replace(root=root, meta=ClipMeta("a", "adult", "jump", "1"))


def sample(clip: MotionClip, action: str = "jump") -> Sample:
    source = clip.replace(meta=ClipMeta("a", "adult", action, "1"))
    return Sample(clip, source, (), None, StyleTask("adult", "child"))


@pytest.mark.parametrize("fps", [30.0, 60.0, 120.0])
@pytest.mark.parametrize("leg", [0.42, 0.95])
def test_phases_of_a_planted_jump(fps, leg):
    plan = Plan()
    jump = find_jump(planted(plan, fps=fps, leg=leg))
    down = plan.take_off + plan.air(leg)
    assert jump.take_off == pytest.approx(plan.seen_up(leg), abs=0.15 / fps)
    assert jump.touchdown == pytest.approx(plan.seen_down(leg), abs=0.15 / fps)
    assert jump.apex == pytest.approx(0.5 * (plan.take_off + down), abs=1.0 / fps)
    assert jump.lowest == pytest.approx(down + plan.absorb, abs=max(0.02, 0.75 / fps))
    # Three quarters of the eased way from the landing's angle to standing.
    assert jump.recovery == pytest.approx(down + plan.absorb + 0.674 * plan.recover, abs=0.02)
    assert jump.end == jump.recovery
    assert plan.crouch <= jump.start <= plan.crouch + 0.5 * (plan.deepest - plan.crouch)


@pytest.mark.parametrize("landing", [100.0, 131.0, 155.0])
@pytest.mark.parametrize("fps", [30.0, 120.0])
def test_measures_of_a_planted_jump(landing, fps):
    plan = Plan(landing=landing, back=-20.0, front=75.0)
    clip = planted(plan, fps=fps)
    # The median over 0.1 s rounds off the lowest point of a quick, deep bend.
    assert landing - 0.1 < LandingKneeAngle().compute(sample(clip)) < landing + 2.5
    assert ArmSwing().compute(sample(clip)) == pytest.approx(95.0, abs=3.0)
    down = plan.seen_down(0.8)
    expected = plan.take_off + plan.air(0.8) + plan.absorb - down
    assert LandingDuration().compute(sample(clip)) == pytest.approx(expected, abs=0.02)
    assert RecoveryDuration().compute(sample(clip)) == pytest.approx(expected + 0.674 * plan.recover, abs=0.02)


def test_a_longer_landing_and_a_wider_swing_measure_more():
    clips = [planted(Plan(absorb=absorb, front=front)) for absorb, front in ((0.12, 20.0), (0.2, 60.0), (0.3, 120.0))]
    jumps = [find_jump(clip) for clip in clips]
    for value in (landing_duration, arm_swing):
        values = [value(clip, jump) for clip, jump in zip(clips, jumps, strict=True)]
        assert values[0] < values[1] - 0.05 and values[1] < values[2] - 0.05


def test_size_place_facing_and_frame_rate_do_not_matter():
    plan = Plan()
    clip = planted(plan)
    turn = quat.from_axis_angle(Y, np.full(len(clip), 2.0))
    rotations = clip.rotations.copy()
    rotations[:, 0] = quat.mul(turn, rotations[:, 0])
    moved = clip.replace(rotations=rotations, root=clip.root + [3.0, 0.0, -2.0])
    for name, value in vars(find_jump(clip)).items():
        assert getattr(find_jump(moved), name) == pytest.approx(value, abs=1e-9)
    assert arm_swing(moved, find_jump(moved)) == pytest.approx(arm_swing(clip, find_jump(clip)), abs=1e-6)
    twice = clip.replace(
        skeleton=clip.skeleton.with_offsets(2.0 * clip.skeleton.offsets),
        root=2.0 * clip.root,
        fps=clip.fps / np.sqrt(2.0),
    )
    first, second = find_jump(clip), find_jump(twice)
    assert second.touchdown == pytest.approx(np.sqrt(2.0) * first.touchdown, abs=1e-9)
    assert lowest_knee_bend(twice, second) == pytest.approx(lowest_knee_bend(clip, first), abs=1.0)


def test_a_result_that_floats_or_sinks_is_measured_all_the_same():
    clip = planted(Plan())
    for height in (0.5, -0.2):
        moved = find_jump(clip.replace(root=clip.root + [0.0, height, 0.0]))
        for name, value in vars(find_jump(clip)).items():
            assert getattr(moved, name) == pytest.approx(value, abs=1e-9)


def test_without_toes_and_with_noise(rng):
    core = planted(Plan(), skeleton=figure(0.8, roles="core"), fps=30.0)
    assert find_jump(core).touchdown == pytest.approx(Plan().seen_down(0.8), abs=0.01)
    clip = planted(Plan(), fps=30.0)
    for _ in range(5):
        shake = quat.exp(0.02 * rng.standard_normal((*clip.rotations.shape[:2], 3)))
        noisy = clip.replace(
            rotations=quat.normalize(quat.mul(clip.rotations, shake)),
            root=clip.root + 0.006 * rng.standard_normal(clip.root.shape),
        )
        jump = find_jump(noisy)
        assert jump.touchdown == pytest.approx(Plan().seen_down(0.8), abs=0.034)
        assert jump.lowest == pytest.approx(Plan().take_off + Plan().air(0.8) + Plan().absorb, abs=0.034)
        assert lowest_knee_bend(noisy, jump) == pytest.approx(131.0, abs=4.0)
        assert arm_swing(noisy, jump) == pytest.approx(145.0, abs=6.0)


def test_a_knee_misplaced_for_one_frame_changes_nothing():
    clip = planted(Plan(), fps=30.0)
    jump = find_jump(clip)
    rotations = clip.rotations.copy()
    frame = round((jump.touchdown + 0.1) * 30.0)
    rotations[frame, clip.skeleton.joint("left_knee")] = quat.from_axis_angle(X, np.array(2.4))
    wrong = clip.replace(rotations=rotations)
    assert lowest_knee_bend(wrong, find_jump(wrong)) == pytest.approx(lowest_knee_bend(clip, jump), abs=3.0)


def test_legs_drawn_up_in_the_air_are_no_landing():
    plan = Plan(tuck=60.0)
    clip = planted(plan)
    jump = find_jump(clip)
    assert knee_angle(clip).min() < 70.0
    assert lowest_knee_bend(clip, jump) == pytest.approx(131.0, abs=1.5)
    assert jump.touchdown == pytest.approx(plan.seen_down(0.8), abs=0.02)


def joined(*clips: MotionClip) -> MotionClip:
    first = clips[0]
    return first.replace(
        rotations=np.concatenate([clip.rotations for clip in clips]), root=np.concatenate([clip.root for clip in clips])
    )


def test_of_two_jumps_the_higher_is_measured():
    low, high = planted(Plan(speed=0.5, landing=150.0)), planted(Plan(speed=0.8, landing=120.0))
    for order, before in (((low, high), low.times[-1] + 1 / 60), ((high, low), 0.0)):
        clip = joined(*order)
        jump = find_jump(clip)
        assert lowest_knee_bend(clip, jump) == pytest.approx(120.0, abs=1.5)
        assert jump.touchdown == pytest.approx(before + Plan(speed=0.8).seen_down(0.8), abs=0.01)


def test_a_landing_cut_off_has_no_recovery_and_one_not_seen_no_jump():
    clip = planted(Plan())
    jump = find_jump(clip)

    def until(seconds):
        return clip.frames(0, round(seconds * 60.0))

    short = until(jump.lowest + 0.15)
    assert find_jump(short).recovery is None and find_jump(short).lowest == pytest.approx(jump.lowest, abs=0.01)
    assert lowest_knee_bend(short, find_jump(short)) == pytest.approx(131.0, abs=1.5)
    with pytest.raises(NotApplicableError, match="before the figure stands again"):
        RecoveryDuration().compute(sample(short))
    for seconds in (jump.apex, jump.touchdown - 0.02, jump.touchdown + 0.08):
        assert find_jump(until(seconds)) is None
    assert find_jump(clip.frames(round(jump.apex * 60.0), len(clip))) is None


@pytest.mark.parametrize(
    "make",
    [
        lambda: wave(figure()),
        lambda: walk(figure()),
        lambda: walk(figure(), tempo=1.5, swing=0.6),
        lambda: planted(Plan(speed=0.0, take_off=1.3)),
        lambda: wave(figure()).frames(0, 1),
        lambda: wave(figure()).replace(root=wave(figure()).root + [0.0, 2.0, 0.0]),
    ],
    ids=["waving", "walking", "striding", "squatting", "one frame", "never on the floor"],
)
def test_what_is_no_jump_has_none(make):
    clip = make()
    assert find_jump(clip) is None
    for metric in (LandingKneeAngle(), ArmSwing(), LandingDuration(), RecoveryDuration()):
        with pytest.raises(NotApplicableError, match="no jump is seen"):
            metric.compute(sample(clip))


@pytest.mark.parametrize(
    ("action", "jumps"),
    [
        ("jump", True),
        ("jump-as-high-as-you-can-in-place", True),
        ("broad-jump-forward", True),
        ("run_and_JUMP", True),
        ("hop-scotch", True),
        ("jumping", True),
        ("leap2", True),
        ("do-two-jumping-jacks", False),
        ("5-jumping-jacks", False),
        ("jumpingjack", False),
        ("walk", False),
        ("shop", False),
        ("hope", False),
        ("", False),
    ],
)
def test_what_is_called_a_jump(action, jumps):
    assert names_a_jump(action) is jumps


def test_another_action_is_not_measured_whatever_it_looks_like():
    clip = planted(Plan())
    for metric in (LandingKneeAngle(), ArmSwing(), LandingDuration(), RecoveryDuration()):
        with pytest.raises(NotApplicableError, match="the action 'run' is no jump"):
            metric.compute(sample(clip, "run"))


def test_the_metrics_are_registered_and_describe_only():
    names = METRICS.select("jump/*")
    assert len(names) == 4
    for name in names:
        info = METRICS.get(name).info
        assert info.name == name and info.direction == "none" and info.needs == "none" and info.scope == "clip"


@pytest.fixture(scope="module")
def generated():
    """Generated jumps of both styles without noise, each with the times that its score states."""
    dataset = SyntheticDataset()
    found = []
    for record in dataset.records:
        if record.action in ("jump", "jump-as-high-as-you-can-in-place", "broad-jump-forward") and record.take == "1":
            actor = dataset.actors[record.actor]
            score = write_score(dataset.content(record.clip_id), Body(actor.skeleton), actor.parameters)
            found.append((record, score, perform(score, tpose=False), dataset))
    return found[::3]


def test_phases_of_generated_jumps(generated):
    assert {record.style for record, *_ in generated} == {"adult", "child"} and len(generated) >= 10
    for record, score, clip, _ in generated:
        jump = find_jump(clip)
        take_off, touchdown = min(score.flights, key=lambda flight: abs(flight[1] - jump.touchdown))
        lowest = min(time for time, *_ in score.heights if time > touchdown + 0.01)
        assert 0.0 < jump.take_off - take_off < 0.05, record.clip_id
        assert 0.0 < touchdown - jump.touchdown < 0.05, record.clip_id
        assert jump.lowest == pytest.approx(lowest, abs=0.012), record.clip_id


def test_generated_jumps_measure_the_same_after_capture(generated):
    """At the data set's own frame rate, with its noise and the T-pose before the motion."""
    for record, _, clip, dataset in generated[::2]:
        noisy = dataset.load(record.clip_id)
        before, after = find_jump(clip), find_jump(noisy)
        assert landing_duration(noisy, after) == pytest.approx(landing_duration(clip, before), abs=0.015)
        assert lowest_knee_bend(noisy, after) == pytest.approx(lowest_knee_bend(clip, before), abs=1.5)
        assert arm_swing(noisy, after) == pytest.approx(arm_swing(clip, before), abs=3.0)


#: Frames of take-off, touchdown and the lowest point, read off the plotted heights of hips, ankles and toes.
READ = {
    "adult/577": (23, 38, 44),
    "adult/734": (27, 42, 47),
    "adult/888": (21, 33, 36),
    "adult/921": (43, 60, 64),
    "adult/934": (28, 46, 49),
    "adult/976": (51, 71, 75),
    "child/106": (49, 62, 69),
    "child/169": (26, 40, 44),
    "child/337": (73, 84, 88),
    "child/342": (24, 37, 45),
    "child/595": (40, 53, 62),
    "child/644": (21, 34, 40),
    "child/723": (25, 43, 47),
}


@pytest.mark.real_data
def test_phases_of_every_real_jump(kinder_gator):
    dataset = open_dataset("kinder-gator", root=kinder_gator)
    takes = {record.clip_id for record in dataset.records if record.action == "jump-as-high-as-you-can"}
    assert takes == {f"{who}/jump-as-high-as-you-can_1" for who in READ}
    for who, frames in READ.items():
        clip = dataset.load(f"{who}/jump-as-high-as-you-can_1")
        jump = find_jump(clip)
        found = np.array([jump.take_off, jump.touchdown, jump.lowest]) * clip.fps
        np.testing.assert_allclose(found, frames, atol=1.7, err_msg=who)


@pytest.mark.real_data
def test_what_differs_between_the_posters_adult_and_child(kinder_gator):
    """The child trained on swings the arms twice as far as the adult of the poster; their landings hardly differ."""
    dataset = open_dataset("kinder-gator", root=kinder_gator)
    adult, child = (dataset.load(f"{who}/jump-as-high-as-you-can_1") for who in ("adult/934", "child/723"))
    jumps = find_jump(adult), find_jump(child)
    assert arm_swing(child, jumps[1]) > 1.8 * arm_swing(adult, jumps[0])
    assert abs(lowest_knee_bend(child, jumps[1]) - lowest_knee_bend(adult, jumps[0])) < 2.0
    assert abs(landing_duration(child, jumps[1]) - landing_duration(adult, jumps[0])) < 1.0 / 30.0
    assert recovery_duration(child, jumps[1]) - recovery_duration(adult, jumps[0]) > 1.0 / 30.0
