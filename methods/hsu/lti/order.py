"""Which orders to try, what to hold out, and how far off a simulated output is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from methods.hsu.lti.records import Records
from methods.hsu.lti.state_space import StateSpace

Array = NDArray[np.float64]

#: Highest order of the suite: that of Dong et al. (2018).
CAP = 40

_GRID = (0, 1, 2, 3, 4, 6, 8, 10, 15, 20, 30, 40)

#: Frames that the end of a single recording must have to serve as a held-out part.
_LEAST_TAIL = 12

#: Relative difference of errors that does not justify more states.
_TIE = 0.01

#: Held-out recordings from which a standard error can be told, and frames of a block where there are fewer.
ENOUGH, BLOCK = 5, 30


def order_grid(cap: int = CAP) -> tuple[int, ...]:
    """Orders to try: 0, a static gain, up to ``cap``."""
    return tuple(order for order in _GRID if order < cap) + (cap,)


@dataclass(frozen=True)
class Split:
    """What a model is fitted to and what it is judged by.

    Attributes
    ----------
    train
        Recordings for the fit.
    judged
        Recordings simulated for the judgement.
    skip
        Frames at the start of each judged recording that do not count, because the fit saw them.
    held_out
        Whether the judged frames are new to the fit.
    given
        Whether the caller gave them.
    """

    train: Records
    judged: Records
    skip: int
    held_out: bool
    given: bool = False


def split_off(records: Records, fraction: float) -> Split:
    """Hold out part of a record, the same part every time.

    Of several recordings every ``1 / fraction``-th is held out, at least one. Of one, the last ``fraction``: it is simulated
    from its start, so that the state at the seam is right, and only the tail counts. If the tail would be shorter than 12
    frames, or what is left than 48, nothing is held out, and orders are compared by the Bayesian information criterion instead.
    """
    count = len(records)
    if count > 1:
        held = max(1, round(fraction * count))
        # Evenly spread, and not the first, which callers tend to put their best recording at.
        places = sorted({min(count - 1, int((k + 0.5) * count / held)) for k in range(held)})
        rest = [index for index in range(count) if index not in places]
        return Split(records.chosen(rest), records.chosen(places), 0, True)
    frames = records.frames
    tail = round(fraction * frames)
    if tail < _LEAST_TAIL or frames - tail < 4 * _LEAST_TAIL:
        return Split(records, records, 0, False)
    head = Records([records.inputs[0][:-tail]], [records.outputs[0][:-tail]])
    return Split(head, records, frames - tail, True)


def simulation_error(model: StateSpace, records: Records, skip: int = 0) -> float:
    """Norm of (recorded - simulated output) over the norm of the recorded one, from rest; infinite if it overflows.

    Parameters
    ----------
    model
        The model.
    records
        Recordings.
    skip
        Frames at the start of each that do not count.
    """
    off, size = residual_energy(model, records, skip)
    if not np.isfinite(off):
        return float("inf")
    if size == 0.0:
        return float(np.sqrt(off))
    return float(np.sqrt(off / size))


def residual_energy(model: StateSpace, records: Records, skip: int = 0) -> tuple[float, float]:
    """Sum of squared differences, and of squared recorded values."""
    off, size = residual_energies(model, records, skip)
    return float(off.sum()), float(size.sum())


def residual_energies(
    model: StateSpace, records: Records, skip: int = 0, *, block: int | None = None
) -> tuple[Array, Array]:
    """Of each recording, or of each ``block`` of frames, the sum of squared differences, and of squared recorded values."""
    off: list[float] = []
    size: list[float] = []
    with np.errstate(over="ignore", invalid="ignore"):
        for y, simulated in zip(records.outputs, model.simulate_each(records.inputs), strict=True):
            length = max(1, len(y) - skip)
            starts = np.arange(skip, skip + length, length if block is None else block)
            for values, rows in ((off, (y - simulated) ** 2), (size, y**2)):
                # Frame by frame first: an overflow in one block must not spoil the sums of others.
                frames = rows.sum(axis=1)
                values += [float(frames[a:b].sum()) for a, b in zip(starts, [*starts[1:], len(y)], strict=True)]
    return np.array(off), np.array(size)


def information_criterion(model: StateSpace, records: Records) -> float:
    """BIC per output value of the simulated fit: ``log(mean square) + k log(N) / N`` with ``k = n (m + l) + l m``."""
    off, size = residual_energy(model, records)
    if not np.isfinite(off):
        return float("inf")
    m, p = records.channels
    count = records.frames * p
    free = model.order * (m + p) + p * m
    # Below the rounding of the outputs there is nothing to compare.
    floor = 1e-24 * (size if size > 0.0 else 1.0)
    return float(np.log(max(off, floor) / count) + free * np.log(count) / count)


def judge(model: StateSpace, split: Split) -> float:
    """The figure by which models are compared: held-out error, or BIC where nothing is held out."""
    if split.held_out:
        return simulation_error(model, split.judged, split.skip)
    return information_criterion(model, split.judged)


def pick(orders: Array, scores: Array, *, relative: bool, energies: Array | None = None) -> int:
    """Index of the candidate of lowest order that is not worse than the best, as far as one can tell.

    That is: no more than 1 % worse, or by no more than one standard error of the difference between the two over the held-out
    part (the one-standard-error rule of Breiman et al. 1984, on paired differences). Orders that only fit what these
    recordings have by chance are not worth their states.

    Parameters
    ----------
    orders, scores
        (K,) of the candidates.
    relative
        Whether scores are errors; if not (BIC, which may be negative), the best itself is taken.
    energies
        (K, R) squared errors of each candidate on each held-out recording, or, where these are few, on each second of them.
    """
    best = int(np.argmin(scores))
    if not np.isfinite(scores[best]):
        return int(np.argmin(orders))
    fit = np.asarray(scores <= (scores[best] * (1.0 + _TIE) if relative else scores[best]))
    if relative and energies is not None and energies.shape[1] >= ENOUGH:
        finite = np.asarray(np.isfinite(energies).all(axis=1))
        worse = np.where(finite[:, None], energies, 0.0) - energies[best]
        error = worse.std(axis=1, ddof=1) * np.sqrt(energies.shape[1])
        fit = fit | (finite & (worse.sum(axis=1) <= error))
    found = np.flatnonzero(fit)
    return int(found[np.lexsort((scores[found], orders[found]))[0]])
