"""From stored scores and ratings to a verdict on each claim."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from reports.claims.definitions import (
    CLAIMS,
    Between,
    Claim,
    Contrast,
    Level,
    Nearer,
    Rated,
    Test,
    Untestable,
)
from reports.claims.ratings import RatingsView
from reports.jumps import jump_cases, jump_table
from reports.run import RunView

if TYPE_CHECKING:
    import pandas as pd

#: Columns of the table of claims.
COLUMNS = (
    "claim",
    "paper",
    "where",
    "statement",
    "test",
    "run",
    "task",
    "n",
    "effect",
    "low",
    "high",
    "p",
    "p_holm",
    "alpha",
    "verdict",
    "why",
)

#: Resamples of a test: enough for p values that survive Holm's correction over the table.
_RESAMPLES = 20_000

HOLDS, FAILS, UNTESTED = "holds", "does not hold", "cannot be tested here"


@dataclass(frozen=True)
class Finding:
    """What one test found on one task of one run.

    Attributes
    ----------
    n
        In words: clips and actors, or raters.
    effect, low, high
        The difference, positive where it has the stated sign, and its 95 % interval.
    p
        Two-sided; NaN where the verdict is by the interval alone.
    run, task
        Where it was found.
    note
        What the reader has to know, such as that raters were simulated.
    """

    n: str
    effect: float
    low: float
    high: float
    p: float
    run: str
    task: str
    note: str = ""


class MissingEvidenceError(Exception):
    """A test that the runs at hand cannot answer; the message says what is missing."""


def judge(runs: Sequence[RunView], claims: Sequence[Claim | Untestable] = CLAIMS) -> pd.DataFrame:
    """One row for each test of each claim, with columns :data:`COLUMNS`.

    Each test is made on the first task of the first run that has what it needs, or on every one where the claim is about every
    style. p values are corrected by Holm's method over
    all tests that have one. A claim holds where each of its tests shows the stated difference: its interval is on the stated
    side of 0 and its corrected p value below the claim's level.

    Parameters
    ----------
    runs
        Finished runs.
    claims
        What is to be judged.
    """
    import pandas as pd

    from eval.stats.correction import holm

    rows: list[dict[str, object]] = []
    for claim in claims:
        common = {"claim": claim.name, "paper": claim.paper, "where": claim.where, "statement": claim.statement}
        if isinstance(claim, Untestable):
            rows.append({**common, "verdict": UNTESTED, "why": claim.reason})
            continue
        for test in claim.tests:
            row = {**common, "test": test.words, "alpha": claim.alpha}
            try:
                findings = find_all(runs, test) if claim.every_task else [find(runs, test)]
            except MissingEvidenceError as missing:
                rows.append({**row, "verdict": UNTESTED, "why": str(missing)})
                continue
            for found in findings:
                facts = {name: getattr(found, name) for name in ("n", "effect", "low", "high", "p", "run", "task")}
                notes = "; ".join(filter(None, (found.note, claim.note)))
                margin = getattr(test, "margin", 0.0)
                if margin:  # judged by the interval; a test of "no difference" answers another question
                    facts["p"] = float("nan")
                where = f" ({found.run}, {found.task})" if claim.every_task else ""
                rows.append({**row, "test": test.words + where, **facts, "why": notes, "margin": margin})
    numbers = ("effect", "low", "high", "p", "p_holm", "alpha", "margin")
    table = pd.DataFrame(rows, columns=[*COLUMNS, "margin"])
    table = table.astype({name: float if name in numbers else object for name in table.columns})
    tested = table["p"].notna()
    if tested.any():
        table.loc[tested, "p_holm"] = holm(table.loc[tested, "p"].to_numpy())
    for index in table.index[table["verdict"].isna()]:
        verdict, why = _verdict(table.loc[index])
        table.loc[index, "verdict"] = verdict
        table.loc[index, "why"] = "; ".join(filter(None, (why, table.loc[index, "why"])))
    text = [name for name in COLUMNS if name not in numbers]
    table[text] = table[text].fillna("").astype(str)
    return table.drop(columns="margin")


def claim_verdicts(table: pd.DataFrame) -> dict[str, str]:
    """The verdict of each claim: it holds if all its tests do, and cannot be tested if one of them cannot and none fails."""
    verdicts = {}
    for name, group in table.groupby("claim", sort=False):
        found = set(group["verdict"])
        verdicts[str(name)] = FAILS if FAILS in found else UNTESTED if UNTESTED in found else HOLDS
    return verdicts


def claim_counts(table: pd.DataFrame) -> str:
    """In words: ``22 claims: 6 hold, 15 do not hold, 1 cannot be tested here``."""
    verdicts = list(claim_verdicts(table).values())
    words = {HOLDS: ("holds", "hold"), FAILS: ("does not hold", "do not hold"), UNTESTED: (UNTESTED, UNTESTED)}
    counts = ((verdicts.count(verdict), forms) for verdict, forms in words.items())
    told = ", ".join(f"{count} {one if count == 1 else more}" for count, (one, more) in counts if count)
    return f"{len(verdicts)} claim{'' if len(verdicts) == 1 else 's'}: {told}"


def _verdict(row: pd.Series) -> tuple[str, str]:
    effect, low, p, alpha = row["effect"], row["low"], row["p_holm"], row["alpha"]
    if row["margin"]:
        return (HOLDS, "") if low > -row["margin"] else (FAILS, f"a difference of {-low:.3g} the wrong way is possible")
    if not np.isfinite(row["p"]):
        return (HOLDS, "") if effect > 0 else (FAILS, "no performance is nearer")
    if effect > 0 and low > 0 and p < alpha:
        return HOLDS, ""
    if effect <= 0 and row["high"] < 0:
        return FAILS, "the difference goes the other way"
    if effect <= 0:
        return FAILS, "no difference of the stated sign"
    return FAILS, "no difference can be shown" if low <= 0 else f"p is not below {alpha:g} after correction"


def find(runs: Sequence[RunView], test: Test) -> Finding:
    """Make one test; a :class:`MissingEvidenceError` says what no run has."""
    if isinstance(test, Rated):
        return _rated(runs, test)
    if isinstance(test, Nearer):
        return _nearer(runs, test)
    return next(_everywhere(runs, test))


def find_all(runs: Sequence[RunView], test: Test) -> list[Finding]:
    """The test on every task of every run that can answer it; a :class:`MissingEvidenceError` if none can.

    Of ratings and of the poster's jumps there is one finding only.
    """
    return [find(runs, test)] if isinstance(test, Rated | Nearer) else list(_everywhere(runs, test))


def _everywhere(runs: Sequence[RunView], test: Contrast | Level | Between) -> Iterator[Finding]:
    reasons, found = [], False
    for run in runs:
        for task in run.tasks:
            try:
                finding = _measured(run, task, test)
            except MissingEvidenceError as missing:
                reasons.append(f"{run.folder.name}: {missing}" if len(runs) > 1 else str(missing))
                continue
            found = True
            yield finding
    if not found:
        raise MissingEvidenceError("; ".join(dict.fromkeys(reasons)))


def _measured(run: RunView, task: str, test: Contrast | Level | Between) -> Finding:
    """A difference of scores on the same clips, by the hierarchical bootstrap of :mod:`eval.stats.comparison`."""
    import pandas as pd

    from eval.stats.comparison import compare

    def scores(method: str, metric: str) -> pd.DataFrame:
        rows = run.results
        known = rows[(rows["task"] == task) & (rows["method"] == method)]
        if known.empty:
            raise MissingEvidenceError(f"the run has no row {method}")
        chosen = known[(known["metric"] == metric) & (known["status"] == "ok")]
        chosen = chosen[(chosen["variant"] == test.variant) & (chosen["clip_id"] != "")]
        if chosen.empty:
            why = "; ".join(sorted(set(known.loc[known["metric"] == metric, "reason"]) - {""}))
            raise MissingEvidenceError(f"{method} has no {metric}" + (f" ({why})" if why else ""))
        return chosen[["actor", "clip_id", "repetition", "value"]]

    if isinstance(test, Contrast):
        left, right = scores(test.left, test.metric), scores(test.right, test.metric)
    elif isinstance(test, Level):
        left = scores(test.method, test.metric)
        right = left.assign(value=test.value)
    else:
        left, right = scores(test.method, test.metric), scores(test.method, test.other)
    both = pd.concat([left.assign(method="left"), right.assign(method="right")]).assign(metric=test.metric)
    differences = compare(both, pairs=[("left", "right")], resamples=_RESAMPLES).differences
    if differences.empty:
        raise MissingEvidenceError("the two have no clip in common")
    row = differences.iloc[0]
    sign = 1.0 if test.sign == "higher" else -1.0
    limits = sorted((sign * row["low"], sign * row["high"]))
    seeds = left["repetition"].nunique()
    actors = pd.concat([left, right])["actor"].nunique()
    n = f"{int(row['n_clips'])} clips of {actors} actors" + (f", {seeds} training seeds" if seeds > 1 else "")
    return Finding(n, sign * row["diff"], limits[0], limits[1], float(row["p"]), run.folder.name, task)


def _rated(runs: Sequence[RunView], test: Rated) -> Finding:
    reasons = []
    for run in runs:
        view = RatingsView.of(run)
        if view is None:
            reasons.append(f"no ratings: `python -m benchmark analyze {run.folder}` makes or reads them")
            continue
        missing = [name for name in test.methods if name not in view.conditions]
        if missing:
            reasons.append(f"nobody rated {', '.join(missing)}")
            continue
        effect, low, high, p = view.difference(test.measure, test.left, test.right)
        if test.sign == "lower":
            effect, low, high = -effect, -high, -low
        return Finding(view.raters, effect, low, high, p, run.folder.name, view.task, view.note)
    raise MissingEvidenceError("; ".join(dict.fromkeys(reasons)))


def _nearer(runs: Sequence[RunView], test: Nearer) -> Finding:
    """The poster's statements, on the poster's own division of the recordings."""
    reasons = []
    for run in runs:
        if (run.document("split.json") or {}).get("protocol") != "named":
            continue
        for task in run.tasks:
            cases = jump_cases(run, task)
            table = jump_table(cases)
            if len(table):
                verdicts = table.loc[table["row"] == test.method, f"nearer_{test.measure}"]
                told = verdicts[verdicts.isin(["yes", "no"])]
                if len(told):
                    share = float((told == "yes").mean())
                    n = f"{len(told)} jump{'s'[: len(told) != 1]}"
                    return Finding(n, share - 0.5, float("nan"), float("nan"), float("nan"), run.folder.name, task)
            # Without the recordings that the run was made on there is nobody to be nearer to.
            reasons += [f"{run.folder}: {case.problem}" for case in cases if case.problem]
    if reasons:
        raise MissingEvidenceError("; ".join(dict.fromkeys(reasons)))
    raise MissingEvidenceError(
        "needs the poster's own division of the recordings: run experiments/dong2018.toml and name its folder too"
    )
