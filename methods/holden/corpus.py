"""What the methods on Holden's autoencoder keep of the training clips, and how they write it down."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from benchmark.motion.clip import ClipMeta, MotionClip
from benchmark.motion.skeleton import Skeleton
from methods.holden.channels import Layout, Scaling
from methods.holden.exemplars import content, nearest

if TYPE_CHECKING:
    from torch import Tensor

Array = NDArray[np.float64]

#: Where the body that clips are put on is stored.
BODY = "body.npz"


@dataclass(frozen=True, eq=False)
class Example:
    """A training clip of the target style: its id and action, normalised channels (T, D), and content (N, S)."""

    clip_id: str
    action: str
    channels: NDArray[np.float32]
    content: Array


def read_channels(
    clips: Sequence[MotionClip], body: Skeleton, layout: Layout, fps: float, report: Callable[[float, str], None]
) -> list[Array]:
    """(T, D) channels of training clips on the common body, at the working rate where that leaves two frames."""
    from benchmark.motion.resample import resample
    from benchmark.motion.retarget import retarget

    arrays = []
    for index, clip in enumerate(clips):
        report(0.0, f"reading {clip.meta.clip_id} ({index + 1}/{len(clips)})")
        slow = resample(clip, fps)
        arrays.append(layout.encode(retarget(slow if len(slow) > 1 else clip, body)))
    return arrays


def make_examples(clips: Sequence[MotionClip], channels: Sequence[Array]) -> tuple[Example, ...]:
    """Examples of clips and their normalised channels."""
    return tuple(
        Example(clip.meta.clip_id, clip.meta.action, array.astype(np.float32), content(clip))
        for clip, array in zip(clips, channels, strict=True)
    )


def choose_examples(examples: Sequence[Example], source: MotionClip, count: int) -> tuple[list[int], bool]:
    """Numbers of the ``count`` examples that lend ``source`` their style, and whether they are of its action."""
    every = range(len(examples))
    same = [number for number in every if examples[number].action == source.meta.action]
    pool = same or list(every)
    found = nearest(content(source), [examples[number].content for number in pool], count)
    return [pool[index] for index, _ in found], bool(same)


def to_tensors(scaling: Scaling, examples: Sequence[Example]) -> dict[str, Tensor]:
    """Statistics and examples by name."""
    import torch

    tensors = {"scaling/offset": torch.from_numpy(scaling.offset), "scaling/scale": torch.from_numpy(scaling.scale)}
    for index, example in enumerate(examples):
        tensors[f"example/{index}/channels"] = torch.from_numpy(example.channels)
        tensors[f"example/{index}/content"] = torch.from_numpy(example.content)
    return tensors


def names_of(examples: Sequence[Example]) -> list[list[str]]:
    """What is not a number of examples, for JSON."""
    return [[example.clip_id, example.action] for example in examples]


def from_tensors(tensors: Mapping[str, Tensor], names: Sequence[Sequence[str]]) -> tuple[Scaling, tuple[Example, ...]]:
    """What :func:`to_tensors` and :func:`names_of` made."""

    def array(name: str) -> Any:
        return tensors[name].numpy()

    examples = tuple(
        Example(clip_id, action, array(f"example/{index}/channels"), array(f"example/{index}/content"))
        for index, (clip_id, action) in enumerate(names)
    )
    return Scaling(array("scaling/offset"), array("scaling/scale")), examples


def save_body(body: Skeleton, fps: float, folder: Path) -> None:
    """Store the common body, in its rest pose."""
    from benchmark.motion import npz, quat

    rest = MotionClip(body, quat.identity(1, len(body)), np.zeros((1, 3)), fps, ClipMeta())
    npz.save(rest, folder / BODY)


def load_body(folder: Path) -> Skeleton:
    """The body that :func:`save_body` stored."""
    from benchmark.motion import npz

    return npz.load(folder / BODY).skeleton


def resampled(values: Array, times: Array, at: Array) -> Array:
    """Values (T, D) at ``times``, by cubic splines at other times; the last value holds beyond the last time."""
    if len(times) == len(at) and np.array_equal(times, at):
        return values
    from scipy.interpolate import make_interp_spline

    # The same spline as that of scipy's `CubicSpline`, in half of the time.
    spline = make_interp_spline(times, values, k=min(3, len(times) - 1))
    return np.asarray(spline(np.minimum(at, times[-1])))
