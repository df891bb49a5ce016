"""Estimates come from what was measured, say how sure they are, and get better by what is measured next."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from benchmark.runner import costs
from benchmark.runner.costs import Meter, Record, Work, estimate, power_law
from benchmark.runner.progress import Quiet
from benchmark.runner.run import cell_states


@pytest.fixture(autouse=True)
def ledger(tmp_path, monkeypatch):
    monkeypatch.setenv("BENCHMARK_CACHE", str(tmp_path / "cache"))
    return costs.ledger_path()


def record(train=10, test=4, fit=2.0, other=1.0, **changes) -> Record:
    return Record(
        **{
            "method": "m",
            "params": "p",
            "train": train,
            "test": test,
            "variants": 2,
            "device": "cpu",
            "threads": 1,
            "processor": "here",
            "fit_seconds": fit,
            "other_seconds": other,
            "memory": 1e8,
            "disk": 1e6,
            **changes,
        }
    )


def work(train=10, test=4, **changes) -> Work:
    return replace(Work("key", "m", "p", train, test, 2, "cpu", 1), **changes)


@pytest.mark.parametrize("slope", [0.0, 0.7, 1.0, 2.0])
def test_a_power_law_is_found_whatever_one_point_says(slope):
    points = [(x, 3.0 * x**slope) for x in (10, 20, 40, 80, 160)]
    guess = power_law([*points, (50, 1e5)], 320.0)
    assert guess.value == pytest.approx(3.0 * 320.0**slope, rel=0.02)
    assert guess.low < guess.value < guess.high


def test_one_size_is_carried_over_with_a_wider_range():
    near, far = power_law([(10, 5.0), (10, 5.0)], 10), power_law([(10, 5.0), (10, 5.0)], 100)
    assert (near.value, far.value) == (pytest.approx(5.0), pytest.approx(50.0))
    assert near.high / near.value == pytest.approx(costs.LEAST)
    assert far.high / far.value > 3.0
    assert power_law([(10, 5.0)], 100, slope=0.0).value == pytest.approx(5.0)
    assert power_law([(10, 0.0)], 10) == costs.NOTHING


def test_nothing_is_guessed_of_what_was_never_measured():
    found = estimate([work(), work(key="b", method="other")], [record()], jobs=2, processor="here")
    assert found.unknown == 1
    assert found.works["b"] is None
    assert found.wall.value == pytest.approx(3.0)
    none = estimate([work(device="cuda")], [record()], jobs=1, processor="here")
    assert (none.unknown, none.wall.value) == (1, 0.0)


def test_the_same_settings_and_machine_count_before_others():
    records = [record(fit=2.0), record(fit=50.0, params="q"), record(fit=9.0, processor="there")]
    same = estimate([work()], records, jobs=1, processor="here").works["key"]
    assert same is not None
    assert same.seconds.value == pytest.approx(3.0)
    assert same.basis == "1 measurement of the same settings"
    other = estimate([work(params="r")], records[:1], jobs=1, processor="elsewhere").works["key"]
    assert other is not None
    assert other.basis == "1 measurement of other settings, another machine"
    assert other.seconds.high / other.seconds.value == pytest.approx(costs.LEAST * 6.0)


def test_the_wall_is_that_of_processes_that_take_turns():
    works = [work(key=str(index)) for index in range(5)]
    for jobs, seconds in [(1, 15.0), (2, 9.0), (5, 3.0), (50, 3.0)]:
        assert estimate(works, [record()], jobs=jobs, processor="here").wall.value == pytest.approx(seconds)
    probe = work(key="probe", first=True)
    found = estimate([probe, *works], [record()], jobs=2, processor="here")
    assert found.wall.value == pytest.approx(3.0 + 9.0)
    assert found.memory.value == pytest.approx(2e8)
    assert found.disk.value == pytest.approx(6e6)


def test_the_ledger_survives_what_is_no_line_and_stays_small(ledger, monkeypatch):
    assert costs.read_ledger() == []
    costs.keep([record(train=index) for index in range(3)])
    with ledger.open("a") as file:
        file.write('garbage\n[1]\n{"method": "m"}\n' + json.dumps({**costs.asdict(record()), "disk": "much"}) + "\n")
        file.write(json.dumps({**costs.asdict(record()), "disk": float("nan")}) + "\n")
    assert [entry.train for entry in costs.read_ledger()] == [0, 1, 2]
    monkeypatch.setattr(costs, "KEPT", 30)
    costs.keep([record(fit=float(index)) for index in range(1000)])
    assert [entry.train for entry in costs.read_ledger()] == [0, 1, 2] + [10] * costs.EACH
    costs.keep([record(train=index) for index in range(100)])
    assert [entry.train for entry in costs.read_ledger()] == list(range(70, 100))


def test_the_next_estimate_is_better(make, go):
    prepared = make("copy[pause=0.3]", "noisy")
    works = costs.pending(prepared, cell_states(prepared))
    assert [entry.method for entry in works] == ["copy", "noisy", "child-reference"]
    assert {(entry.train, entry.test) for entry in works} == {
        (len(prepared.splits[0].train), len(prepared.splits[0].test))
    }
    # A first measurement that was much too long.
    wild = [
        Record(entry.method, entry.params, entry.train, entry.test, 2, "cpu", 1, "here", 60.0, 0.1, 1.0, 1.0)
        for entry in works
    ]
    costs.keep(wild)

    def guess():
        return estimate(works, costs.read_ledger(), jobs=1, processor="here")

    first = guess()
    meter = Meter(Quiet())
    outcome = go(prepared, observer=meter)
    assert set(meter.seconds) == {entry.key for entry in works}
    found = costs.measured(works, prepared.folder, outcome.states, meter.seconds, "here")
    assert min(entry.fit_seconds for entry in found if entry.method == "copy") >= 0.3
    assert all(entry.memory > 1e6 and entry.disk > 1e3 for entry in found)
    costs.keep(found * 3)
    took = sum(meter.seconds.values())
    assert abs(guess().wall.value - took) < 0.5 * abs(first.wall.value - took)
    assert "outside the range" in costs.error_line(first, took)
    assert costs.document(first, took)["relative_error"] > 1.0
    # What is there needs no estimate.
    assert costs.pending(make("copy[pause=0.3]", "noisy"), cell_states(prepared)) == []
