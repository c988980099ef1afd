"""Clips in MAT-files: the 2018 KT3DMoSeg release, Hopkins12 and MTPV62, and Hopkins155.

The release, Hopkins12 and MTPV62 share a struct `Data`: `yAll` (3, N, F) and `ySparse` (3, n, F) are
homogeneous pixels, (0, 0, 0) where invisible; `visibleAll` (N, F) and `visibleSparse` (n, F) show where they
are; `SparseIndex` (n, 1) counts the evaluated rows of `yAll` from 1; `GtLabel` (n, 1) holds the motions, 0 an
outlier. Only we write `Background`: the motion of the static scene, or 0 when it is unknown; it is left out
where it is 1 and not most labels are 0.

Hopkins155 (Tron and Vidal, CVPR 2007) has one ``<sequence>_truth.mat`` each: `y` (3, P, F) homogeneous
pixels, `s` (P, 1) the motions from 1, `K` (3, 3) the matrix that normalised them, `width` and `height` of the
images. The additional sequences carry a mask `m` (P, F), 1 where a point is visible, and label outliers 0;
without it the trajectories are complete.

These conventions end here: inside, coordinates are (N, F, 2) with NaN where invisible and rows count from 0.

Of the container ("MAT-File Format", MathWorks), version 5 is read: arrays, texts, structs and cells, no size
being trusted. scipy's reader is not used: damaged files crash it. Sparse arrays, objects and function handles
are named but not decoded.
"""

import io
import math
import os
import struct
import zlib
from collections.abc import Iterator, Mapping
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import FileFormatError, InvalidValueError
from kt3dmoseg.files import PathLike, read_bytes, write_bytes
from kt3dmoseg.io.fields import Fields, foreign_clip
from kt3dmoseg.types import BoolArray, Camera, Clip, FloatArray, IntArray, Labels, Trajectories

# Instead of the platform and the date that scipy writes, so that equal content gives equal bytes.
_BANNER = b"MATLAB 5.0 MAT-file, written by kt3dmoseg".ljust(116)
# In the release the static scene is motion 1 in every clip; the other collections do not define it.
_RELEASED = 1
_MINE = "Background"

MAX_BYTES = 1 << 30
# zlib packs a run of zeros a thousandfold; trajectories with many gaps reach some tens.
_MAX_RATIO, _FREE = 300, 1 << 24
_MAX_DEPTH, _MAX_FIELDS, _MAX_DIMS = 8, 4096, 8
_HEADER = 128
_MATRIX, _COMPRESSED, _INT32, _UINT32, _INT8, _TEXT = (14,), 15, (5,), (6,), (1,), (1, 2, 4, 16, 17, 18)
_TWO_BYTES = (4, 17)  # of text: uint16 and UTF-16
_STORAGE = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_NUMERIC = dict(enumerate(("f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8"), start=6))
_CELL, _STRUCT, _CHAR = 1, 2, 4
_OTHER = {2: "struct array", 3: "object", 4: "text array", 5: "sparse", 16: "function handle"}
_IS_COMPLEX, _IS_LOGICAL = 0x0800, 0x0200

# The last is a variable that is not decoded: what it is, and its dimensions.
Value: TypeAlias = "npt.NDArray[Any] | str | dict[str, Value] | list[Value] | tuple[str, tuple[int, ...]]"


def read(path: PathLike) -> Clip:
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


def write(clip: Clip, path: PathLike) -> None:
    """Write a clip as a MAT-file of the 2018 schema; the same clip gives the same bytes.

    A clip that was read from such a file gets the fields that its file had (Hopkins12 and MTPV62
    have no `yAll`), as far as they still hold everything. Names of motions, frame numbers, image
    size and camera are not part of the schema.
    """
    from scipy.io import savemat  # a reader does without: importing it takes longer than reading a file

    data, buffer = _struct(clip), io.BytesIO()
    if (size := sum(np.asarray(value).nbytes for value in data.values())) > MAX_BYTES:
        raise InvalidValueError("MAT-file", expected=f"at most {MAX_BYTES} bytes", found=f"{size}")
    savemat(buffer, {"Data": data}, do_compression=True)  # type: ignore[arg-type]  # a stream will do
    write_bytes(path, _BANNER + buffer.getvalue()[len(_BANNER) :])


