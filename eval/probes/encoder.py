"""The frozen extractor that distributions of motion and Gram matrices are compared through."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Literal, Self
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from benchmark.api import FitContext, NotApplicableError, Probe, ProbeInfo, StyleTask, TrainView
from benchmark.motion.clip import MotionClip
from eval.features.kinematic import STEADY, kinematic_features, stabilised, window_spans
from eval.features.sequence import pose_sequence
from eval.probes.projection import Projection
from eval.probes.storage import read_arrays, write_arrays

Array = NDArray[np.float64]

#: Which of the two descriptions of a window: :func:`~eval.features.kinematic.kinematic_features` or the encoder's own.
FeatureSet = Literal["kinematic", "learned"]

_UNITS = 64
_WIDTHS = (15, 7)

#: Windows without which there is nothing to learn from.
FEWEST_WINDOWS = 8

#: Floor of a channel's standard deviation over that of all channels.
_CONSTANT = 1e-2


class MotionEncoder(Probe):
    """A convolutional denoising autoencoder of size-free motion, and the principal axes of two feature sets.

    The encoder sees :func:`~eval.features.sequence.pose_sequence` at 30 frames a second, standardised by training statistics:
    convolution of 15 frames to 64 units, rectified, max-pooled by 2, convolution of 7 to 64, rectified, max-pooled by 2. It is
    trained to undo noise on the training clips of both styles, and then frozen. It has no part in any method.

    ``learned`` features of a window of 2 s are mean and standard deviation over its frames of the second layer's units: what
    happens, whenever in the window. ``kinematic`` features are standardised, speeds by their square roots
    (:func:`~eval.features.kinematic.stabilised`). Both are put on the principal axes of the training windows: at most 32, and
    at most one for ten windows.

    Attributes
    ----------
    mean_, deviation_
        (C,) of the channels over all training frames.
    weights_
        Filters and biases of the two encoding layers.
    kinematic_, learned_
        The two projections.
    """

    info = ProbeInfo(
        name="motion-encoder",
        summary="frozen convolutional autoencoder of size-free motion, with principal axes of two feature sets",
        citation="Holden et al. 2016 (convolutional autoencoder); Maiorca et al. 2022 (Fréchet motion distance)",
        code_deps=(
            "benchmark.motion.canonical",
            "benchmark.motion.pose",
            "benchmark.motion.resample",
            "eval.features",
            "eval.metrics.shared",
            "eval.probes.autoencoder",
            "eval.probes.projection",
            "eval.probes.storage",
        ),
    )

    #: Optimiser steps of the training.
    steps: ClassVar[int] = 200

    def __init__(self) -> None:
        self._known: WeakKeyDictionary[MotionClip, tuple[Array, Array]] = WeakKeyDictionary()
        self._seen: WeakKeyDictionary[MotionClip, dict[FeatureSet, Array]] = WeakKeyDictionary()

    def fit(self, train: TrainView, task: StyleTask, *, rng: np.random.Generator, ctx: FitContext) -> Self:
        """Train on every training clip; a :class:`~benchmark.api.NotApplicableError` where there are too few windows."""
        from eval.probes.autoencoder import train as learn

        self._known, self._seen = WeakKeyDictionary(), WeakKeyDictionary()
        clips = [clip for style in (task.source_style, task.target_style) for clip in train.clips(style)]
        described = [_kinematic(clip) for clip in clips]
        windows = sum(len(each) for each in described)
        if windows < FEWEST_WINDOWS:
            raise NotApplicableError(f"{windows} windows of 2 s in the training clips are too few to learn motion from")
        sequences = [pose_sequence(clip) for clip in clips]
        frames = np.concatenate(sequences)
        self.mean_ = frames.mean(axis=0)
        deviation = frames.std(axis=0)
        self.deviation_ = np.maximum(deviation, _CONSTANT * np.sqrt(np.mean(deviation**2)))
        standardised = [((each - self.mean_) / self.deviation_).astype(np.float32) for each in sequences]
        self.weights_ = learn(standardised, units=_UNITS, widths=_WIDTHS, steps=self.steps, rng=rng, report=ctx.report)
        self.kinematic_ = Projection.fit(np.concatenate(described), standardise=True)
        pooled = np.concatenate([self._pooled(clip) for clip in clips])
        self.learned_ = Projection.fit(pooled, standardise=False)
        return self

    def hidden(self, clip: MotionClip) -> Array:
        """(T / 2, 64) activations of the first layer, 15 a second, over a whole clip, read-only."""
        return self._layers(clip)[0]

    def features(self, clip: MotionClip, which: FeatureSet) -> Array:
        """(W, K) features of the windows of a clip on the principal axes of the training windows, read-only.

        Their unit is the root mean variance of a training window along an axis, so the K axes together have variance K.
        A clip of fewer than 4 frames at 30 a second has no kinematic features: :class:`~benchmark.api.NotApplicableError`.
        """
        # Real clips are looked at anew by every metric of every set.
        seen = self._seen.setdefault(clip, {})
        if which not in seen:
            projection = self.projection(which)
            raw = stabilised(kinematic_features(clip)) if which == "kinematic" else self._pooled(clip)
            seen[which] = projection.apply(raw) / np.sqrt(projection.variances.mean())
            seen[which].flags.writeable = False
        return seen[which]

    def projection(self, which: FeatureSet) -> Projection:
        """The principal axes of a feature set."""
        return self.kinematic_ if which == "kinematic" else self.learned_

    def save(self, folder: Path) -> None:
        """Write statistics, weights and axes, bit for bit."""
        arrays: dict[str, NDArray] = {"mean": self.mean_, "deviation": self.deviation_}
        arrays |= {f"encoder/{name}": value for name, value in self.weights_.items()}
        arrays |= self.kinematic_.to_arrays("kinematic") | self.learned_.to_arrays("learned")
        write_arrays(folder, arrays, {"probe": self.info.name, "version": self.info.version})

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read what :meth:`save` wrote."""
        arrays, _ = read_arrays(folder)
        probe = cls()
        probe.mean_, probe.deviation_ = arrays["mean"], arrays["deviation"]
        probe.weights_ = {
            name.removeprefix("encoder/"): value for name, value in arrays.items() if name.startswith("encoder/")
        }
        probe.kinematic_ = Projection.from_arrays(arrays, "kinematic")
        probe.learned_ = Projection.from_arrays(arrays, "learned")
        return probe

    def _layers(self, clip: MotionClip) -> tuple[Array, Array]:
        if clip not in self._known:
            standardised = (pose_sequence(clip) - self.mean_) / self.deviation_
            first = _pooled_convolution(standardised, self.weights_["first/weight"], self.weights_["first/bias"])
            second = _pooled_convolution(first, self.weights_["second/weight"], self.weights_["second/bias"])
            first.flags.writeable = False
            self._known[clip] = first, second
        return self._known[clip]

    def _pooled(self, clip: MotionClip) -> Array:
        """(W, 128) mean and standard deviation of the second layer's units over each window."""
        frames = len(pose_sequence(clip))
        second = self._layers(clip)[1]
        rows = []
        for span in window_spans(frames):
            part = second[span.start // 4 : max(span.start // 4 + 1, -(-min(span.stop, frames) // 4))]
            rows.append(np.concatenate([part.mean(axis=0), part.std(axis=0)]))
        return np.stack(rows)


def _kinematic(clip: MotionClip) -> Array:
    """The kinematic features of a clip as distances are taken on them; none where it is too short."""
    try:
        return stabilised(kinematic_features(clip))
    except NotApplicableError:
        return np.zeros((0, len(STEADY)))


def _pooled_convolution(values: Array, weight: NDArray, bias: NDArray) -> Array:
    """(ceil(T / 2), F) of (T, C): convolution padded with zeros, rectified, larger of each two frames.

    What the trained layer computes, in plain arrays: measuring needs no training library.
    """
    width = weight.shape[-1]
    padded = np.pad(values, ((width // 2, width // 2), (0, 0)))
    views = np.lib.stride_tricks.sliding_window_view(padded, width, axis=0)
    out = views.reshape(len(values), -1) @ weight.reshape(len(weight), -1).T.astype(np.float64) + bias
    out = np.maximum(out, 0.0)
    if len(out) % 2:
        out = np.concatenate([out, out[-1:]])
    return np.maximum(out[0::2], out[1::2])
