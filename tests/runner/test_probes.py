from __future__ import annotations

import pytest

from benchmark.api import Probe, ProbeInfo
from benchmark.config import load_config
from benchmark.errors import ContractError, UnknownNameError
from benchmark.registry import Registry
from benchmark.runner.probes import probe_store
from benchmark.runner.progress import Quiet
from benchmark.runner.run import prepare, run, score
from benchmark.runner.selection import choose_metrics, choose_probe

METHODS = Registry("method", "test.none", "fakebench:METHODS")
PROBES = Registry("probe", "test.none", "fakebench:PROBES")


@pytest.fixture
def metrics():
    return Registry("metric", "test.none", "fakebench:PROBED_METRICS")


@pytest.fixture
def start(metrics, tmp_path):
    """``start(**settings)``: run copy and noisy and score them through probes."""

    def start(observer=None, **settings):
        flags = {"methods": ("copy", "noisy"), "out": tmp_path / "run", "dataset": {"name": "fake"}, **settings}
        known = {"methods": METHODS, "metrics": metrics}
        opener = "fakebench:open_fake"
        prepared = prepare(load_config(flags=flags), **known, probes=PROBES, opener=opener, gpu=lambda: False)
        return run(prepared, observer or Quiet(), **known)

    return start


class Watch(Quiet):
    def __init__(self):
        self.finished = []

    def cell_finished(self, cell, state, reason, seconds):
        self.finished.append((cell.title, state, reason))

    @property
    def probes(self):
        return [(title, state) for title, state, _ in self.finished if title.startswith("probe ")]


def by_metric(rows, name):
    return [row for row in rows if row["metric"] == name]


def test_a_probe_is_fitted_once_and_seen_by_every_cell(start, results):
    watch = Watch()
    outcome = start(watch)
    assert sorted(watch.probes) == [
        ("probe blind adult:child", "skipped"),
        ("probe lame adult:child", "failed"),
        ("probe mean-height adult:child", "ok"),
    ]
    assert len(watch.finished) == len(outcome.cells) + 3
    assert not outcome.failures
    rows = results(outcome.folder)
    heights = {(row["method"], row["clip_id"], row["variant"]): row["value"] for row in by_metric(rows, "test/height")}
    probed = by_metric(rows, "probed/height")
    gaps = [heights[row["method"], row["clip_id"], row["variant"]] - row["value"] for row in probed]
    assert len(probed) == len(heights)
    assert max(gaps) - min(gaps) < 1e-12
    assert len({row["probe_digest"] for row in probed}) == 1
    assert all(row["probe_digest"] == "" for row in by_metric(rows, "test/height"))
    assert len({row["value"] for row in by_metric(rows, "probed/drawn")}) == 1


def test_rows_say_why_there_is_no_value(start, results):
    rows = results(start().folder)
    (blind,) = {(row["status"], row["reason"]) for row in by_metric(rows, "probed/blind")}
    assert blind == ("skipped", "probe blind: nothing to learn from")
    (lame,) = {(row["status"], row["reason"]) for row in by_metric(rows, "probed/lame")}
    assert lame == ("failed", "probe lame: ValueError: it hurts")


def test_only_a_failed_probe_is_tried_again(start, results, monkeypatch):
    start()
    watch = Watch()
    outcome = start(watch)
    assert watch.probes == [("probe lame adult:child", "failed")]
    assert outcome.executed == 0
    monkeypatch.setenv("FAKE_LAME", "heal")
    outcome = start(watch, backend="serial")
    assert {row["status"] for row in by_metric(results(outcome.folder), "probed/lame")} == {"ok"}
    watch = Watch()
    assert start(watch).scored == 0
    assert watch.finished == []


def test_a_probe_that_ends_its_process_harms_no_other(start, results, monkeypatch):
    monkeypatch.setenv("FAKE_LAME", "abort")
    outcome = start()
    rows = results(outcome.folder)
    assert {row["status"] for row in by_metric(rows, "probed/height")} == {"ok"}
    lame = by_metric(rows, "probed/lame")
    assert {row["status"] for row in lame} == {"failed"}


def test_scoring_again_reads_the_probe(start, metrics, results):
    folder = start().folder
    before = results(folder)
    watch = Watch()
    known = {"metrics": metrics, "probes": PROBES, "opener": "fakebench:open_fake"}
    score(folder, watch, requests=["probed/height", "probed/drawn"], force=True, **known)
    assert ("probe mean-height adult:child", "ok") not in watch.probes
    assert results(folder) == before


def test_a_damaged_probe_is_fitted_again_to_the_same(start, metrics, results):
    folder = start().folder
    before = results(folder)
    store = probe_store(folder)
    (file,) = store.cells.glob("*/model/probe.json")
    file.write_text("[0.0, 0.0]")
    watch = Watch()
    known = {"metrics": metrics, "probes": PROBES, "opener": "fakebench:open_fake"}
    score(folder, watch, requests=["probed/height"], force=True, **known)
    assert ("probe mean-height adult:child", "ok") in watch.probes
    assert results(folder) == before


def test_the_number_of_processes_changes_nothing(start, results, tmp_path):
    one = results(start(out=tmp_path / "one", jobs=1).folder)
    two = results(start(out=tmp_path / "two", jobs=2).folder)
    for row in (*one, *two):
        row.pop("run")
    assert one == two


def test_changed_code_of_a_probe_changes_the_metric(metrics, tmp_path, monkeypatch):
    text = "from fakebench import MeanHeight\n\n\nclass Here(MeanHeight):\n    pass  # {}\n"
    (tmp_path / "probe_edited.py").write_text(text.format(1))
    monkeypatch.syspath_prepend(str(tmp_path))
    probes = Registry("probe", "test.none", "fakebench:PROBES")
    digests = []
    for revision in (1, 2):
        (tmp_path / "probe_edited.py").write_text(text.format(revision))
        probes = Registry("probe", "test.none", "fakebench:NO_PROBES")
        probes.register("mean-height", "probe_edited:Here")
        digests.append(choose_metrics(metrics, ["probed/height"], probes)[0].digest)
    assert digests[0] != digests[1]


def test_an_unknown_probe_is_named(metrics):
    none = Registry("probe", "test.none", "fakebench:NO_PROBES")
    with pytest.raises(UnknownNameError, match="unknown probe 'mean-height'"):
        choose_metrics(metrics, ["probed/height"], none)
    assert "unknown probe" in choose_metrics(metrics, ["probed/*"], none)[0].error


def test_what_is_no_probe_is_refused():
    probes = Registry("probe", "test.none", "fakebench:NO_PROBES")
    probes.register("height", "fakebench:Height")
    with pytest.raises(ContractError, match="not a complete subclass of Probe"):
        choose_probe(probes, "height")
    probes.register("other", "fakebench:MeanHeight")
    with pytest.raises(ContractError, match="calls itself 'mean-height'"):
        choose_probe(probes, "other")

    class Local(Probe):
        info = ProbeInfo("local", "s")

        def fit(self, train, task, *, rng, ctx):
            return self

        def save(self, folder):
            pass

        @classmethod
        def load(cls, folder):
            return cls()

    probes.register(Local)
    with pytest.raises(ContractError, match="define it in a module"):
        choose_probe(probes, "local")
