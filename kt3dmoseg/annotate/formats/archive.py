"""Zip files with one entry per frame, written byte for byte the same every time, read with care."""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Mapping

from kt3dmoseg.annotate.formats.masks import check_frame
from kt3dmoseg.annotate.model import Annotation
from kt3dmoseg.errors import FileFormatError

_LARGEST_ENTRY = 64 << 20
_LARGEST_TOTAL = 512 << 20
_NUMBER = re.compile(r"(\d{1,9})\D*$")


def pack(entries: Mapping[str, bytes]) -> bytes:
    """Return a zip file with these entries."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in entries.items():
            info = zipfile.ZipInfo(name, date_time=(1980, 1, 1, 0, 0, 0))
            info.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(info, content)
    return out.getvalue()


def unpack(content: bytes, suffix: str, like: Annotation, what: str) -> dict[int, bytes]:
    """Return the entries of a zip file by frame number, without writing anything anywhere.

    Parameters
    ----------
    content : bytes
        The zip file.
    suffix : str
        Which entries count.
    like : Annotation
        The clip, which must have the frames.
    what : str
        Name of the format, for messages.

    Raises
    ------
    FileFormatError
        When it is no zip file, an entry is too large, or a frame is given twice or unknown.
    """
    out: dict[int, bytes] = {}
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            infos = [i for i in archive.infolist() if i.filename.lower().endswith(suffix)]
            _check_sizes(infos, what)
            for info in infos:
                frame = _frame(info.filename, what)
                check_frame(frame, like, what)
                if frame in out:
                    raise FileFormatError(what, expected="one file per frame", found=f"frame {frame} twice")
                out[frame] = archive.read(info)
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError) as error:
        raise FileFormatError(what, expected="a zip file", found=str(error)[:100]) from error
    if not out:
        raise FileFormatError(what, expected=f"*{suffix} files, one per frame", found="none")
    return out


def _check_sizes(infos: list[zipfile.ZipInfo], what: str) -> None:
    largest = max((info.file_size for info in infos), default=0)
    total = sum(info.file_size for info in infos)
    if largest > _LARGEST_ENTRY or total > _LARGEST_TOTAL:
        raise FileFormatError(
            what, expected=f"entries of at most {_LARGEST_ENTRY} bytes", found=f"{largest}, {total} in all"
        )


def _frame(name: str, what: str) -> int:
    found = _NUMBER.search(name.rpartition("/")[2].rpartition(".")[0])
    if not found:
        raise FileFormatError(what, expected="names with the frame's number, 00000.png", found=name[:80])
    return int(found.group(1))
