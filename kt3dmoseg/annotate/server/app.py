"""The labelling server: the application, who may use it, and running it.

A page of another site can make the user's browser send requests to 127.0.0.1, directly (Origin shows it)
or through a name that it lets point there (DNS rebinding; Host shows it). Both are refused. Bound to
another address than loopback, the server also requires a token.
"""

from __future__ import annotations

import hmac
import json
import mimetypes
import re
import secrets
import socket
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from ipaddress import ip_address
from pathlib import Path
from urllib.parse import quote

import uvicorn
from jinja2 import Template
from markupsafe import Markup
from starlette.applications import Starlette
from starlette.datastructures import MutableHeaders
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import HTMLResponse, JSONResponse, RedirectResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from kt3dmoseg.annotate.model import StaleRevisionError, to_json
from kt3dmoseg.annotate.server.clip_session import LONGEST_NAME, NotTrackedError
from kt3dmoseg.annotate.server.routes import Routes
from kt3dmoseg.app import typed
from kt3dmoseg.draw.palette import css_palette
from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError, KT3DMoSegError
from kt3dmoseg.files import read_bytes, write_text

_TOKEN = 24  # random bytes
_MAX_TEAM = 1 << 16
MAX_BODY = 32 << 20
MAX_HELD = 256 << 20  # of all bodies that are being received or worked on
_SMALL = 4 << 20
_HTTP = 80
_LAST_PORT = 65_535
_OWN_NAMES = ("127.0.0.1", "localhost", "[::1]")
_STATIC = Path(__file__).parents[1] / "static"
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
# What some systems take for plain text, which browsers do not run.
mimetypes.add_type("text/javascript", ".js")


def create_app(routes: Routes, *, hosts: Iterable[str], tokens: Mapping[str, str] | None = None) -> Guard:
    """Make the guarded ASGI application; see `Guard` for hosts and tokens."""
    template = Template((_STATIC / "index.html").read_text(encoding="utf-8"), autoescape=True)
    # The browser fetches all modules at once instead of following imports step by step.
    modules = [f'<link rel="modulepreload" href="/static/{file.name}">' for file in _STATIC.glob("*.js")]
    fixed = {"palette": json.dumps(css_palette()), "modules": Markup("\n".join(modules))}

    async def page(request: Request) -> Response:
        asked = request.query_params.get("clip", "")
        clip = asked if asked in routes.sessions else next(iter(routes.sessions))
        picture = f"/api/clips/{quote(clip, safe='')}/frames/0"
        html = template.render(clip=clip, picture=picture, **fixed)
        return HTMLResponse(html, headers={"cache-control": "no-store"})

    table = [Route("/", page), Mount("/static", StaticFiles(directory=_STATIC)), *routes.table()]
    expected = (KT3DMoSegError, HTTPException, ClientDisconnect, NotTrackedError)
    app = Starlette(routes=table, exception_handlers=dict.fromkeys(expected, _failed))
    return Guard(app, hosts, tokens or {})


async def _failed(_: Request, error: Exception) -> Response:
    if isinstance(error, HTTPException):
        return _refuse(error.status_code, typed(error.detail))
    if isinstance(error, NotTrackedError):
        progress = dict(zip(("done", "total", "error"), error.args, strict=True))
        return JSONResponse(progress, status_code=500 if progress["error"] else 202)
    if isinstance(error, StaleRevisionError):
        return JSONResponse({"error": str(error), "annotation": to_json(error.current)}, status_code=412)
    return _refuse(500 if isinstance(error, InputFileError) else 400, typed(str(error)))


