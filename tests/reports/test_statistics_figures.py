"""Figures of the statistics: what they draw is what is stored, nothing is cut or drawn over, and simulated is said."""

from __future__ import annotations

import csv
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from benchmark.api import NotApplicableError
from benchmark.runner.views import LEADERBOARD_COLUMNS
from eval.ratings.reading import PEOPLE, SIMULATED
from eval.stats import critical_difference as nemenyi
from eval.stats import rank_groups
from reports.figures.ablations import ablation_forest, differences, variants_of
from reports.figures.critical_difference import bars, critical_difference, diagrams, levels
from reports.figures.headline import headline_metrics
from reports.figures.rating_boxes import boxes, brackets, order_conditions, rating_drawing, ratings, stars

TASK = "adult:child"
METRICS = {"style/d-s": "lower", "content/pose-distance": "lower", "physics/jerk-ratio": "target"}
LONG = [
    "identity",
    "dynamic-scaling[length]",
    "dynamic-scaling[both]",
    "hsu",
    "holden",
    "cyclegan",
    "cyclegan-kc[eq14]",
]


def boxes_of(figure):
    """The extent in pixels of every text that says something, with the text."""
    from matplotlib.text import Text

    renderer = figure.canvas.get_renderer()
    figure.draw(renderer)
    texts = [text for text in figure.findobj(Text) if text.get_text().strip() and text.get_visible()]
    return [(text.get_text(), text.get_window_extent(renderer)) for text in texts]


def assert_nothing_is_cut(figure):
    renderer = figure.canvas.get_renderer()
    figure.draw(renderer)
    drawn, (width, height) = figure.get_tightbbox(renderer), figure.get_size_inches()
    assert drawn.x0 > -0.01 and drawn.y0 > -0.01, drawn
    assert drawn.x1 < width + 0.01 and drawn.y1 < height + 0.01, (drawn, width, height)


def ranks(methods, seed=0, n=40):
    rng = np.random.default_rng(seed)
    parts = []
    for metric, direction in METRICS.items():
        rank = np.sort(rng.uniform(1, len(methods), len(methods)))
        cd = nemenyi(n, len(methods))
        groups = rank_groups(rank, cd)
        parts.append(
            pd.DataFrame(
                {
                    "task": TASK,
                    "variant": "raw",
                    "direction": direction,
                    "metric": metric,
                    "method": rng.permutation(methods),
                    "mean_rank": rank,
                    "groups": [" ".join(str(b) for b, bar in enumerate(groups) if i in bar) for i in range(len(rank))],
                    "cd": cd,
                    "p": 1e-4,
                    "n": n,
                    "k": len(methods),
                }
            )
        )
    return pd.concat(parts, ignore_index=True)


