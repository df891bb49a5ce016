"""Methods compared on the objective metrics of a run: differences with intervals, and ranks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.runner.views import read_leaderboard
from reports.run import RunView

if TYPE_CHECKING:
    import pandas as pd

#: Files in the folder of the statistics.
COMPARISON, RANKS = "metrics-comparison.csv", "metrics-ranks.csv"

#: Draws of the bootstrap at least, and for each test of the largest family: its p is never below two over their number, and has
#: to be able to pass 5 % when Holm multiplies it by the tests of a family.
RESAMPLES, RESAMPLES_PER_TEST = 20_000, 60

#: Values nearer to 0 than this are rounding noise, and ranks of it would be ranks of nothing.
_NOISE = 1e-9


@dataclass(frozen=True)
class MetricComparison:
    """Every task and variant of a run in two tables.

    Attributes
    ----------
    differences
        ``task, variant, metric, a, b, diff, low, high, p, p_flip, unit, n_units, n_clips, family, p_holm, family_size,
        reject``: see :func:`eval.stats.compare`.
    ranks
        ``task, variant, metric, direction, method, mean_rank, groups, cd, chi2, df, p, n, k, n_dropped``, without real
        performers, who are no competitors; ``groups`` are the numbers of the bars of a critical-difference diagram.
    """

    differences: pd.DataFrame
    ranks: pd.DataFrame


def compare_metrics(run: RunView, *, seed: int = 0, resamples: int | None = None) -> MetricComparison:
    """Compare all methods of a run on all metrics of single clips.

    Parameters
    ----------
    run
        The run; real performers take part in the differences.
    seed, resamples
        Of the hierarchical bootstrap and the permutations; ``None`` for as many as the largest family needs.

    Returns
    -------
    MetricComparison
        Empty tables where no task has two methods with values.

    Notes
    -----
    The declared families: the metrics of one group (``physics``, ``style`` …) of one task and variant, over all pairs of
    methods. Metrics that describe rather than judge (direction ``none``) are compared, and not ranked.
    """
    import pandas as pd

    differences, ranks = [], []
    for task in run.tasks:
        for variant in run.variants(task):
            found = _compare(run, task, variant, seed, resamples)
            if found is not None:
                differences.append(found[0])
                ranks.append(found[1])
    if not differences:
        return MetricComparison(pd.DataFrame({"task": []}), pd.DataFrame({"task": []}))
    return MetricComparison(pd.concat(differences, ignore_index=True), pd.concat(ranks, ignore_index=True))


def _compare(
    run: RunView, task: str, variant: str, seed: int, resamples: int | None
) -> tuple[pd.DataFrame, pd.DataFrame] | None:
    import pandas as pd

    from eval.stats import compare

    rows = run.results
    rows = rows[(rows["task"] == task) & (rows["variant"] == variant) & (rows["status"] == "ok")]
    # One value a clip; metrics of whole sets have one a method, which says nothing of its spread.
    rows = rows[(rows["clip_id"] != "") & ~rows["metric"].str.startswith("cost/")]
    if rows["method"].nunique() < 2:
        return None
    rows = rows.assign(
        method=pd.Categorical(rows["method"], categories=run.methods(task)),
        value=rows["value"].where(rows["value"].abs() >= _NOISE, 0.0),
    )
    families: dict[str, list[str]] = {}
    for name in dict.fromkeys(rows["metric"]):
        families.setdefault(name.partition("/")[0], []).append(name)
    if resamples is None:
        methods = rows["method"].nunique()
        tests = max(map(len, families.values())) * methods * (methods - 1) // 2
        resamples = max(RESAMPLES, RESAMPLES_PER_TEST * tests)
    differences = compare(rows, families=families, seed=seed, resamples=resamples).differences

    competitors = rows[rows["method"] != run.real_method]
    meanings = {
        row["metric"]: (row["direction"], row["target"]) for row in read_leaderboard(run.folder) if row["task"] == task
    }
    goals = {name: _goal(*meanings[name]) for name in dict.fromkeys(competitors["metric"])}
    better = {name: goal for name, goal in goals.items() if goal is not None}
    # Ranks are not resampled, so that one draw is enough.
    ranks = compare(competitors, better=better, families={}, resamples=1).ranks
    ranks["groups"] = [" ".join(str(number) for number in groups) for groups in ranks["groups"]]
    ranks.insert(0, "direction", [meanings[name][0] for name in ranks["metric"]])
    return _placed(differences, task, variant), _placed(ranks, task, variant)


def _goal(direction: str, target: float | None) -> str | float | None:
    if direction == "target":
        return target
    return {"lower": "low", "higher": "high"}.get(direction)


def _placed(table: pd.DataFrame, task: str, variant: str) -> pd.DataFrame:
    table = table.copy()
    table.insert(0, "task", task)
    table.insert(1, "variant", variant)
    return table


def write_comparison(run: RunView, out: Path, *, seed: int = 0, resamples: int | None = None) -> MetricComparison:
    """Write ``metrics-comparison.csv`` and ``metrics-ranks.csv`` into the folder ``out``, and return both tables."""
    comparison = compare_metrics(run, seed=seed, resamples=resamples)
    out.mkdir(parents=True, exist_ok=True)
    comparison.differences.to_csv(out / COMPARISON, index=False, lineterminator="\n")
    comparison.ranks.to_csv(out / RANKS, index=False, lineterminator="\n")
    return comparison