class Guard:
    """ASGI middleware that refuses foreign hosts, foreign origins, missing tokens and large bodies.

    `hosts` are accepted values of the Host header, with port; any, when there are none. `tokens` give the
    name of who has each, "" for nobody in particular. When there are any, every request must carry one:
    ``Authorization: Bearer TOKEN``, the cookie that opening ``/?token=TOKEN`` sets, or be for it.
    """

    def __init__(self, app: ASGIApp, hosts: Iterable[str], tokens: Mapping[str, str]) -> None:
        self.app, self.hosts, self.tokens = app, {host.lower() for host in hosts}, tokens
        self.held = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer, refuse, or pass the request on with a bounded body."""
        if scope["type"] != "http":
            return
        # The browser requests files of the page again after an update: their ETag decides.
        fixed = scope["path"].startswith("/static/")
        headers = _HEADERS | ({"cache-control": "no-cache"} if fixed else {})
        size = 0

        async def bounded() -> Message:
            nonlocal size
            message = await receive()
            length = len(message.get("body", b""))
            size, self.held = size + length, self.held + length
            if size > MAX_BODY:
                raise HTTPException(413, f"a body of at most {MAX_BODY} bytes is expected")
            if self.held > MAX_HELD and size > _SMALL:
                raise HTTPException(503, "the server is receiving too much; try again later")
            return message

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(headers)
            await send(message)

        answer = self._refusal(Request(scope)) or self.app
        try:
            await answer(scope, bounded, with_headers)
        finally:
            self.held -= size

    def _refusal(self, request: Request) -> Response | None:
        # Starlette's TrustedHostMiddleware ignores the port, and answers in plain text.
        host = request.headers.get("host", "").lower()
        if self.hosts and host not in self.hosts:
            return _refuse(421, f"Host {host[:80]!r} is not served here")
        origin = request.headers.get("origin")
        if origin is not None and origin.lower() not in {f"http://{host}", f"https://{host}"}:
            return _refuse(403, f"Origin {origin[:80]!r} may not use this server")
        return self._check_token(request, host) if self.tokens else None

    def _check_token(self, request: Request, host: str) -> Response | None:
        # Browsers keep cookies by host, not by port, and two servers may share one.
        cookie = "kt3dmoseg_token_" + (re.findall(r":(\d+)$", host) or [f"{_HTTP}"])[0]
        given = request.query_params.get("token", "")
        if request.url.path == "/" and self._holder(given) is not None:
            # The token leaves the address bar, and with it the browser's history.
            page = request.url.remove_query_params("token").replace(scheme="", netloc="")
            welcome = RedirectResponse(page, status_code=303)
            welcome.set_cookie(cookie, given, httponly=True, samesite="lax")  # links in mail lead here, too
            return welcome
        bearer = request.headers.get("authorization", "").removeprefix("Bearer ")
        for token in (bearer, request.cookies.get(cookie, "")):
            if (name := self._holder(token)) is not None:
                request.scope["annotator"] = name
                return None
        return _refuse(401, "open the address with your token: the server printed it, or the team has it")

    def _holder(self, given: str) -> str | None:
        """Return whose token this is; None when it is none. Every token is compared, in constant time."""
        same = [
            name for token, name in self.tokens.items() if hmac.compare_digest(given.encode(), token.encode())
        ]
        return same[0] if same else None


def _refuse(status: int, message: str) -> JSONResponse:
    return JSONResponse({"error": message}, status_code=status)


def serve(
    routes: Routes,
    *,
    host: str,
    port: int,
    ready: Callable[[dict[str, str]], object],
    tokens: Mapping[str, str],
) -> None:
    """Serve the labelling page until interrupted; any host but loopback makes the server want a token.

    Port 0 is any free one. `tokens` are those of a team, with their names (`read_team`). `ready` is called
    once the server listens, with the page's address for each name, "" without a team.
    """
    if not 0 <= port <= _LAST_PORT:
        raise InvalidValueError("port", expected=f"0 to {_LAST_PORT}", found=str(port))
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        listener = socket.create_server((host, port), family=family)
    except OSError as error:
        where, reason = f"{host}:{port}: cannot listen", error.strerror or str(error)
        raise InputFileError(where, found=reason, fix="choose another port") from error
    port, names = listener.getsockname()[1], {host, *_OWN_NAMES}
    hosts = {f"{name}:{port}" for name in names} | (names if port == _HTTP else set())
    if not is_loopback(host):  # whatever it is called here, the token protects
        hosts, tokens = set(), tokens or {secrets.token_urlsafe(_TOKEN): ""}
    app = create_app(routes, hosts=hosts, tokens=tokens)
    config = uvicorn.Config(app, log_level="warning", lifespan="off", server_header=False)
    shown = _reached(host)
    page = f"http://{shown}:{port}/"
    ready({name: f"{page}?token={token}" for token, name in tokens.items()} or {"": page})
    try:
        uvicorn.Server(config).run(sockets=[listener])
    finally:
        routes.counting.shutdown(wait=False, cancel_futures=True)


def _reached(host: str) -> str:
    """Return a host as others write it in an address: of a wildcard, this machine's own address."""
    if host in ("0.0.0.0", "::", ""):
        with suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.connect(("192.0.2.1", 9))  # nothing is sent: this only chooses the network
            return str(probe.getsockname()[0])
    return f"[{host}]" if ":" in host else host


def read_team(path: Path) -> dict[str, str]:
    """Return the names in a file, one a line, by their tokens.

    A name without a token behind a tab gets one, which is written into the file: addresses stay valid.
    Raises InputFileError, or FileFormatError for names that are missing, too long or there twice.
    """
    text = read_bytes(path, _MAX_TEAM).decode("utf-8-sig", "replace")
    team: dict[str, str] = {}
    for line in filter(str.strip, text.splitlines()):
        name, _, token = (part.strip() for part in line.partition("\t"))
        if not name or len(name) > LONGEST_NAME or name in team.values():
            expected = f"each name once, of at most {LONGEST_NAME} characters"
            raise FileFormatError(f"{path}", expected=expected, found=repr(line)[:120])
        team[token or secrets.token_urlsafe(_TOKEN)] = name
    if not team:
        raise FileFormatError(f"{path}", expected="the name of an annotator on each line", found="none")
    write_text(path, "".join(f"{name}\t{token}\n" for token, name in team.items()))
    path.chmod(0o600)
    return team


def is_loopback(host: str) -> bool:
    """Whether an address is only reachable from this machine."""
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
