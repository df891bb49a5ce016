"""What the pictures show."""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import numpy as np
import pytest

from benchmark.errors import ConfigError
from benchmark.motion.clip import MotionClip
from benchmark.motion.quat import from_axis_angle, inv_rotate, mul
from benchmark.motion.skeleton import Skeleton
from reports.video import Panel, Scene, render
from reports.video.bodies import make_body, stature
from reports.video.camera import FOLLOW_SIGMA, Camera, frame_camera, smooth_path
from reports.video.canvas import Canvas, to_luma, to_ycc
from reports.video.scene import HEIGHT, LEG, scale_of

SMALL = (160, 120)


def body_mask(picture: np.ndarray) -> np.ndarray:
    """Where a picture is coloured: bodies are, backdrop, ground and shadow are grey."""
    return np.ptp(picture.astype(int), axis=-1) > 24


def mirrored(clip: MotionClip) -> MotionClip:
    """The clip in a mirror across x = 0: reflected positions, left and right exchanged by name."""
    skeleton = clip.skeleton
    swap = [
        skeleton.names.index(name.replace("Left", "#").replace("Right", "Left").replace("#", "Right"))
        for name in skeleton.names
    ]
    turn = clip.rotations[:, swap] * [1.0, 1.0, -1.0, -1.0]
    return clip.replace(rotations=turn, root=clip.root * [-1.0, 1.0, 1.0], source=None)


def test_frames_have_the_size_asked_for_and_move(walk):
    frames = list(render([Panel(walk)], size=SMALL, fps=10))
    assert len(frames) == 21
    assert all(frame.shape == (120, 160, 3) and frame.dtype == np.uint8 for frame in frames)
    assert all(np.abs(a.astype(int) - b).max() > 60 for a, b in pairwise(frames))


def test_the_whole_figure_is_in_the_picture_and_none_too_small(walk, jump):
    for clip in (walk, jump):
        for frame in render([Panel(clip)], size=SMALL, fps=5):
            mask = body_mask(frame)
            assert not (mask[0].any() or mask[-1].any() or mask[:, 0].any() or mask[:, -1].any())
        heights = [np.ptp(np.flatnonzero(body_mask(f).any(axis=1))) for f in render([Panel(clip)], size=SMALL, fps=5)]
        assert max(heights) > 0.6 * 120


def test_left_is_blue_and_right_is_orange_unless_sides_are_not_told(walk):
    frame = next(iter(render([Panel(walk)], size=(320, 240)))).astype(int)
    blue, orange = frame[..., 2] - frame[..., 0] > 60, frame[..., 0] - frame[..., 2] > 60
    # Seen from the front, the figure's left is on the right.
    assert np.flatnonzero(blue.any(axis=0)).mean() > np.flatnonzero(orange.any(axis=0)).mean() + 10
    plain = next(iter(render([Panel(walk)], size=(320, 240), sides=False))).astype(int)
    assert np.ptp(plain, axis=-1).max() < 50


def test_a_mirrored_motion_gives_the_mirrored_sides(walk):
    """The camera stands to the left, so pictures are not mirror images; which side is where is."""

    def sides(clip):
        frame = Scene([Panel(clip)], size=(320, 240)).frame_at(0.5).rgb().astype(int)
        return (frame[..., 2] - frame[..., 0] > 60).sum(), (frame[..., 0] - frame[..., 2] > 60).sum()

    twice = mirrored(mirrored(walk))
    np.testing.assert_allclose(twice.positions, walk.positions, atol=1e-9)
    body, other = make_body(walk), make_body(mirrored(walk))
    for number, side in enumerate(body.sides):
        if side:
            wanted = body.starts[:, number] * [-1.0, 1.0, 1.0]
            gaps = np.abs(other.starts[:, other.sides == 3 - side] - wanted[:, None]).max(axis=(0, 2))
            assert gaps.min() < 1e-9
    assert min(sides(mirrored(walk))) > 100


def test_the_ground_scrolls_with_a_walk_and_the_camera_follows(walk):
    frames = list(render([Panel(walk)], size=(320, 240), fps=10))
    middles = [np.flatnonzero(body_mask(frame).any(axis=0)).mean() for frame in frames]
    walked = np.linalg.norm(walk.root[-1] - walk.root[0])
    assert walked > 1.5
    assert np.ptp(middles) < 0.2 * 320
    ground = [frame[200:, :40].astype(int) for frame in frames]
    assert any(np.abs(a - b).max() > 15 for a, b in pairwise(ground))


