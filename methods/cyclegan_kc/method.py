"""The method ``cyclegan-kc``: a cycle-consistent GAN on a motion autoencoder, with kinematic constraints."""

from __future__ import annotations

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
from methods._torch.presets import resolve
from methods.clips import training_clips

if TYPE_CHECKING:
    import torch

    from methods._torch.history import History
    from methods._torch.word_bank import WordBank
    from methods.cyclegan_kc.losses import Kinematics
    from methods.cyclegan_kc.network import Generator, Style
    from methods.holden.channels import Layout

Array = NDArray[np.float64]

#: Share of the progress bar that is pre-training.
_PRETRAINING = 0.3


class CycleGanKc(Method):
    """Cycle-consistent GAN with kinematic constraints (Wang, Du, Li, Ji & Yu 2021).

    An autoencoder of one convolution each way (that of Holden et al. 2016) learns the training clips of both styles, all put on
    the target skeleton. A transfer operator between its halves gives the hidden units of a content C the statistics of those
    of a style clip S: ``GM = G(C, S)``. The whole is then trained on words of both styles, paired by action, to fool a
    discriminator, to meet the Gram matrix of S, to come back as C when given C's own style again, ``G(GM, C)``, and to keep the
    content's accelerations, bone lengths and root trajectory. A new clip is transferred whole, in the style of the training
    clips of its action that are nearest in content; then its hidden units descend on the kinematic terms alone. Joint
    positions are read off, the target skeleton's bones are turned to them, and the root follows the velocity and yaw rate
    that were generated, at the source's own frame rate.

    The style comes from clips of any action where the training clips lack the source's, and the diagnostics say so. They
    also have the kinematic loss before and after refinement, and the mean error of bone lengths, as a share, before the
    skeleton is fitted.

    What the paper leaves open, and what is done here: S enters by adaptive instance normalisation and a learned convolution
    (``unrolled`` is the literal reading of a constraint in the hidden space; ``wct`` and ``transport`` match covariances); the
    discriminator has a head and does not share the encoder; the generator's adversarial loss does not saturate; equation 6
    compares S with GM and has a weight in the total, from which it is missing in print; equation 10 matches accelerations
    frame by frame, and has no negative values; all terms have weights, and units in which they are near 1.

    Departures from the paper, all of them: trained on the benchmark's own training clips, not on the CMU data; hidden units as
    pre-trained measure style; dropout acts in pre-training and on the discriminator, not on the generator in adversarial
    training; unpooling shares values evenly but for pre-training; the discriminator does not see contact channels; a clip is
    transferred whole, first and last frame held as padding, not in windows; refinement returns the best point it met. The
    preset ``quick`` in addition works at 30 frames a second, whitens and colours hidden units instead of normalising each
    (``wct``), adds what G changed to the content's own channels (``residual``), takes the style of several clips, holds
    standing feet (``w_foot``), weighs bones more and accelerations less, and takes fewer and larger steps of refinement;
    ``paper`` does none of these.

    Parameters
    ----------
    preset
        ``smoke``, ``quick`` or ``paper``: where every keyword that is ``None`` comes from.
    fps
        Frame rate that it works at.
    seconds
        Length of the words for training; they overlap by half.
    filters, width
        Of the autoencoder's convolutions: how many, and how many frames each spans (odd).
    dropout
        Share of inputs and hidden units dropped in pre-training, and of the discriminator's inputs.
    sparsity
        Weight of the mean magnitude of the weights in pre-training.
    pretrain_epochs, pretrain_lr
        Passes over the words of both styles, and Adam's learning rate.
    epochs, pairs
        Passes over ``pairs`` pairs of words in adversarial training; 0 pairs: one for each word of the source style.
    batch
        Words, or pairs, per update.
    lr, lr_judge
        Adam's learning rates for generator and discriminator; they fall to zero over the second half.
    operator
        ``adain``: mean and deviation of each unit; ``wct``: means and covariances, by whitening and colouring;
        ``transport``: the same with the least change to the content; ``unrolled``: steps of descent to the Gram matrix.
    strength
        How far the operator goes from the content's units, at 0, to the style's, at 1.
    unrolled_steps
        Steps of the operator ``unrolled``.
    mixing
        Hidden frames that the learned convolution after the operator spans, odd; 0 for none.
    residual
        Whether to add what G changes to the content's own channels, so that what the autoencoder cannot reproduce is kept.
    share_encoder
        Whether the discriminator's first layer is the generator's encoder, as in print.
    head
        Of the discriminator: ``mean`` over time, or ``patch``, a verdict for each hidden frame.
    gan
        ``log`` (equation 7) or ``lsgan``.
    symmetric
        Whether the cycle also begins at the style's words.
    smooth_mode
        ``match``: accelerations are the content's; ``abs``: their squared magnitudes are.
    w_gan, w_style, w_cyc, w_kc
        Weights of the terms of equation 14, and of the style loss. With 0 a term is off; ``w_kc`` is for training alone.
    w_smooth, w_bone, w_traj, w_foot
        Weights within the kinematic term, in training and refinement.
    exemplars
        How many clips the style is averaged over in a transfer.
    refine_iterations, refine_step
        Of the refinement: how many, and Adam's learning rate; 0 iterations switch it off.
    """

    info = MethodInfo(
        name="cyclegan-kc",
        summary="cycle-consistent GAN on a motion autoencoder, with kinematic constraints",
        capabilities=Capabilities(
            supervision=Supervision.UNPAIRED,
            representation=("positions",),
            output="positions",
            device="gpu_preferred",
            stochastic_fit=True,
        ),
        citation="Wang, Du, Li, Ji & Yu 2021",
        code_deps=(
            "methods.clips",
            "methods.cyclegan_kc",
            "methods.holden.channels",
            "methods.holden.corpus",
            "methods.holden.descent",
            "methods.holden.exemplars",
            "methods.holden.network",
            "methods._torch",
            "methods.hsu.track",
            "benchmark.motion.canonical",
            "benchmark.motion.contacts",
            "benchmark.motion.dtw",
            "benchmark.motion.ik",
            "benchmark.motion.pose",
            "benchmark.motion.resample",
            "benchmark.motion.retarget",
            "benchmark.motion.root",
            "benchmark.motion.windows",
        ),
    )

    def __init__(
        self,
        *,
        preset: str = "quick",
        fps: float | None = None,
        seconds: float | None = None,
        filters: int | None = None,
        width: int | None = None,
        dropout: float | None = None,
        sparsity: float | None = None,
        pretrain_epochs: int | None = None,
        pretrain_lr: float | None = None,
        epochs: int | None = None,
        pairs: int | None = None,
        batch: int | None = None,
        lr: float | None = None,
        lr_judge: float | None = None,
        operator: str | None = None,
        strength: float | None = None,
        unrolled_steps: int | None = None,
        mixing: int | None = None,
        residual: bool | None = None,
        share_encoder: bool | None = None,
        head: str | None = None,
        gan: str | None = None,
        symmetric: bool | None = None,
        smooth_mode: str | None = None,
        w_gan: float | None = None,
        w_style: float | None = None,
        w_cyc: float | None = None,
        w_kc: float | None = None,
        w_smooth: float | None = None,
        w_bone: float | None = None,
        w_traj: float | None = None,
        w_foot: float | None = None,
        exemplars: int | None = None,
        refine_iterations: int | None = None,
        refine_step: float | None = None,
    ) -> None:
        self.preset = preset
        self.fps = fps
        self.seconds = seconds
        self.filters = filters
        self.width = width
        self.dropout = dropout
        self.sparsity = sparsity
        self.pretrain_epochs = pretrain_epochs
        self.pretrain_lr = pretrain_lr
        self.epochs = epochs
        self.pairs = pairs
        self.batch = batch
        self.lr = lr
        self.lr_judge = lr_judge
        self.operator = operator
        self.strength = strength
        self.unrolled_steps = unrolled_steps
        self.mixing = mixing
        self.residual = residual
        self.share_encoder = share_encoder
        self.head = head
        self.gan = gan
        self.symmetric = symmetric
        self.smooth_mode = smooth_mode
        self.w_gan = w_gan
        self.w_style = w_style
        self.w_cyc = w_cyc
        self.w_kc = w_kc
        self.w_smooth = w_smooth
        self.w_bone = w_bone
        self.w_traj = w_traj
        self.w_foot = w_foot
        self.exemplars = exemplars
        self.refine_iterations = refine_iterations
        self.refine_step = refine_step

    @classmethod
    def presets(cls) -> dict[str, dict[str, Any]]:
        """The paper's own comparison, each constraint alone, and equation 14 to the letter."""
        off = {"w_smooth": 0.0, "w_bone": 0.0, "w_traj": 0.0, "w_foot": 0.0}
        return {
            "unconstrained": {"w_kc": 0.0, **off, "refine_iterations": 0},
            "bone-only": {**off, "w_bone": 1.0},
            "trajectory-only": {**off, "w_traj": 1.0},
            "smooth-only": {**off, "w_smooth": 1.0},
            "eq14": {
                **dict.fromkeys(("w_gan", "w_cyc", "w_kc", "w_smooth", "w_bone", "w_traj"), 1.0),
                "w_style": 0.0,
                "w_foot": 0.0,
            },
        }

    @classmethod
    def test_params(cls) -> list[dict[str, Any]]:
        """The small preset, and with it the literal readings."""
        literal = {"operator": "unrolled", "share_encoder": True, "residual": False, "exemplars": 1, "w_foot": 0.0}
        return [{"preset": "smoke"}, {"preset": "smoke", **literal}]

    def fit(self, train: TrainView, task: StyleTask, *, rng: np.random.Generator, ctx: FitContext) -> Self:
        """Train the autoencoder on the words of both styles, then generator and discriminator on pairs of them."""
        from methods._torch.device import device_for, isolated_random
        from methods._torch.word_bank import WordBank
        from methods.cyclegan_kc.losses import mean_squared_acceleration
        from methods.cyclegan_kc.training import PairSampler
        from methods.holden import corpus
        from methods.holden.channels import Layout, Scaling
        from methods.holden.training import train_autoencoder

        chosen = self.settings_ = self._settings()
        sources, targets = training_clips("cyclegan-kc", train, task)
        self.body_ = task.target_skeleton or targets[0].skeleton
        self.layout_ = Layout.of(self.body_)
        arrays = corpus.read_channels([*sources, *targets], self.body_, self.layout_, chosen["fps"], ctx.report)
        self.scaling_ = Scaling.fit(self.layout_, arrays)
        self.acceleration_ = mean_squared_acceleration(self.layout_, arrays)
        arrays = [self.scaling_.apply(array) for array in arrays]
        self.examples_ = corpus.make_examples(targets, arrays[len(sources) :])

        device = device_for(ctx.device)
        length = 2 * max(1, round(0.5 * chosen["seconds"] * chosen["fps"]))
        bank = WordBank(arrays, length, length // 2, device=device)
        sampler = PairSampler(bank.clip, [clip.meta.action for clip in (*sources, *targets)], len(sources))
        self.facts_: dict[str, Any] = {
            "words": len(bank),
            "pairs": "same action" if sampler.conditional else "any action",
        }
        with isolated_random(rng):
            generator = self._generator().to(device)
        self.pretraining_ = train_autoencoder(
            generator.autoencoder,
            bank,
            epochs=chosen["pretrain_epochs"],
            batch=chosen["batch"],
            lr=chosen["pretrain_lr"],
            dropout=chosen["dropout"],
            sparsity=chosen["sparsity"],
            rng=rng,
            ctx=_share(ctx, 0.0, _PRETRAINING),
            name="autoencoder",
        )
        self.history_ = self._train(generator, bank, sampler, rng, _share(ctx, _PRETRAINING, 1.0))
        self._ready(generator)
        return self

    def transfer(self, source: MotionClip, task: StyleTask, *, rng: np.random.Generator) -> TransferResult:
        """Give ``source`` the style, on ``task.target_skeleton``, at its own frame rate and length."""
        from benchmark.motion.resample import resample
        from benchmark.motion.retarget import retarget
        from methods.cyclegan_kc.refinement import Padded, draw
        from methods.holden.corpus import choose_examples, resampled

        chosen = self.settings_
        skeleton = source.skeleton if task.target_skeleton is None else task.target_skeleton
        own = retarget(source, self.body_)
        work = resample(own, chosen["fps"])
        if len(work) < 2:
            work = own
        channels = self.layout_.encode(work)
        low = self.scaling_.apply(channels)
        picked, known = choose_examples(self.examples_, source, chosen["exemplars"])
        drawn = draw(
            self.generator_,
            self.decoder_,
            Padded(low, self._margin()),
            [self.styles_[index] for index in picked],
            self._kinematics("cpu"),
            iterations=chosen["refine_iterations"],
            step=chosen["refine_step"],
        )
        out = drawn.channels - low if chosen["residual"] else drawn.channels
        made = resampled(out, work.times, source.times)
        if chosen["residual"]:
            made = (channels if work is own else self.layout_.encode(own, contacts=False)) + made * self.scaling_.scale
        else:
            made = self.scaling_.invert(made)
        posed = _posed(self.layout_, made, own)
        result = posed if skeleton == self.body_ else retarget(posed, skeleton)
        diagnostics = {
            "exemplars": [self.examples_[index].clip_id for index in picked],
            "action_in_training": known,
            "kinematic_loss": [drawn.before, drawn.after],
            "bone_length_error": drawn.bone_error,
        }
        return TransferResult(result, diagnostics=diagnostics)

    def save(self, folder: Path) -> None:
        """Write weights, statistics and the target style's clips as safetensors, and the loss curves."""
        from methods._torch.weights import write_tensors
        from methods.holden import corpus

        facts = {
            "params": self.params(),
            "settings": self.settings_,
            "acceleration": self.acceleration_,
            "facts": self.facts_,
            "examples": corpus.names_of(self.examples_),
        }
        tensors = {f"generator/{name}": value for name, value in self.generator_.state_dict().items()}
        tensors |= corpus.to_tensors(self.scaling_, self.examples_)
        write_tensors(folder / "cyclegan-kc.safetensors", tensors, facts)
        corpus.save_body(self.body_, self.settings_["fps"], folder)
        self.pretraining_.save(folder / "pretrain.parquet")
        self.history_.save(folder / "train.parquet")

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read what :meth:`save` wrote; loss curves stay on disk."""
        from methods._torch.history import History
        from methods._torch.weights import read_tensors, under
        from methods.holden import corpus
        from methods.holden.channels import Layout

        tensors, facts = read_tensors(folder / "cyclegan-kc.safetensors")
        method = cls(**facts["params"])
        method.settings_ = facts["settings"]
        method.acceleration_ = facts["acceleration"]
        method.facts_ = facts["facts"]
        method.body_ = corpus.load_body(folder)
        method.layout_ = Layout.of(method.body_)
        method.scaling_, method.examples_ = corpus.from_tensors(tensors, facts["examples"])
        generator = method._generator()
        generator.load_state_dict(under(tensors, "generator/"))
        method.pretraining_, method.history_ = History(), History()
        method._ready(generator)
        return method

    def _settings(self) -> dict[str, Any]:
        """The settings, checked."""
        given = self.params()
        chosen = resolve("methods.cyclegan_kc", given.pop("preset"), given)
        choices = {
            "operator": ("adain", "wct", "transport", "unrolled"),
            "head": ("mean", "patch"),
            "gan": ("log", "lsgan"),
            "smooth_mode": ("match", "abs"),
        }
        for name, allowed in choices.items():
            if chosen[name] not in allowed:
                raise ConfigError(f"cyclegan-kc: {name} must be one of {', '.join(allowed)}, not {chosen[name]!r}")
        if chosen["width"] % 2 == 0:
            raise ConfigError(f"cyclegan-kc: width must be odd, not {chosen['width']}: filters are centred on a frame")
        if chosen["mixing"] % 2 == 0 and chosen["mixing"]:
            raise ConfigError(f"cyclegan-kc: mixing must be odd, or 0 for none, not {chosen['mixing']}")
        if not 0 <= chosen["dropout"] < 1:
            raise ConfigError(f"cyclegan-kc: dropout must be at least 0 and below 1, not {chosen['dropout']}")
        if not 0 <= chosen["strength"] <= 1:
            raise ConfigError(f"cyclegan-kc: strength must be from 0 to 1, not {chosen['strength']}")
        positive = ("fps", "seconds", "filters", "width", "pretrain_epochs", "pretrain_lr", "epochs", "batch", "lr")
        for name in (*positive, "lr_judge", "exemplars", "refine_step"):
            if not chosen[name] > 0:
                raise ConfigError(f"cyclegan-kc: {name} must be above 0, not {chosen[name]}")
        weights = [name for name in chosen if name.startswith("w_")]
        for name in (*weights, "sparsity", "pairs", "mixing", "unrolled_steps", "refine_iterations"):
            if not chosen[name] >= 0:
                raise ConfigError(f"cyclegan-kc: {name} must not be negative, and it is {chosen[name]}")
        return chosen

    def _generator(self) -> Generator:
        from methods.cyclegan_kc.network import Generator
        from methods.holden.network import Autoencoder

        chosen = self.settings_
        return Generator(
            Autoencoder(self.layout_.dim, chosen["filters"], chosen["width"]),
            operator=chosen["operator"],
            strength=chosen["strength"],
            steps=chosen["unrolled_steps"],
            mixing=chosen["mixing"],
            residual=chosen["residual"],
        )

    def _kinematics(self, device: torch.device | str) -> Kinematics:
        from methods.cyclegan_kc.losses import TERMS, Kinematics

        chosen = self.settings_
        smooth, bone, trajectory, foot = (chosen[f"w_{name}"] for name in TERMS)
        return Kinematics.of(
            self.layout_,
            self.scaling_,
            acceleration=self.acceleration_,
            fps=chosen["fps"],
            mode=chosen["smooth_mode"],
            weights=(smooth, bone, trajectory, foot),
            device=device,
        )

    def _train(
        self, generator: Generator, bank: WordBank, sampler: Any, rng: np.random.Generator, ctx: FitContext
    ) -> History:
        from methods._torch.device import isolated_random
        from methods._torch.schedule import linear_decay
        from methods._torch.train import Settings, train
        from methods.cyclegan_kc.network import Discriminator
        from methods.cyclegan_kc.training import KinematicCycleStep, Weights

        chosen, device = self.settings_, bank.frames.device
        seen = np.ones(self.layout_.dim)
        seen[self.layout_.contacts] = 0.0
        with isolated_random(rng):
            judge = Discriminator(
                generator.autoencoder, seen.tolist(), head=chosen["head"], share=chosen["share_encoder"]
            )
        step = KinematicCycleStep(
            generator,
            judge.to(device),
            bank,
            kinematics=self._kinematics(device),
            weights=Weights(chosen["w_gan"], chosen["w_style"], chosen["w_cyc"], chosen["w_kc"]),
            gan=chosen["gan"],
            symmetric=chosen["symmetric"],
            dropout=chosen["dropout"],
            lr=chosen["lr"],
            lr_judge=chosen["lr_judge"],
        )
        count, half = chosen["pairs"] or len(sampler), 0.5 * chosen["epochs"]
        return train(
            step,
            items=lambda epoch, draws: sampler.draw(count, draws),
            states=step.states,
            optimizers=step.optimizers,
            # Covariances and their roots do not bear bfloat16.
            settings=Settings(epochs=chosen["epochs"], batch=chosen["batch"], precision="float32"),
            rng=rng,
            device=device,
            schedules=dict.fromkeys(step.optimizers, linear_decay(start=half, length=half)),
            folder=ctx.work_dir,
            name="cyclegan-kc",
            report=ctx.report,
            unit="pairs",
        )

    def _ready(self, generator: Generator) -> None:
        """Keep a trained generator, and what it takes from each example, which follows from it."""
        import torch

        from methods.cyclegan_kc.analytic import PairDecoder
        from methods.cyclegan_kc.refinement import Padded

        self.generator_ = generator.cpu().eval().requires_grad_(False)
        self.decoder_ = PairDecoder(self.generator_.autoencoder.decoder)
        with torch.no_grad():
            self.styles_: list[Style] = [
                Padded(example.channels, self._margin()).style(generator) for example in self.examples_
            ]

    def _margin(self) -> int:
        """Frames of padding on either side, even, over which the zeros beyond the ends are out of the filters' reach."""
        chosen = self.settings_
        # Half a filter of the encoder and of the decoder, and half one of hidden frames, each of which is two, and their pair.
        return 2 * (chosen["width"] // 2 + chosen["mixing"] // 2 + 1)


def _share(ctx: FitContext, start: float, end: float) -> FitContext:
    """The context in which a part of the work moves a part of the progress bar."""
    return FitContext(
        ctx.device, ctx.work_dir, lambda fraction, message: ctx.report(start + (end - start) * fraction, message)
    )


def _posed(layout: Layout, values: Array, own: MotionClip) -> MotionClip:
    """The clip that channels (T, D) in units describe, its root moving and turning as they say.

    ``own`` gives the first frame's place and direction, the height at which feet meet the floor, and what positions leave
    open.
    """
    from benchmark.motion.canonical import HEADING_SIGMA, heading
    from benchmark.motion.root import turn_frames

    yaw = heading(own, sigma=HEADING_SIGMA)
    turned = np.concatenate([[0.0], np.cumsum(values[:-1, layout.velocity][:, 2] / own.fps)])
    # The root's place is composed again from the velocities by `decode`; here it only has to turn with the body.
    return layout.decode(values, turn_frames(own, turned - (yaw - yaw[0])))
