"""Training the CycleGAN on motion words, beside the same network written down plainly; and transfer against real time."""

from __future__ import annotations

import copy
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
from timing import Job, collect, interleaved, rows
from torch import Tensor, nn

from benchmark.api import FitContext, StyleTask
from benchmark.commands.conformance.figures import ADULT, CHILD, perform, small_view, walk
from methods.cyclegan.discriminator import Discriminator
from methods.cyclegan.generator import JointConv, make_generator
from methods.cyclegan.literal import LiteralTrunk
from methods.cyclegan.losses import coherence_loss, cycle_loss, discriminator_loss, generator_loss
from methods.cyclegan.method import CycleGan
from methods.cyclegan.training import CycleGanStep, Weights

FRAMES = 60
#: Frames of noise that words are taken from.
KEPT = 1000
#: Passes of forward and backward through a generator and a discriminator per pair, both generators updated at once: four
#: forward passes with two products backward each; two discriminators on two words with their weights' gradients, and on one
#: without.
GENERATOR_PASSES, JUDGE_PASSES = 12, 16
#: Side of the matrices whose product is the yardstick.
SQUARE = 1024


class RandomWords:
    """Random unit quaternions in the place of a domain's words; drawn before, so that nobody is timed drawing them."""

    def __init__(self, joints: int, dtype: torch.dtype = torch.float32) -> None:
        generator = torch.Generator().manual_seed(joints)
        self.frames = nn.functional.normalize(torch.randn(joints, 4, KEPT, generator=generator), dim=1).to(dtype)
        self.rows = torch.arange(FRAMES)
        self.turn = 0

    def words(self, numbers: Any) -> Tensor:
        """(J, 4, T, B), others each time."""
        starts = (torch.arange(len(numbers)) + self.turn) % (KEPT - FRAMES)
        self.turn += len(numbers)
        return self.frames[:, :, starts + self.rows[:, None]]


class Case:
    """The paper's networks at one size, all contestants starting from the same weights."""

    dtype = torch.float32

    def __init__(self, joints: int, width: int, blocks: int, judge_width: int, batch: int) -> None:
        self.joints, self.width, self.blocks, self.batch = joints, width, blocks, batch
        self.judge_widths = [judge_width * factor for factor in (1, 2, 4, 8)]

    def networks(self) -> list[Any]:
        seeds = torch.Generator().manual_seed(0)
        networks: list[Any] = [make_generator(self.joints, width=self.width, blocks=self.blocks) for _ in range(2)]
        networks += [Discriminator(self.joints, widths=self.judge_widths) for _ in range(2)]
        for network in networks:
            network.reset(seeds)
            network.to(self.dtype)
        return networks

    def ours(self, batch: int, order: str) -> Job:
        """The update that training does."""
        step = CycleGanStep(
            *self.networks(), *(RandomWords(self.joints, self.dtype) for _ in range(2)), weights=Weights(), order=order
        )
        item = SimpleNamespace(index=np.zeros((batch, 2), dtype=np.int64), generator=torch.Generator().manual_seed(1))
        return lambda: {name: float(value.detach()) for name, value in step(item).items()}

    def plain(self, batch: int) -> Job:
        """The same update in the paper's order, every pass by itself, from textbook modules."""
        forth, back, judge_a, judge_c = self.networks()
        trunks = [LiteralTrunk(network.trunk) for network in (forth, back)]
        judges = [_textbook(judge) for judge in (judge_a, judge_c)]
        optimizers = [
            torch.optim.Adam(network.parameters(), lr=2e-4, betas=(0.5, 0.999)) for network in trunks + judges
        ]
        sources = [RandomWords(self.joints, self.dtype) for _ in range(2)]

        def generate(trunk: nn.Module, x: Tensor) -> Tensor:
            out = torch.tanh(trunk(x)).unflatten(1, (self.joints, 4))
            return nn.functional.normalize(out, dim=2, eps=1e-8).flatten(1, 2)

        def layout(x: Tensor) -> Tensor:
            """(J, 4, T, B) as the losses take it."""
            return x.unflatten(1, (self.joints, 4)).permute(1, 2, 3, 0)

        def job() -> dict[str, float]:
            a, c = (source.words(range(batch)).permute(3, 0, 1, 2).flatten(1, 2) for source in sources)
            losses = {"adversarial": 0.0, "cycle": 0.0, "coherence": 0.0}
            for own, other, judge, word, real, name in ((0, 1, 1, a, c, "d_target"), (1, 0, 0, c, a, "d_source")):
                fake = generate(trunks[own], word)
                parts = {
                    "adversarial": generator_loss(judges[judge](fake)),
                    "cycle": cycle_loss(generate(trunks[other], fake), word)
                    + cycle_loss(generate(trunks[own], generate(trunks[other], real).detach()), real),
                    "coherence": coherence_loss(layout(fake)),
                }
                total = parts["adversarial"] + 15.0 * parts["cycle"] + 30.0 * parts["coherence"]
                optimizers[own].zero_grad()
                total.backward()
                optimizers[own].step()
                found = discriminator_loss(judges[judge](real), judges[judge](fake.detach()))
                optimizers[2 + judge].zero_grad()
                found.backward()
                optimizers[2 + judge].step()
                losses[name] = float(found.detach())
                for key, value in parts.items():
                    losses[key] += float(value.detach()) * (0.5 if key == "cycle" else 1.0)
            return losses

        return job

    def check(self, job: Job | None = None) -> None:
        """Hold four plain updates, or those of ``job``, to the losses of ours, batch 1.

        In double precision: Adam makes steps of full length of gradients that are nothing but rounding, and in single precision
        there are enough of them for weights to part soon.
        """
        double = copy.copy(self)
        double.dtype = torch.float64
        ours, plain = double.ours(1, "sequential"), job or double.plain(1)
        for _ in range(4):
            expected, got = ours(), plain()
            for name, value in expected.items():  # type: ignore[attr-defined]
                if not np.isclose(got[name], value, rtol=1e-5, atol=1e-9):  # type: ignore[index]
                    raise ValueError(f"its loss {name} is {got[name]:.6g}, not {value:.6g}")  # type: ignore[index]

    def flops(self) -> float:
        """Arithmetic of the convolutions for one pair of words."""
        generator, _, judge, _ = self.networks()
        return 2.0 * (GENERATOR_PASSES * _products(generator) + JUDGE_PASSES * _products(judge))


