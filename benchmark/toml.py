"""TOML from anybody: what is no TOML ends in one kind of error."""

from __future__ import annotations

import tomllib
from typing import Any


def parse_toml(text: str) -> dict[str, Any]:
    """The tables of ``text``.

    Raises
    ------
    tomllib.TOMLDecodeError
        With the place, or that tables and lists are nested too deep: the parser calls itself for each.
    """
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise tomllib.TOMLDecodeError("tables or lists are nested too deep") from None
