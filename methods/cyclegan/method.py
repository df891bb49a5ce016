"""The method ``cyclegan``: Adult2child, a CycleGAN over motion words, from training clips to transferred ones."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from benchmark.api import (
    Capabilities,
    FitContext,
    Method,
    MethodInfo,
    StyleTask,
    Supervision,
    TrainView,
    TransferResult,
)
from benchmark.errors import ConfigError
from benchmark.motion.clip import MotionClip
from benchmark.motion.skeleton import Skeleton
from methods._torch.presets import resolve
from methods.clips import training_clips

if TYPE_CHECKING:
    from methods._torch.history import History
    from methods.cyclegan.generator import Generator
    from methods.cyclegan.words import PairSampler, Scale

Array = NDArray[np.float64]

#: Words that go through a generator together in a transfer: few enough for the cache, enough to be worth a call.
_AT_ONCE = 24

#: Share of the frames, those with the lowest foot, that count as stance.
_STANCE_SHARE = 0.25

_ROUTES = {"forth": ("forth",), "back": ("back",), "cycle": ("forth", "back")}


class CycleGan(Method):
    """Adult2child (Dong et al., MIG 2020): two generators between motion words of two styles, kept in check by a cycle.

    Clips of both styles are put on the target skeleton and cut into words of joint quaternions. A generator convolves every
    joint along time with kernels of its own; a PatchGAN discriminator sees all joints. Least-squares adversarial losses, a
    cycle loss and a temporal coherence loss; words of the two styles are drawn in pairs of the same action, not aligned. A
    clip is transferred word by word; overlapping words are averaged, peaks removed and the rest low-passed. Place, path and
    facing on the floor are the source's, the path scaled by leg length; one constant lift keeps the stance foot at its height.

    Both directions are kept: :meth:`reverse` goes the other way, :meth:`round_trip` there and back.

    Settings that are ``None`` come from the preset; ``paper`` has those of the paper, and of Zhu et al. 2017 where it is
    silent. ``quick`` departs from them beyond size and schedule: no instance norm, standardised inputs and a long skip, a
    coherence loss that does not reward frozen poses, both generators updated at once, and filters on the change from the source
    instead of on the output, which would lose what the source itself has above their cutoff.

    Parameters
    ----------
    preset
        ``smoke``, ``quick`` or ``paper``.
    convolution
        ``joint``: kernels for each joint along time; ``joint2d``: over time and the quaternion axis, the literal reading;
        ``overall``: over time and joints, shared by all joints, the paper's negative result.
    width
        Channels of the generators' first layer, per joint (joint-wise) or in all; doubled twice.
    blocks
        Residual blocks of a generator.
    norm
        ``instance``, or ``none``. Instance norm takes the mean of every channel over the word away, and with it the pose
        about which a word moves.
    cross_joint
        Mix joints once before the residual blocks; strictly joint-wise generators cannot coordinate joints.
    skip
        Generators say how much a pose changes instead of what it becomes.
    whiten
        Standardise what generators and discriminators see, component by component.
    judge_width, judge_norm
        Channels of the discriminators' first layer, doubled three times; ``instance`` or ``none``.
    cycle, coherence, transition, identity
        Weights of the losses; the adversarial one has 1.
    coherence_mode
        ``absolute``: all change from frame to frame is penalised, as in the paper, which favours a frozen pose; ``excess``:
        only what exceeds the source word's; ``second``: second differences.
    order
        ``sequential``: both generators and both discriminators are updated in the paper's order, one after another; ``joint``:
        both generators at once, with half of the forward passes.
    pool
        Earlier words kept for either discriminator; 0 for none.
    lr, lr_judge
        Initial rates of Adam (beta_1 0.5) for generators and discriminators.
    decay_from, decay_over
        From this epoch rates fall in a straight line, to zero over so many epochs; by steps of whole epochs.
    epochs
        Passes over ``pairs`` pairs of words.
    pairs
        Pairs in an epoch; 0: as many as the style with more words has.
    batch
        Pairs per update.
    length, hop, fps
        Frames of a word, between words, and per second.
    blend
        Weights of overlapping words: ``ones``, ``hann`` or ``triangular``.
    peaks
        Whether to remove peaks (Hampel filter, 7 frames, 3 deviations).
    cutoff
        Hertz of the zero-phase low-pass (second-order Butterworth, both ways); 0 for none.
    smooth
        What peaks and high frequencies are taken from: the ``output``, as in the paper, or the ``change`` from the source, so
        that what the source has of them, a person's and the capture's, is kept.
    return_trip
        Whether a transfer also hands out the clip taken to the target style and back, for the metric of the double
        translation; it costs as much again.
    """

    info = MethodInfo(
        name="cyclegan",
        summary="CycleGAN over motion words of joint rotations, with temporal coherence",
        capabilities=Capabilities(
            supervision=Supervision.UNPAIRED,
            representation=("quaternions",),
            device="gpu_preferred",
            stochastic_fit=True,
        ),
        citation="Dong, Aristidou, Shamir, Mahler & Jain 2020",
        code_deps=(
            "methods.clips",
            "methods.cyclegan",
            "methods._torch",
            "benchmark.motion.canonical",
            "benchmark.motion.features",
            "benchmark.motion.quat",
            "benchmark.motion.resample",
            "benchmark.motion.retarget",
            "benchmark.motion.windows",
        ),
    )

    def __init__(
        self,
        *,
        preset: str = "quick",
        convolution: str | None = None,
        width: int | None = None,
        blocks: int | None = None,
        norm: str | None = None,
        cross_joint: bool | None = None,
        skip: bool | None = None,
        whiten: bool | None = None,
        judge_width: int | None = None,
        judge_norm: str | None = None,
        cycle: float | None = None,
        coherence: float | None = None,
        coherence_mode: str | None = None,
        transition: float | None = None,
        identity: float | None = None,
        order: str | None = None,
        pool: int | None = None,
        lr: float | None = None,
        lr_judge: float | None = None,
        decay_from: float | None = None,
        decay_over: float | None = None,
        epochs: int | None = None,
        pairs: int | None = None,
        batch: int | None = None,
        length: int | None = None,
        hop: int | None = None,
        fps: float | None = None,
        blend: str | None = None,
        peaks: bool | None = None,
        cutoff: float | None = None,
        smooth: str | None = None,
        return_trip: bool | None = None,
    ) -> None:
        self.preset = preset
        self.convolution = convolution
        self.width = width
        self.blocks = blocks
        self.norm = norm
        self.cross_joint = cross_joint
        self.skip = skip
        self.whiten = whiten
        self.judge_width = judge_width
        self.judge_norm = judge_norm
        self.cycle = cycle
        self.coherence = coherence
        self.coherence_mode = coherence_mode
        self.transition = transition
        self.identity = identity
        self.order = order
        self.pool = pool
        self.lr = lr
        self.lr_judge = lr_judge
        self.decay_from = decay_from
        self.decay_over = decay_over
        self.epochs = epochs
        self.pairs = pairs
        self.batch = batch
        self.length = length
        self.hop = hop
        self.fps = fps
        self.blend = blend
        self.peaks = peaks
        self.cutoff = cutoff
        self.smooth = smooth
        self.return_trip = return_trip

    @classmethod
    def test_params(cls) -> list[dict[str, Any]]:
        """The smallest setting."""
        return [{"preset": "smoke"}]

    def fit(self, train: TrainView, task: StyleTask, *, rng: np.random.Generator, ctx: FitContext) -> Self:
        """Train both generators and discriminators on the words of all clips of the two styles."""
        from methods._torch.device import device_for, torch_generator
        from methods._torch.schedule import linear_decay, stepwise
        from methods._torch.train import Settings
        from methods._torch.train import train as run
        from methods.cyclegan.discriminator import Discriminator
        from methods.cyclegan.training import CycleGanStep, Weights, WordTable

        chosen = self._chosen()
        sampler = self._prepare(train, task, chosen)
        device = device_for(ctx.device)
        forth, back = self._generators(chosen)
        judge_source, judge_target = (
            Discriminator(
                len(self.body_),
                widths=[chosen["judge_width"] * factor for factor in (1, 2, 4, 8)],
                norm=chosen["judge_norm"],
                whiten=chosen["whiten"],
            )
            for _ in range(2)
        )
        source, target = WordTable(sampler.source, device), WordTable(sampler.target, device)
        seeds = torch_generator(rng)
        for network, table in ((forth, source), (back, target), (judge_source, source), (judge_target, target)):
            network.reset(seeds)
            network.to(device)
            if network.whitening is not None:
                network.whitening.fit(*table.moments())
        step = CycleGanStep(
            forth,
            back,
            judge_source,
            judge_target,
            source,
            target,
            weights=Weights(
                chosen["cycle"], chosen["coherence"], chosen["transition"], chosen["identity"], chosen["coherence_mode"]
            ),
            order=chosen["order"],
            hop=chosen["hop"],
            pool=chosen["pool"],
            lr=chosen["lr"],
            lr_discriminator=chosen["lr_judge"],
        )
        count = chosen["pairs"] or len(sampler)
        falling = stepwise(linear_decay(start=chosen["decay_from"], length=chosen["decay_over"]))
        self.history_: History = run(
            step,
            items=lambda epoch, draws: sampler.draw(count, draws),
            states=step.states,
            optimizers=step.optimizers,
            settings=Settings(chosen["epochs"], chosen["batch"], precision="float32"),
            rng=rng,
            device=device,
            schedules=dict.fromkeys(step.optimizers, falling),
            folder=ctx.work_dir,
            name="cyclegan",
            report=ctx.report,
            unit="pairs",
        )
        self.generators_ = {"forth": forth.cpu().eval(), "back": back.cpu().eval()}
        return self

    def transfer(self, source: MotionClip, task: StyleTask, *, rng: np.random.Generator) -> TransferResult:
        """Put ``source`` into the target style on ``task.target_skeleton``, frame for frame at its own rate."""
        skeleton = source.skeleton if task.target_skeleton is None else task.target_skeleton
        clip, raw = self._translated(source, skeleton, "forth")
        back = self.round_trip(source) if self.settings_["return_trip"] else None
        return TransferResult(clip, raw_clip=raw, round_trip=back)

    def reverse(self, clip: MotionClip, skeleton: Skeleton | None = None) -> MotionClip:
        """A clip of the target style in the source style, on ``skeleton`` or its own."""
        return self._translated(clip, skeleton or clip.skeleton, "back")[0]

    def round_trip(self, clip: MotionClip, skeleton: Skeleton | None = None) -> MotionClip:
        """A clip of the source style taken to the target style and back: what the cycle loss compares with the clip itself.

        Words go through both generators before they are blended and smoothed, once.
        """
        return self._translated(clip, skeleton or clip.skeleton, "cycle")[0]

    def save(self, folder: Path) -> None:
        """Write settings as JSON, generators as safetensors, the skeleton as ``.npz`` and loss curves as parquet."""
        from benchmark.motion import npz, quat
        from benchmark.motion.clip import ClipMeta
        from methods._torch.weights import save_weights

        folder.mkdir(parents=True, exist_ok=True)
        header = {
            "params": self.params(),
            "settings": self.settings_,
            "scales": {name: scale.pair for name, scale in self.scales_.items()},
            "facts": self.facts_,
        }
        (folder / "cyclegan.json").write_text(json.dumps(header, indent=1, sort_keys=True))
        save_weights(folder / "generators.safetensors", self.generators_)
        np.savez(folder / "reference.npz", reference=self.reference_)
        rest = MotionClip(self.body_, quat.identity(1, len(self.body_)), np.zeros((1, 3)), 1.0, ClipMeta())
        npz.save(rest, folder / "body.npz")
        self.history_.save(folder / "train.parquet")

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read what :meth:`save` wrote; loss curves stay on disk."""
        from benchmark.motion import npz
        from methods._torch.history import History
        from methods._torch.weights import load_weights
        from methods.cyclegan.words import Scale

        header = json.loads((folder / "cyclegan.json").read_text())
        method = cls(**header["params"])
        method.settings_ = header["settings"]
        method.facts_ = header["facts"]
        method.scales_ = {name: Scale(*pair) for name, pair in header["scales"].items()}
        method.reference_ = npz.read_arrays(folder / "reference.npz")["reference"]
        method.body_ = npz.load(folder / "body.npz").skeleton
        forth, back = method._generators(method.settings_)
        method.generators_ = {"forth": forth.eval(), "back": back.eval()}
        load_weights(folder / "generators.safetensors", method.generators_)
        method.history_ = History()
        return method

    def _chosen(self) -> dict[str, Any]:
        """The settings, checked."""
        from benchmark.motion.windows import WEIGHTS

        given = self.params()
        preset = given.pop("preset")
        chosen = resolve("methods.cyclegan", preset, given)
        choices = {
            "convolution": ("joint", "joint2d", "overall"),
            "norm": ("instance", "none"),
            "judge_norm": ("instance", "none"),
            "coherence_mode": ("absolute", "excess", "second"),
            "order": ("sequential", "joint"),
            "blend": WEIGHTS,
            "smooth": ("output", "change"),
        }
        for name, allowed in choices.items():
            if chosen[name] not in allowed:
                raise ConfigError(f"cyclegan: {name} must be one of {', '.join(allowed)}, not {chosen[name]!r}")
        least = {"width": 1, "judge_width": 1, "epochs": 1, "batch": 1, "hop": 1}
        least |= dict.fromkeys(("blocks", "pool", "pairs", "cycle", "coherence", "transition", "identity", "cutoff"), 0)
        for name, bound in least.items():
            if not chosen[name] >= bound:
                raise ConfigError(f"cyclegan: {name} must be at least {bound}, not {chosen[name]!r}")
        for name in ("lr", "lr_judge", "decay_over", "fps"):
            if not chosen[name] > 0:
                raise ConfigError(f"cyclegan: {name} must be above 0, not {chosen[name]!r}")
        if chosen["length"] % 4 or chosen["length"] < 24:
            raise ConfigError(
                f"cyclegan: length must be a multiple of 4 and at least 24 frames, not {chosen['length']!r}: "
                "the generators work at a quarter of the rate, the discriminators at a quarter less two"
            )
        if chosen["hop"] > chosen["length"]:
            raise ConfigError(f"cyclegan: hop must be at most length ({chosen['length']}), not {chosen['hop']!r}")
        if chosen["cross_joint"] and chosen["convolution"] == "overall":
            raise ConfigError(
                "cyclegan: cross_joint is for joint-wise generators; convolution 'overall' mixes all joints"
            )
        self.settings_ = chosen
        return chosen

    def _prepare(self, train: TrainView, task: StyleTask, chosen: dict[str, Any]) -> PairSampler:
        """The words of both styles and how to draw them."""
        from methods.cyclegan.words import Domain, PairSampler, on_body, word_reference

        sides = list(training_clips("cyclegan", train, task))
        shared = {clip.meta.action for clip in sides[0]} & {clip.meta.action for clip in sides[1]}
        self.body_ = task.target_skeleton or sides[1][0].skeleton
        if shared:
            sides = [[clip for clip in clips if clip.meta.action in shared] for clips in sides]
        sides = [[on_body(clip, self.body_, chosen["fps"]) for clip in clips] for clips in sides]
        cutting = {"length": chosen["length"], "hop": chosen["hop"]}
        self.reference_ = word_reference([clip for clips in sides for clip in clips], **cutting)
        actions = sorted({clip.meta.action for clips in sides for clip in clips})
        source, target = (Domain.of(clips, self.reference_, actions, **cutting) for clips in sides)
        self.scales_: dict[str, Scale] = {"source": source.scale, "target": target.scale}
        sampler = PairSampler(source, target, adjacent=chosen["transition"] > 0)
        self.facts_: dict[str, Any] = {
            "words": [len(source), len(target)],
            "actions": len(actions),
            "pairs": "same action" if sampler.conditional else "any action",
        }
        return sampler

    def _generators(self, chosen: dict[str, Any]) -> tuple[Generator, Generator]:
        from methods.cyclegan.generator import make_generator

        options = {
            name: chosen[name] for name in ("convolution", "width", "blocks", "norm", "cross_joint", "skip", "whiten")
        }
        source, target = self.scales_["source"].pair, self.scales_["target"].pair
        joints = len(self.body_)
        forth = make_generator(joints, source=source, target=target, **options)
        back = make_generator(joints, source=target, target=source, **options)
        return forth, back

    def _translated(self, source: MotionClip, skeleton: Skeleton, route: str) -> tuple[MotionClip, MotionClip]:
        """The clip on ``skeleton`` after the generators of ``route``; smoothed, and as blended."""
        from benchmark.motion import quat
        from benchmark.motion.resample import low_pass, sample_at
        from benchmark.motion.retarget import retarget
        from benchmark.motion.windows import overlap_add_quat
        from methods.cyclegan.smoothing import smooth_rotations
        from methods.cyclegan.words import cut_clip, on_body

        chosen = self.settings_
        clip = on_body(source, self.body_, chosen["fps"])
        cut = cut_clip(clip, self.reference_, length=chosen["length"], hop=chosen["hop"])
        words = self._generated(cut.windows.array, route)
        blended = overlap_add_quat(cut.restored(words), weights=chosen["blend"])
        filters = {"peaks": chosen["peaks"], "cutoff": chosen["cutoff"]}
        if chosen["smooth"] == "change":
            turned = quat.inv_mul(clip.rotations, blended)
            smooth = quat.mul(clip.rotations, smooth_rotations(turned, chosen["fps"], **filters))
        else:
            smooth = smooth_rotations(blended, chosen["fps"], **filters)
        # What has been low-passed already holds next to nothing that thinning could fold back; nor does what a source of the
        # lower rate was moved by.
        low = 0.4 * source.fps
        calm = 0 < chosen["cutoff"] <= low
        results = []
        for rotations, folds in ((smooth, not calm), (blended, True)):
            result = _placed(clip, rotations)
            if skeleton != self.body_:
                result = retarget(result, skeleton)
            if source.fps != chosen["fps"]:
                if source.fps < chosen["fps"] and folds:
                    result = low_pass(result, low)
                result = sample_at(result, source.times, fps=source.fps)
            results.append(result)
        return results[0], results[1]

    def _generated(self, words: Array, route: str) -> Array:
        """Words (N, L, J, 4) through the generators of ``route``."""
        import torch

        legs = _ROUTES[route]
        first, last = ("target", "source") if legs[0] == "back" else ("source", "target")
        if len(legs) == 2:
            last = "source"
        given, got = self.scales_[first], self.scales_[last]
        x = torch.as_tensor((words.transpose(2, 3, 1, 0) - given.offset) / given.scale, dtype=torch.float32)
        with torch.inference_mode():
            parts = []
            for part in x.split(_AT_ONCE, dim=-1):
                out = part.contiguous()
                for leg in legs:
                    out = self.generators_[leg](out)
                parts.append(out)
            y = torch.cat(parts, dim=-1).double().numpy()
        out_words: Array = (y * got.scale + got.offset).transpose(3, 2, 0, 1)
        return out_words


def _placed(clip: MotionClip, rotations: Array) -> MotionClip:
    """``clip`` with other rotations, on its own path; one constant lift puts the stance foot back to its height."""
    posed = clip.replace(rotations=rotations, translations=None, residual=None, source=None)
    root = clip.root.copy()
    root[:, 1] += _stance_height(clip) - _stance_height(posed)
    return posed.replace(root=root)


def _stance_height(clip: MotionClip) -> float:
    """Median height in metres of the lowest foot point, over the frames in which it is lowest."""
    from benchmark.motion.canonical import foot_points

    lowest = foot_points(clip)[..., 1].min(axis=1)
    return float(np.median(lowest[lowest <= np.quantile(lowest, _STANCE_SHARE)]))
