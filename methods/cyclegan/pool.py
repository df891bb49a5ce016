"""A pool of words generated earlier, for the discriminators."""

from __future__ import annotations

import torch
from torch import Tensor


class ReplayPool:
    """Shows a discriminator past generated words half of the time (Shrivastava et al. 2017; Zhu et al. 2017, 50 images).

    Until it is full every word is kept and passed on. Then each word is passed on with probability one half; otherwise it takes
    the place of a random kept one, which is passed on instead.

    Parameters
    ----------
    shape
        (J, 4, T) of a word.
    size
        Words kept; 0 passes everything on.
    device
        Of the words.
    """

    def __init__(self, shape: tuple[int, ...], size: int = 50, *, device: torch.device | str = "cpu") -> None:
        self.size = size
        self.kept = torch.zeros((*shape, size), device=device)
        self.held = 0

    def exchange(self, words: Tensor, generator: torch.Generator) -> Tensor:
        """Generated words (J, 4, T, B), detached, to the words (J, 4, T, B) to show."""
        if self.size == 0:
            return words
        parts = [self._exchange(part, generator) for part in words.split(self.size, dim=-1)]
        return parts[0] if len(parts) == 1 else torch.cat(parts, dim=-1)

    def state_dict(self) -> dict[str, Tensor]:
        """What is kept, for a checkpoint."""
        return {"kept": self.kept, "held": torch.tensor(self.held)}

    def load_state_dict(self, state_dict: dict[str, Tensor]) -> None:
        """Take over a state."""
        self.kept.copy_(state_dict["kept"])
        self.held = int(state_dict["held"])

    def _exchange(self, words: Tensor, generator: torch.Generator) -> Tensor:
        """At most ``size`` words, each of which meets a slot of its own."""
        fresh = min(words.shape[-1], self.size - self.held)
        self.kept[..., self.held : self.held + fresh] = words[..., :fresh]
        full = self.held == self.size
        self.held += fresh
        if not full:
            return words
        count = words.shape[-1]
        swapped = torch.rand(count, generator=generator, device=generator.device) < 0.5
        slots = torch.randperm(self.size, generator=generator, device=generator.device)[:count]
        past = self.kept[..., slots]
        self.kept[..., slots] = torch.where(swapped, words, past)
        return torch.where(swapped, past, words)
