"""PNG images whose pixels are indices into a palette, as DAVIS keeps its masks.

OpenCV gives the colours of such an image and no index; the palette in the file turns them back.
"""

from __future__ import annotations

import struct
import zlib

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import FileFormatError
from kt3dmoseg.io.images import decode

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PALETTED = 3


def davis_palette() -> npt.NDArray[np.uint8]:
    """Return the palette of PASCAL VOC and DAVIS, (256, 3) RGB.

    The bits of the index are spread over the high bits of the channels.
    """
    palette = np.zeros((256, 3), dtype=np.uint8)
    for index in range(256):
        for bit in range(8):
            palette[index, bit % 3] |= ((index >> bit) & 1) << (7 - bit // 3)
    return palette


def encode_indexed(image: npt.NDArray[np.uint8]) -> bytes:
    """Return an (H, W) image of indices as a PNG with the DAVIS palette (PNG specification, 2003)."""
    height, width = image.shape
    rows = np.concatenate([np.zeros((height, 1), dtype=np.uint8), image], axis=1)
    header = struct.pack(">IIBBBBB", width, height, 8, _PALETTED, 0, 0, 0)
    return b"".join(
        [
            _SIGNATURE,
            _chunk(b"IHDR", header),
            _chunk(b"PLTE", davis_palette().tobytes()),
            _chunk(b"IDAT", zlib.compress(rows.tobytes(), 6)),
            _chunk(b"IEND", b""),
        ]
    )


def decode_indexed(content: bytes, where: str) -> npt.NDArray[np.int64]:
    """Return the indices of a palette PNG, or the values of a gray one, (H, W).

    Raises
    ------
    FileFormatError
        For anything else.
    """
    image = decode(content, where)
    palette = _palette(content)
    if palette is None:
        if image.ndim != 2 or image.dtype != np.uint8:
            found = f"{image.dtype} of shape {image.shape}"
            raise FileFormatError(where, expected="an indexed or 8-bit gray PNG", found=found)
        return np.asarray(image, dtype=np.int64)
    colours = np.atleast_3d(image)[..., :3].astype(np.int64)
    if colours.shape[2] == 1:
        colours = np.repeat(colours, 3, axis=2)
    code = (colours[..., 2] << 16) | (colours[..., 1] << 8) | colours[..., 0]
    index = np.full(1 << 24, -1, dtype=np.int16)
    known = palette.astype(np.int64)
    index[(known[::-1, 0] << 16) | (known[::-1, 1] << 8) | known[::-1, 2]] = np.arange(len(known))[::-1]
    out: npt.NDArray[np.int64] = index[code].astype(np.int64)
    if (out < 0).any():
        raise FileFormatError(where, expected="colours of the file's palette", found="others")
    return out


def _palette(content: bytes) -> npt.NDArray[np.uint8] | None:
    if not content.startswith(_SIGNATURE) or content[25:26] != bytes([_PALETTED]):
        return None
    at = len(_SIGNATURE)
    while at + 8 <= len(content):
        size, kind = struct.unpack(">I4s", content[at : at + 8])
        if kind == b"PLTE":
            entries = content[at + 8 : at + 8 + size]
            return np.frombuffer(entries[: len(entries) // 3 * 3], dtype=np.uint8).reshape(-1, 3)
        at += 12 + size
    return None


def _chunk(kind: bytes, content: bytes) -> bytes:
    check = zlib.crc32(kind + content)
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", check)
