"""Answers of raters about clips: known log-odds, known variances, and who varies."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from eval.stats import gee_logit, pigeonhole_bootstrap, pigeonhole_means, tost_pigeonhole

NAMES = {"condition": "method", "answer": "child"}


def simulate(seed, *, raters=36, clips=10, rater_sd=0.0, clip_sd=0.0, logits=(0.0, 1.0), shared=False) -> pd.DataFrame:
    """Answers of every rater to every clip; clips are the conditions' own unless ``shared``."""
    rng = np.random.default_rng(seed)
    person = rater_sd * rng.normal(size=(raters, 1, 1))
    stimulus = clip_sd * rng.normal(size=(1, clips, 1 if shared else len(logits)))
    p = 1.0 / (1.0 + np.exp(-(person + stimulus + np.asarray(logits))))
    yes = rng.random(p.shape) < p
    rows = [
        (f"r{r:02d}", f"c{c}" if shared else f"{'abcde'[m]}{c}", "abcde"[m], int(yes[r, c, m]))
        for r in range(raters)
        for c in range(clips)
        for m in range(len(logits))
    ]
    return pd.DataFrame(rows, columns=["rater", "clip", "method", "child"])


def test_odds_ratio_is_that_of_the_proportions():
    df = simulate(1, rater_sd=0.5)
    share = df.groupby("method")["child"].mean()
    odds = share / (1 - share)
    for clip in (None, "clip"):
        (row,) = gee_logit(df, subject="rater", **NAMES, clip=clip).to_dict("records")
        assert (row["a"], row["b"]) == ("b", "a")
        # In a balanced design the marginal estimate is the raw log odds ratio under any working correlation.
        assert row["odds_ratio"] == pytest.approx(odds["b"] / odds["a"])
        assert row["log_odds_ratio"] == pytest.approx(np.log(row["odds_ratio"]))
        assert row["low"] < row["odds_ratio"] < row["high"]
        assert (row["proportion_a"], row["proportion_b"]) == pytest.approx((share["b"], share["a"]))
    turned = gee_logit(df, subject="rater", **NAMES, reference="b").iloc[0]
    assert turned["log_odds_ratio"] == pytest.approx(-row["log_odds_ratio"])


def test_known_log_odds_are_covered():
    hits = []
    for seed in range(60):
        row = gee_logit(simulate(seed, raters=20, clips=5, logits=(-0.5, 0.7)), subject="rater", **NAMES).iloc[0]
        hits.append(row["low"] <= np.exp(1.2) <= row["high"])
    assert 0.88 <= np.mean(hits) <= 1.0


def test_without_clustering_the_errors_are_those_of_counts():
    # Independent answers: the variance of a log odds ratio is the sum of the inverse counts.
    df = simulate(2, raters=150, clips=10)
    counts = df.groupby("method")["child"].agg(["sum", "size"])
    expected = np.sqrt((1 / counts["sum"] + 1 / (counts["size"] - counts["sum"])).sum())
    for clip in (None, "clip"):
        row = gee_logit(df, subject="rater", **NAMES, clip=clip).iloc[0]
        assert row["se"] == pytest.approx(expected, rel=0.35)
    assert gee_logit(df, subject="rater", **NAMES, covariance="robust").iloc[0]["se"] == pytest.approx(
        expected, rel=0.15
    )


def test_clips_that_differ_widen_the_two_way_interval_only():
    df = simulate(3, rater_sd=1.0, clip_sd=1.0)
    alone = gee_logit(df, subject="rater", **NAMES).iloc[0]
    both = gee_logit(df, subject="rater", **NAMES, clip="clip").iloc[0]
    assert both["se"] > 1.7 * alone["se"]
    assert both["n_clips"] == 20
    assert alone["n_clips"] == 0


