"""What is inside a file or folder: as plain values, and as a text that a person can read."""

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kt3dmoseg.errors import FileFormatError, InputFileError
from kt3dmoseg.files import PathLike, listed
from kt3dmoseg.io import images
from kt3dmoseg.io.flow_files import read_flow
from kt3dmoseg.io.formats import clip_files, dataset_paths, first_bytes, load, recognise
from kt3dmoseg.io.npz import is_lone_array
from kt3dmoseg.text import count, text_table
from kt3dmoseg.types import Trajectories

_LONG = 100  # characters of one value of the provenance
_LINE = 110


def info(path: PathLike) -> str:
    """Describe a clip, a folder of clips, a folder of frames (or of such folders), a video, or a flow field.

    Of a single folder of frames every picture is read, of several only the first of each. InputFileError or
    FileFormatError when there is nothing that can be described.
    """
    facts, name = describe(path), Path(path).name
    size = _size(facts.get("image_size"))
    match facts["kind"]:
        case "clip":
            return _clip_text(facts)
        case "clips":
            return _clips_text(facts["clips"])
        case "frames":
            header = ["frames of", "frames", "numbers", "size", "first picture", ""]
            return text_table([_frames_row(row) for row in facts["folders"]], header)
        case "video":
            return f"{name}: a video of {facts['frames']} frames, {size}"
        case "picture":
            return f"{name}: a picture of {size}, {facts['pixels']}"
    known = "{known:.1%} known, mean {mean:.2f} px, longest {longest:.2f} px".format_map
    return f"{name}: optical flow of {size}, {known(facts) if facts['known'] else 'nowhere known'}"


def describe(path: PathLike) -> dict[str, Any]:
    """Return what `info` reports as JSON values; `kind` is clip, clips, frames, video, picture or flow."""
    target = Path(path)
    if not target.exists():
        raise InputFileError(f"{target}", expected="a file or folder", found="nothing")
    if target.is_dir():
        return _folder(target)
    if first_bytes(target).startswith((b"PIEH", b"\x93NUMPY")) or is_lone_array(target):
        return _flow(target)
    if target.suffix.lower() in images.IMAGE_SUFFIXES:
        facts = _picture(target)
        return _flow(target) if facts["pixels"] == "16-bit 3 channels" else facts
    return _video(target) if target.suffix.lower() in images.VIDEO_SUFFIXES else _clip(target)


def _clip(path: Path) -> dict[str, Any]:
    clip = load(path)
    labels, numbers, times = clip.labels, clip.frame_numbers, clip.timestamps
    known = {0: "unlabelled or outlier", labels.background: "background"} | dict(labels.names)
    motions = []
    for value, size in zip(*np.unique(labels.label, return_counts=True), strict=True):
        name, share = known.get(int(value), ""), float(size) / len(labels)
        motions.append({"motion": int(value), "name": name, "trajectories": int(size), "share": share})
    return {
        "kind": "clip",
        "clip": clip.name,
        "format": recognise(path).name,
        "frames": clip.n_frames,
        "numbers": numbers[[0, -1]].tolist() if clip.n_frames else None,
        "image_size": clip.dense.image_size,
        "trajectories": _tracks(clip.dense),
        "evaluated": _tracks(clip.evaluated_trajectories),
        "n_motions": clip.n_motions,
        "motions": motions,
        "camera": clip.camera and {"name": clip.camera.name, "has_K": clip.camera.K is not None},
        "time": None if times is None or not clip.n_frames else times[[0, -1]].tolist(),
        "provenance": dict(clip.provenance),
    }


def _tracks(tracks: Trajectories) -> dict[str, Any]:
    lengths = tracks.lengths
    span = [int(lengths.min()), int(lengths.max()), float(lengths.mean())] if len(lengths) else None
    missing = 1 - float(tracks.visible.mean()) if tracks.visible.size else None
    return {"count": len(tracks), "shortest_longest_mean": span, "missing": missing}


def _folder(folder: Path) -> dict[str, Any]:
    if images.is_clip(folder):
        return {"kind": "frames", "folders": [_frames(folder, check=True)]}
    subfolders = [sub for sub in listed(folder) if images.has_pictures(sub)]
    if clip_files(folder) or not subfolders:
        return {"kind": "clips", "clips": [_clip(path) for path in dataset_paths(folder).values()]}
    folders = []
    for sub in subfolders:
        try:
            folders.append(_frames(sub, check=False))
        except (FileFormatError, InputFileError) as error:
            folders.append({"name": sub.name, "error": str(error)})
    return {"kind": "frames", "folders": folders}


def _frames(folder: Path, *, check: bool) -> dict[str, Any]:
    """Describe a folder of frames; with `check` see that all pictures are intact, of one size and depth."""
    paths = images.frame_paths(folder)
    first = _picture(paths[0])
    for path in paths[1:] if check else ():
        other = _picture(path)
        if other["image_size"] != first["image_size"] or other["pixels"][:4] != first["pixels"][:4]:
            expected, found = (f"{_size(facts['image_size'])}, {facts['pixels']}" for facts in (first, other))
            raise FileFormatError(f"{path}", expected=f"{expected}, as {paths[0].name}", found=found)
    numbers = [images.frame_number(paths[0]), images.frame_number(paths[-1])]
    return first | {"name": folder.name, "frames": len(paths), "numbers": numbers}


