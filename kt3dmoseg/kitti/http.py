"""Bytes over a bad network: ranged requests that resume, retry, and are bounded.

All faults of a server are handled here: dropped connections, 5xx, stalled and slow headers and
bodies, wrong lengths, wrong ranges, ignored ranges, redirects, files that change. What arrives in the wrong
*content* is found by the readers above, which hold checksums. Most faults show in the body, which
`urllib3.Retry` does not read; one loop of ours counts them all.
"""

import queue
import re
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import requests
from tqdm import tqdm
from urllib3.exceptions import HTTPError

from kt3dmoseg.errors import InputFileError
from kt3dmoseg.kitti import Origin

_BLOCK = 1 << 16
_PROGRESS = 1 << 14  # an attempt that receives this much is not counted against the server
_LONGEST_WAIT = 30.0
_REDIRECTS = 5
_ABSENT = (403, 404, 410)  # S3 answers 403 for an object that is absent from a bucket it may not list
_TRANSIENT = (408, 425, 429, 500, 502, 503, 504)
_NUMBER = r"\d{1,18}"  # in a header
_UNSTATED = 4 << 30  # bytes of a body whose length is not stated


class AbsentError(InputFileError):
    """The server has no such file."""


class RangesIgnoredError(InputFileError):
    """The server sends whole files only; `size` is the file's size when the server gave it."""

    def __init__(self, url: str, size: int | None) -> None:
        super().__init__(f"{url}: the server ignores ranges and sends whole files only")
        self.url, self.size = url, size


class ChangedError(InputFileError):
    """The file on the server is not the one that was read before."""


class _TransientError(Exception):
    """Worth repeating; after `pause` seconds if the server asked for them."""

    def __init__(self, reason: str, pause: float = 0.0) -> None:
        super().__init__(reason)
        self.pause = pause


@dataclass
class Traffic:
    """Requests made, and bytes of answers received."""

    requests: int = 0
    bytes: int = 0


