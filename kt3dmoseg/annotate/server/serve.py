"""Running the labelling server."""

from __future__ import annotations

import secrets
import socket
from collections.abc import Callable
from ipaddress import ip_address

from kt3dmoseg.annotate.server.app import create_app
from kt3dmoseg.annotate.server.routes import Routes
from kt3dmoseg.errors import InputFileError, InvalidValueError, MissingDependencyError

_LAST_PORT = 65_535


def serve(
    routes: Routes, *, host: str = "127.0.0.1", port: int = 0, ready: Callable[[str], None] | None = None
) -> None:
    """Serve the labelling page until interrupted.

    Parameters
    ----------
    routes : Routes
        The clips.
    host : str
        Address to listen on. Any but loopback makes the server want a token.
    port : int
        0 = any free one.
    ready : callable, optional
        Called with the page's address once the server listens.

    Raises
    ------
    MissingDependencyError
        When uvicorn is not installed.
    InputFileError
        When the address cannot be listened on.
    """
    try:
        import uvicorn
    except ImportError as error:
        fix = "pip install 'kt3dmoseg[label]'"
        raise MissingDependencyError("uvicorn is not installed", fix=fix) from error
    listener = _listen(host, port)
    port = listener.getsockname()[1]
    token = "" if is_loopback(host) else secrets.token_urlsafe(24)
    app = create_app(routes, hosts=_hosts(host, port), token=token)
    # Found out now, not while the first page waits for it.
    _ = routes.suffixes, routes.proposers
    config = uvicorn.Config(app, log_level="warning", lifespan="off", server_header=False)
    if ready is not None:
        shown = f"[{host}]" if ":" in host else host
        ready(f"http://{shown}:{port}/" + (f"?token={token}" if token else ""))
    uvicorn.Server(config).run(sockets=[listener])


def is_loopback(host: str) -> bool:
    """Whether an address is only reachable from this machine."""
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _listen(host: str, port: int) -> socket.socket:
    if not 0 <= port <= _LAST_PORT:
        raise InvalidValueError("--port", expected=f"0 to {_LAST_PORT}", found=str(port))
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputFileError(
            f"{host}:{port}: cannot listen", found=reason, fix="choose another --port"
        ) from error


def _hosts(host: str, port: int) -> set[str]:
    names = {"127.0.0.1", "localhost", "[::1]"} if is_loopback(host) else {host}
    if host in ("0.0.0.0", "::"):  # every address of this machine; the token protects
        names |= {"127.0.0.1", "localhost", socket.gethostname(), *_addresses()}
    return {f"{name}:{port}" for name in names} | (names if port == 80 else set())


def _addresses() -> set[str]:
    try:
        found = socket.getaddrinfo(socket.gethostname(), None)
    except OSError:
        return set()
    return {f"[{a[4][0]}]" if ":" in str(a[4][0]) else str(a[4][0]) for a in found}
