"""JPEG files segment by segment (ITU-T T.81, annex B), checked before and while they are decoded.

Some decoders fill what is missing at the end of a file with gray and say nothing. Of damage within,
libjpeg tells only the terminal: OpenCV has no other way to ask it.
"""

from __future__ import annotations

import os
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from kt3dmoseg.errors import FileFormatError
from kt3dmoseg.io.png import MAX_PIXELS

_START = b"\xff\xd8"
# A marker before a segment, or the end; not the stuffed zeros and restarts within pixel data.
_MARKER = re.compile(rb"\xff[^\x00\x01\xd0-\xd7\xff]")
_END = 0xD9
_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
_STANDARD_ERROR, _PIPE = 2, 1 << 16
# libjpeg's warnings (jerror.h): those of damage, and those that files without any may give.
_DAMAGE = re.compile(
    rb"^(Corrupt JPEG data: (?!bad ICC)|Premature end of JPEG file|Inconsistent progression).*\n",
    re.MULTILINE,
)
_HARMLESS = re.compile(
    rb"^(Corrupt JPEG data: bad ICC|Invalid SOS|Unknown Adobe|Warning: ).*\n", re.MULTILINE
)
_alone = threading.Lock()  # there is one standard error for all threads


def check(content: bytes, where: str) -> None:
    """Refuse a JPEG that is cut short, or that claims to be huge; pass over all other files.

    The end is that of the picture: neither that of a preview within the metadata, whose segment is
    skipped, nor the last bytes of the file, since cameras append to it. Damage within the pixel data
    is for `watched`.

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


@contextmanager
def watched(content: bytes, where: str) -> Iterator[None]:
    """Refuse a JPEG of which libjpeg says that its data are corrupt, when the block decodes it.

    That it says nothing proves little: a JPEG carries no checksum, and many a wrong byte is a valid code.

    Parameters
    ----------
    content : bytes
        The file; one that is no JPEG is passed over.
    where : str
        Its name, for messages.

    Raises
    ------
    FileFormatError
        When libjpeg found damage.
    """
    if not content.startswith(_START):
        yield
        return
    said = bytearray()
    with _alone, _overheard(said):
        yield
    damage = _DAMAGE.search(said)
    if others := _HARMLESS.sub(b"", _DAMAGE.sub(b"", said)):  # another thread's
        os.write(_STANDARD_ERROR, others)
    if damage:
        raise FileFormatError(
            where,
            expected="a sound JPEG",
            found=damage[0].decode("latin-1").strip(),
            fix="fetch the file again; if it is as its camera wrote it, save it as PNG",
        )


@contextmanager
def _overheard(said: bytearray) -> Iterator[None]:
    """Collect what is written to the process's standard error, up to what a pipe holds."""
    try:
        kept = os.dup(_STANDARD_ERROR)
    except OSError:  # it is closed: nothing can be heard
        yield
        return
    heard, told = os.pipe()
    for end in (heard, told):
        os.set_blocking(end, False)  # neither side waits: what does not fit is lost
    try:
        os.dup2(told, _STANDARD_ERROR)
        try:
            yield
        finally:
            os.dup2(kept, _STANDARD_ERROR)
            with suppress(BlockingIOError):
                said += os.read(heard, _PIPE)
    finally:
        for end in (heard, told, kept):
            os.close(end)


def _check_size(field: bytes, where: str) -> None:
    """Judge height and width of a frame header (B.2.2): a few bytes can claim a huge picture."""
    height, width = int.from_bytes(field[:2], "big"), int.from_bytes(field[2:], "big")
    if height * width > MAX_PIXELS:
        raise FileFormatError(where, expected=f"at most {MAX_PIXELS} pixels", found=f"{width}x{height}")
