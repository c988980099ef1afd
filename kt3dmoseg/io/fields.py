"""The gate of every clip format: what a clip's file holds, checked by name and made a clip."""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import FileFormatError, InvalidValueError
from kt3dmoseg.files import PathLike, parse_json, sha256_file
from kt3dmoseg.types import BoolArray, Camera, Clip, FloatArray, IntArray, Labels, Trajectories

_LONGEST = 200
_FRACTION = 1.5  # a clip whose every coordinate is smaller is not in pixels
_FAR = 1e9
CLEAR = 1.5  # a reading is surely wrong when another one is so many times better
_SHAKEN = 3.0  # pixels that a shaking camera may bend paths by
_MOST = 1000  # tracks and frames that are looked at, evenly spaced
_NUMBER = re.compile(r"-?[0-9]{1,18}")
NUMBERS, TEXT = "biuf", "U"
_KINDS = {NUMBERS: "numbers", "iu": "whole numbers", "f": "floating-point numbers", "bu": "true or false"}
_KINDS[TEXT] = "a text"


class Field(NamedTuple):
    """One value of a clip: its kinds in numpy's letters, where HDF5 has it, what it is called."""

    kinds: str
    place: str
    words: str
    about: str = ""  # of a dataset in HDF5; the others are attributes


# What the formats hold that keep everything, in the order in which HDF5 is written.
FIELDS = {
    "xy": Field(
        "f",
        "dense/xy",
        "coordinates",
        "(N, F, 2) positions, x right, y down, pixels; (0, 0) is the centre of the top-left pixel; "
        "NaN where not visible",
    ),
    "visible": Field(
        "bu", "dense/visible", "coordinates", "(N, F) 1 where the trajectory exists in the frame, else 0"
    ),
    "track_id": Field("iu", "dense/track_id", "track ids", "(N,) identity of each trajectory"),
    "evaluated": Field(
        "iu", "evaluated", "which trajectories are evaluated", "(n,) rows of dense that are scored, from 0"
    ),
    "label": Field(
        "iu", "labels/label", "labels", "(n,) motion of each evaluated trajectory; 0 = unlabelled or outlier"
    ),
    "frame_numbers": Field("iu", "frames/number", "frame numbers", "(F,) number of each frame in its source"),
    "timestamps": Field("f", "frames/timestamp", "timestamps", "(F,) seconds"),
    "K": Field("f", "camera/K", "camera", "(3, 3) normalised to pixel coordinates"),
    "name": Field(TEXT, "name", "name"),
    "provenance": Field(TEXT, "provenance", "provenance"),
    "label_names": Field(TEXT, "labels/names", "names of the motions"),
    "image_size": Field(NUMBERS, "dense/image_size", "image size"),
    "background": Field("iu", "labels/background", "which label is the background"),
    "camera_name": Field(TEXT, "camera/name", "camera"),
}
NEEDED = {"name", "xy", "visible", "track_id", "evaluated", "label", "frame_numbers"}


