"""What is inside a file or folder: as plain values, and as a text that a person can read."""

from __future__ import annotations

import os
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import FileFormatError, InputFileError
from kt3dmoseg.files import read_bytes
from kt3dmoseg.io.flow_files import read_flow
from kt3dmoseg.io.formats import check_regular, clip_files, dataset_paths, load, recognise
from kt3dmoseg.io.images import IMAGE_SUFFIXES, decode, frame_number, frame_paths, has_pictures
from kt3dmoseg.io.npz import npz_shapes
from kt3dmoseg.io.video import VIDEO_SUFFIXES, open_video
from kt3dmoseg.types import Clip, Trajectories

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
    facts = describe(path)
    name = Path(path).name
    match facts["kind"]:
        case "clip":
            return _clip_text(facts)
        case "clips":
            return _clips_text(facts["clips"])
        case "frames":
            header = ["frames of", "frames", "numbers", "size", "first picture", ""]
            return table([_frames_row(row) for row in facts["folders"]], header)
        case "video":
            return f"{name}: a video of {facts['frames']} frames, {_size(facts['image_size'])}"
        case "picture":
            return f"{name}: a picture of {_size(facts['image_size'])}, {facts['pixels']}"
    size = f"{name}: optical flow of {_size(facts['image_size'])}"
    if not facts["known"]:
        return f"{size}, nowhere known"
    return (
        f"{size}, {facts['known']:.1%} known, mean {facts['mean']:.2f} px, longest {facts['longest']:.2f} px"
    )


