"""The table of clip formats, and what goes by it: load, save, datasets, conversion.

Reading recognises the content, writing goes by the suffix.
"""

import os
import re
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

import numpy as np

from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError
from kt3dmoseg.files import PathLike, listed, one_line
from kt3dmoseg.io.fields import FIELDS, clip_name, clip_values
from kt3dmoseg.registry import strict
from kt3dmoseg.types import Clip, Trajectories

_HEAD = 128
_MANY, _OUTSIDE = 2000, 0.05  # tracks that are looked at, share of their points outside of the image
_LEVELS = 3  # of folders in which clips are looked for
_FIX = "is the file complete? fetch it, or write it, again"
_SAVE_MAT = "save it in MATLAB with the option '-v7'"


class Format(NamedTuple):
    """One clip format: `module` has ``read(path) -> Clip`` and ``write(clip, path)``.

    A file may be of it when its first 128 bytes match the pattern `head`.
    """

    name: str
    suffix: str
    head: bytes
    module: str


FORMATS = (
    Format("hdf5", ".h5", rb"\x89HDF\r\n\x1a\n", "kt3dmoseg.io.hdf5"),
    Format("mat", ".mat", rb"MATLAB", "kt3dmoseg.io.matlab"),
    Format("npz", ".npz", rb"PK\x03\x04", "kt3dmoseg.io.point_tracks"),
    Format("dat", ".dat", rb"\s*[\d+.eE-][\d\s+.eE-]*\Z", "kt3dmoseg.io.brox"),
)
CLIP_SUFFIXES = tuple(f.suffix for f in FORMATS)
# Other files by their first bytes: what they are, and what to do about it. A matrix of version 4 starts with
# five whole numbers of either byte order: type, rows, columns, 0 or 1, length of its name.
_FOREIGN = (
    (rb"\Z", "an empty file", _FIX),
    (rb"\0{128}", "zeros, as an unfinished copy has them", _FIX),
    (rb"\x1f\x8b|BZh|\xfd7zXZ|7z\xbc|Rar!|\x28\xb5\x2f\xfd", "a compressed file", "unpack it"),
    (rb"\x80[\2-\5]", "a pickle", "pickles run code when read; save the arrays with numpy.savez"),
    (rb"version https://git-lfs", "a Git LFS pointer", "fetch the file that it stands for: git lfs pull"),
    (rb"(?i)\s*<(!doctype|html)", "a web page", "fetch the file itself, not the page about it"),
    (rb"(?s)..\0\0.{8}[\0\1]\0\0\0[\2-@]\0\0\0", "a MATLAB version 4 MAT-file", _SAVE_MAT),
    (rb"(?s)\0\0.{10}\0\0\0[\0\1]\0\0\0[\2-@]", "a MATLAB version 4 MAT-file", _SAVE_MAT),
)