class Fields(dict[str, Any]):
    """The named values of a file, and checked access to them; `prefix` precedes their names in messages."""

    def __init__(self, prefix: str, values: Mapping[str, Any]) -> None:
        super().__init__(values)
        self.prefix = prefix

    def array(
        self, name: str, shape: tuple[int | None, ...] | None = None, kinds: str = NUMBERS
    ) -> npt.NDArray[Any]:
        """Return an array; in `shape` None is any size, without it any shape will do."""
        given = self.get(name)
        value = np.asarray(given if isinstance(given, np.ndarray | np.generic | str) else None)
        wanted = " x ".join("any" if n is None else str(n) for n in shape or ())
        if value.dtype.kind not in kinds:
            raise self.error(name, f"{_KINDS[kinds]} {wanted}".strip())
        if shape is None:
            return value
        # MATLAB drops a third dimension of size one.
        full = value[..., None] if len(shape) == 3 and value.ndim == 2 else value
        if full.ndim != len(shape) or any(w not in (None, n) for w, n in zip(shape, full.shape, strict=True)):
            turned = full.ndim == len(shape) > 1 and {*shape} - {None} <= {*full.shape}
            fix = f"is it transposed? it must be {wanted}" if turned else ""
            raise self.error(name, wanted or "one value", _by(value.shape), fix)
        return full

    def integers(self, name: str, count: int, low: int = 0, high: int = 1 << 31) -> IntArray:
        """Return so many whole numbers within bounds, from a row, a column or a vector."""
        given = self.array(name)
        if given.size != count or (given.size and given.size != max(given.shape, default=1)):
            raise self.error(name, f"a vector of {count}", _by(given.shape))
        values = given.astype(np.float64).ravel()
        good = (values >= low) & (values <= high) & (values == np.floor(values))
        if not good.all():
            raise self.error(name, f"whole numbers {low}..{high}", repr(float(values[~good][0])))
        return values.astype(np.int64)

    def flags(self, name: str, shape: tuple[int, ...]) -> BoolArray:
        """Return an array that is 0 or 1 everywhere."""
        values = self.array(name, shape)
        if not np.isin(values, (0, 1)).all():
            raise self.error(name, "0 or 1", f"{values.min():g} to {values.max():g}")
        return values.astype(np.bool_)

    def json(self, name: str) -> dict[str, Any]:
        """Parse a text that is a JSON object; it is empty when there is none."""
        text = str(self.array(name, (), TEXT)) if name in self else "{}"
        values = parse_json(text, f"{self.prefix}{name}")
        if not isinstance(values, dict):
            raise self.error(name, "a JSON object", type(values).__name__)
        return values

    def error(self, name: str, expected: str, found: str = "", fix: str = "") -> FileFormatError:
        """Make the error that names the field, by default with the value that it has."""
        value = self.get(name)
        if name not in self:
            found = found or f"only {', '.join(sorted(self))}"
        elif isinstance(value, np.ndarray | np.generic):
            found = found or f"{value.dtype} of shape {value.shape}"
        kinds: dict[type, str] = {str: "a text", dict: "a struct", list: "cells"}
        found = found or kinds.get(type(value), str(value))
        return FileFormatError(f"{self.prefix}{name}", expected=expected, found=found, fix=fix)


def _by(shape: tuple[int, ...]) -> str:
    return " x ".join(map(str, shape)) or "one value"


def clip_name(path: PathLike) -> str:
    """Return the clip's name: the file's stem without ``_Tracks`` or ``_truth``.

    >>> clip_name("release/Seq028_clip03_Tracks.mat"), clip_name("cars1_truth.mat")
    ('Seq028_clip03', 'cars1')
    """
    return Path(path).stem.removesuffix("_Tracks").removesuffix("_truth")


def check_name(name: str, where: str) -> None:
    """Raise InvalidValueError when a clip's name is empty, too long, or leads elsewhere as a file's name."""
    if not name.isprintable() or name in ("", ".", "..") or len(name) > _LONGEST or set(name) & set("/\\"):
        expected = f"a clip's name in UTF-8, at most {_LONGEST} characters without a slash"
        raise InvalidValueError(where, expected=expected, found=f"{name!r}")


def check_axes(name: str, xy: FloatArray, visible: BoolArray) -> None:
    """Refuse positions (N, F, 2) that are no pixels, or whose visibility or axes are exchanged.

    A path bends less in time than from one track to the next.
    """
    for value in (0, -1):  # of positions, some would have only one coordinate of that value
        at = visible[..., None] & (xy == value)
        points = at.all(axis=2)
        if (points.sum(axis=0) > 1).any() and (points == at.any(axis=2)).all():
            found = f"{points.sum()} at exactly ({value}, {value})"
            fix = "where a point is not visible, say so, or give NaN"
            raise InvalidValueError(name, expected="positions of visible points", found=found, fix=fix)
    seldom = int((visible.sum(axis=1) < 2).sum())
    if visible.shape[1] > 2 and visible.any() and 2 * seldom > len(visible):
        expected, found = "most tracks in two frames or more", f"{seldom} of {len(visible)} in fewer"
        raise InvalidValueError(
            "visible", expected=expected, found=found, fix="True is visible, not occluded"
        )
    if visible.any() and (farthest := np.abs(xy[visible]).max()) <= _FRACTION:
        fix = "multiply fractions by width and height, and subtract 0.5"
        raise InvalidValueError(name, expected="pixels", found=f"at most {farthest:g}", fix=fix)
    across, along = bends(xy, visible)
    if along > CLEAR * max(across, _SHAKEN):
        expected = "paths that bend less in time than from track to track"
        found = f"{along:.3g} px from frame to frame, {across:.3g} px from track to track"
        fix = "exchange the axes of tracks and frames, or give kt3dmoseg.Trajectories if they are right"
        raise InvalidValueError(name, expected=expected, found=found, fix=fix)


