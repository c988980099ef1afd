"""Zip archives read through ranges: the directory first, then only the wanted members.

The standard library parses the directory (zip64 and comments included); what it says is then held to be
a claim. An archive is refused as a whole for names that leave it, symbolic links, duplicates and members
that overlap; a member is refused when its bytes do not bear out its claim.
"""

from __future__ import annotations

import io
import re
import stat
import struct
import zipfile
from collections.abc import Iterable, Iterator, Mapping

from kt3dmoseg.errors import FileFormatError, KT3DMoSegError
from kt3dmoseg.kitti.member import LOCAL, DamagedError, Member, acceptable, runs, unpack
from kt3dmoseg.kitti.source import FileSource, Source

LARGEST_DIRECTORY = 8 << 20

# The end record (22) with its longest comment, and zip64's locator (20) and record (56).
_TAIL = (1 << 16) + 22 + 20 + 56
_DESCRIPTOR = 24
_LONGEST_EXTRA = (1 << 16) - 1
_DEFLATE_LIMIT = 1100  # deflate cannot reach more than 1032 : 1
_ATTEMPTS = 3
_ENCRYPTED = 0x1


class Archive:
    """A zip archive behind a `Source`.

    Parameters
    ----------
    source : Source
        Where its bytes are.
    tail : bytes, optional
        The last bytes of the archive, from an earlier `tail`; the directory is then not read again.

    Raises
    ------
    FileFormatError
        When it is not a zip archive, is damaged or truncated, or is hostile.
    """

    def __init__(self, source: Source, tail: bytes | None = None) -> None:
        self.source = source
        self.tail, self.members = self._open() if tail is None else _parse_tail(source, tail)
        self._held = source.size - len(self.tail)

    def __repr__(self) -> str:
        """Name the source."""
        return f"Archive({self.source.name!r})"

    @property
    def name(self) -> str:
        """Address or path of the archive."""
        return self.source.name

    @property
    def local(self) -> bool:
        """Whether it is on this machine."""
        return isinstance(self.source, FileSource)

    def size(self, name: str) -> int:
        """Size of a member in bytes."""
        return self.members[name].size

    def crc32(self, name: str) -> int:
        """CRC32 of a member, as the directory claims it; `read` verifies it."""
        return self.members[name].crc32

    def names(self) -> Iterable[str]:
        """Names of all members."""
        return self.members.keys()

    def cost(self, names: Iterable[str]) -> int:
        """Bytes that `read` asks the source for."""
        wanted = runs(self.members[name] for name in names)
        return sum(run[-1].end - run[0].offset for run in wanted if run[0].offset < self._held)

    def read(self, names: Iterable[str]) -> Iterator[tuple[str, bytes]]:
        """Yield the wanted members' names and contents, verified by size and CRC32.

        Neighbours come in one request, each is yielded as soon as its bytes are here. A damaged member is
        asked for again, up to three times in all.

        Raises
        ------
        DamagedError
            When a member stays damaged.
        FileFormatError
            When a member is encrypted, packed by an unusual method or larger than 64 MiB.
        """
        wanted = [acceptable(self.members[name], self.source.name) for name in names]
        for attempt in range(1, _ATTEMPTS + 1):
            damaged = []
            for member, raw in self._raw(wanted):
                try:
                    content = unpack(member, raw, self.source.name)
                except DamagedError:
                    if attempt == _ATTEMPTS:
                        raise
                    damaged.append(member)
                    continue
                yield member.name, content
            wanted = damaged

    def _raw(self, members: Iterable[Member]) -> Iterator[tuple[Member, bytes]]:
        for run in runs(members):
            start = run[0].offset
            buffer, at = bytearray(), start
            chunks = self._chunks(start, run[-1].end - start)
            for member in run:
                while at + len(buffer) < member.end:
                    buffer += next(chunks)
                yield member, bytes(buffer[member.offset - at : member.end - at])
                del buffer[: member.end - at]
                at = member.end
            for _ in chunks:  # sees its end, so that the connection can serve the next run
                pass

    def _chunks(self, start: int, length: int) -> Iterator[bytes]:
        """Read from the end that is held already, or from the source."""
        if start >= self._held:
            return iter([self.tail[start - self._held :][:length]])
        return self.source.chunks(start, length)

    def _open(self) -> tuple[bytes, Mapping[str, Member]]:
        for attempt in range(1, _ATTEMPTS + 1):
            try:
                return _parse_tail(self.source, b"")
            except FileFormatError:
                if attempt == _ATTEMPTS:
                    raise
        raise AssertionError("unreachable")


