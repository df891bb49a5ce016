"""Figures, tables and the page of a small real run."""

from __future__ import annotations

import re
import shutil
from html.parser import HTMLParser

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from benchmark.commands.figures import figures
from benchmark.commands.report import report
from benchmark.errors import StoreError, UnknownNameError
from reports.build import build_report, draw_figures
from reports.html.boards import OVERVIEW
from reports.run import RunView
from reports.sources import source_clip
from reports.tables import by_group, with_values


class Page(HTMLParser):
    """Collects what a test asks of a page."""

    def __init__(self, text):
        super().__init__()
        self.elements, self.data = [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.elements.append((tag, dict(attributes)))

    def handle_data(self, data):
        self.data.append(data)

    def all(self, tag):
        return [attributes for name, attributes in self.elements if name == tag]

    @property
    def text(self):
        return " ".join(" ".join(self.data).split())


@pytest.fixture(scope="module")
def page(finished):
    return Page(build_report(finished).read_text(encoding="utf-8"))


def test_page_stands_alone(page, finished):
    outside = [a for _, attributes in page.elements for k, a in attributes.items() if k in ("src", "href")]
    assert outside and not any(re.match(r"(https?:)?//", link) for link in outside)
    images = page.all("img")
    # Every drawing; among them the metrics of each group, and the landing of the jump that is one of the two clips.
    groups = by_group(with_values(RunView(finished).leaderboard("adult:child")))
    drawn = {path.stem for path in (finished / "figures").glob("*.png")}
    assert {f"metrics-adult-to-child-{group}" for group in groups} | {"jump-landing-adult-to-child"} <= drawn
    assert len(images) == len(drawn)
    assert all(image["src"].startswith("data:image/png;base64,") and len(image["alt"]) > 40 for image in images)
    ids = {attributes["id"] for _, attributes in page.elements if "id" in attributes}
    for link in page.all("a"):
        if link["href"].startswith("#"):
            assert link["href"][1:] in ids, link
        else:
            assert (finished / "report" / link["href"]).resolve().is_file(), link
    assert (finished / "report" / "index.html").stat().st_size < 25e6


def test_page_says_what_it_is(page):
    assert "Synthetic data." in page.text and "nobody performed it" in page.text
    assert "Only 2 test clips were transferred" in page.text
    for words in ("licence", "MIT", "held-out performer", "config.toml", "dataset", "numpy"):
        assert words in page.text, words
    assert {"lang": "en"} in page.all("html")


def test_page_shows_the_means_of_the_results(page, finished):
    rows = RunView(finished).results
    rows = rows[(rows["metric"] == "timing/duration-ratio") & (rows["method"] == "dynamic-scaling[time]")]
    mean = rows.loc[rows["variant"] == "raw", "value"].mean()
    shown = [float(cell["data-value"]) for cell in page.all("td") if cell.get("data-value")]
    assert np.isclose(shown, mean, rtol=1e-12).any()


def test_leaderboard_has_every_method_and_metric_once(finished):
    run = RunView(finished)
    table = run.leaderboard("adult:child")
    assert not table.duplicated(["method", "metric"]).any()
    assert set(table["method"]) == {"identity", "dynamic-scaling[time]", "child-reference"}
    assert list(dict.fromkeys(table["method"])) == ["identity", "dynamic-scaling[time]", "child-reference"]
    good = table[table["n"] > 0]
    assert ((good["low"] <= good["mean"] + 1e-12) & (good["mean"] <= good["high"] + 1e-12)).all()
    assert (table.loc[table["n"] == 0, "reason"] != "").all()


def test_tables_for_papers(finished):
    build_report(finished)
    csv = pd.read_csv(finished / "tables" / "leaderboard-adult-to-child-raw.csv")
    assert {"physics/jerk-ratio", "truth/pose-distance"} <= set(csv["metric"])
    tex = (finished / "tables" / "leaderboard-adult-to-child-raw.tex").read_text(encoding="utf-8")
    body = tex.split(r"\midrule")[1].split(r"\bottomrule")[0].strip().splitlines()
    groups = by_group(csv[csv["metric"].isin(csv.loc[csv["mean"].notna(), "metric"])])
    assert tex.count(r"\begin{tabular}") == len(groups)
    assert (
        len(body) == groups[next(iter(groups))]["metric"].nunique() and len({line.count(" & ") for line in body}) == 1
    )
    markdown = (finished / "tables" / "leaderboard-adult-to-child-raw.md").read_text(encoding="utf-8").splitlines()
    measured = csv.loc[csv["mean"].notna(), "metric"].nunique()
    assert len(markdown) == 2 + measured and len({line.count("|") for line in markdown}) == 1
    assert tex.count("{held-out performer}") == len(groups)
    assert "\npose-distance [deg]" in tex and "\npose-distance [leg]" in tex
    assert tex.count("{") == tex.count("}") and "Synthetic data" in tex


def test_the_same_run_gives_the_same_files(finished):
    first = {entry.name: (entry.pdf.read_bytes(), entry.csv.read_bytes()) for entry in draw_figures(finished)}
    second = {entry.name: (entry.pdf.read_bytes(), entry.csv.read_bytes()) for entry in draw_figures(finished)}
    assert first == second


def test_strip_numbers_are_joint_positions(finished):
    draw_figures(finished, ["pose-strips"])
    table = pd.read_csv(finished / "figures" / "pose-strip-adult-to-child.csv")
    run = RunView(finished)
    clip = source_clip(run, run.showpiece("adult:child"))
    first = table[(table["row"] == "adult input") & (table["pose"] == 0)]
    frame = round(first["seconds"].iloc[0] * clip.fps)
    np.testing.assert_allclose(first[["x", "y", "z"]], clip.positions[frame], atol=1e-9)


@pytest.fixture(scope="module")
def with_holes(finished, tmp_path_factory):
    """The finished run with one method that failed and one that was skipped, as the runner stores them."""
    folder = tmp_path_factory.mktemp("holes") / "run"
    shutil.copytree(finished, folder)
    rows = pd.read_parquet(folder / "results.parquet")
    own = rows[(rows["method"] == "identity") & (rows["variant"] == "raw")].drop_duplicates("metric")
    added = [
        own.assign(method=method, cell_key=method, status=status, reason=reason, clip_id="", value=np.nan)
        for method, status, reason in (
            ("raising", "failed", "ValueError: <planted> & 5% of_it ^2"),
            ("needs-gpu", "skipped", "needs a GPU"),
        )
    ]
    pd.concat([rows, *added]).to_parquet(folder / "results.parquet")
    return folder


def test_failed_and_skipped_methods_are_shown_with_their_reasons(with_holes):
    page = Page(build_report(with_holes).read_text(encoding="utf-8"))
    assert "failed : ValueError: <planted> & 5% of_it ^2" in page.text.replace("failed:", "failed :")
    groups = by_group(RunView(with_holes).leaderboard("adult:child"))
    # A table for each group and variant, with a row of dashes that say why, and those of the overview.
    metrics = 2 * sum(table["metric"].nunique() for table in groups.values())
    measured = set(with_values(RunView(with_holes).leaderboard("adult:child"))["metric"])
    metrics += 2 * len(measured & set(OVERVIEW))
    titles = [cell.get("title", "") for cell in page.all("td")]
    assert titles.count("needs a GPU") == metrics
    assert titles.count("ValueError: <planted> & 5% of_it ^2") == metrics
    holes = page.text.split("Metrics without a value")[1].split("config.toml")[0]
    assert "needs a GPU" not in holes and "planted" not in holes
    for variant in ("raw", "cleaned"):
        stem = with_holes / "tables" / f"leaderboard-adult-to-child-{variant}"
        tex = stem.with_suffix(".tex").read_text(encoding="utf-8")
        # Two columns of dashes, beside the three methods that have values.
        assert all(line.count("--") >= 2 for line in tex.splitlines() if line.startswith("jerk-ratio"))
        for method in ("raising", "needs-gpu"):
            assert f"{{{method}}}" in tex
            assert f" {method} |" in stem.with_suffix(".md").read_text(encoding="utf-8").splitlines()[0]
    assert (with_holes / "figures" / "pose-strip-adult-to-child.png").is_file()
    assert (with_holes / "figures" / "metrics-adult-to-child-style.png").is_file()


def test_unknown_figures_and_folders_are_refused(finished, tmp_path):
    with pytest.raises(UnknownNameError, match="did you mean 'pose-strips'"):
        draw_figures(finished, ["pose-strip"])
    with pytest.raises(StoreError, match="folder of a finished run"):
        RunView(tmp_path)


@pytest.mark.parametrize(("flags", "moving"), [([], True), (["--without-motion"], False)])
def test_report_command_can_leave_the_motion_out(finished, monkeypatch, flags, moving):
    asked = []
    monkeypatch.setattr(
        "reports.build.build_report", lambda folder, **options: asked.append(options) or folder / "page"
    )
    result = CliRunner().invoke(report, [str(finished), *flags])
    assert result.exit_code == 0 and result.output == f"report: {finished / 'page'}\n"
    assert [options["moving"] for options in asked] == [moving]


def test_a_broken_figure_does_not_stop_the_others(finished, monkeypatch):
    def broken(run):
        raise ValueError("planted")

    monkeypatch.setattr("reports.figures.tempo.tempo", broken)
    result = CliRunner().invoke(
        figures, [str(finished), "--only", "tempo", "--only", "style-similarity", "--only", "loss-curves"]
    )
    assert result.exit_code == 1
    assert "tempo: failed: ValueError: planted" in result.output
    assert "style-similarity.png" in result.output
    assert "loss-curves: nothing to draw: no method of this run stored loss curves" in result.output


def test_bars_and_histograms_hold_what_was_stored(finished):
    draw_figures(finished, ["style-similarity", "tempo"])
    run = RunView(finished)
    bars = pd.read_csv(finished / "figures" / "style-similarity.csv").set_index(["metric", "method"])["mean"]
    board = run.leaderboard("adult:child").set_index(["metric", "method"])["mean"]
    np.testing.assert_allclose(bars, board.loc[bars.index], rtol=1e-12)
    shown = pd.read_csv(finished / "figures" / "tempo-adult-to-child.csv")
    rows = run.results
    rows = rows[(rows["variant"] == "raw") & (rows["status"] == "ok") & rows["metric"].isin(shown["metric"].unique())]
    np.testing.assert_allclose(sorted(shown["value"]), sorted(rows["value"]), rtol=1e-12)


def test_captions_say_n(finished):
    captions = {
        entry.name: entry.caption
        for entry in draw_figures(finished, ["pose-strips", "style-*", "tempo", "trajectories"])
    }
    assert captions and all("n = " in caption for caption in captions.values()), captions


def test_figures_command_names_the_files(finished):
    result = CliRunner().invoke(figures, [str(finished), "--only", "metric-*"])
    assert result.exit_code == 0 and "metrics-adult-to-child-style.png" in result.output
