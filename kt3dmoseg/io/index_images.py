"""PNG images whose pixels are numbers: indices into a palette, or gray levels of 8 or 16 bits."""

from __future__ import annotations

import struct
import zlib

import numpy as np

from kt3dmoseg.errors import FileFormatError
from kt3dmoseg.io.images import decode
from kt3dmoseg.types import ByteArray, IntArray

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_HEADER_END = 33
_PALETTE, _GRAY = 3, 0


def decode_indices(content: bytes, where: str) -> tuple[IntArray, int]:
    """Decode a PNG to its numbers, whatever colours its palette gives them.

    Parameters
    ----------
    content : bytes
        The file.
    where : str
        Its name, for messages.

    Returns
    -------
    indices : (H, W) int64
        The numbers.
    bits : int
        Bits per pixel in the file: 1, 2, 4, 8 or 16.

    Raises
    ------
    FileFormatError
        When it is no PNG of one channel, or damaged.
    """
    if content[:8] != _SIGNATURE or len(content) < _HEADER_END:
        raise FileFormatError(where, expected="an indexed or gray PNG", found="another file")
    bits, colour = content[24], content[25]
    picture = decode(_as_gray(content, where) if colour == _PALETTE else content, where)
    if picture.ndim != 2:
        raise FileFormatError(
            where,
            expected="one channel of numbers",
            found=f"{picture.shape[2]} channels",
            fix="write it as indexed PNG, not as colours",
        )
    # OpenCV stretches gray of 1, 2 and 4 bits to 0..255.
    stretch = 255 // ((1 << bits) - 1) if bits < 8 else 1
    return picture.astype(np.int64) // stretch, bits


def encode_indices(indices: ByteArray, palette: ByteArray) -> bytes:
    """Encode indices as a PNG with a palette (PNG specification, 2003), which OpenCV cannot.

    Parameters
    ----------
    indices : (H, W) uint8
        The numbers.
    palette : (256, 3) uint8
        Red, green and blue of each number.
    """
    height, width = indices.shape
    header = struct.pack(">IIBBBBB", width, height, 8, _PALETTE, 0, 0, 0)
    rows = np.pad(indices, ((0, 0), (1, 0)))  # each row starts with its filter: none
    chunks = [
        (b"IHDR", header),
        (b"PLTE", palette.tobytes()),
        (b"IDAT", zlib.compress(rows.tobytes(), 6)),
        (b"IEND", b""),
    ]
    return _SIGNATURE + b"".join(_chunk(kind, data) for kind, data in chunks)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def _as_gray(content: bytes, where: str) -> bytes:
    """Return the same PNG with its indices as gray levels: the pixel data of both are alike."""
    out, at = [_SIGNATURE], len(_SIGNATURE)
    while at + 12 <= len(content):
        size, kind = struct.unpack(">I4s", content[at : at + 8])
        data = content[at + 8 : at + 8 + size]
        if kind == b"IHDR":
            data = data[:9] + bytes([_GRAY]) + data[10:]
        if kind not in (b"PLTE", b"tRNS"):
            out.append(_chunk(kind, data))
        at += 12 + size
    if at != len(content):
        raise FileFormatError(where, expected="a sound PNG", found="damage", fix="fetch it again")
    return b"".join(out)