def test_the_path_followed_is_smooth_without_delay():
    fps, speed = 60.0, 1.3
    time = np.arange(400) / fps
    even = np.stack([speed * time, np.ones_like(time), 0.2 * time], axis=1)
    path = smooth_path(even, fps)
    np.testing.assert_allclose(path[:, 0], even[:, 0], atol=1e-9)
    assert (path[:, 1] == 0).all()
    shaken = even + 0.05 * np.sin(2 * np.pi * 2.0 * time)[:, None]
    inside = slice(round(3 * FOLLOW_SIGMA * fps), -round(3 * FOLLOW_SIGMA * fps))
    np.testing.assert_allclose(smooth_path(shaken, fps)[inside, 0], even[inside, 0], atol=1e-3)


def test_the_shadow_leaves_the_feet_in_a_jump(jump):
    top = float(jump.times[np.argmax(jump.positions[:, jump.skeleton.joint("hips"), 1])])
    scene = Scene([Panel(jump)], size=(320, 240))

    def gap(at: float) -> float:
        frame = scene.frame_at(at).rgb().astype(int)
        feet = np.flatnonzero(body_mask(frame).any(axis=1)).max()
        dark = (frame[..., 1] < 175) & ~body_mask(frame) & (np.arange(240) > 120)[:, None]
        return float(np.flatnonzero(dark.any(axis=1)).mean() - feet)

    assert gap(top) > gap(0.0) + 5


def test_feet_stand_on_the_ground_that_is_drawn(walk):
    body = make_body(walk)
    lowest = np.minimum(
        (body.starts[..., 1] - body.radii[:, 0]).min(axis=1), (body.ends[..., 1] - body.radii[:, 1]).min(axis=1)
    )
    leg = walk.skeleton.leg_length
    assert abs(float(np.median(lowest)) + body.sole) < 0.02 * leg
    assert lowest.min() > -body.sole - 0.03 * leg


def test_the_nose_points_where_the_body_goes(walk):
    body = make_body(walk)
    nose, head = body.starts[:, -1], body.starts[:, -2]
    ahead = np.diff(walk.root, axis=0).mean(axis=0) * [1.0, 0.0, 1.0]
    assert ((nose - head) @ (ahead / np.linalg.norm(ahead)) > 0.05 * walk.skeleton.leg_length).all()
    # Whatever the file takes for zero.
    head_joint = walk.skeleton.joint("head")
    odd = from_axis_angle([0.0, 1.0, 0.0], 2.0)
    turned = walk.rotations.copy()
    turned[:, head_joint] = mul(turned[:, head_joint], odd)
    ends = [
        dataclasses.replace(end, offset=tuple(inv_rotate(odd, np.array(end.offset))))
        if end.parent == head_joint
        else end
        for end in walk.skeleton.end_sites
    ]
    other = walk.replace(
        skeleton=walk.skeleton.with_offsets(walk.skeleton.offsets, ends), rotations=turned, source=None
    )
    np.testing.assert_allclose(make_body(other).starts, body.starts, atol=1e-9)


def test_what_is_below_the_ground_is_hidden(walk):
    sunk = walk.with_root(walk.root - [0.0, 0.5, 0.0])
    shown = [
        np.count_nonzero(body_mask(Scene([Panel(clip)], size=(320, 240)).frame_at(1.0).rgb())) for clip in (walk, sunk)
    ]
    assert 0.3 * shown[0] < shown[1]
    frame = Scene([Panel(sunk)], size=(320, 240)).frame_at(1.0).rgb()
    assert np.flatnonzero(body_mask(frame).any(axis=1)).max() < 235


def test_panels_share_scale_and_clock(walk, jump):
    pair = Scene([Panel(walk, "one"), Panel(jump, "two")], size=(640, 240))
    frame = pair.frame_at(0.0).rgb()
    tall = [np.ptp(np.flatnonzero(body_mask(part).any(axis=1))) for part in (frame[:, :320], frame[:, 320:])]
    ratio = stature(walk.skeleton) / stature(jump.skeleton)
    assert tall[0] / tall[1] == pytest.approx(ratio, rel=0.12)
    same = Scene([Panel(walk), Panel(jump)], size=(640, 240), normalise="height").frame_at(0.0).rgb()
    tall = [np.ptp(np.flatnonzero(body_mask(part).any(axis=1))) for part in (same[:, :320], same[:, 320:])]
    assert tall[0] / tall[1] == pytest.approx(1.0, rel=0.08)
    # The shorter clip holds its last pose.
    short = min((walk, jump), key=lambda clip: clip.duration)
    late, later = (
        Scene([Panel(walk), Panel(jump)], size=(640, 240)).frame_at(short.duration + extra).rgb()
        for extra in (0.1, 0.3)
    )
    held = (slice(None), slice(0, 320) if short is walk else slice(320, None))
    np.testing.assert_array_equal(late[held], later[held])


