"""The method ``holden``: an autoencoder of motion, and descent on what it hides."""

from __future__ import annotations

from collections.abc import Sequence
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
    from torch import Tensor

    from methods.holden.corpus import Example

Array = NDArray[np.float64]

#: By how much the root may be sped up or slowed down, and the mean speed, in leg lengths per second, below which it is not.
SPEED_LIMITS, STANDING_SPEED = (0.5, 2.0), 0.1


class Holden(Method):
    """Convolutional autoencoder and style transfer by Gram matrices in its hidden space (Holden, Saito & Komura 2016).

    An autoencoder of one convolution each way learns the training clips of both styles, all put on the target skeleton. A
    new clip's hidden units then descend from the content's (or noise) to where their products over time, the Gram matrix, are
    those of real clips of the target style, while staying near the content's; and from there to where bones have their
    lengths, the root follows its trajectory and feet that stand do not slide. Joint positions are read off, and the target
    skeleton's bones are turned to them.

    The style comes from training clips of the same action that are nearest in content, by dynamic time warping of the pose;
    from any action where the training clips lack this one, and the diagnostics say so. The source's clock, the direction
    faced and the contacts stay; the root's speed is scaled as in the released code, by the mean speed of the stylised motion
    over that of the content.

    Departures from the paper, all of them: trained on the benchmark's own training clips, not on the CMU data; unpooling shares
    values evenly at test (the released code's argument for it is ignored there); Gram matrices are means over time, not
    sums; a clip is transferred whole, in one descent, not in windows that would have to be blended; descents return the best
    point they met; where the root is in the world is taken from the trajectory that the feet are constrained for. The preset
    ``quick`` in addition works at 30 frames a second, starts at the content, takes the style of several clips and
    adds what the descent changed to the source (``residual``); ``paper`` does none of these.

    Parameters
    ----------
    preset
        ``smoke``, ``quick`` or ``paper``: where every keyword that is ``None`` comes from.
    fps
        Frame rate that it works at.
    seconds
        Length of the windows for training; they overlap by half.
    filters, width
        Of both convolutions: how many, and how many frames each spans (odd).
    dropout
        Share of inputs and of hidden units dropped in training.
    sparsity
        Weight of the mean magnitude of the weights in the loss.
    epochs, batch, lr
        Passes over the windows, windows per step, and Adam's learning rate.
    style_weight, content_weight
        s and c of the objective.
    start
        ``content``, or ``noise``: hidden units of white noise, as in the paper.
    iterations, step
        Of the descent to the style: how many, and Adam's learning rate.
    exemplars
        How many clips the Gram matrix is averaged over.
    residual
        Whether to add what the descent changes to the source's own channels, so that what the autoencoder cannot reproduce is
        kept, instead of taking all channels from the decoder.
    constraint_iterations, constraint_step
        Of the descent onto the constraints; 0 iterations switches it off.
    bone_weight, trajectory_weight, foot_weight
        Of the three constraints.
    """

    info = MethodInfo(
        name="holden",
        summary="convolutional autoencoder, style by Gram matrices of hidden units",
        capabilities=Capabilities(
            supervision=Supervision.UNPAIRED,
            representation=("positions",),
            output="positions",
            device="gpu_preferred",
            stochastic_fit=True,
        ),
        citation="Holden, Saito & Komura 2016",
        code_deps=(
            "methods.clips",
            "methods.holden",
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
        epochs: int | None = None,
        batch: int | None = None,
        lr: float | None = None,
        style_weight: float | None = None,
        content_weight: float | None = None,
        start: str | None = None,
        iterations: int | None = None,
        step: float | None = None,
        exemplars: int | None = None,
        residual: bool | None = None,
        constraint_iterations: int | None = None,
        constraint_step: float | None = None,
        bone_weight: float | None = None,
        trajectory_weight: float | None = None,
        foot_weight: float | None = None,
    ) -> None:
        self.preset = preset
        self.fps = fps
        self.seconds = seconds
        self.filters = filters
        self.width = width
        self.dropout = dropout
        self.sparsity = sparsity
        self.epochs = epochs
        self.batch = batch
        self.lr = lr
        self.style_weight = style_weight
        self.content_weight = content_weight
        self.start = start
        self.iterations = iterations
        self.step = step
        self.exemplars = exemplars
        self.residual = residual
        self.constraint_iterations = constraint_iterations
        self.constraint_step = constraint_step
        self.bone_weight = bone_weight
        self.trajectory_weight = trajectory_weight
        self.foot_weight = foot_weight

    @classmethod
    def test_params(cls) -> list[dict[str, Any]]:
        """The small preset, and with it the paper's way of transfer."""
        return [{"preset": "smoke"}, {"preset": "smoke", "start": "noise", "residual": False, "exemplars": 1}]

    def fit(self, train: TrainView, task: StyleTask, *, rng: np.random.Generator, ctx: FitContext) -> Self:
        """Train the autoencoder on the clips of both styles."""
        from methods._torch.device import device_for, isolated_random
        from methods._torch.word_bank import WordBank
        from methods.holden import corpus
        from methods.holden.channels import Layout, Scaling
        from methods.holden.network import Autoencoder
        from methods.holden.training import train_autoencoder

        self.settings_ = self._settings()
        sources, targets = training_clips("holden", train, task)
        self.body_ = task.target_skeleton or targets[0].skeleton
        self.layout_ = Layout.of(self.body_)
        arrays = corpus.read_channels([*sources, *targets], self.body_, self.layout_, self.settings_["fps"], ctx.report)
        self.scaling_ = Scaling.fit(self.layout_, arrays)
        arrays = [self.scaling_.apply(array) for array in arrays]
        self.examples_ = corpus.make_examples(targets, arrays[len(sources) :])

        device = device_for(ctx.device)
        length = self._window()
        bank = WordBank(arrays, length, length // 2, device=device)
        with isolated_random(rng):
            network = Autoencoder(self.layout_.dim, self.settings_["filters"], self.settings_["width"])
        self.network_ = network.to(device)
        self.noise_seed_ = int(rng.integers(2**31))
        chosen = self.settings_
        self.history_ = train_autoencoder(
            self.network_,
            bank,
            **{key: chosen[key] for key in ("epochs", "batch", "lr", "dropout", "sparsity")},
            rng=rng,
            ctx=ctx,
            name="holden",
        )
        self.network_.requires_grad_(False)
        return self

    def transfer(self, source: MotionClip, task: StyleTask, *, rng: np.random.Generator) -> TransferResult:
        """Give ``source`` the style, on ``task.target_skeleton``, at its own frame rate and length."""
        from benchmark.motion.resample import resample
        from benchmark.motion.retarget import retarget
        from methods.holden.corpus import choose_examples, resampled

        skeleton = source.skeleton if task.target_skeleton is None else task.target_skeleton
        own = retarget(source, self.body_)
        given = self.layout_.encode(own)
        work = resample(own, self.settings_["fps"])
        if len(work) < 2:
            work = own
        low = self.scaling_.apply(given if work is own else self.layout_.encode(work))
        numbers, known = choose_examples(self.examples_, source, self.settings_["exemplars"])
        chosen = [self.examples_[number] for number in numbers]
        out, ratio = self._stylised(low, chosen)

        spread = resampled(out - low if self.settings_["residual"] else out, work.times, source.times)
        if self.settings_["residual"]:
            values = self.scaling_.invert(self.scaling_.apply(given) + spread)
        else:
            values = self.scaling_.invert(spread)
        velocity = self.layout_.velocity
        values[:, velocity] = given[:, velocity] * [ratio, ratio, 1.0]
        posed = self.layout_.decode(values, own)
        result = posed if skeleton == self.body_ else retarget(posed, skeleton)
        diagnostics = {
            "exemplars": [example.clip_id for example in chosen],
            "action_in_training": known,
            "speed_ratio": ratio,
        }
        return TransferResult(result, diagnostics=diagnostics)

    def save(self, folder: Path) -> None:
        """Write weights, statistics and the target style's clips as safetensors, and the loss curve."""
        from methods._torch.weights import write_tensors
        from methods.holden import corpus

        facts = {
            "params": self.params(),
            "settings": self.settings_,
            "noise_seed": self.noise_seed_,
            "examples": corpus.names_of(self.examples_),
        }
        tensors = {f"network/{name}": value for name, value in self.network_.state_dict().items()}
        tensors |= corpus.to_tensors(self.scaling_, self.examples_)
        write_tensors(folder / "holden.safetensors", tensors, facts)
        corpus.save_body(self.body_, self.settings_["fps"], folder)
        self.history_.save(folder / "train.parquet")

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read what :meth:`save` wrote."""
        from methods._torch.history import History
        from methods._torch.weights import read_tensors, under
        from methods.holden import corpus
        from methods.holden.channels import Layout
        from methods.holden.network import Autoencoder

        tensors, facts = read_tensors(folder / "holden.safetensors")
        method = cls(**facts["params"])
        method.settings_ = facts["settings"]
        method.noise_seed_ = facts["noise_seed"]
        method.body_ = corpus.load_body(folder)
        method.layout_ = Layout.of(method.body_)
        method.scaling_, method.examples_ = corpus.from_tensors(tensors, facts["examples"])
        method.network_ = Autoencoder(method.layout_.dim, method.settings_["filters"], method.settings_["width"])
        method.network_.load_state_dict(under(tensors, "network/"))
        method.network_.requires_grad_(False)
        method.history_ = History()
        return method

    def _settings(self) -> dict[str, Any]:
        given = self.params()
        settings = resolve("methods.holden", given.pop("preset"), given)
        if settings["start"] not in ("content", "noise"):
            raise ConfigError(f"holden: start must be 'content' or 'noise', not {settings['start']!r}")
        if settings["width"] % 2 == 0:
            raise ConfigError(f"holden: width must be odd, not {settings['width']}: filters are centred on a frame")
        if not 0 <= settings["dropout"] < 1:
            raise ConfigError(f"holden: dropout must be at least 0 and below 1, not {settings['dropout']}")
        for name in (
            "fps",
            "seconds",
            "filters",
            "width",
            "epochs",
            "batch",
            "lr",
            "step",
            "exemplars",
            "constraint_step",
        ):
            if not settings[name] > 0:
                raise ConfigError(f"holden: {name} must be above 0, not {settings[name]}")
        weights = ("sparsity", "style_weight", "content_weight", "bone_weight", "trajectory_weight", "foot_weight")
        for name in (*weights, "iterations", "constraint_iterations"):
            if not settings[name] >= 0:
                raise ConfigError(f"holden: {name} must not be negative, and it is {settings[name]}")
        if settings["style_weight"] + settings["content_weight"] == 0:
            raise ConfigError("holden: style_weight and content_weight are both 0: there is nothing to descend to")
        return settings

    def _window(self) -> int:
        """Frames of a training window, even because the encoder halves them."""
        return 2 * max(1, round(0.5 * self.settings_["seconds"] * self.settings_["fps"]))

    def _stylised(self, values: Array, examples: Sequence[Example]) -> tuple[Array, float]:
        """Normalised channels (T, D) in the style of ``examples``, and by how much the root's speed is scaled."""
        import torch

        from methods.holden.descent import descend, style_objective

        settings, network = self.settings_, self.network_
        inner = self._margin() // 2
        with torch.no_grad():
            style = torch.stack([self._gram(example.channels) for example in examples]).mean(dim=0)
            content = network.encode(self._padded(values))
            if settings["start"] == "noise":
                generator = torch.Generator().manual_seed(self.noise_seed_)
                shape = (1, self.layout_.dim, 2 * content.shape[-1])
                start = network.encode(torch.randn(shape, generator=generator).to(content))
            else:
                start = content
        kept = slice(inner, content.shape[-1] - inner)
        hidden = descend(
            lambda h: style_objective(
                h,
                content,
                style,
                style_weight=settings["style_weight"],
                content_weight=settings["content_weight"],
                inner=kept,
            ),
            start,
            iterations=settings["iterations"],
            step=settings["step"],
        )
        with torch.no_grad():
            offset = self._padded(values) - network.decode(content) if settings["residual"] else 0.0
            drawn = self._cropped(network.decode(hidden) + offset, len(values))
        ratio = self._speed_ratio(values, drawn)
        if settings["constraint_iterations"]:
            hidden = self._constrained(hidden, offset, values, ratio)
            with torch.no_grad():
                drawn = self._cropped(network.decode(hidden) + offset, len(values))
        return drawn, ratio

    def _constrained(self, hidden: Tensor, offset: Tensor | float, values: Array, ratio: float) -> Tensor:
        """Hidden units from which bones, trajectory and feet come out as they should."""
        import torch

        from methods.holden.descent import Constraints, descend

        settings, layout, network = self.settings_, self.layout_, self.network_

        def tensor(array: Array) -> Tensor:
            return torch.as_tensor(array, dtype=hidden.dtype, device=hidden.device)

        # Padded frames obey as the first and last do; they are cut off in the end.
        target = self.scaling_.invert(np.pad(values, self._pads(len(values)), mode="edge")).T[None]
        skeleton = self.body_
        constraints = Constraints(
            parents=torch.as_tensor(np.array(skeleton.parents), device=hidden.device),
            lengths=tensor(skeleton.bone_lengths / skeleton.leg_length),
            feet=torch.as_tensor(layout.feet, device=hidden.device),
            contacts=(tensor(target[:, layout.contacts]) > 0.5).to(hidden.dtype),
            velocity=tensor(target[:, layout.velocity] * np.array([ratio, ratio, 1.0])[:, None]),
            fps=settings["fps"],
            weights=(settings["bone_weight"], settings["trajectory_weight"], settings["foot_weight"]),
        )
        scale, mean = tensor(self.scaling_.scale[:, None]), tensor(self.scaling_.offset[:, None])
        return descend(
            lambda h: constraints.objective((network.decode(h) + offset) * scale + mean),
            hidden,
            iterations=settings["constraint_iterations"],
            step=settings["constraint_step"],
        )

    def _speed_ratio(self, content: Array, drawn: Array) -> float:
        """Mean speed of the root after over before, held within :data:`SPEED_LIMITS`; 1 for a root that stands."""
        columns = slice(self.layout_.velocity.start, self.layout_.velocity.start + 2)
        before, after = (
            float(np.linalg.norm(self.scaling_.invert(values)[:, columns], axis=1).mean())
            for values in (content, drawn)
        )
        return 1.0 if before < STANDING_SPEED else float(np.clip(after / before, *SPEED_LIMITS))

    def _margin(self) -> int:
        """Frames of padding on either side, even, over which the zeros beyond the ends are out of the filters' reach."""
        return 2 * self.settings_["width"]

    def _pads(self, frames: int) -> tuple[tuple[int, int], tuple[int, int]]:
        return (self._margin(), self._margin() + frames % 2), (0, 0)

    def _padded(self, values: Array | NDArray[np.float32]) -> Tensor:
        """(1, D, T') on the network's device, first and last frame held, T' even."""
        import torch

        padded = np.pad(values, self._pads(len(values)), mode="edge")
        weight = self.network_.encoder.weight
        return torch.as_tensor(padded.T[None].copy(), dtype=weight.dtype, device=weight.device)

    def _cropped(self, values: Tensor, frames: int) -> Array:
        """(T, D) of what was :meth:`_padded`."""
        margin = self._margin()
        return values[0, :, margin : margin + frames].T.cpu().numpy().astype(np.float64)

    def _gram(self, channels: NDArray[np.float32]) -> Tensor:
        from methods.holden.descent import gram

        hidden = self.network_.encode(self._padded(channels))
        inner = self._margin() // 2
        return gram(hidden[..., inner : hidden.shape[-1] - inner])[0]
