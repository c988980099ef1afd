"""What is inside a file or folder, as a text that a person can read."""

from __future__ import annotations

import os
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kt3dmoseg.errors import FileFormatError, InputFileError
from kt3dmoseg.files import read_bytes
from kt3dmoseg.io.formats import check_regular, clip_files, dataset_paths, load, recognise
from kt3dmoseg.io.images import IMAGE_SUFFIXES, decode, frame_number, frame_paths, has_pictures
from kt3dmoseg.io.video import VIDEO_SUFFIXES, open_video
from kt3dmoseg.types import Clip, Trajectories

_FLOW_STARTS = (b"PIEH", b"\x93NUMPY")
_PICTURE_LIMIT = 1 << 28
_LONG = 100  # characters of one value of the provenance
_LINE = 110


def info(path: str | os.PathLike[str]) -> str:
    """Describe a clip, a folder of clips, a folder of frames (or of such folders), a video, or a flow field.

    Of a single folder of frames every picture is read, of several only the first of each.

    Parameters
    ----------
    path : path
        File or folder.

    Returns
    -------
    str
        Lines of text, without a final newline.

    Raises
    ------
    InputFileError, FileFormatError
        When there is nothing that can be described.
    """
    place = Path(path)
    if not place.exists():
        raise InputFileError(f"{place}", expected="a file or folder", found="nothing")
    if place.is_dir():
        return _folder(place)
    check_regular(place)
    with open(place, "rb") as stream:
        head = stream.read(8)
    if head[:4] == _FLOW_STARTS[0] or head[:6] == _FLOW_STARTS[1]:
        return _flow(place)
    if place.suffix.lower() in IMAGE_SUFFIXES:
        return _picture(place)
    if place.suffix.lower() in VIDEO_SUFFIXES:
        return _video(place)
    return _npz(place) if head[:2] == b"PK" else _clip(load(place), recognise(place).name)


def table(rows: Sequence[Sequence[str]], header: Sequence[str]) -> str:
    """Lay out cells in columns: the first to the left, numbers to the right.

    >>> print(table([["a", "1"], ["bc", "10"]], ["clip", "n"]))
    clip   n
    a      1
    bc    10
    """
    cells = [list(header), *map(list, rows)]
    widths = [max(len(row[k]) for row in cells) for k in range(len(header))]
    lines = ("  ".join(_aligned(row, widths)).rstrip() for row in cells)
    return "\n".join(lines)


def _aligned(row: Sequence[str], widths: Sequence[int]) -> list[str]:
    return [
        f"{cell:<{w}}" if k == 0 else f"{cell:>{w}}"
        for k, (cell, w) in enumerate(zip(row, widths, strict=True))
    ]


def _clip(clip: Clip, format: str) -> str:
    dense, scored = clip.dense, clip.evaluated_trajectories
    numbers = clip.frame_numbers
    rows = [
        ("clip", clip.name),
        ("format", format),
        ("frames", f"{clip.n_frames}" + (f", numbered {numbers[0]}..{numbers[-1]}" if clip.n_frames else "")),
        ("image size", _size(dense.image_size)),
        ("trajectories", f"{len(dense)}, {_lengths(dense)}, {_missing(dense)} of the positions missing"),
        ("evaluated", f"{len(scored)}, {_lengths(scored)}, {_missing(scored)} of the positions missing"),
        ("motions", str(clip.n_motions) if clip.n_motions else "0, the clip is not labelled"),
    ]
    if clip.camera is not None:
        rows.append(
            ("camera", clip.camera.name or "unnamed" + (", K known" if clip.camera.K is not None else ""))
        )
    if clip.timestamps is not None and clip.n_frames:
        rows.append(("time", f"{clip.timestamps[0]:.3f} s to {clip.timestamps[-1]:.3f} s"))
    motions = _motions(clip) if clip.n_motions else ""
    return "\n\n".join(part for part in (_entries(rows), motions, _provenance(clip.provenance)) if part)


def _motions(clip: Clip) -> str:
    labels = clip.labels
    rows = []
    for value in np.unique(labels.label).tolist():
        count = int((labels.label == value).sum())
        known = "unlabelled or outlier" if value == 0 else "background" if value == labels.background else ""
        rows.append([f"{value} {labels.names.get(value, known)}", str(count), f"{count / len(labels):.1%}"])
    return table(rows, ["motion", "trajectories", "share"])


def _clips(paths: dict[str, Path]) -> str:
    rows, totals = [], np.zeros(3, dtype=np.int64)
    for name, path in paths.items():
        clip = load(path)
        totals += clip.n_frames, len(clip.dense), len(clip.evaluated)
        counts = [str(int((clip.labels.label == m).sum())) for m in clip.labels.motions]
        sizes = [str(clip.n_frames), str(len(clip.dense)), str(len(clip.evaluated)), str(clip.n_motions)]
        scored = clip.evaluated_trajectories
        rows.append([name, *sizes, " ".join(counts) or "-", _missing(scored), _size(clip.dense.image_size)])
    rows.append([f"{len(paths)} clips", *map(str, totals), "", "", "", ""])
    header = ["clip", "frames", "dense", "evaluated", "motions", "per motion", "missing", "image size"]
    return table(rows, header)