def _picture(path: Path) -> dict[str, Any]:
    picture = images.read_picture(path)
    channels = "gray" if picture.ndim == 2 else f"{picture.shape[2]} channels"
    pixels = f"{8 * picture.dtype.itemsize}-bit {channels}"
    return {"kind": "picture", "image_size": picture.shape[1::-1], "pixels": pixels}


def _video(path: Path) -> dict[str, Any]:
    shapes = [picture.shape for picture in images.read_video(path)]
    return {"kind": "video", "frames": len(shapes), "image_size": shapes[0][1::-1]}


def _flow(path: Path) -> dict[str, Any]:
    field = read_flow(path)
    with np.errstate(invalid="ignore"):  # a file may hold any NaN
        length = np.hypot(*np.moveaxis(field.astype(np.float64), -1, 0))
    known = length[np.isfinite(length)]
    facts = {"kind": "flow", "image_size": field.shape[1::-1], "known": known.size / max(1, length.size)}
    return facts | ({"mean": float(known.mean()), "longest": float(known.max())} if known.size else {})


def _clip_text(facts: Mapping[str, Any]) -> str:
    numbers, camera, time = facts["numbers"], facts["camera"], facts["time"]
    rows = {
        "clip": facts["clip"],
        "format": facts["format"],
        "frames": f"{facts['frames']}" + (f", numbered {numbers[0]}..{numbers[1]}" if numbers else ""),
        "image size": _size(facts["image_size"]),
    }
    for name in ("trajectories", "evaluated"):
        span = facts[name]["shortest_longest_mean"]
        lengths = "{} to {} frames long (mean {:.1f})".format(*span) if span else "none"
        rows[name] = f"{facts[name]['count']}, {lengths}, {_missing(facts[name])} of the positions missing"
    rows["motions"] = str(facts["n_motions"] or "0, the clip is not labelled")
    if camera:
        rows["camera"] = (camera["name"] or "unnamed") + (", K known" if camera["has_K"] else "")
    if time:
        rows["time"] = f"{time[0]:.3f} s to {time[1]:.3f} s"
    shares = [
        [f"{m['motion']} {m['name']}", str(m["trajectories"]), f"{m['share']:.1%}"] for m in facts["motions"]
    ]
    origin: dict[str, str] = {}
    for key, value in facts["provenance"].items():
        inner = value if isinstance(value, Mapping) and value else {"": value}
        origin |= {f"provenance {key} {name}".rstrip(): _value_text(part) for name, part in inner.items()}
    motions = text_table(shares, ["motion", "trajectories", "share"]) if facts["n_motions"] else ""
    return "\n\n".join(part for part in (_wrapped(rows), motions, _wrapped(origin)) if part)


def _clips_text(clips: Sequence[Mapping[str, Any]]) -> str:
    rows, totals = [], np.zeros(3, dtype=np.int64)
    for clip in clips:
        counts = [clip["frames"], clip["trajectories"]["count"], clip["evaluated"]["count"]]
        totals += counts
        motions = " ".join(str(m["trajectories"]) for m in clip["motions"] if m["motion"]) or "-"
        sizes = [clip["n_motions"], motions, _missing(clip["evaluated"]), _size(clip["image_size"])]
        rows.append([clip["clip"], *counts, *sizes])
    rows.append([count(len(clips), "clip"), *totals, "", "", "", ""])
    header = ["clip", "frames", "dense", "evaluated", "motions", "per motion", "missing", "image size"]
    return text_table([[*map(str, row)] for row in rows], header)


def _frames_row(row: Mapping[str, Any]) -> list[str]:
    if "error" in row:
        return [row["name"], "-", "-", "-", "-", row["error"]]
    first, last = row["numbers"]
    return [row["name"], str(row["frames"]), f"{first}..{last}", _size(row["image_size"]), row["pixels"], ""]


def _missing(tracks: Mapping[str, Any]) -> str:
    return "-" if tracks["missing"] is None else f"{tracks['missing']:.1%}"


def _size(size: Sequence[int] | None) -> str:
    return "unknown" if size is None else f"{size[0]}x{size[1]}"


def _wrapped(rows: Mapping[str, str]) -> str:
    """Lay out names and texts; a long text goes on below itself."""
    width = max(map(len, rows), default=0) + 2
    wrapper = textwrap.TextWrapper(_LINE, break_long_words=False, break_on_hyphens=False)
    wrapper.subsequent_indent = " " * width
    return "\n".join(wrapper.fill(f"{name:<{width}}{text}") for name, text in rows.items())


def _value_text(value: object) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_value_text(inner)}" for key, inner in value.items()) or "none"
    text = str(value)
    return text if 0 < len(text) <= _LONG else f"{text[: _LONG - 3]}..." if text else "none"