def test_two_way_covariance_of_one_rater_per_row_is_that_of_clips():
    # If every answer has a rater of its own, rater and cell terms cancel up to their small-sample factors.
    df = simulate(4, clip_sd=1.0)
    df["rater"] = [f"r{i}" for i in range(len(df))]
    row = gee_logit(df, subject="rater", **NAMES, clip="clip").iloc[0]
    counts = df.groupby(["method", "clip"])["child"].agg(["sum", "size"]).reset_index()
    variance = 0.0
    for _, part in counts.groupby("method"):
        share = part["sum"].sum() / part["size"].sum()
        score = part["sum"] - part["size"] * share
        variance += (score**2).sum() * 20 / 19 / (part["size"].sum() * share * (1 - share)) ** 2
    assert row["se"] == pytest.approx(np.sqrt(variance), rel=1e-6)


def test_everyone_says_yes():
    df = simulate(5, logits=(0.0, 1.0, 0.0))
    df.loc[df["method"] == "c", "child"] = 1
    table = gee_logit(df, subject="rater", **NAMES).set_index("a")
    assert table.loc["c", "odds_ratio"] == np.inf
    assert np.isnan(table.loc["c", "high"])
    assert "every answer is yes" in table.loc["c", "note"]
    assert np.isfinite(table.loc["b", "high"])
    with pytest.raises(ValueError, match="every answer to c is the same"):
        gee_logit(df, subject="rater", **NAMES, reference="c")
    only = gee_logit(df[df["method"] != "b"], subject="rater", **NAMES)
    assert only["odds_ratio"].tolist() == [np.inf]


def test_gee_refusals():
    df = simulate(6)
    with pytest.raises(ValueError, match="no level z"):
        gee_logit(df, subject="rater", **NAMES, reference="z")
    with pytest.raises(ValueError, match="covariance must be"):
        gee_logit(df, subject="rater", **NAMES, covariance="naive")
    with pytest.raises(ValueError, match="2 subjects"):
        gee_logit(df[df["rater"] == "r00"], subject="rater", **NAMES)


def width(table: pd.DataFrame) -> float:
    row = table[table["quantity"] == "difference"].iloc[0]
    return row["high"] - row["low"]


def test_clips_double_the_interval_where_both_vary():
    df = simulate(7, rater_sd=1.0, clip_sd=1.0)
    both = pigeonhole_bootstrap(df, rater="rater", clip="clip", **NAMES)
    raters = pigeonhole_bootstrap(df, rater="rater", clip=None, **NAMES)
    assert 1.5 < width(both) / width(raters) < 4.0
    assert both["estimate"].tolist() == raters["estimate"].tolist()
    assert both["n_clips"].tolist() == [10, 10, 10]
    assert raters["n_clips"].tolist() == [0, 0, 0]


def test_estimates_and_direction():
    df = simulate(8)
    share = df.groupby("method")["child"].mean()
    table = pigeonhole_bootstrap(df, rater="rater", clip="clip", **NAMES, pairs=[("b", "a")])
    assert table["quantity"].tolist() == ["proportion", "proportion", "difference"]
    row = table.iloc[2]
    assert (row["a"], row["b"]) == ("b", "a")
    assert row["estimate"] == pytest.approx(share["b"] - share["a"])
    assert row["low"] > 0
    assert row["p"] < 0.01
    assert (table["low"] <= table["estimate"]).all()
    assert (table["estimate"] <= table["high"]).all()


def test_shared_clips_are_drawn_once_for_all_conditions():
    # The clips differ a lot, the conditions hardly: drawn together, their difference does not feel the clips.
    shared = simulate(9, raters=60, clips=12, clip_sd=2.0, logits=(0.0, 0.2), shared=True)
    own = shared.assign(clip=shared["method"] + shared["clip"])
    together = pigeonhole_bootstrap(shared, rater="rater", clip="clip", **NAMES)
    apart = pigeonhole_bootstrap(own, rater="rater", clip="clip", **NAMES)
    assert width(apart) > 2.0 * width(together)


def test_standard_error_of_a_proportion_adds_both_variances():
    # Owen (2007): the expected bootstrap variance is the sum of the row, the column and the cell terms.
    rng = np.random.default_rng(10)
    grid = (rng.random((30, 12)) < 1 / (1 + np.exp(-rng.normal(size=(30, 1)) - rng.normal(size=(1, 12))))).astype(int)
    df = pd.DataFrame(
        [(r, c, "a", grid[r, c]) for r in range(30) for c in range(12)], columns=["rater", "clip", "method", "child"]
    )
    rows, columns = grid.mean(axis=1).var() / 30, grid.mean(axis=0).var() / 12
    residual = grid - grid.mean(axis=1, keepdims=True) - grid.mean(axis=0) + grid.mean()
    table = pigeonhole_bootstrap(df, rater="rater", clip="clip", **NAMES, resamples=20000)
    assert len(table) == 1
    assert table.loc[0, "se"] ** 2 == pytest.approx(rows + columns + (residual**2).mean() / 360, rel=0.05)


