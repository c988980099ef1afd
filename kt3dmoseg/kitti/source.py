"""Where bytes come from: a file on disk or on a server, behind one protocol of ranges."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from kt3dmoseg.errors import InputFileError
from kt3dmoseg.kitti.http import Client
from kt3dmoseg.kitti.member import DamagedError


class Source(Protocol):
    """Somewhere that gives ranges of bytes."""

    @property
    def name(self) -> str:
        """Address or path, for messages."""

    @property
    def size(self) -> int:
        """Length in bytes."""

    def chunks(self, start: int, length: int) -> Iterator[bytes]:
        """Yield exactly the bytes of a range, in pieces."""


@dataclass(frozen=True)
class FileSource:
    """A file on disk as a `Source`."""

    path: Path

    @property
    def name(self) -> str:
        """The path."""
        return str(self.path)

    @property
    def size(self) -> int:
        """The file's size in bytes."""
        try:
            return self.path.stat().st_size
        except OSError as error:
            raise InputFileError(f"{self.path}: {error.strerror or error}") from None

    def chunks(self, start: int, length: int) -> Iterator[bytes]:
        """Yield the range in blocks."""
        try:
            with open(self.path, "rb") as stream:
                stream.seek(start)
                while length > 0 and (block := stream.read(min(length, 1 << 20))):
                    length -= len(block)
                    yield block
        except OSError as error:
            raise InputFileError(f"{self.path}: {error.strerror or error}") from None
        if length:
            raise DamagedError(str(self.path), expected=f"{length} bytes more", found="its end")


@dataclass(frozen=True)
class HttpSource:
    """A file on a server that answers ranges, as a `Source`."""

    client: Client
    url: str
    size: int

    @property
    def name(self) -> str:
        """The address."""
        return self.url

    def chunks(self, start: int, length: int) -> Iterator[bytes]:
        """Yield the range as it arrives."""
        return self.client.chunks(self.url, start, length, self.size)
