"""The table of clip formats, and what goes by it: load, save, datasets, conversion.

Reading recognises the content, writing goes by the suffix.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

import numpy as np

from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError
from kt3dmoseg.files import listed
from kt3dmoseg.io.fields import clip_name, clip_values
from kt3dmoseg.types import Clip

_HEAD = 128
_LEVELS = 3  # of folders in which clips are looked for
_FIX = "is the file complete? fetch it, or write it, again"
_SAVE_MAT = "save it in MATLAB with the option '-v7'"


@dataclass(frozen=True)
class Format:
    """One clip format; `recognise` decides from the first 128 bytes whether a file may be of it.

    Its `module`, imported when it is used, has ``read(path) -> Clip`` and ``write(clip, path)``.
    """

    name: str
    suffix: str
    recognise: Callable[[bytes], bool]
    module: str


def _is_text_of_numbers(head: bytes) -> bool:
    return bool(head.strip()) and set(head) <= set(b"0123456789+-.eE \t\r\n")


FORMATS = (
    Format("hdf5", ".h5", lambda head: head[:8] == b"\x89HDF\r\n\x1a\n", "kt3dmoseg.io.hdf5"),
    Format("mat", ".mat", lambda head: head[:6] == b"MATLAB", "kt3dmoseg.io.matlab"),
    Format("npz", ".npz", lambda head: head[:4] == b"PK\x03\x04", "kt3dmoseg.io.npz"),
    Format("dat", ".dat", _is_text_of_numbers, "kt3dmoseg.io.brox"),
)
CLIP_SUFFIXES = tuple(f.suffix for f in FORMATS)
_WORDS = {
    "name": "name",
    "xy": "coordinates",
    "track_id": "track ids",
    "image_size": "image size",
    "evaluated": "which trajectories are evaluated",
    "label": "labels",
    "background": "which label is the background",
    "label_names": "names of the motions",
    "frame_numbers": "frame numbers",
    "timestamps": "timestamps",
    "camera_name": "camera",
    "K": "camera",
    "provenance": "provenance",
}


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
    try:
        clip: Clip = import_module(recognise(file).module).read(file)
    except InvalidValueError as error:
        raise FileFormatError(f"{file}: {error}") from None
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
    import_module(written_as(path).module).write(clip, path)


def written_as(path: str | os.PathLike[str]) -> Format:
    """Return the format of a path's suffix; InvalidValueError when there is none."""
    suffix = Path(path).suffix.lower()
    for format in FORMATS:
        if format.suffix == suffix:
            return format
    raise InvalidValueError(
        os.fspath(path), expected=f"a suffix of {', '.join(CLIP_SUFFIXES)}", found=repr(suffix)
    )


def recognise(file: Path) -> Format:
    """Return the format of a file from its first bytes; FileFormatError when it is none of `FORMATS`."""
    try:
        with open(file, "rb") as stream:
            head = stream.read(_HEAD)
    except OSError as error:
        raise InputFileError(f"{file}: {error.strerror or error}") from None
    matlab = file.suffix.lower() == ".mat"
    for format in FORMATS:
        if format.recognise(head) and not (matlab and format.name == "dat"):
            return format
    by_suffix = [f for f in FORMATS if f.suffix == file.suffix.lower()]
    expected = f"a clip ({', '.join(f.name for f in by_suffix or FORMATS)})"
    found, fix = _foreign(head, matlab)
    raise FileFormatError(f"{file}", expected=expected, found=found, fix=fix)


def _foreign(head: bytes, matlab: bool) -> tuple[str, str]:
    """Return what a file of no clip format is, by its first bytes, and what to do about it."""
    text = head.lstrip().lower()
    words = [word for word in text.split() if not _is_text_of_numbers(word)]
    if not head:
        return "an empty file", _FIX
    if head[:1] == b"\x80" and head[1:2] in b"\x02\x03\x04\x05":
        return "a pickle", "pickles run code when read; save the arrays with numpy.savez"
    if text.startswith(b"version https://git-lfs"):
        return "a Git LFS pointer", "fetch the file that it stands for: git lfs pull"
    if text.startswith((b"<!doctype", b"<html")):
        return "a web page", "fetch the file itself, not the page about it"
    if matlab and _is_mat4(head):
        return "a MATLAB version 4 MAT-file", _SAVE_MAT
    if all(byte in b"\t\n\r" or 32 <= byte < 127 for byte in head):
        known = "a text file" + (f" with {words[0].decode()!r}" if words else "")
        return known, _SAVE_MAT if matlab else ""
    return f"a file that starts with {head[:8]!r}", _FIX


def _is_mat4(head: bytes) -> bool:
    """Whether five whole numbers are the header of a matrix: type, rows, columns, complex, length of name."""
    for order in "<>" if len(head) >= 20 else "":
        kind, rows, columns, complex_, name = struct.unpack(f"{order}5i", head[:20])
        if 0 <= kind < 5000 and min(rows, columns) >= 0 and complex_ in (0, 1) and 1 < name <= 64:
            return True
    return False


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
        fix = f"give one, e.g. {files[0]}; load_dataset reads them all" if files else ""
        raise InputFileError(
            f"{path}", expected="one clip", found=f"a folder with {len(files)} of them", fix=fix
        )
    return files[0]


def clip_files(folder: Path) -> list[Path]:
    """List the files of a folder that have a clip's suffix, sorted; unfinished ones are hidden."""
    return [file for file in listed(folder) if file.suffix.lower() in CLIP_SUFFIXES and file.is_file()]