def test_intervals_cover_where_raters_and_clips_vary():
    from scipy.integrate import quad
    from scipy.stats import norm

    def marginal(logit: float) -> float:
        return quad(lambda z: norm.pdf(z) / (1 + np.exp(-(logit + z * np.sqrt(1.25)))), -8, 8)[0]

    truth = marginal(0.0) - marginal(1.0)
    hits = {"clip": 0, None: 0}
    for seed in range(120):
        df = simulate(seed, raters=24, clips=16, rater_sd=1.0, clip_sd=0.5)
        for clip in hits:
            table = pigeonhole_bootstrap(df, rater="rater", clip=clip, **NAMES, resamples=300, seed=seed)
            row = table[table["quantity"] == "difference"].iloc[0]
            hits[clip] += row["low"] <= truth <= row["high"]
    assert hits["clip"] / 120 >= 0.9
    # Clips taken as fixed: far too narrow.
    assert hits[None] / 120 < 0.85


def test_seed_decides_and_row_order_does_not():
    df = simulate(11)
    args = {"rater": "rater", "clip": "clip", **NAMES}
    first = pigeonhole_bootstrap(df, **args, seed=1)
    pd.testing.assert_frame_equal(first, pigeonhole_bootstrap(df.sample(frac=1.0, random_state=0), **args, seed=1))
    assert not first.equals(pigeonhole_bootstrap(df, **args, seed=2))


def test_missing_answers_are_allowed_for():
    df = simulate(12)
    part = df[np.random.default_rng(0).random(len(df)) < 0.5]
    table = pigeonhole_bootstrap(part, rater="rater", clip="clip", **NAMES)
    assert table.loc[0, "estimate"] == pytest.approx(part[part["method"] == "a"]["child"].mean())
    with pytest.raises(ValueError, match="at least 2 raters"):
        pigeonhole_bootstrap(df[df["rater"] == "r00"], rater="rater", clip="clip", **NAMES)


def test_means_are_resampled_as_proportions_are():
    df = simulate(13, rater_sd=0.5, clip_sd=0.5)
    args = {"rater": "rater", "clip": "clip", "condition": "method", "resamples": 500}
    shares = pigeonhole_bootstrap(df, **args, answer="child")
    means = pigeonhole_means(df.assign(score=3.0 + 2.0 * df["child"]), **args, value="score")
    assert means["quantity"].tolist() == ["mean", "mean", "difference"]
    assert means["estimate"].tolist() == pytest.approx(
        [3 + 2 * shares["estimate"][0], 3 + 2 * shares["estimate"][1], 2 * shares["estimate"][2]]
    )
    for column in ("low", "high", "se"):
        assert means[column][2] == pytest.approx(2 * shares[column][2])
    with pytest.raises(ValueError, match="lacks a value in 1 rows"):
        pigeonhole_means(df.assign(score=[np.nan, *df["child"][1:]]), **args, value="score")
    with pytest.raises(ValueError, match="0 or 1 in every row"):
        pigeonhole_bootstrap(df.assign(child=2.0), **args, answer="child")


def test_equivalence_of_means_scales_with_the_margin():
    df = simulate(14, raters=60, clips=20, logits=(0.0, 0.05), shared=True)
    args = {"rater": "rater", "clip": "clip", "condition": "method", "reference": "a", "resamples": 500}
    one = tost_pigeonhole(df, **args, answer="child", margin=0.1)
    ten = tost_pigeonhole(df.assign(child=10.0 * df["child"]), **args, answer="child", margin=1.0, scale=True)
    assert ten["p"].tolist() == one["p"].tolist() and ten["equivalent"].all()
    assert ten["low"].tolist() == pytest.approx((10 * one["low"]).tolist())
