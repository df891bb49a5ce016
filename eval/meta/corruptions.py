"""Faults of a transferred motion, each in grades from none to gross.

Grades of one fault use the same random numbers, scaled: a higher grade is the same fault, larger. Amounts are chosen so that
the first grade is hard to see in an animation and the last one cannot be missed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from benchmark.motion import quat
from benchmark.motion.clip import MotionClip
from benchmark.motion.resample import sample_at
from benchmark.motion.skeleton import SIDES
from eval.meta.cases import Case

_UP = np.array([0.0, 1.0, 0.0])

#: Seconds of a burst of jitter, and from one to the next.
_BURST, _BURST_EVERY = 0.1, 1.0

#: Seconds of one swing of an uneven timing; shorter than this and the largest grade would run backwards.
_SWING = 2.0

#: Corrupts one clip by an amount, with a generator that is the same for all grades.
Change = Callable[[MotionClip, float, np.random.Generator], MotionClip]
#: Picks what is handed in for case ``index`` of ``cases``.
Pick = Callable[[Sequence[Case], int, float, np.random.Generator], MotionClip]


@dataclass(frozen=True)
class Corruption:
    """One fault.

    Attributes
    ----------
    name
        For tables and files.
    title
        Short, for the head of a column.
    summary
        One sentence.
    amounts
        From 0, which changes nothing, upwards.
    labels
        The amounts in words.
    change
        How one clip is corrupted; or ``None``.
    pick
        How the result is picked among performances, for faults of style and choice that are no change of a clip.
    shuffles
        Whether ``pick`` only says who hands in which uncorrupted performance.
    """

    name: str
    title: str
    summary: str
    amounts: tuple[float, ...]
    labels: tuple[str, ...]
    change: Change | None = None
    pick: Pick | None = None
    shuffles: bool = False

    def result(self, cases: Sequence[Case], index: int, grade: int, seed: int) -> MotionClip:
        """What is handed in for case ``index`` at ``grade``; grade 0 is the performance itself."""
        amount = self.amounts[grade]
        if amount == 0.0:
            return cases[index].performance
        if self.change is not None:
            return self.change(cases[index].performance, amount, np.random.default_rng([seed, index]))
        if self.pick is None:
            raise ValueError(f"corruption {self.name!r} neither changes a clip nor picks one")
        return self.pick(cases, index, amount, np.random.default_rng(seed))

    def round_trip(self, cases: Sequence[Case], index: int, grade: int, seed: int) -> MotionClip | None:
        """The source with the same fault, as a translation there and back would leave it; ``None`` where that has no sense."""
        if self.change is None:
            return cases[index].source if self.amounts[grade] == 0.0 else None
        if self.amounts[grade] == 0.0:
            return cases[index].source
        return self.change(cases[index].source, self.amounts[grade], np.random.default_rng([seed, index]))


def noise(clip: MotionClip, degrees: float, rng: np.random.Generator) -> MotionClip:
    """White noise of ``degrees`` per axis on every joint rotation, at the clip's frame rate."""
    shake = quat.exp(np.radians(degrees) * rng.standard_normal((*clip.rotations.shape[:2], 3)))
    return clip.replace(rotations=quat.normalize(quat.mul(clip.rotations, shake)))


def bursts(clip: MotionClip, degrees: float, rng: np.random.Generator) -> MotionClip:
    """Every second, for a tenth of a second, noise of ``degrees`` per axis on every joint but the root."""
    active = (clip.times + rng.uniform(0.0, _BURST_EVERY)) % _BURST_EVERY < _BURST
    shake = np.radians(degrees) * rng.standard_normal((*clip.rotations.shape[:2], 3)) * active[:, None, None]
    shake[:, 0] = 0.0
    return clip.replace(rotations=quat.normalize(quat.mul(clip.rotations, quat.exp(shake))))


def over_smoothing(clip: MotionClip, period: float, rng: np.random.Generator) -> MotionClip:
    """A Gaussian over rotations and root that halves the power of what comes back every ``period`` seconds.

    Before the first and after the last frame these are held, so that the ends are smoothed as the middle is.
    """
    from scipy.ndimage import gaussian_filter1d

    sigma = np.sqrt(np.log(2.0)) / (2.0 * np.pi) * period * clip.fps
    rotations = gaussian_filter1d(quat.unroll(clip.rotations), sigma, axis=0, mode="nearest")
    return clip.replace(
        rotations=quat.normalize(rotations), root=gaussian_filter1d(clip.root, sigma, axis=0, mode="nearest")
    )


