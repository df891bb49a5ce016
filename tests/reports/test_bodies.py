"""The projection of stick bodies, against directions known beforehand."""

from __future__ import annotations

import numpy as np
import pytest

from benchmark.commands.conformance.figures import figure
from reports.figures.bodies import project, segments


def test_projection_from_the_front_and_the_side():
    up, left, front = np.eye(3)[[1, 0, 2]]
    # Seen from the front, the figure's left (+X) is on the page's right.
    np.testing.assert_allclose(project(left, turn=0.0, tilt=0.0)[:2], [1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(project(up, turn=0.0, tilt=0.0)[:2], [0.0, 1.0], atol=1e-12)
    # From the figure's left side its front points to the page's left, and its left to the eye.
    side = project(front, turn=np.pi / 2, tilt=0.0)
    np.testing.assert_allclose(side[:2], [-1.0, 0.0], atol=1e-12)
    assert project(left, turn=np.pi / 2, tilt=0.0)[2] == pytest.approx(1.0)


def test_projection_keeps_lengths(rng):
    points = rng.normal(size=(20, 3))
    seen = project(points, turn=0.7, tilt=0.2)
    np.testing.assert_allclose(np.linalg.norm(seen, axis=-1), np.linalg.norm(points, axis=-1), atol=1e-12)


def test_sides_of_limbs():
    skeleton = figure()
    side = {skeleton.names[child]: side for _, child, side in segments(skeleton)}
    for role, joint in skeleton.roles.items():
        if joint and not role.startswith("hips"):
            expected = role.split("_")[0] if role.startswith(("left", "right")) else "trunk"
            assert side[skeleton.names[joint]] == expected, role
