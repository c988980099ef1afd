"""The MAT-file container, version 5: numeric arrays, texts and structs, read without trusting a size.

Follows the public "MAT-File Format" description. Cells, sparse arrays, objects and function handles
are named but not decoded. Version 7.3 (HDF5) and version 4 are refused.
"""

from __future__ import annotations

import math
import os
import struct
import zlib
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import FileFormatError
from kt3dmoseg.files import read_bytes

MAX_BYTES = 1 << 30
# zlib packs a run of zeros a thousandfold; trajectories with many gaps reach some tens.
_MAX_RATIO, _RATIO_FREE = 300, 1 << 24
_MAX_DEPTH, _MAX_FIELDS, _MAX_DIMS = 8, 4096, 8
_HEADER = 128

MI_MATRIX, MI_COMPRESSED, MI_INT32, MI_UINT32, MI_INT8 = 14, 15, 5, 6, 1
STORAGE = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_TEXT = {1: "utf-8", 2: "utf-8", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
NUMERIC = {
    6: "f8",
    7: "f4",
    8: "i1",
    9: "u1",
    10: "i2",
    11: "u2",
    12: "i4",
    13: "u4",
    14: "i8",
    15: "u8",
}
_OTHER = {1: "cell", 3: "object", 5: "sparse", 16: "function handle", 17: "opaque object", 18: "object"}
CLASS_STRUCT, CLASS_CHAR = 2, 4
FLAG_COMPLEX, FLAG_LOGICAL = 0x08, 0x02


class Undecoded(NamedTuple):
    """A variable of a class that is not decoded: what it is and its dimensions."""

    kind: str
    shape: tuple[int, ...]


Value: TypeAlias = "npt.NDArray[Any] | str | dict[str, Value] | Undecoded"


def read_mat(path: str | os.PathLike[str]) -> dict[str, Value]:
    """Read every variable of a version 5 MAT-file.

    Parameters
    ----------
    path : path
        The file.

    Returns
    -------
    dict of str to value
        Arrays have the class that MATLAB shows (double, logical, ...), whatever integer type the
        file stores them in. A 1x1 struct is a dict, a row of characters a str.

    Raises
    ------
    FileFormatError
        When the file is not a version 5 MAT-file, is truncated, or lies about a size.
    InputFileError
        When it cannot be read or is larger than `MAX_BYTES`.
    """
    where = os.fspath(path)
    content = read_bytes(path, MAX_BYTES)
    order = _check_header(content, where)
    reader = _Reader(where, order, memoryview(content)[_HEADER:])
    out: dict[str, Value] = {}
    while reader.left():
        name, value = reader.variable()
        if name:
            out[name] = value
    return out


def _check_header(content: bytes, where: str) -> str:
    version5 = "a MATLAB version 5 to 7 MAT-file"
    if content[:19] == b"MATLAB 7.3 MAT-file" or content[:8] == b"\x89HDF\r\n\x1a\n":
        raise FileFormatError(
            where,
            expected=version5,
            found="version 7.3 (HDF5)",
            fix="save it again in MATLAB with the option '-v7'",
        )
    mark = content[126:128]
    if len(content) < _HEADER or mark not in (b"IM", b"MI") or content[:6] != b"MATLAB":
        raise FileFormatError(where, expected=version5, found=_describe_start(content))
    return "<" if mark == b"IM" else ">"


def _describe_start(content: bytes) -> str:
    if not content:
        return "an empty file"
    if len(content) < _HEADER:
        return f"{len(content)} bytes, less than a header; the file is truncated"
    return f"a file that starts with {content[:8]!r}"


@dataclass
class _Reader:
    """Walks over the elements of one stretch of bytes."""

    where: str
    order: str
    data: memoryview
    at: int = 0
    depth: int = 0

    def left(self) -> int:
        return len(self.data) - self.at

    def variable(self) -> tuple[str, Value]:
        kind, payload = self.element()
        if kind == MI_COMPRESSED:
            inner = _Reader(self.where, self.order, self._inflate(payload))
            kind, payload = inner.element()
        if kind != MI_MATRIX:
            raise self.fail("a matrix element", f"an element of type {kind}")
        return self._inside(payload, 1).matrix()

    def element(self) -> tuple[int, memoryview]:
        """Return the type and the bytes of the next element, after checking that they are there."""
        if self.left() < 8:
            raise self.fail("an 8-byte tag", f"{self.left()} bytes; the file is truncated")
        word, size = struct.unpack_from(self.order + "II", self.data, self.at)
        if word >> 16:
            kind, size, start, step = word & 0xFFFF, word >> 16, self.at + 4, 8
            if size > 4:
                raise self.fail("at most 4 bytes in a small element", f"{size}")
        else:
            kind, start = word, self.at + 8
            step = 8 + (size if kind == MI_COMPRESSED else -(-size // 8) * 8)
        if start + size > len(self.data):
            raise self.fail(
                f"{size} bytes of an element", f"{len(self.data) - start}; the file is truncated or damaged"
            )
        self.at = min(self.at + step, len(self.data))
        return kind, self.data[start : start + size]

    def matrix(self) -> tuple[str, Value]:
        if not self.left():
            return "", np.zeros((0, 0))
        flags = self._numbers({MI_UINT32}, 2, "array flags")
        shape = tuple(int(n) for n in self._numbers({MI_INT32}, _MAX_DIMS, "dimensions"))
        if len(shape) < 2 or min(shape) < 0:
            raise self.fail("two or more dimensions >= 0", str(shape))
        if 0 in shape and math.prod(n or 1 for n in shape) > _RATIO_FREE:
            raise self.fail(f"at most {_RATIO_FREE} places in an empty array", str(shape))
        name = bytes(self._typed({MI_INT8}, "a name")).decode("latin-1")
        return name, self._value(int(flags[0]) & 0xFF, int(flags[0]) >> 8 & 0xFF, shape)

    def _value(self, klass: int, flags: int, shape: tuple[int, ...]) -> Value:
        if klass == CLASS_STRUCT and shape == (1, 1):
            return self._struct()
        if klass == CLASS_CHAR and shape[0] <= 1 and len(shape) == 2:
            return self._text(shape)
        if klass in NUMERIC and not flags & FLAG_COMPLEX:
            return self._array(np.dtype(bool if flags & FLAG_LOGICAL else NUMERIC[klass]), shape)
        names = _OTHER | {CLASS_STRUCT: "struct array", CLASS_CHAR: "text array"}
        return Undecoded("complex" if klass in NUMERIC else names.get(klass, f"class {klass}"), shape)

    def _array(self, dtype: np.dtype[Any], shape: tuple[int, ...]) -> npt.NDArray[Any]:
        kind, payload = self.element()
        if kind not in STORAGE:
            raise self.fail("numbers", f"an element of type {kind}")
        stored = np.dtype(self.order + STORAGE[kind])
        if math.prod(shape) * stored.itemsize != len(payload):
            raise self.fail(
                f"{math.prod(shape) * stored.itemsize} bytes for an array {shape}", f"{len(payload)}"
            )
        return np.frombuffer(payload, stored).astype(dtype).reshape(shape, order="F")

    def _text(self, shape: tuple[int, ...]) -> str:
        if not math.prod(shape):
            return ""
        payload = self._typed(set(_TEXT), "text")
        kind_bytes = len(payload) // math.prod(shape)
        codec = {1: "utf-8", 2: "utf-16-le" if self.order == "<" else "utf-16-be"}.get(kind_bytes, "utf-8")
        return bytes(payload).decode(codec, errors="replace")

    def _struct(self) -> dict[str, Value]:
        width = int(self._numbers({MI_INT32}, 1, "field name length")[0])
        names = bytes(self._typed({MI_INT8}, "field names"))
        if width < 1 or len(names) % width or len(names) // width > _MAX_FIELDS:
            raise self.fail("field names of one length", f"{len(names)} bytes in pieces of {width}")
        out: dict[str, Value] = {}
        for start in range(0, len(names), width):
            name = names[start : start + width].split(b"\0")[0].decode("latin-1")
            kind, payload = self.element()
            if kind != MI_MATRIX:
                raise self.fail(f"a matrix in field {name!r}", f"an element of type {kind}")
            out[name] = self._inside(payload, self.depth + 1).matrix()[1]
        return out

    def _numbers(self, kinds: set[int], most: int, what: str) -> npt.NDArray[Any]:
        payload = self._typed(kinds, what)
        if not 4 <= len(payload) <= 4 * most or len(payload) % 4:
            raise self.fail(f"{what} of 4 to {4 * most} bytes", f"{len(payload)}")
        return np.frombuffer(payload, self.order + "i4")

    def _typed(self, kinds: set[int], what: str) -> memoryview:
        kind, payload = self.element()
        if kind not in kinds:
            raise self.fail(what, f"an element of type {kind}")
        return payload

    def _inside(self, payload: memoryview, depth: int) -> _Reader:
        if depth > _MAX_DEPTH:
            raise self.fail(f"at most {_MAX_DEPTH} structs inside each other", "more")
        return _Reader(self.where, self.order, payload, depth=depth)

    def _inflate(self, packed: memoryview) -> memoryview:
        """Unpack one element: first its tag, then no more than the tag says."""
        unpack = zlib.decompressobj()
        try:
            tag = unpack.decompress(packed, 8)
            if len(tag) < 8:
                raise self.fail("a packed element", "too few bytes; the file is truncated")
            size = struct.unpack(self.order + "I", tag[4:])[0]
            limit = min(MAX_BYTES, max(_RATIO_FREE, _MAX_RATIO * len(packed)))
            if size > limit:
                raise self.fail(f"at most {limit} bytes in a packed element", f"{size}")
            return memoryview(tag + unpack.decompress(unpack.unconsumed_tail, size + 8))
        except zlib.error as error:
            raise self.fail("zlib data", f"{error}; the file is truncated or damaged") from None

    def fail(self, expected: str, found: str) -> FileFormatError:
        return FileFormatError(f"{self.where}: MAT-file", expected=expected, found=found)