def _textbook(judge: Discriminator) -> nn.Module:
    """A copy of the discriminator in torch's own layout."""
    layers: list[nn.Module] = []
    for conv in judge.layers:
        assert isinstance(conv, JointConv)
        layer, weight = conv.layer, conv.weight[:, 0].permute(1, 2, 0)
        plain = nn.Conv1d(*weight.shape[1::-1], layer.taps, stride=layer.stride, padding=layer.pad, bias=not layer.norm)
        plain = plain.to(weight.dtype)
        with torch.no_grad():
            plain.weight.copy_(weight)
            if plain.bias is not None:
                plain.bias.copy_(conv.bias[0])
        layers.append(plain)
        if layer.norm:
            layers.append(nn.InstanceNorm1d(len(weight), affine=True, dtype=weight.dtype))
        if layer.slope != 1.0:
            layers.append(nn.LeakyReLU(layer.slope))
    return nn.Sequential(*layers)


def _products(network: nn.Module) -> int:
    """Multiplications in the convolutions of a forward pass of one word."""
    total, frames = 0, FRAMES
    for conv in network.modules():
        if isinstance(conv, JointConv):
            rows = conv.layer.rows(frames)
            total += conv.weight.numel() * rows
            frames = conv.layer.pieces * rows
    return total


def _plain(batch: int) -> Callable[[Case], Job]:
    def build(case: Case) -> Job:
        if batch == 1:
            case.check()
        return case.plain(batch)

    return build


def _transfer(width: int, blocks: int, seconds: float) -> Job:
    """Transfer of one walk; what is learned does not change the time, so next to nothing is."""
    body = perform("walk", CHILD, 1).skeleton
    method = CycleGan(preset="smoke", width=width, blocks=blocks, epochs=1, pairs=1, batch=1)
    task = StyleTask(ADULT, CHILD, body)
    method.fit(small_view(), task, rng=np.random.default_rng(0), ctx=FitContext())
    clip = walk(perform("walk", ADULT, 1).skeleton, seconds=seconds)
    return lambda: method.transfer(clip, task, rng=np.random.default_rng(0))


def run(
    console: Any,
    *,
    joints: int = 25,
    width: int = 8,
    blocks: int = 9,
    judge_width: int = 64,
    batch: int = 16,
    repeats: int = 5,
    seconds: float = 20.0,
) -> list[dict[str, Any]]:
    """Time updates at the paper's size, ``batch`` pairs and twice as many against one; and transfers of ``seconds``."""
    case = Case(joints, width, blocks, judge_width, batch)
    side = torch.randn(SQUARE, SQUARE)
    jobs, missing = collect(
        {"plain, batch 1": _plain(1), f"plain at batch {batch}": _plain(batch)}, case, console=console
    )
    named: dict[str, tuple[int, Job]] = {
        "ours": (batch, case.ours(batch, "joint")),
        f"ours, batch {2 * batch}": (2 * batch, case.ours(2 * batch, "joint")),
        f"ours, batch {batch}, the paper's order": (batch, case.ours(batch, "sequential")),
        "ours, batch 1, the paper's order": (1, case.ours(1, "sequential")),
        **{name: (1 if name == "plain, batch 1" else batch, job) for name, job in jobs.items()},
        "product": (1, lambda: side @ side),
    }
    taken = interleaved({name: job for name, (_, job) in named.items()}, repeats=repeats)
    per_pair = {name: value / named[name][0] for name, value in taken.items()}
    # The convolutions' arithmetic at the pace of one large matrix product.
    product = per_pair.pop("product")
    per_pair["ours, were it one large matrix product"] = product * case.flops() / (2.0 * SQUARE**3)
    task = f"CycleGAN training, {joints} joints"
    result = rows(task, per_pair, missing, work=1.0, unit="pairs/s")
    spent = interleaved({"ours": _transfer(width, blocks, seconds)}, repeats=repeats)
    result += rows("CycleGAN transfer", spent, {}, work=seconds, unit="times real time")
    return result
