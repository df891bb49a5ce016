"""Effect sizes: closed forms, agreement with the tests they belong to, and coverage by simulation."""

from __future__ import annotations

import numpy as np
import pytest

from eval.stats import cousineau_morey, d_av, dz, eta_p2_interval, rm_anova

RM = {"subject": "rater", "within": "method", "value": "score"}


def test_dz_interval_touches_zero_where_t_is_critical():
    from scipy.stats import t

    n = 36
    base = np.linspace(-1, 1, n)
    base /= base.std(ddof=1)
    critical = t.isf(0.025, n - 1) / np.sqrt(n)
    effect = dz(base + critical)
    assert effect.estimate == pytest.approx(critical)
    assert effect.low == pytest.approx(0.0, abs=1e-6)
    mirrored = dz(-(base + critical))
    assert (mirrored.low, mirrored.high) == pytest.approx((-effect.high, -effect.low))


def test_dz_interval_covers():
    rng = np.random.default_rng(6)
    hits = [e.low <= 0.6 <= e.high for e in (dz(0.6 + rng.normal(size=20)) for _ in range(400))]
    assert 0.925 <= np.mean(hits) <= 0.975


def test_d_av_by_hand_and_its_coverage():
    a, b = np.array([1.0, 2.0, 3.0, 6.0]), np.array([0.0, 2.0, 2.0, 4.0])
    # Variances 14/3 and 8/3, mean difference 1.
    assert d_av(a, b).estimate == pytest.approx(1.0 / np.sqrt(11 / 3))
    assert d_av(b, a).estimate == pytest.approx(-d_av(a, b).estimate)
    rng = np.random.default_rng(7)
    hits = []
    for _ in range(500):
        person = rng.normal(size=40)
        x, y = 0.8 * person + 0.6 * rng.normal(size=40) + 0.5, 0.8 * person + 0.6 * rng.normal(size=40)
        effect = d_av(x, y)
        hits.append(effect.low <= 0.5 <= effect.high)
    assert 0.92 <= np.mean(hits) <= 0.98


def test_no_spread_has_no_effect_size():
    assert np.isnan(dz([0.1, 0.1, 0.1]).estimate)
    assert np.isnan(d_av([1.0, 1.0], [2.0, 2.0]).low)


def test_eta_interval_inverts_the_noncentral_f():
    from scipy.stats import f, ncf

    low, high = eta_p2_interval(23.66, 4, 140)
    for eta, tail in ((low, 0.95), (high, 0.05)):
        nc = eta * 145 / (1 - eta)
        assert ncf.cdf(23.66, 4, 140, nc) == pytest.approx(tail, abs=1e-6)
    assert low < 0.403 < high
    # Its lower end leaves 0 where the test becomes significant.
    critical = f.isf(0.05, 4, 140)
    assert eta_p2_interval(critical * 0.999, 4, 140)[0] == 0.0
    assert eta_p2_interval(critical * 1.01, 4, 140)[0] > 0.0
    assert eta_p2_interval(0.01, 4, 140) == (0.0, 0.0)
    assert np.isnan(eta_p2_interval(np.inf, 1, 5)).all()


def test_the_published_f_and_its_effect(long, rng):
    # Data scaled so that F(4, 140) is the published 23.66: partial eta squared is then .403 and p 5.8e-15.
    noise, effect = rng.normal(size=(36, 5)), np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
    residual = noise - noise.mean(axis=1, keepdims=True) - noise.mean(axis=0)
    ms = (residual - residual.mean()).ravel() @ (residual - residual.mean()).ravel() / 140
    y = residual + effect * np.sqrt(23.66 * ms / (36 * effect.var(ddof=1)))
    (row,) = rm_anova(long(y), **RM).to_dict("records")
    assert row["F"] == pytest.approx(23.66)
    assert row["eta_p2"] == pytest.approx(0.403, abs=5e-4)
    assert row["p"] == pytest.approx(5.8e-15, rel=0.05)


def test_cousineau_morey_by_hand(ratings):
    table = cousineau_morey(ratings, **RM)
    y = ratings.pivot_table(index="rater", columns="method", values="score")
    from scipy.stats import t

    centred = y.sub(y.mean(axis=1), axis=0) + y.to_numpy().mean()
    half = t.isf(0.025, 35) * centred["c"].std(ddof=1) * np.sqrt(5 / 4) / 6.0
    row = table.set_index("level").loc["c"]
    assert row["mean"] == pytest.approx(y["c"].mean())
    assert (row["low"], row["high"]) == pytest.approx((y["c"].mean() - half, y["c"].mean() + half))


def test_cousineau_morey_pools_to_the_error_of_the_anova(ratings):
    from scipy.stats import t

    table = cousineau_morey(ratings, **RM)
    half = (table["high"] - table["low"]) / 2.0
    variance = (half / t.isf(0.025, 35)) ** 2 * 36
    # What Morey's factor is for: on average the variances are the error mean square.
    assert variance.mean() == pytest.approx(rm_anova(ratings, **RM).loc[0, "MS_err"])


def test_subject_differences_do_not_widen_it(ratings):
    shift = dict(zip(ratings["rater"].unique(), 100.0 * np.arange(36), strict=True))
    moved = ratings.assign(score=ratings["score"] + ratings["rater"].map(shift))
    a, b = cousineau_morey(ratings, **RM), cousineau_morey(moved, **RM)
    assert (b["high"] - b["low"]).to_numpy() == pytest.approx((a["high"] - a["low"]).to_numpy())
