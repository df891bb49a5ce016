"""The mixed model: closed forms of balanced designs, statsmodels' own, coverage, and what is said when it fails."""

from __future__ import annotations

import warnings

import numpy as np
import pandas as pd
import pytest

from eval.stats import mixed, mixed_model

NAMES = {"rater": "rater", "clip": "clip", "condition": "method", "value": "score"}


def simulate(seed, *, raters=12, clips=8, sd=(0.6, 0.5, 0.4, 0.4, 1.0), effects=(0.0, 1.0, 0.2)) -> pd.DataFrame:
    """Every rater scores every clip in every condition; ``sd`` of rater, clip, rater:condition, stimulus, answer."""
    rng = np.random.default_rng(seed)
    k = len(effects)
    y = (
        np.asarray(effects)
        + sd[0] * rng.normal(size=(raters, 1, 1))
        + sd[1] * rng.normal(size=(1, clips, 1))
        + sd[2] * rng.normal(size=(raters, 1, k))
        + sd[3] * rng.normal(size=(1, clips, k))
        + sd[4] * rng.normal(size=(raters, clips, k))
    )
    rows = [
        (f"r{r:02d}", f"c{c}", "abcde"[m], y[r, c, m]) for r in range(raters) for c in range(clips) for m in range(k)
    ]
    return pd.DataFrame(rows, columns=["rater", "clip", "method", "score"])


def mean_squares(df: pd.DataFrame) -> dict[str, float]:
    """Mean squares of the balanced three-way layout, by inclusion and exclusion of cell means."""
    y = df.pivot_table(index="rater", columns=["clip", "method"], values="score").to_numpy()
    r, c, m = df["rater"].nunique(), df["clip"].nunique(), df["method"].nunique()
    y = y.reshape(r, c, m)

    def mean(*axes: int) -> np.ndarray:
        return y.mean(axis=axes, keepdims=True)

    rm = mean(1) - mean(1, 2) - mean(0, 1) + mean(0, 1, 2)
    cm = mean(0) - mean(0, 2) - mean(0, 1) + mean(0, 1, 2)
    additive = mean(1) + mean(0) - mean(0, 1)
    return {
        "rater_condition": c * (rm**2).sum() / ((r - 1) * (m - 1)),
        "stimulus": r * (cm**2).sum() / ((c - 1) * (m - 1)),
        # Rater by clip is no component of the model: it is part of the residual.
        "residual": ((y - additive) ** 2).sum() / (r * c * m - (r + c - 1) * m),
    }


def test_without_shared_effects_it_is_the_analysis_of_variance():
    # With every rater and clip effect specific to a condition, the moments of the balanced layout are the estimates.
    df = simulate(3, sd=(0.0, 0.0, 0.9, 0.9, 1.0))
    table = mixed_model(df, **NAMES).set_index("a")
    means = df.groupby("method")["score"].mean()
    for level in ("b", "c"):
        assert table.loc[level, "diff"] == pytest.approx(means[level] - means["a"], abs=1e-7)
    row = table.loc["b"]
    # The variance of a difference in a balanced layout, from whatever components were estimated.
    expected = 2 * (row["var_rater_condition"] / 12 + row["var_stimulus"] / 8 + row["var_residual"] / 96)
    assert row["se"] ** 2 == pytest.approx(expected, rel=1e-6)


def test_components_of_a_balanced_layout_are_those_of_its_mean_squares():
    df = simulate(5)
    squares = mean_squares(df)
    row = mixed_model(df, **NAMES).iloc[0]
    assert row["note"] == "" and row["converged"]
    assert row["var_residual"] == pytest.approx(squares["residual"], rel=1e-3)
    assert row["var_rater_condition"] == pytest.approx((squares["rater_condition"] - squares["residual"]) / 8, rel=1e-3)
    assert row["var_stimulus"] == pytest.approx((squares["stimulus"] - squares["residual"]) / 12, rel=1e-3)


