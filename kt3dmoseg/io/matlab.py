"""Clips in MAT-files: the 2018 KT3DMoSeg release, Hopkins12 and MTPV62, and Hopkins155.

The release, Hopkins12 and MTPV62 share a struct `Data`: `yAll` (3, N, F) and `ySparse` (3, n, F) are
homogeneous pixels, (0, 0, 0) where invisible; `visibleAll` (N, F) and `visibleSparse` (n, F) show where they
are; `SparseIndex` (n, 1) counts the evaluated rows of `yAll` from 1; `GtLabel` (n, 1) holds the motions, 0 an
outlier. Only we write `Background`: the motion of the static scene where it is not 1, 0 when it is unknown.

Hopkins155 (Tron and Vidal, CVPR 2007) has one ``<sequence>_truth.mat`` each: `y` (3, P, F) homogeneous
pixels, `s` (P, 1) the motions from 1, `K` (3, 3) the matrix that normalised them, `width` and `height` of the
images. The additional sequences carry a mask `m` (P, F), 1 where a point is visible, and label outliers 0;
without it the trajectories are complete.

These conventions end here: inside, coordinates are (N, F, 2) with NaN where invisible and rows count from 0.
"""

from __future__ import annotations

import io
import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from kt3dmoseg.errors import FileFormatError, InvalidValueError
from kt3dmoseg.files import write_bytes
from kt3dmoseg.io.fields import Fields, clip_name, clip_of_tracks, origin
from kt3dmoseg.io.mat5 import MAX_BYTES, read_mat
from kt3dmoseg.types import BoolArray, Camera, Clip, FloatArray, Labels, Trajectories

# Instead of the platform and the date that scipy writes, so that equal content gives equal bytes.
_TEXT = b"MATLAB 5.0 MAT-file, written by kt3dmoseg".ljust(116)
# In the release the static scene is motion 1 in every clip; the other collections do not define it.
_BACKGROUND = 1
_DENSE = ("nAllPoints", "yAll", "visibleAll")
_ALL_FIELDS = (*_DENSE, "nFrames", "nSparsePoints", "ySparse", "visibleSparse", "SparseIndex", "GtLabel")
_MINE = "Background"


def read(path: str | os.PathLike[str]) -> Clip:
    """Read a clip; it takes the name of its file.

    `dense` holds `yAll`; without it the labelled trajectories, all of them evaluated. Without a mask every
    point counts as visible.
    """
    variables = read_mat(path)
    data = variables.get("Data")
    if {"y", "s"} <= set(variables):
        return _hopkins(path, variables)
    if isinstance(data, dict) and {"ySparse", "GtLabel"} <= set(data):
        return _release(path, data)
    inside = f", Data with the fields {', '.join(sorted(data))}" if isinstance(data, dict) else ""
    raise FileFormatError(
        os.fspath(path),
        expected="a struct Data with ySparse and GtLabel, or the variables y and s",
        found=f"variables {', '.join(sorted(variables)) or 'none'}{inside}",
        fix="give a KT3DMoSeg, Hopkins12 or MTPV62 *_Tracks.mat, or a Hopkins155 *_truth.mat",
    )


def write(clip: Clip, path: str | os.PathLike[str]) -> None:
    """Write a clip as a MAT-file of the 2018 schema; the same clip gives the same bytes.

    A clip that was read from such a file gets the fields that its file had (Hopkins12 and MTPV62
    have no `yAll`), as far as they still hold everything. Names of motions, frame numbers, image
    size and camera are not part of the schema.
    """
    from scipy.io import savemat  # a reader does without: importing it takes longer than reading a file

    values = _field_values(clip)
    if (size := 8 * values["yAll"].size) > MAX_BYTES:
        raise InvalidValueError("MAT-file", expected=f"at most {MAX_BYTES} bytes", found=f"{size}")
    buffer = io.BytesIO()
    fields = [name for name in _wanted_fields(clip) if name != _MINE]
    data = {name: values[name] for name in fields}
    if clip.labels.background != (_BACKGROUND if "yAll" in fields else None):
        data[_MINE] = float(clip.labels.background or 0)
    savemat(buffer, {"Data": data}, do_compression=True)  # type: ignore[arg-type]  # a stream will do
    write_bytes(path, _TEXT + buffer.getvalue()[len(_TEXT) :])


