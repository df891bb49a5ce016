"""A discrete linear time-invariant model: simulation over whole clips and frame by frame."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmark.errors import ContractError
from methods.hsu.lti.scan import propagate

Array = NDArray[np.float64]

#: Floats of state that one batch of :meth:`StateSpace.simulate` may hold.
_ROOM = 4_000_000


@dataclass(frozen=True, eq=False)
class StateSpace:
    """``x[t+1] = A x[t] + B u[t]``, ``y[t] = C x[t] + D u[t]``.

    The four matrices are copied and read-only. Besides them the object holds one thing that changes: the state that
    :meth:`step` advances and :meth:`reset` zeroes. ``simulate`` neither reads nor writes it.

    Attributes
    ----------
    A
        (n, n) transition; ``n`` may be 0, a static gain.
    B
        (n, m) input.
    C
        (l, n) output.
    D
        (l, m) direct gain.

    Raises
    ------
    ContractError
        If the shapes do not fit together or a value is not finite.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    _state: Array = field(init=False, repr=False)
    _joined: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        matrices = {}
        for name in ("A", "B", "C", "D"):
            matrix = np.array(getattr(self, name), dtype=np.float64, copy=True)
            if matrix.ndim != 2:
                raise ContractError(f"StateSpace: {name} must be a matrix, not an array of shape {matrix.shape}")
            if not np.isfinite(matrix).all():
                raise ContractError(f"StateSpace: {name} holds values that are not finite")
            matrices[name] = matrix
        outputs, inputs = matrices["D"].shape
        order = len(matrices["A"])
        for name, shape in (("A", (order, order)), ("B", (order, inputs)), ("C", (outputs, order))):
            if matrices[name].shape != shape:
                raise ContractError(f"StateSpace: {name} has shape {matrices[name].shape}; A and D ask for {shape}")
        for name, matrix in matrices.items():
            matrix.flags.writeable = False
            object.__setattr__(self, name, matrix)
        joined = np.block([[matrices["A"], matrices["B"]], [matrices["C"], matrices["D"]]])
        object.__setattr__(self, "_joined", joined)
        object.__setattr__(self, "_state", np.zeros(order))

    @classmethod
    def static(cls, gain: ArrayLike) -> Self:
        """A model of order 0: ``y = gain @ u``, gain of shape (l, m)."""
        matrix = np.atleast_2d(np.asarray(gain, dtype=np.float64))
        outputs, inputs = matrix.shape
        return cls(np.zeros((0, 0)), np.zeros((0, inputs)), np.zeros((outputs, 0)), matrix)

    @property
    def order(self) -> int:
        """Number of states."""
        return len(self.A)

    @property
    def inputs(self) -> int:
        """Number of input channels."""
        return self.D.shape[1]

    @property
    def outputs(self) -> int:
        """Number of output channels."""
        return self.D.shape[0]

    @property
    def spectral_radius(self) -> float:
        """Largest modulus of a pole; 0 for a static gain."""
        return float(np.abs(self.poles()).max(initial=0.0))

    def poles(self) -> NDArray[np.complex128]:
        """(n,) eigenvalues of ``A``, by falling modulus, then by angle."""
        values = np.linalg.eigvals(self.A).astype(np.complex128) if self.order else np.zeros(0, dtype=np.complex128)
        return values[np.lexsort((np.angle(values), -np.round(np.abs(values), 12)))]

    def markov(self, count: int) -> Array:
        """(count, l, m) response to a unit impulse: ``D, C B, C A B, …``. Independent of the basis of the state."""
        result = np.zeros((count, self.outputs, self.inputs))
        if count:
            result[0] = self.D
        reach = self.C
        for lag in range(1, count if self.order else 0):
            result[lag] = reach @ self.B
            reach = reach @ self.A
        return result

    def simulate(self, u: ArrayLike, x0: ArrayLike | None = None) -> Array:
        """Response to an input, all frames at once.

        Parameters
        ----------
        u
            (..., T, m) input; leading axes are independent sequences.
        x0
            (..., n) state at frame 0; zero if omitted.

        Returns
        -------
        array
            (..., T, l), the same to 1e-12 of its size as the recurrence frame by frame, if the model is stable.

        Raises
        ------
        ContractError
            If ``u`` or ``x0`` has the wrong number of channels.
        """
        drive = np.asarray(u, dtype=np.float64)
        if drive.ndim < 2 or drive.shape[-1] != self.inputs:
            raise ContractError(
                f"StateSpace.simulate: u must have shape (..., frames, {self.inputs}), not {drive.shape}"
            )
        frames = drive.shape[-2]
        flat = drive.reshape(math.prod(drive.shape[:-2]), frames, self.inputs)
        state = np.zeros((len(flat), self.order))
        if x0 is not None:
            given = np.asarray(x0, dtype=np.float64)
            if given.shape[-1:] != (self.order,):
                raise ContractError(f"StateSpace: x0 must have {self.order} values, not shape {given.shape}")
            state = np.broadcast_to(given, (*drive.shape[:-2], self.order)).reshape(len(flat), self.order)
        result = flat @ self.D.T
        if self.order and frames:
            span = max(256, _ROOM // max(1, len(flat) * self.order))
            for begin in range(0, frames, span):
                states, state = propagate(self.A, flat[:, begin : begin + span] @ self.B.T, state)
                result[:, begin : begin + span] += states @ self.C.T
        return result.reshape(*drive.shape[:-1], self.outputs)

    def simulate_each(self, inputs: Sequence[Array]) -> list[Array]:
        """Responses from rest to several inputs of any lengths, (T_k, m) each; short ones are padded and run together."""
        lengths = [len(u) for u in inputs]
        longest = max(lengths, default=0)
        if len(inputs) < 2 or len(inputs) * longest > 2 * sum(lengths) + 4096:
            return [self.simulate(u) for u in inputs]
        padded = np.zeros((len(inputs), longest, self.inputs))
        for row, u in zip(padded, inputs, strict=True):
            row[: len(u)] = u
        return [y[:length] for y, length in zip(self.simulate(padded), lengths, strict=True)]

    def step(self, u: ArrayLike) -> Array:
        """Take one input frame (m,), return the output frame (l,) and keep the state for the next call."""
        frame = np.asarray(u, dtype=np.float64)
        if frame.shape != (self.inputs,):
            raise ContractError(f"StateSpace.step: u must have shape ({self.inputs},), not {frame.shape}")
        both = self._joined @ np.concatenate([self._state, frame])
        self._state[:] = both[: self.order]
        return both[self.order :]

    def reset(self, x0: ArrayLike | None = None) -> None:
        """Put the streaming state back to zero, or to ``x0`` of shape (n,)."""
        self._state[:] = 0.0 if x0 is None else x0

    def transformed(self, basis: Array) -> StateSpace:
        """The same map with the state ``z`` of ``x = basis @ z``; ``basis`` (n, n) is invertible."""
        inverse = np.asarray(np.linalg.inv(basis), dtype=np.float64)
        return StateSpace(inverse @ self.A @ basis, inverse @ self.B, self.C @ basis, self.D)

    def rescaled(self, input_scale: Array, output_scale: Array) -> StateSpace:
        """The map in other units: of channels that are ``input_scale`` (m,) and ``output_scale`` (l,) times this model's."""
        return StateSpace(
            self.A,
            self.B / input_scale,
            self.C * output_scale[:, None],
            self.D * output_scale[:, None] / input_scale,
        )

    def to_arrays(self) -> dict[str, Array]:
        """The four matrices by name, to be kept in an ``npz`` or ``safetensors`` file."""
        return {"A": self.A, "B": self.B, "C": self.C, "D": self.D}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Any]) -> Self:
        """The model of :meth:`to_arrays`; a :class:`~benchmark.errors.ContractError` names a matrix that is missing."""
        missing = [name for name in ("A", "B", "C", "D") if name not in arrays]
        if missing:
            raise ContractError(f"StateSpace: the saved model lacks {', '.join(missing)}")
        return cls(*(np.asarray(arrays[name], dtype=np.float64) for name in ("A", "B", "C", "D")))
