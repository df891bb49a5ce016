"""Analyses of variance against certified values: NIST StRD, MathWorks' iris example, R's ezANOVA."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from eval.stats import oneway_anova, rm_anova

RM = {"subject": "rater", "within": "method", "value": "score"}
NIST = Path(str(find_spec("scipy").origin)).parent / "stats" / "tests" / "data" / "nist_anova"
EZ = Path(str(find_spec("statsmodels").origin)).parent / "stats" / "tests" / "results" / "anova-rm-test-data.csv"

# Certified F, and the relative error that inputs rounded to double allow: 7 to 13 constant leading digits cost their share.
CERTIFIED = {
    "SiRstv": (1.18046237440255e00, 1e-9),
    "AtmWtAg": (1.59467335677930e01, 1e-9),
    **{f"SmLs{n:02d}": (f, tol) for (n, f), tol in [((1, 21.0), 1e-9), ((2, 201.0), 1e-9), ((3, 2001.0), 1e-9)]},
    **{f"SmLs{n:02d}": (f, tol) for (n, f), tol in [((4, 21.0), 1e-9), ((5, 201.0), 1e-9), ((6, 2001.0), 1e-9)]},
    **{f"SmLs{n:02d}": (f, tol) for (n, f), tol in [((7, 21.0), 1e-3), ((8, 201.0), 1e-3), ((9, 2001.0), 1e-3)]},
}


@pytest.mark.parametrize("name", CERTIFIED)
def test_nist_one_way_sets(name):
    path = NIST / f"{name}.dat"
    if not path.exists():
        pytest.skip("this build of SciPy comes without the NIST sets")
    rows = np.loadtxt(path, skiprows=60)
    df = pd.DataFrame({"treatment": rows[:, 0].astype(int), "response": rows[:, 1]})
    certified, tolerance = CERTIFIED[name]
    (row,) = oneway_anova(df, group="treatment", value="response").to_dict("records")
    assert row["F"] == pytest.approx(certified, rel=tolerance)
    assert row["df1"] == len(set(df["treatment"])) - 1
    assert row["df2"] == len(df) - len(set(df["treatment"]))
    # The certified table itself, from the file.
    words = [line.split() for line in path.read_text().splitlines()[40:60]]
    between = next(line for line in words if line[:1] == ["Between"])
    within = next(line for line in words if line[:1] == ["Within"])
    assert (row["SS"], row["SS_err"]) == pytest.approx((float(between[3]), float(within[3])), rel=tolerance)
    assert float(between[5]) == pytest.approx(certified)


def test_one_way_agrees_with_scipy_and_welch_with_statsmodels(rng):
    from scipy.stats import f_oneway
    from statsmodels.stats.oneway import anova_oneway

    groups = [rng.normal(m, s, size=n) for m, s, n in [(0, 1, 12), (0.5, 2, 20), (0.2, 0.5, 9)]]
    df = pd.DataFrame([(i, v) for i, g in enumerate(groups) for v in g], columns=["g", "v"])
    (row,) = oneway_anova(df, group="g", value="v").to_dict("records")
    assert (row["F"], row["p"]) == pytest.approx(tuple(f_oneway(*groups)))
    welch = anova_oneway(groups, use_var="unequal", welch_correction=True)
    assert (row["F_welch"], row["p_welch"]) == pytest.approx((welch.statistic, welch.pvalue))
    assert row["df2_welch"] == pytest.approx(welch.df_denom)
    # Omega squared from its other form, df1 (F - 1) / (df1 (F - 1) + n).
    excess = row["df1"] * (row["F"] - 1.0)
    assert row["omega2"] == pytest.approx(excess / (excess + row["n"]))


def test_one_way_leaves_out_missing_values_and_says_so():
    df = pd.DataFrame({"g": list("aabb"), "v": [1.0, 2.0, 4.0, 6.0]})
    with_gap = pd.concat([df, pd.DataFrame({"g": ["a"], "v": [np.nan]})], ignore_index=True)
    (row,) = oneway_anova(with_gap, group="g", value="v").to_dict("records")
    # Means 1.5 and 5, SS between 12.25, within 0.5 + 2.
    assert (row["n_dropped"], row["SS"], row["SS_err"]) == (1, pytest.approx(12.25), pytest.approx(2.5))
    assert row["F"] == pytest.approx(9.8)


def test_one_way_refuses_what_has_no_error_term():
    with pytest.raises(ValueError, match="more observations than groups"):
        oneway_anova(pd.DataFrame({"g": ["a", "b"], "v": [1.0, 2.0]}), group="g", value="v")
    with pytest.raises(ValueError, match="no column group"):
        oneway_anova(pd.DataFrame({"g": ["a"], "v": [1.0]}), group="group", value="v")


def test_no_error_is_infinite_and_nothing_at_all_undefined():
    df = pd.DataFrame({"g": list("aabb"), "v": [1.0, 1.0, 2.0, 2.0]})
    (row,) = oneway_anova(df, group="g", value="v").to_dict("records")
    assert (row["F"], row["p"]) == (np.inf, 0.0)
    (row,) = oneway_anova(df.assign(v=3.0), group="g", value="v").to_dict("records")
    assert np.isnan(row["F"])
    assert np.isnan(row["p"])


@pytest.fixture
def iris() -> pd.DataFrame:
    from sklearn.datasets import load_iris

    values, species = load_iris(return_X_y=True)
    rows = [(i, int(species[i]), j, values[i, j]) for i in range(150) for j in range(4)]
    return pd.DataFrame(rows, columns=["flower", "species", "measurement", "cm"])


def test_iris_agrees_with_mathworks_to_all_printed_digits(iris):
    table = rm_anova(iris, subject="flower", within="measurement", value="cm", between="species").set_index("effect")
    row, both = table.loc["measurement"], table.loc["species:measurement"]
    assert f"{row['mauchly_W']:.5f}" == "0.55814"
    assert f"{row['mauchly_chi2']:.3f}" == "84.976"
    assert row["mauchly_df"] == 5
    assert f"{row['mauchly_p']:.4e}" == "7.6149e-17"
    assert f"{row['eps_gg']:.5f}" == "0.75179"
    assert f"{row['eps_hf']:.5f}" == "0.76409"
    assert row["eps_lb"] == pytest.approx(1 / 3)
    assert f"{row['F']:.1f}" == "6873.3"
    assert (f"{row['SS']:.1f}", f"{row['MS']:.2f}", f"{row['MS_err']:.6f}") == ("1656.3", "552.09", "0.080324")
    printed = [f"{row[name]:.4e}" for name in ("p_gg", "p_hf", "p_lb")]
    assert printed == ["9.4491e-279", "2.9213e-283", "2.5871e-125"]
    assert (f"{both['F']:.1f}", f"{both['SS']:.2f}", f"{both['SS_err']:.3f}") == ("586.1", "282.47", "35.423")
    assert (both["df1"], both["df2"], row["df1"], row["df2"]) == (6, 441, 3, 441)
    printed = [f"{both[name]:.4e}" for name in ("p", "p_gg", "p_hf", "p_lb")]
    assert printed == ["1.4271e-206", "4.9313e-156", "1.5406e-158", "9.0151e-71"]


def test_between_effect_is_the_one_way_test_of_subject_means(iris):
    table = rm_anova(iris, subject="flower", within="measurement", value="cm", between="species").set_index("effect")
    means = iris.groupby(["flower", "species"], as_index=False)["cm"].mean()
    (row,) = oneway_anova(means, group="species", value="cm").to_dict("records")
    assert table.loc["species", "F"] == pytest.approx(row["F"])
    assert table.loc["species", "p"] == pytest.approx(row["p"])
    assert np.isnan(table.loc["species", "eps_gg"])


def test_unequal_groups_use_unweighted_means(iris):
    # Two levels make the within effect a t test of the unweighted mean of the groups' mean differences.
    uneven = iris[(iris["measurement"] < 2) & ~iris["flower"].isin(range(30))]
    table = rm_anova(uneven, subject="flower", within="measurement", value="cm", between="species").set_index("effect")
    wide = uneven.pivot_table(index=["flower", "species"], columns="measurement", values="cm")
    difference = (wide[0] - wide[1]).reset_index(name="d")
    groups = [part["d"].to_numpy() for _, part in difference.groupby("species")]
    pooled = sum(((g - g.mean()) ** 2).sum() for g in groups) / (120 - 3)
    centre = np.mean([g.mean() for g in groups])
    t = centre / np.sqrt(pooled * sum(1 / len(g) for g in groups) / 9)
    assert table.loc["measurement", "F"] == pytest.approx(t**2)


@pytest.mark.skipif(not EZ.exists(), reason="this build of statsmodels comes without its test data")
def test_ez_anova_values_of_statsmodels():
    data = pd.read_csv(EZ)
    one = rm_anova(data.iloc[:16], subject="id", within="B", value="DV")
    assert one[["df1", "df2", "F", "p"]].to_numpy() == pytest.approx(np.array([[1, 7, 22.4, 0.002125452]]), rel=1e-6)
    # Two levels: no sphericity to violate.
    assert one[["eps_gg", "eps_hf", "eps_lb"]].to_numpy().tolist() == [[1.0, 1.0, 1.0]]
    two = rm_anova(data.iloc[:48], subject="id", within=["A", "B"], value="DV")
    assert two["effect"].tolist() == ["A", "B", "A:B"]
    expected = [[1, 7, 40.14159, 3.905263e-04], [2, 14, 29.21739, 1.007549e-05], [2, 14, 17.10545, 1.741322e-04]]
    assert two[["df1", "df2", "F", "p"]].to_numpy() == pytest.approx(np.array(expected), rel=1e-6)
    three = rm_anova(data, subject="id", within=["A", "B", "D"], value="DV")
    expected = [
        [1, 7, 8.7650709, 0.021087505],
        [2, 14, 8.4985785, 0.003833921],
        [1, 7, 20.5076546, 0.002704428],
        [2, 14, 0.8457797, 0.450021759],
        [1, 7, 21.7593382, 0.002301792],
        [2, 14, 6.2416695, 0.011536846],
        [2, 14, 5.4253359, 0.018010647],
    ]
    assert three[["df1", "df2", "F", "p"]].to_numpy() == pytest.approx(np.array(expected), rel=1e-6)


def test_the_study_of_2020_is_the_repeated_measures_test_with_36_raters(ratings):
    (row,) = rm_anova(ratings, **RM).to_dict("records")
    assert (row["df1"], row["df2"], row["n"]) == (4, 140, 36)
    assert row["eta_p2"] == pytest.approx(row["F"] * 4 / (row["F"] * 4 + 140))


def test_effect_sizes_from_sums_of_squares(ratings):
    (row,) = rm_anova(ratings, **RM).to_dict("records")
    y = ratings.pivot_table(index="rater", columns="method", values="score").to_numpy()
    n, k = y.shape
    condition = n * ((y.mean(axis=0) - y.mean()) ** 2).sum()
    person = k * ((y.mean(axis=1) - y.mean()) ** 2).sum()
    total = ((y - y.mean()) ** 2).sum()
    error = total - condition - person
    assert (row["SS"], row["SS_err"]) == pytest.approx((condition, error))
    assert row["eta_p2"] == pytest.approx(condition / (condition + error))
    # One factor within: all of the variance is condition, subject or error.
    assert row["eta_g2"] == pytest.approx(condition / total)


def test_missing_cells_are_refused_by_name_or_dropped_and_counted(ratings):
    gap = ratings.drop(index=[3, 52])
    with pytest.raises(ValueError, match=r"2 of 36 subjects lack a value in some cell: r000, r010; .*missing=\"drop\""):
        rm_anova(gap, **RM)
    table = rm_anova(gap, **RM, missing="drop")
    assert table.loc[0, "n_dropped"] == 2
    assert table.loc[0, "n"] == 34
    assert table.attrs["dropped"] == ["r000", "r010"]
    whole = rm_anova(ratings[~ratings["rater"].isin(["r000", "r010"])], **RM)
    assert table.loc[0, "F"] == pytest.approx(whole.loc[0, "F"])
    # A NaN is a missing cell as well.
    blank = ratings.copy()
    blank.loc[[3, 52], "score"] = np.nan
    assert rm_anova(blank, **RM, missing="drop").loc[0, "F"] == table.loc[0, "F"]


def test_duplicates_are_refused_or_averaged(ratings):
    double = pd.concat([ratings, ratings.assign(score=ratings["score"] + 1.0)])
    with pytest.raises(ValueError, match=r'180 cells have several values.*aggregate="mean"'):
        rm_anova(double, **RM)
    assert rm_anova(double, **RM, aggregate="mean").loc[0, "F"] == pytest.approx(rm_anova(ratings, **RM).loc[0, "F"])


def test_a_between_factor_may_not_vary_within_a_subject(ratings):
    with pytest.raises(ValueError, match=r"site must be constant within a subject; it varies in r000"):
        rm_anova(ratings.assign(site=["x", "y"] * 90), **RM, between="site")
    with pytest.raises(ValueError, match="has one level only"):
        rm_anova(ratings.assign(day=1), subject="rater", within=["method", "day"], value="score")


def test_perfect_data_have_infinite_f_and_no_warning(long):
    (row,) = rm_anova(long(np.array([[1.0, 2.0, 3.0]] * 4)), **RM).to_dict("records")
    assert row["F"] == np.inf
    assert row["p"] == row["p_gg"] == 0.0
    (row,) = rm_anova(long(np.ones((4, 3))), **RM).to_dict("records")
    assert np.isnan(row["F"])
