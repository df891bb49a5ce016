"""What a rater's form may say, checked on the server: everything else is refused with a sentence for the rater."""

from __future__ import annotations

import unicodedata
from collections.abc import Mapping
from urllib.parse import parse_qsl

from eval.ratings.reading import HIGHEST, LOWEST
from reports.study.database import Answer
from reports.study.plan import Plan

#: Characters of a free answer.
LONGEST = 200

#: Fields of a form, more than any page has.
_FIELDS = 16


class FormError(Exception):
    """A form that cannot be used.

    Parameters
    ----------
    problems
        Field and what is wrong with it, in words for the rater.
    """

    def __init__(self, problems: Mapping[str, str]) -> None:
        super().__init__("; ".join(problems.values()))
        self.problems = dict(problems)


def read_form(body: bytes) -> dict[str, str]:
    """The fields of a form, each of which may come once.

    Raises
    ------
    FormError
        If the body is no form.
    """
    try:
        pairs = parse_qsl(
            body.decode("ascii"),
            keep_blank_values=True,
            strict_parsing=bool(body),
            errors="strict",
            max_num_fields=_FIELDS,
        )
    except ValueError:
        raise FormError({"": "The form could not be read."}) from None
    fields = dict(pairs)
    if len(fields) != len(pairs):
        raise FormError({"": "The form holds the same answer twice."})
    return fields


def read_answer(fields: Mapping[str, str], plan: Plan) -> Answer:
    """The answer that a form holds.

    Raises
    ------
    FormError
        For an unknown stimulus, a missing answer, or one that was not offered.
    """
    name = fields.get("stimulus", "")
    stimulus = plan.stimuli.get(name)
    if stimulus is None or name == plan.example:
        raise FormError({"": "This form belongs to no video of this study."})
    problems: dict[str, str] = {}
    style = fields.get("style", "")
    if not style:
        problems["style"] = "Please answer the first question."
    elif style not in plan.styles:
        problems["style"] = "Please choose one of the answers to the first question."
    score = fields.get("naturalness", "")
    if not score:
        problems["naturalness"] = "Please answer the second question."
    elif score not in {str(value) for value in range(LOWEST, HIGHEST + 1)}:
        problems["naturalness"] = f"Please choose a number from {LOWEST} to {HIGHEST} in the second question."
    action: str | None = None
    if plan.action_question != "none":
        action = unicodedata.normalize("NFC", fields.get("action", "")).strip()
        if not action:
            problems["action"] = "Please answer the third question."
        elif plan.action_question == "list" and action not in stimulus.actions:
            problems["action"] = "Please choose one of the answers to the third question."
        elif plan.action_question == "text" and (problem := _free_text(action)):
            problems["action"] = problem
    if problems:
        raise FormError(problems)
    return Answer(name, style, int(score), action)


def _free_text(text: str) -> str | None:
    if len(text) > LONGEST:
        return f"Please answer the third question in at most {LONGEST} characters."
    if any(unicodedata.category(character) in ("Cc", "Cs", "Zl", "Zp") for character in text):
        return "Please answer the third question in one line of plain text."
    if text[0] in "=+-@":
        # A spreadsheet would take such a cell for a formula.
        return "Please begin your answer to the third question with a letter or a number."
    return None
