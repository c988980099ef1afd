"""Reading from an HDF5 file that may be damaged or hostile: nothing is allocated, or followed, unchecked."""

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

MAX_BYTES = 1 << 32
# Deflate packs at most 1032 : 1; small arrays may claim what they like.
_MAX_RATIO, _RATIO_FREE = 1100, 1 << 24
_MAX_CHUNK = 1 << 26
_MAX_TEXT = 1 << 26
_FILTERS = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}


@contextmanager
def open_hdf5(path: str) -> Iterator[h5py.File]:
    """Open a file for reading; whatever the HDF5 library raises in the block becomes one line.

    Raises
    ------
    InputFileError
        When the file cannot be read.
    FileFormatError
        When it is damaged.
    """
    try:
        with h5py.File(path, "r", locking=False) as file:
            yield file
    except KT3DMoSegError:
        raise
    except OSError as error:
        if error.errno is not None:
            raise InputFileError(f"{path}: {os.strerror(error.errno)}") from None
        raise FileFormatError(path, expected="a sound HDF5 file", found=f"damage: {error}") from None
    except (KeyError, RuntimeError, ValueError, TypeError, OverflowError, MemoryError) as error:
        raise FileFormatError(path, expected="a sound HDF5 file", found=f"damage: {error}") from None


def read_array(file: h5py.File, name: str, where: str, dtype: str, ndim: int) -> npt.NDArray[Any]:
    """Read a dataset of known type and number of dimensions.

    Raises
    ------
    FileFormatError
        When it is missing, of another type, stored outside this file, or larger than what the
        file can hold.
    """
    place = f"{where}: {name}"
    dataset = _hard_linked(file, name, where)
    if not isinstance(dataset, h5py.Dataset):
        raise FileFormatError(place, expected="a dataset", found="a group")
    wanted = np.dtype(dtype)
    same = dataset.dtype.kind == wanted.kind and dataset.dtype.itemsize == wanted.itemsize
    if not same or dataset.ndim != ndim:
        found = f"{dataset.dtype} with {dataset.ndim}"
        raise FileFormatError(place, expected=f"{wanted} with {ndim} dimensions", found=found)
    _check_storage(dataset, place)
    values = np.asarray(dataset[()], dtype=wanted)
    values.flags.writeable = False  # a clip takes it as it is, without a copy
    return values


def read_text(group: h5py.Group, name: str, where: str, default: str | None = None) -> str:
    """Read a text attribute."""
    if name not in group.attrs:
        if default is None:
            raise FileFormatError(f"{where}: attribute {name}", expected="a text", found="nothing")
        return default
    kind = group.attrs.get_id(name)
    if kind.shape != () or kind.dtype.kind not in "SO" or kind.dtype.itemsize > _MAX_TEXT:
        raise FileFormatError(f"{where}: attribute {name}", expected="a text", found=f"{kind.dtype}")
    value = group.attrs[name]
    if isinstance(value, bytes):
        return value.decode("utf-8", errors="replace")
    if not isinstance(value, str):
        raise FileFormatError(f"{where}: attribute {name}", expected="a text", found=type(value).__name__)
    return value


def checked_group(file: h5py.File, name: str, where: str) -> h5py.Group:
    """Return a group of this very file."""
    group = _hard_linked(file, name, where)
    if not isinstance(group, h5py.Group):
        raise FileFormatError(f"{where}: {name}", expected="a group", found="a dataset")
    return group


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


def _check_storage(dataset: h5py.Dataset, place: str) -> None:
    if dataset.external or dataset.is_virtual:
        raise FileFormatError(place, expected="data in this file", found="a reference to another file")
    plan = dataset.id.get_create_plist()
    filters = {plan.get_filter(i)[0] for i in range(plan.get_nfilters())}
    if not filters <= _FILTERS:
        raise FileFormatError(place, expected="gzip compression", found=f"filter {max(filters - _FILTERS)}")
    size = math.prod(dataset.shape) * dataset.dtype.itemsize
    stored = dataset.id.get_storage_size()
    limit = min(MAX_BYTES, max(_RATIO_FREE, _MAX_RATIO * stored))
    if size > limit:
        found = f"{size} bytes, shape {dataset.shape}, from {stored} stored"
        raise FileFormatError(place, expected=f"at most {limit} bytes", found=found)
    if dataset.chunks and math.prod(dataset.chunks) * dataset.dtype.itemsize > _MAX_CHUNK:
        raise FileFormatError(
            place, expected=f"chunks of at most {_MAX_CHUNK} bytes", found=f"{dataset.chunks}"
        )