def bends(xy: FloatArray, visible: BoolArray) -> tuple[float, float]:
    """Mean second difference of positions (N, F, 2) from track to track, and in time, in pixels.

    NaN of fewer than three. In time it is at most 0.6 of the other for each clip, and for each motion by
    itself, of the release, Hopkins155, Hopkins12, MTPV62, our builds and the synthetic drives.
    """
    some = slice(None, None, len(xy) // _MOST + 1), slice(None, None, xy.shape[1] // _MOST + 1)
    xy, visible = xy[some], visible[some]
    visible = visible & (np.abs(xy) < _FAR).all(axis=2)
    xy = np.where(visible[..., None], xy, 0.0)

    def bend(xy: FloatArray, visible: BoolArray) -> float:
        seen = visible[2:] & visible[1:-1] & visible[:-2]
        bent = (xy[2:] - 2 * xy[1:-1] + xy[:-2])[seen]
        return float(np.hypot(*bent.T).mean()) if len(bent) else np.nan

    return bend(xy, visible), bend(xy.swapaxes(0, 1), visible.T)


def foreign_clip(
    path: PathLike,
    format: str,
    dense: Trajectories,
    labels: Labels | None = None,
    rows: IntArray | None = None,
    camera: Camera | None = None,
    **provenance: Any,  # noqa: ANN401  # JSON
) -> Clip:
    """Return a clip of another format, named by its file; by default all is evaluated, nothing labelled."""
    rows = np.arange(len(dense)) if rows is None else rows
    labels = Labels(np.zeros(len(rows), dtype=np.int64)) if labels is None else labels
    origin = {"format": format, "source": Path(path).name, "sha256": sha256_file(path)}
    return Clip(clip_name(path), dense, rows, labels, camera=camera, provenance=origin | provenance)


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
    for name in (name for name, value in values.items() if isinstance(value, str)):
        try:
            values[name].encode()
        except UnicodeEncodeError:  # half of a pair of UTF-16, as Python reads a byte of a file's name
            raise InvalidValueError(name, expected="text in UTF-8", found=ascii(values[name])[:80]) from None
    check_name(clip.name, "name")
    return {name: value for name, value in values.items() if value is not None}


def clip_from(fields: Fields) -> Clip:
    """Return the clip of a file that has what `FIELDS` lists."""
    got: dict[str, Any] = {}
    for name in (name for name in FIELDS if name in NEEDED or name in fields):
        kinds = FIELDS[name].kinds
        got[name] = fields.array(name, () if kinds == TEXT or name == "background" else None, kinds)
        got[name].flags.writeable = False  # a clip takes it as it is, without a copy
    check_name(str(got["name"]), "name")
    names = fields.json("label_names")
    odd = next((key for key in names if not _NUMBER.fullmatch(key)), None)
    if odd is not None:
        raise fields.error("label_names", "numbers of motions", repr(odd))
    motions = {int(key): str(name) for key, name in names.items()}
    has_camera = "K" in got or "camera_name" in got
    return Clip(
        name=str(got["name"]),
        dense=Trajectories(got["xy"], got["visible"], got["track_id"], got.get("image_size")),
        evaluated=got["evaluated"],
        labels=Labels(got["label"], got.get("background"), motions),
        frame_numbers=got["frame_numbers"],
        timestamps=got.get("timestamps"),
        camera=Camera(str(got.get("camera_name", "")), got.get("K")) if has_camera else None,
        provenance=fields.json("provenance"),
    )


def _json_text(values: Mapping[str, Any], what: str) -> str:
    """Return JSON with sorted keys, so that equal values give equal bytes."""
    try:
        return json.dumps(dict(values), sort_keys=True, ensure_ascii=False, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InvalidValueError(what, expected="JSON values", found=str(error)) from None
