"""Recognition from movement as it unfolds: an ensemble of small temporal convolution networks on pose sequences."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from benchmark.api import ProbeInfo
from benchmark.motion.clip import MotionClip
from benchmark.motion.skeleton import SIDES
from eval.features.sequence import SEQUENCE_NAMES, pose_sequence
from eval.probes.recogniser import Array, Examples, Indices, Recogniser, Scores, Weights, smoothed

#: Frames a second: enough for what smoothing leaves, and half the work of 30.
RATE = 15.0

#: Deviations below this share of the median one count as it, so that a channel that is constant in training cannot explode.
_FLOOR = 0.05


@dataclass(frozen=True)
class Settings:
    """The network and its training.

    Attributes
    ----------
    length, hop
        Frames of a window, and from one window to the next when a clip is judged.
    channels
        Width.
    steps, batch
        How long: training sees ``steps * batch`` windows, whatever the number of clips.
    rate, decay
        Peak learning rate, which rises and falls along one cycle, and decoupled weight decay.
    noise, dropout
        Standard deviation of the noise on normalised inputs; share of units left out.
    """

    length: int = 32
    hop: int = 16
    channels: int = 48
    steps: int = 240
    batch: int = 32
    rate: float = 4e-3
    decay: float = 0.02
    noise: float = 0.1
    dropout: float = 0.3


class TemporalRecogniser(Recogniser):
    """Temporal convolutions on :func:`eval.features.sequence.pose_sequence`, three networks of different seeds averaged."""

    info = ProbeInfo(
        name="recogniser-temporal",
        summary="style and action by temporal convolution networks on size-free pose sequences",
        citation="Guo et al. 2017 (temperature)",
        code_deps=(
            "eval.probes.recogniser",
            "eval.probes.storage",
            "eval.probes.tcn",
            "eval.features.sequence",
            "benchmark.motion.pose",
            "benchmark.motion.canonical",
            "benchmark.motion.resample",
            "benchmark.motion.windows",
        ),
    )
    members: ClassVar[int] = 3

    #: The network and its training.
    settings: ClassVar[Settings] = Settings()

    def features(self, clip: MotionClip) -> Array:
        """(T, D) the pose sequence of the smoothed clip, at :data:`RATE`."""
        return pose_sequence(smoothed(clip), RATE)

    def learn(self, examples: Examples, rng: np.random.Generator) -> Weights:
        """Train one network."""
        from eval.probes.tcn import train

        frames = np.concatenate(examples.features)
        offset, spread = frames.mean(axis=0), frames.std(axis=0)
        scale = np.maximum(spread, max(_FLOOR * float(np.median(spread)), 1e-6))
        parameters = train(
            [(each - offset) / scale for each in examples.features],
            [(mirrored(each) - offset) / scale for each in examples.features],
            examples.style,
            examples.action,
            shared=examples.shared,
            weights=examples.action_weights,
            actions=len(self.actions_),
            settings=self.settings,
            rng=rng,
        )
        return {"offset": offset, "scale": scale, **parameters}

    def scores(self, weights: Weights, features: Array) -> Scores:
        """Scores of windows of 2.1 s about every second."""
        from eval.probes.tcn import judge

        parameters = {name: value for name, value in weights.items() if name not in ("offset", "scale")}
        return Scores(*judge(parameters, (features - weights["offset"]) / weights["scale"], self.settings))


def mirrored(features: Array) -> Array:
    """Features (T, D) as a mirror shows the performer: left and right exchanged in joints and in directions."""
    return features[:, _OTHER_SIDE] * _SIGN


def _mirror() -> tuple[Indices, Array]:
    """For each column of the features, the column of the other side and its sign."""
    other, sign = [], []
    for name in SEQUENCE_NAMES:
        part, _, axis = name.partition("/")
        opposite = "-".join(_swapped(end) for end in part.split("-"))
        other.append(SEQUENCE_NAMES.index(f"{opposite}/{axis}"))
        # A line from the right joint to the left one is turned round as well.
        sign.append(-1.0 if axis.startswith(("left", "yaw")) != part.endswith("-line") else 1.0)
    return np.array(other, dtype=np.int64), np.array(sign)


def _swapped(role: str) -> str:
    side, _, joint = role.partition("_")
    return f"{SIDES[1 - SIDES.index(side)]}_{joint}" if side in SIDES else role


_OTHER_SIDE, _SIGN = _mirror()