@strict
def load(path: PathLike) -> Clip:
    """Load one clip from any format that is read.

    The content decides, not the suffix: the canonical HDF5, MAT-files of the 2018 release,
    Hopkins155, Hopkins12 and MTPV62, `.npz` (also of `kt3dmoseg.io.point_tracks`), Brox/FBMS `.dat`.

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
    file = Path(path)
    if not file.exists():
        raise InputFileError(f"{file}", expected="a clip", found="no such file")
    if file.is_dir():
        files = clip_files(file)
        if len(files) != 1:
            fix = f"give one, e.g. {files[0]}; load_dataset reads them all" if files else ""
            found = f"a folder with {len(files)} of them"
            raise InputFileError(f"{file}", expected="one clip", found=found, fix=fix)
        file = files[0]
    try:
        clip: Clip = import_module(recognise(file).module).read(file)
        _check_size(clip.dense)
    except InvalidValueError as error:
        raise FileFormatError(f"{file}: {error}") from None
    return clip


def _check_size(tracks: Trajectories) -> None:
    """Refuse positions that lie in the image only when x and y, or its width and height, are exchanged."""
    if tracks.image_size is None:
        return
    width, height = tracks.image_size
    x, y = tracks.xy[:_MANY][tracks.visible[:_MANY]].T
    outside = np.count_nonzero((x >= width) | (y >= height)) > _OUTSIDE * len(x)
    if outside and (x < height).all() and (y < width).all():
        found = f"positions inside of {height}x{width} only; are x and y exchanged, or width and height?"
        raise InvalidValueError("image_size", expected=f"positions in {width}x{height} px", found=found)


@strict
def save(clip: Clip, path: PathLike) -> None:
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


def written_as(path: PathLike) -> Format:
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
    head, matlab = first_bytes(file), file.suffix.lower() == ".mat"
    for format in FORMATS:
        if re.match(format.head, head) and not (matlab and format.name == "dat"):
            return format
    found, fix = f"a file that starts with {head[:8]!r}", ""
    if all(byte in b"\t\n\r" or 32 <= byte < 127 for byte in head):
        word = re.search(rb"\S*[^\d\s+.eE-]\S*", head)
        found = f"a text file with {word[0].decode()!r}" if word else "a text file"
        fix = _SAVE_MAT if matlab and not word else ""
    found, fix = next(((what, do) for start, what, do in _FOREIGN if re.match(start, head)), (found, fix))
    by_suffix = [f.name for f in FORMATS if f.suffix == file.suffix.lower()]
    expected = f"a clip ({', '.join(by_suffix or [f.name for f in FORMATS])})"
    raise FileFormatError(f"{file}", expected=expected, found=found, fix=fix)


def first_bytes(file: Path) -> bytes:
    """Read the first bytes of a file, but not of a pipe or device: that might wait for ever."""
    if not file.is_file():
        raise InputFileError(f"{file}", expected="a file", found="a pipe or device")
    with one_line(file), open(file, "rb") as stream:
        return stream.read(_HEAD)


def clip_files(folder: Path) -> list[Path]:
    """List the files of a folder that have a clip's suffix, sorted; unfinished ones are hidden."""
    return [file for file in listed(folder) if file.suffix.lower() in CLIP_SUFFIXES and file.is_file()]


def dataset_paths(folder: PathLike) -> dict[str, Path]:
    """Names and files of the clips of a folder, sorted by name, without reading them.

    It holds one file per clip, or folders that do, as archives of benchmarks unpack: up to three levels below
    (``kt3dmoseg/release``, ``Hopkins155/<sequence>``, ``MTPV62/<clip>_Tracks``). InputFileError when the
    folder is missing or holds no clip, or holds some itself and others in folders; FileFormatError when two
    files give the same clip.
    """
    root = Path(folder)
    if not root.is_dir():
        found, fix = "no such folder", ""
        if root.exists():
            found, fix = "a file", "give a folder; unpack an archive"
        raise InputFileError(f"{root}", expected="a folder of clips", found=found, fix=fix)
    own, below = clip_files(root), _clips_below(root, _LEVELS)
    # Predictions and copies have the names of clips.
    names = {clip_name(file) for file in own}
    others = [file for file in _surely_clips(below) if clip_name(file) not in names]
    if own and others:
        found = f"{own[0].name} there, and {others[0].relative_to(root)} ({len(others)} in folders)"
        fix = "move them into one folder, or give the folder of some"
        raise InputFileError(f"{root}", expected="all clips there, or all in folders", found=found, fix=fix)
    if not own and not below:
        near = _surely_clips(clip_files(root.resolve().parent))
        near = near or _surely_clips(_clips_below(root, 2 * _LEVELS))
        expected, found = f"clips ({', '.join(CLIP_SUFFIXES)})", f"none, nor in folders up to {_LEVELS} below"
        home = Path(os.path.commonpath([file.parent for file in near])) if near else root
        home = near[0].parent if near and home == root else home
        fix = f"give {home}, which has {near[0].relative_to(home)}" if near else ""
        raise InputFileError(f"{root}", expected=expected, found=found, fix=fix)
    out: dict[str, Path] = {}
    for file in own or below:
        first = out.setdefault(clip_name(file), file)
        if not first.samefile(file):  # a link may lead back to a folder above
            found, fix = f"{first.relative_to(root)} and {file.relative_to(root)}", "keep one of them"
            where = f"{root}: clip {clip_name(file)}"
            raise FileFormatError(where, expected="one file", found=found, fix=fix)
    return dict(sorted(out.items()))


