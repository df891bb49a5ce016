"""Devices, precision and random numbers."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import numpy as np
import torch
from torch import Tensor

from benchmark.errors import ConfigError

PRECISIONS = ("auto", "float32", "bfloat16")


def device_for(name: str) -> torch.device:
    """The torch device of :attr:`benchmark.api.FitContext.device`; a ``ConfigError`` if it cannot be used here."""
    if name == "cuda" and not torch.cuda.is_available():
        raise ConfigError("the device 'cuda' was asked for, and torch sees no GPU here: use the device 'cpu'")
    return torch.device(name)


def low_precision(device: torch.device, precision: str = "auto") -> bool:
    """Whether to compute in bfloat16: ``auto`` does where it is faster, on GPUs that have it in hardware; CPUs never gain."""
    if precision not in PRECISIONS:
        raise ConfigError(f"precision must be one of {', '.join(PRECISIONS)}, not {precision!r}")
    return precision == "bfloat16" or (
        precision == "auto" and device.type == "cuda" and torch.cuda.is_bf16_supported(including_emulation=False)
    )


def torch_generator(rng: np.random.Generator, device: torch.device | str = "cpu") -> torch.Generator:
    """A torch generator seeded by a draw from ``rng``."""
    return torch.Generator(device).manual_seed(int(rng.integers(2**63)))


@contextlib.contextmanager
def isolated_random(rng: np.random.Generator) -> Iterator[None]:
    """Within, torch's global CPU generator is seeded by a draw from ``rng``; afterwards it is as it was.

    For what draws from the global generator alone: the constructors of ``torch.nn`` modules.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(int(rng.integers(2**63)))
        yield


def dropout(x: Tensor, share: float, generator: torch.Generator) -> Tensor:
    """``x`` with ``share`` of its elements, drawn from ``generator``, zero and the others scaled up to keep the mean."""
    if share == 0.0:
        return x
    keep = torch.rand(x.shape, generator=generator, device=x.device) >= share
    return x * keep / (1.0 - share)
