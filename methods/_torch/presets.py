"""Hyper-parameters from presets: a package's ``presets.toml`` has one table for each, and a keyword overrides its entry."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

from benchmark.errors import ConfigError, ContractError, UnknownNameError


def resolve(package: str, preset: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """The settings of ``preset``, with those of ``given`` that are not ``None`` in their place.

    Parameters
    ----------
    package
        Dotted name of the package that holds ``presets.toml``, with tables ``smoke``, ``quick`` and ``paper``.
    preset
        Name of a table.
    given
        The method's keywords besides ``preset``; ``None`` means "from the preset".

    Returns
    -------
    dict
        A value for every name in ``given``, of the type that the preset's has.

    Raises
    ------
    UnknownNameError
        If there is no such preset.
    ConfigError
        If a keyword is of another type than the preset's value.
    ContractError
        If a table does not name exactly the keywords of ``given``.
    """
    tables = tomllib.loads((files(package) / "presets.toml").read_text(encoding="utf-8"))
    if preset not in tables:
        raise UnknownNameError("preset", str(preset), tables)
    chosen = tables[preset]
    if set(chosen) != set(given):
        odd = ", ".join(sorted(set(chosen) ^ set(given)))
        raise ContractError(f"preset {preset!r} of {package} and the constructor do not name the same settings: {odd}")
    return {name: chosen[name] if value is None else _typed(name, value, chosen[name]) for name, value in given.items()}


def _typed(name: str, value: Any, example: Any) -> Any:
    kind = type(example)
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if type(value) is not kind:
        raise ConfigError(f"{name} must be a {kind.__name__} such as {example!r}, not {value!r}")
    return value
