"""Who may talk to the server, and how much.

A page of another site can make the user's browser send requests to 127.0.0.1, directly (Origin tells)
or through a name that it lets point there (DNS rebinding; Host tells). Both are refused. Bound to
another address than loopback, the server also wants a token.
"""

from __future__ import annotations

import hmac
from collections.abc import Iterable
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs

from starlette.responses import JSONResponse, RedirectResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

MAX_BODY = 32 << 20
_HTTP = 80
TOO_LARGE = f"a body of at most {MAX_BODY} bytes is expected"
_HEADERS = {
    "content-security-policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; "
        "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "x-frame-options": "DENY",
}


class BodyTooLargeError(Exception):
    """A request's body turned out larger than `MAX_BODY`; the application answers 413."""


class Guard:
    """ASGI middleware that refuses foreign hosts, foreign origins, missing tokens and large bodies.

    Parameters
    ----------
    app : ASGI application
        What is guarded.
    hosts : iterable of str
        Accepted values of the Host header, with port.
    token : str
        When not empty, every request must carry it: ``Authorization: Bearer TOKEN``, the cookie that
        opening ``/?token=TOKEN`` sets, or that address itself.
    """

    def __init__(self, app: ASGIApp, hosts: Iterable[str], token: str = "") -> None:
        self.app, self.hosts, self.token = app, {host.lower() for host in hosts}, token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer, refuse, or pass the request on with a bounded body."""
        if scope["type"] != "http":
            if scope["type"] == "lifespan":
                await self.app(scope, receive, send)
            return
        headers = {name.decode("latin-1"): value.decode("latin-1") for name, value in scope["headers"]}
        refusal = self._refusal(scope, headers)
        answer = _with_headers(send)
        if refusal is not None:
            await refusal(scope, receive, answer)
            return
        await self._bounded(scope, receive, answer)

    def _refusal(self, scope: Scope, headers: dict[str, str]) -> JSONResponse | RedirectResponse | None:
        host = headers.get("host", "").lower()
        if host not in self.hosts:
            return refuse(421, f"Host {host[:80]!r} is not served here")
        origin = headers.get("origin")
        if origin is not None and origin.lower() not in {f"http://{host}", f"https://{host}"}:
            return refuse(403, f"Origin {origin[:80]!r} may not use this server")
        if (
            headers.get("content-length", "0").isdigit()
            and int(headers.get("content-length", "0")) > MAX_BODY
        ):
            return refuse(413, TOO_LARGE)
        return self._check_token(scope, headers) if self.token else None

    def _check_token(self, scope: Scope, headers: dict[str, str]) -> JSONResponse | RedirectResponse | None:
        asked = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[0]
        if scope["path"] == "/" and self._matches(asked):
            # The token leaves the address bar, and with it the browser's history.
            welcome = RedirectResponse("/", status_code=303)
            welcome.set_cookie(_cookie_name(headers), self.token, httponly=True, samesite="strict")
            return welcome
        bearer = headers.get("authorization", "").removeprefix("Bearer ")
        if self._matches(bearer) or self._matches(_cookie(headers)):
            return None
        return refuse(401, "this server wants the token that it printed when it started")

    def _matches(self, given: str) -> bool:
        return bool(given) and hmac.compare_digest(given.encode(), self.token.encode())

    async def _bounded(self, scope: Scope, receive: Receive, send: Send) -> None:
        size = 0

        async def counted() -> Message:
            nonlocal size
            message = await receive()
            size += len(message.get("body", b""))
            if size > MAX_BODY:
                raise BodyTooLargeError
            return message

        await self.app(scope, counted, send)


def _cookie_name(headers: dict[str, str]) -> str:
    """Name the cookie after the port: browsers keep cookies by host, and two servers may share one."""
    port = headers["host"].rpartition(":")[2]
    return f"kt3dmoseg_token_{port if port.isdecimal() else _HTTP}"


def _cookie(headers: dict[str, str]) -> str:
    try:
        found = SimpleCookie(headers.get("cookie", "")).get(_cookie_name(headers))
    except CookieError:
        return ""
    return found.value if found else ""


def refuse(status: int, message: str) -> JSONResponse:
    """Answer with an error that the page shows."""
    return JSONResponse({"error": message}, status_code=status)


def _with_headers(send: Send) -> Send:
    extra = [(name.encode(), value.encode()) for name, value in _HEADERS.items()]

    async def wrapped(message: Message) -> None:
        if message["type"] == "http.response.start":
            message = {**message, "headers": [*message.get("headers", []), *extra]}
        await send(message)

    return wrapped
