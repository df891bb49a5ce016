"""Recognition from a description that needs no training: logistic regression on kinematic features."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from benchmark.api import ProbeInfo
from benchmark.motion.clip import MotionClip
from eval.features.kinematic import KINEMATIC_NAMES, STEADY, kinematic_features
from eval.probes.recogniser import Array, Examples, Recogniser, Scores, Weights, smoothed

#: Inverse strength of the ridge penalty (``C`` of scikit-learn, samples weighing 1 on average) for style and for action.
_STYLE_PENALTY, _ACTION_PENALTY = 0.1, 1.0


class KinematicRecogniser(Recogniser):
    """Logistic regression on :func:`eval.features.kinematic.kinematic_features`; scikit-learn fits, numpy judges."""

    info = ProbeInfo(
        name="recogniser-kinematic",
        summary="style and action by logistic regression on training-free kinematic features",
        citation="Guo et al. 2017 (temperature)",
        code_deps=(
            "eval.probes.recogniser",
            "eval.probes.storage",
            "eval.features.kinematic",
            "eval.features.sequence",
            "benchmark.motion.pose",
            "benchmark.motion.canonical",
            "benchmark.motion.resample",
        ),
    )

    def features(self, clip: MotionClip) -> Array:
        """(W, D) the kinematic features of each window of the smoothed clip, those that measure roughness left out."""
        return kinematic_features(smoothed(clip))[:, _COLUMNS]

    def mirrored(self, features: Array) -> Array:
        """Features (W, D) of the same performance with left and right exchanged."""
        return features[:, _OTHER_SIDE]

    def learn(self, examples: Examples, rng: np.random.Generator) -> Weights:
        """Fit both regressions."""
        rows = np.concatenate(examples.features)
        lengths = np.array([len(each) for each in examples.features])
        weights = np.repeat(examples.action_weights / lengths, lengths)
        offset = weights @ rows
        spread = np.sqrt(weights @ (rows - offset) ** 2)
        scale = np.where(spread > 1e-9, spread, 1.0)
        rows, twins = ((each - offset) / scale for each in (rows, self.mirrored(rows)))
        shared = np.repeat(examples.style_weights / lengths, lengths)
        # A style has no side, an action may: a mirrored performance teaches the one and not the other.
        styles = np.tile(np.repeat(examples.style, lengths), 2)
        style = _regression(np.concatenate([rows, twins]), styles, np.tile(shared, 2), 2, _STYLE_PENALTY)
        action = _regression(rows, np.repeat(examples.action, lengths), weights, len(self.actions_), _ACTION_PENALTY)
        return {
            "offset": offset,
            "scale": scale,
            "style.weight": style[0],
            "style.bias": style[1],
            "action.weight": action[0],
            "action.bias": action[1],
        }

    def scores(self, weights: Weights, features: Array) -> Scores:
        """Linear scores of each window."""
        rows = (features - weights["offset"]) / weights["scale"]
        return Scores(
            rows @ weights["style.weight"].T + weights["style.bias"],
            rows @ weights["action.weight"].T + weights["action.bias"],
        )


def _other_side(columns: Sequence[int]) -> NDArray[np.int64]:
    """For each column of the features, the column that holds the same of the other side."""
    swapped = {"left": "right", "right": "left"}
    names = [KINEMATIC_NAMES[index] for index in columns]
    others = [
        "/".join("-".join(swapped.get(word, word) for word in part.split("-")) for part in name.split("/"))
        for name in names
    ]
    return np.array([names.index(name) for name in others], dtype=np.int64)


#: What is left of jerk and spectral centroids after smoothing still follows the capture's noise.
_COLUMNS = list(STEADY)
_OTHER_SIDE = _other_side(_COLUMNS)


def _regression(
    rows: Array, labels: NDArray[np.int64], weights: Array, classes: int, penalty: float
) -> tuple[Array, Array]:
    """Coefficients (K, D) and intercepts (K,) of a multinomial logistic regression; -30 for classes without a sample."""
    from sklearn.linear_model import LogisticRegression

    counted = weights > 0.0
    rows, labels, weights = rows[counted], labels[counted], weights[counted]
    coefficients, intercepts = np.zeros((classes, rows.shape[1])), np.full(classes, -30.0)
    present = np.unique(labels)
    if len(present) == 1:
        intercepts[present] = 0.0
        return coefficients, intercepts
    model = LogisticRegression(C=penalty, max_iter=1000, tol=1e-6)
    model.fit(rows, labels, sample_weight=weights * len(weights) / weights.sum())
    if len(present) == 2:
        # Two classes share one set of coefficients: their difference.
        coefficients[present], intercepts[present] = model.coef_ * [[-0.5], [0.5]], model.intercept_ * [-0.5, 0.5]
    else:
        coefficients[present], intercepts[present] = model.coef_, model.intercept_
    return coefficients, intercepts
