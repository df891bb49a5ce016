"""The page: hostile names, failing parts, budgets, and what a reader must be told."""

from __future__ import annotations

import json
import re
import shutil
from html.parser import HTMLParser

import numpy as np
import pandas as pd
import pytest

from benchmark.registry import FIGURES
from reports.build import build_report
from reports.html import boards, motion, pictures
from reports.page import LARGEST, write_page
from reports.run import RunView

#: Ends a script, opens a tag, leaves an attribute, closes a comment.
HOSTILE = '</script><script>window.broken=1</script><img src=x onerror="window.broken=1">\'--><b>&amp;'


class Elements(HTMLParser):
    """Start tags, text of scripts and all other text of a page."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.scripts, self.text, self._tag = [], [], "", ""
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self._tag = tag
        self.tags.append((tag, dict(attributes)))
        if tag == "script":
            self.scripts.append("")

    def handle_endtag(self, tag):
        self._tag = ""

    def handle_data(self, data):
        if self._tag == "script":
            self.scripts[-1] += data
        elif self._tag != "style":
            self.text += data

    def count(self, tag):
        return sum(name == tag for name, _ in self.tags)


def _copy(finished, folder):
    shutil.copytree(finished, folder, ignore=shutil.ignore_patterns("report", "figures", "tables", "stats"))
    return folder


def _hostile(folder):
    """Put the hostile text into every name that a file, a plug-in or a user can choose."""
    rows = pd.read_parquet(folder / "results.parquet")
    names = {name: name + HOSTILE for name in ("dynamic-scaling[time]",)}
    rows["method"] = rows["method"].replace(names)
    for column in ("clip_id", "actor", "action"):
        rows[column] = rows[column].where(rows[column] == "", rows[column] + HOSTILE)
    failed = rows[(rows["method"] == "identity") & (rows["variant"] == "raw")].drop_duplicates("metric")
    failed = failed.assign(method="planted" + HOSTILE, cell_key="k" * 64, status="failed", clip_id="", value=np.nan)
    failed["reason"] = "ValueError: " + HOSTILE
    metric = "style/pose-distance"
    rows = pd.concat([rows, failed], ignore_index=True)
    rows["metric"] = rows["metric"].replace({metric: metric + HOSTILE})
    rows.to_parquet(folder / "results.parquet")
    board = pd.read_csv(folder / "leaderboard.csv", keep_default_na=False)
    board["method"] = board["method"].replace(names)
    board["metric"] = board["metric"].replace({metric: metric + HOSTILE})
    board.to_csv(folder / "leaderboard.csv", index=False)
    for path in folder.glob("cells/*/items.json"):
        items = json.loads(path.read_bytes())
        for item in items:
            for key in ("clip_id", "actor", "action"):
                item[key] += HOSTILE
        path.write_text(json.dumps(items))
    plan = json.loads((folder / "plan.json").read_bytes())
    for cell in plan["shared"]:
        cell["method"] += HOSTILE
        cell["params"]["note"] = HOSTILE
    (folder / "plan.json").write_text(json.dumps(plan))
    split = json.loads((folder / "split.json").read_bytes())
    split["train"] = [f"adult/{HOSTILE.replace('/', '|')}/walk_1"]
    (folder / "split.json").write_text(json.dumps(split))
    environment = json.loads((folder / "environment.json").read_bytes())
    environment["command"] += ["--out", HOSTILE]
    environment["versions"]["numpy"] = HOSTILE
    (folder / "environment.json").write_text(json.dumps(environment))
    (folder / "config.toml").write_text(f"# {HOSTILE}\n" + (folder / "config.toml").read_text(), encoding="utf-8")
    (folder / "stats").mkdir(exist_ok=True)
    links = "[go](javascript:alert(1)) ![x](x.png)"
    text = f"# Ratings (people)\n\n{HOSTILE}\n\n- {HOSTILE}\n- {links}\n\n## Raters (people)\n\n- {HOSTILE}\n"
    (folder / "stats" / "ratings.md").write_text(text, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def hostile(finished, tmp_path_factory):
    folder = _hostile(_copy(finished, tmp_path_factory.mktemp("hostile") / "run <b>&'x"))
    return Elements(write_page(RunView(folder), []).read_text(encoding="utf-8"))


def test_hostile_names_stay_text(hostile):
    assert hostile.count("img") == 0 and hostile.count("b") == 0
    # Index, two clips, two programs.
    assert len(hostile.scripts) == 5 and not any("window.broken" in text for text in hostile.scripts[3:])
    assert not any(key.startswith("on") for _, attributes in hostile.tags for key in attributes)
    assert not any("javascript:" in str(attributes.get("href")) for _, attributes in hostile.tags)
    assert not any(tag == "a" and "x.png" in str(attributes) for tag, attributes in hostile.tags)
    # They are all there to be read: title, alarm, tables, ratings, settings.
    assert hostile.text.count(HOSTILE) > 40


def test_hostile_names_survive_in_the_data_of_the_player(hostile):
    index = json.loads(hostile.scripts[0])
    assert all(HOSTILE in clip["title"] for clip in index["clips"])
    assert any(HOSTILE in figure["label"] for figure in json.loads(hostile.scripts[1])["figures"])


def test_ids_are_unique_and_every_link_has_its_target(hostile):
    ids = [attributes["id"] for _, attributes in hostile.tags if "id" in attributes]
    assert len(ids) == len(set(ids)) and all(re.fullmatch(r"[\w-]+", name) for name in ids)
    links = [attributes["href"] for tag, attributes in hostile.tags if tag == "a"]
    assert all(link[1:] in ids for link in links if link.startswith("#"))
    for _, attributes in hostile.tags:
        for key in ("aria-labelledby", "aria-describedby", "for"):
            assert key not in attributes or attributes[key] in ids


def test_failures_are_loud(hostile):
    top = hostile.text.split("Contents")[0]
    assert "Something failed" in top and "ValueError: " + HOSTILE in top


@pytest.fixture
def run(finished, tmp_path):
    return _copy(finished, tmp_path / "run")


def test_a_part_that_fails_is_named_and_the_others_stand(run, monkeypatch):
    def fail(*_):
        raise ZeroDivisionError("planted")

    monkeypatch.delenv("BENCHMARK_DEBUG", raising=False)
    monkeypatch.setattr(boards, "task_boards", fail)
    monkeypatch.setattr(motion, "make_reel", fail)
    (run / "environment.json").write_text("{")
    page = Elements(write_page(RunView(run), []).read_text(encoding="utf-8"))
    top, _, rest = page.text.partition("Contents")
    for part in ("the leaderboard of adult:child", "the moving pictures", "the facts of the machine"):
        assert f"{part}: " in top.replace("\n", "")
    assert top.count("ZeroDivisionError: planted") == 2
    assert "There is no leaderboard." in rest and "licence" in rest and "There is nothing to play" in rest


def test_a_figure_that_fails_leaves_the_report(run, monkeypatch):
    monkeypatch.delenv("BENCHMARK_DEBUG", raising=False)
    FIGURES.register(name="planted")(lambda _: 1 / 0)
    monkeypatch.setattr(FIGURES, "names", lambda: ["planted", "pose-strips"])
    try:
        page = Elements(build_report(run).read_text(encoding="utf-8"))
    finally:
        FIGURES.unregister("planted")
    assert "the figure planted: ZeroDivisionError: division by zero" in page.text
    assert page.count("img") == len(list((run / "figures").glob("pose-strip*.png"))) > 0


def test_the_same_run_gives_the_same_page(run):
    first = write_page(RunView(run), []).read_bytes()
    assert write_page(RunView(run), []).read_bytes() == first


def test_pictures_and_motion_leave_room_for_tables(run, monkeypatch):
    assert pictures.BUDGET + motion.BUDGET <= LARGEST - 2_500_000
    bare = len(write_page(RunView(run), [], moving=False).read_bytes())
    # Three methods and two clips; tables grow with methods and tasks, not with clips.
    assert bare < 500_000
    monkeypatch.setattr("reports.page.LARGEST", bare + 120_000)
    page = write_page(RunView(run), [])
    assert page.stat().st_size <= bare + 120_000


def test_a_page_without_motion_holds_no_positions(run):
    text = write_page(RunView(run), [], moving=False).read_text(encoding="utf-8")
    assert "motion-index" not in text and "without moving pictures" in text


def test_recordings_without_a_licence_are_not_to_be_passed_on(run):
    rows = pd.read_parquet(run / "results.parquet")
    rows.assign(dataset="kinder-gator").to_parquet(run / "results.parquet")
    page = Elements(write_page(RunView(run), []).read_text(encoding="utf-8"))
    assert "Do not pass this page on." in page.text and "never: the repository has no licence file" in page.text
    assert "real child" in json.dumps([json.loads(text) for text in page.scripts[1:3]])
    assert "Aloba" in page.text and "Synthetic data." not in page.text


def test_metrics_are_explained(run):
    page = Elements(write_page(RunView(run), []).read_text(encoding="utf-8"))
    assert "Share of foot contacts in which the foot moves over the floor" in page.text
    assert "lower is better" in page.text and "best at 1" in page.text
    targets = {attributes["href"] for tag, attributes in page.tags if attributes.get("class") == "what" and tag == "a"}
    metrics = set(RunView(run).leaderboard("adult:child")["metric"])
    assert targets == {f"#{boards.metric_id(metric)}" for metric in metrics}
