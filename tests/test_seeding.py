from __future__ import annotations

import numpy as np
import pytest

from benchmark.errors import ConfigError, UnknownNameError
from benchmark.seeding import AXES, Seeds, generator, seed_for


def test_a_seed_depends_on_every_axis_and_not_on_their_order():
    base = {"dataset": "d", "task": "a:b", "method": "m", "repetition": 0}
    seeds = {
        seed_for(**{**base, axis: value})
        for axis, value in [("dataset", "e"), ("task", "b:a"), ("method", "n"), ("repetition", 1)]
    }
    assert len(seeds | {seed_for(**base)}) == 5
    assert seed_for(**dict(reversed(base.items()))) == seed_for(**base)


def test_seeds_never_change():
    assert seed_for(dataset="synthetic", task="adult:child", method="hsu", repetition=3) == 5875960686654419960


def test_seeds_fit_a_signed_64_bit_column_and_fill_it():
    seeds = [seed_for(repetition=i) for i in range(500)]
    assert len(set(seeds)) == 500
    assert all(0 <= seed < 2**63 for seed in seeds)
    assert max(seeds) > 2**62


@pytest.mark.parametrize("axis", ["jobs", "out", "repetitions"])
def test_an_unknown_axis_is_an_error(axis):
    with pytest.raises(UnknownNameError, match=axis):
        seed_for(**{axis: 1})


def test_no_axis_or_no_plain_value_is_an_error():
    with pytest.raises(ConfigError):
        seed_for()
    for value in (1.5, True, None):
        with pytest.raises(ConfigError, match="repetition"):
            seed_for(repetition=value)


def test_generators_repeat_and_leave_global_state_alone():
    before = np.random.get_state()[1].copy()  # noqa: NPY002 - the global state is what must stay as it is
    first, second = generator(method="a").normal(size=5), generator(method="a").normal(size=5)
    assert np.array_equal(first, second)
    assert not np.array_equal(first, generator(method="b").normal(size=5))
    assert np.array_equal(before, np.random.get_state()[1])  # noqa: NPY002


def test_axes_are_named_once():
    assert len(set(AXES)) == len(AXES)


def test_many_seeds_are_those_asked_for_one_by_one():
    many = Seeds(("repetition",), seed=7, dataset="a", task="é:ü", method="m")
    for repetition in (0, 1, 99):
        assert many(repetition=repetition) == seed_for(
            seed=7, dataset="a", task="é:ü", method="m", repetition=repetition
        )
    with pytest.raises(UnknownNameError, match="colour"):
        Seeds(("repetition",), colour=3)
    with pytest.raises(ConfigError, match="must be a string or an integer"):
        many(repetition=1.5)
