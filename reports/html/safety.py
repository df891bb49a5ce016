"""What keeps a page closed: data that cannot end its element, and a policy under which nothing can be fetched or injected."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Sequence
from typing import Any

#: Signs that could end a ``<script>`` element or a line of it; JSON has them in strings only, where they may be escaped.
_SIGNS = {ord(sign): f"\\u{ord(sign):04x}" for sign in "<>&\u2028\u2029"}


def inline_json(value: Any) -> str:
    """``value`` as JSON for a ``<script type="application/json">``: no string in it can close the element.

    Raises
    ------
    ValueError
        If it holds a number that JSON has no word for.
    """
    return json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":")).translate(_SIGNS)


def policy(*, scripts: Sequence[str], styles: Sequence[str]) -> str:
    """A Content-Security-Policy that lets exactly these inline scripts and style sheets work, and pictures that are inline.

    Parameters
    ----------
    scripts, styles
        The text between the tags, byte for byte.
    """
    return "; ".join(
        [
            "default-src 'none'",
            "img-src data:",
            f"script-src {_hashes(scripts)}",
            f"style-src {_hashes(styles)}",
            "base-uri 'none'",
            "form-action 'none'",
        ]
    )


def _hashes(texts: Sequence[str]) -> str:
    found = (base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in texts)
    return " ".join(f"'sha256-{found}'" for found in found)
