"""Methods across clips, actors and training seeds: point values by hand, coverage by simulation, directions."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from eval.stats import clustered_mean, compare, sign_flip_p


def table(values, metrics=("m0",), clips_per_actor=5, shuffle=None) -> pd.DataFrame:
    """A long table from an array (methods, clips, seeds, metrics); actors own consecutive clips."""
    array = np.asarray(values, dtype=float)
    rows = [
        (f"x{m}", f"actor{c // clips_per_actor}", f"clip{c:02d}", s, metrics[k], array[m, c, s, k])
        for m in range(array.shape[0])
        for c in range(array.shape[1])
        for s in range(array.shape[2])
        for k in range(array.shape[3])
    ]
    return pd.DataFrame(rows, columns=["method", "actor", "clip_id", "repetition", "metric", "value"])


def scores(rng, methods=3, actors=8, clips=5, seeds=3, metrics=1, actor_sd=1.0, seed_sd=0.0, effect=None):
    effect = np.zeros(methods) if effect is None else np.asarray(effect)
    actor = np.repeat(rng.normal(size=(methods, actors)), clips, axis=1)[:, :, None, None] * actor_sd
    trained = seed_sd * rng.normal(size=(methods, 1, seeds, 1))
    return actor + trained + rng.normal(size=(methods, actors * clips, seeds, metrics)) + effect[:, None, None, None]


def test_means_and_differences_by_hand(rng):
    values = scores(rng, metrics=2)
    result = compare(table(values, metrics=("m0", "m1")))
    means = result.means.set_index(["metric", "method"])
    assert means.loc[("m1", "x2"), "mean"] == pytest.approx(values[2, :, :, 1].mean())
    assert means.loc[("m1", "x2"), ["n_clips", "n_actors", "n_seeds"]].tolist() == [40, 8, 3]
    row = result.differences.set_index(["metric", "a", "b"]).loc[("m0", "x0", "x2")]
    assert row["diff"] == pytest.approx(values[0, :, :, 0].mean() - values[2, :, :, 0].mean())
    assert (row["unit"], row["n_units"], row["n_clips"]) == ("actor", 8, 40)
    assert len(result.differences) == 2 * 3


def test_intervals_agree_with_the_clustered_bootstrap(rng):
    values = scores(rng, methods=1, seeds=1, actors=10)
    row = compare(table(values), training_seed=None, resamples=6000).means.iloc[0]
    other = clustered_mean(values[0, :, 0, 0], np.repeat(np.arange(10), 5), resamples=6000)
    assert row["mean"] == pytest.approx(other.mean)
    # Nine of ten actors are drawn, which makes the interval wider by the square root of 10 / 9.
    assert row["high"] - row["low"] == pytest.approx(np.sqrt(10 / 9) * (other.high - other.low), rel=0.06)


def test_a_seed_is_one_model_for_all_clips(rng):
    # Seeds differ, clips do not: two hundred clips are no more informative than one.
    values = np.zeros((1, 200, 4, 1)) + rng.normal(size=4)[None, None, :, None]
    row = compare(table(values), resamples=4000).means.iloc[0]
    spread = values[0, 0, :, 0].std(ddof=1) / np.sqrt(4)
    assert row["high"] - row["low"] == pytest.approx(2 * 1.96 * spread, rel=0.25)
    single = compare(table(values[:, :, :1]), resamples=500).means.iloc[0]
    assert single["high"] - single["low"] == pytest.approx(0.0, abs=1e-12)


def test_paired_differences_do_not_feel_what_clips_share(rng):
    shared = 10.0 * rng.normal(size=(1, 40, 1, 1))
    values = (
        np.repeat(shared, 2, axis=0) + 0.1 * rng.normal(size=(2, 40, 1, 1)) + np.array([0, 0.2])[:, None, None, None]
    )
    result = compare(table(values))
    row = result.differences.iloc[0]
    assert result.means["high"].iloc[0] - result.means["low"].iloc[0] > 3.0
    assert row["high"] - row["low"] < 0.2
    assert row["high"] < 0
    assert row["p"] < 0.02
    assert row["p_flip"] < 0.02


@pytest.mark.parametrize(("actors", "seeds"), [(3, 3), (12, 6)])
def test_difference_intervals_cover(actors, seeds):
    rng = np.random.default_rng(15)
    hits = 0
    for trial in range(150):
        values = scores(
            rng, methods=2, actors=actors, clips=4, seeds=seeds, actor_sd=0.5, seed_sd=0.5, effect=[0.5, 0.0]
        )
        row = compare(table(values, clips_per_actor=4), resamples=300, seed=trial).differences.iloc[0]
        hits += row["low"] <= 0.5 <= row["high"]
    assert 0.9 <= hits / 150 <= 0.99


def test_only_the_bootstrap_holds_its_level_over_actors_and_trainings():
    rng = np.random.default_rng(17)
    found = np.zeros(2)
    for trial in range(120):
        values = scores(rng, methods=2, actors=4, clips=6, seeds=3, actor_sd=0.5, seed_sd=0.5)
        row = compare(table(values, clips_per_actor=6), resamples=300, seed=trial).differences.iloc[0]
        found += [row["p"] <= 0.05, row["p_flip"] <= 0.05]
    assert found[0] / 120 <= 0.11
    assert found[1] / 120 > 0.25


def test_rounding_is_no_difference(rng):
    values = np.repeat(rng.normal(size=(1, 40, 1, 1)), 2, axis=0)
    values[1] = (values[1] * 3.0) / 3.0
    row = compare(table(values)).differences.iloc[0]
    assert (row["p"], row["p_flip"]) == (1.0, 1.0)
    assert (row["low"], row["high"]) == (0.0, 0.0)


def test_few_actors_show_all_of_their_variance(rng):
    # Clips of an actor are alike: the standard error is that of three actors, with two degrees of freedom.
    values = np.repeat(rng.normal(size=3), 20)[None, :, None, None] * np.ones((1, 60, 1, 1))
    from eval.stats.panel import read_panel, resample

    df = table(values, clips_per_actor=20)
    panel = read_panel(
        df, method="method", clip="clip_id", actor="actor", metric="metric", value="value", seed="repetition"
    )
    draws = resample(panel, seed=0, resamples=20000).means(0, np.ones((60, 1), dtype=bool), np.array([0]))
    assert draws.var() == pytest.approx(values[0, ::20, 0, 0].var(ddof=1) / 3, rel=0.03)


def test_sign_flips_have_their_size_by_actor_and_not_by_clip():
    rng = np.random.default_rng(16)
    actors = np.repeat(np.arange(10), 6)
    differences = rng.normal(size=(10, 500))[actors] + 0.5 * rng.normal(size=(60, 500))
    by_actor = sign_flip_p(differences, actors)
    by_clip = sign_flip_p(differences, np.arange(60), flips=1000)
    assert 0.02 <= (by_actor <= 0.05).mean() <= 0.08
    assert (by_clip <= 0.05).mean() > 0.2


def test_sign_flips_by_hand():
    # All eight patterns of 1, 2, 4: only the observed one and its mirror reach 7.
    assert sign_flip_p(np.array([[1.0], [2.0], [4.0]]), np.arange(3))[0] == pytest.approx(2 / 8)
    # |1 + 2 - 4| = 1 is reached by every pattern.
    assert sign_flip_p(np.array([[1.0], [2.0], [-4.0]]), np.arange(3))[0] == 1.0
    assert sign_flip_p(np.zeros((5, 2)), np.arange(5)).tolist() == [1.0, 1.0]
    many = sign_flip_p(np.ones((30, 1)), np.arange(30), flips=999)
    assert many[0] == pytest.approx(1 / 1000)


def test_few_actors_fall_back_to_clips_and_say_so(rng):
    values = scores(rng, actors=3)
    assert set(compare(table(values)).differences["unit"]) == {"clip"}
    forced = compare(table(values), unit="actor").differences
    assert set(forced["unit"]) == {"actor"}
    # Three signs leave no p below a quarter.
    assert forced["p_flip"].min() >= 0.25


def test_holm_runs_within_declared_families(rng):
    values = scores(rng, metrics=3, effect=[0, 0, 1.0])
    df = table(values, metrics=("m0", "m1", "m2"))
    result = compare(df, families={"primary": ["m0"], "second": ["m1"]}).differences.set_index("metric")
    assert set(result.loc["m0", "family_size"]) == {3}
    assert result.loc["m2", "p_holm"].isna().all()
    assert not result.loc["m2", "reject"].any()
    assert (result.loc["m0", "p_holm"] >= result.loc["m0", "p"]).all()
    assert set(compare(df).differences["family_size"]) == {9}
    one = compare(df, families={"primary": ["m0"]}, pairs=[("x2", "x0")]).differences.set_index("metric")
    assert one.loc["m0", "p_holm"] == one.loc["m0", "p"]
    assert one.loc["m0", "diff"] > 0
    with pytest.raises(ValueError, match="m0 is in two families"):
        compare(df, families={"a": ["m0"], "b": ["m0"]})
    with pytest.raises(ValueError, match="no metric nope"):
        compare(df, families={"a": ["nope"]})


def test_ranks_follow_the_declared_direction(rng):
    values = 0.01 * scores(rng, effect=[100.0, 200.0, 300.0])
    df = table(values)
    order = {
        goal: compare(df, better={"m0": goal}, resamples=10).ranks["method"].tolist()
        for goal in ("low", "high", 2.0, 2.9)
    }
    assert order["low"] == ["x0", "x1", "x2"]
    assert order["high"] == ["x2", "x1", "x0"]
    assert order[2.0][0] == "x1"
    assert order[2.9] == ["x2", "x1", "x0"]
    assert compare(df, resamples=10).ranks.empty
    with pytest.raises(ValueError, match='must be "low", "high" or a number'):
        compare(df, better={"m0": "up"}, resamples=10)


def test_ranks_agree_with_the_public_friedman(rng):
    from eval.stats import friedman, mean_ranks

    values = scores(rng, seeds=1, effect=[0, 0.3, 0.8])
    df = table(values)
    ranks = compare(df, better={"m0": "high"}, resamples=10).ranks
    rm = {"subject": "clip_id", "within": "method", "value": "value"}
    assert ranks["chi2"].iloc[0] == pytest.approx(friedman(df, **rm)["chi2"].iloc[0])
    public = mean_ranks(df, **rm, best="high")
    assert ranks["method"].tolist() == public["level"].tolist()
    assert ranks["mean_rank"].tolist() == pytest.approx(public["mean_rank"].tolist())
    assert ranks["groups"].tolist() == public["groups"].tolist()
    by_actor = compare(df, better={"m0": "high"}, block="actor", resamples=10).ranks
    assert by_actor["n"].tolist() == [8, 8, 8]


def test_missing_clips_are_left_out_of_what_needs_them(rng):
    values = scores(rng, methods=3)
    values[0, :10] = np.nan
    values[1, 3, 1] = np.nan
    values[2] = np.nan
    values[2, :, 0] = scores(rng, methods=1, seeds=1)[0, :, 0]
    result = compare(table(values), better={"m0": "low"})
    means = result.means.set_index("method")
    assert means["n_clips"].to_dict() == {"x0": 30, "x1": 40, "x2": 40}
    assert means["n_seeds"].to_dict() == {"x0": 3, "x1": 3, "x2": 1}
    # A clip with values from some seeds keeps the mean of those.
    clip_means = np.nanmean(values[1, :, :, 0], axis=1)
    assert means.loc["x1", "mean"] == pytest.approx(clip_means.mean())
    row = result.differences.set_index(["a", "b"]).loc[("x0", "x1")]
    common = np.nanmean(values[0, 10:, :, 0], axis=1) - clip_means[10:]
    assert (row["n_clips"], row["n_units"]) == (30, 6)
    assert row["diff"] == pytest.approx(common.mean())
    assert row["low"] < row["diff"] < row["high"]
    assert result.ranks["n"].tolist() == [30, 30, 30]
    assert result.ranks["n_dropped"].tolist() == [10, 10, 10]


def test_a_method_without_values_is_left_out_not_ranked_last(rng):
    values = scores(rng)
    values[1] = np.nan
    result = compare(table(values), better={"m0": "low"}, resamples=50)
    assert sorted(result.ranks["method"]) == ["x0", "x2"]
    assert sorted(result.means["method"]) == ["x0", "x2"]
    assert result.differences[["a", "b"]].to_numpy().tolist() == [["x0", "x2"]]


def test_duplicates_are_refused_with_the_likely_cause(rng):
    df = table(scores(rng))
    with pytest.raises(ValueError, match="cells have several values, the first is x0, clip clip00, m0"):
        compare(pd.concat([df, df]))
    with pytest.raises(ValueError, match="name the column of training seeds"):
        compare(df, training_seed=None)


def test_equal_clip_labels_of_two_actors_are_two_clips(rng):
    df = table(scores(rng, methods=2))
    df["clip_id"] = df["clip_id"].str[-2:].astype(int) % 5
    assert compare(df, resamples=50).means["n_clips"].tolist() == [40, 40]


def test_row_order_and_seed(rng):
    df = table(scores(rng, metrics=2), metrics=("m0", "m1"))
    first, again = compare(df, resamples=200), compare(df.sample(frac=1.0, random_state=3), resamples=200)
    for left, right in zip(first, again, strict=True):
        pd.testing.assert_frame_equal(left, right)
    assert not first.means.equals(compare(df, resamples=200, seed=1).means)


def test_the_size_of_a_real_run_is_no_burden(rng):
    # 8 methods, 80 clips, 3 seeds, 30 metrics.
    names = tuple(f"m{k:02d}" for k in range(30))
    df = table(scores(rng, methods=8, actors=8, clips=10, metrics=30), metrics=names, clips_per_actor=10)
    result = compare(df, better=dict.fromkeys(names, "low"), resamples=1000)
    assert len(result.differences) == 28 * 30
    assert len(result.ranks) == len(result.means) == 8 * 30
    assert np.isfinite(result.differences[["low", "high", "p", "p_flip", "p_holm"]].to_numpy()).all()