def describe(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return what `info` says as values of JSON; `kind` is clip, clips, frames, video, picture or flow."""
    target = Path(path)
    if not target.exists():
        raise InputFileError(f"{target}", expected="a file or folder", found="nothing")
    if target.is_dir():
        return _folder(target)
    check_regular(target)
    with open(target, "rb") as stream:
        head = stream.read(8)
    suffix = target.suffix.lower()
    if (
        head[:4] == b"PIEH"
        or head[:6] == b"\x93NUMPY"
        or (head[:2] == b"PK" and len(npz_shapes(target)) == 1)
    ):
        return _flow(target)
    if suffix in IMAGE_SUFFIXES:
        picture = _picture(target)
        if picture.dtype == np.uint16 and picture.ndim == 3:
            return _flow(target)
        return {"kind": "picture", "image_size": _shape(picture), "pixels": _pixels(picture)}
    if suffix in VIDEO_SUFFIXES:
        return _video(target)
    return _clip(load(target), recognise(target).name)


def table(rows: Sequence[Sequence[str]], header: Sequence[str]) -> str:
    """Lay out cells in columns: the first to the left, numbers to the right.

    >>> print(table([["a", "1"], ["bc", "10"]], ["clip", "n"]))
    clip   n
    a      1
    bc    10
    """
    cells = [header, *rows]
    widths = [max(len(row[k]) for row in cells) for k in range(len(header))]
    lines = []
    for first, *others in cells:
        numbers = [f"{cell:>{width}}" for cell, width in zip(others, widths[1:], strict=True)]
        lines.append("  ".join([f"{first:<{widths[0]}}", *numbers]).rstrip())
    return "\n".join(lines)


def _clip(clip: Clip, format: str) -> dict[str, Any]:
    labels, numbers, times = clip.labels, clip.frame_numbers, clip.timestamps
    motions = []
    for value in np.unique(labels.label).tolist():
        count = int((labels.label == value).sum())
        known = "unlabelled or outlier" if value == 0 else "background" if value == labels.background else ""
        name = labels.names.get(value, known)
        motions.append({"motion": value, "name": name, "trajectories": count, "share": count / len(labels)})
    return {
        "kind": "clip",
        "clip": clip.name,
        "format": format,
        "frames": clip.n_frames,
        "numbers": [int(numbers[0]), int(numbers[-1])] if clip.n_frames else None,
        "image_size": clip.dense.image_size,
        "trajectories": _tracks(clip.dense),
        "evaluated": _tracks(clip.evaluated_trajectories),
        "n_motions": clip.n_motions,
        "motions": motions,
        "camera": clip.camera and {"name": clip.camera.name, "has_K": clip.camera.K is not None},
        "time": None if times is None or not clip.n_frames else [float(times[0]), float(times[-1])],
        "provenance": dict(clip.provenance),
    }


def _tracks(tracks: Trajectories) -> dict[str, Any]:
    lengths = tracks.lengths
    low, high, mean = (lengths.min(), lengths.max(), lengths.mean()) if len(lengths) else (0, 0, 0)
    missing = 1 - float(tracks.visible.mean()) if tracks.visible.size else None
    span = {"shortest": int(low), "longest": int(high), "mean_length": float(mean)}
    return {"count": len(tracks), **span, "missing": missing}


def _folder(folder: Path) -> dict[str, Any]:
    if has_pictures(folder):
        return {"kind": "frames", "folders": [_frames(folder, check=True)]}
    subfolders = [sub for sub in sorted(folder.iterdir()) if sub.is_dir() and not sub.name.startswith(".")]
    if not clip_files(folder) and any(map(has_pictures, subfolders)):
        folders = []
        for sub in filter(has_pictures, subfolders):
            try:
                folders.append(_frames(sub, check=False))
            except (FileFormatError, InputFileError) as error:
                folders.append({"name": sub.name, "error": str(error)})
        return {"kind": "frames", "folders": folders}
    paths = dataset_paths(folder).values()
    return {"kind": "clips", "clips": [_clip(load(path), recognise(path).name) for path in paths]}


def _frames(folder: Path, *, check: bool) -> dict[str, Any]:
    """Describe a folder of frames; with `check` see that all pictures are intact, of one size and depth."""
    paths = frame_paths(folder)
    first = _picture(paths[0])
    size, pixels = _shape(first), _pixels(first)
    for path in paths[1:] if check else ():
        other = _picture(path)
        if (other.shape[:2], other.dtype) != (first.shape[:2], first.dtype):
            expected, found = (f"{_size(_shape(p))}, {_pixels(p)}" for p in (first, other))
            raise FileFormatError(f"{path}", expected=f"{expected}, as {paths[0].name}", found=found)
    numbers = [frame_number(paths[0]), frame_number(paths[-1])]
    return {
        "name": folder.name,
        "frames": len(paths),
        "numbers": numbers,
        "image_size": size,
        "pixels": pixels,
    }


def _picture(path: Path) -> npt.NDArray[Any]:
    return decode(read_bytes(path, _PICTURE_LIMIT), f"{path}")


def _shape(picture: npt.NDArray[Any]) -> tuple[int, int]:
    return picture.shape[1], picture.shape[0]


def _pixels(picture: npt.NDArray[Any]) -> str:
    channels = 1 if picture.ndim == 2 else picture.shape[2]
    return f"{8 * picture.dtype.itemsize}-bit " + ("gray" if channels == 1 else f"{channels} channels")


def _video(path: Path) -> dict[str, Any]:
    size, count = None, 0
    with open_video(path) as video:
        while (read := video.read())[0]:
            size, count = _shape(read[1]), count + 1
    if not count:
        raise FileFormatError(f"{path}", expected="a video that OpenCV decodes", found="none")
    return {"kind": "video", "frames": count, "image_size": size}


def _flow(path: Path) -> dict[str, Any]:
    field = read_flow(path)
    with np.errstate(invalid="ignore"):  # a file may hold any NaN
        length = np.hypot(*np.moveaxis(field.astype(np.float64), -1, 0))
    known = length[np.isfinite(length)]
    figures = {"mean": float(known.mean()), "longest": float(known.max())} if known.size else {}
    share = known.size / length.size if length.size else 0.0
    return {"kind": "flow", "image_size": _shape(field), "known": share, **figures}


def _clip_text(facts: Mapping[str, Any]) -> str:
    numbers, camera, time = facts["numbers"], facts["camera"], facts["time"]
    rows = [
        ("clip", facts["clip"]),
        ("format", facts["format"]),
        ("frames", f"{facts['frames']}" + (f", numbered {numbers[0]}..{numbers[1]}" if numbers else "")),
        ("image size", _size(facts["image_size"])),
        ("trajectories", _tracks_text(facts["trajectories"])),
        ("evaluated", _tracks_text(facts["evaluated"])),
        ("motions", str(facts["n_motions"] or "0, the clip is not labelled")),
    ]
    if camera:
        rows.append(("camera", (camera["name"] or "unnamed") + (", K known" if camera["has_K"] else "")))
    if time:
        rows.append(("time", f"{time[0]:.3f} s to {time[1]:.3f} s"))
    origin = []
    for key, value in facts["provenance"].items():
        inner = value if isinstance(value, Mapping) and value else {"": value}
        origin += [(f"provenance {key} {name}".rstrip(), _value_text(part)) for name, part in inner.items()]
    motions = [
        [f"{m['motion']} {m['name']}", str(m["trajectories"]), f"{m['share']:.1%}"] for m in facts["motions"]
    ]
    shares = table(motions, ["motion", "trajectories", "share"]) if facts["n_motions"] else ""
    return "\n\n".join(part for part in (_wrapped(rows), shares, _wrapped(origin)) if part)


def _clips_text(clips: Sequence[Mapping[str, Any]]) -> str:
    rows, totals = [], np.zeros(3, dtype=np.int64)
    for clip in clips:
        counts = [clip["frames"], clip["trajectories"]["count"], clip["evaluated"]["count"]]
        totals += counts
        motions = " ".join(str(m["trajectories"]) for m in clip["motions"] if m["motion"]) or "-"
        missing, size = _missing(clip["evaluated"]), _size(clip["image_size"])
        rows.append([clip["clip"], *map(str, counts), str(clip["n_motions"]), motions, missing, size])
    rows.append([f"{len(clips)} clips", *map(str, totals), "", "", "", ""])
    header = ["clip", "frames", "dense", "evaluated", "motions", "per motion", "missing", "image size"]
    return table(rows, header)


def _frames_row(row: Mapping[str, Any]) -> list[str]:
    if "error" in row:
        return [row["name"], "-", "-", "-", "-", row["error"]]
    first, last = row["numbers"]
    return [row["name"], str(row["frames"]), f"{first}..{last}", _size(row["image_size"]), row["pixels"], ""]


def _tracks_text(tracks: Mapping[str, Any]) -> str:
    lengths = f"{tracks['shortest']} to {tracks['longest']} frames long (mean {tracks['mean_length']:.1f})"
    span = lengths if tracks["count"] else "none"
    return f"{tracks['count']}, {span}, {_missing(tracks)} of the positions missing"


def _missing(tracks: Mapping[str, Any]) -> str:
    return "-" if tracks["missing"] is None else f"{tracks['missing']:.1%}"


def _size(size: tuple[int, int] | None) -> str:
    return "unknown" if size is None else f"{size[0]}x{size[1]}"


def _wrapped(rows: Sequence[tuple[str, str]]) -> str:
    """Lay out names and texts; a long text goes on below itself."""
    width = max((len(name) for name, _ in rows), default=0) + 2
    wrapper = textwrap.TextWrapper(_LINE, break_long_words=False, break_on_hyphens=False)
    wrapper.subsequent_indent = " " * width
    return "\n".join(wrapper.fill(f"{name:<{width}}{text}") for name, text in rows)


def _value_text(value: object, levels: int = 2) -> str:
    if isinstance(value, Mapping) and value and levels:
        return ", ".join(f"{key} {_value_text(inner, levels - 1)}" for key, inner in value.items())
    text = str(value)
    if text in ("", "{}"):
        return "none"
    return text if len(text) <= _LONG else text[: _LONG - 3] + "..."
