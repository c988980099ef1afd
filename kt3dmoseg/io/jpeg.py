"""JPEG files segment by segment (ITU-T T.81, annex B), checked before they are decoded.

Some decoders fill what is missing at the end of a file with gray and say nothing.
"""

from __future__ import annotations

import re

from kt3dmoseg.errors import FileFormatError
from kt3dmoseg.io.png import MAX_PIXELS

_START = b"\xff\xd8"
# A marker before a segment, or the end; not the stuffed zeros and restarts within pixel data.
_MARKER = re.compile(rb"\xff[^\x00\x01\xd0-\xd7\xff]")
_END = 0xD9
_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}


def check(content: bytes, where: str) -> None:
    """Refuse a JPEG that is cut short, or that claims to be huge; pass over all other files.

    The end is that of the picture: neither that of a preview within the metadata, whose segment is
    skipped, nor the last bytes of the file, since cameras append to it. Damage within the pixel data
    is not found: a JPEG carries no checksum.

    Parameters
    ----------
    content : bytes
        The file.
    where : str
        Its name, for messages.

    Raises
    ------
    FileFormatError
        When there is no end-of-image marker, or the frame header gives too many pixels.
    """
    if not content.startswith(_START):
        return
    at = len(_START)
    while found := _MARKER.search(content, at):
        marker, at = content[found.start() + 1], found.end()
        if marker == _END:
            return
        if marker in _FRAMES:
            _check_size(content[at + 3 : at + 7], where)
        at += int.from_bytes(content[at : at + 2], "big")
    raise FileFormatError(
        where,
        expected="a whole JPEG",
        found=f"a file cut short at {len(content)} bytes",
        fix="the file is damaged; fetch it again",
    )


def _check_size(field: bytes, where: str) -> None:
    """Judge height and width of a frame header (B.2.2): a few bytes can claim a huge picture."""
    height, width = int.from_bytes(field[:2], "big"), int.from_bytes(field[2:], "big")
    if height * width > MAX_PIXELS:
        raise FileFormatError(where, expected=f"at most {MAX_PIXELS} pixels", found=f"{width}x{height}")
