"""What tables for LaTeX share: texts from files as LaTeX prints them, never as its commands, and tables that fit the page."""

from __future__ import annotations

import re
from collections.abc import Iterable

from reports.markdown import one_line

#: One sign to its LaTeX; all at once, so that what an earlier sign became is not read again.
_SIGNS = str.maketrans(
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


def latex_escape(text: str) -> str:
    """Text as LaTeX prints it: special signs escaped, raised digits and dashes as LaTeX has them, in one line."""
    return one_line(text).translate(_SIGNS)


def latex_label(text: str) -> str:
    r"""Text as the name of a ``\label``, where not even escaped signs may stand."""
    return re.sub(r"[^\w:.+-]|_", "-", text, flags=re.ASCII)


def fitted(tabular: Iterable[str]) -> list[str]:
    r"""The lines of a ``tabular``, drawn smaller where it is wider than the page; needs ``graphicx``."""
    return [r"\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{%", *tabular, "}"]
