"""The MAT-file container, version 5: arrays, texts and structs, read without trusting a size.

Follows "MAT-File Format" (MathWorks). scipy's reader is not used: damaged files crash it. Cells, sparse
arrays, objects and function handles are named but not decoded. Version 7.3 (HDF5) and version 4 are refused.
"""

from __future__ import annotations

import math
import os
import struct
import zlib
from collections.abc import Iterator
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import FileFormatError
from kt3dmoseg.files import read_bytes

MAX_BYTES = 1 << 30
# zlib packs a run of zeros a thousandfold; trajectories with many gaps reach some tens.
_MAX_RATIO, _FREE = 300, 1 << 24
_MAX_DEPTH, _MAX_FIELDS, _MAX_DIMS = 8, 4096, 8
_HEADER = 128
_MATRIX, _COMPRESSED, _INT32, _UINT32, _INT8 = 14, 15, 5, 6, 1
_STORAGE = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_TEXT = (1, 2, 4, 16, 17, 18)
_NUMERIC = dict(enumerate(("f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8"), start=6))
_STRUCT, _CHAR = 2, 4
_OTHER = {1: "cell", 2: "struct array", 3: "object", 4: "text array", 5: "sparse", 16: "function handle"}
_IS_COMPLEX, _IS_LOGICAL = 0x08, 0x02

Value: TypeAlias = "npt.NDArray[Any] | str | dict[str, Value] | Undecoded"
_Parts: TypeAlias = Iterator[tuple[int, memoryview]]


class Undecoded(NamedTuple):
    """A variable of a class that is not decoded: what it is and its dimensions."""

    kind: str
    shape: tuple[int, ...]


def read_mat(path: str | os.PathLike[str]) -> dict[str, Value]:
    """Read every variable of a version 5 MAT-file of at most `MAX_BYTES`.

    Arrays have the class that MATLAB shows (double, logical, ...), whatever integer type the file stores
    them in. A 1x1 struct is a dict, a row of characters a str, other classes are `Undecoded`.
    """
    where = os.fspath(path)
    content = read_bytes(path, MAX_BYTES)
    _check_version(content, where)
    reader = _Reader("<" if content[126:128] == b"IM" else ">")
    try:
        with np.errstate(invalid="ignore"):  # an odd file may store NaN of a class of whole numbers
            named = [reader.variable(*part) for part in reader.parts(memoryview(content)[_HEADER:])]
    except (ValueError, struct.error, zlib.error, StopIteration) as error:
        reason = f"{str(error) or 'an element is missing'}; the file is damaged or truncated"
        raise FileFormatError(f"{where}: MAT-file", expected="intact elements", found=reason) from None
    return {name: value for name, value in named if name}


def _check_version(content: bytes, where: str) -> None:
    found, fix = f"a file that starts with {content[:8]!r}", ""
    if content[:19] == b"MATLAB 7.3 MAT-file" or content[:8] == b"\x89HDF\r\n\x1a\n":
        found, fix = "version 7.3 (HDF5)", "save it again in MATLAB with the option '-v7'"
    elif len(content) < _HEADER:
        found = f"{len(content)} bytes, less than a header; the file is truncated"
    elif content[:6] == b"MATLAB" and content[126:128] in (b"IM", b"MI"):
        return
    raise FileFormatError(where, expected="a MATLAB version 5 to 7 MAT-file", found=found, fix=fix)


