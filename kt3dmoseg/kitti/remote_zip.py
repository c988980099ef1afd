"""Zip archives read through ranges: the directory first, then only the wanted files.

`SafeZip` parses, checks and unpacks; the bytes come from a `_RangeFile`. What a directory states is a claim:
an archive is refused for unsafe names, symbolic links, duplicates, encrypted files and files that overlap; a
file is refused when it is too large or its bytes do not bear out size and CRC32.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import TypeAlias

from kt3dmoseg.errors import FileFormatError, InputFileError
from kt3dmoseg.files import SafeZip, ZipLimits

LARGEST_FILE = 64 << 20
Chunks: TypeAlias = Callable[[int, int], Iterator[bytes]]

_LARGEST_DIRECTORY = 8 << 20
_HEADER = 30
_TAIL = (1 << 16) + 22 + 20 + 56  # the end record with its longest comment, and zip64's locator and record
_LONGEST_REST = (1 << 16) + 24  # extra fields in front of a file's data, and its descriptor behind them
# KITTI's zips hold 4 GB; one file is limited when it is read. Deflate cannot reach more than 1032 : 1.
_LIMITS = ZipLimits(
    files=1 << 20, file_bytes=1 << 40, total_bytes=1 << 50, ratio=1100, free_bytes=1024, depth=32
)
_LONGEST_GAP = 4096  # a smaller gap between two files is read too, which saves a request
_LONGEST_RUN = 2 << 20  # what is under way is lost when a pull is killed
_ATTEMPTS = 3


class DamagedError(FileFormatError):
    """Bytes do not match their checksum or their directory; reading them again may help."""


class _RangeFile(io.RawIOBase):
    """A remote file, for `zipfile`: it keeps the end, and takes the rest from the requested range.

    The end, where the directory is, grows backwards as far as it is read, until a range is requested.
    """

    def __init__(self, name: str, size: int, chunks: Chunks, tail: bytes) -> None:
        super().__init__()
        self.name, self.size, self.tail = name, size, tail
        self._chunks, self._at = chunks, 0
        self._range: tuple[int, bytearray, Iterator[bytes]] | None = None
        if not tail:
            self._reach(max(0, size - _TAIL))

    @property
    def held(self) -> int:
        return self.size - len(self.tail)

    def request(self, start: int, length: int) -> Iterator[bytes]:
        """Request a range, from which `read` takes as it arrives; return what is left of it then."""
        kept = self.tail[start - self.held :] if start >= self.held else b""
        arriving = iter([kept]) if kept else self._chunks(start, length)
        self._range = start, bytearray(), arriving
        return arriving

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = 0) -> int:
        self._at = offset + {0: 0, 1: self._at, 2: self.size}[whence]
        if self._at < 0:
            raise OSError("a position before the archive's start")
        return self._at

    def read(self, size: int | None = -1) -> bytes:
        end = self.size if size is None or size < 0 else min(self.size, self._at + size)
        if self._range is None:
            self._reach(self._at)
            block = self.tail[self._at - self.held : max(self._at, end) - self.held]
        else:
            start, buffer, arriving = self._range
            while start + len(buffer) < end and (chunk := next(arriving, b"")):
                buffer += chunk
            block = bytes(buffer[self._at - start : end - start])
        self._at += len(block)
        return block

    def _reach(self, start: int) -> None:
        if self.size - start > _LARGEST_DIRECTORY:
            found = f"one that begins {self.size - start} bytes before the end"
            expected = f"a directory of at most {_LARGEST_DIRECTORY} bytes"
            raise FileFormatError(self.name, expected=expected, found=found)
        if start < self.held:
            self.tail = b"".join(self._chunks(start, self.held - start)) + self.tail


class Archive:
    """A zip archive on a server or on disk.

    ``chunks(start, length)`` yields exactly these of its `size` bytes, in pieces. With the `tail` of an
    earlier `directory` this is not read again. FileFormatError is raised when it is not a zip archive, is
    damaged or truncated, or is hostile.
    """

    def __init__(
        self, name: str, size: int, chunks: Chunks, tail: bytes = b"", *, local: bool = False
    ) -> None:
        self.name, self.local = name, local
        self.fresh = not tail and not local  # read just now from the network; no checksum protects it
        for attempt in range(1, _ATTEMPTS + 1):
            try:
                self._file = _RangeFile(name, size, chunks, tail)
                self._open()
                break
            except FileFormatError:
                if attempt == _ATTEMPTS:
                    raise
        self.directory, self.sizes = (size, self._file.tail), self._zip.sizes

    @classmethod
    def on_disk(cls, path: Path) -> Archive:
        """Open a file."""
        try:
            return cls(str(path), path.stat().st_size, partial(_read_file, path), local=True)
        except OSError as error:
            raise InputFileError(f"{path}: {error.strerror or error}") from None

    def crc32(self, name: str) -> int:
        """CRC32 of a file, as the directory claims it; `read` verifies it."""
        return self._infos[name].CRC

    def cost(self, names: Iterable[str]) -> int:
        """Bytes that `read` requests."""
        return sum(stop - start for start, stop, _ in self._runs(names) if start < self._file.held)

    def read(self, names: Iterable[str]) -> Iterator[tuple[str, bytes]]:
        """Yield the wanted files' names and contents, verified by size and CRC32.

        Neighbours come in one request, each is yielded as soon as its bytes are here. A damaged file is
        requested again, up to three times in all, before DamagedError is raised. FileFormatError is raised
        for a file larger than 64 MiB.
        """
        wanted = list(names)
        for name in wanted:
            if self.sizes[name] > LARGEST_FILE:
                self._refuse(name, f"unpacks to {self.sizes[name]} bytes, more than {LARGEST_FILE}")
        for attempt in range(1, _ATTEMPTS + 1):
            damaged = []
            for name, content in self._read_once(wanted):
                if isinstance(content, bytes):
                    yield name, content
                elif attempt < _ATTEMPTS:
                    damaged.append(name)
                else:
                    raise content
            wanted = damaged

    def _open(self) -> None:
        self._zip = SafeZip(self._file, _LIMITS, self.name)
        self._infos, self._ends = self._zip.infos, dict[str, int]()
        infos = sorted(self._infos.items(), key=lambda item: item[1].header_offset)
        following = [info.header_offset for _, info in infos[1:]] + [self._zip.directory_start]
        for (name, info), end in zip(infos, following, strict=True):
            least = info.header_offset + _HEADER + len(info.orig_filename) + info.compress_size
            if info.header_offset < 0 or least > end:
                self._refuse(name, "overlaps its neighbour")
            self._ends[name] = min(end, least + 3 * len(name) + _LONGEST_REST)

    def _refuse(self, name: str, fault: str) -> None:
        raise FileFormatError(f"{self.name}: refused: file {name!r:.200} {fault}")

    def _runs(self, names: Iterable[str]) -> Iterator[tuple[int, int, list[str]]]:
        """Group files that are neighbours, to be fetched in one request of at most 2 MiB."""
        run: list[str] = []
        start = stop = 0
        for name in sorted(names, key=lambda name: self._infos[name].header_offset):
            offset, end = self._infos[name].header_offset, self._ends[name]
            if run and (offset - stop > _LONGEST_GAP or end - start > _LONGEST_RUN):
                yield start, stop, run
                run = []
            start, stop = (start if run else offset), end
            run.append(name)
        if run:
            yield start, stop, run

    def _read_once(self, names: Iterable[str]) -> Iterator[tuple[str, bytes | DamagedError]]:
        for start, stop, run in self._runs(names):
            rest = self._file.request(start, stop - start)
            for name in run:
                yield name, self._unpack(name)
            for _ in rest:  # sees its end, so that the connection can serve the next run
                pass

    def _unpack(self, name: str) -> bytes | DamagedError:
        try:
            return self._zip.read(name)  # zipfile checks the CRC
        except FileFormatError as error:
            expected = f"{self.sizes[name]} bytes with CRC {self.crc32(name):08x}"
            return DamagedError(f"{self.name}: {name}", expected=expected, found=error.found)


def _read_file(path: Path, start: int, length: int) -> Iterator[bytes]:
    with open(path, "rb") as stream:
        stream.seek(start)
        while length > 0 and (block := stream.read(min(length, 1 << 20))):
            length -= len(block)
            yield block
    if length:
        raise DamagedError(str(path), expected=f"{length} bytes more", found="its end")
