"""Motion packed into the page."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from benchmark.motion import quat
from benchmark.motion.clip import MotionClip
from benchmark.motion.skeleton import Skeleton
from reports.html.bodies import body_points, make_body
from reports.html.motion import LONGEST, choose_clips, make_reel, pack, phase, thin, unpack
from reports.run import RunView


@given(
    arrays(
        np.float64,
        st.tuples(st.integers(1, 6), st.integers(1, 4), st.just(3)),
        elements=st.floats(-50.0, 50.0, allow_subnormal=False),
    )
)
def test_packed_positions_are_off_by_half_a_step_at_most(positions):
    packed = pack(positions)
    found = unpack(packed, positions.shape[1])
    assert np.abs(found - positions).max() <= 0.5 * packed["step"] + 2e-6
    assert packed["step"] <= max(1e-6, np.ptp(positions) / 65535.0 + 1e-12)


def test_thinning_keeps_what_moves_evenly():
    times = np.arange(241) / 60.0
    positions = np.stack([times, 2 * times, -times], axis=-1)[:, None]
    fps, thinned = thin(positions, 60.0)
    assert fps == 30.0 and len(thinned) == 121
    np.testing.assert_allclose(thinned[:, 0, 0], np.arange(121) / 30.0, atol=1e-12)
    fps, same = thin(positions, 25.0)
    assert fps == 25.0 and len(same) == 241
    assert len(thin(np.zeros((3000, 1, 3)), 30.0)[1]) == LONGEST * 30 + 1


def _clip(seconds: float, fps: float = 20.0) -> MotionClip:
    frames = round(seconds * fps) + 1
    skeleton = Skeleton(("a",), np.array([-1]), np.zeros((1, 3)))
    return MotionClip(skeleton, quat.identity(frames, 1), np.zeros((frames, 3)), fps)


def test_a_time_map_is_turned_round():
    source, result = _clip(2.0), _clip(4.0)
    # Each output frame shows half its time of the source: twice as slow.
    found = phase(result, source, result.times / 2, follows=True)
    assert found == [200 * tenth for tenth in range(21)]


def test_who_follows_no_input_goes_evenly_and_who_keeps_the_clock_has_no_phase():
    source, real = _clip(2.0), _clip(3.0)
    assert phase(real, source, None, follows=False) == [150 * tenth for tenth in range(21)]
    assert phase(source, source, None, follows=True) is None


def test_reel_holds_every_action_once_and_every_method(finished):
    run = RunView(finished)
    reel = make_reel(run)
    assert [clip["id"] for clip in reel.clips] == choose_clips(run, "adult:child", run.cells("adult:child"))
    assert reel.notes == [] and len(reel.index["clips"]) == 2
    for packed in reel.clips:
        assert [figure["method"] for figure in packed["figures"]] == run.methods("adult:child")
        assert [figure["role"] for figure in packed["figures"]] == ["input", "method", "real"]
        for figure, (_, clip) in zip(packed["figures"], run.renderings("adult:child", packed["id"]), strict=True):
            body = reel.index["bodies"][figure["body"]]
            points = body_points(clip, make_body(clip.skeleton))
            found = unpack(figure, body["points"])
            np.testing.assert_allclose(found[0], points[0], atol=figure["step"])
            assert (figure["frames"] - 1) / figure["fps"] == pytest.approx(clip.duration, abs=1 / 30)
    timed = {figure["method"] for clip in reel.clips for figure in clip["figures"] if figure["phase"]}
    assert timed == {"dynamic-scaling[time]", "child-reference"}


def test_a_budget_leaves_clips_out_and_says_so(finished):
    run = RunView(finished)
    sizes = [sum(len(figure["data"]) for figure in clip["figures"]) for clip in make_reel(run).clips]
    reel = make_reel(run, budget=sizes[0])
    assert len(reel.clips) == 1 and reel.notes == ["1 of 2 actions are here, as many as the page has room for."]
    assert make_reel(run, budget=0).clips == []
