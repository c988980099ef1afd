"""A clip as a plain NumPy .npz, for those who have no HDF5; docs/formats.md lists the arrays."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import numpy.typing as npt

from kt3dmoseg.arrays import image_size
from kt3dmoseg.errors import FileFormatError
from kt3dmoseg.io import point_tracks
from kt3dmoseg.io.npy import npz_shapes, read_npz, write_npz
from kt3dmoseg.io.text import json_object, json_text, motion_names
from kt3dmoseg.types import Camera, Clip, Labels, Trajectories

KEYS = {"xy", "visible", "evaluated", "label", "track_id", "frame_numbers", "name"}


def write(clip: Clip, path: str | os.PathLike[str]) -> None:
    """Write a clip; the same clip gives the same bytes."""
    dense, labels = clip.dense, clip.labels
    optional = {
        "image_size": dense.image_size,
        "background": labels.background,
        "timestamps": clip.timestamps,
        "camera_name": None if clip.camera is None else clip.camera.name,
        "K": None if clip.camera is None else clip.camera.K,
    }
    arrays = {
        "name": np.array(clip.name),
        "xy": dense.xy,
        "visible": dense.visible,
        "track_id": dense.track_id,
        "evaluated": clip.evaluated,
        "label": labels.label,
        "label_names": np.array(json_text({str(k): v for k, v in labels.names.items()}, "names")),
        "frame_numbers": clip.frame_numbers,
        "provenance": np.array(json_text(clip.provenance, "provenance")),
    }
    write_npz(path, arrays | {k: np.asarray(v) for k, v in optional.items() if v is not None})


def read(path: str | os.PathLike[str]) -> Clip:
    """Read a clip; see `kt3dmoseg.io.load` for the errors."""
    where = os.fspath(path)
    arrays = _Arrays(where, read_npz(path))
    names = motion_names(arrays.text("label_names", "{}"), f"{where}: label_names")
    size = arrays.get("image_size", "iu", (2,))
    background = arrays.get("background", "iu", ())
    has_camera = "K" in arrays or "camera_name" in arrays
    return Clip(
        name=arrays.text("name", None),
        dense=Trajectories(
            arrays.need("xy", "f", 3),
            arrays.need("visible", "b", 2),
            arrays.need("track_id", "iu", 1),
            None if size is None else image_size(size),
        ),
        evaluated=arrays.need("evaluated", "iu", 1),
        labels=Labels(
            arrays.need("label", "iu", 1),
            None if background is None else int(background),
            names,
        ),
        frame_numbers=arrays.need("frame_numbers", "iu", 1),
        timestamps=arrays.get("timestamps", "f", None),
        camera=Camera(arrays.text("camera_name", ""), arrays.get("K", "f", (3, 3))) if has_camera else None,
        provenance=json_object(arrays.text("provenance", "{}"), f"{where}: provenance"),
    )


def read_any(path: str | os.PathLike[str]) -> Clip:
    """Read a clip, or the output of CoTracker or a video of TAP-Vid."""
    names = set(npz_shapes(path))
    if names >= point_tracks.COTRACKER_KEYS:
        return point_tracks.read_cotracker(path)
    if names >= point_tracks.TAPVID_KEYS:
        return point_tracks.read_tapvid(path)
    if names >= KEYS:
        return read(path)
    raise FileFormatError(
        os.fspath(path),
        expected=f"the arrays {', '.join(sorted(KEYS))} of a clip",
        found=", ".join(sorted(names)) or "none",
        fix="the arrays of CoTracker and of TAP-Vid (points, occluded, video) are read too",
    )


class _Arrays:
    """Checked access to the arrays of the file."""

    def __init__(self, where: str, arrays: dict[str, npt.NDArray[Any]]) -> None:
        self.where, self.arrays = where, arrays

    def __contains__(self, name: str) -> bool:
        return name in self.arrays

    def need(self, name: str, kinds: str, ndim: int) -> npt.NDArray[Any]:
        array = self.arrays.get(name)
        if array is None or array.dtype.kind not in kinds or array.ndim != ndim:
            found = "nothing" if array is None else f"{array.dtype} with {array.ndim}"
            raise self.fail(name, f"type {'/'.join(kinds)} with {ndim} dimensions", found)
        return array

    def get(self, name: str, kinds: str, shape: tuple[int, ...] | None) -> npt.NDArray[Any] | None:
        array = self.arrays.get(name)
        if array is not None and (array.dtype.kind not in kinds or shape not in (None, array.shape)):
            raise self.fail(name, f"type {'/'.join(kinds)}, shape {shape}", f"{array.dtype} {array.shape}")
        return array

    def text(self, name: str, default: str | None) -> str:
        array = self.arrays.get(name)
        if array is None and default is not None:
            return default
        if array is None or array.dtype.kind != "U" or array.shape != ():
            raise self.fail(name, "a text", "nothing" if array is None else f"{array.dtype}")
        return str(array)

    def fail(self, name: str, expected: str, found: str) -> FileFormatError:
        return FileFormatError(f"{self.where}: {name}", expected=expected, found=found)