@pytest.mark.parametrize(("how", "wanted"), [("leg", LEG), ("height", HEIGHT)])
def test_normalised_bodies_are_of_one_size(walk, jump, how, wanted):
    for clip in (walk, jump):
        measure = clip.skeleton.leg_length if how == "leg" else stature(clip.skeleton)
        assert scale_of(clip, how) * measure == pytest.approx(wanted)


def test_titles_and_footer_are_written(walk):
    plain = next(iter(render([Panel(walk)], size=(320, 240))))
    titled = next(iter(render([Panel(walk, "a title")], size=(320, 240))))
    assert (titled[:16].min(axis=-1) < 120).any()
    assert not (plain[:16].min(axis=-1) < 120).any()
    foot = next(iter(render([Panel(walk)], size=(320, 240), footer="data set, licence")))
    assert (foot[-14:].min(axis=-1) < 160).any()
    assert foot[-1, 0].min() > 240


def test_a_long_title_is_kept_inside_its_panel(walk):
    frame = next(iter(render([Panel(walk, "W" * 300)], size=(320, 240))))
    assert frame[:16, :2].min() > 230


def test_a_skeleton_whose_joints_are_not_known_is_drawn_as_bones():
    names = ("a", "b", "c")
    skeleton = Skeleton(names, np.array([-1, 0, 1]), np.array([[0, 0, 0], [0, 0.5, 0], [0.3, 0.2, 0]]))
    turns = np.zeros((5, 3, 4))
    turns[..., 0] = 1.0
    clip = MotionClip(skeleton, turns, np.zeros((5, 3)), 30.0)
    frames = list(render([Panel(clip)], size=SMALL))
    assert len(frames) == 5
    assert frames[0].min() < 140
    with pytest.raises(Exception, match="role"):
        Scene([Panel(clip)], size=SMALL, normalise="leg").frame_at(0.0)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"size": (641, 480)}, "both even"),
        ({"size": (32, 32)}, "96 to 4096"),
        ({"fps": 0}, "frames per second"),
        ({"seconds": -1.0}, "seconds"),
        ({"normalise": "arm"}, "leg or height"),
        ({"panels": []}, "at least one clip"),
    ],
)
def test_settings_out_of_range_are_refused(walk, change, words):
    with pytest.raises(ConfigError, match=words):
        dataclasses.replace(Scene([Panel(walk)]), **change)


def test_too_many_panels_for_the_size_are_refused(walk):
    with pytest.raises(ConfigError, match="larger size"):
        Scene([Panel(walk, "title")] * 60, size=(96, 96)).frame_at(0.0)


def test_a_moment_outside_the_clip_is_refused(walk):
    with pytest.raises(ConfigError, match=r"between 0 and 2\.00 s"):
        Scene([Panel(walk)]).frame_at(9.0)


def test_colours_survive_the_way_through_luma_and_chroma():
    colours = np.array([[200.0, 30.0, 60.0], [20.0, 180.0, 90.0], [250.0, 250.0, 250.0], [128.0, 128.0, 128.0]])
    for colour in colours:
        canvas = Canvas(np.full((4, 4), 90, dtype=np.uint8))
        canvas.blend(np.stack([np.zeros((4, 4)), np.ones((4, 4))]).astype(np.float32), to_ycc(colour[None]), 0, 0)
        np.testing.assert_allclose(canvas.rgb()[1, 1], colour, atol=2.5)
    np.testing.assert_allclose(Canvas(to_luma(np.full((2, 2), 77.0)).round().astype(np.uint8)).rgb(), 77, atol=1)


def test_the_camera_sees_the_ground_where_it_projects_it():
    camera = frame_camera([np.array([[[-0.4, 0.0, -0.4], [0.4, 1.7, 0.4]]])], SMALL, -0.02)
    assert isinstance(camera, Camera)
    x, z = camera.ground(-0.02)
    for row, column in ((100, 20), (90, 80), (115, 140)):
        point = np.array([x[row, column], -0.02, z[row, column]])
        across, down, _ = camera.project(point)
        assert across == pytest.approx(column + 0.5, abs=1e-6)
        assert down == pytest.approx(row + 0.5, abs=1e-6)