class Client:
    """A session with one or more servers; it keeps the sizes of files, and notices when one changes.

    Its methods raise AbsentError, RangesIgnoredError and ChangedError, or InputFileError when the server
    cannot be reached or refuses.
    """

    def __init__(self, options: Origin, traffic: Traffic | None = None) -> None:
        self._options, self._traffic = options, traffic or Traffic()
        self.sizes: dict[str, int] = {}
        self._versions: dict[str, str] = {}  # what If-Range asks for: a strong ETag, else Last-Modified
        self._session = requests.Session()
        self._session.headers["Accept-Encoding"] = "identity"  # so that lengths are those of the file
        self._session.max_redirects = _REDIRECTS
        self._session.hooks["response"].append(_close_redirect)
        self.close = self._session.close

    def size(self, url: str) -> int:
        """Request the size of a file, with its first byte; what was known of the file is forgotten."""
        self.sizes.pop(url, None)
        self._versions.pop(url, None)
        list(self.chunks(url, 0, 1))
        return self.sizes[url]

    def download(self, url: str, path: Path, title: str, total: int | None = None) -> None:
        """Append to `path` what it lacks of a file, from a server that may ignore ranges, with a bar.

        Where the server sends everything again, the beginning is passed over. A file that changes meanwhile
        is fetched from its beginning, once.
        """
        for mode in ("ab", "wb"):
            self.sizes.pop(url, None)
            self._versions.pop(url, None)
            bar = tqdm(total=total, unit="B", unit_scale=True, desc=title, disable=None)
            with bar, open(path, mode) as stream:
                try:
                    for block in self.chunks(url, stream.tell(), None):
                        stream.write(block)
                        bar.update(len(block))
                    return
                except ChangedError:
                    if mode == "wb":
                        raise

    def chunks(self, url: str, start: int, length: int | None) -> Iterator[bytes]:
        """Yield exactly `length` bytes of a file from `start` on, or all, resuming as often as needed."""
        stop, failures = None if length is None else start + length, 0
        while True:
            before = start
            try:
                for block in self._attempt(url, start, stop):
                    start += len(block)
                    yield block
                return
            except _TransientError as error:
                failures = 1 if start - before >= _PROGRESS else failures + 1
                if failures > self._options.retries:
                    what = f"gave up after {failures} attempts, the last: {error}"
                    fix = "what was fetched is kept; run it again later"
                    raise InputFileError(f"{url}: {what}", fix=fix) from None
                pause = min(max(error.pause, self._options.wait * 2 ** (failures - 1)), _LONGEST_WAIT)
                if failures > 1 and sys.stderr.isatty():
                    tqdm.write(f"{url}: {error}; again in {pause:.0f} s", file=sys.stderr)
                time.sleep(pause)

    def _attempt(self, url: str, start: int, stop: int | None) -> Iterator[bytes]:
        """Yield a range; without `stop` all the rest, also from a server that sends everything."""
        with closing(self._get(url, f"bytes={start}-{'' if stop is None else stop - 1}")) as response:
            if response.status_code == 416:
                if stop is None:
                    return  # there is no more; the reader will notice if it is not the file
                raise ChangedError(url, expected=f"at least {stop} bytes", found="fewer")
            at, size = self._extent(response, url, start, whole=stop is None)
            end = size if stop is None else stop
            for block in self._body(response):
                yield block[max(0, start - at) : None if end is None else max(0, end - at)]
                at += len(block)
                if end is None and at > _UNSTATED:
                    raise InputFileError(url, expected=f"at most {_UNSTATED} bytes", found="more")
                if stop is not None and at >= stop:
                    return  # what the server sends beyond the request is not read
        if end is not None and at < end:
            raise _TransientError(f"the connection ended {end - at} bytes early")

    def _extent(
        self, response: requests.Response, url: str, start: int, *, whole: bool
    ) -> tuple[int, int | None]:
        """Return where the body begins, and the size of the file if the server states it."""
        headers = response.headers
        etag = headers.get("ETag", "")
        version = etag if etag.startswith('"') else headers.get("Last-Modified", "")
        asked = self._versions.setdefault(url, version)
        if response.status_code != 206:  # ranges are ignored, or If-Range is honoured for a changed file
            if asked != version:
                raise ChangedError(url, expected=f"version {asked} as before", found=version or "another")
            total = headers.get("Content-Length", "")
            size = int(total) if re.fullmatch(_NUMBER, total) else None
            if not whole:
                raise RangesIgnoredError(url, size)
            return 0, size
        text = headers.get("Content-Range", "")
        match = re.fullmatch(rf"bytes ({_NUMBER})-{_NUMBER}/({_NUMBER})", text.strip())
        if not match:
            found = f"{text!r:.80}"
            raise InputFileError(f"{url}: Content-Range", expected="bytes FIRST-LAST/SIZE", found=found)
        first, size = int(match[1]), int(match[2])
        known = self.sizes.setdefault(url, size)
        if known != size:
            raise ChangedError(url, expected=f"{known} bytes as before", found=f"{size}")
        if first != start:
            raise _TransientError(f"a range from byte {first} instead of {start}")
        return first, size

    def _get(self, url: str, range_: str) -> requests.Response:
        try:
            response = self._answer(url, range_)
        except requests.TooManyRedirects:
            raise InputFileError(f"{url}: redirected more than {_REDIRECTS} times") from None
        except ValueError as error:  # not an address
            raise InputFileError(f"{url}: {error}") from None
        except OSError as error:  # also those of requests
            if "certificate" in str(error).lower():
                raise InputFileError(f"{url}: the server's certificate is not trusted") from None
            raise _TransientError(_reason(error)) from None
        self._traffic.requests += len(response.history)
        code, status = response.status_code, f"{response.status_code} {response.reason}"
        if code >= 400 and code != 416:
            response.close()
            if code in _TRANSIENT:
                pause = response.headers.get("Retry-After", "")
                raise _TransientError(status, float(pause) if re.fullmatch(_NUMBER, pause) else 0.0)
            kind = AbsentError if code in _ABSENT else InputFileError
            raise kind(f"{url}: the server answered {status}")
        return response

    def _answer(self, url: str, range_: str) -> requests.Response:
        """Wait one time-out for the headers, redirects included: a socket's starts again with every byte."""
        answers: queue.SimpleQueue[requests.Response | Exception] = queue.SimpleQueue()
        version, timeout = self._versions.get(url), self._options.timeout
        headers = {"Range": range_} | ({"If-Range": version} if version else {})

        def ask() -> None:
            try:
                answers.put(self._session.get(url, headers=headers, stream=True, timeout=timeout))
            except Exception as error:  # raised again where the answer is waited for
                answers.put(error)

        self._traffic.requests += 1
        threading.Thread(target=ask, daemon=True).start()
        try:
            answer = answers.get(timeout=timeout)
        except queue.Empty:
            raise _TransientError("headers timed out") from None
        if isinstance(answer, Exception):
            raise answer
        return answer

    def _body(self, response: requests.Response) -> Iterator[bytes]:
        """Yield what arrives as it arrives; give up on a trickle that the socket's timeout cannot see."""
        since, arrived, window = time.monotonic(), 0, self._options.timeout
        while True:
            try:
                block: bytes = response.raw.read1(_BLOCK, decode_content=False)
            except (HTTPError, OSError) as error:
                raise _TransientError(_reason(error)) from None
            if not block:
                return
            self._traffic.bytes += len(block)
            arrived += len(block)
            yield block
            if (now := time.monotonic()) - since > window:
                if arrived < self._options.slowest * (now - since):
                    raise _TransientError(f"{arrived / (now - since):.0f} bytes per second")
                since, arrived = now, 0


def _close_redirect(response: requests.Response, **_: object) -> None:
    """Close a redirect before requests reads its body, of any length."""
    if response.is_redirect:
        response.close()


def _reason(error: BaseException) -> str:
    text = str(error).lower()
    words = next((words for words in ("timed out", "refused", "reset", "closed") if words in text), "")
    return f"connection {words} ({type(error).__name__})" if words else type(error).__name__