def _release(path: str | os.PathLike[str], data: Mapping[str, Any]) -> Clip:
    fields = Fields(f"{os.fspath(path)}: Data.", data)
    n, frames = _layout(fields, "ySparse", "GtLabel")
    label = fields.integers("GtLabel", n, 0, 1 << 31)
    sparse, sparse_visible = _points(fields, "ySparse", "visibleSparse")
    dense, visible, rows = sparse, sparse_visible, np.arange(n)
    if released := "yAll" in fields:
        count = fields.array("yAll", (3, None, frames)).shape[1]
        dense, visible = _points(fields, "yAll", "visibleAll")
        rows = fields.integers("SparseIndex", n, 1, count) - 1
        if not np.array_equal(dense[rows], sparse, equal_nan=True):
            raise fields.error("ySparse", "the rows SparseIndex of yAll", "other coordinates")
        if len(np.unique(rows)) != n:
            raise fields.error("SparseIndex", "rows each given once", "a row given twice")
    for name, actual in (("nFrames", frames), ("nSparsePoints", n), ("nAllPoints", len(dense))):
        if name in fields and (stated := fields.integers(name, 1, 0, 1 << 31)[0]) != actual:
            raise fields.error(name, f"{actual}, as the arrays hold", str(stated))
    provenance = origin(path, "mat-2018") | {"fields": list(data)}
    if isinstance(data.get("Name"), str):
        provenance["Name"] = data["Name"]
    if "visibleSparse" not in fields:
        provenance["visibility"] = "the file has no mask: every point taken as visible"
    return Clip(
        name=clip_name(path),
        dense=Trajectories(dense, visible),
        evaluated=rows,
        labels=Labels(label, background=_background(fields, _BACKGROUND if released else None)),
        provenance=provenance,
    )


def _background(fields: Fields, default: int | None) -> int | None:
    return int(fields.integers(_MINE, 1, 0, 1 << 31)[0]) or None if _MINE in fields else default


def _hopkins(path: str | os.PathLike[str], variables: Mapping[str, Any]) -> Clip:
    fields = Fields(f"{os.fspath(path)}: ", variables)
    _layout(fields, "y", "s")
    xy, visible = _points(fields, "y", "m")
    for name, size in (("K", 9), ("width", 1), ("height", 1)):
        if fields.array(name).size != size:
            raise fields.error(name, f"{size} numbers", f"{fields.array(name).size}")
    image_size = (fields.array("width").item(), fields.array("height").item())
    dense = Trajectories(xy, visible, image_size=image_size)
    camera = Camera(K=fields.array("K").reshape(3, 3))
    return clip_of_tracks(path, "hopkins155", dense, fields.integers("s", len(xy), 0, 999), camera)


def _layout(fields: Fields, name: str, labels: str) -> tuple[int, int]:
    """Return points and frames of homogeneous pixels (3, N, F), which must not be (3, F, N)."""
    n, frames = fields.array(name, (3, None, None)).shape[1:]
    if fields.array(labels).size == frames != n:
        fix = f"permute its last two dimensions: there are {frames} {labels}"
        raise fields.error(name, f"3 x {frames} points x {n} frames", f"3 x {n} x {frames}", fix)
    return n, frames


def _points(fields: Fields, name: str, mask: str) -> tuple[FloatArray, BoolArray]:
    """Return positions and visibility from homogeneous pixels and their mask, if there is one."""
    y = fields.array(name, (3, None, None)).astype(np.float64)
    stated = fields.array(mask, y.shape[1:]) if mask in fields else np.ones(y.shape[1:], dtype=np.bool_)
    if not np.isin(stated, (0, 1)).all():
        raise fields.error(mask, "0 or 1", "others")
    visible = stated.astype(np.bool_)
    if not (np.isfinite(y[:2, visible]).all() and (y[2, visible] == 1).all()):
        raise fields.error(name, "finite (x, y, 1) where visible", "another value")
    return np.where(visible[..., None], np.moveaxis(y[:2], 0, -1), np.nan), visible


def _wanted_fields(clip: Clip) -> Sequence[str]:
    given = clip.provenance.get("fields")
    known = {*_ALL_FIELDS, "Name", _MINE}
    if not isinstance(given, list) or not {"ySparse", "GtLabel"} <= set(given) <= known:
        return _ALL_FIELDS
    whole = np.array_equal(clip.evaluated, np.arange(len(clip.dense)))
    has_dense = {"yAll", "visibleAll", "SparseIndex"} <= set(given)
    has_mask = "visibleSparse" in given or bool(clip.dense.visible.all())
    return given if (has_dense or whole) and has_mask else _ALL_FIELDS


def _field_values(clip: Clip) -> dict[str, Any]:
    sparse = clip.evaluated_trajectories
    return {
        "Name": str(clip.provenance.get("Name", clip.name)),
        "nAllPoints": float(len(clip.dense)),
        "yAll": _homogeneous(clip.dense),
        "visibleAll": clip.dense.visible,
        "nFrames": float(clip.n_frames),
        "nSparsePoints": float(len(sparse)),
        "ySparse": _homogeneous(sparse),
        "visibleSparse": sparse.visible,
        "SparseIndex": (clip.evaluated[:, None] + 1).astype(np.float64),
        "GtLabel": clip.labels.label[:, None].astype(np.float64),
    }


def _homogeneous(trajectories: Trajectories) -> FloatArray:
    """Return (3, N, F): x, y, 1 where visible, else 0, 0, 0."""
    points = np.concatenate([trajectories.xy, np.ones_like(trajectories.xy[..., :1])], axis=2)
    return np.moveaxis(np.where(trajectories.visible[..., None], points, 0.0), -1, 0)
