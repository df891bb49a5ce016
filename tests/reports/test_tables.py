"""How numbers are written."""

from __future__ import annotations

import pytest

from reports.tables import arrow, number


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (3e-15, "0"),
        (1.0, "1.00"),
        (12.345, "12.3"),
        (1234.5, "1,234"),
        (499123.0, "499,123"),
        (1.5e9, "1.50e+09"),
        (0.012345, "0.0123"),
        (1.5e-6, "1.50e-06"),
        (-2.5, "-2.50"),
        (float("nan"), "–"),
        (None, "–"),
    ],
)
def test_number(value, text):
    assert number(value) == text


def test_arrow():
    assert [arrow("lower", None), arrow("higher", float("nan")), arrow("target", 1.0), arrow("none", None)] == [
        "↓",
        "↑",
        "→ 1",
        "",
    ]
