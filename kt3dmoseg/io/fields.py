"""What every clip format shares: checked arrays and texts of a file, names, provenance as JSON."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import FileFormatError, InvalidValueError
from kt3dmoseg.files import parse_json, sha256_file
from kt3dmoseg.types import Camera, Clip, IntArray, Labels, Trajectories

_ENDINGS = ("_Tracks", "_truth")
_LONGEST = 200
_NUMBER = re.compile(r"-?[0-9]{1,18}")
NUMBERS = "biuf"
_WORDS = {NUMBERS: "numbers", "iu": "whole numbers", "f": "floating-point numbers", "b": "true or false"}


class Fields:
    """Checked access to the named `values` of a file; `prefix` precedes their names in messages."""

    def __init__(self, prefix: str, values: Mapping[str, Any]) -> None:
        self.prefix, self.values = prefix, values

    def __contains__(self, name: str) -> bool:
        """Whether there is a field of that name."""
        return name in self.values

    def array(
        self, name: str, shape: tuple[int | None, ...] | None = None, kinds: str = NUMBERS
    ) -> npt.NDArray[Any]:
        """Return an array of numbers; in `shape` None is any size, without it any shape will do."""
        value = self.values.get(name)
        wanted = " x ".join("any" if n is None else str(n) for n in shape or ())
        if not isinstance(value, np.ndarray) or value.dtype.kind not in kinds:
            found = f"only {', '.join(sorted(self.values))}" if value is None else _describe(value)
            raise self.error(name, f"{_WORDS[kinds]} {wanted}".strip(), found)
        if shape is None:
            return value
        # MATLAB drops a third dimension of size one.
        full = value[..., None] if len(shape) == 3 and value.ndim == 2 else value
        fits = full.ndim == len(shape) and all(w in (None, n) for w, n in zip(shape, full.shape, strict=True))
        if not fits:
            found = " x ".join(map(str, value.shape)) or "one value"
            turned = full.ndim == len(shape) > 1 and {*shape} - {None} <= {*full.shape}
            fix = f"is it transposed? it must be {wanted}" if turned else ""
            raise self.error(name, wanted or "one value", found, fix)
        return full

    def integers(self, name: str, count: int, low: int, high: int) -> IntArray:
        """Return so many whole numbers within bounds, from a row, a column or a vector."""
        given = self.array(name)
        if given.size != count or (given.size and given.size != max(given.shape, default=1)):
            raise self.error(name, f"a vector of {count}", " x ".join(map(str, given.shape)) or "one value")
        values = given.astype(np.float64).ravel()
        good = np.isfinite(values) & (values >= low) & (values <= high)
        good[good] &= values[good] == np.floor(values[good])
        if not good.all():
            raise self.error(name, f"whole numbers {low}..{high}", repr(float(values[~good][0])))
        return values.astype(np.int64)

    def text(self, name: str) -> str:
        """Return a text."""
        value = self.values[name]
        if isinstance(value, np.ndarray) and value.dtype.kind == "U" and value.shape == ():
            return str(value)
        if not isinstance(value, str):
            raise self.error(name, "a text", _describe(value))
        return value

    def error(self, name: str, expected: str, found: str, fix: str = "") -> FileFormatError:
        """Make the error that names the field."""
        return FileFormatError(f"{self.prefix}{name}", expected=expected, found=found, fix=fix)


def _describe(value: object) -> str:
    if isinstance(value, np.ndarray):
        return f"{value.dtype} of shape {value.shape}"
    return "a text" if isinstance(value, str) else "a struct" if isinstance(value, dict) else str(value)


def clip_name(path: str | os.PathLike[str]) -> str:
    """Return the clip's name: the file's stem without ``_Tracks`` or ``_truth``.

    >>> clip_name("release/Seq028_clip03_Tracks.mat"), clip_name("cars1_truth.mat")
    ('Seq028_clip03', 'cars1')
    """
    stem = Path(path).stem
    for ending in _ENDINGS:
        stem = stem.removesuffix(ending)
    return stem


def check_name(name: str, where: str) -> None:
    """Raise InvalidValueError when a clip's name is empty, too long, or leads elsewhere as a file's name."""
    if not name.isprintable() or name in ("", ".", "..") or len(name) > _LONGEST or set(name) & set("/\\"):
        expected = f"a clip's name, at most {_LONGEST} characters without a slash"
        raise InvalidValueError(where, expected=expected, found=f"{name!r}")


def origin(path: str | os.PathLike[str], format: str) -> dict[str, Any]:
    """Return the provenance of a clip that was read from another format: format, file name, checksum."""
    return {"format": format, "source": Path(path).name, "sha256": sha256_file(path)}


def clip_of_tracks(
    path: str | os.PathLike[str],
    format: str,
    dense: Trajectories,
    label: IntArray | None = None,
    camera: Camera | None = None,
) -> Clip:
    """Return a clip from a format that holds only tracks: named by its file, all of them evaluated."""
    label = np.zeros(len(dense), dtype=np.int64) if label is None else label
    rows = np.arange(len(dense))
    return Clip(clip_name(path), dense, rows, Labels(label), camera=camera, provenance=origin(path, format))


def clip_values(clip: Clip) -> dict[str, Any]:
    """Return everything of a clip but positions and visibility; what is not known is left out."""
    size, background, camera = clip.dense.image_size, clip.labels.background, clip.camera
    values: dict[str, Any] = {
        "name": clip.name,
        "track_id": clip.dense.track_id,
        "evaluated": clip.evaluated,
        "label": clip.labels.label,
        "label_names": _json_text({str(k): v for k, v in clip.labels.names.items()}, "names"),
        "frame_numbers": clip.frame_numbers,
        "provenance": _json_text(clip.provenance, "provenance"),
        "image_size": None if size is None else np.array(size, dtype=np.int64),
        "background": None if background is None else np.int64(background),
        "timestamps": clip.timestamps,
        "camera_name": None if camera is None else camera.name,
        "K": None if camera is None else camera.K,
    }
    for name in ("name", "label_names", "provenance", "camera_name"):
        try:
            (values[name] or "").encode()
        except UnicodeEncodeError:  # half of a pair of UTF-16, as Python reads a byte of a file's name
            raise InvalidValueError(name, expected="text in UTF-8", found=ascii(values[name])[:80]) from None
    return {name: value for name, value in values.items() if value is not None}


def clip_from(values: Mapping[str, Any], prefix: str) -> Clip:
    """Return the clip of what `clip_values` gave, `xy` and `visible`; `prefix` precedes names in messages."""
    background = values.get("background")
    has_camera = "K" in values or "camera_name" in values
    names = json_object(values.get("label_names", "{}"), f"{prefix}label_names")
    odd = next((key for key in names if not _NUMBER.fullmatch(key)), None)
    if odd is not None:
        raise FileFormatError(f"{prefix}label_names", expected="numbers of motions", found=repr(odd))
    return Clip(
        name=values["name"],
        dense=Trajectories(values["xy"], values["visible"], values["track_id"], values.get("image_size")),
        evaluated=values["evaluated"],
        labels=Labels(
            values["label"],
            None if background is None else int(background),
            {int(key): str(name) for key, name in names.items()},
        ),
        frame_numbers=values["frame_numbers"],
        timestamps=values.get("timestamps"),
        camera=Camera(values.get("camera_name", ""), values.get("K")) if has_camera else None,
        provenance=json_object(values.get("provenance", "{}"), f"{prefix}provenance"),
    )


def _json_text(values: Mapping[str, Any], what: str) -> str:
    """Return JSON with sorted keys, so that equal values give equal bytes."""
    try:
        return json.dumps(dict(values), sort_keys=True, ensure_ascii=False, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InvalidValueError(what, expected="JSON values", found=str(error)) from None


def json_object(text: str, where: str) -> dict[str, Any]:
    """Parse a JSON object."""
    values = parse_json(text, where)
    if not isinstance(values, dict):
        raise FileFormatError(where, expected="a JSON object", found=type(values).__name__)
    return values
