from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmark.api import Capabilities, StyleTask, TransferResult
from benchmark.errors import ContractError
from benchmark.runner.contract import check_result

KEEPS = Capabilities(changes_proportions=False)


@pytest.fixture
def source(fakes):
    return fakes.Fake().load("adult/adult1/walk_1")


@pytest.fixture
def task(fakes):
    return StyleTask("adult", "child", fakes.skeleton(0.6))


def on_child(clip, fakes):
    return clip.replace(skeleton=fakes.skeleton(0.6))


def test_what_keeps_the_contract_comes_back(source, task, fakes):
    result = TransferResult(source)
    assert check_result(result, source, task, KEEPS) is result
    onto = TransferResult(on_child(source, fakes), time_map=source.times, contacts=np.ones((12, 2), dtype=bool))
    assert check_result(onto, source, task, Capabilities()) is onto
    shorter = TransferResult(on_child(source, fakes).frames(0, 5), time_map=np.linspace(0, source.duration, 5))
    assert check_result(shorter, source, task, Capabilities(changes_timing=True)) is shorter
    no_target = replace(task, target_skeleton=None)
    assert check_result(result, source, no_target, Capabilities()) is result


def test_the_ceiling_row_may_be_on_its_own_skeleton(source, task, fakes):
    result = TransferResult(source.replace(skeleton=fakes.skeleton(0.7)))
    assert check_result(result, source, task, Capabilities(uses_reference=True)) is result


@pytest.mark.parametrize(
    ("changes", "capabilities", "message"),
    [
        ({}, Capabilities(), "not|off that of task.target_skeleton"),
        ({"clip": lambda c: c.frames(0, 5)}, KEEPS, "5 frames and the source 12"),
        ({"clip": lambda c: c.replace(fps=60.0)}, KEEPS, "60 frames per second and the source 30"),
        ({"clip": lambda c: "clip"}, KEEPS, "must be a MotionClip, not str"),
        ({"raw_clip": lambda c: c.replace(fps=60.0)}, KEEPS, "raw_clip has 60"),
        ({"time_map": lambda c: np.zeros(3)}, KEEPS, r"time_map must be floats of shape \(12,\)"),
        ({"time_map": lambda c: np.arange(12)}, KEEPS, "time_map must be floats"),
        ({"time_map": lambda c: c.times[::-1]}, KEEPS, "falls at frame 1"),
        ({"time_map": lambda c: c.times * np.nan}, KEEPS, "not finite"),
        ({"time_map": lambda c: c.times * 2}, KEEPS, "outside the source's"),
        ({"time_map": lambda c: c.times - 1}, KEEPS, "outside the source's"),
        ({"contacts": lambda c: np.ones((12, 2))}, KEEPS, "contacts must be booleans"),
        ({"contacts": lambda c: np.ones((11, 2), dtype=bool)}, KEEPS, "contacts must be booleans"),
        ({"diagnostics": lambda c: {"loss": float("nan")}}, KEEPS, "diagnostics must be ready for JSON"),
        ({"diagnostics": lambda c: {"loss": object()}}, KEEPS, "diagnostics must be ready for JSON"),
        ({"copied_from": lambda c: 3}, KEEPS, "copied_from"),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, dict) else "",
)
def test_every_broken_promise_is_named(source, task, changes, capabilities, message):
    result = replace(TransferResult(source), **{name: change(source) for name, change in changes.items()})
    with pytest.raises(ContractError, match=message):
        check_result(result, source, task, capabilities)


def test_another_topology_is_refused(source, task, fakes):
    skeleton = replace(fakes.skeleton(), names=tuple(f"x{name}" for name in fakes.NAMES))
    with pytest.raises(ContractError, match="joints are not those of the source"):
        check_result(TransferResult(source.replace(skeleton=skeleton)), source, task, KEEPS)


def test_something_else_is_refused(source, task):
    with pytest.raises(ContractError, match="must return a TransferResult, not MotionClip"):
        check_result(source, source, task, KEEPS)


def test_arrays_altered_after_the_clip_was_made_are_seen(source, task):
    rotations = source.rotations.copy()
    clip = source.replace(rotations=rotations)
    rotations[2, 3] *= 2
    with pytest.raises(ContractError, match="not unit quaternions"):
        check_result(TransferResult(clip), source, task, KEEPS)


def test_fit_residual_is_summed_up_in_metres():
    import numpy as np

    from benchmark.commands.conformance.figures import figure, walk
    from benchmark.runner.execute import fit_residual

    clip = walk(figure())
    assert fit_residual(clip) is None
    residual = np.zeros((len(clip), len(clip.skeleton)))
    residual[:, 1:] = 0.02
    residual[0, 1] = 0.5
    assert fit_residual(clip.replace(residual=residual)) == {"median": 0.02, "p95": 0.02}
