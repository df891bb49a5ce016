from __future__ import annotations

import pytest

from benchmark.errors import StoreError
from benchmark.registry import Registry
from benchmark.runner.progress import Quiet
from benchmark.runner.run import score
from benchmark.runner.score import SCORES, SCORES_MARK
from benchmark.runner.views import LEADERBOARD, MARK, read_leaderboard


@pytest.fixture
def metrics():
    return Registry("metric", "test.none", "fakebench:GOOD_METRICS")


@pytest.fixture
def finished(make, go):
    return go(make("copy", "noisy")).folder


def again(folder, metrics, **options):
    return score(folder, Quiet(), metrics=metrics, opener="fakebench:open_fake", **options)


def stamps(folder):
    return {path: path.stat().st_mtime_ns for path in folder.glob("cells/*/status.json")}


def test_nothing_to_do_is_nothing_done(finished, metrics):
    before = stamps(finished)
    outcome = again(finished, metrics)
    assert (outcome.executed, outcome.scored, outcome.rebuilt) == (0, 0, False)
    assert stamps(finished) == before


def test_a_new_metric_is_scored_without_refitting(finished, metrics, results, monkeypatch, tmp_path):
    (tmp_path / "metric_under_test.py").write_text(
        "from fakebench import Height\nfrom benchmark.api import MetricInfo\nclass Twice(Height):\n"
        "    info = MetricInfo(name='test/twice', summary='s', unit='m', direction='none')\n"
        "    def compute(self, sample):\n        return 2 * super().compute(sample)\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    before, cells = results(finished), stamps(finished)
    metrics.register("test/twice", "metric_under_test:Twice")
    outcome = again(finished, metrics)
    assert (outcome.executed, outcome.scored) == (0, 3)
    assert stamps(finished) == cells
    after = results(finished)
    assert [row for row in after if row["metric"] != "test/twice"] == before
    heights = [row["value"] for row in after if row["metric"] == "test/height"]
    assert [row["value"] for row in after if row["metric"] == "test/twice"] == [2 * value for value in heights]


def test_changed_code_of_a_metric_is_scored_again_and_alone(finished, metrics, results, monkeypatch, tmp_path):
    path = tmp_path / "metric_edited.py"
    text = (
        "from fakebench import Height\nfrom benchmark.api import MetricInfo\nclass Edited(Height):\n"
        "    info = MetricInfo(name='test/edited', summary='s', unit='m', direction='none')\n"
        "    def compute(self, sample):\n        return {}\n"
    )
    path.write_text(text.format("1.0"))
    monkeypatch.syspath_prepend(str(tmp_path))
    metrics.register("test/edited", "metric_edited:Edited")
    assert again(finished, metrics).scored == 3
    assert again(finished, metrics).scored == 0
    path.write_text(text.format("22.0"))
    assert again(finished, metrics).scored == 3
    assert {row["value"] for row in results(finished) if row["metric"] == "test/edited"} == {22.0}


def test_forcing_computes_the_same_values(finished, metrics, results):
    before = results(finished)
    assert again(finished, metrics, force=True).scored == 3
    assert again(finished, metrics, requests=["test/height"], force=True).scored == 3
    assert results(finished) == before


@pytest.mark.parametrize("name", [SCORES, SCORES_MARK])
@pytest.mark.parametrize("how", ["removed", "garbled"])
def test_damaged_scores_are_computed_again(finished, metrics, results, name, how):
    before = results(finished)
    path = next(finished.glob(f"cells/*/{name}"))
    if how == "removed":
        path.unlink()
    else:
        path.write_bytes(path.read_bytes()[:-5])
    outcome = again(finished, metrics)
    assert (outcome.executed, outcome.scored) == (0, 1)
    assert results(finished) == before


def test_scores_of_two_data_sets_do_not_mix(finished, metrics, monkeypatch, fakes):
    marks = {path: path.read_bytes() for path in finished.glob(f"cells/*/{SCORES_MARK}")}
    monkeypatch.setattr(fakes.Fake, "digest", property(lambda self: "f" * 64))
    with pytest.raises(
        StoreError, match=r"data set fake is not the one that .* was run on: its digest is ffffffffffff"
    ):
        again(finished, metrics, force=True)
    assert {path: path.read_bytes() for path in finished.glob(f"cells/*/{SCORES_MARK}")} == marks
    assert again(finished, metrics).scored == 0, "what needs no data set goes on"


@pytest.mark.parametrize("name", ["results.parquet", "leaderboard.csv", MARK])
def test_altered_views_are_rebuilt(finished, metrics, name):
    content = (finished / name).read_bytes()
    middle = len(content) // 2
    (finished / name).write_bytes(content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :])
    assert again(finished, metrics).rebuilt
    assert (finished / name).read_bytes() == content


def test_a_marker_that_is_no_json_vouches_for_nothing(finished, metrics):
    (finished / MARK).write_text("{")
    assert again(finished, metrics).rebuilt
    assert not again(finished, metrics).rebuilt


def test_a_run_without_tables_says_how_to_get_them(finished, metrics):
    (finished / LEADERBOARD).unlink()
    with pytest.raises(StoreError, match=r"leaderboard\.csv is missing: .*benchmark score"):
        read_leaderboard(finished)
    again(finished, metrics)
    assert read_leaderboard(finished)


@pytest.mark.parametrize("name", ["results.parquet", "leaderboard.csv"])
def test_lost_views_are_rebuilt(finished, metrics, name):
    before = (finished / name).read_bytes()
    (finished / name).unlink()
    assert again(finished, metrics).rebuilt
    assert (finished / name).read_bytes() == before
