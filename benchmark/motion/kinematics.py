"""Forward kinematics and what follows directly from it.

Quaternions are worked on as pairs of complex numbers: ``w + x i + y j + z k = a + b j`` with ``a = w + x i`` and
``b = y + z i``, which is how ``(..., 4)`` lies in memory anyway. One Hamilton product is then four complex products, which
numpy does in three or four calls on long contiguous rows instead of the 28 that four separate components take.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmark.errors import ContractError
from benchmark.motion import quat
from benchmark.motion.skeleton import Skeleton

#: Joint-frames worked on at a time: keeps the buffers of a block in a core's second-level cache.
_BLOCK = 16384


def fk(
    skeleton: Skeleton,
    rotations: ArrayLike,
    root: ArrayLike,
    *,
    translations: ArrayLike | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """World rotations and positions of every joint.

    Parameters
    ----------
    skeleton
        J joints.
    rotations
        (..., J, 4) local unit quaternions.
    root
        (..., 3) position of joint 0, metres.
    translations
        (..., J, 3) local positions that replace the offsets, or ``None``. Those of joint 0 are ignored.

    Returns
    -------
    rotations, positions
        (..., J, 4) and (..., J, 3), new float64 arrays.

    Raises
    ------
    ContractError
        If a shape does not fit the skeleton or the other arrays.
    """
    local = np.ascontiguousarray(rotations, dtype=np.float64)
    origin = np.asarray(root, dtype=np.float64)
    moved = None if translations is None else np.asarray(translations, dtype=np.float64)
    joints, lead = len(skeleton), local.shape[:-2]
    if local.ndim < 2 or local.shape[-2:] != (joints, 4):
        raise ContractError(f"rotations must have shape (..., {joints}, 4) on this skeleton, not {local.shape}")
    if origin.shape != (*lead, 3):
        raise ContractError(f"root must have shape {(*lead, 3)} to go with the rotations, not {origin.shape}")
    if moved is not None and moved.shape != (*lead, joints, 3):
        raise ContractError(f"translations must have shape {(*lead, joints, 3)}, not {moved.shape}")
    world, positions = np.empty((*lead, joints, 4)), np.empty((*lead, joints, 3))
    flat_local, flat_world = local.reshape(-1, joints, 4), world.reshape(-1, joints, 4)
    flat_origin, flat_positions = origin.reshape(-1, 3), positions.reshape(-1, joints, 3)
    flat_moved = None if moved is None else moved.reshape(-1, joints, 3)
    frames = len(flat_local)
    if frames == 0:
        return world, positions

    parents = skeleton.parents.tolist()
    rigid = skeleton.offsets[1:, :, None]
    size = min(frames, max(32, _BLOCK // joints))
    work = _Workspace(joints, size)
    for start in range(0, frames, size):
        block = slice(start, min(start + size, frames))
        if block.stop - start < size:
            work = _Workspace(joints, block.stop - start)
        _fk_block(
            work,
            parents,
            flat_local[block],
            flat_origin[block],
            rigid if flat_moved is None else flat_moved[block, 1:].transpose(1, 2, 0),
            flat_world[block],
            flat_positions[block],
        )
    return world, positions


class _Workspace:
    """Buffers for one block of frames, joint by joint so that every row of frames is contiguous."""

    def __init__(self, joints: int, frames: int) -> None:
        self.local = np.empty((joints, 2, frames), complex)
        self.conjugate = np.empty((joints, 2, frames), complex)
        self.world = np.empty((joints, 2, frames), complex)
        self.product = np.empty((joints, 2, frames), complex)
        self.positions = np.empty((joints, 3, frames))


def _fk_block(
    work: _Workspace,
    parents: list[int],
    local: NDArray[np.float64],
    root: NDArray[np.float64],
    bones: NDArray[np.float64],
    world_out: NDArray[np.float64],
    positions_out: NDArray[np.float64],
) -> None:
    """Kinematics of a block of T frames.

    ``local`` (T, J, 4), ``root`` (T, 3) and ``bones`` (J - 1, 3, T or 1) are read, ``world_out`` (T, J, 4) and
    ``positions_out`` (T, J, 3) are written.
    """
    multiply, add, subtract = np.multiply, np.add, np.subtract
    np.copyto(work.local, local.view(complex).transpose(1, 2, 0))
    np.conjugate(work.local, out=work.conjugate)
    work.world[0] = work.local[0]
    # (a + b j)(c + d j) = (a c - b d*) + (a d + b c*) j, with * the complex conjugate.
    crossed = work.product[0]
    for joint in range(1, len(parents)):
        a, b = work.world[parents[joint]]
        out = work.world[joint]
        multiply(a, work.local[joint], out=out)
        multiply(b, work.conjugate[joint], out=crossed)
        first, second = out
        subtract(first, crossed[1], out=first)
        add(second, crossed[0], out=second)
    np.copyto(world_out.view(complex), work.world.transpose(2, 0, 1))

    positions = work.positions
    positions[0] = root.T
    if len(parents) > 1:
        _rotated_bones(work, parents, bones, positions[1:])
    for joint in range(1, len(parents)):
        row = positions[joint]
        add(row, positions[parents[joint]], out=row)
    np.copyto(positions_out, positions.transpose(2, 0, 1))


def _rotated_bones(work: _Workspace, parents: list[int], bones: NDArray[np.float64], out: NDArray[np.float64]) -> None:
    """Write into ``out`` (J - 1, 3, T) the bones turned by the world rotations of their parents.

    With ``q = a + b j`` and the bone ``v = x i + (y + z i) j = x i + u j``, ``q v = c + d j`` has ``c = a x i - b u*`` and
    ``d = a u - b x i``; then ``q v q*`` has the i part ``Im(c a* + d b*)`` and the j, k parts ``a d - b c``.
    """
    multiply, add, subtract = np.multiply, np.add, np.subtract
    x, u = 1j * bones[:, 0], bones[:, 1] + 1j * bones[:, 2]
    # The local rotations are no longer needed: their buffers are free.
    q = np.take(work.world, parents[1:], axis=0, out=work.local[1:], mode="clip")
    half, other = work.conjugate[1:], work.product[1:]
    multiply(q[:, :1], np.stack([u, x], axis=1), out=half)
    multiply(q[:, 1:], np.stack([x, u.conj()], axis=1), out=other)
    subtract(half, other, out=half)
    multiply(q, half, out=other)
    lateral = subtract(other[:, 0], other[:, 1], out=other[:, 0])
    out[:, 1], out[:, 2] = lateral.real, lateral.imag
    np.conjugate(q, out=q)
    multiply(q, half[:, ::-1], out=other)
    add(other[:, 0].imag, other[:, 1].imag, out=out[:, 0])


def local_from_world(skeleton: Skeleton, world: ArrayLike) -> NDArray[np.float64]:
    """Local rotations (..., J, 4) from world rotations (..., J, 4): the inverse of :func:`fk` for rotations."""
    world = np.asarray(world, dtype=np.float64)
    local = quat.inv_mul(world[..., np.maximum(skeleton.parents, 0), :], world)
    local[..., 0, :] = world[..., 0, :]
    return local


def end_site_positions(skeleton: Skeleton, world: ArrayLike, positions: ArrayLike) -> NDArray[np.float64]:
    """World positions (..., E, 3) of the E end sites, from the world rotations and positions of the joints."""
    world, positions = np.asarray(world, dtype=np.float64), np.asarray(positions, dtype=np.float64)
    parents = [end.parent for end in skeleton.end_sites]
    offsets = np.array([end.offset for end in skeleton.end_sites], dtype=np.float64).reshape(-1, 3)
    return positions[..., parents, :] + quat.rotate(world[..., parents, :], offsets)


def velocities(values: ArrayLike, fps: float) -> NDArray[np.float64]:
    """First derivative along axis 0 in units per second.

    Central differences inside, second-order one-sided ones at both ends (first-order for two frames), so that a parabola
    is differentiated exactly. A single frame has zero velocity.
    """
    values = np.asarray(values, dtype=np.float64)
    if len(values) < 2:
        return np.zeros_like(values)
    return np.gradient(values, 1.0 / fps, axis=0, edge_order=2 if len(values) > 2 else 1)
