"""``study analyze``: from the answers to tables, sentences and the figure of ratings."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from eval.ratings.reading import read_ratings, read_stimuli
from reports.drawing import save
from reports.ratings import STATS, Written, analyse_ratings
from reports.study.export import Exported, export_ratings, export_stimuli
from reports.study.layout import StudyFolder
from reports.study.plan import read_plan


@dataclass(frozen=True)
class StudyResults:
    """An analysed study: the analysis, what it was made of, and the pictures."""

    written: Written
    exported: Exported
    figures: tuple[Path, ...]


def analyse_study(
    folder: StudyFolder, *, rehearsal: bool = False, out: Path | None = None, seed: int = 0
) -> StudyResults:
    """Export the answers, analyse them as was decided before, and draw them.

    Parameters
    ----------
    folder
        The study.
    rehearsal
        Whether to analyse the answers of rehearsals.
    out
        Folder that gets ``stats``, ``tables`` and ``figures``; ``analysis`` or ``rehearsal`` in the study by default.
    seed
        Of the bootstrap.

    Raises
    ------
    DataError
        With too few answers.
    StoreError
        If the study was changed.
    """
    plan = read_plan(folder, check_videos=False)
    target = folder.results(rehearsal=rehearsal) if out is None else out
    target.mkdir(parents=True, exist_ok=True)
    answers, stimuli = target / "ratings.csv", target / "stimuli.csv"
    exported = export_ratings(folder, answers, rehearsal=rehearsal, plan=plan)
    export_stimuli(folder, stimuli)
    read = read_ratings(answers, read_stimuli(stimuli), styles=plan.styles)
    shown = (
        f"What was shown: {plan.source} {plan.styles[0]} to {plan.styles[1]}, {plan.pages} videos of {plan.seconds:g} s.",
        f"Sessions: {exported.finished} finished, {exported.unfinished} begun and not finished; the answers of both count.",
    )
    written = analyse_ratings(read, target, seed=seed, notes=shown)
    return StudyResults(written, exported, draw_ratings(target, plan.styles, plan.source))


def draw_ratings(folder: Path, styles: tuple[str, str], source: str) -> tuple[Path, ...]:
    """Draw the ratings of ``folder/stats`` as the 2020 paper's figure 8 into ``folder/figures``, and return its files."""
    from reports.figures.rating_boxes import rating_drawing

    drawing = rating_drawing(folder / STATS, "ratings", styles=styles, what=f"{source}, {styles[0]} to {styles[1]}")
    if drawing is None:
        return ()
    target = folder / "figures"
    target.mkdir(exist_ok=True)
    saved = save(drawing, target)
    return saved.png, saved.pdf, saved.csv
