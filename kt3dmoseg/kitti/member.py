"""Members of a zip archive: which of them to ask for together, and unpacking one from its raw bytes.

What the directory says of a member is a claim; here its bytes have to bear it out.
"""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from kt3dmoseg.errors import FileFormatError

LARGEST_MEMBER = 64 << 20
LOCAL = struct.Struct("<4s5H3L2H")

_LONGEST_GAP = 4096  # a smaller hole between two members is read over rather than asked around
_LONGEST_RUN = 2 << 20  # what is under way is lost when a pull is killed
_DESCRIBED = 0x8


class DamagedError(FileFormatError):
    """Bytes do not match their checksum or their directory; reading them again may help."""


@dataclass(frozen=True)
class Member:
    """A file in an archive, as the directory describes it; `offset` to `end` holds all of its bytes."""

    name: str
    size: int
    stored: int
    crc32: int
    method: int
    encrypted: bool
    offset: int
    end: int


def runs(members: Iterable[Member]) -> Iterator[list[Member]]:
    """Group members that lie side by side, to be asked for in one request of at most 2 MiB."""
    run: list[Member] = []
    for member in sorted(members, key=lambda member: member.offset):
        near = run and member.offset - run[-1].end <= _LONGEST_GAP
        if run and not (near and member.end - run[0].offset <= _LONGEST_RUN):
            yield run
            run = []
        run.append(member)
    if run:
        yield run


def acceptable(member: Member, where: str) -> Member:
    """Return the member when it can and may be unpacked; raise FileFormatError otherwise."""
    fault = ""
    if member.size > LARGEST_MEMBER:
        fault = f"unpacks to {member.size} bytes, more than {LARGEST_MEMBER}"
    elif member.encrypted:
        fault = "is encrypted"
    elif member.method not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        fault = f"is packed by method {member.method}"
    if fault:
        raise FileFormatError(f"{where}: refused: member {member.name!r:.200} {fault}")
    return member


def unpack(member: Member, raw: bytes, where: str) -> bytes:
    """Unpack a member from its local header and data, never to more than its claimed size.

    Raises
    ------
    DamagedError
        When name, method, size or CRC32 are not what the directory says.
    """
    where = f"{where}: {member.name}"
    if len(raw) < LOCAL.size or raw[:4] != b"PK\x03\x04":
        raise DamagedError(where, expected="a member", found="something else")
    fields = LOCAL.unpack_from(raw)
    flags, method, crc, name_length, extra_length = fields[2], fields[3], fields[6], fields[9], fields[10]
    begin = LOCAL.size + name_length + extra_length
    name = raw[LOCAL.size : LOCAL.size + name_length]
    if method != member.method or name not in (member.name.encode(), member.name.encode("cp437", "replace")):
        raise DamagedError(where, expected="what the directory says", found="another member")
    if not flags & _DESCRIBED and crc != member.crc32:
        raise DamagedError(where, expected=f"CRC {member.crc32:08x}", found=f"{crc:08x} in its own header")
    data = raw[begin : begin + member.stored]
    content = data if member.method == zipfile.ZIP_STORED else _inflate(data, member.size, where)
    if len(content) != member.size or zlib.crc32(content) != member.crc32:
        raise DamagedError(
            where,
            expected=f"{member.size} bytes with CRC {member.crc32:08x}",
            found=f"{len(content)} with {zlib.crc32(content):08x}",
        )
    return content


def _inflate(data: bytes, size: int, where: str) -> bytes:
    try:
        return zlib.decompressobj(-zlib.MAX_WBITS).decompress(data, size + 1)
    except zlib.error as error:
        raise DamagedError(where, expected="deflated data", found=str(error)) from None