class _Tail(io.RawIOBase):
    """The archive as a seekable file of which only the end is held; grows backwards when read."""

    def __init__(self, source: Source, data: bytes) -> None:
        self._source, self._size, self._at = source, source.size, 0
        self.start = self._size - len(data)
        self.data = data
        if not data:
            self._reach(max(0, self._size - _TAIL))

    def seekable(self) -> bool:
        return True

    def readable(self) -> bool:
        return True

    def tell(self) -> int:
        return self._at

    def seek(self, offset: int, whence: int = 0) -> int:
        self._at = offset + {0: 0, 1: self._at, 2: self._size}[whence]
        if self._at < 0:
            raise OSError("a position before the archive's start")
        return self._at

    def read(self, size: int | None = -1) -> bytes:
        end = self._size if size is None or size < 0 else min(self._size, self._at + size)
        self._reach(self._at)
        block = self.data[self._at - self.start : max(self._at, end) - self.start]
        self._at += len(block)
        return block

    def _reach(self, start: int) -> None:
        if self._size - start > LARGEST_DIRECTORY:
            raise FileFormatError(
                self._source.name,
                expected=f"a directory of at most {LARGEST_DIRECTORY} bytes",
                found=f"one that begins {self._size - start} bytes before the end",
            )
        if start < self.start:
            self.data = b"".join(self._source.chunks(start, self.start - start)) + self.data
            self.start = start


def _parse_tail(source: Source, data: bytes) -> tuple[bytes, Mapping[str, Member]]:
    tail = _Tail(source, data)
    try:
        with zipfile.ZipFile(tail) as archive:
            infos, directory = archive.infolist(), archive.start_dir
    except KT3DMoSegError:
        raise
    except (
        zipfile.BadZipFile,
        OSError,
        ValueError,
        NotImplementedError,
        struct.error,
        OverflowError,
    ) as error:
        raise FileFormatError(
            source.name, expected="a complete zip archive", found=str(error) or type(error).__name__
        ) from None
    members = _members(infos, directory, source.name)
    return tail.data, members


def _members(infos: list[zipfile.ZipInfo], directory: int, where: str) -> dict[str, Member]:
    members: dict[str, Member] = {}
    infos = sorted(infos, key=lambda info: info.header_offset)
    following = [info.header_offset for info in infos[1:]] + [directory]
    for info, end in zip(infos, following, strict=True):
        name = info.orig_filename
        fault = _fault(info) or ("is there twice" if name in members else "")
        room = end - info.header_offset - LOCAL.size - len(name)
        if not fault and (info.header_offset < 0 or info.compress_size > room):
            fault = "overlaps its neighbour"
        if fault:
            raise FileFormatError(f"{where}: refused: member {name!r:.200} {fault}")
        reach = info.header_offset + LOCAL.size + 4 * len(name) + _LONGEST_EXTRA
        members[name] = Member(
            name=name,
            size=info.file_size,
            stored=info.compress_size,
            crc32=info.CRC,
            method=info.compress_type,
            encrypted=bool(info.flag_bits & _ENCRYPTED),
            offset=info.header_offset,
            end=min(end, reach + info.compress_size + _DESCRIPTOR),
        )
    return members


def _fault(info: zipfile.ZipInfo) -> str:
    name = info.orig_filename
    parts = name.split("/")
    if not name or name.startswith("/") or re.search(r"[\\:\0]", name):
        return "has an absolute name"
    if ".." in parts or "." in parts:
        return "leaves the archive's folder"
    if info.external_attr and stat.S_ISLNK(info.external_attr >> 16):
        return "is a symbolic link"
    if info.file_size > info.compress_size * _DEFLATE_LIMIT + 1024:
        return f"claims to unpack {info.compress_size} bytes to {info.file_size}"
    if info.compress_type == zipfile.ZIP_STORED and info.file_size != info.compress_size:
        return "is stored with two sizes"
    return ""
