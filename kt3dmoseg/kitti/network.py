"""How patient to be with a network, what went over it, and what can go wrong with it."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from tqdm import tqdm

from kt3dmoseg.errors import InputFileError
from kt3dmoseg.kitti.options import Network

_LONGEST_WAIT = 30.0
_PROGRESS = 1 << 14  # an attempt that brings this much is not counted against the server
_KEPT = "what was fetched is kept; run it again later"


class AbsentError(InputFileError):
    """The server says that there is no such file."""


class RangesIgnoredError(InputFileError):
    """The server sends whole files only; `size` is the file's size when the server told it."""

    def __init__(self, url: str, size: int | None) -> None:
        super().__init__(f"{url}: the server ignores ranges")
        self.url, self.size = url, size


class ChangedError(InputFileError):
    """The file on the server is not the one that was read before."""


@dataclass
class Traffic:
    """What went over the network, and whom to tell."""

    requests: int = 0
    bytes: int = 0
    listeners: list[Callable[[int], object]] = field(default_factory=list)

    def received(self, count: int) -> None:
        """Count bytes of a body and tell the listeners."""
        self.bytes += count
        for listener in self.listeners:
            listener(count)


class TransientError(Exception):
    """Worth repeating; `pause` seconds if the server asked for them."""

    def __init__(self, reason: str, pause: float = 0.0) -> None:
        super().__init__(reason)
        self.pause = pause


class Patience:
    """Counts failures in a row of one request, waits between them, and ends it."""

    def __init__(self, url: str, network: Network) -> None:
        self._url, self._network, self._failures = url, network, 0

    def failed(self, error: TransientError, progress: int) -> None:
        """Wait before the next attempt, longer each time; raise InputFileError after too many."""
        if progress >= _PROGRESS:
            self._failures = 0
        self._failures += 1
        if self._failures > self._network.retries:
            what = f"gave up after {self._failures} attempts, the last: {error}"
            raise InputFileError(f"{self._url}: {what}", fix=_KEPT) from None
        pause = min(max(error.pause, self._network.wait * 2 ** (self._failures - 1)), _LONGEST_WAIT)
        if self._failures > 1 and sys.stderr.isatty():
            tqdm.write(f"{self._url}: {error}; again in {pause:.0f} s", file=sys.stderr)
        time.sleep(pause)
