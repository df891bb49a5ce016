from __future__ import annotations

import inspect
import pickle

import pytest

from benchmark import errors
from benchmark.errors import BenchmarkError, MotionFileError, UnknownNameError

CLASSES = [
    cls
    for _, cls in inspect.getmembers(errors, inspect.isclass)
    if issubclass(cls, Exception) and cls.__module__ == errors.__name__
]
EXAMPLES = [
    MotionFileError("a.bvh", "bad number", line=3),
    MotionFileError("a.bvh", "empty"),
    UnknownNameError("method", "hsv", ["hsu"]),
]


@pytest.mark.parametrize("cls", CLASSES, ids=lambda cls: cls.__name__)
def test_all_are_in_one_tree_and_end_with_code_2(cls):
    assert issubclass(cls, BenchmarkError)
    assert cls.exit_code == 2
    assert cls.__doc__


@pytest.mark.parametrize(
    "error", [*EXAMPLES, *(cls("text") for cls in CLASSES if cls not in (MotionFileError, UnknownNameError))]
)
def test_all_survive_the_way_back_from_a_worker(error):
    copy = pickle.loads(pickle.dumps(error))  # noqa: S301 - made a moment ago
    assert type(copy) is type(error)
    assert str(copy) == str(error)
    assert vars(copy) == vars(error)


def test_messages_name_the_thing_and_the_fix():
    assert str(EXAMPLES[0]) == "a.bvh, line 3: bad number"
    assert str(EXAMPLES[1]) == "a.bvh: empty"
    assert str(EXAMPLES[2]) == "unknown method 'hsv'; did you mean 'hsu'? (known: hsu)"
    assert str(UnknownNameError("metric", "x", [])) == "unknown metric 'x' (known: none)"
