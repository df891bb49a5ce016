"""What was answered, as the files that ``analyze --ratings … --stimuli …`` reads; safe while the site runs."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from benchmark.errors import DataError
from eval.ratings.reading import PEOPLE, SIMULATED
from reports.study.layout import StudyFolder
from reports.study.plan import Plan, read_plan
from reports.study.schema import check, connect


@dataclass(frozen=True)
class Exported:
    """What was written: answers, raters who finished, and raters who began and did not."""

    answers: int
    finished: int
    unfinished: int


def export_ratings(
    folder: StudyFolder, path: Path, *, rehearsal: bool = False, times: bool = False, plan: Plan | None = None
) -> Exported:
    """Write the ratings of a study.

    Parameters
    ----------
    folder
        The study.
    path
        The CSV file; written whole or not at all.
    rehearsal
        Whether to take the answers of rehearsals; every row of them says ``simulated observers, not people``.
    times
        Whether to add when each page was answered. Left out by default: with it somebody who knows who came when knows who
        answered what.
    plan
        The plan, where it was read already.

    Raises
    ------
    DataError
        If there is no answer yet.
    StoreError
        If the answers belong to another plan.
    """
    import csv
    import io

    from benchmark.motion._atomic import atomic_write

    plan = read_plan(folder, check_videos=False) if plan is None else plan
    database = folder.database(rehearsal=rehearsal)
    kind = SIMULATED if rehearsal else PEOPLE
    connection = connect(database, read_only=True)
    try:
        # One transaction: what is answered meanwhile is in the next export, whole.
        connection.execute("BEGIN")
        check(connection, database, plan=plan.digest, kind=kind)
        rows = connection.execute(
            "SELECT raters.name, stimulus, style, naturalness, action, position, seconds, answered FROM answers JOIN raters "
            "ON raters.id = answers.rater WHERE withdrawn IS NULL ORDER BY raters.name, position"
        ).fetchall()
        finished, unfinished = connection.execute(
            "SELECT count(finished), count(*) - count(finished) FROM raters WHERE withdrawn IS NULL AND started IS NOT NULL"
        ).fetchone()
    finally:
        connection.close()
    if not rows:
        hint = "`study simulate` makes some" if rehearsal else "`study serve` asks people"
        raise DataError(f"{database} holds no answers yet: {hint}")
    asked = plan.action_question != "none"
    columns = ["rater", "stimulus", "style", "naturalness", *(["action"] if asked else []), "order", "seconds"]
    columns += [*(["time"] if times else []), "kind"]
    text = io.StringIO(newline="")
    if rehearsal:
        text.write(f"# {SIMULATED}\n")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    for name, stimulus, style, naturalness, action, position, seconds, answered in rows:
        moment = datetime.fromtimestamp(answered, UTC).isoformat(timespec="seconds")
        writer.writerow(
            [
                *(name, stimulus, style, naturalness),
                *([action] if asked else []),
                *(position + 1, f"{seconds:.1f}"),
                *([moment] if times else []),
                kind,
            ]
        )
    atomic_write(path, [text.getvalue().encode()])
    return Exported(len(rows), finished, unfinished)


def export_stimuli(folder: StudyFolder, path: Path) -> None:
    """Write the key beside the ratings: what was shown under each id."""
    from benchmark.motion._atomic import atomic_write

    read_plan(folder, check_videos=False)
    atomic_write(path, [folder.key.read_bytes()])
