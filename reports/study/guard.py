"""What holds for every request: sizes, where it may come from, and the headers of every response."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

#: Bytes of a request's body; a page of answers has some hundred.
LARGEST_BODY = 64 * 1024

TOO_LARGE = f"The request is too large: at most {LARGEST_BODY // 1024} kB are read."

#: Bytes of a request's path with its query.
LONGEST_PATH = 512

#: Sent with everything: nothing but our own files is loaded, nobody may frame a page, and no other site learns of it.
HEADERS: Mapping[str, str] = {
    "Content-Security-Policy": (
        "default-src 'none'; style-src 'self'; script-src 'self'; media-src 'self'; img-src 'self'; form-action 'self'; "
        "base-uri 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Permissions-Policy": "camera=(), microphone=(), geolocation=(), display-capture=(), usb=(), payment=()",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "X-Robots-Tag": "noindex, nofollow",
}


class TooLarge(Exception):
    """A body beyond :data:`LARGEST_BODY`; raised while it is read, so that no more of it is."""


class Guard:
    """ASGI middleware: refuses what is too large or comes from another site, and sets :data:`HEADERS`.

    Parameters
    ----------
    app
        The site.
    """

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, or refuse it."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        headers = {name.decode("latin-1").lower(): value.decode("latin-1") for name, value in scope["headers"]}

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                given = {name.lower() for name, _ in message["headers"]}
                extra = dict(HEADERS)
                if scope["scheme"] == "https":
                    extra["Strict-Transport-Security"] = "max-age=31536000"
                if b"cache-control" not in given:
                    extra["Cache-Control"] = "no-store"
                message["headers"] = [
                    *message["headers"],
                    *((name.encode(), value.encode()) for name, value in extra.items()),
                ]
            await send(message)

        refusal = _refusal(scope, headers)
        if refusal is not None:
            await _plain(*refusal, send_with_headers)
            return
        size = 0

        async def receive_limited() -> Message:
            nonlocal size
            message = await receive()
            if message["type"] == "http.request":
                size += len(message.get("body", b""))
                if size > LARGEST_BODY:
                    raise TooLarge
            return message

        await self.app(scope, receive_limited, send_with_headers)


def _refusal(scope: Scope, headers: Mapping[str, str]) -> tuple[int, str] | None:
    if len(scope.get("raw_path") or b"") + len(scope.get("query_string") or b"") > LONGEST_PATH:
        return 414, "The address is too long."
    length = headers.get("content-length", "0")
    if not length.isascii() or not length.isdigit():
        return 400, "The length of the request is no number."
    if int(length) > LARGEST_BODY:
        return 413, TOO_LARGE
    if scope["method"] == "POST":
        # A browser says where a form comes from; under `no-referrer` its Origin is "null", and Sec-Fetch-Site still tells.
        origin = headers.get("origin", "null")
        foreign = origin != "null" and urlsplit(origin).netloc != headers.get("host", "")
        if foreign or headers.get("sec-fetch-site", "same-origin") not in ("same-origin", "none"):
            return 403, "Forms of other sites are refused."
        if headers.get("content-type", "").partition(";")[0].strip().lower() != "application/x-www-form-urlencoded":
            return 415, "Only forms are read (application/x-www-form-urlencoded)."
    return None


async def _plain(status: int, text: str, send: Any) -> None:
    body = f"{text}\n".encode()
    headers = [
        (b"content-type", b"text/plain; charset=utf-8"),
        (b"content-length", str(len(body)).encode()),
        (b"connection", b"close"),
    ]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})
