"""How work grows with size, in instructions of the interpreter: what a stopwatch on a shared machine cannot hold.

Python executes the same instructions for the same work on any machine, busy or not. Code that leaves loops over frames to
compiled libraries executes a few more for each frame (a block of some hundred is one step), where a loop over frames takes tens
and one over the joints of each frame hundreds. The limits are about twice what is needed now.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pytest

from benchmark.data.catalog import open_dataset
from benchmark.motion import bvh, contacts, footlock
from benchmark.motion.clip import MotionClip
from benchmark.motion.dtw import dtw
from benchmark.motion.kinematics import fk
from benchmark.motion.resample import resample
from benchmark.motion.retarget import retarget
from eval.features.kinematic import kinematic_features
from eval.metrics.spectral import mean_arc_length, power_spectra
from eval.metrics.two_sample import frechet, kernel_distance
from eval.stats.bootstrap import clustered_mean
from methods.hsu.lti import identify
from methods.hsu.space_warp import space_warp
from methods.hsu.time_warp import Corridor, time_warp

Work = Callable[[], object]


def instructions(work: Work) -> int:
    """Instructions of Python that ``work`` executes; what compiled code does inside one counts as that one."""
    count = 0

    def trace(frame: FrameType, event: str, _: Any) -> Any:
        nonlocal count
        frame.f_trace_opcodes, frame.f_trace_lines = True, False
        count += event == "opcode"
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        work()
    finally:
        sys.settrace(before)
    return count


def each(make: Callable[[int], Work], small: int) -> float:
    """Instructions for each frame, row or draw that a problem has more: between two sizes, one four times the other."""
    works = [make(small), make(4 * small)]
    make(small)()  # imports, and tables that are made once
    one, other = (instructions(work) for work in works)
    return (other - one) / (3 * small)


def test_the_counter_counts() -> None:
    def loop(size: int) -> Work:
        return lambda: sum(value * value for value in range(size))

    assert instructions(loop(100)) == instructions(loop(100))
    assert 5 < each(loop, 1000) < 20
    assert each(lambda size: np.arange(size).sum, 1000) == 0.0


@pytest.fixture(scope="module")
def long_clip() -> MotionClip:
    """A clip of the synthetic corpus, again and again: 8000 frames at 60 a second."""
    dataset = open_dataset("synthetic")
    clip = dataset.load(dataset.records[0].clip_id)
    index = np.arange(8000) % len(clip)
    return MotionClip(clip.skeleton, clip.rotations[index], clip.root[index], clip.fps)


def _first(clip: MotionClip, frames: int) -> MotionClip:
    return MotionClip(clip.skeleton, clip.rotations[:frames], clip.root[:frames], clip.fps)


def _of_a_clip(work: Callable[[MotionClip], object]) -> Callable[[MotionClip, Path], Callable[[int], Work]]:
    def make(whole: MotionClip, folder: Path) -> Callable[[int], Work]:
        def sized(frames: int) -> Work:
            clip = _first(whole, frames)
            return lambda: work(clip)

        return sized

    return make


def _loading(whole: MotionClip, folder: Path) -> Callable[[int], Work]:
    def sized(frames: int) -> Work:
        path = folder / f"{frames}.bvh"
        bvh.save(_first(whole, frames), path)
        return lambda: bvh.load(path)

    return sized


#: Work on a clip of 25 joints, and the instructions that a frame may take.
CLIPS = {
    "read BVH": (_loading, 25),
    "write BVH": (_of_a_clip(lambda clip: bvh.save(clip, "/dev/null")), 6),
    "forward kinematics": (_of_a_clip(lambda clip: fk(clip.skeleton, clip.rotations, clip.root)), 8),
    "resample": (_of_a_clip(lambda clip: resample(clip, 50.0)), 3),
    "retarget": (_of_a_clip(lambda clip: retarget(clip, clip.skeleton.scaled(0.8))), 16),
    "contacts": (_of_a_clip(contacts.detect), 10),
    "foot lock": (_of_a_clip(footlock.lock_feet), 130),
    "kinematic features": (_of_a_clip(kinematic_features), 9),
    "spectral arc length": (_of_a_clip(mean_arc_length), 9),
    "power spectra": (_of_a_clip(power_spectra), 10),
}


@pytest.mark.parametrize("name", CLIPS)
def test_work_on_a_clip_is_left_to_compiled_code(name: str, long_clip: MotionClip, tmp_path: Path) -> None:
    make, limit = CLIPS[name]
    assert each(make(long_clip, tmp_path), 2000) <= limit


def _noise(*shape: int) -> np.ndarray:
    return np.random.default_rng(5).normal(size=shape)


def _alignment(frames: int) -> Work:
    x, y = _noise(2, frames, 6)
    return lambda: dtw(x, y)


def _warping(frames: int) -> Work:
    x, y = _noise(2, frames, 6)
    corridor = Corridor.between(frames, frames, band=0.1, max_skip=2)
    return lambda: time_warp(x, y, corridor)


def _scaling(frames: int) -> Work:
    x, y = _noise(2, frames, 6)
    return lambda: space_warp(x, y, np.arange(frames), smooth_scale=10.0, smooth_offset=10.0, ridge=1e-3)


def _identification(frames: int) -> Work:
    x, y = _noise(2, frames, 3)
    return lambda: identify([x], [y], 4)


def _frechet(rows: int) -> Work:
    x, y = _noise(2, rows, 8)
    return lambda: frechet(x, y)


def _kernel(rows: int) -> Work:
    x, y = _noise(2, rows, 8)
    groups = np.arange(rows) % 10
    return lambda: kernel_distance(x, y, groups, groups)


def _interval(draws: int) -> Work:
    values, actors = _noise(40), [str(index % 4) for index in range(40)]
    return lambda: clustered_mean(values, actors, resamples=draws)


#: Work of a size, the smaller of the two sizes, and the instructions that a frame, row or draw may take.
SIZES = {
    "alignment, by diagonals": (_alignment, 200, 200),
    "time warp, by frames": (_warping, 200, 350),
    "space warp": (_scaling, 500, 1),
    "identification": (_identification, 500, 5),
    "Fréchet distance": (_frechet, 500, 0),
    "kernel distance": (_kernel, 500, 1),
    "bootstrap interval": (_interval, 500, 0),
}


@pytest.mark.parametrize("name", SIZES)
def test_numerical_work_is_left_to_compiled_code(name: str) -> None:
    make, small, limit = SIZES[name]
    assert each(make, small) <= limit


def operations(work: Work) -> int:
    """Operations of torch in the third run of ``work``, whose memory is made by then."""
    from torch.utils._python_dispatch import TorchDispatchMode

    class Counter(TorchDispatchMode):
        count = 0

        def __torch_dispatch__(self, function: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
            self.count += 1
            return function(*args, **(kwargs or {}))

    work()
    work()
    with Counter() as counter:
        work()
    return counter.count


class _Words:
    """The same random words at every turn, as training takes them."""

    def __init__(self, joints: int) -> None:
        import torch

        drawn = torch.randn(joints, 4, 100, generator=torch.Generator().manual_seed(joints))
        self.frames, self.rows = torch.nn.functional.normalize(drawn, dim=1), torch.arange(60)

    def words(self, numbers: Any) -> Any:
        """(J, 4, T, B)."""
        return self.frames[:, :, :60, None].expand(-1, -1, -1, len(numbers)).contiguous()


@pytest.mark.parametrize(("order", "limit"), [("joint", 4500), ("sequential", 7300)])
def test_an_update_of_the_cyclegan_takes_as_many_operations_for_any_batch_and_body(order: str, limit: int) -> None:
    from types import SimpleNamespace

    import torch

    from methods.cyclegan.discriminator import Discriminator
    from methods.cyclegan.generator import make_generator
    from methods.cyclegan.training import CycleGanStep, Weights

    def update(joints: int, batch: int) -> Work:
        seeds = torch.Generator().manual_seed(0)
        networks: list[Any] = [make_generator(joints, width=4, blocks=3) for _ in range(2)]
        networks += [Discriminator(joints, widths=(8, 16, 32, 64)) for _ in range(2)]
        for network in networks:
            network.reset(seeds)
        words: list[Any] = [_Words(joints) for _ in range(2)]
        step = CycleGanStep(*networks, *words, weights=Weights(), order=order)
        item: Any = SimpleNamespace(index=np.zeros((batch, 2), dtype=np.int64), generator=torch.Generator())
        return lambda: step(item)

    counts = {operations(update(joints, batch)) for joints, batch in ((5, 1), (5, 16), (9, 4))}
    assert len(counts) == 1 and counts.pop() <= limit
