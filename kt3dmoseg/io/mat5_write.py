"""Writing version 5 MAT-files as MATLAB does: doubles that are whole numbers stored as small integers."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.io.mat5 import (
    CLASS_CHAR,
    CLASS_STRUCT,
    FLAG_LOGICAL,
    MAX_BYTES,
    MI_COMPRESSED,
    MI_INT8,
    MI_INT32,
    MI_MATRIX,
    MI_UINT32,
    NUMERIC,
    STORAGE,
)

_MI_UTF8 = 16
_TEXT = b"MATLAB 5.0 MAT-file, written by kt3dmoseg"
_KINDS = {np.dtype("<" + code): kind for kind, code in STORAGE.items()}
_CLASSES = {np.dtype("<" + code): klass for klass, code in NUMERIC.items()}
# The order in which MATLAB tries to store doubles that are whole numbers.
_COMPACT = ("u1", "i1", "u2", "i2", "i4")
_NAME_WIDTH = 32


def mat_bytes(variables: Mapping[str, Any]) -> bytes:
    """Return the content of a MAT-file.

    Parameters
    ----------
    variables : mapping of str to value
        Arrays of numbers or bool, texts, or mappings of them (1x1 structs). The class MATLAB
        shows is the array's dtype.

    Raises
    ------
    InvalidValueError
        When the content is larger than `read_mat` would read back.
    """
    # Fixed text without a date, so that equal content gives equal bytes.
    parts = [_TEXT.ljust(116), bytes(8), struct.pack("<H2s", 0x0100, b"IM")]
    for name, value in variables.items():
        packed = zlib.compress(_matrix(name, value))
        parts.append(struct.pack("<II", MI_COMPRESSED, len(packed)) + packed)
    return b"".join(parts)


def _matrix(name: str, value: Any) -> bytes:  # noqa: ANN401
    if isinstance(value, Mapping):
        return _element(MI_MATRIX, _head(CLASS_STRUCT, 0, (1, 1), name) + _fields(value))
    if isinstance(value, str):
        body = _element(_MI_UTF8, value.encode())
        return _element(MI_MATRIX, _head(CLASS_CHAR, 0, (1, len(value)), name) + body)
    array = np.atleast_2d(np.asarray(value))
    flags = FLAG_LOGICAL if array.dtype == np.bool_ else 0
    plain = array.astype(np.uint8) if flags else array.astype(array.dtype.newbyteorder("<"), copy=False)
    stored = _compact(plain)
    head = _head(_CLASSES[plain.dtype], flags, array.shape, name)
    return _element(MI_MATRIX, head + _element(_KINDS[stored.dtype], stored.tobytes(order="F")))


def _compact(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return doubles as the first integer type that holds them all exactly, else as they are."""
    if array.dtype != np.float64 or not array.size:
        return array
    low, high = array.min(), array.max()
    whole = np.isfinite(array).all() and (array == np.floor(array)).all()
    if not whole or np.signbit(array[array == 0]).any():
        return array
    for code in _COMPACT:
        bounds = np.iinfo(code)
        if bounds.min <= low and high <= bounds.max:
            return array.astype("<" + code)
    return array


def _fields(values: Mapping[str, Any]) -> bytes:
    names = b"".join(name.encode("ascii")[: _NAME_WIDTH - 1].ljust(_NAME_WIDTH, b"\0") for name in values)
    out = [_element(MI_INT32, struct.pack("<i", _NAME_WIDTH)), _element(MI_INT8, names)]
    return b"".join(out + [_matrix("", value) for value in values.values()])


def _head(klass: int, flags: int, shape: tuple[int, ...], name: str) -> bytes:
    return (
        _element(MI_UINT32, struct.pack("<II", klass | flags << 8, 0))
        + _element(MI_INT32, np.array(shape, dtype="<i4").tobytes())
        + _element(MI_INT8, name.encode("ascii"))
    )


def _element(kind: int, payload: bytes) -> bytes:
    if len(payload) > MAX_BYTES:
        raise InvalidValueError("MAT-file", expected=f"at most {MAX_BYTES} bytes", found=f"{len(payload)}")
    if kind != MI_MATRIX and 0 < len(payload) <= 4:
        return struct.pack("<HH", kind, len(payload)) + payload.ljust(4, b"\0")
    return struct.pack("<II", kind, len(payload)) + payload + bytes(-len(payload) % 8)
