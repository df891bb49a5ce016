"""The analysed ratings of a run, as claims ask for them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, Self

from reports.ratings import STATS
from reports.run import FLOOR, RunView

if TYPE_CHECKING:
    import pandas as pd

#: What ``analyze`` leaves behind.
CONTRASTS, CONDITIONS = "ratings-contrasts.csv", "ratings-conditions.csv"


@dataclass(frozen=True)
class RatingsView:
    """Contrasts of conditions, of the raters who count.

    Attributes
    ----------
    contrasts
        As :func:`eval.ratings.analysis.analyse` makes them.
    conditions
        Conditions, by the names of the run's rows.
    names
        The condition of each of them.
    raters
        How many, in words.
    note
        Says so where they were simulated.
    task
        What they were shown.
    """

    contrasts: pd.DataFrame
    conditions: tuple[str, ...]
    names: dict[str, str]
    raters: str
    note: str
    task: str

    @classmethod
    def of(cls, run: RunView) -> Self | None:
        """The analysis in the run's folder; ``None`` if it has none."""
        import pandas as pd

        folder = run.folder / STATS
        if not ((folder / CONTRASTS).is_file() and (folder / CONDITIONS).is_file()):
            return None
        contrasts, table = pd.read_csv(folder / CONTRASTS), pd.read_csv(folder / CONDITIONS)
        contrasts = contrasts[contrasts["sample"] == "attentive"]
        for task in run.tasks:
            source, _, target = task.partition(":")
            names = {{source: FLOOR, target: run.real_method}.get(name, name): name for name in table["condition"]}
            if FLOOR in names or run.real_method in names:
                break
        kind = str(table["kind"].iloc[0])
        note = "" if kind == "people" else kind
        return cls(contrasts, tuple(names), names, f"{int(contrasts['n'].min())} raters", note, task)

    def difference(
        self, measure: Literal["child", "naturalness"], left: str, right: str
    ) -> tuple[float, float, float, float]:
        """``left`` minus ``right``, its 95 % interval, and the p value of the paired test.

        The interval is the one over raters and clips where the analysis has it, else that over raters.
        """
        rows = self.contrasts[self.contrasts["question"] == measure]
        a, b = self.names[left], self.names[right]
        ours = rows[(rows["a"] == a) & (rows["b"] == b)]
        turned = rows[(rows["a"] == b) & (rows["b"] == a)]
        row, sign = (ours.iloc[0], 1.0) if len(ours) else (turned.iloc[0], -1.0)
        over_clips = row.notna()["low_clips"]
        names = ("diff_answers", "low_clips", "high_clips") if over_clips else ("diff", "low", "high")
        value, low, high = (sign * float(row[name]) for name in names)
        return value, min(low, high), max(low, high), float(row["p"])
