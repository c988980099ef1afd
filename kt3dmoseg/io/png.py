"""PNG files chunk by chunk, checked before they are decoded.

libpng tells of damage on standard error and of many a fault nowhere else; what passes here it decodes
in silence.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from kt3dmoseg.errors import FileFormatError

Chunk: TypeAlias = tuple[bytes, bytes]

SIGNATURE = b"\x89PNG\r\n\x1a\n"
GRAY, PALETTE = 0, 3
_CHANNELS = {GRAY: 1, 2: 3, PALETTE: 1, 4: 2, 6: 4}
_DEPTHS = {GRAY: (1, 2, 4, 8, 16), 2: (8, 16), PALETTE: (1, 2, 4, 8), 4: (8, 16), 6: (8, 16)}
MAX_PIXELS = 1 << 26
_DEFLATE_RATIO = 1032  # the most that deflate packs
_BLOCK = 1 << 20
_LAST_FILTER = 4
# First column and row, and steps, of the passes of Adam7 (PNG specification, 8.2).
_WHOLE = ((0, 0, 1, 1),)
_ADAM7 = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))


@dataclass(frozen=True)
class Header:
    """The fields of IHDR."""

    width: int
    height: int
    bits: int
    colour: int
    interlaced: bool

    def rows(self) -> list[tuple[int, int]]:
        """Give the number of rows of each pass, and the bytes of a row with its filter byte."""
        depth = self.bits * _CHANNELS[self.colour]
        passes = []
        for left, top, across, down in _ADAM7 if self.interlaced else _WHOLE:
            columns, lines = -(-(self.width - left) // across), -(-(self.height - top) // down)
            if columns > 0 and lines > 0:
                passes.append((lines, 1 + (columns * depth + 7) // 8))
        return passes


def is_png(content: bytes) -> bool:
    """Whether a file says that it is a PNG."""
    return content.startswith(SIGNATURE)


def read_header(content: bytes, where: str) -> Header:
    """Read the header.

    Raises
    ------
    FileFormatError
        When it makes no sense, or promises more pixels than the file's bytes can unpack to.
    """
    if len(content) < 33 or content[12:16] != b"IHDR":
        raise _damage(where, f"{len(content)} bytes without a header")
    width, height, bits, colour, packing, filters, interlace = struct.unpack(">IIBBBBB", content[16:29])
    known = bits in _DEPTHS.get(colour, ()) and packing == filters == 0 and interlace in (0, 1)
    if not (width and height and known):
        raise _damage(where, f"a header of {width}x{height}, {bits} bits, colour type {colour}")
    header = Header(width, height, bits, colour, bool(interlace))
    if width * height > MAX_PIXELS or _raw_size(header) > _DEFLATE_RATIO * len(content):
        most = min(MAX_PIXELS, _DEFLATE_RATIO * len(content))
        raise FileFormatError(
            where,
            expected=f"a picture of at most {most} pixels in {len(content)} bytes",
            found=f"{width}x{height}",
            fix="the file is damaged; fetch it again",
        )
    return header


def sound(content: bytes, where: str) -> bytes:
    """Return a PNG with nothing but header, palette and pixels, each checked.

    Raises
    ------
    FileFormatError
        When it is cut short, a checksum differs, or the pixels are not as many as the header says.
    """
    header = read_header(content, where)
    chunks = list(_critical(content, where))
    if header.colour == PALETTE and all(kind != b"PLTE" for kind, _ in chunks):
        raise _damage(where, "no palette")
    _check_pixels(header, b"".join(data for kind, data in chunks if kind == b"IDAT"), where)
    return join(chunks)


def as_gray(content: bytes, where: str) -> bytes:
    """Return a palette PNG with its indices as gray levels: the pixel data of both are alike."""
    chunks = [(kind, data) for kind, data in _critical(content, where) if kind != b"PLTE"]
    head = chunks[0][1]
    return join([(b"IHDR", head[:9] + bytes([GRAY]) + head[10:]), *chunks[1:]])


def _critical(content: bytes, where: str) -> Iterator[Chunk]:
    """Chunks that pixels depend on, checksums verified."""
    at = len(SIGNATURE)
    while at + 12 <= len(content):
        size, kind = struct.unpack(">I4s", content[at : at + 8])
        data, check = content[at + 8 : at + 8 + size], content[at + 8 + size : at + 12 + size]
        if len(check) < 4:
            break
        if struct.unpack(">I", check)[0] != zlib.crc32(kind + data):
            raise _damage(where, f"a wrong checksum at byte {at}")
        if kind in (b"IHDR", b"PLTE", b"IDAT", b"IEND"):
            yield kind, data
        if kind == b"IEND":
            return
        at += 12 + size
    raise _damage(where, f"a file cut short at {len(content)} bytes")


def _check_pixels(header: Header, packed: bytes, where: str) -> None:
    """Unpack block by block, keeping nothing: the right number of bytes, the right filter types."""
    passes, wanted = header.rows(), _raw_size(header)
    stride = wanted if header.interlaced else passes[0][1]
    unpack, done = zlib.decompressobj(), 0
    try:
        while done <= wanted and (block := unpack.decompress(packed, _BLOCK)):
            if max(block[-done % stride :: stride], default=0) > _LAST_FILTER:
                raise _damage(where, "a row with an unknown filter")
            packed, done = unpack.unconsumed_tail, done + len(block)
    except zlib.error:
        raise _damage(where, "pixels that do not unpack") from None
    if done != wanted or not unpack.eof:
        raise _damage(where, f"{done} of {wanted} bytes of pixels")


def _raw_size(header: Header) -> int:
    return sum(lines * size for lines, size in header.rows())


def join(chunks: Sequence[Chunk]) -> bytes:
    """Put a PNG together from its chunks."""
    parts = [SIGNATURE]
    for kind, data in chunks:
        parts += [struct.pack(">I", len(data)), kind, data, struct.pack(">I", zlib.crc32(kind + data))]
    return b"".join(parts)


def _damage(where: str, found: str) -> FileFormatError:
    return FileFormatError(
        where, expected="a sound PNG", found=found, fix="the file is damaged; fetch it again"
    )
