"""The side-by-side timing of alignments strikes off what is wrong and says why a library is missing."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

FOLDER = Path(__file__).resolve().parents[1] / "speed"
NAMES = ("timing", "bench_dtw")


class Silent:
    def print(self, *words: object, **_: object) -> None:
        pass


@pytest.fixture
def bench(monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    for name in NAMES:
        monkeypatch.delitem(sys.modules, name, raising=False)
    yield importlib.import_module("bench_dtw")
    for name in NAMES:
        sys.modules.pop(name, None)


def straight(case):
    """The diagonal: a path, but not the cheapest."""
    frames = np.arange(len(case.x))
    return np.stack((frames, frames), axis=1)


def absent(case):
    raise ImportError("no such library")


def test_the_total_along_a_path_is_that_of_its_cells(bench):
    case = bench.Case(12)
    from benchmark.motion.dtw import dtw

    assert case.along(dtw(case.x, case.y).path) == pytest.approx(case.cost, rel=1e-12)
    squared = ((case.x - case.y) ** 2).sum(axis=1)
    assert case.along(straight(case)) == pytest.approx(squared.sum())
    assert case.along(straight(case), plain=True) == pytest.approx(np.sqrt(squared).sum())
    assert case.excess(straight(case)) > 0.0


@pytest.mark.parametrize(
    "spoil",
    [
        lambda path: path[1:],
        lambda path: path[:-1],
        lambda path: path[::-1],
        lambda path: np.delete(path, 5, axis=0),
        lambda path: np.repeat(path, 2, axis=0),
    ],
)
def test_what_is_no_path_is_refused(bench, spoil):
    case = bench.Case(12)
    with pytest.raises(ValueError, match="no path from corner to corner"):
        case.along(spoil(straight(case)))


def test_a_right_cost_does_not_excuse_a_wrong_path(bench):
    case = bench.Case(12)
    with pytest.raises(ValueError, match="along its path"):
        case.check(case.cost, straight(case))


def test_costs_by_a_product_are_the_squared_distances(bench):
    case = bench.Case(9)
    expected = ((case.x[:, None] - case.y[None]) ** 2).sum(axis=-1)
    np.testing.assert_allclose(bench.squared_distances(case.x, case.y), expected, rtol=1e-9, atol=1e-12)


def test_rows_say_why_a_library_is_missing_and_how_near_an_approximate_one_comes(bench):
    def wrong(case):
        case.check(case.cost, straight(case))
        return lambda: None

    peers = {
        "clashing": bench.Peer(absent, apart="needs an older pandas"),
        "absent": bench.Peer(absent),
        "slow": bench.Peer(absent, most=10),
        "wrong": bench.Peer(wrong),
        "rough": bench.Peer(lambda case: lambda: straight(case), approximate=True),
    }
    rows = bench.run(Silent(), sizes={16: 1}, peers=peers)
    notes = {row["what"]: row.get("note") for row in rows}
    assert notes["clashing"] == "needs an older pandas"
    assert notes["absent"] == "not installed"
    assert notes["slow"] == "loops in Python: up to 10 frames"
    assert notes["wrong"].startswith("fails: ValueError: the cost along its path")
    case = bench.Case(16)
    named = f"rough, approximate: {case.excess(straight(case)):.2%} above"
    assert named in notes
    assert {row["what"] for row in rows if row["value"] is not None} == {"ours", named}


def test_a_size_that_may_not_fit_the_memory_is_not_tried(bench, monkeypatch):
    monkeypatch.setattr(bench.psutil, "virtual_memory", lambda: SimpleNamespace(available=1000))
    rows = bench.run(Silent(), sizes={16: 1}, peers={"large": bench.Peer(absent)})
    assert next(row["note"] for row in rows if row["what"] == "large").endswith("GB of memory")
