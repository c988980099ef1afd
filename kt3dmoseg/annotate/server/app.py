"""The labelling server as an ASGI application."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from html import escape
from importlib import resources
from urllib.parse import quote

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, Response
from starlette.routing import Route

from kt3dmoseg.annotate.model import to_json
from kt3dmoseg.annotate.server.guard import TOO_LARGE, BodyTooLargeError, Guard, refuse
from kt3dmoseg.annotate.server.routes import Routes
from kt3dmoseg.annotate.session import StaleRevisionError
from kt3dmoseg.draw.palette import css_palette
from kt3dmoseg.errors import InputFileError, KT3DMoSegError

_TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}


def create_app(routes: Routes, *, hosts: Iterable[str], token: str = "") -> Guard:
    """Make the application.

    Parameters
    ----------
    routes : Routes
        The clips and what can be done with them.
    hosts : iterable of str
        Accepted Host headers, with port.
    token : str
        Wanted from every request when not empty.

    Returns
    -------
    Guard
        The guarded ASGI application.
    """
    static = _static_files()
    template = bytes(static["index.html"].body).decode()

    async def page(request: Request) -> Response:
        asked = request.query_params.get("clip", "")
        return HTMLResponse(
            _page(template, static, routes.desks, asked), headers={"cache-control": "no-store"}
        )

    async def file(request: Request) -> Response:
        # A table of the packaged files: no path of a request ever reaches the file system.
        found = static.get(request.path_params["name"])
        return found or refuse(404, "no such file")

    table = [Route("/", page), Route("/static/{name}", file), *routes.table()]
    app = Starlette(
        routes=table,
        exception_handlers={
            StaleRevisionError: _stale,
            BodyTooLargeError: _too_large,
            InputFileError: _unavailable,
            KT3DMoSegError: _bad_request,
            HTTPException: _http,
        },
    )
    return Guard(app, hosts, token)


def _page(template: str, static: Iterable[str], clips: Iterable[str], asked: str) -> str:
    """Name the clip to open, and let the browser fetch at once what it would find out about step by step."""
    names = list(clips)
    clip = asked if asked in names else names[0]
    modules = [f'<link rel="modulepreload" href="/static/{name}">' for name in static if name.endswith(".js")]
    picture = f"/api/clips/{quote(clip, safe='')}/frames/0"
    values = {
        "{{clip}}": escape(clip),
        "{{picture}}": picture,
        "{{palette}}": escape(json.dumps(css_palette())),
        "{{modules}}": "\n".join(modules),
    }
    for name, value in values.items():
        template = template.replace(name, value)
    return template


def _static_files() -> Mapping[str, Response]:
    folder = resources.files("kt3dmoseg.annotate") / "static"
    out: dict[str, Response] = {}
    for entry in folder.iterdir():
        suffix = "." + entry.name.rpartition(".")[2]
        if suffix in _TYPES:
            headers = {"cache-control": "no-cache"}
            out[entry.name] = Response(entry.read_bytes(), media_type=_TYPES[suffix], headers=headers)
    return out


async def _stale(_: Request, error: Exception) -> Response:
    assert isinstance(error, StaleRevisionError)
    return JSONResponse({"error": str(error), "annotation": to_json(error.current)}, status_code=412)


async def _bad_request(_: Request, error: Exception) -> Response:
    return refuse(400, str(error))


async def _unavailable(_: Request, error: Exception) -> Response:
    return refuse(500, str(error))


async def _too_large(_: Request, error: Exception) -> Response:
    del error
    return refuse(413, TOO_LARGE)


async def _http(_: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    return refuse(error.status_code, error.detail)
