"""The texts that the researcher edits: consent before, thanks after. Plain text with headings and lists, always escaped."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from benchmark.errors import ConfigError
from reports.study.layout import StudyFolder

CONSENT, THANKS = "consent.md", "thanks.md"

#: What is still to be filled in: words in square brackets.
_HOLE = re.compile(r"\[[^\[\]\n]{3,}\]")


@dataclass(frozen=True)
class Block:
    """A heading, a paragraph or a list."""

    kind: Literal["heading", "paragraph", "list"]
    lines: tuple[str, ...]


def read_blocks(text: str) -> tuple[Block, ...]:
    """The blocks of a text: ``#`` begins a heading, ``-`` an item of a list, an empty line ends a paragraph."""
    blocks: list[Block] = []
    for part in re.split(r"\n\s*\n", text.replace("\r\n", "\n").strip()):
        paragraph: list[str] = []
        items: list[str] = []

        def close(paragraph: list[str] = paragraph, items: list[str] = items) -> None:
            if paragraph:
                blocks.append(Block("paragraph", (" ".join(paragraph),)))
            if items:
                blocks.append(Block("list", tuple(items)))
            paragraph.clear()
            items.clear()

        for line in (line.strip() for line in part.split("\n")):
            if line.startswith("#"):
                close()
                blocks.append(Block("heading", (line.lstrip("# "),)))
            elif line.startswith("- "):
                if paragraph:
                    close()
                items.append(line[2:].strip())
            elif line and items:
                items[-1] += f" {line}"
            elif line:
                paragraph.append(line)
        close()
    return tuple(blocks)


def read_text(folder: StudyFolder, name: str) -> str:
    """One of the texts.

    Raises
    ------
    ConfigError
        If it is missing, empty or not UTF-8.
    """
    path = folder.texts / name
    if not path.is_file():
        raise ConfigError(f"{path} is missing: write it (the template of a new study shows how)")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path} is not UTF-8: save it as UTF-8") from error
    if not text.strip():
        raise ConfigError(f"{path} is empty: raters must be told what they take part in")
    return text


def check_filled_in(folder: StudyFolder) -> None:
    """Refuse texts with words in square brackets, which are still to be filled in.

    Raises
    ------
    ConfigError
        Naming the first of them.
    """
    for name in (CONSENT, THANKS):
        text = read_text(folder, name)
        found = _HOLE.search(text)
        if found:
            line = text[: found.start()].count("\n") + 1
            raise ConfigError(
                f"{folder.texts / name}, line {line}: {found.group()} is still to be filled in before people are asked "
                "(--rehearsal shows the study as it is, and keeps its answers apart)"
            )


def write_templates(folder: StudyFolder, **known: str) -> list[Path]:
    """Write the templates of both texts, where there is none, with what is known filled in."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("reports", "templates/study"),
        autoescape=False,  # plain text; it is escaped when a page shows it
        undefined=StrictUndefined,
        keep_trailing_newline=True,
    )
    folder.texts.mkdir(exist_ok=True)
    written = []
    for name in (CONSENT, THANKS):
        path = folder.texts / name
        if not path.exists():
            text = environment.get_template(f"{name}.j2").render(known)
            path.write_text(text, encoding="utf-8")
            written.append(path)
    return written
