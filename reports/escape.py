"""Texts that come from files, as the table formats print them and never as commands of theirs."""

from __future__ import annotations

import re

#: One sign to its LaTeX; all at once, so that what an earlier sign became is not read again.
_LATEX = str.maketrans(
    {
        "\\": r"\textbackslash{}",
        "{": r"\{",
        "}": r"\}",
        "&": r"\&",
        "%": r"\%",
        "_": r"\_",
        "#": r"\#",
        "$": r"\$",
        "^": r"\textasciicircum{}",
        "~": r"\textasciitilde{}",
        "<": r"\textless{}",
        ">": r"\textgreater{}",
        "|": r"\textbar{}",
        "²": "$^2$",
        "³": "$^3$",
        "·": r"$\cdot$",
        "−": "$-$",
        "–": "--",
    }
)

_MARKDOWN = str.maketrans({"\\": r"\\", "|": r"\|", "`": r"\`", "*": r"\*", "&": "&amp;", "<": "&lt;"})


def latex_escape(text: str) -> str:
    """Text as LaTeX prints it: special signs escaped, raised digits and dashes as LaTeX has them, in one line."""
    return _one_line(text).translate(_LATEX)


def latex_label(text: str) -> str:
    r"""Text as the name of a ``\label``, where not even escaped signs may stand."""
    return re.sub(r"[^\w:.+-]|_", "-", text, flags=re.ASCII)


def markdown_escape(text: str) -> str:
    """Text for a line or a table cell of Markdown: no markup, no HTML, no link, in one line."""
    # Brackets alone are text (``holden[large]``); what makes them a link or a picture is what follows.
    return re.sub(r"\](?=[(\[:])", r"\\]", _one_line(text).translate(_MARKDOWN))


def _one_line(text: str) -> str:
    return " ".join("".join(sign if sign.isprintable() else " " for sign in text).split())