def dataset_paths(folder: str | os.PathLike[str]) -> dict[str, Path]:
    """Names and files of the clips of a folder, without reading them.

    Parameters
    ----------
    folder : path
        Holds one file per clip, or folders that do, as archives of benchmarks unpack: up to three levels
        below (``kt3dmoseg/release``, ``Hopkins155/<sequence>``, ``MTPV62/<clip>_Tracks``).

    Returns
    -------
    dict of str to Path
        Sorted by name.

    Raises
    ------
    InputFileError
        When the folder is missing or holds no clip, or holds some itself and others in folders.
    FileFormatError
        When two files give the same clip.
    """
    root = Path(folder)
    if not root.is_dir():
        found, fix = (
            ("a file", "give a folder; unpack an archive") if root.exists() else ("no such folder", "")
        )
        raise InputFileError(f"{root}", expected="a folder of clips", found=found, fix=fix)
    own, below = clip_files(root), _clips_below(root, _LEVELS)
    if own:
        _check_unmixed(root, own, below)
    elif not below:
        near = clip_files(root.resolve().parent)
        expected, found = f"clips ({', '.join(CLIP_SUFFIXES)})", f"none, nor in folders up to {_LEVELS} below"
        fix = f"give {root.resolve().parent}, which has {near[0].name}" if near else ""
        raise InputFileError(f"{root}", expected=expected, found=found, fix=fix)
    out: dict[str, Path] = {}
    for file in own or below:
        name = clip_name(file)
        if name in out and not out[name].samefile(file):  # a link may lead back to a folder above
            both = f"{out[name].relative_to(root)} and {file.relative_to(root)}"
            fix = "keep one of them"
            raise FileFormatError(f"{root}: clip {name}", expected="one file", found=both, fix=fix)
        out[name] = file
    return dict(sorted(out.items()))


def _clips_below(folder: Path, levels: int) -> list[Path]:
    """List the clip files in the folders of a folder, and in theirs, so many levels deep."""
    folders = [path for path in listed(folder) if path.is_dir()] if levels else []
    return [file for sub in folders for file in (*clip_files(sub), *_clips_below(sub, levels - 1))]


def _check_unmixed(root: Path, own: list[Path], below: list[Path]) -> None:
    """Refuse clips in folders next to clips; predictions and copies have their names, caches are npz."""
    names = {clip_name(file) for file in own}
    others = [
        file for file in below if file.suffix.lower() in (".h5", ".mat") and clip_name(file) not in names
    ]
    if others:
        found = f"{own[0].name} there, and {others[0].relative_to(root)} ({len(others)} in folders)"
        fix = "move them into one folder, or give the folder of some"
        raise InputFileError(f"{root}", expected="all clips there, or all in folders", found=found, fix=fix)


def load_dataset(folder: str | os.PathLike[str]) -> dict[str, Clip]:
    """Load every clip of a folder, by name, in the order of `dataset_paths`."""
    return {name: load(path) for name, path in dataset_paths(folder).items()}


def convert(source: str | os.PathLike[str], target: str | os.PathLike[str]) -> list[str]:
    """Convert a clip or a flow field; the suffix of `target` names the format.

    The file is read back and compared with what went in.

    Parameters
    ----------
    source : path
        A clip, or a flow field when `target` is ``.flo``, ``.png`` or ``.npy``.
    target : path
        The file to write.

    Returns
    -------
    list of str
        What did not survive, in words; empty when everything did.

    Raises
    ------
    InputFileError, FileFormatError
        When the source cannot be read or the target cannot be written.
    InvalidValueError
        When the target's suffix is of no format, or source and target are the same file.
    """
    if Path(target).exists() and Path(target).resolve() == Path(source).resolve():
        raise InvalidValueError(os.fspath(target), expected="another file than the source", found="the same")
    if Path(target).suffix.lower() in CLIP_SUFFIXES:
        clip = load(source)
        save(clip, target)
        return _lost(clip, load(target))
    return _convert_flow(source, target)


def _convert_flow(source: str | os.PathLike[str], target: str | os.PathLike[str]) -> list[str]:
    from kt3dmoseg.io.flow_files import FLOW_SUFFIXES, read_flow, write_flow  # imports OpenCV

    if Path(target).suffix.lower() not in FLOW_SUFFIXES:
        known = ", ".join(dict.fromkeys((*CLIP_SUFFIXES, *FLOW_SUFFIXES)))
        raise InvalidValueError(
            os.fspath(target), expected=f"a suffix of {known}", found=repr(Path(target).suffix)
        )
    field = read_flow(source)
    write_flow(target, field)
    error = np.abs(read_flow(target).astype(np.float64) - field)
    worst = float(np.nanmax(error, initial=0.0))
    return [f"displacements are rounded by up to {worst:.4f} px"] if worst > 0 else []


def _lost(before: Clip, after: Clip) -> list[str]:
    first, second = ({"xy": clip.dense.xy} | clip_values(clip) for clip in (before, after))
    lost = [_WORDS[name] for name in _WORDS if not _same(first.get(name), second.get(name))]
    return list(dict.fromkeys(lost))


def _same(first: object, second: object) -> bool:
    if isinstance(first, np.ndarray) and isinstance(second, np.ndarray):
        return np.array_equal(first, second, equal_nan=first.dtype.kind == "f")
    return type(first) is type(second) and first == second
