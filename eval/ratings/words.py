"""What the tables say, in plain words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import pandas as pd


def p_words(p: float) -> str:
    """``p < 0.001`` or ``p = 0.012``; ``no p`` where there is none."""
    if not np.isfinite(p):
        return "no p"
    return "p < 0.001" if p < 0.001 else f"p = {p:.3f}"


def points(share: float) -> str:
    """A share in percentage points, with its sign."""
    return f"{100 * share:+.0f}"


def headline(tables: Mapping[str, pd.DataFrame], styles: tuple[str, str]) -> list[str]:
    """The main effect of the condition on each question, and what each condition received."""
    anova = tables["anova"]
    rows = anova[(anova["sample"] == "attentive") & (anova["design"] == "repeated measures")]
    sentences = []
    row: Any
    for row in rows.itertuples():
        name = f"share of {styles[1]!r} answers" if row.question == "child" else "naturalness"
        if not np.isfinite(row.F):
            sentences.append(f"The {name} does not vary within raters beyond the conditions, so there is no F test.")
            continue
        corrected = f"Greenhouse-Geisser corrected {p_words(row.p_gg)}, epsilon {row.eps_gg:.2f}"
        verdict = "depends" if row.p_gg < 0.05 else "was not shown to depend"
        sentences.append(
            f"The {name} {verdict} on the condition: repeated-measures analysis of variance F({row.df1}, {row.df2}) = "
            f"{row.F:.2f}, {corrected}, partial eta squared {row.eta_p2:.2f} [90 % interval {row.eta_p2_low:.2f}, "
            f"{row.eta_p2_high:.2f}], {row.n} raters."
        )
    for row in tables["conditions"].itertuples():
        action = (
            "" if np.isnan(row.action_correct) else f", the action was named right {100 * row.action_correct:.0f} %"
        )
        sentences.append(
            f"{row.condition}: {100 * row.child_share:.0f} % {styles[1]!r} [95 % interval over raters and clips "
            f"{100 * row.child_low:.0f}, {100 * row.child_high:.0f}], naturalness {row.naturalness_mean:.1f}{action}."
        )
    return sentences


def conclusions(
    tables: Mapping[str, pd.DataFrame], styles: tuple[str, str], source: str, target: str, margin: float
) -> tuple[list[str], list[str]]:
    """One sentence a contrast: those with real motion, equivalence with the target included, and those among methods."""
    contrasts = tables["contrasts"]
    rows = contrasts[contrasts["sample"] == "attentive"]
    real: list[str] = []
    methods: list[str] = []
    row: Any
    for question in ("child", "naturalness"):
        for row in rows[rows["question"] == question].itertuples():
            text = _share_contrast(row, styles) if question == "child" else _natural_contrast(row, tables["wilcoxon"])
            (real if {row.a, row.b} & {source, target} else methods).append(text)
    return real + _equivalence(tables["equivalence"], styles, target, margin), methods


def _share_contrast(row: Any, styles: tuple[str, str]) -> str:
    # Told from the side that received more, so that the difference is positive.
    if row.diff >= 0:
        more, less, high_share, low_share, low, high = (
            row.a,
            row.b,
            row.mean_a,
            row.mean_b,
            row.low_clips,
            row.high_clips,
        )
    else:
        more, less, high_share, low_share, low, high = (
            row.b,
            row.a,
            row.mean_b,
            row.mean_a,
            -row.high_clips,
            -row.low_clips,
        )
    facts = (
        f"{100 * high_share:.0f} % against {100 * low_share:.0f} %, difference {points(abs(row.diff))} points [95 % interval "
        f"over raters and clips {points(low)}, {points(high)}]; Holm-corrected {p_words(row.p_holm)}, {_dz(row.dz)}"
    )
    if row.reject and low > 0:
        return f"{more} was called {styles[1]!r} more often than {less}: {facts}."
    if row.reject:
        return (
            f"{more} was called {styles[1]!r} more often than {less} on these clips, but that need not carry over to other "
            f"clips: {facts}."
        )
    return (
        f"No difference in {styles[1]!r} answers was shown between {row.a} and {row.b}, which is no proof of sameness: "
        f"{facts}."
    )


def _natural_contrast(row: Any, wilcoxon: pd.DataFrame) -> str:
    rank = wilcoxon[(wilcoxon["a"] == row.a) & (wilcoxon["b"] == row.b)].iloc[0]
    if row.diff >= 0:
        more, less, high, low, bounds = row.a, row.b, row.mean_a, row.mean_b, (row.low_clips, row.high_clips)
    else:
        more, less, high, low, bounds = row.b, row.a, row.mean_b, row.mean_a, (-row.high_clips, -row.low_clips)
    facts = (
        f"{high:.1f} against {low:.1f} of 7, difference {abs(row.diff):+.2f} [95 % interval over raters and clips "
        f"{bounds[0]:+.2f}, {bounds[1]:+.2f}]; Holm-corrected {p_words(row.p_holm)}, {_dz(row.dz)}; Wilcoxon "
        f"{p_words(float(rank['p_holm']))}"
    )
    if row.reject and bool(rank["reject"]) and bounds[0] > 0:
        return f"{more} was rated more natural than {less}: {facts}."
    if row.reject and bool(rank["reject"]):
        return (
            f"{more} was rated more natural than {less} on these clips, which need not carry over to others: {facts}."
        )
    if row.reject or bool(rank["reject"]):
        return f"{more} was rated more natural than {less} by one of the two tests only, so it is not settled: {facts}."
    return f"No difference in naturalness was shown between {more} and {less}: {facts}."


def mixed_words(table: pd.DataFrame, meaning: str, reference: str, alpha: float) -> str:
    """What a linear mixed model says of one question; of a fit that did not converge that, and nothing else."""
    row: Any = table.iloc[0]
    head = f"Linear mixed model of the {meaning}, raters and clips both random"
    if not row["converged"]:
        return f"{head}: {row['note']}."
    different = table.loc[table["p"] <= alpha, "a"].tolist()
    found = ", ".join(map(str, different)) if different else "no condition"
    variances = ", ".join(
        f"{name} {row[column]:.3g}"
        for name, column in (
            ("raters", "var_rater"),
            ("clips", "var_clip"),
            ("raters' reactions to a condition", "var_rater_condition"),
            ("single stimuli", "var_stimulus"),
            ("single answers", "var_residual"),
        )
        if np.isfinite(row[column])
    )
    note = f"; {row['note']}" if row["note"] else ""
    return (
        f"{head}: against {reference}, {found} {'differs' if len(different) <= 1 else 'differ'} at p <= {alpha:g}, "
        f"uncorrected; variances: {variances}{note}."
    )


def replication(tables: Mapping[str, pd.DataFrame], styles: tuple[str, str]) -> list[str]:
    """Tukey's test with the right and with the naive error term, and what the rank tests say of naturalness."""
    tukey = tables["tukey"]
    sentences = []
    for question, name in (("child", f"{styles[1]!r} answers"), ("naturalness", "naturalness")):
        of = tukey[tukey["question"] == question]
        naive = of["error_term"].str.startswith("between")
        found, all_pairs = int(of.loc[~naive, "reject"].sum()), int((~naive).sum())
        sentences.append(
            f"Tukey's test on {name}: {found} of {all_pairs} pairs differ with the error within raters, "
            f"{int(of.loc[naive, 'reject'].sum())} with the error between them, which counts the raters' own levels as noise."
        )
    test = tables["nemenyi"].iloc[0]
    ranks = ", ".join(f"{row.condition} {row.mean_rank:.1f}" for row in tables["ranks"].itertuples())
    figures = f"chi-squared({test['df']:.0f}) = {test['chi2']:.1f}, {p_words(float(test['p_friedman']))}"
    sentences.append(
        f"Naturalness by ranks: Friedman {figures}; mean ranks, best first: {ranks}; Nemenyi's critical difference "
        f"{test['cd']:.2f}."
    )
    return sentences


