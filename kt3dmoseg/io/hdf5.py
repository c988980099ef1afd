"""The canonical format: one HDF5 file per clip. docs/formats.md has the layout.

The same clip gives the same bytes: nothing is stamped with a time, invisible positions are one
NaN. Metadata and data carry checksums, so that damage is noticed.
"""

import io
import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from uuid import uuid4

import h5py
import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import FileFormatError, InputFileError, KT3DMoSegError
from kt3dmoseg.files import PathLike, write_bytes
from kt3dmoseg.io.fields import FIELDS, NUMBERS, Fields, clip_from, clip_values
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

DESCRIPTIONS = {field.place: field.about for field in FIELDS.values() if field.about}


def write(clip: Clip, path: PathLike) -> None:
    """Write a clip; InvalidValueError when its provenance is not made of JSON values."""
    values = clip_values(clip)
    # Put together in memory: a full disk must not leave the HDF5 library with a half-written file.
    image = io.BytesIO()
    with _new_file(image) as file:
        _write_trajectories(file, clip.dense)
        attributes: dict[str, Any] = {"format": FORMAT, "version": np.int64(VERSION)}
        for name, field in ((name, FIELDS[name]) for name in FIELDS if name in values):
            if field.about:
                array = values[name]
                with _created(file, field.place, array.shape, array.dtype) as dataset:
                    dataset[...] = _one_nan(array)
            else:
                attributes[field.place] = values[name]
        for place, value in attributes.items():
            group, _, key = place.rpartition("/")
            _untimed_group(file, group).attrs.create(key, _fixed(value))
    write_bytes(path, image.getvalue())


def read(path: PathLike) -> Clip:
    """Read a clip; see `kt3dmoseg.io.load` for the errors."""
    where = os.fspath(path)
    with open_hdf5(where) as file:
        values = _attributes(file, where)
        for name, dataset in _datasets(file, where):
            values[name] = dataset[()]
        return clip_from(Fields(f"{where}: ", values))


def provenance(path: PathLike) -> dict[str, Any]:
    """Return only the provenance of a clip's file, after all its checksums are checked; raises as `read`."""
    where = os.fspath(path)
    with open_hdf5(where) as file:
        values = _attributes(file, where)
        for _, dataset in _datasets(file, where):
            for part in dataset.iter_chunks() if dataset.chunks else [()]:  # a long clip fits by chunks only
                dataset[part]
        return Fields(f"{where}: ", values).json("provenance")


def _new_file(image: io.BytesIO) -> h5py.File:
    # The 1.10 file format has checksums on metadata; times are switched off for root and groups.
    creation = h5py.h5p.create(h5py.h5p.FILE_CREATE)
    creation.set_obj_track_times(False)
    access = h5py.h5p.create(h5py.h5p.FILE_ACCESS)
    access.set_libver_bounds(h5py.h5f.LIBVER_V110, h5py.h5f.LIBVER_V110)
    access.set_fileobj_driver(h5py.h5fd.fileobj_driver, image)
    name = uuid4().hex.encode()  # two threads cannot open files of one name, not even in memory
    return h5py.File(h5py.h5f.create(name, h5py.h5f.ACC_TRUNC, creation, access))


def _write_trajectories(file: h5py.File, dense: Trajectories) -> None:
    """Write chunk by chunk: of a long clip, the whole would be mostly NaN."""
    shape, n = (len(dense), dense.n_frames), len(dense)
    for part, (name, of, dtype) in enumerate((("dense/xy", (2,), "f8"), ("dense/visible", (), "u1"))):
        with _created(file, name, (*shape, *of), np.dtype(dtype)) as dataset:
            step = dataset.chunks[0] if dataset.chunks else 1
            for first in range(0, n if dataset.size else 0, step):
                last = min(first + step, n)
                dataset[first:last] = _one_nan(dense.block(first, last)[part])


