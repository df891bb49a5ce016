"""The bodies that the page draws."""

from __future__ import annotations

import numpy as np
import pytest

from benchmark.motion import quat
from benchmark.motion.clip import MotionClip
from benchmark.motion.skeleton import Skeleton
from reports.html.bodies import body_points, make_body
from reports.run import RunView


@pytest.fixture(scope="module")
def clip(finished):
    run = RunView(finished)
    return run.renderings("adult:child", run.showpiece("adult:child"))[0][1]


def test_every_point_is_drawn_and_every_limb_joins_two(clip):
    body = make_body(clip.skeleton)
    used = {place for limb in body.limbs for place in (limb.start, limb.end)} | set(body.head[:2])
    assert used == set(range(len(body.points)))
    assert all(limb.start != limb.end and min(limb.radius_start, limb.radius_end) > 0.005 for limb in body.limbs)
    sides = [limb.side for limb in body.limbs]
    assert sides.count("left") == sides.count("right") == 8


def test_joints_are_where_the_clip_has_them_and_tips_where_their_end_sites_are(clip):
    body = make_body(clip.skeleton)
    points = body_points(clip, body)
    assert points.shape == (len(clip), len(body.points), 3)
    positions = clip.positions
    for place, point in enumerate(body.points):
        if point >= 0:
            np.testing.assert_array_equal(points[:, place], positions[:, point])
        else:
            end = clip.skeleton.end_sites[-1 - point]
            away = np.linalg.norm(points[:, place] - positions[:, end.parent], axis=1)
            np.testing.assert_allclose(away, np.linalg.norm(end.offset), rtol=1e-9)
    assert any(point < 0 for point in body.points)


def test_a_skeleton_without_roles_is_drawn_bone_by_bone():
    skeleton = Skeleton(("a", "b", "c"), np.array([-1, 0, 1]), np.array([[0.0, 0, 0], [0, 0.5, 0], [0, 0.5, 0]]))
    body = make_body(skeleton)
    assert [(limb.start, limb.end) for limb in body.limbs] == [(0, 1), (1, 2)]
    assert body.head is None and body.to_json()["head"] is None
    clip = MotionClip(skeleton, quat.identity(2, 3), np.zeros((2, 3)), 30.0)
    np.testing.assert_allclose(body_points(clip, body)[0, 2], [0.0, 1.0, 0.0])


def test_scaled_bodies_have_scaled_limbs(clip):
    small, large = make_body(clip.skeleton), make_body(clip.skeleton.scaled(1.5))
    assert small.points == large.points
    for a, b in zip(small.limbs, large.limbs, strict=True):
        assert b.radius_start == pytest.approx(1.5 * a.radius_start)
    assert large.head[2] == pytest.approx(1.5 * small.head[2])
