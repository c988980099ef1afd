"""PNG images whose pixels are numbers: indices into a palette, or gray levels of 8 or 16 bits."""

from __future__ import annotations

import struct
import zlib

import numpy as np

from kt3dmoseg.errors import FileFormatError
from kt3dmoseg.io import png
from kt3dmoseg.io.images import decode
from kt3dmoseg.types import ByteArray, IntArray


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
    if not png.is_png(content):
        raise FileFormatError(where, expected="an indexed or gray PNG", found="another file")
    header = png.read_header(content, where)
    picture = decode(png.as_gray(content, where) if header.colour == png.PALETTE else content, where)
    if picture.ndim != 2:
        raise FileFormatError(
            where,
            expected="one channel of numbers",
            found=f"{picture.shape[2]} channels",
            fix="write it as indexed PNG, not as colours",
        )
    # OpenCV stretches gray of 1, 2 and 4 bits to 0..255.
    stretch = 255 // ((1 << header.bits) - 1) if header.bits < 8 else 1
    return picture.astype(np.int64) // stretch, header.bits


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
    header = struct.pack(">IIBBBBB", width, height, 8, png.PALETTE, 0, 0, 0)
    rows = np.pad(indices, ((0, 0), (1, 0)))  # each row starts with its filter: none
    chunks = [
        (b"IHDR", header),
        (b"PLTE", palette.tobytes()),
        (b"IDAT", zlib.compress(rows.tobytes(), 6)),
        (b"IEND", b""),
    ]
    return png.join(chunks)
