"""What the figures of motion draw, against oracles: moments, fronts, hulls, joint angles, paths, overlaid jumps."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from benchmark.data.synthetic import SyntheticDataset
from benchmark.motion import quat
from eval.metrics.jump import find_jump
from reports.figures.contents import contents, groups
from reports.figures.joints import joint_changes
from reports.figures.jump_overlay import figures_at
from reports.figures.jump_overlay import moments as jump_moments
from reports.figures.mannequin import capsules
from reports.figures.moments import ALIKE, SAME, STATED, matching, most_alike, stretch
from reports.figures.pareto import front
from reports.figures.trajectories import DEVIATION, deviations, paths, travellers
from reports.jumps import JumpRow
from reports.run import RunView
from reports.trajectory_tables import deviation_table

TASK = "adult:child"


@pytest.fixture(scope="module")
def walk():
    return SyntheticDataset().load("adult/adult001/walk_1")


@pytest.fixture(scope="module")
def leap():
    return SyntheticDataset().load("adult/adult001/jump-as-high-as-you-can-in-place_1")


def test_moments_are_a_step_apart_where_the_clip_moves_most(leap):
    times = stretch(leap, step=5, poses=6)
    np.testing.assert_allclose(np.diff(times), 5 / 60)
    jump = find_jump(leap)
    # Most moves between crouching and the landing's lowest point.
    assert jump.take_off - 1.0 < times[0] and times[-1] < jump.end
    assert len(stretch(leap.frames(0, 3), step=60, poses=6)) == 1


def test_the_phase_of_a_result_follows_from_what_is_known_of_it(walk):
    times = stretch(walk, step=5, poses=6)
    shown, how = matching(walk, times, walk)
    assert how == SAME and np.array_equal(shown, times)
    # Played at half the speed, it shows at 2 t what the source shows at t.
    slow = walk.replace(fps=walk.fps / 2.0)
    shown, how = matching(walk, times, slow, time_map=walk.times)
    assert how == STATED
    np.testing.assert_allclose(shown, 2.0 * times, atol=1e-9)
    # Without the stated times it is found by its poses, within the step of the durations tried.
    late = walk.frames(20, len(walk))
    begun = times + 30 / walk.fps
    shown, how = matching(walk, begun, late)
    assert how == ALIKE
    np.testing.assert_allclose(shown, begun - 20 / walk.fps, atol=0.08)
    assert most_alike(walk, times[:1], walk) == pytest.approx(times[:1], abs=1.0 / walk.fps)


points = st.integers(1, 12).flatmap(
    lambda n: st.tuples(*(arrays(np.float64, n, elements=st.integers(0, 6).map(float)) for _ in range(2)))
)


@given(points)
def test_the_front_is_what_no_other_beats(both):
    cost, quality = both
    found = front(cost, quality)

    def beaten(i: int) -> bool:
        better = (cost <= cost[i]) & (quality >= quality[i]) & ((cost < cost[i]) | (quality > quality[i]))
        return bool(better.any())

    unbeaten = {(cost[i], quality[i]) for i in range(len(cost)) if not beaten(i)}
    assert {(cost[i], quality[i]) for i in found} == unbeaten
    # Of equal points one; cheapest first, and better the dearer.
    assert len(found) == len(unbeaten)
    assert (np.diff(cost[found]) > 0).all() and (np.diff(quality[found]) > 0).all()


@given(
    arrays(np.float64, (4, 2, 2), elements=st.floats(-2, 2)), arrays(np.float64, (4, 2), elements=st.floats(0.05, 1))
)
def test_capsules_are_hulls_of_their_circles(centres, radii):
    for hull, ends, sizes in zip(capsules(centres, radii), centres, radii, strict=True):
        # No corner lies outside the swept circle, and each lies on its rim.
        share = np.linspace(0.0, 1.0, 401)[:, None]
        middles, reach = ends[0] + share * (ends[1] - ends[0]), sizes[0] + share[:, 0] * (sizes[1] - sizes[0])
        gaps = (np.linalg.norm(hull[:, None] - middles, axis=-1) - reach).min(axis=1)
        np.testing.assert_allclose(gaps, 0.0, atol=2e-2)
        # It turns one way all along.
        edges = np.roll(hull, -1, axis=0) - hull
        following = np.roll(edges, -1, axis=0)
        turns = edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0]
        assert (turns > -1e-9).all() or (turns < 1e-9).all()


@pytest.mark.parametrize("stated", [False, True])
def test_joint_changes_are_the_turns_that_were_made(walk, stated):
    elbow = walk.skeleton.joint("left_elbow")
    rotations = np.array(walk.rotations)
    rotations[:, elbow] = quat.mul(rotations[:, elbow], quat.from_axis_angle([0.0, 1.0, 0.0], np.deg2rad(25.0)))
    turned = walk.replace(rotations=rotations)
    found = joint_changes(turned, walk, walk.times if stated else None, copied=False)
    assert found.pop("left_elbow") == pytest.approx(25.0, abs=1e-6)
    assert max(found.values()) < 1e-5
    # By time warping a clip is nearest to itself.
    assert max(joint_changes(walk, walk, None, copied=True).values()) < 1e-5


def test_paths_start_at_the_hips_and_are_leg_lengths(walk):
    own = paths(walk)
    assert set(own) == {"hips", "left", "right"}
    np.testing.assert_array_equal(own["hips"][0], 0.0)
    moved = paths(walk.with_root(walk.root + [3.0, 0.0, -2.0]))
    for part, path in own.items():
        np.testing.assert_allclose(moved[part], path, atol=1e-9)
    travelled = walk.positions[-1, 0, [0, 2]] - walk.positions[0, 0, [0, 2]]
    np.testing.assert_allclose(own["hips"][-1] * walk.skeleton.leg_length, travelled, atol=1e-9)


def test_deviations_are_the_stored_metrics(finished):
    run = RunView(finished)
    rows = run.results
    rows = rows[(rows["metric"] == DEVIATION) & (rows["variant"] == "raw") & (rows["status"] == "ok")]
    table = deviation_table(run, TASK)
    for method, own in rows.groupby("method"):
        found = table[(table["method"] == method) & (table["metric"] == DEVIATION)].set_index("action")
        assert found.loc["all", "mean"] == pytest.approx(own["value"].mean())
        assert found.loc["all", "n"] == own["clip_id"].nunique()
        for action, part in own.groupby("action"):
            assert found.loc[action, "mean"] == pytest.approx(part["value"].mean())
    (first, *_) = travellers(run, TASK)
    here = rows[rows["clip_id"] == first].groupby("method")["value"].mean()
    assert deviations(run, TASK, first) == pytest.approx(here.to_dict())


def test_overlaid_bodies_face_one_way_at_the_moments_of_their_jump(leap):
    row = JumpRow("method", "result", "a", leap)
    take_off, top, lowest = jump_moments(row)
    assert take_off < top < lowest
    hips = leap.positions[:, leap.skeleton.joint("hips"), 1]
    inside = (leap.times >= row.jump.take_off) & (leap.times <= row.jump.touchdown)
    assert np.interp(top, leap.times, hips) == pytest.approx(hips[inside].max())
    bodies = figures_at(row)
    joint = leap.skeleton.joint("hips")
    np.testing.assert_allclose(bodies[:, joint, [0, 2]], 0.0, atol=1e-9)
    np.testing.assert_allclose(bodies[1, joint, 1] * leap.skeleton.leg_length, hips[inside].max(), atol=1e-9)
    # Turned and moved as a whole, it is drawn the same.
    turn = quat.from_axis_angle([0.0, 1.0, 0.0], 0.9)
    rotations = np.array(leap.rotations)
    rotations[:, 0] = quat.mul(turn, rotations[:, 0])
    moved = leap.replace(rotations=rotations, root=quat.rotate(turn, leap.root) + [1.0, 0.0, 2.0])
    np.testing.assert_allclose(figures_at(JumpRow("method", "result", "a", moved)), bodies, atol=1e-6)


def test_tasks_share_a_comparison_only_where_they_were_tested_on_the_same_contents():
    tested = {"a:b": ["x", "y", "z"], "a:c": ["z", "x", "y"], "a:d": ["x", "u"], "a:e": ["u", "x"]}
    run = SimpleNamespace(
        cells=lambda task: [SimpleNamespace(results=tested[task])],
        showpieces=lambda task, count, among: [name for name in tested[task] if name in among][:count],
    )
    assert groups(run, list(tested)) == [["a:b", "a:c"], ["a:d", "a:e"]]
    assert contents(run, ["a:b", "a:d"]) == ["x"]