def frozen(clip: MotionClip, share: float, rng: np.random.Generator) -> MotionClip:
    """The last ``share`` of the clip holds the pose and place in which it stopped."""
    return sample_at(clip, np.minimum(clip.times, (1.0 - share) * clip.duration), fps=clip.fps)


def lagging_arms(clip: MotionClip, seconds: float, rng: np.random.Generator) -> MotionClip:
    """Both arms come ``seconds`` late; the rest of the body is in time."""
    late = sample_at(clip, np.maximum(clip.times - seconds, 0.0), fps=clip.fps)
    joints = [joint for side in SIDES for joint in _below(clip, f"{side}_shoulder")]
    rotations = np.array(clip.rotations)
    rotations[:, joints] = late.rotations[:, joints]
    return clip.replace(rotations=rotations)


def uneven_timing(clip: MotionClip, seconds: float, rng: np.random.Generator) -> MotionClip:
    """The clip runs ahead and falls behind by ``seconds``, to and fro every two seconds or more; its duration stays."""
    swings = max(1, int(clip.duration / _SWING))
    shift = seconds * np.sin(2.0 * np.pi * swings * clip.times / clip.duration)
    times = np.maximum.accumulate(np.clip(clip.times + shift, 0.0, clip.duration))
    return sample_at(clip, times, fps=clip.fps)


def time_stretch(clip: MotionClip, share: float, rng: np.random.Generator) -> MotionClip:
    """The whole clip takes ``share`` longer."""
    frames = round(clip.duration * (1.0 + share) * clip.fps) + 1
    return sample_at(clip, np.arange(frames) / clip.fps / (1.0 + share), fps=clip.fps)


def foot_slide(clip: MotionClip, speed: float, rng: np.random.Generator) -> MotionClip:
    """The figure glides over the floor at ``speed`` metres a second in one direction, on top of its own travel."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return clip.replace(root=clip.root + speed * clip.times[:, None] * [np.cos(angle), 0.0, np.sin(angle)])


def heading_drift(clip: MotionClip, degrees: float, rng: np.random.Generator) -> MotionClip:
    """The figure turns away by ``degrees`` over the clip, evenly, while its path stays."""
    sign = 1.0 if rng.random() < 0.5 else -1.0
    turn = quat.from_axis_angle(_UP, sign * np.radians(degrees) * np.linspace(0.0, 1.0, len(clip)))
    rotations = np.array(clip.rotations)
    rotations[:, 0] = quat.normalize(quat.mul(turn, rotations[:, 0]))
    return clip.replace(rotations=rotations)


def raised(clip: MotionClip, metres: float, rng: np.random.Generator) -> MotionClip:
    """The figure is ``metres`` too high; too low where they are negative."""
    return clip.replace(root=clip.root + [0.0, metres, 0.0])


def bone_stretch(clip: MotionClip, share: float, rng: np.random.Generator) -> MotionClip:
    """Upper and lower arms grow and shrink by ``share`` of their length, once a second."""
    translations = np.repeat(np.array(clip.skeleton.offsets)[None], len(clip), axis=0)
    phase = rng.uniform(0.0, 2.0 * np.pi)
    factor = 1.0 + share * np.sin(2.0 * np.pi * clip.times + phase)
    for role in ("elbow", "wrist"):
        for side in SIDES:
            translations[:, clip.skeleton.joint(f"{side}_{role}")] *= factor[:, None]
    return clip.replace(translations=translations)


def half_style(cases: Sequence[Case], index: int, share: float, rng: np.random.Generator) -> MotionClip:
    """``share`` of the source's style in place of the target's, on the target's body."""
    return cases[index].blend(share)


def adult_itself(cases: Sequence[Case], index: int, amount: float, rng: np.random.Generator) -> MotionClip:
    """The source clip on the target's body: what a method that does nothing hands in."""
    return cases[index].adult


def wrong_action(cases: Sequence[Case], index: int, share: float, rng: np.random.Generator) -> MotionClip:
    """For ``share`` of the clips the true performance of another action; a higher share contains a lower one."""
    order = rng.permutation(len(cases))
    if int(np.flatnonzero(order == index)[0]) >= round(share * len(cases)):
        return cases[index].performance
    others = [case for case in cases if case.action != cases[index].action]
    if not others:
        return cases[index].performance
    return others[int(np.random.default_rng([7, index]).integers(len(others)))].performance


def one_for_all(cases: Sequence[Case], index: int, share: float, rng: np.random.Generator) -> MotionClip:
    """For ``share`` of the clips one and the same performance, whatever was asked for."""
    order = rng.permutation(len(cases))
    place = int(np.flatnonzero(order == index)[0])
    return cases[int(order[-1])].performance if place < round(share * len(cases)) else cases[index].performance


