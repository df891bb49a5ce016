"""One update of both generators and both discriminators, for the training loop of :mod:`methods._torch.train`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import chain

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.optim import Adam, Optimizer

from methods._torch.train import Batch
from methods.cyclegan.discriminator import Discriminator
from methods.cyclegan.generator import Generator
from methods.cyclegan.losses import (
    coherence_loss,
    cycle_loss,
    discriminator_loss,
    generator_loss,
    transition_loss,
)
from methods.cyclegan.pool import ReplayPool
from methods.cyclegan.words import Domain

#: ``sequential``: G_a2c, D_c, G_c2a, D_a one after another, as in the paper; ``joint``: both generators at once, then both
#: discriminators, as in Zhu's code, which needs half of the forward passes.
ORDERS = ("sequential", "joint")


class WordTable:
    """The words of a domain as tensors (J, 4, T, B), gathered from its frames when asked for."""

    def __init__(self, domain: Domain, device: torch.device | str = "cpu") -> None:
        self.frames = torch.as_tensor(domain.frames, device=device)
        self.starts = torch.as_tensor(domain.starts, device=device)
        self.yaw = torch.as_tensor(domain.yaw, dtype=torch.float32, device=device)
        self.flip = torch.as_tensor(domain.flip, dtype=torch.float32, device=device)
        self.rows = torch.arange(domain.length, device=device)
        self.scale = domain.scale

    def words(self, numbers: NDArray[np.int64] | Tensor) -> Tensor:
        """The words of those numbers (B,), headings taken out, scaled to [-1, 1]."""
        numbers = torch.as_tensor(numbers, device=self.frames.device)
        out = self.frames[:, :, self.starts[numbers] + self.rows[:, None]]
        half = -0.5 * self.yaw[numbers]
        cos, sin = torch.cos(half) * self.flip[numbers], torch.sin(half) * self.flip[numbers]
        w, x, y, z = out[0].clone()
        out[0, 0], out[0, 1] = cos * w - sin * y, cos * x + sin * z
        out[0, 2], out[0, 3] = cos * y + sin * w, cos * z - sin * x
        return out.sub_(self.scale.offset).div_(self.scale.scale)

    def moments(self, *, least: float = 0.02) -> tuple[Tensor, Tensor]:
        """Mean and standard deviation (J, 4) over all words; deviations of at least ``least``, two degrees: below is noise."""
        total = square = torch.zeros((), dtype=torch.float64, device=self.frames.device)
        numbers = torch.arange(len(self.starts), device=self.frames.device)
        # Not all words at once: overlapping, they take several times the memory of the clips.
        for part in numbers.split(256):
            words = self.words(part).double()
            total = total + words.sum(dim=(2, 3))
            square = square + words.square().sum(dim=(2, 3))
        count = len(numbers) * len(self.rows)
        mean = total / count
        spread = (square / count - mean.square()).clamp_min(0.0).sqrt().clamp_min(least)
        return mean.float(), spread.float()

    def turn(self, numbers: NDArray[np.int64]) -> Tensor:
        """(B,) radians from the heading of each word to that of the next one of its clip."""
        chosen = torch.as_tensor(numbers, device=self.frames.device)
        return self.yaw[chosen + 1] - self.yaw[chosen]


@dataclass(frozen=True)
class Weights:
    """Weights of the losses: the lambdas of eq. 11. The adversarial loss has 1.

    ``identity`` is the weight of Zhu's ``|G(b) - b|``, which the paper does not mention. ``coherence_mode`` is one of
    :data:`methods.cyclegan.losses.COHERENCES`.
    """

    cycle: float = 15.0
    coherence: float = 30.0
    transition: float = 0.0
    identity: float = 0.0
    coherence_mode: str = "absolute"


class CycleGanStep:
    """Generators ``forth`` (source to target) and ``back``, their discriminators, optimisers and replay pools, and an update.

    Parameters
    ----------
    forth, back
        Generators.
    judge_source, judge_target
        Discriminators of words of either domain.
    source, target
        Training words.
    weights
        Of the losses.
    order
        One of :data:`ORDERS`.
    hop
        Frames between neighbouring words, for the transition loss.
    pool
        Words in either replay pool.
    lr, lr_discriminator, betas
        Of Adam.
    """

    def __init__(
        self,
        forth: Generator,
        back: Generator,
        judge_source: Discriminator,
        judge_target: Discriminator,
        source: WordTable,
        target: WordTable,
        *,
        weights: Weights,
        order: str = "joint",
        hop: int = 20,
        pool: int = 50,
        lr: float = 2e-4,
        lr_discriminator: float = 2e-4,
        betas: tuple[float, float] = (0.5, 0.999),
    ) -> None:
        self.forth, self.back = forth, back
        self.judge_source, self.judge_target = judge_source, judge_target
        self.source, self.target = source, target
        self.weights, self.order, self.hop = weights, order, hop
        device = source.frames.device
        shape = (*source.frames.shape[:2], len(source.rows))
        self.pools = {name: ReplayPool(shape, pool, device=device) for name in ("source", "target")}

        def adam(rate: float, *modules: nn.Module) -> Optimizer:
            parameters = chain.from_iterable(module.parameters() for module in modules)
            return Adam(parameters, lr=rate, betas=betas, fused=True)

        self.optimizers: dict[str, Optimizer]
        if order == "joint":
            self.optimizers = {
                "generators": adam(lr, forth, back),
                "discriminators": adam(lr_discriminator, judge_source, judge_target),
            }
        else:
            self.optimizers = {
                "forth": adam(lr, forth),
                "back": adam(lr, back),
                "judge_source": adam(lr_discriminator, judge_source),
                "judge_target": adam(lr_discriminator, judge_target),
            }

    @property
    def states(self) -> dict[str, nn.Module | ReplayPool]:
        """All that changes in training, by name."""
        return {**self.modules, "pool_source": self.pools["source"], "pool_target": self.pools["target"]}

    @property
    def modules(self) -> dict[str, nn.Module]:
        """The networks."""
        return {
            "forth": self.forth,
            "back": self.back,
            "judge_source": self.judge_source,
            "judge_target": self.judge_target,
        }

    def __call__(self, batch: Batch) -> Mapping[str, Tensor]:
        """Update all four networks on the pairs ``batch.index`` (B, 2)."""
        a, c = self.source.words(batch.index[:, 0]), self.target.words(batch.index[:, 1])
        turns: tuple[Tensor, Tensor] | None = None
        if self.weights.transition:
            # Every word is followed by its neighbour: the second half of the batch.
            a = torch.cat((a, self.source.words(batch.index[:, 0] + 1)), dim=-1)
            c = torch.cat((c, self.target.words(batch.index[:, 1] + 1)), dim=-1)
            turns = self.source.turn(batch.index[:, 0]), self.target.turn(batch.index[:, 1])
        update = self._joint if self.order == "joint" else self._sequential
        return update(a, c, turns, batch.generator)

    def _joint(
        self, a: Tensor, c: Tensor, turns: tuple[Tensor, Tensor] | None, generator: torch.Generator
    ) -> Mapping[str, Tensor]:
        _learn(self.judge_source, self.judge_target, on=False)
        fake_c, fake_a = self.forth(a), self.back(c)
        losses = {
            "adversarial": generator_loss(self.judge_target(fake_c)) + generator_loss(self.judge_source(fake_a)),
            "cycle": cycle_loss(self.back(fake_c), a) + cycle_loss(self.forth(fake_a), c),
            **self._own(self.forth, a, fake_c, c, None if turns is None else turns[0]),
        }
        for name, value in self._own(self.back, c, fake_a, a, None if turns is None else turns[1]).items():
            losses[name] = losses[name] + value
        self._descend("generators", self._total(losses))
        _learn(self.judge_source, self.judge_target, on=True)
        d_target = self._judged("target", self.judge_target, c, fake_c.detach(), generator)
        d_source = self._judged("source", self.judge_source, a, fake_a.detach(), generator)
        self._descend("discriminators", d_target + d_source)
        return {**losses, "d_target": d_target, "d_source": d_source}

    def _sequential(
        self, a: Tensor, c: Tensor, turns: tuple[Tensor, Tensor] | None, generator: torch.Generator
    ) -> Mapping[str, Tensor]:
        sums: dict[str, Tensor] = {}
        sides = (
            ("forth", "judge_target", "target", self.forth, self.back, self.judge_target, a, c, 0),
            ("back", "judge_source", "source", self.back, self.forth, self.judge_source, c, a, 1),
        )
        for name, judge_name, domain, own, other, judge, word, real, turn in sides:
            _learn(other, judge, on=False)
            with torch.no_grad():
                across = other(real)
            fake = own(word)
            losses = {
                "adversarial": generator_loss(judge(fake)),
                "cycle": cycle_loss(other(fake), word) + cycle_loss(own(across), real),
                **self._own(own, word, fake, real, None if turns is None else turns[turn]),
            }
            self._descend(name, self._total(losses))
            _learn(other, judge, on=True)
            losses["cycle"] = 0.5 * losses["cycle"]
            losses[f"d_{domain}"] = self._judged(domain, judge, real, fake.detach(), generator)
            self._descend(judge_name, losses[f"d_{domain}"])
            for loss, value in losses.items():
                sums[loss] = sums[loss] + value.detach() if loss in sums else value.detach()
        return sums

    def _own(
        self, generator: Generator, word: Tensor, fake: Tensor, real: Tensor, turn: Tensor | None
    ) -> dict[str, Tensor]:
        """Losses of one generator by itself."""
        weights = self.weights
        losses = {"coherence": coherence_loss(fake, word, mode=weights.coherence_mode)}
        if turn is not None:
            quaternions = fake * generator.target[1] + generator.target[0]
            earlier, later = quaternions.chunk(2, dim=-1)
            losses["transition"] = transition_loss(earlier, later, hop=self.hop, yaw=turn)
        if weights.identity:
            # A word of the target, in the units that the generator takes.
            given = (real * generator.target[1] + generator.target[0] - generator.source[0]) / generator.source[1]
            losses["identity"] = cycle_loss(generator(given), real)
        return losses

    def _total(self, losses: Mapping[str, Tensor]) -> Tensor:
        weights = self.weights
        total = losses["adversarial"] + weights.cycle * losses["cycle"]
        for name in ("coherence", "transition", "identity"):
            if getattr(weights, name):
                total = total + getattr(weights, name) * losses[name]
        return total

    def _judged(
        self, domain: str, judge: Discriminator, real: Tensor, fake: Tensor, generator: torch.Generator
    ) -> Tensor:
        shown = self.pools[domain].exchange(fake, generator)
        # Norms are per word, so real and generated words can share a pass.
        on_real, on_fake = judge(torch.cat((real, shown), dim=-1)).chunk(2, dim=-1)
        return discriminator_loss(on_real, on_fake)

    def _descend(self, name: str, loss: Tensor) -> None:
        optimizer = self.optimizers[name]
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        optimizer.step()


def _learn(*modules: nn.Module, on: bool) -> None:
    for module in modules:
        module.requires_grad_(on)
