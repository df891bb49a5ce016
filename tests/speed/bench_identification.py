"""State-space identification beside other people's libraries, and the speed of simulating what was identified."""

from __future__ import annotations

import contextlib
import importlib
import io
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from timing import Job, collect, interleaved, rows

from methods.hsu.lti import StateSpace, identify

#: Order of the true system; the models have this order and a lower one.
TRUTH = 40
FRAMES, FRESH = 3000, 1000
#: (order, channels in and out) to repeats.
CASES = {(10, 3): 9, (40, 3): 9, (10, 20): 5, (40, 20): 5}
#: Joints, order, frames a second and frames of a clip that is translated.
JOINTS, CLIP = 25, 100
FPS = 30.0


class Case:
    """One noisy record of a known system, for the fit, and a fresh one without noise, to judge by."""

    def __init__(
        self, order: int, channels: int, *, frames: int = FRAMES, fresh: int = FRESH, truth: int = TRUTH
    ) -> None:
        rng = np.random.default_rng(channels)
        self.order, self.channels = order, channels
        # More block rows than the largest order needs of three outputs; sippy wants more than the order.
        self.block_rows, self.horizon = 20, max(20, order + 2)
        a = rng.normal(size=(truth, truth))
        a *= 0.95 / np.abs(np.linalg.eigvals(a)).max()
        system = StateSpace(
            a,
            rng.normal(size=(truth, channels)),
            rng.normal(size=(channels, truth)),
            rng.normal(size=(channels, channels)),
        )
        # Outputs of one size, so that no library gains by weighing the large ones more, or less, than the judgement does.
        size = system.simulate(rng.normal(size=(frames, channels))).std(axis=0)
        system = system.rescaled(np.ones(channels), 1.0 / size)
        self.u = rng.normal(size=(frames, channels))
        clean = system.simulate(self.u)
        self.y = clean + 0.05 * clean.std(axis=0) * rng.normal(size=clean.shape)
        self.fresh_u = rng.normal(size=(fresh, channels))
        self.fresh_y = system.simulate(self.fresh_u)

    def error(self, model: StateSpace) -> float:
        """Norm of the simulated error on the fresh record over the norm of that record."""
        with np.errstate(over="ignore", invalid="ignore"):
            off = np.linalg.norm(model.simulate(self.fresh_u) - self.fresh_y)
        return float(off / np.linalg.norm(self.fresh_y))

    def check(self, model: StateSpace) -> None:
        """Strike off a library whose model says nothing about the fresh record."""
        error = self.error(model)
        if not error < 1.0:
            raise ValueError(f"its error on fresh data is {error:.3g} of the data")


def _ours(case: Case) -> Job:
    return lambda: identify(case.u, case.y, case.order, block_rows=case.block_rows).model


def _nfoursid(case: Case) -> Job:
    library = importlib.import_module("nfoursid.nfoursid")
    pandas = importlib.import_module("pandas")
    inputs = [f"u{k}" for k in range(case.channels)]
    outputs = [f"y{k}" for k in range(case.channels)]
    frame = pandas.DataFrame(np.concatenate([case.u, case.y], axis=1), columns=inputs + outputs)

    def job() -> StateSpace:
        found = library.NFourSID(frame, output_columns=outputs, input_columns=inputs, num_block_rows=case.block_rows)
        found.subspace_identification()
        model, _ = found.system_identification(rank=case.order)
        return StateSpace(model.a, model.b, model.c, model.d)

    case.check(job())
    return job


def _sippy(name: str) -> Callable[[Case], Job]:
    def build(case: Case) -> Job:
        library = importlib.import_module("sippy_unipi")

        def job() -> StateSpace:
            try:
                # It prints where it doubts its arguments.
                with contextlib.redirect_stdout(io.StringIO()):
                    model = library.system_identification(
                        case.y.T,
                        case.u.T,
                        name,
                        SS_fixed_order=case.order,
                        SS_f=case.horizon,
                        SS_p=case.horizon,
                        SS_D_required=True,
                    )
            except SystemExit as error:
                raise ValueError("it ended the program") from error
            return StateSpace(model.A, model.B, model.C, model.D)

        case.check(job())
        return job

    return build


def _llsi(case: Case) -> Job:
    library = importlib.import_module("llsi")
    if case.channels > 3:
        # Its window grows with the product of inputs and outputs and has more rows than the record has frames.
        raise ValueError("its window does not fit into the record")
    inputs = [f"u{k}" for k in range(case.channels)]
    outputs = [f"y{k}" for k in range(case.channels)]
    channels = dict(zip(inputs + outputs, np.concatenate([case.u, case.y], axis=1).T, strict=True))

    def job() -> StateSpace:
        data = library.SysIdData(t_start=0.0, Ts=1.0, **channels)
        model = library.sysid(data, outputs, inputs, case.order, method="po-moesp")
        return StateSpace(model.A, model.B, model.C, model.D)

    case.check(job())
    return job


PEERS = {
    "nfoursid": _nfoursid,
    "sippy-unipi N4SID": _sippy("N4SID"),
    "sippy-unipi MOESP": _sippy("MOESP"),
    "llsi": _llsi,
}


def run(
    console: Any,
    *,
    cases: dict[tuple[int, int], int] | None = None,
    peers: Sequence[str] = tuple(PEERS),
    repeats: int = 9,
    **sizes: int,
) -> list[dict[str, Any]]:
    """Time identification with the error on fresh data beside it, then translation; ``cases`` maps them to repeats."""
    result = []
    for (order, channels), rounds in (CASES if cases is None else cases).items():
        case = Case(order, channels, **sizes)
        jobs, missing = collect({name: PEERS[name] for name in peers}, case, console=console)
        contestants = {"ours": _ours(case), **jobs}
        name = f"order {order}, {channels} in, {channels} out"
        result += rows(f"Identification, {name}", interleaved(contestants, repeats=rounds), missing)
        # Turned over, so that more is better, as it is for every row that is not a time.
        errors = {who: case.error(job()) for who, job in contestants.items()}  # type: ignore[arg-type]
        result += rows(f"Identification accuracy, {name}", errors, missing, work=1.0, unit="/ error on fresh data")
    return result + translation(repeats=repeats, **{k: v for k, v in sizes.items() if k == "truth"})


def translation(*, repeats: int, truth: int = TRUTH) -> list[dict[str, Any]]:
    """How many times faster than it was performed a clip goes through one model for each joint."""
    models = []
    for joint in range(JOINTS):
        rng = np.random.default_rng(joint)
        a = rng.normal(size=(truth, truth))
        a *= 0.95 / np.abs(np.linalg.eigvals(a)).max()
        shapes = ((truth, 3), (3, truth), (3, 3))
        models.append(StateSpace(a, *(rng.normal(size=shape) for shape in shapes)))
    clip = np.random.default_rng(JOINTS).normal(size=(JOINTS, CLIP, 3))

    def whole() -> list[np.ndarray]:
        return [model.simulate(u) for model, u in zip(models, clip, strict=True)]

    def streamed() -> list[np.ndarray]:
        for model in models:
            model.reset()
        return [
            np.array([model.step(u[frame]) for model, u in zip(models, clip, strict=True)]) for frame in range(CLIP)
        ]

    seconds = interleaved({"ours": whole, "ours, frame by frame": streamed}, repeats=repeats)
    name = f"Simulation, {JOINTS} joints, order {truth}"
    return rows(name, seconds, {}, work=CLIP / FPS, unit="times real time")
