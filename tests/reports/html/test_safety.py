"""Nothing that a file or a user named can become part of the page's code."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from importlib import resources

import pytest
from hypothesis import given
from hypothesis import strategies as st

from reports.html.safety import inline_json, policy


@given(
    st.recursive(
        st.text() | st.integers() | st.booleans(), lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner)
    )
)
def test_inline_json_is_the_same_value_and_cannot_end_its_element(value):
    text = inline_json(value)
    assert json.loads(text) == value
    assert not re.search("[<>&\u2028\u2029]", text)


def test_numbers_that_json_lacks_are_refused():
    with pytest.raises(ValueError, match="JSON compliant"):
        inline_json(float("nan"))


def test_policy_names_the_very_texts():
    found = policy(scripts=["let a = 1;", "b"], styles=["c"])
    digest = base64.b64encode(hashlib.sha256(b"let a = 1;").digest()).decode()
    assert f"'sha256-{digest}'" in found.split("script-src")[1].split(";")[0]
    assert found.startswith("default-src 'none'") and "unsafe" not in found and found.count("sha256-") == 3


def _variables(text: str) -> dict[str, str]:
    return dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6});", text))


def _luminance(colour: str) -> float:
    parts = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    red, green, blue = (c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def _contrast(a: str, b: str) -> float:
    high, low = sorted((_luminance(a), _luminance(b)), reverse=True)
    return (high + 0.05) / (low + 0.05)


#: Text on what it stands on, everywhere on the page.
_TEXT = [
    *(
        (ink, ground)
        for ink in ("ink", "soft")
        for ground in ("page", "band", "real", "floor", "stage", "warn-band", "fail-band")
    ),
    *(("link", ground) for ground in ("page", "band", "fail-band", "warn-band")),
    *(("best", ground) for ground in ("page", "stage", "real")),
    ("warn", "page"),
    ("warn", "warn-band"),
    ("fail", "page"),
    ("fail", "fail-band"),
    ("page", "link"),
]


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_can_be_read_in_both_schemes(scheme):
    css = (resources.files("reports") / "templates" / "page.css").read_text(encoding="utf-8")
    light, _, rest = css.partition("@media (prefers-color-scheme: dark)")
    colours = _variables(light)
    if scheme == "dark":
        dark = _variables(rest.split("* { box-sizing")[0])
        assert set(dark) == set(colours)
        colours = dark
    # WCAG 2.2, 1.4.3 and 1.4.11.
    low = {pair: _contrast(colours[pair[0]], colours[pair[1]]) for pair in _TEXT}
    assert min(low.values()) >= 4.5, min(low.items(), key=lambda entry: entry[1])
    assert min(_contrast(colours["focus"], colours[ground]) for ground in ("page", "stage", "band")) >= 3.0
    assert _contrast(colours["soft"], colours["page"]) >= 3.0
