"""Which raters count: the rule of the 2020 study, declared before the analysis."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from eval.ratings.reading import Ratings

if TYPE_CHECKING:
    import pandas as pd

#: Raters whose share of right action answers is this or less are left out.
ATTENTION = 0.5


@dataclass(frozen=True)
class Exclusion:
    """The ratings that count, and why others do not.

    Attributes
    ----------
    kept
        Ratings of the raters who paid attention.
    raters
        One row a rater: ``rater, checks, correct, share, excluded``.
    sentence
        The rule and what it did, in words.
    """

    kept: Ratings
    raters: pd.DataFrame
    sentence: str


def exclude_inattentive(ratings: Ratings, *, threshold: float = ATTENTION) -> Exclusion:
    """Leave out raters who are right on ``threshold`` or less of the pages that check attention.

    Parameters
    ----------
    ratings
        All of them.
    threshold
        Share of right action answers that is not enough.

    Returns
    -------
    Exclusion
        Nobody is left out where the action was not asked or no stimulus checks attention. Where some do, a rater who saw
        none of them is left out: attention that was never shown cannot be assumed.

    Notes
    -----
    "We excluded five participants whose overall correctness score are equal or below 50%" (Dong et al. 2020, section 5.4).
    A check that was shown and not answered counts as wrong. The rule looks at the action question alone, never at the two
    questions that are analysed.
    """
    import pandas as pd

    checks = ratings.table[ratings.table["attention"]]
    judged = ratings.asks_action and bool(ratings.stimuli["attention"].any())
    rows = []
    for rater in ratings.raters:
        answers = checks.loc[checks["rater"] == rater, "correct"]
        share = float(answers.mean()) if len(answers) else float("nan")
        inattentive = judged and not share > threshold
        rows.append((rater, len(answers), int(answers.sum()), share, inattentive))
    raters = pd.DataFrame(rows, columns=["rater", "checks", "correct", "share", "excluded"])
    out = raters.loc[raters["excluded"], "rater"].tolist()
    if not judged:
        why = "No stimulus checks attention" if ratings.asks_action else "The action was not asked"
        sentence = f"{why}, so nobody could be excluded for inattention; {len(raters)} raters count."
    else:
        named = f": {', '.join(out[:10])}{' …' if len(out) > 10 else ''}" if out else ""
        sentence = (
            f"Excluded, by the rule declared before the analysis (action named right on {100 * threshold:g} % or less of the "
            f"checks): {len(out)} of {len(raters)} raters{named}. {len(raters) - len(out)} count."
        )
        choices = checks["expected"].nunique()
        if 0 < choices <= 1 / threshold:
            sentence += (
                f" With {choices} different right answers among the checks a guesser is right {100 / choices:g} % of the time, "
                "so this rule lets about half of the guessers pass: show more actions."
            )
    kept = [rater for rater in ratings.raters if rater not in set(out)]
    return Exclusion(ratings.of(kept), raters, sentence)