@contextmanager
def _created(
    file: h5py.File, name: str, shape: tuple[int, ...], dtype: np.dtype[Any]
) -> Iterator[h5py.Dataset]:
    """Give a new dataset and close it: the file's bytes depend on when, and a profiler may hold variables."""
    group = _untimed_group(file, name.rpartition("/")[0])
    row = max(1, math.prod(shape[1:]) * dtype.itemsize)
    rows = max(1, min(shape[0], _CHUNK_BYTES // row))
    packed = {"chunks": (rows, *shape[1:]), "compression": "gzip", "compression_opts": _GZIP}
    options = {**packed, "shuffle": True, "fletcher32": True} if math.prod(shape) else {}
    dataset = group.create_dataset(name.rpartition("/")[2], shape, dtype, track_times=False, **options)
    dataset.attrs.create("description", _fixed(DESCRIPTIONS[name]))
    yield dataset
    dataset.id.close()


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


def _attributes(file: h5py.File, where: str) -> dict[str, Any]:
    """Read the attributes; FileFormatError for a file of another kind or a newer version."""
    places = {name: field.place for name, field in FIELDS.items() if not field.about}
    values: dict[str, Any] = {}
    for name, place in {"format": "format", "version": "version", **places}.items():
        group, _, key = place.rpartition("/")
        owner = _find(file, group, where)
        if owner is None or key not in owner.attrs:
            continue
        if (kind := owner.attrs.get_id(key)).dtype.itemsize * math.prod(kind.shape) > _MAX_TEXT:
            raise FileFormatError(f"{where}: {name}", expected=f"at most {_MAX_TEXT} bytes", found="more")
        value = owner.attrs[key]
        values[name] = value.decode("utf-8", errors="replace") if isinstance(value, bytes) else value
    if str(kind := values.pop("format", "")) != FORMAT:
        found = f"format {kind!r}" if kind else "another HDF5 file (no attribute 'format')"
        fix = "give a file that kt3dmoseg build, track or convert wrote"
        if "#refs#" in file or "Data" in file:
            found, fix = "a MATLAB 7.3 MAT-file (HDF5)", "save it again in MATLAB with the option '-v7'"
        raise FileFormatError(where, expected=f"a {FORMAT}", found=found, fix=fix)
    if (version := Fields(f"{where}: ", values).integers("version", 1, 1)[0]) > VERSION:
        fix = "the file was written by a newer kt3dmoseg; upgrade this one"
        raise FileFormatError(f"{where}: version", expected=f"at most {VERSION}", found=str(version), fix=fix)
    return values


def _datasets(file: h5py.File, where: str) -> Iterator[tuple[str, h5py.Dataset]]:
    """Give the datasets of a clip that are there, checked, with the names of their fields."""
    for name, field in FIELDS.items():
        if field.about and (dataset := _find(file, field.place, where)) is not None:
            check_storage(dataset, f"{where}: {name}")
            yield name, dataset


def _find(file: h5py.File, place: str, where: str) -> Any | None:  # noqa: ANN401  # h5py has no types
    """Look an object up; None when it is not there, and no soft or external link is followed."""
    here: Any = file
    for part in filter(None, place.split("/")):
        link = here.get(part, getlink=True) if isinstance(here, h5py.Group) else None
        if link is None:
            return None
        if not isinstance(link, h5py.HardLink):
            raise FileFormatError(f"{where}: {place}", expected="data in this file", found="a link")
        here = here[part]
    return here


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


def check_storage(dataset: Any, field: str) -> None:  # noqa: ANN401  # h5py has no types
    """Refuse what is no dataset of numbers, stored in this very file within bounds."""
    if not isinstance(dataset, h5py.Dataset) or dataset.dtype.kind not in NUMBERS:
        raise FileFormatError(field, expected="a dataset of numbers", found=str(dataset))
    if dataset.external or dataset.is_virtual:
        raise FileFormatError(field, expected="data in this file", found="a reference to another file")
    plan = dataset.id.get_create_plist()
    filters = {plan.get_filter(i)[0] for i in range(plan.get_nfilters())}
    if not filters <= _FILTERS:
        raise FileFormatError(field, expected="gzip compression", found=f"filter {max(filters - _FILTERS)}")
    size = math.prod(dataset.shape) * dataset.dtype.itemsize
    stored = dataset.id.get_storage_size()
    limit = min(_MAX_BYTES, max(_RATIO_FREE, _MAX_RATIO * stored))
    chunk = math.prod(dataset.chunks or ()) * dataset.dtype.itemsize
    if size > limit or chunk > _MAX_CHUNK:
        expected = f"at most {limit} bytes, in chunks of at most {_MAX_CHUNK}"
        found = f"{size}, shape {dataset.shape}, from {stored} stored, in chunks of {chunk}"
        raise FileFormatError(field, expected=expected, found=found)
