"""Whether the assumptions of the analysis hold, in numbers and in words."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from eval.ratings.reading import HIGHEST, LOWEST, Ratings

if TYPE_CHECKING:
    import pandas as pd

#: Ratio of the variance between clips to that of random answers from which the clips count as different.
_DIFFERENT = 2.0


def check_assumptions(ratings: Ratings, cells: pd.DataFrame) -> pd.DataFrame:
    """Check the design within raters for both questions, and how far the clips of a condition differ.

    Parameters
    ----------
    ratings
        Of the raters who count.
    cells
        Their means, as :func:`eval.ratings.analysis.rater_cells` gives them.

    Returns
    -------
    pandas.DataFrame
        ``question, check, severity, statistic, p, sentence``. No check decides what is computed: the corrected and the
        robust analyses are always given, and a sentence says which to read.
    """
    import pandas as pd

    from eval.stats import check_rm

    parts = []
    for question, name, bounds in (
        ("child", "Target-style answers", (0.0, 1.0)),
        ("naturalness", "Naturalness", (float(LOWEST), float(HIGHEST))),
    ):
        table = check_rm(cells, subject="rater", within="condition", value=question, bounds=bounds)
        parts.append(table.assign(question=question, sentence=[f"{name}: {text}" for text in table["sentence"]]))
    parts.append(pd.DataFrame([_clips(ratings)]))
    table = pd.concat(parts, ignore_index=True)
    return table[["question", "check", "severity", "statistic", "p", "sentence"]]


def _clips(ratings: Ratings) -> dict[str, Any]:
    """Spread of clips within conditions beside what answering at random with the condition's share would give."""
    answers = ratings.judged.dropna(subset=["child"])
    by_clip = answers.groupby(["condition", "clip_id"])["child"].agg(["mean", "size"]).reset_index()
    counts = by_clip.groupby("condition").size()
    row: dict[str, Any] = {"question": "child", "check": "clips", "statistic": float("nan"), "p": float("nan")}
    if counts.min() < 2:
        text = "Clips: a condition has one clip only, so that nothing can be said about other clips."
        return row | {"severity": "warning", "sentence": text}
    centre = by_clip.groupby("condition")["mean"].transform("mean")
    expected = float((centre * (1 - centre) / by_clip["size"]).mean())
    # Each condition's mean takes one degree of freedom.
    found = float(((by_clip["mean"] - centre) ** 2).sum() / (len(by_clip) - len(counts)))
    ratio = found / expected if expected > 0 else float("nan")
    low, high = int(counts.min()), int(counts.max())
    text = f"Clips: {low if low == high else f'{low} to {high}'} in each condition"
    if ratio > _DIFFERENT:
        text += (
            f", and their shares vary {ratio:.1f} times as much as answers at random would make them. Tests over raters "
            "alone speak of these clips only; for others read the rater x clip bootstrap."
        )
    else:
        text += ", and their shares vary hardly more than answers at random would make them."
    return row | {"severity": "note" if ratio > _DIFFERENT else "ok", "statistic": ratio, "sentence": text}
