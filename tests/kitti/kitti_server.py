"""A local HTTP server that serves bytes from memory, counts everything, and misbehaves on demand."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

_PIECE = 1 << 15


class FaultyServer(ThreadingHTTPServer):
    """Serves `files` (path to bytes); `fault(count, path)` names what goes wrong with a request."""

    daemon_threads = True
    block_on_close = False

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.files: dict[str, bytes] = {}
        self.fault: Callable[[int, str], str] = lambda count, path: ""
        self.ranges = True
        self.versions: dict[str, str] = {}  # ETags, by path
        self.endless: dict[str, str] | None = None  # headers of an answer to everything, without an end
        self.requests: list[tuple[str, str]] = []
        self.sent = 0
        self.connections = 0
        self.stopping = threading.Event()
        self.guard = threading.Lock()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}/raw_data"

    def reset(self) -> None:
        self.requests, self.sent, self.connections = [], 0, 0

    def requests_for(self, part: str) -> list[tuple[str, str]]:
        return [request for request in self.requests if part in request[0]]

    def handle_error(self, request: object, client_address: object) -> None:
        """Clients that hang up are part of the tests."""


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server: FaultyServer

    def setup(self) -> None:
        super().setup()
        with self.server.guard:
            self.server.connections += 1

    def log_message(self, *arguments: object) -> None:
        pass

    def do_GET(self) -> None:
        asked = self.headers.get("Range", "")
        with self.server.guard:
            self.server.requests.append((self.path, asked))
            count = len(self.server.requests)
        fault = self.server.fault(count, self.path)
        if fault in ("500", "503", "403"):
            return self._status(int(fault))
        if fault == "drop":
            return self._hang_up()
        if "redirect" in fault and not self.path.startswith("/moved"):
            head = {"Location": "/moved" + self.path}
            fat = head | {"Content-Length": f"{1 << 40}"}
            return self._status(302, head) if fault == "redirect" else self._endless(302, fat)
        if fault == "slow headers":
            return self._trickle_headers()
        if fault == "loop":
            return self._status(302, {"Location": self.path + "x"})
        content = self.server.files.get(self.path.removeprefix("/moved").removeprefix("/raw_data/"))
        if content is None:
            return self._status(404)
        if self.server.endless is not None:
            return self._endless(200, self.server.endless)
        return self._send(content, asked, fault)

    def _send(self, content: bytes, asked: str, fault: str) -> None:
        match = re.fullmatch(r"bytes=(\d*)-(\d*)", asked)
        version = self.server.versions.get(self.path.removeprefix("/raw_data/"), "")
        tag = {"ETag": version} if version else {}
        if not match or not self.server.ranges or self.headers.get("If-Range", version) != version:
            return self._body(200, content, tag, fault)
        if not match[1]:
            return self._status(416)  # suffix ranges are refused
        start, stop = int(match[1]), min(int(match[2] or len(content)) + 1, len(content))
        if start >= len(content):
            return self._status(416, {"Content-Range": f"bytes */{len(content)}"})
        if fault == "short":
            stop = start + max(1, (stop - start) // 2)
        shift = 1 if fault == "shifted" and start else 0
        head = tag | {"Content-Range": f"bytes {start - shift}-{stop - 1 - shift}/{len(content)}"}
        part = content[start:stop]
        if fault == "long":
            part += b"surplus" * 100
        if fault == "flip":
            middle = len(part) // 2
            part = part[:middle] + bytes([part[middle] ^ 0x55]) + part[middle + 1 :]
        return self._body(206, part, head, fault)

    def _body(self, status: int, part: bytes, head: dict[str, str], fault: str) -> None:
        self.send_response(status)
        for key, value in head.items():
            self.send_header(key, value)
        self.send_header("Content-Length", str(len(part)))
        self.end_headers()
        end = len(part) // 2 if fault in ("cut", "stall", "trickle") else len(part)
        for at in range(0, end, _PIECE):
            self._write(part[at : min(end, at + _PIECE)])
        if fault == "cut":
            self._hang_up()
        while fault in ("stall", "trickle") and not self.server.stopping.is_set():
            time.sleep(0.02)
            if fault == "trickle":
                self._write(b"x")

    def _write(self, piece: bytes) -> None:
        self.wfile.write(piece)
        self.wfile.flush()
        with self.server.guard:
            self.server.sent += len(piece)

    def _status(self, status: int, head: dict[str, str] | None = None) -> None:
        self.send_response(status)
        for key, value in (head or {}).items():
            self.send_header(key, value)
        self.send_header("Content-Length", "0")
        self.end_headers()

    def _endless(self, status: int, head: dict[str, str]) -> None:
        self.send_response(status)
        for key, value in head.items():
            self.send_header(key, value)
        self.end_headers()
        self.close_connection = True
        chunk = b"%x\r\n%b\r\n" % (_PIECE, bytes(_PIECE))
        while not self.server.stopping.is_set():
            self._write(chunk if "Transfer-Encoding" in head else bytes(_PIECE))

    def _trickle_headers(self) -> None:
        self.close_connection = True
        self.wfile.write(b"HTTP/1.1 206 Partial Content\r\nX-Slow: ")
        while not self.server.stopping.is_set():
            time.sleep(0.02)
            self._write(b"x")

    def _hang_up(self) -> None:
        self.close_connection = True
        self.connection.close()


@contextmanager
def serving() -> Iterator[FaultyServer]:
    server = FaultyServer()
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
    thread.start()
    try:
        yield server
    finally:
        server.stopping.set()
        server.shutdown()
        server.server_close()
        thread.join()