def run_of(folder, methods):
    (folder / "stats").mkdir(parents=True, exist_ok=True)
    rows = [
        {
            "task": TASK,
            "method": method,
            "status": "ok",
            "clip_id": f"c{clip}",
            "actor": f"a{clip % 4}",
            "repetition": r,
        }
        for method in methods
        for clip in range(8)
        for r in range(2)
    ]
    with (folder / "leaderboard.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, LEADERBOARD_COLUMNS)
        writer.writeheader()
        for metric, direction in METRICS.items():
            row = dict.fromkeys(LEADERBOARD_COLUMNS, 1)
            row |= {"metric": metric, "direction": direction, "unit": "deg", "method": methods[0]}
            row |= {"source_style": "adult", "target_style": "child", "task": TASK}
            writer.writerow({name: row[name] for name in LEADERBOARD_COLUMNS})
    return SimpleNamespace(
        folder=folder,
        tasks=[TASK],
        results=pd.DataFrame(rows),
        dataset_title="Planted data",
        real_method="child-reference",
        methods=lambda task: list(methods),
        label=str,
    )


def test_one_metric_stands_for_each_group():
    there = ["style/pose-distance", "style/d-s", "mine/thing", "physics/odd", "jump/arm-swing", "mine/other"]
    assert headline_metrics(there) == ["style/d-s", "physics/odd", "mine/thing"]
    assert headline_metrics(there, also=("mine/other", "none/there"))[-1] == "mine/other"


def test_bars_are_the_stored_groups():
    table = pd.DataFrame({"mean_rank": [1.0, 2.0, 2.5, 4.0], "groups": ["0", "0 1", "1", np.nan]})
    assert bars(table) == [(1.0, 2.0), (2.0, 2.5)]
    # Bars that would touch lie on different levels, those far apart on the same.
    assert levels([(1.0, 2.0), (2.0, 2.5), (4.0, 5.0)]) == [0, 1, 0]


@pytest.mark.parametrize("count", [3, 7, 14])
def test_a_critical_difference_diagram_has_every_method_and_cuts_none(count):
    methods = [f"{LONG[i % 7]}{'' if i < 7 else i}" for i in range(count)]
    table = ranks(methods)
    figure = diagrams(table, {name: name for name in methods})
    assert_nothing_is_cut(figure)
    # A long name stands on two lines.
    written = [(text.replace("\n", ""), extent) for text, extent in boxes_of(figure)]
    for method in methods:
        assert [text for text, _ in written].count(method) == len(METRICS)
    names = [(text, extent) for text, extent in written if text in methods]
    for index, (text, one) in enumerate(names):
        for other, two in names[index + 1 :]:
            assert not one.overlaps(two), f"{text} over {other}"


def test_where_friedman_finds_nothing_there_is_one_bar_and_it_is_said():
    table = ranks(LONG).assign(p=0.4)
    figure = diagrams(table[table["metric"] == "style/d-s"], {name: name for name in LONG})
    thick = [line for line in figure.axes[0].lines if line.get_linewidth() > 2]
    assert len(thick) == 1
    assert any("Friedman p = 0.40: not told apart" in text for text, _ in boxes_of(figure))
    assert not any(text.startswith("CD") for text, _ in boxes_of(figure))


def test_the_diagram_of_a_run_says_n_actors_and_the_test(tmp_path):
    run = run_of(tmp_path, LONG)
    with pytest.raises(NotApplicableError, match="benchmark analyze"):
        critical_difference(run)
    ranks(LONG).to_csv(tmp_path / "stats" / "metrics-ranks.csv", index=False)
    (drawing,) = critical_difference(run)
    assert drawing.name == "critical-difference-adult-to-child"
    for word in ("40 test clips of 4 actors", "Nemenyi", "alpha 0.05", "depend on one another"):
        assert word in drawing.caption
    assert set(drawing.data["metric"]) == set(METRICS)
    # A metric of few clips gives way.
    few = ranks(LONG)
    few.loc[few["metric"] == "style/d-s", "n"] = 3
    few.to_csv(tmp_path / "stats" / "metrics-ranks.csv", index=False)
    assert "style/d-s" not in set(critical_difference(run)[0].data["metric"])


def conditions(names, kind=SIMULATED):
    rng = np.random.default_rng(1)
    rows = []
    for name in names:
        row = {"condition": name, "raters": 36, "clips": 10, "kind": kind}
        for question, low, high in (("child", 0, 1), ("naturalness", 1, 7)):
            values = np.sort(rng.uniform(low, high, 5))
            row |= {f"{question}_{key}": v for key, v in zip(("min", "q1", "median", "q3", "max"), values, strict=True)}
            mean = "child_share" if question == "child" else "naturalness_mean"
            ends = (
                ("child_low", "child_high")
                if question == "child"
                else ("naturalness_low_clips", "naturalness_high_clips")
            )
            row |= {mean: values[2], ends[0]: values[1], ends[1]: values[3]}
        rows.append(row)
    return pd.DataFrame(rows)


def contrasts(names, reject=lambda a, b: True, low=0.1):
    rows = [
        {"sample": "attentive", "question": question, "a": a, "b": b, "reject": reject(a, b), "p_holm": 0.004}
        for question in ("child", "naturalness")
        for index, a in enumerate(names)
        for b in names[index + 1 :]
    ]
    return pd.DataFrame(rows).assign(low_clips=low, high_clips=0.3)


FIVE = ["child", "adult", "ours", "holden", "aberman"]
NINE = ["adult", *LONG, "child"]


def test_real_motion_stands_at_the_ends():
    assert order_conditions(FIVE, ("adult", "child")) == ["adult", "ours", "holden", "aberman", "child"]
    assert [stars(p) for p in (0.05, 0.049, 0.009, 0.0009)] == ["", "*", "**", "***"]


def test_brackets_are_the_significant_pairs():
    order = order_conditions(FIVE, ("adult", "child"))
    table = contrasts(FIVE, reject=lambda a, b: {a, b} in ({"adult", "ours"}, {"adult", "child"}))
    of = table[table["question"] == "child"]
    assert brackets(of, order, ("adult", "child")) == [(0, [(1, "**")]), (0, [(4, "**")])]
    doubtful = of.assign(low_clips=-0.1)
    assert brackets(doubtful, order, ("adult", "child"))[0] == (0, [(1, "(**)")])
    # With many conditions: one bracket for each kind of real motion, pairs among methods left to the table.
    many = contrasts(NINE, reject=lambda a, b: "adult" in (a, b) or {a, b} == {"hsu", "holden"})
    order = order_conditions(NINE, ("adult", "child"))
    found = brackets(many[many["question"] == "child"], order, ("adult", "child"))
    assert found == [(0, [(i, "**") for i in range(1, 9)]), (8, [(0, "**")])]


@pytest.mark.parametrize("names", [FIVE, NINE], ids=["five", "nine"])
@pytest.mark.parametrize("kind", [SIMULATED, PEOPLE])
def test_boxes_are_drawn_whole_and_say_whose_ratings_they_are(names, kind):
    table = conditions(names, kind)
    labels = {name: name for name in names}
    figure = boxes(table, contrasts(names), styles=("adult", "child"), kind=kind, labels=labels)
    assert_nothing_is_cut(figure)
    assert figure.get_size_inches()[0] == pytest.approx(3.4 if names is FIVE else 7.1)
    written = [text for text, _ in boxes_of(figure)]
    assert written.count(SIMULATED) == (kind == SIMULATED)
    ticks = [label.get_text() for label in figure.axes[1].get_xticklabels()]
    assert ticks == order_conditions(names, ("adult", "child"))
    medians = [line.get_ydata()[0] for line in figure.axes[0].lines if line.get_linewidth() == 1.6]
    expected = table.set_index("condition").loc[ticks, "child_median"] * 100
    assert medians == pytest.approx(expected.tolist())


def test_the_ratings_of_a_run_become_its_figure(tmp_path):
    run = run_of(tmp_path, LONG)
    with pytest.raises(NotApplicableError, match="benchmark analyze"):
        ratings(run)
    conditions(FIVE).to_csv(tmp_path / "stats" / "ratings-conditions.csv", index=False)
    contrasts(FIVE).to_csv(tmp_path / "stats" / "ratings-contrasts.csv", index=False)
    (drawing,) = ratings(run)
    assert drawing.name == "ratings" and drawing.caption.startswith(f"{SIMULATED.capitalize()}. Planted data")
    for word in ("36 raters", "10 clips", "Holm", "all 10 pairs"):
        assert word in drawing.caption
    assert drawing.data["condition"].tolist()[0] == "adult" and set(drawing.data["kind"]) == {SIMULATED}
    conditions(FIVE, PEOPLE).to_csv(tmp_path / "stats" / "ratings-conditions.csv", index=False)
    people = rating_drawing(tmp_path / "stats", "ratings", styles=("adult", "child"), what="A study")
    assert people is not None and people.caption.startswith("A study") and "imulated" not in people.caption
    # An analysis of an earlier version, without intervals over clips for naturalness, is not drawn.
    conditions(FIVE).drop(columns="naturalness_low_clips").to_csv(
        tmp_path / "stats/ratings-conditions.csv", index=False
    )
    with pytest.raises(NotApplicableError, match="benchmark analyze"):
        ratings(run)


ABLATED = ["identity", "cyclegan", "cyclegan[coherence=0]", "cyclegan[convolution=overall]", "kc[a]", "kc"]


def comparison():
    rows = [
        {"task": TASK, "variant": "raw", "metric": metric, "a": a, "b": b, "diff": 0.5, "low": 0.2, "high": 0.9}
        for metric in METRICS
        for index, a in enumerate(ABLATED)
        for b in ABLATED[index + 1 :]
    ]
    return pd.DataFrame(rows).assign(
        p=0.001,
        p_holm=[0.01, 0.2] * 22 + [0.5],
        reject=[True, False] * 22 + [False],
        family="x",
        family_size=15,
        n_clips=8,
    )


def test_ablations_are_found_by_their_labels_and_signed_from_their_base():
    bases = variants_of(ABLATED)
    assert bases == {"cyclegan": ABLATED[2:4], "kc": ["kc[a]"]}
    table = differences(comparison(), bases)
    assert len(table) == 3 * len(METRICS)
    rows = table[table["metric"] == "style/d-s"].set_index("variant")
    # Stored as cyclegan minus its variant, and as the variant kc[a] minus kc.
    assert rows.loc["cyclegan[coherence=0]", ["diff", "low", "high"]].tolist() == [-0.5, -0.9, -0.2]
    assert rows.loc["kc[a]", ["diff", "low", "high"]].tolist() == [0.5, 0.2, 0.9]


def test_the_forest_of_a_run(tmp_path):
    run = run_of(tmp_path, ABLATED)
    with pytest.raises(NotApplicableError, match="benchmark analyze"):
        ablation_forest(run)
    comparison().to_csv(tmp_path / "stats" / "metrics-comparison.csv", index=False)
    (drawing,) = ablation_forest(run)
    assert_nothing_is_cut(drawing.figure)
    for word in ("8 test clips of 4 actors", "2 trainings each", "hierarchical bootstrap", "Holm", "(15 tests)"):
        assert word in drawing.caption
    labels = [label.get_text() for label in drawing.figure.axes[0].get_yticklabels()]
    assert labels == ["cyclegan", "coherence=0", "convolution=overall", "kc", "a"]
    dots = [line for line in drawing.figure.axes[0].lines if line.get_marker() == "o"]
    assert [float(dot.get_xdata()[0]) for dot in dots] == [-0.5, -0.5, 0.5]
    filled = [dot.get_markerfacecolor() != "#ffffff" for dot in dots]
    assert filled == drawing.data[drawing.data["metric"] == "style/d-s"]["reject"].tolist()
    # What no variant changes has no panel.
    still = comparison()
    still.loc[still["metric"] == "style/d-s", ["diff", "low", "high"]] = 0.0
    still.to_csv(tmp_path / "stats" / "metrics-comparison.csv", index=False)
    assert set(ablation_forest(run)[0].data["metric"]) == set(METRICS) - {"style/d-s"}
    assert variants_of(["kc[a]", "kc[a,b]", "kc[c]"]) == {"kc[a]": ["kc[a,b]"]}
    assert variants_of(["kc", "kc[a]", "kc[a,b]"]) == {"kc": ["kc[a]"], "kc[a]": ["kc[a,b]"]}
    plain = run_of(tmp_path, ["identity", "kc[a]"])
    with pytest.raises(NotApplicableError, match="beside variants"):
        ablation_forest(plain)
