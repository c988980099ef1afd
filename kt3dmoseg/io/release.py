"""The struct `Data` of the 2018 KT3DMoSeg release, which Hopkins12 and MTPV62 share.

`yAll` (3, N, F) and `ySparse` (3, n, F) are homogeneous pixels, (0, 0, 0) where invisible;
`visibleAll` (N, F) and `visibleSparse` (n, F) say where they are; `SparseIndex` (n, 1) counts the
evaluated rows of `yAll` from 1; `GtLabel` (n, 1) holds the motions, 0 an outlier. These conventions
end here: inside, coordinates are (N, F, 2) with NaN where invisible and rows count from 0.
"""

from __future__ import annotations

import io
import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.io import savemat

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.files import write_bytes
from kt3dmoseg.io.fields import Fields, clip_name, origin
from kt3dmoseg.types import BoolArray, Clip, FloatArray, Labels, Trajectories

_LARGEST = 1 << 30  # as much as is read back
# In place of the platform and the date that scipy writes, so that equal content gives equal bytes.
_TEXT = b"MATLAB 5.0 MAT-file, written by kt3dmoseg".ljust(116)
# In the release the static scene is motion 1 in every clip; the other collections do not say.
_BACKGROUND = 1
_ALL_FIELDS = (
    "nAllPoints",
    "yAll",
    "visibleAll",
    "nFrames",
    "nSparsePoints",
    "ySparse",
    "visibleSparse",
    "SparseIndex",
    "GtLabel",
)


def read(path: str | os.PathLike[str], data: Mapping[str, Any]) -> Clip:
    """Read a clip from a MAT-file of the 2018 release, Hopkins12 or MTPV62.

    Parameters
    ----------
    path : path
        The file; the clip takes its name.
    data : mapping of str to value
        Fields of its struct `Data`.

    Returns
    -------
    Clip
        Without `yAll`, `dense` holds the labelled trajectories, all of them evaluated. Without a
        visibility mask every point counts as visible.

    Raises
    ------
    FileFormatError
        When the struct lacks a field or its fields contradict each other.
    """
    fields = Fields(f"{os.fspath(path)}: Data.", data)
    sparse_y = fields.array("ySparse", (3, None, None))
    n, frames = sparse_y.shape[1:]
    label = fields.whole("GtLabel", (n, 1), 0, 1 << 31)
    sparse, sparse_visible = _points(fields, "Sparse", (n, frames))
    released = "yAll" in fields
    dense, visible, rows = sparse, sparse_visible, np.arange(n)
    if released:
        count = fields.array("yAll", (3, None, frames)).shape[1]
        dense, visible = _points(fields, "All", (count, frames))
        rows = fields.whole("SparseIndex", (n, 1), 1, count) - 1
        if not np.array_equal(dense[rows], sparse, equal_nan=True):
            raise fields.error("ySparse", "the rows SparseIndex of yAll", "other coordinates")
        if len(np.unique(rows)) != n:
            raise fields.error("SparseIndex", "rows each given once", "a row given twice")
    for name, actual in (("nFrames", frames), ("nSparsePoints", n), ("nAllPoints", len(dense))):
        if name in fields and (stated := fields.whole(name, (1, 1), 0, 1 << 31)[0]) != actual:
            raise fields.error(name, f"{actual}, as the arrays hold", str(stated))
    return Clip(
        name=clip_name(path),
        dense=Trajectories(dense, visible),
        evaluated=rows,
        labels=Labels(label, background=_BACKGROUND if released else None),
        provenance=_provenance(path, fields),
    )


def _points(fields: Fields, kind: str, shape: tuple[int, int]) -> tuple[FloatArray, BoolArray]:
    """Return positions and visibility of ``y<kind>`` and ``visible<kind>``."""
    y = fields.array(f"y{kind}", (3, *shape)).astype(np.float64)
    visible = np.ones(shape, dtype=np.bool_)
    if f"visible{kind}" in fields:
        visible = fields.array(f"visible{kind}", shape) != 0
    if not (np.isfinite(y[:2, visible]).all() and (y[2, visible] == 1).all()):
        raise fields.error(f"y{kind}", "finite (x, y, 1) where visible", "another value")
    xy = np.where(visible[..., None], np.moveaxis(y[:2], 0, -1), np.nan)
    return xy, visible


def _provenance(path: str | os.PathLike[str], fields: Fields) -> dict[str, Any]:
    out = origin(path, "mat-2018") | {"fields": list(fields.values)}
    if isinstance(name := fields.values.get("Name"), str):
        out["Name"] = name
    if "visibleSparse" not in fields:
        out["visibility"] = "the file has no mask: every point taken as visible"
    return out


def write(clip: Clip, path: str | os.PathLike[str]) -> None:
    """Write a clip as a MAT-file of the 2018 schema; the same clip gives the same bytes.

    A clip that was read from such a file gets the fields that its file had (Hopkins12 and MTPV62
    have no `yAll`), as far as they still hold everything. Names of motions, frame numbers, image
    size and camera have no place in the schema.
    """
    values = _field_values(clip)
    if (size := 8 * values["yAll"].size) > _LARGEST:
        raise InvalidValueError("MAT-file", expected=f"at most {_LARGEST} bytes", found=f"{size}")
    buffer = io.BytesIO()
    data = {name: values[name] for name in _wanted_fields(clip)}
    savemat(buffer, {"Data": data}, do_compression=True)  # type: ignore[arg-type]  # a stream will do
    write_bytes(path, _TEXT + buffer.getvalue()[len(_TEXT) :])


def _wanted_fields(clip: Clip) -> Sequence[str]:
    given = clip.provenance.get("fields")
    known = {*_ALL_FIELDS, "Name"}
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
