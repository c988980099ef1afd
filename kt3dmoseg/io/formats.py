"""The table of clip formats: `load` recognises what it is given, `save` goes by the suffix."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError, KT3DMoSegError
from kt3dmoseg.types import Clip

_HEAD = 128
_FIX = "is the file whole? fetch it, or write it, again"
_PICKLE_FIX = "pickles run code when read; save the arrays with numpy.savez"


@dataclass(frozen=True)
class Format:
    """One clip format; its module is imported when it is used.

    Parameters
    ----------
    name : str
        What it is called.
    suffix : str
        Of its files.
    recognise : callable
        Whether a file with these first 128 bytes may be of this format.
    reader, writer : str
        "module:function"; no writer, no writing.
    """

    name: str
    suffix: str
    recognise: Callable[[bytes], bool]
    reader: str
    writer: str = ""


def _is_text_of_numbers(head: bytes) -> bool:
    return bool(head.strip()) and set(head) <= set(b"0123456789+-.eE \t\r\n")


FORMATS = (
    Format(
        "hdf5",
        ".h5",
        lambda head: head[:8] == b"\x89HDF\r\n\x1a\n",
        "kt3dmoseg.io.hdf5:read",
        "kt3dmoseg.io.hdf5:write",
    ),
    Format(
        "mat",
        ".mat",
        lambda head: head[:6] == b"MATLAB",
        "kt3dmoseg.io.matlab:read",
        "kt3dmoseg.io.release:write",
    ),
    Format(
        "npz",
        ".npz",
        lambda head: head[:4] == b"PK\x03\x04",
        "kt3dmoseg.io.npz:read",
        "kt3dmoseg.io.npz:write",
    ),
    Format("dat", ".dat", _is_text_of_numbers, "kt3dmoseg.io.brox:read", "kt3dmoseg.io.brox:write"),
)
CLIP_SUFFIXES = tuple(f.suffix for f in FORMATS)


def load(path: str | os.PathLike[str]) -> Clip:
    """Load one clip from any format that is read.

    The content decides, not the suffix: the canonical HDF5, MAT-files of the 2018 release,
    Hopkins155, Hopkins12 and MTPV62, `.npz` (also CoTracker's and TAP-Vid's), Brox/FBMS `.dat`.

    Parameters
    ----------
    path : path
        A file, or a folder that holds one.

    Raises
    ------
    InputFileError
        When it is missing or unreadable, or a folder of several clips.
    FileFormatError
        When it is of no known format, damaged, of a newer version, or contradicts itself.
    """
    file = _single_file(Path(path))
    read = _function(recognise(file).reader)
    try:
        clip: Clip = read(file)
    except InvalidValueError as error:
        raise FileFormatError(f"{file}: {error}", fix=_FIX) from None
    except FileFormatError as error:
        fix = error.fix or _FIX
        raise FileFormatError(error.where, expected=error.expected, found=error.found, fix=fix) from None
    except KT3DMoSegError:
        raise
    except OSError as error:
        raise InputFileError(f"{file}: {error.strerror or error}") from None
    return clip


def save(clip: Clip, path: str | os.PathLike[str]) -> None:
    """Write a clip in the format of the path's suffix, atomically.

    Parameters
    ----------
    clip : Clip
        The clip.
    path : path
        Ends in ``.h5`` (canonical; keeps everything), ``.mat`` (2018 schema), ``.npz`` or ``.dat``.

    Raises
    ------
    InvalidValueError
        When no format has that suffix.
    InputFileError
        When the file cannot be written.
    """
    _function(written_as(path).writer)(clip, path)


def written_as(path: str | os.PathLike[str]) -> Format:
    """Return the format in which a path's suffix says that a clip is written.

    Raises
    ------
    InvalidValueError
        When no format has that suffix.
    """
    suffix = Path(path).suffix.lower()
    for format in FORMATS:
        if format.suffix == suffix:
            return format
    raise InvalidValueError(
        os.fspath(path), expected=f"a suffix of {', '.join(CLIP_SUFFIXES)}", found=repr(suffix)
    )


def recognise(file: Path) -> Format:
    """Return the format of a file from its first bytes.

    Raises
    ------
    InputFileError
        When it cannot be read.
    FileFormatError
        When it is none of `FORMATS`.
    """
    try:
        with open(file, "rb") as stream:
            head = stream.read(_HEAD)
    except OSError as error:
        raise InputFileError(f"{file}: {error.strerror or error}") from None
    for format in FORMATS:
        if format.recognise(head):
            return format
    by_suffix = [f for f in FORMATS if f.suffix == file.suffix.lower()]
    pickled = head[:1] == b"\x80" and head[1:2] in b"\x02\x03\x04\x05"
    raise FileFormatError(
        f"{file}",
        expected=f"a clip ({', '.join(f.name for f in by_suffix or FORMATS)})",
        found="a pickle" if pickled else f"a file that starts with {head[:8]!r}" if head else "an empty file",
        fix=_PICKLE_FIX if pickled else _FIX,
    )


def check_regular(path: Path) -> None:
    """Refuse a pipe or device: reading it might wait for ever."""
    if not path.is_file():
        raise InputFileError(f"{path}", expected="a file", found="a pipe or device")


def _single_file(path: Path) -> Path:
    if not path.exists():
        raise InputFileError(f"{path}", expected="a clip", found="no such file")
    if not path.is_dir():
        check_regular(path)
        return path
    files = clip_files(path)
    if len(files) != 1:
        raise InputFileError(
            f"{path}",
            expected="one clip",
            found=f"a folder with {len(files)} of them",
            fix=f"give one, e.g. {files[0]}; load_dataset reads them all" if files else "",
        )
    return files[0]


def clip_files(folder: Path) -> list[Path]:
    """List the files of a folder that have a clip's suffix, sorted; unfinished ones are hidden."""
    return [
        f
        for f in sorted(folder.iterdir())
        if f.suffix in CLIP_SUFFIXES and not f.name.startswith(".") and f.is_file()
    ]


def _function(target: str) -> Callable[..., Any]:
    module, _, name = target.partition(":")
    function: Callable[..., Any] = getattr(import_module(module), name)
    return function