def _folder(folder: Path) -> str:
    if has_pictures(folder):
        return _frames([folder])
    subfolders = [sub for sub in sorted(folder.iterdir()) if sub.is_dir() and not sub.name.startswith(".")]
    if not clip_files(folder):
        with_pictures = [sub for sub in subfolders if has_pictures(sub)]
        if with_pictures:
            return _frames(with_pictures)
    return _clips(dataset_paths(folder))


def _frames(folders: Sequence[Path]) -> str:
    rows = []
    for folder in folders:
        try:
            paths = frame_paths(folder)
            first = _first_of(paths, check=len(folders) == 1)
            numbers = f"{frame_number(paths[0])}..{frame_number(paths[-1])}"
            size = f"{first.shape[1]}x{first.shape[0]}"
            rows.append([folder.name, str(len(paths)), numbers, size, _kind(first), ""])
        except (FileFormatError, InputFileError) as error:
            if len(folders) == 1:
                raise
            rows.append([folder.name, "-", "-", "-", "-", str(error)])
    return table(rows, ["frames of", "frames", "numbers", "size", "first picture", ""])


def _first_of(paths: Sequence[Path], *, check: bool) -> np.ndarray[Any, Any]:
    """Return the first picture; with `check` see that the others are sound, of its size and depth."""
    first = decode(read_bytes(paths[0], _PICTURE_LIMIT), f"{paths[0]}")
    for path in paths[1:] if check else ():
        other = decode(read_bytes(path, _PICTURE_LIMIT), f"{path}")
        if (other.shape[:2], other.dtype) != (first.shape[:2], first.dtype):
            expected, found = (f"{p.shape[1]}x{p.shape[0]}, {_kind(p)}" for p in (first, other))
            raise FileFormatError(f"{path}", expected=f"{expected}, as {paths[0].name}", found=found)
    return first


def _picture(path: Path) -> str:
    picture = decode(read_bytes(path, _PICTURE_LIMIT), f"{path}")
    if picture.dtype == np.uint16 and picture.ndim == 3:
        return _flow(path)
    return f"{path.name}: a picture of {picture.shape[1]}x{picture.shape[0]}, {_kind(picture)}"


def _video(path: Path) -> str:
    with open_video(path) as video:
        size, count = "", 0
        while (read := video.read())[0]:
            size, count = f"{read[1].shape[1]}x{read[1].shape[0]}", count + 1
    if not count:
        raise FileFormatError(f"{path}", expected="a video that OpenCV decodes", found="none")
    return f"{path.name}: a video of {count} frames, {size}"


def _kind(picture: np.ndarray[Any, Any]) -> str:
    channels = 1 if picture.ndim == 2 else picture.shape[2]
    return f"{8 * picture.dtype.itemsize}-bit " + ("gray" if channels == 1 else f"{channels} channels")


def _npz(path: Path) -> str:
    from kt3dmoseg.io.npz import npz_shapes

    shapes = npz_shapes(path)
    return _flow(path) if set(shapes) == {"flow"} or len(shapes) == 1 else _clip(load(path), "npz")


def _flow(path: Path) -> str:
    from kt3dmoseg.io.flow_files import read_flow

    field = read_flow(path)
    with np.errstate(invalid="ignore"):  # a file may hold any NaN
        length = np.hypot(*np.moveaxis(field.astype(np.float64), -1, 0))
    known = np.isfinite(length)
    size = f"{field.shape[1]}x{field.shape[0]}"
    if not known.any():
        return f"{path.name}: optical flow of {size}, nowhere known"
    figures = f"mean {length[known].mean():.2f} px, longest {length[known].max():.2f} px"
    return f"{path.name}: optical flow of {size}, {known.mean():.1%} known, {figures}"


def _lengths(trajectories: Trajectories) -> str:
    lengths = trajectories.lengths
    if not len(lengths):
        return "none"
    return f"{lengths.min()} to {lengths.max()} frames long (mean {lengths.mean():.1f})"


def _missing(trajectories: Trajectories) -> str:
    return f"{1 - trajectories.visible.mean():.1%}" if trajectories.visible.size else "-"


def _size(size: tuple[int, int] | None) -> str:
    return "unknown" if size is None else f"{size[0]}x{size[1]}"


def _entries(rows: Sequence[tuple[str, str]]) -> str:
    """Lay out names and texts; a long text goes on below itself."""
    width = max((len(name) for name, _ in rows), default=0) + 2
    wrapper = textwrap.TextWrapper(_LINE, break_long_words=False, break_on_hyphens=False)
    wrapper.subsequent_indent = " " * width
    lines = []
    for name, text in rows:
        wrapper.initial_indent = f"{name:<{width}}"
        lines.append(wrapper.fill(text))
    return "\n".join(lines)


def _provenance(values: Mapping[str, Any]) -> str:
    rows: list[tuple[str, str]] = []
    for key, value in values.items():
        inner = value if isinstance(value, Mapping) and value else {"": value}
        rows += [(f"provenance {key} {name}".rstrip(), _text(part)) for name, part in inner.items()]
    return _entries(rows)


def _text(value: object, levels: int = 2) -> str:
    if isinstance(value, Mapping) and value and levels:
        return ", ".join(f"{key} {_text(inner, levels - 1)}" for key, inner in value.items())
    text = str(value)
    if text in ("", "{}"):
        return "none"
    return text if len(text) <= _LONG else text[: _LONG - 3] + "..."
