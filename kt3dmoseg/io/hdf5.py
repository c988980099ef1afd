"""The canonical format: one HDF5 file per clip. docs/formats.md has the layout.

The same clip gives the same bytes: nothing is stamped with a time, invisible positions are one
NaN. Metadata and data carry checksums, so that damage is noticed.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import FileFormatError, InputFileError, KT3DMoSegError
from kt3dmoseg.files import write_bytes
from kt3dmoseg.io.fields import clip_from, clip_values, json_object
from kt3dmoseg.types import Clip, Trajectories

FORMAT, VERSION = "kt3dmoseg clip", 1
_CHUNK_BYTES = 1 << 18
_GZIP = 4
_MAX_BYTES = 1 << 32
# Deflate packs at most 1032 : 1; small arrays may claim what they like.
_MAX_RATIO, _RATIO_FREE = 1100, 1 << 24
_MAX_CHUNK = 1 << 26
_MAX_TEXT = 1 << 26
_FILTERS = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}

_POSITIONS = (
    "(N, F, 2) positions, x right, y down, pixels; (0, 0) is the centre of the top-left pixel; "
    "NaN where not visible"
)
_LABELS = "(n,) motion of each evaluated trajectory; 0 = unlabelled or outlier"
# Of each array of a clip its path in the file, type, number of dimensions, and what it is.
_DATASETS = {
    "xy": ("dense/xy", "f8", 3, _POSITIONS),
    "visible": ("dense/visible", "u1", 2, "(N, F) 1 where the trajectory exists in the frame, else 0"),
    "track_id": ("dense/track_id", "i8", 1, "(N,) identity of each trajectory"),
    "evaluated": ("evaluated", "i8", 1, "(n,) rows of dense that are scored, from 0"),
    "label": ("labels/label", "i8", 1, _LABELS),
    "frame_numbers": ("frames/number", "i8", 1, "(F,) number of each frame in its source"),
    "timestamps": ("frames/timestamp", "f8", 1, "(F,) seconds"),
    "K": ("camera/K", "f8", 2, "(3, 3) normalised to pixel coordinates"),
}
DESCRIPTIONS = {inner: text for inner, _, _, text in _DATASETS.values()}
_OPTIONAL = ("timestamps", "K")
_ATTRIBUTES = {
    "format": "format",
    "version": "version",
    "name": "name",
    "provenance": "provenance",
    "label_names": "labels/names",
    "image_size": "dense/image_size",
    "background": "labels/background",
    "camera_name": "camera/name",
}
_TEXTS = ("name", "provenance", "label_names", "camera_name")


def write(clip: Clip, path: str | os.PathLike[str]) -> None:
    """Write a clip; InvalidValueError when its provenance is not made of JSON values."""
    # Put together in memory: a full disk must not leave the HDF5 library with a half-written file.
    with _new_file() as file:
        _write_trajectories(file, clip.dense)
        values: dict[str, Any] = {"format": FORMAT, "version": np.int64(VERSION)} | clip_values(clip)
        for name, (inner, *_) in _DATASETS.items():
            if name in values:
                _create(file, inner, values[name].shape, values[name].dtype)[...] = _one_nan(values[name])
        for name, inner in _ATTRIBUTES.items():
            if name in values:
                group, _, key = inner.rpartition("/")
                _untimed_group(file, group).attrs.create(key, _fixed(values[name]))
        file.flush()
        image = file.id.get_file_image()
    write_bytes(path, image)


def read(path: str | os.PathLike[str]) -> Clip:
    """Read a clip; see `kt3dmoseg.io.load` for the errors."""
    where = os.fspath(path)
    with open_hdf5(where) as file:
        _check_version(file, where)
        values: dict[str, Any] = {
            name: read_array(file, inner, where, dtype, ndim)
            for name, (inner, dtype, ndim, _) in _DATASETS.items()
            if name not in _OPTIONAL or inner in file
        }
        values["visible"] = values["visible"] != 0
        values["image_size"] = _attribute(file, _ATTRIBUTES["image_size"], where)
        values["background"] = _integer(file, _ATTRIBUTES["background"], where)
        values |= {name: _text(file, _ATTRIBUTES[name], where) for name in _TEXTS}
        if values["name"] is None:
            raise FileFormatError(f"{where}: attribute name", expected="a text", found="nothing")
        return clip_from({name: value for name, value in values.items() if value is not None}, f"{where}: ")


def provenance(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return only the provenance of a clip's file, after all its checksums are checked; raises as `read`."""
    where = os.fspath(path)
    with open_hdf5(where) as file:
        _check_version(file, where)
        for inner in _ATTRIBUTES.values():
            _attribute(file, inner, where)
        for inner, dtype, ndim, _ in _DATASETS.values():
            if inner in file:
                dataset = _dataset(file, inner, where, dtype, ndim)
                step = dataset.chunks[0] if dataset.chunks else max(1, len(dataset))
                for first in range(0, len(dataset), step):  # a long clip fits into memory by chunks only
                    dataset[first : first + step]
        return json_object(_text(file, "provenance", where) or "{}", f"{where}: provenance")


