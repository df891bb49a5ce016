"""Texts that come from files as Markdown prints them, never as markup of theirs."""

from __future__ import annotations

import re

#: What begins code or emphasis or ends a cell; a tag, an entity or a link, where that is what would follow; and at the start of
#: a text, what would define a link. Plain brackets, names_with_underscores and ``p < .001`` stay as they are.
_MARKUP = re.compile(r"[\\|`*]|(?<![^\W_])_|_(?![^\W_])|~(?=~)|(?<=~)~|<(?=[A-Za-z/!?])|&(?=#?\w+;)|\](?=\()|^\[")


def markdown_escape(text: str) -> str:
    """Text for a line or a table cell of Markdown: no markup, no HTML, no link, in one line."""
    return _MARKUP.sub(lambda found: {"<": "&lt;", "&": "&amp;"}.get(found[0], "\\" + found[0]), one_line(text))


def one_line(text: str) -> str:
    """Text without line breaks and control characters, single spaces between its words."""
    return " ".join("".join(sign if sign.isprintable() else " " for sign in text).split())
