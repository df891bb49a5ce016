"""The secret of a study: it signs the plan and makes ids that nobody can compute from what they stand for."""

from __future__ import annotations

import hashlib
import hmac
import os
import secrets
from pathlib import Path

from benchmark.errors import StoreError

#: Bytes of the secret.
_SIZE = 32


def make_secret(path: Path) -> bytes:
    """The secret in ``path``, made if it is not there, readable by its owner only.

    Raises
    ------
    StoreError
        If the file holds something else.
    """
    if not path.exists():
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(descriptor, "wb") as file:
            file.write(secrets.token_bytes(_SIZE))
    secret = path.read_bytes()
    if len(secret) != _SIZE:
        raise StoreError(
            f"{path} is no secret of a study ({len(secret)} bytes instead of {_SIZE}): take the folder away"
        )
    return secret


def signature(text: bytes, secret: bytes) -> str:
    """HMAC-SHA256 of a text."""
    return hmac.new(secret, b"plan\0" + text, hashlib.sha256).hexdigest()


def verify(text: bytes, signed: str, secret: bytes) -> bool:
    """Whether ``signed`` is the text's signature."""
    return hmac.compare_digest(signature(text, secret).encode(), signed.encode())


def stimulus_id(what: str, secret: bytes) -> str:
    """Sixteen hex digits that stand for ``what``; without the secret they say nothing of it."""
    return hmac.new(secret, b"stimulus\0" + what.encode(), hashlib.sha256).hexdigest()[:16]
