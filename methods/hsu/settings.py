"""What the settings of ``hsu`` may be, and those of the poster."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmark.errors import ConfigError
from methods.hsu.align import WARPS
from methods.hsu.model import SPREADS
from methods.hsu.timing import TIMINGS
from methods.hsu.track import COORDINATES, FLOORS

#: The poster's settings where it states them, and the most literal reading where it does not.
FAITHFUL: Mapping[str, Any] = {
    "scope": "action",
    "coordinates": "hips",
    "floor": "clip",
    "body": "own",
    "partners": 1,
    "pairs": 1,
    "statistics": "pairs",
    "least_std": 0.0,
    "distance": "l2",
    "warp": "per-joint",
    "align_fps": 1000.0,
    "path_sigma": 0.0,
    "identification": "subspace",
    "order": 40,
    "repeat": 28,
    "ridge": 0.0,
    "spread": "none",
    "timing": "none",
}

_CHOICES: Mapping[str, tuple[str, ...]] = {
    "scope": ("all", "action"),
    "coordinates": COORDINATES,
    "floor": FLOORS,
    "spread": SPREADS,
    "body": ("common", "own"),
    "statistics": ("all", "pairs"),
    "warp": WARPS,
    "distance": ("squared", "l2"),
    "solver": ("banded", "dense"),
    "identification": ("auto", "subspace", "kernel-fir"),
    "timing": TIMINGS,
}

_LEAST: Mapping[str, float] = {
    "partners": 0,
    "pairs": 0,
    "least_std": 0.0,
    "band": 0.0,
    "max_skip": 1,
    "path_sigma": 0.0,
    "max_order": 0,
    "choice_frames": 0,
    "repeat": 1,
    "pre_roll": 0.0,
    "limit": 0.0,
}

_ABOVE_ZERO = ("smooth", "align_fps")


def check(settings: Mapping[str, Any]) -> None:
    """:class:`~benchmark.errors.ConfigError` for the first setting of ``hsu`` that cannot be, with what could."""
    for name, allowed in _CHOICES.items():
        if settings[name] not in allowed:
            raise ConfigError(f"hsu: {name} must be one of {', '.join(allowed)}, not {settings[name]!r}")
    order = settings["order"]
    if order != "auto" and (not isinstance(order, int) or isinstance(order, bool) or order < 0):
        raise ConfigError(f"hsu: order must be 'auto' or a whole number of at least 0, not {order!r}")
    # Comparisons the other way round let not-a-number pass.
    for name, bound in _LEAST.items():
        if not settings[name] >= bound:
            raise ConfigError(f"hsu: {name} must be at least {bound}, not {settings[name]!r}")
    for name in _ABOVE_ZERO:
        if not settings[name] > 0:
            raise ConfigError(f"hsu: {name} must be above 0, not {settings[name]!r}")
