"""Identification from recordings to a stable model: method, order, stability and ridge, with what was found on the way."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import ContractError
from methods.hsu.lti.input_matrices import InputProblems, input_problem
from methods.hsu.lti.kernel_fir import kernel_fir
from methods.hsu.lti.order import (
    BLOCK,
    CAP,
    ENOUGH,
    Split,
    judge,
    order_grid,
    pick,
    residual_energies,
    simulation_error,
    split_off,
)
from methods.hsu.lti.realization import effective_order, realize
from methods.hsu.lti.records import (
    IdentificationWarning,
    RankDeficientWarning,
    Recordings,
    Records,
)
from methods.hsu.lti.refine import refine as refine_model
from methods.hsu.lti.stability import WAYS, calmed, longest_radius, output_normal, radius, stabilised
from methods.hsu.lti.state_space import StateSpace
from methods.hsu.lti.subspace import (
    TRANSITIONS,
    WEIGHTS,
    Subspace,
    choose_block_rows,
    identify_subspace,
    least_block_rows,
    usual_block_rows,
)

Array = NDArray[np.float64]

METHODS = ("subspace", "kernel-fir", "auto")

#: Ridges compared where one may be chosen by held-out error.
RIDGES = (0.0, 1e-4, 1e-2)

#: Ridges where none can be chosen so: of a rank-deficient record, and of one whose ``A`` had to be stabilised.
DEFICIENT_RIDGE, STABILISED_RIDGE = 1e-2, 1e-4


@dataclass(frozen=True)
class Identification:
    """A model and how it came about.

    Attributes
    ----------
    model
        The model, in the units of the data; its spectral radius is at most ``rho_max``.
    method
        ``subspace``, ``kernel-fir`` or ``static`` (order 0).
    order
        Order of ``model``.
    rank, rank_needed
        Numerical rank of the stacked block Hankel matrices of inputs and outputs, and ``2 i m + n`` for the order asked for;
        0 where no subspace method ran.
    block_rows
        ``i``; 0 where no subspace method ran.
    singular_values
        Those that order is read from: of the projected Hankel matrix, or of the Hankel matrix of the impulse response.
    spectral_radius_found
        Radius before stability was seen to.
    stabilised
        Whether it had to be.
    stabilised_by
        ``clip``, ``scale`` or an empty string.
    transition
        ``state``, ``shift`` or an empty string where no subspace method ran.
    ridge
        Share of the mean squared column that penalised ``B``.
    train_error
        Norm of the simulated error over the norm of the outputs, channels at unit size, on what the model was fitted to.
    held_out_error
        The same on what was held out, of the model as fitted without it; ``nan`` where nothing was.
    scores
        For each candidate order of the method chosen, its held-out error (or BIC where nothing was held out).
    refined
        Whether output-error refinement was accepted.
    refitted
        Whether the model was fitted once more to everything after the choice was made.
    """

    model: StateSpace
    method: str
    order: int
    rank: int
    rank_needed: int
    block_rows: int
    singular_values: Array
    spectral_radius_found: float
    stabilised: bool
    stabilised_by: str
    transition: str
    ridge: float
    train_error: float
    held_out_error: float
    scores: dict[int, float]
    refined: bool
    refitted: bool


@dataclass(frozen=True)
class Settings:
    """The options of :func:`identify` that every step shares."""

    weight: str
    transition: str | None
    ridge: float | None
    rho_max: float
    block_rows: int | None
    taps: int | None
    threshold: float


@dataclass(frozen=True)
class _Candidate:
    model: StateSpace
    method: str
    asked: int
    found: float = 0.0
    way: str = ""
    transition: str = ""
    ridge: float = 0.0
    subspace: Subspace | None = None
    singular_values: Array | None = None
    score: float = float("nan")

    @property
    def order(self) -> int:
        return self.model.order


def fit_lti(inputs: Recordings, outputs: Recordings, order: int | str | None = None, **options: Any) -> StateSpace:
    """Identify a discrete linear time-invariant model from recordings that start from rest.

    The model of :func:`identify`, which takes the same arguments and also returns what was found on the way.
    """
    return identify(inputs, outputs, order, **options).model


def identify(
    inputs: Recordings,
    outputs: Recordings,
    order: int | str | None = None,
    *,
    method: str = "subspace",
    weight: str = "moesp",
    transition: str | None = None,
    ridge: float | None = None,
    rho_max: float | None = None,
    fps: float = 30.0,
    tau: float = 2.0,
    refine: bool = False,
    iterations: int = 200,
    validation: tuple[Recordings, Recordings] | float | None = None,
    max_order: int = CAP,
    block_rows: int | None = None,
    taps: int | None = None,
    threshold: float = 1e-6,
    refit: bool = True,
) -> Identification:
    """Identify a model and report on it.

    Everything is done on channels divided by their root mean square. With a subspace method ``A`` and ``C`` come from
    PO-MOESP or N4SID; if a pole lies outside the circle of ``rho_max``, and only then, it is brought in by clipping or by
    scaling, whichever simulates better; ``B`` and ``D`` are then fitted to the simulated output from rest. With
    ``kernel-fir`` the impulse response is estimated with a TC kernel and realised by Ho-Kalman.

    Parameters
    ----------
    inputs, outputs
        (T, m) and (T, l), or lists of such of any lengths: separate experiments, each from rest.
    order
        Number of states; ``None`` or ``"auto"``: the one of :func:`~methods.hsu.lti.order.order_grid` up to ``max_order``
        that simulates the held-out part best, or the one with fewest states that cannot be told from it
        (:func:`~methods.hsu.lti.order.pick`). The grid begins with a static gain. Where the record has fewer directions than
        states are asked for, the model has as many states as there are directions.
    method
        ``subspace``, ``kernel-fir``, or ``auto``: the better one on the held-out part.
    weight
        ``moesp`` or ``n4sid``.
    transition
        How ``A`` and ``C`` are had from the subspace, :meth:`~methods.hsu.lti.subspace.Subspace.transition`. ``None``: with a
        held-out part the better one, else ``state``, or ``shift`` if the record is rank-deficient. With white inputs
        ``state`` simulates up to a tenth better; with few smooth clips of a resonant system ``shift`` can have a third of
        its error, but leaves the circle twice as often.
    ridge
        Penalty on the energy of the response, as a share of the mean squared column of the fit for ``B``. ``None``: with a
        held-out part the best of 0, 1e-4 and 1e-2; else 1e-2 if the record is rank-deficient, 1e-4 if only ``A`` had to be
        stabilised, and 0 otherwise.
    rho_max
        Largest spectral radius; ``exp(-1 / (fps tau))`` if omitted.
    fps, tau
        Frames per second and the longest time constant in seconds.
    refine
        Follow with output-error refinement, accepted only if it does better on the held-out part.
    iterations
        Iterations of the refinement.
    validation
        ``(inputs, outputs)`` to judge by, which are never fitted to; or the share to split off, the same every time; ``None``:
        a fifth, where there is something to choose (order, method, refinement), and nothing otherwise. See
        :func:`~methods.hsu.lti.order.split_off` for a single recording.
    max_order
        Highest order tried.
    block_rows
        Block rows of the Hankel matrices; ``max(20, ceil(n / l) + 2)`` if omitted, fewer with a warning where recordings
        are too short.
    taps
        Length of the impulse responses of ``kernel-fir``; 40 to 90 by the length of the recordings if omitted.
    threshold
        Singular values of a realised impulse response below this share of the first are dropped.
    refit
        Fit the chosen kind of model once more to everything, where the held-out part was split off. A refined model is not.

    Returns
    -------
    Identification

    Warns
    -----
    RankDeficientWarning
        If the rank of the record is below ``2 i m + n``. The model is still stable, and with the safe ridge a sane one; states
        that would be made of rounding are left out, and where none is left the impulse response is taken.
    IdentificationWarning
        If recordings are so short that something else was done than asked, or have fewer directions than states were asked for.

    Raises
    ------
    ContractError
        If shapes or options do not fit.
    DataError
        If there is no frame, or a value is not finite.
    """
    everything = Records.of(inputs, outputs)
    radius_allowed = longest_radius(fps, tau) if rho_max is None else float(rho_max)
    asked = _check(order, method, weight, transition, ridge, radius_allowed, max_order, block_rows, taps)
    settings = Settings(weight, transition, ridge, radius_allowed, block_rows, taps, threshold)
    input_scale, output_scale = everything.scales()
    scaled = everything.scaled(input_scale, output_scale)
    split = _split(scaled, validation, asked is None or method == "auto" or refine, input_scale, output_scale)

    orders = order_grid(max_order) if asked is None else (asked,)
    candidates = _candidates(split, orders, method, settings)
    best = _best(candidates, split)
    # Scores by order, of the method that won; a static gain belongs to every method.
    scores: dict[int, float] = {}
    for candidate in candidates:
        if candidate.method in (best.method, "static") or best.method == "static":
            scores[candidate.order] = min(candidate.score, scores.get(candidate.order, float("inf")))
    held_out = simulation_error(best.model, split.judged, split.skip) if split.held_out else float("nan")

    refined = refitted = False
    if refine:
        result = refine_model(best.model, split, radius_allowed, iterations=iterations)
        if result.accepted:
            refined = True
            best = replace(best, model=result.model)
            held_out = simulation_error(best.model, split.judged, split.skip)
    if refit and not refined and split.held_out and not split.given:
        again = _refitted(scaled, best, settings)
        if again is not None:
            best, refitted = again, True
    fitted_to = scaled if refitted or not split.held_out else split.train
    error = simulation_error(best.model, fitted_to)
    model = _guarded(best.model, radius_allowed).rescaled(input_scale, output_scale)
    _warn(best, model, len(orders) == 1, block_rows)
    subspace = best.subspace
    return Identification(
        model=model,
        method=best.method,
        order=model.order,
        rank=0 if subspace is None else subspace.rank,
        rank_needed=0 if subspace is None else subspace.rank_needed(best.asked),
        block_rows=0 if subspace is None else subspace.block_rows,
        singular_values=np.zeros(0) if best.singular_values is None else best.singular_values,
        spectral_radius_found=best.found,
        stabilised=bool(best.way),
        stabilised_by=best.way,
        transition=best.transition,
        ridge=best.ridge,
        train_error=error,
        held_out_error=held_out,
        scores=dict(sorted(scores.items())),
        refined=refined,
        refitted=refitted,
    )


def _check(
    order: int | str | None,
    method: str,
    weight: str,
    transition: str | None,
    ridge: float | None,
    rho_max: float,
    max_order: int,
    block_rows: int | None,
    taps: int | None,
) -> int | None:
    if method not in METHODS:
        raise ContractError(f"identification: method must be one of {', '.join(METHODS)}, not {method!r}")
    if weight not in WEIGHTS:
        raise ContractError(f"identification: weight must be one of {', '.join(WEIGHTS)}, not {weight!r}")
    if transition is not None and transition not in TRANSITIONS:
        raise ContractError(f"identification: transition must be one of {', '.join(TRANSITIONS)}, not {transition!r}")
    if ridge is not None and not (np.isfinite(ridge) and ridge >= 0.0):
        raise ContractError(f"identification: ridge must be at least 0, not {ridge}")
    if not 0.0 < rho_max < 1.0:
        raise ContractError(f"identification: rho_max must lie between 0 and 1, not {rho_max}")
    if max_order < 0:
        raise ContractError(f"identification: max_order must be at least 0, not {max_order}")
    for name, value in (("block_rows", block_rows), ("taps", taps)):
        if value is not None and value < 1:
            raise ContractError(f"identification: {name} must be at least 1, not {value}")
    if order is None or order == "auto":
        return None
    if isinstance(order, (str, bool)) or int(order) != order or order < 0:
        raise ContractError(f"identification: order must be a whole number of at least 0 or 'auto', not {order!r}")
    return int(order)


def _split(
    records: Records,
    validation: tuple[Recordings, Recordings] | float | None,
    needed: bool,
    input_scale: Array,
    output_scale: Array,
) -> Split:
    if isinstance(validation, (tuple, list)):
        if len(validation) != 2:
            raise ContractError("identification: validation must be (inputs, outputs) or a share")
        judged = Records.of(validation[0], validation[1])
        if judged.channels != records.channels:
            raise ContractError(
                f"identification: validation has {judged.channels} channels, the recordings {records.channels}"
            )
        return Split(records, judged.scaled(input_scale, output_scale), 0, True, given=True)
    if validation is None:
        return split_off(records, 0.2) if needed else Split(records, records, 0, False)
    if not 0.0 < validation < 1.0:
        raise ContractError(f"identification: the share of validation must lie between 0 and 1, not {validation}")
    return split_off(records, float(validation))


def _candidates(split: Split, orders: tuple[int, ...], method: str, settings: Settings) -> list[_Candidate]:
    """Models of every order asked for, with their scores; never empty."""
    found: list[_Candidate] = []
    positive = tuple(order for order in orders if order > 0)
    if 0 in orders:
        found.append(_static(split.train))
    if positive and method in ("subspace", "auto"):
        found += _by_subspace(split, positive, settings)
    if positive and (method in ("kernel-fir", "auto") or not found):
        found += _by_kernel(split.train, positive, settings)
    return [
        candidate if np.isfinite(candidate.score) else replace(candidate, score=judge(candidate.model, split))
        for candidate in found
    ]


def _best(candidates: list[_Candidate], split: Split) -> _Candidate:
    orders = np.array([candidate.order for candidate in candidates], dtype=np.float64)
    scores = np.array([candidate.score for candidate in candidates])
    energies = None
    if split.held_out:
        block = None if len(split.judged) >= ENOUGH else BLOCK
        energies = np.array([residual_energies(c.model, split.judged, split.skip, block=block)[0] for c in candidates])
    return candidates[pick(orders, scores, relative=split.held_out, energies=energies)]


def _static(records: Records) -> _Candidate:
    outputs = records.channels[1]
    problem = input_problem(records, np.zeros((0, 0)), np.zeros((outputs, 0)))
    return _Candidate(StateSpace.static(problem.solve()[1]), "static", 0)


def _by_subspace(split: Split, orders: tuple[int, ...], settings: Settings) -> list[_Candidate]:
    """One factorisation, then a model of each order; with fewer block rows, and so fewer orders, where clips are short."""
    records = split.train
    reachable = list(orders)
    while reachable:
        rows = choose_block_rows(records, reachable[-1], settings.block_rows)
        if rows is not None:
            break
        dropped = reachable.pop()
        if len(orders) == 1:
            warnings.warn(
                f"the recordings (at most {max(records.lengths)} frames) are too short for a subspace method of order "
                f"{dropped}; using a kernel-regularised impulse response instead",
                IdentificationWarning,
                stacklevel=4,
            )
    if not reachable:
        return []
    assert rows is not None
    try:
        subspace = identify_subspace(records, rows, settings.weight)
    except np.linalg.LinAlgError as error:
        warnings.warn(
            f"the subspace factorisation failed ({error}); using an impulse response",
            IdentificationWarning,
            stacklevel=4,
        )
        return []
    if not subspace.directions:
        if len(orders) == 1:
            warnings.warn(
                f"{_undetermined(subspace, reachable[-1])}; its past says nothing of its future that the inputs do not, so "
                "that there are no states: using a kernel-regularised impulse response instead",
                RankDeficientWarning,
                stacklevel=4,
            )
        return []
    problems = InputProblems(records, many=len(reachable) > 3)
    found: dict[int, list[_Candidate]] = {}
    for asked in reachable:
        # Further states would be made of rounding, and the model would differ with the last bit of a record.
        order = min(asked, subspace.directions)
        if order <= subspace.highest_order and order not in found:
            candidates = _of_order(split, subspace, problems, order, settings)
            found[order] = [replace(candidate, asked=asked) for candidate in candidates]
    return [candidate for candidates in found.values() for candidate in candidates]


def _undetermined(subspace: Subspace, order: int) -> str:
    return (
        f"the record does not determine a model of order {order}: rank {subspace.rank} < 2im+n = "
        f"{subspace.rank_needed(order)} (i = {subspace.block_rows} block rows); repeating a recording adds nothing"
    )


def _of_order(
    split: Split, subspace: Subspace, problems: InputProblems, order: int, settings: Settings
) -> list[_Candidate]:
    """The best model of one order, over the ways to have, to stabilise and to complete its ``A``; none if all fail."""
    if settings.transition is not None:
        transitions: tuple[str, ...] = (settings.transition,)
    else:
        # Of a deficient record the past says nothing that the inputs do not, and states regressed on it are all zero.
        deficient = subspace.rank < subspace.rank_needed(order)
        transitions = TRANSITIONS if split.held_out else (("shift",) if deficient else ("state",))
    candidates: list[_Candidate] = []
    for transition in transitions:
        try:
            a, c = subspace.transition(order, transition)
            found = radius(a)
        except np.linalg.LinAlgError:
            continue
        for way in WAYS if found > settings.rho_max else ("",):
            stable = calmed(stabilised(a, settings.rho_max, way), c)
            moved, seen = output_normal(stable, c)
            problem = problems.of(moved, seen)
            for ridge in _ridges(split, subspace, order, settings, stable is not a):
                b, d = problem.solve(ridge)
                if np.isfinite(b).all() and np.isfinite(d).all():
                    candidates.append(
                        _Candidate(
                            StateSpace(moved, b, seen, d),
                            "subspace",
                            order,
                            found=found,
                            way=way if way or stable is a else "scale",
                            transition=transition,
                            ridge=ridge,
                            subspace=subspace,
                            singular_values=subspace.singular_values,
                        )
                    )
    if len(candidates) < 2:
        return candidates
    judged = [replace(candidate, score=judge(candidate.model, split)) for candidate in candidates]
    return [min(judged, key=lambda candidate: candidate.score)]


def _ridges(split: Split, subspace: Subspace, order: int, settings: Settings, moved: bool) -> tuple[float, ...]:
    if settings.ridge is not None:
        return (settings.ridge,)
    if split.held_out:
        return RIDGES
    if subspace.rank < subspace.rank_needed(order):
        return (DEFICIENT_RIDGE,)
    return (STABILISED_RIDGE if moved else 0.0,)


def _by_kernel(records: Records, orders: tuple[int, ...], settings: Settings) -> list[_Candidate]:
    response = kernel_fir(records, settings.taps)
    whole = realize(response.markov, orders[-1])
    reachable = effective_order(whole.singular_values, orders[-1], settings.threshold)
    found: dict[int, _Candidate] = {}
    for order in orders:
        model = whole.model(min(order, reachable))
        radius_found = model.spectral_radius
        way = "clip" if radius_found > settings.rho_max else ""
        if way:
            model = StateSpace(stabilised(model.A, settings.rho_max, way), model.B, model.C, model.D)
        method = "kernel-fir" if model.order else "static"
        found.setdefault(
            model.order,
            _Candidate(model, method, order, found=radius_found, way=way, singular_values=whole.singular_values),
        )
    return list(found.values())


def _refitted(records: Records, best: _Candidate, settings: Settings) -> _Candidate | None:
    """The chosen kind of model on everything; ``None`` if that cannot be had."""
    whole = Split(records, records, 0, False)
    if best.method == "static":
        return _static(records)
    if best.method == "kernel-fir":
        return _by_kernel(records, (best.order,), settings)[0]
    assert best.subspace is not None
    fixed = replace(settings, ridge=best.ridge, transition=best.transition, block_rows=best.subspace.block_rows)
    again = _by_subspace(whole, (best.order,), fixed)
    return replace(again[0], asked=best.asked) if again else None


def _guarded(model: StateSpace, rho_max: float) -> StateSpace:
    """The model, its poles moved inside by rounding's width if a change of basis has let one out."""
    if model.spectral_radius <= rho_max:
        return model
    return StateSpace(stabilised(model.A, rho_max, "scale"), model.B, model.C, model.D)


def _warn(best: _Candidate, model: StateSpace, single: bool, wanted: int | None) -> None:
    subspace = best.subspace
    if subspace is not None and subspace.rank < subspace.rank_needed(best.asked):
        warnings.warn(
            _undetermined(subspace, best.asked),
            RankDeficientWarning,
            stacklevel=3,
        )
    if subspace is not None and single:
        usual = usual_block_rows(best.order, model.outputs) if wanted is None else wanted
        if subspace.block_rows != usual:
            warnings.warn(
                f"{subspace.block_rows} block rows instead of {usual}: order {best.order} needs at least "
                f"{least_block_rows(best.order, model.outputs)}, and the recordings allow no more with a column for each row",
                IdentificationWarning,
                stacklevel=3,
            )
    if single and best.asked > model.order:
        source = "the impulse response" if subspace is None else "what the record's past says of its future"
        warnings.warn(
            f"order {best.asked} was asked for, but {source} has only {model.order} directions",
            IdentificationWarning,
            stacklevel=3,
        )
