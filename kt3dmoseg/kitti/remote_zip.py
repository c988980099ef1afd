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
from kt3dmoseg.kitti.raw import LARGEST_FILE

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
        self.name, self.size = name, size
        self.tail = tail or b"".join(chunks(max(0, size - _TAIL), min(size, _TAIL)))
        self._chunks, self._at = chunks, 0
        self._range: tuple[int, bytearray, Iterator[bytes]] | None = None

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
        self._at = offset + (0, self._at, self.size)[whence]
        if self._at < 0:
            raise OSError("a position before the archive's start")
        return self._at

    def read(self, size: int | None = -1) -> bytes:
        end = self.size if size is None or size < 0 else min(self.size, self._at + size)
        start, buffer, arriving = self._range or self._directory()
        while start + len(buffer) < end and (chunk := next(arriving, b"")):
            buffer += chunk
        block = bytes(buffer[self._at - start : max(self._at, end) - start])
        self._at += len(block)
        return block

    def _directory(self) -> tuple[int, bytearray, Iterator[bytes]]:
        if self.size - self._at > _LARGEST_DIRECTORY:
            found = f"one that begins {self.size - self._at} bytes before the end"
            expected = f"a directory of at most {_LARGEST_DIRECTORY} bytes"
            raise FileFormatError(self.name, expected=expected, found=found)
        if self._at < self.held:
            self.tail = b"".join(self._chunks(self._at, self.held - self._at)) + self.tail
        return self.held, bytearray(self.tail), iter(())


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
                self._zip = SafeZip(self._file, _LIMITS, name)
                self._spans = self._find_spans()
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
        return self._zip.infos[name].CRC

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
        for attempts_left in reversed(range(_ATTEMPTS)):
            damaged: list[str] = []
            yield from self._read_once(wanted, damaged, last=not attempts_left)
            wanted = damaged

    def _read_once(
        self, names: Iterable[str], damaged: list[str], *, last: bool
    ) -> Iterator[tuple[str, bytes]]:
        """Yield what is intact; list the `damaged` files, or raise DamagedError for the first."""
        for start, stop, run in self._runs(names):
            rest = self._file.request(start, stop - start)
            for name in run:
                try:
                    content = self._zip.read(name)  # zipfile checks the CRC
                except FileFormatError as error:
                    if last:
                        expected = f"{self.sizes[name]} bytes with CRC {self.crc32(name):08x}"
                        raise DamagedError(error.where, expected=expected, found=error.found) from None
                    damaged.append(name)
                    continue
                yield name, content
            for _ in rest:  # sees its end, so that the connection can serve the next run
                pass

    def _find_spans(self) -> dict[str, tuple[int, int]]:
        """Where each file begins, and where it ends at the latest."""
        infos, spans = self._zip.infos, {}
        order = sorted(infos, key=lambda name: infos[name].header_offset)
        following = [infos[name].header_offset for name in order[1:]] + [self._zip.directory_start]
        for name, end in zip(order, following, strict=True):
            start = infos[name].header_offset
            least = start + _HEADER + len(infos[name].orig_filename) + infos[name].compress_size
            if start < 0 or least > end:
                self._refuse(name, "overlaps its neighbour")
            spans[name] = start, min(end, least + 3 * len(name) + _LONGEST_REST)
        return spans

    def _refuse(self, name: str, fault: str) -> None:
        raise FileFormatError(f"{self.name}: refused: file {name!r:.200} {fault}")

    def _runs(self, names: Iterable[str]) -> Iterator[tuple[int, int, list[str]]]:
        """Group files that are neighbours, to be fetched in one request of at most 2 MiB."""
        run: list[str] = []
        start = stop = 0
        for name in sorted(names, key=self._spans.__getitem__):
            offset, end = self._spans[name]
            if run and (offset - stop > _LONGEST_GAP or end - start > _LONGEST_RUN):
                yield start, stop, run
                run = []
            start, stop = (start if run else offset), end
            run.append(name)
        if run:
            yield start, stop, run


def _read_file(path: Path, start: int, length: int) -> Iterator[bytes]:
    with open(path, "rb") as stream:
        stream.seek(start)
        while block := stream.read(min(length, 1 << 20)):
            length -= len(block)
            yield block