def _below(clip: MotionClip, role: str) -> list[int]:
    """The joint of ``role`` and every joint that hangs from it."""
    found = [clip.skeleton.joint(role)]
    for joint in range(found[0] + 1, len(clip.skeleton)):
        if int(clip.skeleton.parents[joint]) in found:
            found.append(joint)
    return found


def _percent(*shares: float) -> tuple[str, ...]:
    return tuple(f"{100.0 * share:g} %" for share in shares)


_SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)

#: Every corruption, in the order in which tables show them: smoothness, timing, body and floor, style and content.
CORRUPTIONS: tuple[Corruption, ...] = (
    Corruption(
        "noise",
        "noise",
        "white noise on every joint rotation",
        (0.0, 0.25, 0.5, 1.0, 2.0),
        ("none", "0.25°", "0.5°", "1°", "2°"),
        noise,
    ),
    Corruption(
        "jitter-bursts",
        "jitter bursts",
        "noise for a tenth of every second",
        (0.0, 2.5, 5.0, 10.0, 20.0),
        ("none", "2.5°", "5°", "10°", "20°"),
        bursts,
    ),
    Corruption(
        "over-smoothing",
        "over-smoothing",
        "Gaussian low-pass filter on rotations and root",
        (0.0, 0.125, 0.25, 0.5, 1.0),
        ("none", "8 Hz", "4 Hz", "2 Hz", "1 Hz"),
        over_smoothing,
    ),
    Corruption(
        "frozen-pose",
        "frozen pose",
        "the last part of the clip holds one pose",
        (0.0, 0.1, 0.2, 0.4, 0.8),
        _percent(0.0, 0.1, 0.2, 0.4, 0.8),
        frozen,
    ),
    Corruption(
        "arm-lag",
        "arms lag",
        "the arms come late",
        (0.0, 1.0 / 30.0, 2.0 / 30.0, 4.0 / 30.0, 8.0 / 30.0),
        ("none", "33 ms", "67 ms", "133 ms", "267 ms"),
        lagging_arms,
    ),
    Corruption(
        "uneven-timing",
        "uneven timing",
        "the clip runs ahead and falls behind within its duration",
        (0.0, 0.05, 0.1, 0.2, 0.3),
        ("none", "50 ms", "100 ms", "200 ms", "300 ms"),
        uneven_timing,
    ),
    Corruption(
        "time-stretch",
        "slowed down",
        "the whole clip is slower",
        (0.0, 0.05, 0.1, 0.2, 0.4),
        _percent(0.0, 0.05, 0.1, 0.2, 0.4),
        time_stretch,
    ),
    Corruption(
        "foot-slide",
        "foot slide",
        "the figure glides over the floor",
        (0.0, 0.05, 0.15, 0.3, 0.6),
        ("none", "0.05 m/s", "0.15 m/s", "0.3 m/s", "0.6 m/s"),
        foot_slide,
    ),
    Corruption(
        "heading-drift",
        "heading drift",
        "the figure turns away from its path",
        (0.0, 5.0, 10.0, 20.0, 40.0),
        ("none", "5°", "10°", "20°", "40°"),
        heading_drift,
    ),
    Corruption(
        "floating",
        "floating",
        "the figure is too high",
        (0.0, 0.01, 0.02, 0.04, 0.08),
        ("none", "1 cm", "2 cm", "4 cm", "8 cm"),
        raised,
    ),
    Corruption(
        "sunken",
        "sunken",
        "the figure is too low",
        (0.0, -0.01, -0.02, -0.04, -0.08),
        ("none", "1 cm", "2 cm", "4 cm", "8 cm"),
        raised,
    ),
    Corruption(
        "bone-stretch",
        "arms stretch",
        "the bones of the arms grow and shrink",
        (0.0, 0.01, 0.02, 0.05, 0.1),
        _percent(0.0, 0.01, 0.02, 0.05, 0.1),
        bone_stretch,
    ),
    Corruption(
        "half-style",
        "half style",
        "performed with a share of the source's style",
        _SHARES,
        _percent(*_SHARES),
        pick=half_style,
    ),
    Corruption(
        "no-style",
        "no style",
        "the source clip itself on the target's body",
        (0.0, 1.0),
        ("none", "the source"),
        pick=adult_itself,
    ),
    Corruption(
        "wrong-action",
        "wrong action",
        "a share of the clips shows another action",
        _SHARES,
        _percent(*_SHARES),
        pick=wrong_action,
        shuffles=True,
    ),
    Corruption(
        "one-for-all",
        "one for all",
        "a share of the clips is one and the same performance",
        _SHARES,
        _percent(*_SHARES),
        pick=one_for_all,
        shuffles=True,
    ),
)
