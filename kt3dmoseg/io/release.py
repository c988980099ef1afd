"""The struct `Data` of the 2018 KT3DMoSeg release, which Hopkins12 and MTPV62 share.

`yAll` (3, N, F) and `ySparse` (3, n, F) are homogeneous pixels, (0, 0, 0) where invisible;
`visibleAll` (N, F) and `visibleSparse` (n, F) say where they are; `SparseIndex` (n, 1) counts the
evaluated rows of `yAll` from 1; `GtLabel` (n, 1) holds the motions, 0 an outlier. These conventions
end here: inside, coordinates are (N, F, 2) with NaN where invisible and rows count from 0.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import FileFormatError
from kt3dmoseg.files import sha256_file, write_bytes
from kt3dmoseg.io.mat5 import Undecoded, Value, read_mat
from kt3dmoseg.io.mat5_write import mat_bytes
from kt3dmoseg.io.text import clip_name
from kt3dmoseg.types import BoolArray, Clip, FloatArray, IntArray, Labels, Trajectories

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


def is_release(variables: dict[str, Value]) -> bool:
    """Whether the variables of a MAT-file are those of the 2018 release."""
    data = variables.get("Data")
    return isinstance(data, dict) and {"ySparse", "GtLabel"} <= set(data)


def read(path: str | os.PathLike[str], variables: dict[str, Value] | None = None) -> Clip:
    """Read a clip from a MAT-file of the 2018 release, Hopkins12 or MTPV62.

    Parameters
    ----------
    path : path
        The file; the clip takes its name.
    variables : dict, optional
        What `read_mat` gave, when it has been called already.

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
    where = os.fspath(path)
    content = read_mat(path) if variables is None else variables
    data = content.get("Data")
    if not isinstance(data, dict):
        raise FileFormatError(where, expected="a struct Data", found=", ".join(content) or "nothing")
    return _clip(_Fields(where, data))


class _Fields:
    """Checked access to the fields of the struct."""

    def __init__(self, where: str, data: dict[str, Value]) -> None:
        self.where, self.data = where, data

    def __contains__(self, name: str) -> bool:
        return name in self.data

    def array(self, name: str, shape: tuple[int | None, ...]) -> npt.NDArray[Any]:
        value = self.data.get(name)
        wanted = " x ".join("any" if n is None else str(n) for n in shape)
        if not isinstance(value, np.ndarray):
            found = value.kind if isinstance(value, Undecoded) else type(value).__name__
            raise self.fail(name, f"numbers {wanted}", "nothing" if value is None else found)
        # MATLAB drops trailing dimensions of size one.
        full = value.reshape(value.shape + (1,) * (len(shape) - value.ndim))
        if not _fits(full.shape, shape):
            raise self.fail(name, wanted, " x ".join(map(str, value.shape)))
        return full

    def whole(self, name: str, shape: tuple[int | None, ...], low: int, high: int) -> IntArray:
        """Return whole numbers within bounds, as a vector."""
        values = self.array(name, shape).astype(np.float64).ravel()
        good = np.isfinite(values) & (values >= low) & (values <= high)
        good[good] &= values[good] == np.floor(values[good])
        if not good.all():
            raise self.fail(name, f"whole numbers {low}..{high}", repr(float(values[~good][0])))
        return values.astype(np.int64)

    def check_count(self, name: str, actual: int) -> None:
        if name in self and self.whole(name, (1, 1), 0, 1 << 31)[0] != actual:
            stated = self.whole(name, (1, 1), 0, 1 << 31)[0]
            raise self.fail(name, f"{actual}, as the arrays hold", str(stated))

    def fail(self, name: str, expected: str, found: str) -> FileFormatError:
        return FileFormatError(f"{self.where}: Data.{name}", expected=expected, found=found)


def _fits(actual: tuple[int, ...], wanted: tuple[int | None, ...]) -> bool:
    pairs = zip(wanted, actual, strict=False)
    return len(actual) == len(wanted) and all(want in (None, size) for want, size in pairs)


def _clip(fields: _Fields) -> Clip:
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
            raise fields.fail("ySparse", "the rows SparseIndex of yAll", "other coordinates")
        if len(np.unique(rows)) != n:
            raise fields.fail("SparseIndex", "rows each given once", "a row given twice")
    fields.check_count("nFrames", frames)
    fields.check_count("nSparsePoints", n)
    fields.check_count("nAllPoints", len(dense))
    return Clip(
        name=clip_name(fields.where),
        dense=Trajectories(dense, visible),
        evaluated=rows,
        labels=Labels(label, background=_BACKGROUND if released else None),
        provenance=_provenance(fields),
    )


def _points(fields: _Fields, kind: str, shape: tuple[int, int]) -> tuple[FloatArray, BoolArray]:
    """Return positions and visibility of ``y<kind>`` and ``visible<kind>``."""
    y = fields.array(f"y{kind}", (3, *shape)).astype(np.float64)
    visible = np.ones(shape, dtype=np.bool_)
    if f"visible{kind}" in fields:
        visible = fields.array(f"visible{kind}", shape) != 0
    if not (np.isfinite(y[:2, visible]).all() and (y[2, visible] == 1).all()):
        raise fields.fail(f"y{kind}", "finite (x, y, 1) where visible", "another value")
    xy = np.where(visible[..., None], np.moveaxis(y[:2], 0, -1), np.nan)
    return xy, visible


def _provenance(fields: _Fields) -> dict[str, Any]:
    out: dict[str, Any] = {
        "format": "mat-2018",
        "source": os.path.basename(fields.where),  # noqa: PTH119  # a str in, a str out
        "sha256": sha256_file(fields.where),
        "fields": list(fields.data),
    }
    if isinstance(name := fields.data.get("Name"), str):
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
    wanted = _wanted_fields(clip)
    values = _field_values(clip)
    write_bytes(path, mat_bytes({"Data": {name: values[name] for name in wanted}}))


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
