"""Bytes over a bad network: ranged requests that resume, repeat with patience, and are bounded.

What a server can do to us is met here and nowhere else: dropped connections, 5xx, stalled and slow
bodies, wrong lengths, wrong ranges, ignored ranges, redirects. What arrives in the wrong *content* is
found by the readers above, which hold checksums.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from kt3dmoseg.errors import InputFileError, InvalidValueError, MissingDependencyError
from kt3dmoseg.kitti.network import (
    AbsentError,
    ChangedError,
    Patience,
    RangesIgnoredError,
    Traffic,
    TransientError,
)
from kt3dmoseg.kitti.options import Network

if TYPE_CHECKING:
    import requests

_BLOCK = 1 << 16
_REDIRECTS = 5
_ABSENT = (403, 404, 410)  # S3 answers 403 for an object that is absent from a bucket it may not list
_TRANSIENT = (408, 425, 429, 500, 502, 503, 504)
_RANGE = re.compile(r"bytes (\d+)-(\d+)/(\d+)")


class Client:
    """A session with one or more servers.

    Parameters
    ----------
    network : Network
        Patience.
    traffic : Traffic, optional
        Counter to use.

    Raises
    ------
    MissingDependencyError
        When `requests` is not installed (the extra ``pull``).
    """

    def __init__(self, network: Network | None = None, traffic: Traffic | None = None) -> None:
        try:
            import requests
        except ImportError:
            raise MissingDependencyError(
                "downloads need the package requests", fix="pip install 'kt3dmoseg[pull]'"
            ) from None
        self.network = network or Network()
        self.traffic = traffic or Traffic()
        self._session = requests.Session()
        self._session.max_redirects = _REDIRECTS
        self._session.headers["Accept-Encoding"] = "identity"  # so that lengths are those of the file

    def close(self) -> None:
        """Close all connections."""
        self._session.close()

    def size(self, url: str) -> int:
        """Ask for the size of a file, with a request for its first byte.

        Raises
        ------
        AbsentError
            When there is no such file.
        RangesIgnoredError
            When the server ignores ranges.
        InputFileError
            When the server cannot be reached or refuses.
        """
        patience = Patience(url, self.network)
        while True:
            try:
                with closing(self._ranged(url, 0, 1)) as response:
                    size = _range_of(response, url)[2]
                    next(self._body(response), b"")
                    return size
            except TransientError as error:
                patience.failed(error, 0)

    def chunks(self, url: str, start: int, length: int, size: int) -> Iterator[bytes]:
        """Yield exactly `length` bytes of a file from `start` on, resuming as often as needed.

        Parameters
        ----------
        url : str
            The file.
        start, length : int
            The wanted range.
        size : int
            The file's size, as `size` told it.

        Raises
        ------
        ChangedError
            When the file now has another size.
        AbsentError, RangesIgnoredError, InputFileError
            As for `size`.
        """
        patience, got = Patience(url, self.network), 0
        while got < length:
            before = got
            try:
                for block in self._attempt(url, start + got, length - got, size):
                    got += len(block)
                    yield block
            except TransientError as error:
                patience.failed(error, got - before)

    def download(self, url: str, path: Path) -> None:
        """Append to `path` what it lacks of a file, from a server that may ignore ranges.

        A part that is there already, from an interrupted download, is kept: the rest is asked for, and
        where the server sends everything again, the beginning is passed over.
        """
        patience = Patience(url, self.network)
        while True:
            before = path.stat().st_size if path.exists() else 0
            try:
                return self._append(url, path, before)
            except TransientError as error:
                patience.failed(error, (path.stat().st_size if path.exists() else 0) - before)

    def _attempt(self, url: str, start: int, length: int, size: int) -> Iterator[bytes]:
        with closing(self._ranged(url, start, length)) as response:
            first, _, total = _range_of(response, url)
            if total != size:
                raise ChangedError(url, expected=f"{size} bytes as before", found=f"{total}")
            if first != start:
                raise TransientError(f"a range from byte {first} instead of {start}")
            got = 0
            for block in self._body(response):
                if got == length:
                    return  # the server sends more than it was asked for
                wanted = block[: length - got]
                got += len(wanted)
                yield wanted
            if got == length:
                return
            raise TransientError(f"the connection ended {length - got} bytes early")

    def _ranged(self, url: str, start: int, length: int) -> requests.Response:
        response = self._get(url, f"bytes={start}-{start + length - 1}")
        if response.status_code == 206:
            return response
        response.close()
        if response.status_code == 200:
            raise RangesIgnoredError(url, _length(response))
        if response.status_code == 416:
            raise ChangedError(url, expected=f"at least {start + length} bytes", found="fewer")
        raise InputFileError(f"{url}: the server answered {response.status_code} {response.reason}")

    def _append(self, url: str, path: Path, have: int) -> None:
        response = self._get(url, f"bytes={have}-" if have else None)
        if response.status_code == 416 and have:
            response.close()
            return  # there is nothing after what we have; the reader will say if it is not the file
        with closing(response):
            if response.status_code not in (200, 206):
                raise InputFileError(f"{url}: the server answered {response.status_code} {response.reason}")
            at = _range_of(response, url)[0] if response.status_code == 206 else 0
            if at not in (0, have):
                raise TransientError(f"a range from byte {at} instead of {have}")
            expected = _length(response)
            end = at if expected is None else at + expected
            for block in self._body(response):
                _append_to(path, block[max(0, have - at) :])
                at += len(block)
        if expected is not None and at < end:
            raise TransientError(f"the connection ended {end - at} bytes early")

    def _get(self, url: str, range_: str | None) -> requests.Response:
        import requests

        self.traffic.requests += 1
        headers = {"Range": range_} if range_ else {}
        try:
            response = self._session.get(url, headers=headers, stream=True, timeout=self.network.timeout)
        except (
            requests.exceptions.InvalidURL,
            requests.exceptions.InvalidSchema,
            requests.exceptions.MissingSchema,
        ):
            raise InvalidValueError("address", expected="http:// or https://", found=url) from None
        except requests.exceptions.TooManyRedirects:
            raise InputFileError(f"{url}: redirected more than {_REDIRECTS} times") from None
        except (requests.exceptions.RequestException, OSError) as error:
            if "certificate" in str(error).lower():
                raise InputFileError(f"{url}: the server's certificate is not trusted") from None
            raise TransientError(_reason(error)) from None
        if response.status_code in _TRANSIENT:
            response.close()
            pause = _seconds(response.headers.get("Retry-After", ""))
            raise TransientError(f"{response.status_code} {response.reason}", pause)
        if response.status_code in _ABSENT:
            response.close()
            raise AbsentError(f"{url}: the server answered {response.status_code} {response.reason}")
        return response

    def _body(self, response: requests.Response) -> Iterator[bytes]:
        """Yield what arrives as it arrives; give up on a trickle that the socket's timeout cannot see."""
        import requests
        import urllib3

        since, arrived, window = time.monotonic(), 0, self.network.timeout
        while True:
            try:
                block: bytes = response.raw.read1(_BLOCK, decode_content=False)
            except (requests.exceptions.RequestException, urllib3.exceptions.HTTPError, OSError) as error:
                raise TransientError(_reason(error)) from None
            if not block:
                return
            self.traffic.received(len(block))
            arrived += len(block)
            yield block
            if (now := time.monotonic()) - since > window:
                if arrived < self.network.slowest * (now - since):
                    raise TransientError(f"{arrived / (now - since):.0f} bytes per second")
                since, arrived = now, 0


def _range_of(response: requests.Response, url: str) -> tuple[int, int, int]:
    match = _RANGE.fullmatch(response.headers.get("Content-Range", "").strip())
    if not match:
        raise InputFileError(
            f"{url}: Content-Range",
            expected="bytes FIRST-LAST/SIZE",
            found=repr(response.headers.get("Content-Range")),
        )
    return int(match[1]), int(match[2]), int(match[3])


def _length(response: requests.Response) -> int | None:
    text = response.headers.get("Content-Length", "")
    return int(text) if text.isdigit() else None


def _seconds(text: str) -> float:
    return float(text) if text.isdigit() else 0.0


def _append_to(path: Path, block: bytes) -> None:
    try:
        with open(path, "ab") as stream:
            stream.write(block)
    except OSError as error:
        raise InputFileError(f"{path}: cannot write", found=error.strerror or str(error)) from None


def _reason(error: BaseException) -> str:
    text = str(error)
    for words in ("timed out", "refused", "reset", "closed"):
        if words in text.lower():
            return f"connection {words} ({type(error).__name__})"
    return type(error).__name__
