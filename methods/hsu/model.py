"""What is learned for a group of actions: how to standardise, and one state-space model per joint."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from methods.hsu.lti import StateSpace

Array = NDArray[np.float64]

#: Channels that vary by less than this share of the unit of length do not vary.
CONSTANT = 1e-4

SPREADS = ("source", "none")


@dataclass(frozen=True, eq=False)
class Scale:
    """Mean and standard deviation of channels (J, 3); those of constant channels are 0."""

    mean: Array
    std: Array

    @classmethod
    def of(cls, clips: Sequence[Array], least: float = 0.0) -> Scale:
        """Over all frames of clips (T, J, 3).

        ``least`` is added in quadrature to the standard deviations of channels that vary at all: what varies by little in the
        training clips differs by more between people, and must not count as many standard deviations then.
        """
        frames = np.concatenate(clips)
        std = frames.std(axis=0)
        return cls(frames.mean(axis=0), np.where(std < CONSTANT, 0.0, np.hypot(std, least)))

    def standardise(self, values: Array) -> Array:
        """Zero mean and, without ``least``, unit standard deviation; constant channels become 0."""
        return np.divide(values - self.mean, self.std, out=np.zeros_like(values), where=self.std > 0)

    def restore(self, values: Array) -> Array:
        """Inverse of :meth:`standardise`."""
        return values * self.std + self.mean


@dataclass(frozen=True, eq=False)
class StyleModel:
    """One fitted group.

    Attributes
    ----------
    source, target
        How source and target channels are standardised.
    joints
        A model per joint from the source's moving channels to the target's; ``None`` where nothing moves.
    own
        (J,) how much of the standardised source is added to each joint's response.
    low, high
        (J, 3) where standardised outputs end: the range of the training targets and some standard deviations more.
    """

    source: Scale
    target: Scale
    joints: tuple[StateSpace | None, ...]
    own: Array
    low: Array
    high: Array

    def respond(self, inputs: Array, *, pre_roll: int = 0) -> Array:
        """Standardised responses (T, J, 3) to standardised inputs (T, J, 3), each model starting from state zero.

        ``pre_roll`` repeats of the first frame go before, and are cut off again.
        """
        outputs = self.own[:, None] * inputs * (self.target.std > 0)
        for joint, model in enumerate(self.joints):
            if model is None:
                continue
            u = inputs[:, joint, self.source.std[joint] > 0]
            if pre_roll:
                u = np.concatenate([np.repeat(u[:1], pre_roll, axis=0), u])
            outputs[:, joint, self.target.std[joint] > 0] += model.simulate(u)[pre_roll:]
        return outputs

    def translate(self, values: Array, *, pre_roll: int = 0) -> tuple[Array, float]:
        """Channels (T, J, 3) in the target style, and the share of values that had to be held back at the limits."""
        outputs = self.respond(self.source.standardise(values), pre_roll=pre_roll)
        limited = np.clip(outputs, self.low, self.high)
        return self.target.restore(limited), float(np.mean(limited != outputs))

    def arrays(self) -> dict[str, Array]:
        """Everything, by name, for an ``.npz``; :meth:`from_arrays` is the inverse."""
        found = {
            "source_mean": self.source.mean,
            "source_std": self.source.std,
            "target_mean": self.target.mean,
            "target_std": self.target.std,
            "own": self.own,
            "low": self.low,
            "high": self.high,
        }
        for joint, model in enumerate(self.joints):
            if model is not None:
                found |= {f"joint{joint}.{name}": getattr(model, name) for name in "ABCD"}
        return found

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Array]) -> StyleModel:
        """Inverse of :meth:`arrays`."""
        joints = [
            StateSpace(*(arrays[f"joint{joint}.{name}"] for name in "ABCD")) if f"joint{joint}.D" in arrays else None
            for joint in range(len(arrays["own"]))
        ]
        return cls(
            Scale(arrays["source_mean"], arrays["source_std"]),
            Scale(arrays["target_mean"], arrays["target_std"]),
            tuple(joints),
            arrays["own"],
            arrays["low"],
            arrays["high"],
        )


def fit_style(
    inputs: Sequence[Array],
    outputs: Sequence[Array],
    source: Scale,
    target: Scale,
    identify: Callable[[Sequence[Array], Sequence[Array]], tuple[StateSpace, Mapping[str, Any]]],
    *,
    spread: str,
    limit: float,
    report: Callable[[float], None] = lambda fraction: None,
) -> tuple[StyleModel, list[dict[str, Any]]]:
    """Fit one model per joint to standardised records.

    Parameters
    ----------
    inputs, outputs
        Records (T', J, 3), the source on the target's clock and the target.
    source, target
        What standardised them.
    identify
        Fits one joint: records of moving channels in, model and facts out.
    spread
        ``source``: fill what a joint's model leaves unexplained with the source's own motion; ``none``: leave it out.
    limit
        Standard deviations that outputs may lie beyond the range of the training targets.

    Returns
    -------
    model, facts
        And for each joint what its identification says of itself.
    """
    count = source.mean.shape[0]
    joints: list[StateSpace | None] = []
    facts: list[dict[str, Any]] = []
    for joint in range(count):
        enters, leaves = source.std[joint] > 0, target.std[joint] > 0
        if enters.any() and leaves.any():
            model, fact = identify(
                [record[:, joint, enters] for record in inputs], [record[:, joint, leaves] for record in outputs]
            )
            joints.append(model)
            facts.append({"joint": joint, **fact})
        else:
            joints.append(None)
        report((joint + 1) / count)
    everything = np.concatenate(outputs)
    low, high = everything.min(axis=0) - limit, everything.max(axis=0) + limit
    fitted = StyleModel(source, target, tuple(joints), np.zeros(count), low, high)
    if spread == "source":
        fitted = replace(fitted, own=_own_share(fitted, inputs, outputs))
    return fitted, facts


def _own_share(model: StyleModel, inputs: Sequence[Array], outputs: Sequence[Array]) -> Array:
    """(J,) the least ``c >= 0`` with ``var(r + c u) = var(v)``, of source ``u``, response ``r`` and target ``v``.

    A least-squares model answers with the mean of all the ways in which the target style has answered. Where source and target
    are loosely tied that mean hardly moves, and nobody moves like the mean of many people. Where they are closely tied the
    response spreads as the target does, and ``c`` is 0. Amplifying the response instead would amplify what is in it by
    chance; the source's own motion is at least a motion.
    """
    u, v = np.concatenate(inputs), np.concatenate(outputs)
    r = np.concatenate([model.respond(record) for record in inputs])
    u, v, r = (values - values.mean(axis=0) for values in (u, v, r))
    uu, ur, lacking = np.sum(u * u, (0, 2)), np.sum(u * r, (0, 2)), np.sum(v * v, (0, 2)) - np.sum(r * r, (0, 2))
    root = np.sqrt(ur**2 + uu * np.maximum(lacking, 0.0)) - ur
    return np.divide(np.maximum(root, 0.0), uu, out=np.zeros_like(root), where=(uu > 1e-12) & (lacking > 0.0))
