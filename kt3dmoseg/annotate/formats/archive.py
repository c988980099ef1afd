"""Zip files with one entry per frame, read with care."""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import PurePosixPath

from kt3dmoseg.annotate.formats.masks import check_frame
from kt3dmoseg.annotate.model import Annotation
from kt3dmoseg.errors import FileFormatError

_LARGEST_ENTRY = 32 << 20
_LARGEST_TOTAL = 128 << 20
_NUMBER = re.compile(r"(\d{1,9})\D*$")


def unpack(
    content: bytes, suffix: str, like: Annotation, names: Sequence[str], what: str
) -> dict[int, bytes]:
    """Return the entries of a zip file by frame, without writing anything anywhere.

    Parameters
    ----------
    content : bytes
        The zip file.
    suffix : str
        Which entries count.
    like : Annotation
        The clip, which must have the frames.
    names : sequence of str
        File names of the clip's frames; see `frame_indices`.
    what : str
        Name of the format, for messages.

    Raises
    ------
    FileFormatError
        When it is no zip file, an entry is too large, or a frame is given twice or unknown.
    """
    out: dict[int, bytes] = {}
    with _opened(content, what) as archive:
        infos = _entries(archive, suffix, what)
        frames = frame_indices([info.filename for info in infos], names, what)
        for info, frame in zip(infos, frames, strict=True):
            check_frame(frame, like, what)
            if frame in out:
                raise FileFormatError(what, expected="one file per frame", found=f"frame {frame} twice")
            out[frame] = archive.read(info)
    if not out:
        raise FileFormatError(what, expected=f"*{suffix} files, one per frame", found="none")
    return out


def only_entry(content: bytes, suffix: str, what: str) -> bytes:
    """Return the one entry of a zip file with that suffix; raises as `unpack`."""
    with _opened(content, what) as archive:
        infos = _entries(archive, suffix, what)
        if len(infos) != 1:
            raise FileFormatError(what, expected=f"one *{suffix} file", found=f"{len(infos)}")
        return archive.read(infos[0])


def frame_indices(files: Sequence[str], names: Sequence[str], what: str) -> list[int]:
    """Tell which frame each file belongs to.

    Parameters
    ----------
    files : sequence of str
        Paths of files, one per frame.
    names : sequence of str
        File names of the clip's frames. When all files are named as frames, suffixes aside, they
        belong to those; otherwise the last number in a file's name is its frame, from 0.
    what : str
        Name of the format, for messages.

    Raises
    ------
    FileFormatError
        When a name has no number.
    """
    stems = [PurePosixPath(file).stem for file in files]
    known = {PurePosixPath(name).stem: k for k, name in enumerate(names)}
    if all(stem in known for stem in stems):
        return [known[stem] for stem in stems]
    return [_number(stem, what) for stem in stems]


@contextmanager
def _opened(content: bytes, what: str) -> Iterator[zipfile.ZipFile]:
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            yield archive
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError) as error:
        raise FileFormatError(what, expected="a zip file", found=str(error)[:100]) from error


def _entries(archive: zipfile.ZipFile, suffix: str, what: str) -> list[zipfile.ZipInfo]:
    """List the entries of a suffix but hidden ones, as macOS adds, when they are not too large."""
    infos = [info for info in archive.infolist() if _counts(PurePosixPath(info.filename), suffix)]
    largest = max((info.file_size for info in infos), default=0)
    total = sum(info.file_size for info in infos)
    if largest > _LARGEST_ENTRY or total > _LARGEST_TOTAL:
        raise FileFormatError(
            what,
            expected=f"entries of at most {_LARGEST_ENTRY} bytes, {_LARGEST_TOTAL} in all",
            found=f"{largest}, {total} in all",
        )
    return infos


def _counts(path: PurePosixPath, suffix: str) -> bool:
    return path.suffix.lower() == suffix and not path.name.startswith(".")


def _number(stem: str, what: str) -> int:
    found = _NUMBER.search(stem)
    if not found:
        raise FileFormatError(what, expected="names with the frame's number, 00000.png", found=stem[:80])
    return int(found.group(1))