def _new_file() -> h5py.File:
    # The 1.10 file format has checksums on metadata; times are switched off for root and groups.
    creation = h5py.h5p.create(h5py.h5p.FILE_CREATE)
    creation.set_obj_track_times(False)
    access = h5py.h5p.create(h5py.h5p.FILE_ACCESS)
    access.set_libver_bounds(h5py.h5f.LIBVER_V110, h5py.h5f.LIBVER_V110)
    access.set_fapl_core(_CHUNK_BYTES, False)
    return h5py.File(h5py.h5f.create(b"clip", h5py.h5f.ACC_TRUNC, creation, access))


def _write_trajectories(file: h5py.File, dense: Trajectories) -> None:
    """Write chunk by chunk: of a long clip, the whole would be mostly NaN."""
    shape, n = (len(dense), dense.n_frames), len(dense)
    for part, (name, of, dtype) in enumerate((("dense/xy", (2,), "f8"), ("dense/visible", (), "u1"))):
        dataset = _create(file, name, (*shape, *of), np.dtype(dtype))
        step = dataset.chunks[0] if dataset.chunks else 1
        for first in range(0, n if dataset.size else 0, step):
            last = min(first + step, n)
            dataset[first:last] = _one_nan(dense.block(first, last)[part])


def _create(file: h5py.File, name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> h5py.Dataset:
    group = _untimed_group(file, name.rpartition("/")[0])
    row = max(1, math.prod(shape[1:]) * dtype.itemsize)
    rows = max(1, min(shape[0], _CHUNK_BYTES // row))
    packed = {"chunks": (rows, *shape[1:]), "compression": "gzip", "compression_opts": _GZIP}
    options = {**packed, "shuffle": True, "fletcher32": True} if math.prod(shape) else {}
    dataset = group.create_dataset(name.rpartition("/")[2], shape, dtype, track_times=False, **options)
    dataset.attrs.create("description", _fixed(DESCRIPTIONS[name]))
    return dataset


def _one_nan(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Write every NaN with the same bits: the same clip gives the same bytes."""
    return np.where(np.isnan(values), np.nan, values) if values.dtype.kind == "f" else values


def _untimed_group(file: h5py.File, name: str) -> h5py.Group:
    if name and name not in file:
        creation = h5py.h5p.create(h5py.h5p.GROUP_CREATE)
        creation.set_obj_track_times(False)
        h5py.h5g.create(file.id, name.encode(), gcpl=creation)
    return file[name or "/"]


def _fixed(value: Any) -> Any:  # noqa: ANN401  # numbers pass; texts become fixed-length UTF-8
    if not isinstance(value, str):
        return value
    # Of fixed length, a text lies in the object's header, which has a checksum.
    content = value.encode()
    return np.array(content, dtype=h5py.string_dtype("utf-8", max(1, len(content))))


def _check_version(file: h5py.File, where: str) -> None:
    kind = _text(file, "format", where)
    if kind != FORMAT:
        found = f"format {kind!r}" if kind else "another HDF5 file (no attribute 'format')"
        fix = "give a file that kt3dmoseg build, track or convert wrote"
        if "#refs#" in file or "Data" in file:
            found, fix = "a MATLAB 7.3 MAT-file (HDF5)", "save it again in MATLAB with the option '-v7'"
        raise FileFormatError(where, expected=f"a {FORMAT}", found=found, fix=fix)
    version = _integer(file, "version", where)
    if version is None or version < 1:
        raise FileFormatError(f"{where}: version", expected="1 or more", found=str(version))
    if version > VERSION:
        fix = "the file was written by a newer kt3dmoseg; upgrade this one"
        raise FileFormatError(f"{where}: version", expected=f"at most {VERSION}", found=str(version), fix=fix)


def _attribute(file: h5py.File, name: str, where: str) -> Any:  # noqa: ANN401  # as h5py gives it
    """Return an attribute; None when it is not there."""
    group, _, key = name.rpartition("/")
    if group and group not in file:
        return None
    owner = _hard_linked(file, group, where) if group else file
    if key not in owner.attrs:
        return None
    if (kind := owner.attrs.get_id(key)).dtype.itemsize * math.prod(kind.shape) > _MAX_TEXT:
        raise FileFormatError(f"{where}: {key}", expected=f"at most {_MAX_TEXT} bytes", found="more")
    return owner.attrs[key]


def _text(file: h5py.File, name: str, where: str) -> str | None:
    value = _attribute(file, name, where)
    if isinstance(value, bytes):
        return value.decode("utf-8", errors="replace")
    if not isinstance(value, str | None):
        raise FileFormatError(f"{where}: attribute {name}", expected="a text", found=type(value).__name__)
    return value


def _integer(file: h5py.File, name: str, where: str) -> int | None:
    value = _attribute(file, name, where)
    number = np.asarray(value)
    if value is not None and (number.size != 1 or number.dtype.kind not in "iu"):
        raise FileFormatError(f"{where}: {name}", expected="a whole number", found=repr(value))
    return None if value is None else int(number.item())


@contextmanager
def open_hdf5(path: str) -> Iterator[h5py.File]:
    """Open a file for reading; what h5py raises in the block becomes an InputFileError or FileFormatError."""
    try:
        with h5py.File(path, "r", locking=False) as file:
            yield file
    except KT3DMoSegError:
        raise
    except (OSError, KeyError, RuntimeError, ValueError, TypeError, OverflowError, MemoryError) as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise InputFileError(f"{path}: {os.strerror(error.errno)}") from None
        if "already open for" in str(error):
            fix = "close it there; if that program was killed, 'h5clear -s FILE' frees the file"
            found = "one that another program has open for writing"
            raise InputFileError(path, expected="a finished file", found=found, fix=fix) from None
        raise FileFormatError(path, expected="an intact HDF5 file", found=f"damage: {error}") from None


def read_array(file: h5py.File, name: str, where: str, dtype: str, ndim: int) -> npt.NDArray[Any]:
    """Read a dataset of known type and number of dimensions, stored in this very file within bounds."""
    values = np.asarray(_dataset(file, name, where, dtype, ndim)[()], dtype=np.dtype(dtype))
    values.flags.writeable = False  # a clip takes it as it is, without a copy
    return values


def _dataset(file: h5py.File, name: str, where: str, dtype: str, ndim: int) -> h5py.Dataset:
    field = f"{where}: {name}"
    dataset = _hard_linked(file, name, where)
    if not isinstance(dataset, h5py.Dataset):
        raise FileFormatError(field, expected="a dataset", found="a group")
    wanted = np.dtype(dtype)
    same = dataset.dtype.kind == wanted.kind and dataset.dtype.itemsize == wanted.itemsize
    if not same or dataset.ndim != ndim:
        found = f"{dataset.dtype} with {dataset.ndim}"
        raise FileFormatError(field, expected=f"{wanted} with {ndim} dimensions", found=found)
    _check_storage(dataset, field)
    return dataset


def _hard_linked(file: h5py.File, name: str, where: str) -> h5py.Group | h5py.Dataset:
    """Look an object up without following a soft or external link on the way."""
    here: Any = file
    for part in name.split("/"):
        link = here.get(part, getlink=True) if isinstance(here, h5py.Group) else None
        if link is None:
            raise FileFormatError(f"{where}: {name}", expected="present, as in every clip", found="nothing")
        if not isinstance(link, h5py.HardLink):
            raise FileFormatError(f"{where}: {name}", expected="data in this file", found="a link")
        here = here[part]
    return here


def _check_storage(dataset: h5py.Dataset, field: str) -> None:
    if dataset.external or dataset.is_virtual:
        raise FileFormatError(field, expected="data in this file", found="a reference to another file")
    plan = dataset.id.get_create_plist()
    filters = {plan.get_filter(i)[0] for i in range(plan.get_nfilters())}
    if not filters <= _FILTERS:
        raise FileFormatError(field, expected="gzip compression", found=f"filter {max(filters - _FILTERS)}")
    size = math.prod(dataset.shape) * dataset.dtype.itemsize
    stored = dataset.id.get_storage_size()
    limit = min(_MAX_BYTES, max(_RATIO_FREE, _MAX_RATIO * stored))
    if size > limit:
        found = f"{size} bytes, shape {dataset.shape}, from {stored} stored"
        raise FileFormatError(field, expected=f"at most {limit} bytes", found=found)
    if dataset.chunks and math.prod(dataset.chunks) * dataset.dtype.itemsize > _MAX_CHUNK:
        raise FileFormatError(
            field, expected=f"chunks of at most {_MAX_CHUNK} bytes", found=f"{dataset.chunks}"
        )
