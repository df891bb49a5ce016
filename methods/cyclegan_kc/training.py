"""Pairs of training words, and one update of generator and discriminator. Importing this imports torch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.optim import Adam, Optimizer

from methods._torch.train import Batch
from methods._torch.word_bank import WordBank
from methods.cyclegan_kc.losses import TERMS, Kinematics, cycle_loss, generator_loss, judge_loss, style_loss
from methods.cyclegan_kc.network import Discriminator, Generator, Style, halved, statistics

#: Adam's beta_1 in adversarial training, as is usual since Radford et al. 2016; the paper does not say.
_BETAS = (0.5, 0.999)


class PairSampler:
    """For each word of a content, a word of the style from a clip of the same action.

    Words of the content come in turns, clips of the style with equal chances. Contents of actions that the style lacks are left
    out, unless the styles share none: then any clip will do.

    Parameters
    ----------
    clip
        (N,) the clip of each word.
    actions
        Of each clip.
    sources
        How many clips, from the first, are content; the others are of the style.
    """

    def __init__(self, clip: NDArray[np.int64], actions: Sequence[str], sources: int) -> None:
        words = [np.flatnonzero(clip == number) for number in range(len(actions))]
        shared = set(actions[:sources]) & set(actions[sources:])
        self.conditional = bool(shared)
        self._content = np.concatenate(
            [words[number] for number in range(sources) if not shared or actions[number] in shared]
        )
        names = [actions[number] if shared else "" for number in range(len(actions))]
        self._style = {
            name: [words[number] for number in range(sources, len(actions)) if names[number] == name]
            for name in set(names[sources:])
        }
        self._names = [names[number] for number in clip]

    def __len__(self) -> int:
        """Words of contents."""
        return len(self._content)

    def draw(self, count: int, rng: np.random.Generator) -> NDArray[np.int64]:
        """(count, 2) numbers of words, content first."""
        rounds = -(-count // len(self._content))
        content = np.concatenate([rng.permutation(self._content) for _ in range(rounds)])[:count]
        style = np.empty_like(content)
        for row, word in enumerate(content):
            clips = self._style[self._names[word]]
            chosen = clips[int(rng.random() * len(clips))]
            style[row] = chosen[int(rng.random() * len(chosen))]
        return np.stack([content, style], axis=1)


@dataclass(frozen=True)
class Weights:
    """Of the terms of equation 14; those within the kinematic term are in :class:`~methods.cyclegan_kc.losses.Kinematics`."""

    gan: float
    style: float
    cycle: float
    kinematic: float


class KinematicCycleStep:
    """Generator, discriminator, their optimisers, and an update of both on a batch of pairs.

    Parameters
    ----------
    generator, judge
        The networks.
    bank
        Training words, normalised channels.
    kinematics
        Equations 10 to 13.
    weights
        Of the terms of equation 14.
    gan
        One of :data:`methods.cyclegan_kc.losses.GANS`.
    symmetric
        Whether the cycle also begins at the style's words.
    dropout
        Share of its inputs that the discriminator drops.
    lr, lr_judge
        Of Adam.
    """

    def __init__(
        self,
        generator: Generator,
        judge: Discriminator,
        bank: WordBank,
        *,
        kinematics: Kinematics,
        weights: Weights,
        gan: str,
        symmetric: bool,
        dropout: float,
        lr: float,
        lr_judge: float,
    ) -> None:
        self.generator, self.judge, self.bank = generator, judge, bank
        self.kinematics, self.weights, self.gan = kinematics, weights, gan
        self.symmetric, self.dropout = symmetric, dropout
        # Hidden units as pre-trained are what style is measured in: in those being trained it could be met by forgetting.
        self.measure = deepcopy(generator.autoencoder).requires_grad_(False)
        trained = [*judge.parameters(), *(each for module in judge.shared for each in module.parameters())]
        self.optimizers: dict[str, Optimizer] = {
            "generator": Adam(generator.parameters(), lr=lr, betas=_BETAS),
            "discriminator": Adam(trained, lr=lr_judge, betas=_BETAS),
        }

    @property
    def states(self) -> dict[str, nn.Module]:
        """All that changes in training."""
        return {"generator": self.generator, "discriminator": self.judge}

    def __call__(self, batch: Batch) -> Mapping[str, Tensor]:
        """Update the generator, then the discriminator, on the pairs ``batch.index`` (B, 2)."""
        content, style = (self.bank.words(batch.index[:, side]).transpose(1, 2) for side in (0, 1))
        valid, there = (self.bank.mask(batch.index[:, side]) for side in (0, 1))
        self.judge.requires_grad_(False)
        with batch.autocast():
            made, losses = self.losses(content, valid, style, there, batch.generator)
            total = self.total(losses)
        self._descend("generator", total)
        self.judge.requires_grad_(True)
        with batch.autocast():
            losses["judge"] = judge_loss(
                self._judged(style, there, batch.generator),
                self._judged(made.detach(), valid, batch.generator),
                self.gan,
            )
        if self.weights.gan:
            self._descend("discriminator", losses["judge"])
        return {name: value.detach() for name, value in losses.items()}

    def losses(
        self, content: Tensor, valid: Tensor, style: Tensor, there: Tensor, generator: torch.Generator
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """The generated motions (B, D, T) and the terms of equation 14 without their weights."""
        net, counted, elsewhere = self.generator, halved(valid), halved(there)
        hidden, other = net.encode(torch.cat((content, style))).chunk(2)
        own, wanted = statistics(hidden, counted), statistics(other, elsewhere)
        made = net.decode(net.stylise(hidden, counted, own, wanted), content, hidden)
        back = self._again(made, valid, own)
        losses = {"cycle": cycle_loss(back, content, valid)}
        if self.symmetric:
            across = net.decode(net.stylise(other, elsewhere, wanted, own), style, other)
            losses["cycle"] = losses["cycle"] + cycle_loss(self._again(across, there, wanted), style, there)
        with torch.no_grad():
            gram = statistics(self.measure.encode(style), elsewhere).gram
        losses["style"] = style_loss(statistics(self.measure.encode(made), counted).gram, gram)
        losses["gan"] = generator_loss(self._judged(made, valid, generator), self.gan)
        return made, losses | self.kinematics.terms(made, content, valid)

    def total(self, losses: Mapping[str, Tensor]) -> Tensor:
        """Equation 14, weighted."""
        weights = self.weights
        value = weights.gan * losses["gan"] + weights.style * losses["style"] + weights.cycle * losses["cycle"]
        for name, weight in zip(TERMS, self.kinematics.weights, strict=True):
            if name in losses:
                value = value + weights.kinematic * weight * losses[name]
        return value

    def _again(self, made: Tensor, valid: Tensor, style: Style) -> Tensor:
        return self.generator(made, valid, style)

    def _judged(self, x: Tensor, valid: Tensor, generator: torch.Generator) -> Tensor:
        """Logits of the motions, or of their hidden frames that count, in a row."""
        logits: Tensor = self.judge(x, valid, self.dropout, generator)
        return logits[:, 0] if logits.shape[1] == 1 else logits[halved(valid) > 0]

    def _descend(self, name: str, loss: Tensor) -> None:
        optimizer = self.optimizers[name]
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        optimizer.step()