def _release(path: PathLike, data: Mapping[str, Any]) -> Clip:
    fields = Fields(f"{os.fspath(path)}: Data.", data)
    dense, visible = sparse, _ = _points(fields, "ySparse", "visibleSparse", "GtLabel")
    n, frames = sparse.shape[:2]
    label, rows = _motions(fields, "GtLabel", n), np.arange(n)
    if released := "yAll" in fields:
        dense, visible = _points(fields, "yAll", "visibleAll", frames=frames)
        rows = fields.integers("SparseIndex", n, 1, len(dense)) - 1
        if not np.array_equal(dense[rows], sparse, equal_nan=True):
            raise fields.error("ySparse", "the rows SparseIndex of yAll", "other coordinates")
    for name, actual in (("nFrames", frames), ("nSparsePoints", n), ("nAllPoints", len(dense))):
        if name in fields and (stated := fields.integers(name, 1)[0]) != actual:
            raise fields.error(name, f"{actual}, as the arrays hold", str(stated))
    background = _RELEASED if released else None
    if _MINE in fields:
        background = int(fields.integers(_MINE, 1)[0]) or None
    known: dict[str, Any] = {"fields": list(data)}
    if isinstance(data.get("Name"), str):
        known["Name"] = data["Name"]
    if "visibleSparse" not in fields:
        known["visibility"] = "the file has no mask: every point taken as visible"
    tracks, labels = Trajectories(dense, visible), Labels(label, background)
    return foreign_clip(path, "mat-2018", tracks, labels, rows, **known)


def _hopkins(path: PathLike, variables: Mapping[str, Any]) -> Clip:
    fields = Fields(f"{os.fspath(path)}: ", variables)
    xy, visible = _points(fields, "y", "m", "s")
    width, height = (fields.array(name, (1, 1)).item() for name in ("width", "height"))
    dense, labels = (
        Trajectories(xy, visible, image_size=(width, height)),
        Labels(_motions(fields, "s", len(xy))),
    )
    return foreign_clip(path, "hopkins155", dense, labels, camera=Camera(K=fields.array("K", (3, 3))))


def _motions(fields: Fields, name: str, n: int) -> IntArray:
    """Labels (n,): motions from 1, and 0 for outliers; where those are the most, motions count from 0."""
    label = fields.integers(name, n)
    if _MINE not in fields and _mostly_zero(label):
        found = f"0 in {(label == 0).sum()} of {n}, more than any motion"
        fix = "count motions from 1, or leave out what is not labelled"
        raise fields.error(name, "motions from 1, 0 for outliers", found, fix)
    return label


def _mostly_zero(label: IntArray) -> bool:
    """Whether there are motions, and 0 is more frequent than any."""
    motions = label[label > 0]
    return len(motions) > 0 and bool((label == 0).sum() > np.unique(motions, return_counts=True)[1].max())


def _points(
    fields: Fields, name: str, mask: str, labels: str = "", frames: int | None = None
) -> tuple[FloatArray, BoolArray]:
    """Return positions and visibility from homogeneous pixels (3, N, F) and their mask, if there is one."""
    y = fields.array(name, (3, None, frames)).astype(np.float64)
    n, last = y.shape[1:]
    if labels and fields.array(labels).size == last != n:
        fix = f"permute its last two dimensions: there are {last} {labels}"
        raise fields.error(name, f"3 x {last} points x {n} frames", f"3 x {n} x {last}", fix)
    visible = fields.flags(mask, (n, last)) if mask in fields else np.ones((n, last), dtype=np.bool_)
    bad = visible & ~(np.isfinite(y[:2]).all(axis=0) & (y[2] == 1))
    if bad.any():
        raise fields.error(
            name, "finite (x, y, 1) where visible", "({:g}, {:g}, {:g})".format(*y[:, bad].T[0])
        )
    return np.where(visible[..., None], np.moveaxis(y[:2], 0, -1), np.nan), visible