class _Reader:
    """Decodes elements, each within the one that holds it; damage raises ValueError and the like."""

    def __init__(self, order: str) -> None:
        self.order = order

    def parts(self, data: memoryview) -> _Parts:
        """Give type and bytes of each element, after checking that they are there."""
        at = 0
        while at < len(data):
            kind, size = struct.unpack_from(self.order + "II", data, at)
            start, step = at + 8, 8 + size + (0 if kind == _COMPRESSED else -size % 8)
            if kind >> 16:  # up to 4 bytes lie in the tag itself
                kind, size, start, step = kind & 0xFFFF, min(kind >> 16, 4), at + 4, 8
            if start + size > len(data):
                raise ValueError(f"an element of {size} bytes where {len(data) - start} are left")
            yield kind, data[start : start + size]
            at += step

    def variable(self, kind: int, payload: memoryview) -> tuple[str, Value]:
        if kind == _COMPRESSED:
            kind, payload = next(self.parts(self._inflate(payload)))
        if kind != _MATRIX:
            raise ValueError(f"an element of type {kind} for a variable")
        return self._matrix(payload, 1)

    def _inflate(self, packed: memoryview) -> memoryview:
        """Unpack one element: first its tag, then no more than the tag declares."""
        unpack = zlib.decompressobj()
        tag = unpack.decompress(packed, 8)
        (size,) = struct.unpack(self.order + "4xI", tag)
        limit = min(MAX_BYTES, max(_FREE, _MAX_RATIO * len(packed)))
        if size > limit:
            raise ValueError(f"{size} bytes in a packed element, more than {limit}")
        return memoryview(tag + unpack.decompress(unpack.unconsumed_tail, size + 8))

    def _matrix(self, data: memoryview, depth: int) -> tuple[str, Value]:
        if depth > _MAX_DEPTH:
            raise ValueError(f"more than {_MAX_DEPTH} structs inside each other")
        if not data:
            return "", np.zeros((0, 0))
        parts = self.parts(data)
        flags = self._integers(parts, _UINT32, 2)[0]
        shape = self._integers(parts, _INT32, _MAX_DIMS)
        if len(shape) < 2 or min(shape) < 0 or (0 in shape and math.prod(n or 1 for n in shape) > _FREE):
            raise ValueError(f"dimensions {shape}")
        name, klass = bytes(self._next(parts, (_INT8,))).decode("latin-1"), flags & 0xFF
        if klass == _STRUCT and shape == (1, 1):
            return name, self._struct(parts, depth)
        if klass == _CHAR and shape[0] <= 1 and len(shape) == 2:
            return name, self._text(parts, math.prod(shape))
        if klass in _NUMERIC and not flags >> 8 & _IS_COMPLEX:
            kind, payload = next(parts)
            if kind not in _STORAGE:
                raise ValueError(f"an element of type {kind} for numbers")
            values = np.frombuffer(payload, self.order + _STORAGE[kind])
            dtype = np.dtype(bool if flags >> 8 & _IS_LOGICAL else _NUMERIC[klass])
            return name, values.astype(dtype).reshape(shape, order="F")
        return name, Undecoded("complex" if klass in _NUMERIC else _OTHER.get(klass, f"class {klass}"), shape)

    def _text(self, parts: _Parts, length: int) -> str:
        if not length:
            return ""
        payload = bytes(self._next(parts, _TEXT))
        two_bytes = "utf-16-le" if self.order == "<" else "utf-16-be"
        return payload.decode(two_bytes if len(payload) // length == 2 else "utf-8", errors="replace")

    def _struct(self, parts: _Parts, depth: int) -> dict[str, Value]:
        width = self._integers(parts, _INT32, 1)[0]
        names = bytes(self._next(parts, (_INT8,)))
        if width < 1 or len(names) % width or len(names) // width > _MAX_FIELDS:
            raise ValueError(f"{len(names)} bytes of field names in pieces of {width}")
        out: dict[str, Value] = {}
        for start in range(0, len(names), width):
            name = names[start : start + width].split(b"\0")[0].decode("latin-1")
            out[name] = self._matrix(self._next(parts, (_MATRIX,)), depth + 1)[1]
        return out

    def _integers(self, parts: _Parts, kind: int, most: int) -> tuple[int, ...]:
        payload = self._next(parts, (kind,))
        if not 4 <= len(payload) <= 4 * most:
            raise ValueError(f"{len(payload)} bytes for up to {most} whole numbers")
        return struct.unpack(f"{self.order}{len(payload) // 4}i", payload)

    def _next(self, parts: _Parts, kinds: tuple[int, ...]) -> memoryview:
        kind, payload = next(parts)
        if kind not in kinds:
            raise ValueError(f"an element of type {kind} for one of {kinds}")
        return payload
