"""Ratings and stimuli from CSV files, refused with file and line where they are not what they should be.

The format is described in ``eval/ratings/README.md``.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmark.errors import DataError

if TYPE_CHECKING:
    import pandas as pd

#: What ``kind`` says of answers that people gave, and of answers that a model of an observer gave.
PEOPLE = "people"
SIMULATED = "simulated observers, not people"

#: Columns of the two files; the first group of each is required.
RATING_COLUMNS = ("rater", "stimulus", "style", "naturalness")
RATING_OPTIONS = ("action", "order", "seconds", "time", "kind")
STIMULUS_COLUMNS = ("stimulus", "condition", "clip_id", "action")
STIMULUS_OPTIONS = ("actor", "attention", "expected")

#: How a cell says that there is no answer.
MISSING = ("", "NA")

#: The naturalness scale.
LOWEST, HIGHEST = 1, 7

#: Problems listed in one message.
_SHOWN = 20


class RatingsError(DataError):
    """A ratings or stimuli file with rows that cannot be used.

    Parameters
    ----------
    path
        The file.
    problems
        Line (1-based; ``None`` for the file as a whole) and what is wrong there.
    """

    def __init__(self, path: Path | str, problems: Sequence[tuple[int | None, str]]) -> None:
        self.path, self.problems = Path(path), tuple(problems)
        self.problems = tuple(sorted(self.problems, key=lambda problem: problem[0] or 0))
        texts = [text if line is None else f"line {line}: {text}" for line, text in self.problems[:_SHOWN]]
        more = len(self.problems) - _SHOWN
        if len(texts) == 1:
            message = f"{path}, {texts[0]}" if self.problems[0][0] is not None else f"{path}: {texts[0]}"
        else:
            count = f"{len(self.problems)} problems" + (f", the first {_SHOWN} of them" if more > 0 else "")
            message = f"{path}: {count}\n" + "\n".join(f"  {text}" for text in texts)
        super().__init__(message)

    def __reduce__(self) -> tuple:
        return type(self), (self.path, self.problems)


@dataclass(frozen=True)
class Ratings:
    """Answers joined to what was shown.

    Attributes
    ----------
    table
        One row for each page that a rater answered: ``rater, stimulus, condition, clip_id, actor, shown`` (the action that
        was shown), ``style`` (as answered), ``child`` (1 where the answer is the target style, 0 where it is the source
        style, NaN where missing), ``naturalness`` (1-7 or NaN), ``action`` (as answered), ``attention`` (whether the
        action answer counts for the rater's attention), ``expected``, ``correct`` (1, 0; NaN where ``attention`` is false), and
        ``order, seconds, time`` where the file has them. ``condition`` is empty for pure attention checks.
    stimuli
        The stimuli file.
    styles
        Source and target style, the two possible answers to the first question.
    kind
        :data:`PEOPLE` or :data:`SIMULATED`.
    notes
        What a reader of the results must know of the file: missing cells, unfinished sessions.
    asks_action
        Whether the file has the action question.
    """

    table: pd.DataFrame
    stimuli: pd.DataFrame
    styles: tuple[str, str]
    kind: str
    notes: tuple[str, ...]
    asks_action: bool

    @property
    def simulated(self) -> bool:
        """Whether no person gave these answers."""
        return self.kind != PEOPLE

    @property
    def raters(self) -> list[str]:
        """The raters, in order of their ids."""
        return sorted(set(self.table["rater"]))

    @property
    def conditions(self) -> list[str]:
        """The conditions in the order of the stimuli file, without attention checks."""
        return [name for name in dict.fromkeys(self.stimuli["condition"]) if name]

    @property
    def judged(self) -> pd.DataFrame:
        """The rows of :attr:`table` that belong to a condition."""
        return self.table[self.table["condition"] != ""]

    def of(self, raters: Sequence[str]) -> Ratings:
        """The ratings of some of the raters."""
        return replace(self, table=self.table[self.table["rater"].isin(list(raters))].reset_index(drop=True))


@dataclass(frozen=True)
class _Line:
    """One row of a file: where it starts, and its cells by column."""

    number: int
    cells: Mapping[str, str]


def read_stimuli(path: Path) -> pd.DataFrame:
    """Read a stimuli file.

    Parameters
    ----------
    path
        CSV with the columns ``stimulus, condition, clip_id, action`` and, where wanted, ``actor, attention, expected``.

    Returns
    -------
    pandas.DataFrame
        One row a stimulus, with all seven columns; ``attention`` is a bool (true where the file does not say), ``expected``
        the accepted action answers, by ``|`` (the action itself where the file does not say).

    Raises
    ------
    RatingsError
        Naming every row that cannot be used, up to twenty.
    """
    import pandas as pd

    lines, problems = _read_rows(path, STIMULUS_COLUMNS, STIMULUS_OPTIONS, "stimuli")
    rows: list[dict[str, Any]] = []
    seen: dict[str, int] = {}
    for line in lines:
        cells, here = line.cells, line.number
        name = cells["stimulus"]
        if not name:
            problems.append((here, "the stimulus has no id"))
        elif name in seen:
            problems.append((here, f"stimulus {name!r} stands on line {seen[name]} already: every id must be unique"))
        seen.setdefault(name, here)
        attention = _yes(cells.get("attention", "yes") or "yes")
        if attention is None:
            problems.append((here, f"attention is yes or no, not {cells['attention']!r}"))
        if not cells["condition"] and not attention:
            problems.append((here, "the condition is empty, and the stimulus is no attention check either"))
        if cells["condition"]:
            problems += [(here, f"{column} is empty") for column in ("clip_id", "action") if not cells[column]]
        expected = cells.get("expected", "") or cells["action"]
        if attention and not expected:
            problems.append((here, "an attention check needs an expected answer: fill expected or action"))
        rows.append(
            {
                **{column: cells[column] for column in STIMULUS_COLUMNS},
                "actor": cells.get("actor", ""),
                "attention": bool(attention),
                "expected": expected,
            }
        )
    if problems:
        raise RatingsError(path, problems)
    table = pd.DataFrame(rows)
    conditions = [name for name in dict.fromkeys(table["condition"]) if name]
    if len(conditions) < 2:
        found = f"only {conditions[0]!r}" if conditions else "none"
        raise RatingsError(path, [(None, f"there must be two conditions or more to compare, and there is {found}")])
    return table


def read_ratings(path: Path, stimuli: pd.DataFrame | Path, *, styles: tuple[str, str] = ("adult", "child")) -> Ratings:
    """Read a ratings file and join it to the stimuli.

    Parameters
    ----------
    path
        CSV with one row for each page that a rater answered: ``rater, stimulus, style, naturalness`` and, where there are
        such, ``action, order, seconds, time, kind``.
    stimuli
        As :func:`read_stimuli` gives it, or the path of the file.
    styles
        Source and target style: the two possible answers to "does this motion belong to a child or an adult?".

    Raises
    ------
    RatingsError
        Naming every row that cannot be used, up to twenty: unknown stimulus, answer out of range, a second answer of the
        same rater to the same stimulus, and whatever else is not as the format says.

    Notes
    -----
    Empty cells and ``NA`` are missing answers. They are kept as missing, counted in :attr:`Ratings.notes`, and left out of
    the means that they would belong to; they are never filled in.
    """
    import pandas as pd

    shown = read_stimuli(stimuli) if isinstance(stimuli, Path) else stimuli
    lines, problems = _read_rows(path, RATING_COLUMNS, RATING_OPTIONS, "ratings")
    by_id: dict[str, Mapping[str, Any]] = {
        row["stimulus"]: {str(name): value for name, value in row.items()} for row in shown.to_dict("records")
    }
    rows: list[dict[str, Any]] = []
    first: dict[tuple[str, str], int] = {}
    kinds: dict[str, int] = {}
    for line in lines:
        cells, here = line.cells, line.number
        name = cells["stimulus"]
        stimulus = by_id.get(name)
        if not cells["rater"]:
            problems.append((here, "the rater has no id"))
        if stimulus is None:
            problems.append((here, f"unknown stimulus {name!r}{_hint(name, list(by_id))}"))
        pair = (cells["rater"], name)
        if all(pair) and pair in first:
            problems.append(
                (
                    here,
                    f"rater {pair[0]!r} answered stimulus {name!r} on line {first[pair]} already: keep one of the two",
                )
            )
        first.setdefault(pair, here)
        row: dict[str, Any] = {"rater": cells["rater"], "stimulus": name}
        parsers: dict[str, Callable[[str], Any]] = {
            "style": lambda text: _style(text, styles),
            "naturalness": _score,
            "order": _order,
            "seconds": _seconds,
            "time": _time,
        }
        for column, parse in parsers.items():
            text = cells.get(column)
            if text is None:
                continue
            try:
                row[column] = None if text in MISSING else parse(text)
            except ValueError as error:
                problems.append((here, str(error)))
        row["action"] = None if cells.get("action", "") in MISSING else cells["action"]
        kind = cells.get("kind", "") or PEOPLE
        if kind not in (PEOPLE, SIMULATED):
            problems.append((here, f"kind is {PEOPLE!r} or {SIMULATED!r}, not {kind!r}"))
        kinds.setdefault(kind, here)
        if stimulus is not None:
            row |= _joined(stimulus, row.get("action"), row.get("style"), styles)
        rows.append(row)
    if len(kinds) == 2 and not problems:
        problems.append(
            (max(kinds.values()), f"the kind changes here: {PEOPLE} and {SIMULATED!r} cannot be analysed together")
        )
    if problems:
        raise RatingsError(path, problems)
    table = pd.DataFrame(rows)
    for column in ("child", "naturalness", "correct", "seconds", "order"):
        if column in table:
            table[column] = table[column].astype("float64")
    asked = "action" in lines[0].cells
    return Ratings(table, shown, styles, next(iter(kinds)), tuple(_notes(table, shown, asks_action=asked)), asked)


def same_answer(answer: str, expected: str) -> bool:
    """Whether a free answer names one of the expected ones, by ``|``; case, hyphens, underscores and spaces do not count."""
    return _plain(answer) in {_plain(choice) for choice in expected.split("|")}


def _joined(
    stimulus: Mapping[str, Any], action: str | None, style: str | None, styles: tuple[str, str]
) -> dict[str, Any]:
    correct = float(action is not None and same_answer(action, stimulus["expected"]))
    return {
        "condition": stimulus["condition"],
        "clip_id": stimulus["clip_id"],
        "actor": stimulus["actor"],
        "shown": stimulus["action"],
        "attention": stimulus["attention"],
        "expected": stimulus["expected"],
        "child": math.nan if style is None else float(style == styles[1]),
        "correct": correct if stimulus["attention"] else math.nan,
    }


def _notes(table: pd.DataFrame, stimuli: pd.DataFrame, *, asks_action: bool) -> list[str]:
    questions = ["style", "naturalness"] + (["action"] if asks_action else [])
    missing = {column: int(table[column].isna().sum()) for column in questions}
    total = sum(missing.values())
    raters = table["rater"].nunique()
    notes = [f"{len(table)} answered pages of {raters} raters on {len(stimuli)} stimuli."]
    if total:
        listed = ", ".join(f"{name} {count}" for name, count in missing.items() if count)
        notes.append(
            f"{total} of {len(table) * len(questions)} answers are missing ({listed}); they are left out, not filled in."
        )
    else:
        notes.append("No answer is missing on these pages.")
    short = table.groupby("rater").size()
    short = short[short < len(stimuli)]
    if len(short):
        listed = ", ".join(f"{name} ({count} of {len(stimuli)})" for name, count in list(short.items())[:5])
        more = f" and {len(short) - 5} more" if len(short) > 5 else ""
        notes.append(f"{len(short)} raters did not see every stimulus: {listed}{more}.")
    if not asks_action:
        notes.append("The file has no action question: attention cannot be judged, and nobody is excluded.")
    return notes


def _plain(text: str) -> str:
    return re.sub(r"[\s_\-]+", " ", text).strip().casefold()


def _hint(name: str, known: Sequence[str]) -> str:
    close = get_close_matches(name, known, n=1, cutoff=0.5)
    return f"; did you mean {close[0]!r}?" if close else ": it is not in the stimuli file"


def _yes(text: str) -> bool | None:
    return {"yes": True, "true": True, "1": True, "no": False, "false": False, "0": False}.get(text.casefold())


def _style(text: str, styles: tuple[str, str]) -> str:
    answer = text.casefold()
    for style in styles:
        if answer == style.casefold():
            return style
    raise ValueError(f"style is {styles[0]} or {styles[1]}, not {text!r}")


def _score(text: str) -> int:
    problem = f"naturalness is a whole number from {LOWEST} to {HIGHEST}, not {text!r}"
    # Spreadsheets and data frames with gaps write 5 as 5.0.
    if not re.fullmatch(r"\d+(\.0+)?", text):
        raise ValueError(problem)
    score = int(float(text))
    if not LOWEST <= score <= HIGHEST:
        raise ValueError(problem)
    return score


def _order(text: str) -> int:
    if not re.fullmatch(r"0*[1-9]\d{0,8}", text):
        raise ValueError(f"order counts the pages of a rater from 1, and {text!r} is no such number")
    return int(text)


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value >= 0):
        raise ValueError(f"seconds is the time on the page, a number from 0, not {text!r}")
    return value


def _time(text: str) -> str:
    try:
        datetime.fromisoformat(text)
    except ValueError:
        raise ValueError(f"time is a date and time as in 2026-11-22T18:30:00+00:00, not {text!r}") from None
    return text


def _read_rows(
    path: Path, required: Sequence[str], optional: Sequence[str], what: str
) -> tuple[list[_Line], list[tuple[int | None, str]]]:
    """The rows of a CSV file, and what is wrong with those that are no rows of it; wrong columns are refused at once."""
    text = _decode(path, what)
    # With strict quoting a quote that is never closed is an error, not a cell that swallows the rest of the file.
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    header: list[str] | None = None
    lines: list[_Line] = []
    problems: list[tuple[int | None, str]] = []
    start = 1
    try:
        for cells in reader:
            here, start = start, reader.line_num + 1
            if not any(cell.strip() for cell in cells):
                continue
            if header is None:
                if cells[0].startswith("#"):
                    continue
                header = [cell.strip() for cell in cells]
                _check_header(path, here, header, required, optional)
                continue
            if len(cells) != len(header):
                problems.append((here, f"there are {len(cells)} cells, and the header has {len(header)}"))
                continue
            lines.append(_Line(here, {name: cell.strip() for name, cell in zip(header, cells, strict=True)}))
    except csv.Error as error:
        problems.append((start, f"the row cannot be read as CSV: {error}"))
    if header is None and not problems:
        raise RatingsError(path, [(None, f"the file is empty; {what} need the columns {', '.join(required)}")])
    if not lines:
        raise RatingsError(path, problems or [(None, f"the file has a header and no {what}")])
    return lines, problems


def _check_header(
    path: Path, line: int, header: Sequence[str], required: Sequence[str], optional: Sequence[str]
) -> None:
    known = [*required, *optional]
    if len(header) == 1:
        for sign, name in ((";", "semicolons"), ("\t", "tabs")):
            if sign in header[0]:
                raise RatingsError(path, [(line, f"cells are parted by {name}: save the file with commas")])
    problems: list[tuple[int | None, str]] = []
    for name in dict.fromkeys(header):
        if header.count(name) > 1:
            problems.append((line, f"the column {name!r} stands {header.count(name)} times"))
        if name not in known:
            close = get_close_matches(name.casefold(), known, n=1, cutoff=0.6)
            hint = f"; did you mean {close[0]!r}?" if close else ""
            problems.append((line, f"unknown column {name!r}{hint} (known: {', '.join(known)})"))
    problems += [(line, f"the column {name!r} is missing") for name in required if name not in header]
    if problems:
        raise RatingsError(path, problems)


def _decode(path: Path, what: str) -> str:
    if not path.exists():
        raise RatingsError(path, [(None, f"there is no such file; give a CSV file of {what}")])
    if path.is_dir():
        raise RatingsError(path, [(None, f"this is a folder; give a CSV file of {what}")])
    data = path.read_bytes()
    if data.startswith((b"PK\x03\x04", b"\xd0\xcf\x11\xe0")):
        raise RatingsError(path, [(None, "this is a workbook or archive, not text: save the sheet as CSV (UTF-8)")])
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise RatingsError(path, [(1, "the text is UTF-16: save the file as UTF-8")])
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        raise RatingsError(
            path, [(line, f"byte 0x{data[error.start]:02x} is not UTF-8: save the file as UTF-8")]
        ) from None
    if "\0" in text:
        line = text[: text.index("\0")].count("\n") + 1
        raise RatingsError(path, [(line, "a zero byte: this is not a text file")])
    return text
