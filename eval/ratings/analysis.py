"""From ratings to the whole analysis: tables with the field's column names, and what they say in words.

What is primary was decided before any rating was seen, and stands in :class:`Plan`. Every table has a column ``sample``
where it was made twice: ``attentive`` (the raters who count) and ``all`` (nobody left out, the sensitivity analysis).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmark.errors import DataError
from eval.ratings.checks import check_assumptions
from eval.ratings.exclusion import ATTENTION, exclude_inattentive
from eval.ratings.reading import Ratings
from eval.ratings.words import conclusions, headline, mixed_words, planning, replication

if TYPE_CHECKING:
    import pandas as pd

ATTENTIVE, ALL = "attentive", "all"

#: The two questions that are compared between conditions, with what a value means.
QUESTIONS: Mapping[str, str] = {"child": "share of target-style answers", "naturalness": "naturalness, 1 to 7"}


@dataclass(frozen=True)
class Plan:
    """What was decided before the ratings were seen.

    Attributes
    ----------
    source, target
        Conditions that show real motion of the source and the target style; empty if there is none.
    alpha
        Familywise error of each family of contrasts; each question is a family of all pairs of conditions.
    margin
        Difference in the share of target-style answers that does not matter: 10 percentage points.
    natural_margin
        Difference in mean naturalness that does not matter: half a step of the scale.
    attention
        Share of right action answers that is not enough.
    power
        Power that the number of raters is planned for.
    seed, resamples
        Of the bootstrap.
    """

    source: str = "adult"
    target: str = "child"
    alpha: float = 0.05
    margin: float = 0.10
    natural_margin: float = 0.5
    attention: float = ATTENTION
    power: float = 0.8
    seed: int = 0
    resamples: int = 4000


@dataclass(frozen=True)
class Analysis:
    """The results.

    Attributes
    ----------
    kind
        Whose answers they are.
    tables
        By name: ``raters, cells, conditions, anova, tukey, contrasts, ranks, nemenyi, wilcoxon, logit, mixed, equivalence,
        power, actions, checks``.
    sections
        Headings and their sentences, in the order of a report.
    """

    kind: str
    tables: Mapping[str, pd.DataFrame]
    sections: Mapping[str, Sequence[str]]


def analyse(ratings: Ratings, plan: Plan | None = None) -> Analysis:
    """Analyse ratings as the plan says.

    Parameters
    ----------
    ratings
        As :func:`eval.ratings.reading.read_ratings` gives them.
    plan
        Decisions; conditions it names that do not occur are passed over.

    Raises
    ------
    DataError
        With fewer than three raters who count and rated every condition, or fewer than two conditions with answers: the
        design compares conditions within raters.

    Notes
    -----
    Primary: paired t tests of per-rater means with Holm's correction (Shaffer's stands beside it), and the rater x clip
    bootstrap of the difference; a difference is called one that carries over to other raters and clips only where both agree.
    For replication of Dong et al. (2020): the repeated-measures analysis of variance (their F(4, 140) is one) and Tukey's test,
    with the right and with the naive error term. For robustness: Friedman, Nemenyi and Wilcoxon on naturalness, logistic GEE on
    the two-way question, a linear mixed model with raters and clips crossed on both. Equivalence with the real target style by
    two one-sided tests.
    """
    import pandas as pd

    plan = Plan() if plan is None else plan
    exclusion = exclude_inattentive(ratings, threshold=plan.attention)
    samples = {ATTENTIVE: exclusion.kept}
    if len(exclusion.kept.raters) < len(ratings.raters):
        samples[ALL] = ratings
    cells = {name: rater_cells(sample) for name, sample in samples.items()}
    _check_design(cells[ATTENTIVE], ratings)
    kept = cells[ATTENTIVE]

    anova = pd.concat([_anova(table, name) for name, table in cells.items()], ignore_index=True)
    contrasts = pd.concat(
        [_contrasts(samples[name], table, name, plan) for name, table in cells.items()], ignore_index=True
    )
    logit, logit_notes = _logit(exclusion.kept, plan)
    mixed, mixed_notes = _mixed(exclusion.kept, plan)
    equivalence = _equivalence(exclusion.kept, kept, plan)
    checks = check_assumptions(exclusion.kept, kept)
    tables = {
        "raters": exclusion.raters,
        "cells": pd.concat([table.assign(sample=name) for name, table in cells.items()], ignore_index=True),
        "conditions": _conditions(exclusion.kept, kept, plan),
        "anova": anova,
        "tukey": _tukey(kept, plan),
        "contrasts": contrasts,
        "ranks": _ranks(kept, plan),
        "nemenyi": _nemenyi(kept, plan),
        "wilcoxon": _wilcoxon(kept, plan),
        "logit": logit,
        "mixed": mixed,
        "equivalence": equivalence,
        "power": _power(kept, anova, plan),
        "actions": _actions(exclusion.kept, plan),
        "checks": checks,
    }
    against_real, among_methods = conclusions(tables, ratings.styles, plan.source, plan.target, plan.margin)
    sections: dict[str, list[str]] = {
        "Raters": [*ratings.notes, exclusion.sentence],
        "Main effect": headline(tables, ratings.styles),
        "Against real motion": against_real,
        "Among methods": among_methods,
        "Replication and robustness": [*replication(tables, ratings.styles), *logit_notes, *mixed_notes],
        "Assumptions": checks["sentence"].tolist(),
        "Power": planning(tables["power"], ratings.styles),
        "Sensitivity": _sensitivity(contrasts, ratings, exclusion.kept),
    }
    return Analysis(ratings.kind, tables, {heading: texts for heading, texts in sections.items() if texts})


def rater_cells(ratings: Ratings) -> pd.DataFrame:
    """Means of what each rater answered in each condition: ``rater, condition, child, naturalness, correct, pages``.

    ``condition`` is categorical, in the order of the stimuli file; conditions without any answer are dropped.
    """
    import pandas as pd

    judged = ratings.judged
    means = judged.groupby(["rater", "condition"])[["child", "naturalness", "correct"]].mean()
    table = means.assign(pages=judged.groupby(["rater", "condition"]).size()).reset_index()
    present = [name for name in ratings.conditions if name in set(table["condition"])]
    table["condition"] = pd.Categorical(table["condition"], categories=present)
    return table.sort_values(["rater", "condition"]).reset_index(drop=True)


def _check_design(cells: pd.DataFrame, ratings: Ratings) -> None:
    conditions = list(cells["condition"].cat.categories)
    if len(conditions) < 2:
        raise DataError(f"answers to {len(conditions)} condition(s) are no comparison: two or more are needed")
    for question in QUESTIONS:
        answered = cells.dropna(subset=[question]).groupby("rater")["condition"].nunique()
        complete = int((answered == len(conditions)).sum())
        if complete < 3:
            raise DataError(
                f"{complete} of {len(ratings.raters)} raters count and answered the question {question!r} in all "
                f"{len(conditions)} conditions ({', '.join(conditions)}): three or more are needed, because conditions are "
                "compared within raters"
            )


def _within(question: str) -> dict[str, Any]:
    return {"subject": "rater", "within": "condition", "value": question, "missing": "drop"}


def _anova(cells: pd.DataFrame, sample: str) -> pd.DataFrame:
    import pandas as pd

    from eval.stats import oneway_anova, rm_anova

    parts = []
    for question in QUESTIONS:
        repeated = rm_anova(cells, **_within(question))
        naive = oneway_anova(cells, group="condition", value=question)
        parts += [
            repeated.assign(design="repeated measures", question=question),
            naive.assign(design="between, as if every cell had its own raters", question=question),
        ]
    table = pd.concat(parts, ignore_index=True).assign(sample=sample)
    first = ["sample", "question", "design"]
    return table[first + [name for name in table.columns if name not in first]]


def _tukey(cells: pd.DataFrame, plan: Plan) -> pd.DataFrame:
    import pandas as pd

    from eval.stats import tukey_hsd_between, tukey_hsd_within

    parts = []
    for question in QUESTIONS:
        within = tukey_hsd_within(cells, **_within(question), alpha=plan.alpha)
        between = tukey_hsd_between(cells, group="condition", value=question, alpha=plan.alpha)
        parts += [
            within.assign(question=question, error_term="within raters"),
            between.assign(question=question, error_term="between raters (naive)"),
        ]
    table = pd.concat(parts, ignore_index=True)
    first = ["question", "error_term"]
    return table[first + [name for name in table.columns if name not in first]]


def _answers(ratings: Ratings, question: str) -> pd.DataFrame:
    """The judged pages with an answer, conditions in order."""
    import pandas as pd

    rows = ratings.judged.dropna(subset=[question])
    present = [name for name in ratings.conditions if name in set(rows["condition"])]
    return rows.assign(condition=pd.Categorical(rows["condition"], categories=present))


def _contrasts(ratings: Ratings, cells: pd.DataFrame, sample: str, plan: Plan) -> pd.DataFrame:
    """Holm-corrected paired contrasts of both questions, with the rater x clip bootstrap of each difference."""
    import pandas as pd

    from eval.stats import holm_paired

    parts = []
    for question in QUESTIONS:
        table = holm_paired(cells, **_within(question), alpha=plan.alpha).assign(question=question, sample=sample)
        means = cells.groupby("condition", observed=True)[question].mean()
        table["mean_a"], table["mean_b"] = table["a"].map(means).astype(float), table["b"].map(means).astype(float)
        drawn = _drawn(ratings, question, plan)
        drawn = drawn[drawn["quantity"] == "difference"].set_index(["a", "b"])
        pairs = list(zip(table["a"], table["b"], strict=True))
        for column, name in (
            ("estimate", "diff_answers"),
            ("low", "low_clips"),
            ("high", "high_clips"),
            ("p", "p_clips"),
        ):
            table[name] = [float(drawn.loc[pair, column]) for pair in pairs]
        parts.append(table)
    result = pd.concat(parts, ignore_index=True)
    first = ["sample", "question", "a", "b", "mean_a", "mean_b"]
    return result[first + [name for name in result.columns if name not in first]]


def _drawn(ratings: Ratings, question: str, plan: Plan) -> pd.DataFrame:
    """Conditions and their differences, raters and clips resampled: shares of yes, or means of naturalness."""
    from eval.stats import pigeonhole_bootstrap, pigeonhole_means

    shared: dict[str, Any] = {"rater": "rater", "clip": "clip_id", "condition": "condition"}
    shared |= {"seed": plan.seed, "resamples": plan.resamples}
    answers = _answers(ratings, question)
    if question == "naturalness":
        return pigeonhole_means(answers, value=question, **shared)
    return pigeonhole_bootstrap(answers, answer=question, **shared)


def _conditions(ratings: Ratings, cells: pd.DataFrame, plan: Plan) -> pd.DataFrame:
    """One row a condition: shares and means with intervals, and the five numbers of a box plot over raters.

    ``naturalness_low`` and ``_high`` are for comparing conditions within raters (Cousineau-Morey), ``…_clips`` over raters and
    clips, as those of the share are.
    """
    import pandas as pd

    from eval.stats import cousineau_morey

    answers = _answers(ratings, "child")
    shares, means = (
        table[table["quantity"] != "difference"].set_index("a")
        for table in (_drawn(ratings, question, plan) for question in QUESTIONS)
    )
    natural = cousineau_morey(cells, **_within("naturalness")).set_index("level")
    rows = []
    for condition in cells["condition"].cat.categories:
        of = cells[cells["condition"] == condition]
        row: dict[str, Any] = {"condition": condition}
        row |= {"raters": len(of), "clips": int(shares.loc[condition, "n_clips"])}
        row |= {"answers": int((answers["condition"] == condition).sum())}
        row |= {f"child_{name}": float(shares.loc[condition, key]) for name, key in _SHARE_COLUMNS.items()}
        row |= {f"naturalness_{name}": float(natural.loc[condition, name]) for name in ("mean", "low", "high", "sd")}
        row |= {f"naturalness_{name}_clips": float(means.loc[condition, name]) for name in ("low", "high")}
        for question in QUESTIONS:
            values = of[question].dropna().to_numpy()
            for name, quantile in (("min", 0), ("q1", 25), ("median", 50), ("q3", 75), ("max", 100)):
                row[f"{question}_{name}"] = float(np.percentile(values, quantile))
        row["action_correct"] = (
            float(of["correct"].mean()) if ratings.asks_action and of["correct"].notna().any() else np.nan
        )
        rows.append(row)
    return pd.DataFrame(rows)


_SHARE_COLUMNS = {"share": "estimate", "low": "low", "high": "high"}


def _ranks(cells: pd.DataFrame, plan: Plan) -> pd.DataFrame:
    from eval.stats import mean_ranks

    table = mean_ranks(cells, **_within("naturalness"), best="high", alpha=plan.alpha)
    table["groups"] = [" ".join(str(number) for number in groups) for groups in table["groups"]]
    return table.rename(columns={"level": "condition"})


def _nemenyi(cells: pd.DataFrame, plan: Plan) -> pd.DataFrame:
    from eval.stats import friedman_nemenyi

    return friedman_nemenyi(cells, **_within("naturalness"), best="high", alpha=plan.alpha)


def _wilcoxon(cells: pd.DataFrame, plan: Plan) -> pd.DataFrame:
    from eval.stats import wilcoxon_holm

    return wilcoxon_holm(cells, **_within("naturalness"), alpha=plan.alpha)


def _logit(ratings: Ratings, plan: Plan) -> tuple[pd.DataFrame, list[str]]:
    """Odds ratios against the source condition, answers clustered by rater, and by rater and clip."""
    import pandas as pd

    from eval.stats import gee_logit

    answers = _answers(ratings, "child")
    conditions = list(answers["condition"].cat.categories)
    reference = plan.source if plan.source in conditions else conditions[0]
    ways: list[tuple[str, str | None]] = [("rater", None)]
    if answers["clip_id"].nunique() > 1:
        ways.append(("rater and clip", "clip_id"))
    parts, notes = [], []
    for name, clip in ways:
        try:
            table = gee_logit(
                answers, subject="rater", condition="condition", answer="child", clip=clip, reference=reference
            )
        except ValueError as error:
            notes.append(f"Clustered by {name}, odds ratios could not be estimated: {error}.")
            continue
        parts.append(table.assign(clustered_by=name))
    return (pd.concat(parts, ignore_index=True) if parts else pd.DataFrame({"clustered_by": []})), notes


def _mixed(ratings: Ratings, plan: Plan) -> tuple[pd.DataFrame, list[str]]:
    """Differences from the source condition by a linear mixed model of both questions, and what it says in words."""
    import pandas as pd

    from eval.stats import mixed_model

    parts, notes = [], []
    for question, meaning in QUESTIONS.items():
        answers = _answers(ratings, question)
        conditions = list(answers["condition"].cat.categories)
        reference = plan.source if plan.source in conditions else conditions[0]
        try:
            table = mixed_model(
                answers, rater="rater", clip="clip_id", condition="condition", value=question, reference=reference
            )
        except ValueError as error:
            notes.append(f"A linear mixed model of the {meaning} could not be fitted: {error}.")
            continue
        parts.append(table.assign(question=question, model="linear probability" if question == "child" else "linear"))
        notes.append(mixed_words(table, meaning, reference, plan.alpha))
    return (pd.concat(parts, ignore_index=True) if parts else pd.DataFrame({"question": []})), notes


def _equivalence(ratings: Ratings, cells: pd.DataFrame, plan: Plan) -> pd.DataFrame:
    """Two one-sided tests of every condition against real motion of the target style; empty without that condition."""
    import pandas as pd

    from eval.stats import tost_paired, tost_pigeonhole

    if plan.target not in set(cells["condition"]):
        return pd.DataFrame({"question": [], "test": []})
    shared: dict[str, Any] = {"reference": plan.target, "alpha": plan.alpha}
    parts = []
    for question, margin in (("child", plan.margin), ("naturalness", plan.natural_margin)):
        drawn = tost_pigeonhole(
            _answers(ratings, question),
            rater="rater",
            clip="clip_id",
            condition="condition",
            answer=question,
            margin=margin,
            scale=question == "naturalness",
            seed=plan.seed,
            resamples=plan.resamples,
            **shared,
        )
        parts += [
            tost_paired(cells, **_within(question), margin=margin, **shared).assign(question=question, test="paired t"),
            drawn.assign(question=question, test="rater x clip bootstrap"),
        ]
    table = pd.concat(parts, ignore_index=True)
    first = ["question", "test"]
    return table[first + [name for name in table.columns if name not in first]]


def _power(cells: pd.DataFrame, anova: pd.DataFrame, plan: Plan) -> pd.DataFrame:
    """What this number of raters can find, and how many an effect needs; planned effects, never the observed one.

    The correlation between conditions and epsilon are those of this study, because a plan can only guess them.
    """
    import pandas as pd

    from eval.stats import power_rm, raters_needed, smallest_dz
    from eval.stats.frames import to_wide

    rows = []
    for question in QUESTIONS:
        wide = to_wide(cells, **_within(question)).values
        n, k = wide.shape
        covariance = np.cov(wide, rowvar=False)
        variance = float(np.trace(covariance) / k)
        shared = float((covariance.sum() - np.trace(covariance)) / (k * (k - 1)))
        # Without any spread between raters there is nothing to correlate.
        rho = float(np.clip(shared / variance, -1.0 / (k - 1), 0.99)) if variance > 0 else 0.0
        test = anova[(anova["sample"] == ATTENTIVE) & (anova["question"] == question) & anova["eps_gg"].notna()]
        eps = float(test["eps_gg"].iloc[0]) if len(test) else 1.0
        pairs = k * (k - 1) / 2
        for f in (0.1, 0.25, 0.4):  # small, medium and large after Cohen (1988)
            facts = {"k": k, "f": f, "rho": rho, "eps": eps, "alpha": plan.alpha}
            rows.append(
                {
                    "question": question,
                    "n": n,
                    **facts,
                    "power": power_rm(n=n, **facts),
                    "raters_needed": raters_needed(**facts, power=plan.power),
                    "planned_power": plan.power,
                    "smallest_dz": smallest_dz(n=n, alpha=plan.alpha, power=plan.power),
                    "smallest_dz_all_pairs": smallest_dz(n=n, alpha=plan.alpha / pairs, power=plan.power),
                }
            )
    return pd.DataFrame(rows)


def _actions(ratings: Ratings, plan: Plan) -> pd.DataFrame:
    """How often the action was named right in each condition, with rater x clip intervals; empty if it was not asked."""
    import pandas as pd

    from eval.stats import pigeonhole_bootstrap

    columns = ["condition", "share", "low", "high", "answers", "raters", "clips"]
    if not ratings.asks_action or not ratings.judged["attention"].any():
        return pd.DataFrame(columns=columns)
    answers = _answers(ratings, "correct")
    drawn = pigeonhole_bootstrap(
        answers,
        rater="rater",
        clip="clip_id",
        condition="condition",
        answer="correct",
        seed=plan.seed,
        resamples=plan.resamples,
    )
    drawn = drawn[drawn["quantity"] == "proportion"]
    counts = answers.groupby("condition", observed=True).size()
    return pd.DataFrame(
        {
            "condition": drawn["a"],
            "share": drawn["estimate"],
            "low": drawn["low"],
            "high": drawn["high"],
            "answers": [int(counts[name]) for name in drawn["a"]],
            "raters": drawn["n_raters"],
            "clips": drawn["n_clips"],
        }
    )


def _sensitivity(contrasts: pd.DataFrame, ratings: Ratings, kept: Ratings) -> list[str]:
    """Which contrasts come out otherwise when nobody is left out."""
    if ALL not in set(contrasts["sample"]):
        return ["Nobody was excluded, so the analysis of all raters is the same."]
    keys = ["question", "a", "b"]
    both = contrasts[contrasts["sample"] == ATTENTIVE].merge(
        contrasts[contrasts["sample"] == ALL], on=keys, suffixes=("", "_all")
    )
    changed = both[both["reject"] != both["reject_all"]]
    head = f"With all {len(ratings.raters)} raters instead of the {len(kept.raters)} who count"
    if changed.empty:
        return [f"{head}, every one of the {len(both)} contrasts is decided the same way."]
    asked = {"child": f"{ratings.styles[1]!r} answers", "naturalness": "naturalness"}
    listed = "; ".join(
        f"{row.a} against {row.b} in {asked[str(row.question)]} is {'no longer' if row.reject else 'then'} significant"
        for row in changed.itertuples()
    )
    return [f"{head}, {len(changed)} of {len(both)} contrasts are decided otherwise: {listed}."]
