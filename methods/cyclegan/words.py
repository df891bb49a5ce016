"""Motion words: training clips on one skeleton and at one rate, as quaternions of fixed signs without their heading."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import DataError
from benchmark.motion import quat
from benchmark.motion.canonical import heading
from benchmark.motion.clip import MotionClip
from benchmark.motion.features import fix_signs, sign_reference
from benchmark.motion.resample import low_pass, sample_at
from benchmark.motion.retarget import retarget
from benchmark.motion.skeleton import Skeleton
from benchmark.motion.windows import Windows, cut

Array = NDArray[np.float64]

_UP = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True)
class Scale:
    """``q = offset + scale x``: the affine map between [-1, 1] and all quaternion components of a domain.

    "Overall max and min" of the paper: two numbers for a whole domain, from its training words.
    """

    offset: float
    scale: float

    @property
    def pair(self) -> tuple[float, float]:
        """``(offset, scale)``."""
        return self.offset, self.scale


def at_rate(clip: MotionClip, fps: float) -> MotionClip:
    """The clip at ``fps``, covering all of it: the last frame is held where the new clock steps beyond it."""
    if clip.fps == fps:
        return clip
    if fps < clip.fps:
        clip = low_pass(clip, 0.4 * fps)
    frames = int(np.ceil(clip.duration * fps - 1e-6)) + 1
    return sample_at(clip, np.minimum(np.arange(frames) / fps, clip.duration), fps=fps)


def on_body(clip: MotionClip, body: Skeleton, fps: float) -> MotionClip:
    """The clip on ``body`` at ``fps``: root path by leg length (policy B), see :func:`benchmark.motion.retarget.retarget`."""
    return at_rate(clip if clip.skeleton == body else retarget(clip, body), fps)


def turned(rotations: Array, yaw: Array) -> Array:
    """Rotations (..., J, 4) with joint 0 turned about the vertical by ``yaw`` (...) radians."""
    out = rotations.copy()
    out[..., 0, :] = quat.mul(quat.from_axis_angle(_UP, yaw), out[..., 0, :])
    return out


@dataclass(frozen=True, eq=False)
class CutClip:
    """A clip cut into words.

    Attributes
    ----------
    windows
        (N, L, J, 4) quaternions, sign-continuous, joint 0 relative to the word's heading.
    yaw
        (N,) heading of each word, radians: that of its first frame.
    """

    windows: Windows
    yaw: Array

    def restored(self, words: Array) -> Windows:
        """Other words (N, L, J, 4) in the places of these, their heading put back."""
        yaw = np.broadcast_to(self.yaw[:, None], words.shape[:2])
        return self.windows.with_array(turned(words, yaw))


def cut_clip(clip: MotionClip, reference: Array | None, *, length: int, hop: int) -> CutClip:
    """Cut a clip into words.

    The heading is taken out per word, at its first frame: taken out frame by frame, turns would be lost.

    Parameters
    ----------
    clip
        At the words' rate.
    reference
        (J, 4) from the training words, :func:`word_reference`; ``None`` leaves signs as they are from frame to frame.
    length, hop
        Frames.
    """
    yaw_at = heading(clip)
    signed = fix_signs(clip, reference)
    windows = cut(signed, length, hop)
    yaw = np.asarray(yaw_at[np.clip(windows.starts, 0, len(clip) - 1)])
    words = turned(windows.array, np.broadcast_to(-yaw[:, None], windows.array.shape[:2]))
    if reference is not None:
        # Turning the heading away moves joint 0 across the sphere, so its side is chosen again, for the word as a whole.
        side = np.einsum("nlk,k->n", words[:, :, 0], reference[0])
        words[:, :, 0] *= np.where(side < 0, -1.0, 1.0)[:, None, None]
    return CutClip(windows.with_array(words), yaw)


def word_reference(clips: Sequence[MotionClip], *, length: int, hop: int) -> Array:
    """(J, 4) average rotation of each joint over the words of training clips of both styles; it fixes the signs."""
    return sign_reference(
        cut_clip(clip, None, length=length, hop=hop).windows.array.reshape(-1, len(clip.skeleton), 4) for clip in clips
    )


@dataclass(frozen=True, eq=False)
class Domain:
    """All training words of one style, without copying what they share.

    Attributes
    ----------
    frames
        (J, 4, F) float32, the clips one after another, each with its signs fixed.
    starts
        (N,) first frame of each word in ``frames``.
    yaw
        (N,) radians, heading of each word.
    flip
        (N,) sign of joint 0 after its heading is taken out.
    clip, action
        (N,) number of the clip and of its action.
    actions
        Names of the actions, in order.
    length, hop
        Frames of a word and between words.
    scale
        Of the components of all words.
    """

    frames: NDArray[np.float32]
    starts: NDArray[np.int64]
    yaw: Array
    flip: Array
    clip: NDArray[np.int64]
    action: NDArray[np.int64]
    actions: tuple[str, ...]
    length: int
    hop: int
    scale: Scale

    def __len__(self) -> int:
        return len(self.starts)

    @classmethod
    def of(
        cls, clips: Sequence[MotionClip], reference: Array, actions: Sequence[str], *, length: int, hop: int
    ) -> Domain:
        """Words of training clips, all on one skeleton and at the words' rate.

        Clips shorter than a word are held at their ends to its length, and left out where there are others of their action.
        """
        known = {name: number for number, name in enumerate(actions)}
        long = {clip.meta.action for clip in clips if len(clip) >= length}
        frames, starts, yaws, flips, owners, kinds = [], [], [], [], [], []
        base = 0
        low, high = np.inf, -np.inf
        for number, clip in enumerate(clips):
            if len(clip) < length and clip.meta.action in long:
                continue
            signed = fix_signs(clip, reference)
            held = cut(signed, length, hop)
            if len(clip) < length:
                signed = held.array[0]
            words = cut_clip(clip, reference, length=length, hop=hop)
            low, high = min(low, words.windows.array.min()), max(high, words.windows.array.max())
            plain = turned(held.array, np.broadcast_to(-words.yaw[:, None], held.array.shape[:2]))
            flips.append(np.sign(np.einsum("nk,nk->n", plain[:, 0, 0], words.windows.array[:, 0, 0])))
            frames.append(signed.transpose(1, 2, 0).astype(np.float32))
            starts.append(base + np.maximum(held.starts, 0))
            yaws.append(words.yaw)
            owners.append(np.full(len(held), number))
            kinds.append(np.full(len(held), known[clip.meta.action]))
            base += len(signed)
        offset, scale = 0.5 * (high + low), max(0.5 * (high - low), 1e-6)
        return cls(
            np.concatenate(frames, axis=2),
            np.concatenate(starts).astype(np.int64),
            np.concatenate(yaws),
            np.concatenate(flips),
            np.concatenate(owners),
            np.concatenate(kinds),
            tuple(actions),
            length,
            hop,
            Scale(float(offset), float(scale)),
        )

    def neighbours(self) -> NDArray[np.int64]:
        """Numbers of the words whose next word, of the same clip, starts just one hop later."""
        same = (self.clip[1:] == self.clip[:-1]) & (np.diff(self.starts) == self.hop)
        return np.flatnonzero(same)


class PairSampler:
    """Pairs of words, one of each style, that show the same action: uniform over actions, then clips, then words.

    Pairs are not aligned: only what is done is shared. Where no action is common to both styles, pairs are drawn over all.

    Parameters
    ----------
    source, target
        The domains, their actions numbered alike.
    adjacent
        Draw words that have a next one, for the transition loss.

    Attributes
    ----------
    conditional
        Whether pairs show the same action.

    Raises
    ------
    DataError
        If there is no such pair.
    """

    def __init__(self, source: Domain, target: Domain, *, adjacent: bool = False) -> None:
        self.source, self.target = source, target
        shared = sorted(set(source.action.tolist()) & set(target.action.tolist()))
        self.conditional = bool(shared)
        groups: list[int | None] = [*shared] if shared else [None]
        ours, theirs = (
            [_by_clip(domain, domain.neighbours() if adjacent else np.arange(len(domain)), group) for group in groups]
            for domain in (source, target)
        )
        kept = [k for k in range(len(groups)) if ours[k] and theirs[k]]
        if not kept:
            raise DataError(
                "no training clip of an action of both styles is long enough for two neighbouring words: "
                "leave the transition loss out, or choose a shorter length or hop"
            )
        self._tables = [[table[k] for k in kept] for table in (ours, theirs)]

    def __len__(self) -> int:
        """Pairs in an epoch: as many as the larger domain has words."""
        return max(len(self.source), len(self.target))

    def draw(self, count: int, rng: np.random.Generator) -> NDArray[np.int64]:
        """(count, 2) numbers of the words of ``count`` pairs."""
        kinds = rng.integers(len(self._tables[0]), size=count)
        numbers = []
        for table in self._tables:
            clips = [table[kind][int(rng.random() * len(table[kind]))] for kind in kinds]
            numbers.append(np.array([words[int(rng.random() * len(words))] for words in clips], dtype=np.int64))
        return np.stack(numbers, axis=1)


def _by_clip(domain: Domain, usable: NDArray[np.int64], action: int | None) -> list[NDArray[np.int64]]:
    if action is not None:
        usable = usable[domain.action[usable] == action]
    return [usable[domain.clip[usable] == clip] for clip in np.unique(domain.clip[usable])]