def _surely_clips(files: list[Path]) -> list[Path]:
    """Leave out the formats in which caches (.npz) and label files (.npz, .dat) come, too."""
    return [file for file in files if file.suffix.lower() in (".h5", ".mat")]


def _clips_below(folder: Path, levels: int) -> list[Path]:
    """List the clip files in the folders of a folder, and in theirs, so many levels deep."""
    folders = [path for path in listed(folder) if path.is_dir()] if levels else []
    return [file for sub in folders for file in (*clip_files(sub), *_clips_below(sub, levels - 1))]


@strict
def load_dataset(folder: PathLike) -> dict[str, Clip]:
    """Load every clip of a folder, by the name of its file, in the order of `dataset_paths`."""
    return {name: replace(load(path), name=name) for name, path in dataset_paths(folder).items()}


def convert(source: PathLike, target: PathLike, *, layout: str = "") -> list[str]:
    """Convert a clip or a flow field; the suffix of `target` names the format.

    `layout` is that of a ``.npz``, of a tracker: one of `kt3dmoseg.io.point_tracks.WRITTEN`. The file is read
    back and compared with what went in: what did not survive is returned, in words. InputFileError or
    FileFormatError when the source cannot be read or the target cannot be written; InvalidValueError when the
    target's suffix is of no format, or has no such layout, or source and target are the same.
    """
    if Path(target).exists() and Path(target).resolve() == Path(source).resolve():
        raise InvalidValueError(os.fspath(target), expected="another file than the source", found="the same")
    from kt3dmoseg.io.flow_files import FLOW_SUFFIXES, read_flow, write_flow  # imports OpenCV

    suffix, given = Path(target).suffix.lower(), Path(source).suffix.lower()
    of_flow = suffix in FLOW_SUFFIXES and given in {*FLOW_SUFFIXES} - {*CLIP_SUFFIXES}
    if layout or (suffix in CLIP_SUFFIXES and not of_flow):
        from kt3dmoseg.io.point_tracks import write_layout

        clip = load(source)
        write_layout(clip, target, layout) if layout else save(clip, target)
        both = clip, load(target)
        before, after = ({"xy": c.dense.xy} | clip_values(c) for c in both)
        xy, again = before["xy"], after["xy"]
        if layout and xy.shape == again.shape and np.allclose(xy, again, rtol=0, atol=1e-9, equal_nan=True):
            after["xy"] = xy  # some count from the corner: the last bits are lost
        lost = {f.words for name, f in FIELDS.items() if not _same(before.get(name), after.get(name))}
        return sorted(lost)
    if suffix not in FLOW_SUFFIXES:
        known = ", ".join(dict.fromkeys((*CLIP_SUFFIXES, *FLOW_SUFFIXES)))
        raise InvalidValueError(os.fspath(target), expected=f"a suffix of {known}", found=repr(suffix))
    field = read_flow(source)
    write_flow(target, field)
    worst = np.nanmax(np.abs(read_flow(target).astype(np.float64) - field), initial=0.0)
    return [f"displacements are rounded by up to {worst:.4f} px"] if worst > 0 else []


def _same(first: object, second: object) -> bool:
    a, b = np.asarray(first), np.asarray(second)
    return a.shape == b.shape and bool(((a == b) | ((a != a) & (b != b))).all())  # NaN is not itself