def planning(table: pd.DataFrame, styles: tuple[str, str]) -> list[str]:
    """What this number of raters can find, and how many a medium effect needs."""
    sentences = []
    row: Any
    for row in table[table["f"] == 0.25].itertuples():
        name = f"{styles[1]!r} answers" if row.question == "child" else "naturalness"
        sentences.append(
            f"Power for {name}: {row.n} raters find a medium main effect (f = 0.25; correlation {row.rho:.2f} and epsilon "
            f"{row.eps:.2f} as in these ratings) with probability {row.power:.2f}; {row.raters_needed} raters would do for "
            f"{row.planned_power:g}. The smallest paired difference found with that power is d_z {row.smallest_dz:.2f} for one "
            f"contrast and {row.smallest_dz_all_pairs:.2f} for any of all pairs."
        )
    return sentences


def _equivalence(table: pd.DataFrame, styles: tuple[str, str], target: str, margin: float) -> list[str]:
    if table.empty:
        return [f"There is no condition {target!r} of real motion, so that equivalence with it cannot be tested."]
    sentences = []
    share = table[table["question"] == "child"]
    for name in dict.fromkeys(share["a"]):
        tests = share[share["a"] == name].set_index("test")
        paired, drawn = tests.loc["paired t"], tests.loc["rater x clip bootstrap"]
        bounds = (
            f"difference {points(drawn['diff'])} points [90 % interval {points(drawn['low'])}, {points(drawn['high'])}]"
        )
        within = f"within {100 * margin:g} points of real {styles[1]} motion in {styles[1]!r} answers"
        if paired["equivalent"] and drawn["equivalent"]:
            sentences.append(f"{name} is equivalent, {within}: {bounds}.")
        elif paired["equivalent"]:
            sentences.append(f"{name} is equivalent on these clips, {within}, but not shown to be on others: {bounds}.")
        else:
            sentences.append(f"{name} was not shown to be {within}: {bounds}.")
    return sentences


def _dz(dz: float) -> str:
    if not np.isfinite(dz):
        return "no d_z"
    size = abs(dz)
    word = "negligible" if size < 0.2 else "small" if size < 0.5 else "medium" if size < 0.8 else "large"
    return f"d_z {size:.2f} ({word})"
