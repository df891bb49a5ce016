"""Texts that come from files as Markdown prints them, never as markup of theirs."""

from __future__ import annotations

import re

_SIGNS = str.maketrans({"\\": r"\\", "|": r"\|", "`": r"\`", "*": r"\*", "&": "&amp;", "<": "&lt;"})


def markdown_escape(text: str) -> str:
    """Text for a line or a table cell of Markdown: no markup, no HTML, no link, in one line."""
    # Brackets alone are text (``holden[large]``); what makes them a link or a picture is what follows.
    return re.sub(r"\](?=[(\[:])", r"\\]", one_line(text).translate(_SIGNS))


def one_line(text: str) -> str:
    """Text without line breaks and control characters, single spaces between its words."""
    return " ".join("".join(sign if sign.isprintable() else " " for sign in text).split())