def _struct(clip: Clip) -> dict[str, Any]:
    """Return `Data`: the fields that the clip's own file had, if they hold everything, else all."""
    dense, sparse = clip.dense, clip.evaluated_trajectories
    data: dict[str, Any] = {
        "nAllPoints": float(len(dense)),
        "yAll": _homogeneous(dense),
        "visibleAll": dense.visible,
        "nFrames": float(clip.n_frames),
        "nSparsePoints": float(len(sparse)),
        "ySparse": _homogeneous(sparse),
        "visibleSparse": sparse.visible,
        "SparseIndex": (clip.evaluated[:, None] + 1).astype(np.float64),
        "GtLabel": clip.labels.label[:, None].astype(np.float64),
    }
    named = data | {"Name": str(clip.provenance.get("Name", clip.name))}
    given = clip.provenance.get("fields")
    had = [name for name in given if name in list(named)] if isinstance(given, list) else []
    whole = {"yAll", "visibleAll", "SparseIndex"} <= {*had} or clip.evaluated.tolist() == [*range(len(dense))]
    masked = "visibleSparse" in had or bool(dense.visible.all())
    if {"ySparse", "GtLabel"} <= {*had} and whole and masked:
        data = {name: named[name] for name in had}
    stated = clip.labels.background != (_RELEASED if "yAll" in data else None)
    if stated or _mostly_zero(clip.labels.label):
        data[_MINE] = float(clip.labels.background or 0)
    return data


def _homogeneous(trajectories: Trajectories) -> FloatArray:
    """Return (3, N, F): x, y, 1 where visible, else 0, 0, 0."""
    points = np.concatenate([trajectories.xy, np.ones_like(trajectories.xy[..., :1])], axis=2)
    return np.moveaxis(np.where(trajectories.visible[..., None], points, 0.0), -1, 0)


def read_mat(path: PathLike) -> dict[str, Value]:
    """Read every variable of a version 5 MAT-file of at most `MAX_BYTES`.

    Arrays have the class that MATLAB shows (double, logical, ...), whatever integer type the file stores
    them in. A 1x1 struct is a dict, cells are a list, column by column, a row of characters is a str; of
    other classes there is the kind and shape.
    """
    where = os.fspath(path)
    content = read_bytes(path, MAX_BYTES)
    if content[:10] == b"MATLAB 7.3" or content[:6] != b"MATLAB" or content[126:128] not in (b"IM", b"MI"):
        found, fix = f"{len(content)} bytes, a file that starts with {content[:8]!r}", ""
        if content[:10] == b"MATLAB 7.3":
            found, fix = "version 7.3 (HDF5)", "save it again in MATLAB with the option '-v7'"
        raise FileFormatError(where, expected="a MATLAB version 5 to 7 MAT-file", found=found, fix=fix)
    order, out = "<" if content[126:128] == b"IM" else ">", dict[str, Value]()
    try:
        with np.errstate(invalid="ignore"):  # an odd file may store NaN of a class of whole numbers
            for kind, payload in _elements(memoryview(content)[_HEADER:], order):
                if kind == _COMPRESSED:
                    kind, payload = next(_elements(_inflate(payload, order), order))
                if kind not in _MATRIX:
                    raise ValueError(f"an element of type {kind} for a variable")
                name, value = _Matrix(payload, order).read()
                if name:
                    out[name] = value
    except (ValueError, struct.error, zlib.error, StopIteration) as error:
        reason = f"{str(error) or 'an element is missing'}; the file is damaged or truncated"
        raise FileFormatError(f"{where}: MAT-file", expected="intact elements", found=reason) from None
    return out


