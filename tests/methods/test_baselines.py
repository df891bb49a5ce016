from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from benchmark.api import FitContext, StyleTask
from benchmark.commands.conformance.figures import ADULT, CHILD, SmallView, perform, small_view, wave
from benchmark.errors import ConfigError, DataError, MotionFileError
from benchmark.motion import quat
from benchmark.motion.clip import ClipMeta
from benchmark.motion.resample import resample
from methods.child_reference import ChildReference
from methods.identity import Identity
from methods.nearest import Nearest

RNG = np.random.default_rng(0)


def task(**changes) -> StyleTask:
    return replace(StyleTask(ADULT, CHILD, perform("walk", CHILD, 1).skeleton), **changes)


def fitted(view=None, **params) -> Nearest:
    return Nearest(**params).fit(view or small_view(), task(), rng=RNG, ctx=FitContext())


def test_identity_keeps_angles_and_clock_and_puts_them_on_the_target() -> None:
    source = perform("walk", ADULT, 1)
    clip = Identity().transfer(source, task(), rng=RNG).clip
    assert clip.skeleton == task().target_skeleton
    assert len(clip) == len(source)
    assert np.max(quat.angle(clip.rotations, source.rotations)) < 1e-7


def test_identity_without_a_target_skeleton_is_the_source() -> None:
    source = perform("walk", ADULT, 1)
    assert Identity().transfer(source, task(target_skeleton=None), rng=RNG).clip is source


def test_child_reference_is_the_real_clip_on_its_own_body() -> None:
    real = perform("walk", CHILD, 2)
    result = ChildReference().transfer(perform("walk", ADULT, 1), task(reference=real), rng=RNG)
    assert result.clip is real
    assert result.copied_from == "child/child2/walk_2"


def test_child_reference_takes_the_rate_of_the_source() -> None:
    source = resample(perform("walk", ADULT, 1), 30.0)
    clip = ChildReference().transfer(source, task(reference=perform("walk", CHILD, 2)), rng=RNG).clip
    assert clip.fps == 30.0


def test_child_reference_says_when_there_is_none() -> None:
    with pytest.raises(DataError, match="no real child clip of 'walk'"):
        ChildReference().transfer(perform("walk", ADULT, 1), task(), rng=RNG)


def test_nearest_finds_the_clip_of_the_same_action() -> None:
    result = fitted().transfer(perform("wave", ADULT, 3), task(), rng=RNG)
    assert result.copied_from in ("child/child1/wave_1", "child/child2/wave_2")
    assert result.clip.skeleton == task().target_skeleton
    assert result.diagnostics["action_in_training"] is True
    assert result.diagnostics["candidates"] == 2


def gesture(style: str, swing: float, take: int, tempo: float):
    """Two waves of the hand, by figures of several sizes and proportions."""
    clip = wave(perform("wave", style, take).skeleton, swing=swing, tempo=tempo, seconds=2.0 / tempo)
    return clip.replace(meta=ClipMeta(f"c{take}", style, "wave", str(take)))


@pytest.mark.parametrize(
    ("swing", "expected"), [(0.2, "child/c1/wave_1"), (0.55, "child/c2/wave_2"), (0.9, "child/c3/wave_3")]
)
def test_nearest_finds_the_closest_poses_whatever_tempo_size_and_facing(swing: float, expected: str) -> None:
    view = SmallView(tuple(gesture(CHILD, s, k, 0.6 + 0.3 * k) for k, s in ((1, 0.2), (2, 0.55), (3, 0.9))))
    source = gesture(ADULT, swing, 1, 0.7)
    turn = quat.from_axis_angle(np.array([0.0, 1.0, 0.0]), np.array(1.0))
    rotations = source.rotations.copy()
    rotations[:, 0] = quat.mul(turn, rotations[:, 0])
    source = source.replace(rotations=rotations, root=quat.rotate(turn, source.root) + [4.0, 0.0, 4.0])
    assert fitted(view).transfer(source, task(), rng=RNG).copied_from == expected


def test_nearest_with_a_shortlist_of_all_agrees_with_a_short_one() -> None:
    view = SmallView(tuple(gesture(CHILD, 0.1 * k, k, 0.9) for k in range(1, 10)))
    source = gesture(ADULT, 0.52, 1, 0.8)
    found = {fitted(view, shortlist=size).transfer(source, task(), rng=RNG).copied_from for size in (2, 4, 9)}
    assert found == {"child/c5/wave_5"}


def test_nearest_seeks_an_unknown_action_among_all() -> None:
    source = perform("walk", ADULT, 3)
    strange = source.replace(meta=replace(source.meta, action="march"))
    result = fitted().transfer(strange, task(), rng=RNG)
    assert result.copied_from is not None and "walk" in result.copied_from
    assert result.diagnostics["action_in_training"] is False
    assert result.diagnostics["candidates"] == 4


def test_nearest_returns_the_clip_at_the_rate_of_the_source() -> None:
    result = fitted().transfer(resample(perform("walk", ADULT, 3), 30.0), task(), rng=RNG)
    assert result.clip.fps == 30.0


def test_nearest_needs_target_clips() -> None:
    with pytest.raises(DataError, match="'child'"):
        fitted(SmallView(small_view().clips(ADULT)))


@pytest.mark.parametrize("params", [{"coarse_fps": 0.0}, {"coarse_fps": 60.0}, {"shortlist": 0}])
def test_nearest_refuses_settings_out_of_range(params: dict) -> None:
    with pytest.raises(ConfigError, match="nearest"):
        fitted(**params)


def test_nearest_names_a_damaged_file(tmp_path) -> None:
    fitted().save(tmp_path)
    (tmp_path / "clip-00001.npz").write_bytes(b"not a clip")
    with pytest.raises(MotionFileError, match="clip-00001"):
        Nearest.load(tmp_path)


def test_naming_the_methods_imports_none_of_them() -> None:
    probe = (
        "import methods, sys; print([n for n in sys.modules if n.startswith('methods.') or n in ('numpy', 'torch')])"
    )
    done = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
