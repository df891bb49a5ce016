"""The hierarchy of a BVH file: its grammar, read and written."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

from benchmark.errors import MotionFileError
from benchmark.motion._bvh_numbers import number_in

#: The six channels in the spelling of the format.
CHANNELS: tuple[str, ...] = ("Xposition", "Yposition", "Zposition", "Xrotation", "Yrotation", "Zrotation")

_CHANNEL_OF = {name.lower(): name for name in CHANNELS}
_WORD = re.compile(r"[{}]|[^\s{}]+")
# Indentation stops growing here, so that a chain of n joints takes O(n) bytes.
_DEEPEST_INDENT = 40


@dataclass
class Node:
    """One joint as its block in the file has it."""

    name: str
    parent: int
    line: int
    offset: tuple[float, float, float] | None = None
    channels: tuple[str, ...] | None = None
    has_children: bool = False


@dataclass
class Hierarchy:
    """The joints in file order, and the end sites as (parent, offset)."""

    nodes: list[Node] = field(default_factory=list)
    end_sites: list[tuple[int, tuple[float, float, float]]] = field(default_factory=list)

    @property
    def columns(self) -> list[str]:
        """``joint channel`` of each value of a row."""
        return [f"{channel} of {node.name!r}" for node in self.nodes for channel in node.channels or ()]


class _Reader:
    """Words with their line numbers; the name after ROOT, JOINT and End is one word, spaces included."""

    def __init__(self, path: Path, text: str, end: str) -> None:
        self.path, self.end = path, end
        self.words: list[tuple[str, int]] = []
        for number, content in enumerate(text.split("\n"), 1):
            self._split(content.strip(), number)
        self.last_line = text.count("\n") + 1
        self.at = 0

    def _split(self, content: str, number: int) -> None:
        at = 0
        while match := _WORD.search(content, at):
            word, at = match.group(), match.end()
            self.words.append((word, number))
            if word.upper() in ("ROOT", "JOINT", "END"):
                brace = content.find("{", at)
                name = content[at:] if brace < 0 else content[at:brace]
                self.words.append((name.strip(), number))
                at += len(name)

    def fail(self, message: str, line: int) -> MotionFileError:
        return MotionFileError(self.path, message, line=line)

    def next(self, expected: str) -> tuple[str, int]:
        if self.at >= len(self.words):
            found = f"the hierarchy does not end {self.end}" if self.end else "the hierarchy ends here"
            raise self.fail(f"expected {expected}, but {found}", self.last_line)
        self.at += 1
        return self.words[self.at - 1]

    def brace(self, owner: str) -> None:
        word, line = self.next(f"'{{' after {owner}")
        if word != "{":
            raise self.fail(f"expected '{{' after {owner}, found {word!r}", line)

    def offset(self) -> tuple[float, float, float]:
        values = []
        for axis in "XYZ":
            word, line = self.next(f"the {axis} value of OFFSET")
            value = number_in(word.encode("utf-8", "replace"))
            if value is None:
                raise self.fail(f"expected three numbers after OFFSET, found {word[:40]!r} for {axis}", line)
            values.append(value)
        return values[0], values[1], values[2]

    def channels(self, owner: str) -> tuple[str, ...]:
        word, line = self.next("the number of channels")
        if word not in ("0", "1", "2", "3", "4", "5", "6"):
            raise self.fail(f"expected the number of channels, 0 to 6, found {word[:40]!r}", line)
        names: list[str] = []
        for index in range(int(word)):
            given, at = self.next(f"channel {index + 1} of {word} of {owner}")
            name = _CHANNEL_OF.get(given.lower())
            if name is None:
                raise self.fail(
                    f"expected channel {index + 1} of {word} of {owner}, one of {', '.join(CHANNELS)}; "
                    f"found {given[:40]!r}",
                    at,
                )
            if name in names:
                raise self.fail(f"channel {name} of {owner} is listed twice", at)
            names.append(name)
        return tuple(names)


def parse(path: Path, text: str, *, end: str = "") -> Hierarchy:
    """Read the lines before ``MOTION``.

    Parameters
    ----------
    path
        For messages.
    text
        The lines.
    end
        Where ``text`` was cut off, if it was, for the message that it ends too early.

    Raises
    ------
    MotionFileError
        Where the text departs from the grammar, with the line and what was expected.
    """
    reader = _Reader(path, text, end)
    word, line = reader.next("HIERARCHY")
    if word.upper() != "HIERARCHY":
        raise reader.fail(f"expected HIERARCHY, found {word[:40]!r}: not a BVH file", line)
    hierarchy = Hierarchy()
    seen: dict[str, int] = {}
    word, line = reader.next("ROOT")
    if word.upper() != "ROOT":
        raise reader.fail(f"expected ROOT, found {word[:40]!r}", line)
    stack = [_open(reader, hierarchy, seen, -1)]
    while stack:
        node = hierarchy.nodes[stack[-1]]
        owner = f"joint {node.name!r}"
        word, line = reader.next(f"OFFSET, CHANNELS, JOINT, End Site or '}}' in {owner}")
        keyword = word.upper()
        if keyword == "OFFSET":
            if node.offset is not None:
                raise reader.fail(f"a second OFFSET in {owner}", line)
            node.offset = reader.offset()
        elif keyword == "CHANNELS":
            if node.channels is not None:
                raise reader.fail(f"a second CHANNELS in {owner}", line)
            if node.has_children:
                raise reader.fail(f"CHANNELS of {owner} must come before its first JOINT", line)
            node.channels = reader.channels(owner)
        elif keyword == "JOINT":
            node.has_children = True
            stack.append(_open(reader, hierarchy, seen, stack[-1]))
        elif keyword in ("END", "ENDSITE"):
            hierarchy.end_sites.append((stack[-1], _end_site(reader, keyword, line, owner)))
        elif keyword == "}":
            if node.offset is None:
                raise reader.fail(f"{owner} ends without an OFFSET", line)
            stack.pop()
        elif keyword == "ROOT":
            raise reader.fail(f"a ROOT inside {owner}; is a '}}' missing?", line)
        else:
            raise reader.fail(
                f"expected OFFSET, CHANNELS, JOINT, End Site or '}}' in {owner}, found {word[:40]!r}", line
            )
    if reader.at < len(reader.words):
        word, line = reader.words[reader.at]
        if word.upper() == "ROOT":
            raise reader.fail("a second ROOT: split the file into one figure each", line)
        raise reader.fail(f"expected MOTION after the hierarchy, found {word[:40]!r}", line)
    return hierarchy


def name_fault(name: str) -> str:
    """Why ``name`` cannot be read back as a joint name; empty where it can."""
    if not name or name != name.strip():
        return "it is empty or has white space at an end"
    if "{" in name or "}" in name:
        return "it holds a brace"
    if any(letter < " " or letter == "\x7f" or "\ud800" <= letter <= "\udfff" for letter in name):
        return "it holds a control character"
    return ""


def _open(reader: _Reader, hierarchy: Hierarchy, seen: dict[str, int], parent: int) -> int:
    name, line = reader.next("a joint name")
    if not name:
        raise reader.fail("expected a joint name", line)
    fault = name_fault(name)
    if fault:
        raise reader.fail(f"{name[:40]!r} cannot be a joint name: {fault}", line)
    if name in seen:
        raise reader.fail(f"a second joint named {name!r} (the first is on line {seen[name]}): rename one", line)
    seen[name] = line
    hierarchy.nodes.append(Node(name, parent, line))
    reader.brace(f"joint {name!r}")
    return len(hierarchy.nodes) - 1


def _end_site(reader: _Reader, keyword: str, line: int, owner: str) -> tuple[float, float, float]:
    label = reader.next("Site")[0] if keyword == "END" else "Site"
    if label.upper() != "SITE":
        raise reader.fail(f"expected 'End Site' in {owner}, found 'End {label[:40]}'", line)
    reader.brace(f"the end site of {owner}")
    word, line = reader.next("OFFSET of the end site")
    if word.upper() != "OFFSET":
        raise reader.fail(f"expected OFFSET in the end site of {owner}, found {word[:40]!r}", line)
    offset = reader.offset()
    word, line = reader.next("'}' after the end site")
    if word != "}":
        raise reader.fail(f"expected '}}' after the OFFSET of the end site of {owner}, found {word[:40]!r}", line)
    return offset


def render(hierarchy: Hierarchy) -> str:
    """The hierarchy as text, ``HIERARCHY`` to the last brace. Joints must be in depth-first order."""
    children: dict[int, list[tuple[float, float, float]]] = {}
    for parent, offset in hierarchy.end_sites:
        children.setdefault(parent, []).append(offset)
    lines = ["HIERARCHY"]
    open_nodes: list[int] = []

    def put(depth: int, text: str) -> None:
        lines.append("  " * min(depth, _DEEPEST_INDENT) + text)

    def close() -> None:
        open_nodes.pop()
        put(len(open_nodes), "}")

    for index, node in enumerate(hierarchy.nodes):
        while open_nodes and open_nodes[-1] != node.parent:
            close()
        depth = len(open_nodes)
        put(depth, f"{'JOINT' if depth else 'ROOT'} {node.name}")
        put(depth, "{")
        put(depth + 1, f"OFFSET {_numbers(node.offset or (0.0, 0.0, 0.0))}")
        channels = node.channels or ()
        put(depth + 1, " ".join(["CHANNELS", str(len(channels)), *channels]))
        open_nodes.append(index)
        for offset in children.get(index, ()):
            put(depth + 1, "End Site")
            put(depth + 1, "{")
            put(depth + 2, f"OFFSET {_numbers(offset)}")
            put(depth + 1, "}")
    while open_nodes:
        close()
    return "\n".join(lines) + "\n"


def _numbers(offset: tuple[float, float, float]) -> str:
    return " ".join(repr(float(value)).removesuffix(".0") for value in offset)
