"""The torch kinematics against the numpy ones, and their gradients against finite differences."""

from __future__ import annotations

import numpy as np
import pytest

from benchmark.motion import quat
from benchmark.motion.kinematics import fk as numpy_fk
from benchmark.motion.skeleton import Skeleton

torch = pytest.importorskip("torch")

PARENTS = [-1, 0, 1, 2, 0, 4, 1, 6, 0, 2]


@pytest.fixture
def twin():
    from methods._torch import kinematics

    return kinematics


@pytest.fixture
def skeleton(rng) -> Skeleton:
    return Skeleton(tuple(f"j{i}" for i in range(len(PARENTS))), np.array(PARENTS), rng.normal(size=(len(PARENTS), 3)))


def unit(rng, *shape: int) -> np.ndarray:
    return quat.normalize(rng.normal(size=(*shape, 4)))


def test_algebra_agrees_with_numpy(twin, rng):
    a, b, v = unit(rng, 5, 6), unit(rng, 6), rng.normal(size=(5, 1, 3))
    ta, tb, tv = (torch.from_numpy(array) for array in (a, b, v))
    np.testing.assert_allclose(twin.mul(ta, tb).numpy(), quat.mul(a, b), atol=1e-15)
    np.testing.assert_allclose(twin.rotate(ta, tv).numpy(), quat.rotate(a, v), atol=1e-14)
    np.testing.assert_allclose(twin.inverse(ta).numpy(), quat.inverse(a), atol=0)
    raw = torch.from_numpy(rng.normal(size=(7, 4)) * 3)
    np.testing.assert_allclose(twin.normalize(raw).numpy(), quat.normalize(raw.numpy()), atol=1e-15)
    turned = torch.einsum("tjab,tjb->tja", twin.matrix_from_quaternion(ta), tv.expand(5, 6, 3))
    np.testing.assert_allclose(turned.numpy(), quat.rotate(a, v), atol=1e-14)


@pytest.mark.parametrize("lead", [(), (9,), (2, 3, 4)])
def test_kinematics_agree_with_numpy(twin, skeleton, rng, lead):
    rotations, root = unit(rng, *lead, len(skeleton)), rng.normal(size=(*lead, 3))
    expected = numpy_fk(skeleton, rotations, root)
    got = twin.fk(skeleton.parents, *map(torch.from_numpy, (skeleton.offsets.copy(), rotations, root)))
    for ours, reference in zip(got, expected, strict=True):
        np.testing.assert_allclose(ours.numpy(), reference, rtol=0, atol=1e-12)


def test_bones_may_differ_by_frame(twin, skeleton, rng):
    rotations, root, moved = (
        unit(rng, 6, len(skeleton)),
        rng.normal(size=(6, 3)),
        rng.normal(size=(6, len(skeleton), 3)),
    )
    expected = numpy_fk(skeleton, rotations, root, translations=moved)
    got = twin.fk(skeleton.parents, *map(torch.from_numpy, (moved, rotations, root)))
    np.testing.assert_allclose(got[1].numpy(), expected[1], rtol=0, atol=1e-12)


def test_bones_may_differ_by_sample(twin, skeleton, rng):
    rotations, root = unit(rng, 2, 5, len(skeleton)), rng.normal(size=(2, 5, 3))
    bones = rng.normal(size=(2, 1, len(skeleton), 3))
    got = twin.fk(skeleton.parents, *map(torch.from_numpy, (bones, rotations, root)))[1].numpy()
    for sample in range(2):
        expected = numpy_fk(skeleton.with_offsets(bones[sample, 0]), rotations[sample], root[sample])[1]
        np.testing.assert_allclose(got[sample], expected, rtol=0, atol=1e-12)


def test_single_precision_stays_single(twin, skeleton, rng):
    rotations, root = unit(rng, 8, len(skeleton)), rng.normal(size=(8, 3))
    got = twin.fk(
        skeleton.parents, *(torch.from_numpy(array).float() for array in (skeleton.offsets.copy(), rotations, root))
    )
    assert got[0].dtype == got[1].dtype == torch.float32
    np.testing.assert_allclose(got[1].numpy(), numpy_fk(skeleton, rotations, root)[1], atol=1e-5)


def test_gradients_of_kinematics(twin, rng):
    parents = [-1, 0, 1, 0]
    raw, bones, root = (
        torch.from_numpy(rng.normal(size=shape)).requires_grad_() for shape in ((2, 4, 4), (4, 3), (2, 3))
    )
    assert torch.autograd.gradcheck(lambda q, o, r: twin.fk(parents, o, twin.normalize(q), r), (raw, bones, root))


def test_six_numbers_give_rotations(twin, rng):
    sixd = torch.from_numpy(rng.normal(size=(11, 6))).requires_grad_()
    matrix = twin.matrix_from_sixd(sixd)
    identity = torch.eye(3, dtype=torch.float64).expand(11, 3, 3)
    torch.testing.assert_close(matrix.mT @ matrix, identity, atol=1e-12, rtol=0)
    torch.testing.assert_close(torch.linalg.det(matrix), torch.ones(11, dtype=torch.float64), atol=1e-12, rtol=0)
    # The two first columns of a rotation are its own six numbers.
    again = twin.matrix_from_sixd(torch.cat((matrix[..., 0], matrix[..., 1]), dim=-1))
    torch.testing.assert_close(again, matrix, atol=1e-12, rtol=0)
    assert torch.autograd.gradcheck(twin.matrix_from_sixd, (sixd,))


def test_a_zero_quaternion_has_a_finite_gradient(twin):
    q = torch.zeros(4, dtype=torch.float64, requires_grad=True)
    twin.normalize(q).sum().backward()
    assert torch.isfinite(q.grad).all()


def test_wrong_shapes_are_named(twin, skeleton):
    with pytest.raises(ValueError, match="10 parents need rotations"):
        twin.fk(skeleton.parents, torch.zeros(10, 3), torch.zeros(5, 9, 4), torch.zeros(5, 3))