def _elements(data: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """Give type and bytes of each element, after checking that they are there."""
    at = 0
    while at < len(data):
        kind, size = struct.unpack_from(order + "II", data, at)
        start, step = at + 8, 8 + size + (0 if kind == _COMPRESSED else -size % 8)
        if kind >> 16:  # up to 4 bytes lie in the tag itself
            kind, size, start, step = kind & 0xFFFF, min(kind >> 16, 4), at + 4, 8
        if start + size > len(data):
            raise ValueError(f"an element of {size} bytes where {len(data) - start} are left")
        yield kind, data[start : start + size]
        at += step


def _inflate(packed: memoryview, order: str) -> memoryview:
    """Unpack one element: first its tag, then no more than the tag declares."""
    unpack = zlib.decompressobj()
    tag = unpack.decompress(packed, 8)
    (size,) = struct.unpack(order + "4xI", tag)
    limit = min(MAX_BYTES, max(_FREE, _MAX_RATIO * len(packed)))
    if size > limit:
        raise ValueError(f"{size} bytes in a packed element, more than {limit}")
    return memoryview(tag + unpack.decompress(unpack.unconsumed_tail, size + 8))


class _Matrix:
    """One array, decoded from its elements one after the other; damage raises ValueError and the like."""

    def __init__(self, data: memoryview, order: str, depth: int = 1) -> None:
        if depth > _MAX_DEPTH:
            raise ValueError(f"more than {_MAX_DEPTH} structs inside each other")
        self.data, self.order, self.depth = data, order, depth
        self.parts = _elements(data, order)

    def read(self) -> tuple[str, Value]:
        """Return name and value."""
        if not self.data:
            return "", np.zeros((0, 0))
        flags, shape = self._integers(_UINT32, 2)[0], self._integers(_INT32, _MAX_DIMS)
        if len(shape) < 2 or min(shape) < 0 or (0 in shape and math.prod(n or 1 for n in shape) > _FREE):
            raise ValueError(f"dimensions {shape}")
        name, klass = bytes(self._next(_INT8)[1]).decode("latin-1"), flags & 0xFF
        if klass == _STRUCT and shape == (1, 1):
            return name, self._struct()
        if klass == _CELL and math.prod(shape) <= _MAX_FIELDS:
            return name, [self._inner() for _ in range(math.prod(shape))]
        if klass == _CHAR and shape[0] <= 1 and len(shape) == 2:
            return name, self._text(math.prod(shape))
        if klass in _NUMERIC and not flags & _IS_COMPLEX:
            kind, payload = self._next(tuple(_STORAGE))
            values = np.frombuffer(payload, self.order + _STORAGE[kind])
            dtype = np.dtype(bool if flags & _IS_LOGICAL else _NUMERIC[klass])
            return name, values.astype(dtype).reshape(shape, order="F")
        return name, ("complex" if klass in _NUMERIC else _OTHER.get(klass, f"class {klass}"), shape)

    def _text(self, length: int) -> str:
        kind, payload = self._next(_TEXT) if length else (0, b"")
        two_bytes = "utf-16-le" if self.order == "<" else "utf-16-be"
        return bytes(payload).decode(two_bytes if kind in _TWO_BYTES else "utf-8", errors="replace")

    def _struct(self) -> dict[str, Value]:
        width, names = self._integers(_INT32, 1)[0], bytes(self._next(_INT8)[1])
        if width < 1 or len(names) % width or len(names) // width > _MAX_FIELDS:
            raise ValueError(f"{len(names)} bytes of field names in pieces of {width}")
        out: dict[str, Value] = {}
        for start in range(0, len(names), width):
            name = names[start : start + width].split(b"\0")[0].decode("latin-1")
            out[name] = self._inner()
        return out

    def _inner(self) -> Value:
        return _Matrix(self._next(_MATRIX)[1], self.order, self.depth + 1).read()[1]

    def _integers(self, kinds: tuple[int, ...], most: int) -> tuple[int, ...]:
        payload = self._next(kinds)[1]
        if not 4 <= len(payload) <= 4 * most:
            raise ValueError(f"{len(payload)} bytes for up to {most} whole numbers")
        return struct.unpack(f"{self.order}{len(payload) // 4}i", payload)

    def _next(self, kinds: tuple[int, ...]) -> tuple[int, memoryview]:
        kind, payload = next(self.parts)
        if kind not in kinds:
            raise ValueError(f"an element of type {kind} for one of {kinds}")
        return kind, payload
