"""Differentiable rotations and forward kinematics: the torch twin of :mod:`benchmark.motion.kinematics`.

Same conventions: quaternions ``w, x, y, z``, leading axes broadcast, metres. Everything works in the dtype and on the device of
its input and passes gradients.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional

_EPS = 1e-8


def normalize(q: Tensor) -> Tensor:
    """Unit quaternions (..., 4): ``q / max(|q|, 1e-8)``, so that a zero output of a network has a finite gradient."""
    return functional.normalize(q, dim=-1, eps=_EPS)


def mul(a: Tensor, b: Tensor) -> Tensor:
    """Hamilton product ``a b`` (..., 4): the rotation ``b`` followed by ``a``."""
    aw, ax, ay, az = a.unbind(-1)
    bw, bx, by, bz = b.unbind(-1)
    return torch.stack(
        (
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ),
        dim=-1,
    )


def inverse(q: Tensor) -> Tensor:
    """Inverse of unit quaternions (the conjugate)."""
    return torch.cat((q[..., :1], -q[..., 1:]), dim=-1)


def rotate(q: Tensor, v: Tensor) -> Tensor:
    """Vectors ``v`` (..., 3) turned by the unit quaternions ``q`` (..., 4)."""
    xyz = q[..., 1:]
    xyz, v = torch.broadcast_tensors(xyz, v)
    t = 2.0 * torch.linalg.cross(xyz, v)
    return v + q[..., :1] * t + torch.linalg.cross(xyz, t)


def matrix_from_sixd(sixd: Tensor) -> Tensor:
    """Rotation matrices (..., 3, 3) from six numbers (..., 6), their first two columns before orthonormalisation.

    Zhou et al. 2019, "On the continuity of rotation representations in neural networks", equation 15.
    """
    a, b = sixd[..., :3], sixd[..., 3:]
    first = functional.normalize(a, dim=-1, eps=_EPS)
    second = functional.normalize(b - (first * b).sum(-1, keepdim=True) * first, dim=-1, eps=_EPS)
    return torch.stack((first, second, torch.linalg.cross(first, second)), dim=-1)


def matrix_from_quaternion(q: Tensor) -> Tensor:
    """Rotation matrices (..., 3, 3) of unit quaternions (..., 4)."""
    w, x, y, z = q.unbind(-1)
    entries = (
        1 - 2 * (y * y + z * z),
        2 * (x * y - w * z),
        2 * (x * z + w * y),
        2 * (x * y + w * z),
        1 - 2 * (x * x + z * z),
        2 * (y * z - w * x),
        2 * (x * z - w * y),
        2 * (y * z + w * x),
        1 - 2 * (x * x + y * y),
    )
    return torch.stack(entries, dim=-1).unflatten(-1, (3, 3))


def fk(
    parents: Sequence[int],
    offsets: Tensor,
    rotations: Tensor,
    root: Tensor,
) -> tuple[Tensor, Tensor]:
    """World rotations and positions of every joint, differentiable in all tensors.

    Joints of the same depth are worked on together.

    Parameters
    ----------
    parents
        J parent indices, -1 for joint 0, as in :class:`~benchmark.motion.skeleton.Skeleton`.
    offsets
        (J, 3), or (..., J, 3) for bones that differ by sample or frame.
    rotations
        (..., J, 4) local unit quaternions.
    root
        (..., 3) position of joint 0.

    Returns
    -------
    rotations, positions
        (..., J, 4) and (..., J, 3).
    """
    joints = [int(parent) for parent in parents]
    if rotations.shape[-2:] != (len(joints), 4) or offsets.shape[-2:] != (len(joints), 3):
        raise ValueError(
            f"{len(joints)} parents need rotations (..., {len(joints)}, 4) and offsets (..., {len(joints)}, 3), "
            f"not {tuple(rotations.shape)} and {tuple(offsets.shape)}"
        )
    order, levels = _levels(joints)
    slot = {joint: place for place, joint in enumerate(order)}
    offsets = offsets.expand(*rotations.shape[:-2], *offsets.shape[-2:]) if offsets.ndim > 2 else offsets
    turned = [rotations[..., :1, :]]
    placed = [root.unsqueeze(-2)]
    first = 0
    for level in levels[1:]:
        # Parents sit in the level before, in the order in which that level was laid out.
        above = [slot[joints[joint]] - first for joint in level]
        parent, at = turned[-1][..., above, :], placed[-1][..., above, :]
        placed.append(at + rotate(parent, offsets[..., level, :]))
        turned.append(mul(parent, rotations[..., level, :]))
        first = slot[level[0]]
    back = [slot[joint] for joint in range(len(joints))]
    return torch.cat(turned, dim=-2)[..., back, :], torch.cat(placed, dim=-2)[..., back, :]


def _levels(parents: Sequence[int]) -> tuple[list[int], list[list[int]]]:
    """Joints grouped by depth, and the same joints in one list."""
    depth = [0] * len(parents)
    for joint, parent in enumerate(parents):
        if parent >= 0:
            depth[joint] = depth[parent] + 1
    levels = [[joint for joint, d in enumerate(depth) if d == level] for level in range(max(depth) + 1)]
    return [joint for level in levels for joint in level], levels
