"""Methods and their variants: ``name[variant]`` belongs to the family ``name``."""

from __future__ import annotations

from collections.abc import Iterable


def family(method: str) -> str:
    """The name without the variant in brackets."""
    return method.partition("[")[0]


def families(methods: Iterable[str]) -> dict[str, list[str]]:
    """The methods of each family, in order."""
    found: dict[str, list[str]] = {}
    for method in methods:
        found.setdefault(family(method), []).append(method)
    return found


def representatives(methods: Iterable[str]) -> list[str]:
    """One method a family: that without a variant, else one with fewest parameters set, as those of ablations are.

    Of several, the last, which by custom has everything switched on.
    """
    return [min(reversed(members), key=lambda method: method.count("=")) for members in families(methods).values()]
