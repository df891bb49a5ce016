"""Training the autoencoder on words of motion."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from benchmark.api import FitContext

if TYPE_CHECKING:
    import torch

    from methods._torch.history import History
    from methods._torch.word_bank import WordBank
    from methods.holden.network import Autoencoder


def train_autoencoder(
    network: Autoencoder,
    bank: WordBank,
    *,
    epochs: int,
    batch: int,
    lr: float,
    dropout: float,
    sparsity: float,
    rng: np.random.Generator,
    ctx: FitContext,
    name: str,
) -> History:
    """Minimise the autoencoder's loss over all words by Adam, in place.

    Parameters
    ----------
    network
        On the device of ``bank``.
    bank
        Words of normalised channels.
    epochs, batch, lr
        Passes over all words, words in an update, and Adam's step.
    dropout, sparsity
        Share of inputs and of hidden units that are dropped, and weight of the filters' mean magnitude.
    ctx
        Where the state is kept for going on after an interruption, and whom progress is reported to.
    name
        Of that state.

    Returns
    -------
    History
        The loss at every update.
    """
    from torch.optim import Adam

    from methods._torch.train import Batch, Settings, train

    optimizer = Adam(network.parameters(), lr=lr)

    def step(drawn: Batch) -> dict[str, torch.Tensor]:
        words, valid = bank.words(drawn.index), bank.mask(drawn.index)
        with drawn.autocast():
            loss = network.loss(
                words.transpose(1, 2), valid, share=dropout, sparsity=sparsity, generator=drawn.generator
            )
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        optimizer.step()
        return {"loss": loss.detach()}

    return train(
        step,
        items=len(bank),
        states={"autoencoder": network},
        optimizers={"adam": optimizer},
        settings=Settings(epochs=epochs, batch=batch),
        rng=rng,
        device=bank.frames.device,
        folder=ctx.work_dir,
        name=name,
        report=ctx.report,
    )