def test_it_agrees_with_statsmodels():
    import statsmodels.formula.api as smf

    df = simulate(7, raters=8, clips=5, sd=(0.8, 0.7, 0.0, 0.0, 1.0), effects=(0.0, 0.7))
    df = df[np.random.default_rng(0).random(len(df)) < 0.85]  # unbalanced
    design = np.column_stack([np.ones(len(df)), (df["method"] == "b").to_numpy(float)])
    labels = [df[name].astype("category").cat.codes.to_numpy().astype(np.intp) for name in ("rater", "clip")]
    ours = mixed.fit_components(df["score"].to_numpy(), design, labels)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = smf.mixedlm(
            "score ~ C(method)",
            df.assign(one=1),
            groups="one",
            vc_formula={"a_rater": "0 + C(rater)", "b_clip": "0 + C(clip)"},
        )
        theirs = model.fit(reml=True)
    assert ours.beta == pytest.approx(theirs.fe_params.to_numpy(), abs=1e-4)
    assert np.sqrt(np.diag(ours.covariance)) == pytest.approx(theirs.bse_fe.to_numpy(), rel=1e-3)
    assert ours.variances == pytest.approx(theirs.vcomp, rel=5e-3)
    assert ours.residual == pytest.approx(theirs.scale, rel=1e-3)


def test_intervals_cover_where_raters_and_clips_vary():
    hits = [
        row["low"] <= 1.0 <= row["high"]
        for seed in range(100)
        for row in [mixed_model(simulate(seed, raters=10, clips=6, effects=(0.0, 1.0)), **NAMES).iloc[0]]
    ]
    # 99.9 % of binomial(100, 0.95) lie above 86; the small degrees of freedom are on the safe side.
    assert np.mean(hits) > 0.86


def test_shift_and_scale_of_the_answers_do_not_matter():
    df = simulate(9)
    plain = mixed_model(df, **NAMES, reference="b").iloc[0]
    moved = mixed_model(df.assign(score=1e4 + 100 * df["score"]), **NAMES, reference="b").iloc[0]
    assert moved["diff"] == pytest.approx(100 * plain["diff"], rel=1e-6)
    assert moved["se"] == pytest.approx(100 * plain["se"], rel=1e-4)
    assert moved["t"] == pytest.approx(plain["t"], rel=1e-4)
    assert (plain["a"], plain["b"]) == ("a", "b")


def test_clips_of_one_condition_each_are_the_stimuli():
    df = simulate(11)
    row = mixed_model(df.assign(clip=df["clip"] + df["method"]), **NAMES).iloc[0]
    assert np.isnan(row["var_stimulus"]) and row["var_clip"] > 0
    # One answer of each rater to each condition: raters' reactions cannot be told from the residual.
    single = df[df["clip"] == "c0"].assign(clip=lambda rows: [f"c{i % 3}" for i in range(len(rows))])
    assert np.isnan(mixed_model(single, **NAMES).iloc[0]["var_rater_condition"])


def test_what_goes_wrong_is_said(monkeypatch):
    df = simulate(13, sd=(0.0, 0.0, 0.0, 0.0, 1.0))
    assert "is estimated as 0" in mixed_model(df, **NAMES)["note"].iloc[0]
    found = mixed.fit_components(df["score"].to_numpy(), np.ones((len(df), 1)), [np.arange(len(df)) % 12])
    lost = found._replace(
        beta=np.zeros(3), covariance=np.eye(3), variances=np.ones(4), converged=False, message="LIMIT REACHED."
    )
    monkeypatch.setattr(mixed, "fit_components", lambda *_: lost)
    row = mixed_model(df, **NAMES).iloc[0]
    assert not row["converged"] and "did not converge (LIMIT REACHED): disregard this row" in row["note"]


def test_refusals():
    df = simulate(15)
    with pytest.raises(ValueError, match="no level z"):
        mixed_model(df, **NAMES, reference="z")
    with pytest.raises(ValueError, match="2 conditions, 2 raters and 2 clips"):
        mixed_model(df[df["clip"] == "c0"], **NAMES)
    with pytest.raises(ValueError, match="all answers are the same"):
        mixed_model(df.assign(score=4.0), **NAMES)
