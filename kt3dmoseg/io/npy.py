"""NumPy's .npy and .npz without pickles, and without trusting a size."""

from __future__ import annotations

import ast
import io
import math
import os
import re
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import FileFormatError, InputFileError
from kt3dmoseg.files import write_bytes

MAX_BYTES = 1 << 32
_MAX_RATIO, _RATIO_FREE = 1100, 1 << 24
_MAX_MEMBERS, _MAX_HEADER = 256, 10_000
_NUMBERS_OR_TEXT = re.compile(r"[<>|=]?(b1|[iu][1248]|f[248]|c(8|16)|[SU][1-9]\d{0,8})")
_DAMAGE = (
    zipfile.BadZipFile,
    zlib.error,
    ValueError,
    TypeError,
    KeyError,
    EOFError,
    RuntimeError,
    NotImplementedError,
    RecursionError,
    MemoryError,
    OverflowError,
    SyntaxError,
)


def read_npy(path: str | os.PathLike[str]) -> npt.NDArray[Any]:
    """Read a .npy file of numbers or texts.

    Raises
    ------
    FileFormatError
        When it is damaged, holds Python objects, or lies about its size.
    InputFileError
        When it cannot be read.
    """
    with _one_line(os.fspath(path)), open(path, "rb") as stream:
        return _array(stream, os.fstat(stream.fileno()).st_size, os.fspath(path))


def npz_shapes(path: str | os.PathLike[str]) -> dict[str, tuple[int, ...]]:
    """Names and shapes of the arrays of a .npz file; only their headers are read."""
    with _one_line(os.fspath(path)), zipfile.ZipFile(path) as archive:
        return {
            name: _header(stream, os.fspath(path))[0] for name, stream, _ in _members(archive, path, None)
        }


def read_npz(path: str | os.PathLike[str], names: Iterable[str] | None = None) -> dict[str, npt.NDArray[Any]]:
    """Read the arrays of a .npz file.

    Parameters
    ----------
    path : path
        The file.
    names : iterable of str, optional
        Only these, as far as they are there; by default all.

    Raises
    ------
    FileFormatError
        When it is damaged, holds Python objects, or lies about a size.
    InputFileError
        When it cannot be read.
    """
    where = os.fspath(path)
    wanted = None if names is None else set(names)
    with _one_line(where), zipfile.ZipFile(path) as archive:
        return {
            name: _array(stream, size, f"{where}: {name}")
            for name, stream, size in _members(archive, path, wanted)
        }


def write_npz(path: str | os.PathLike[str], arrays: Mapping[str, npt.NDArray[Any]]) -> None:
    """Write a compressed .npz atomically; equal arrays give equal bytes."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in arrays.items():
            content = io.BytesIO()
            np.lib.format.write_array(content, np.asarray(array), allow_pickle=False)
            archive.writestr(_entry(name), content.getvalue())
    write_bytes(path, buffer.getvalue())


def _entry(name: str) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(f"{name}.npy")  # dated 1980, whatever the day
    entry.compress_type = zipfile.ZIP_DEFLATED
    return entry


def _members(
    archive: zipfile.ZipFile, path: str | os.PathLike[str], wanted: set[str] | None
) -> Iterator[tuple[str, IO[bytes], int]]:
    entries = archive.infolist()
    if len(entries) > _MAX_MEMBERS:
        raise FileFormatError(
            os.fspath(path), expected=f"at most {_MAX_MEMBERS} arrays", found=f"{len(entries)}"
        )
    for entry in entries:
        name = entry.filename.removesuffix(".npy")
        if wanted is not None and name not in wanted:
            continue
        limit = min(MAX_BYTES, max(_RATIO_FREE, _MAX_RATIO * entry.compress_size))
        if entry.file_size > limit:
            place = f"{os.fspath(path)}: {name}"
            raise FileFormatError(place, expected=f"at most {limit} bytes", found=f"{entry.file_size}")
        with archive.open(entry) as stream:
            yield name, stream, entry.file_size


def _array(stream: IO[bytes], size: int, where: str) -> npt.NDArray[Any]:
    shape, fortran, dtype = _header(stream, where)
    needed = math.prod(shape) * dtype.itemsize
    if needed > size:
        raise FileFormatError(where, expected=f"{needed} bytes for {shape}", found=f"at most {size}")
    content = stream.read(needed)
    if len(content) != needed:
        raise FileFormatError(where, expected=f"{needed} bytes for {shape}", found=f"{len(content)}")
    return np.frombuffer(content, dtype).reshape(shape, order="F" if fortran else "C").copy()


def _header(stream: IO[bytes], where: str) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Parse the header of the npy format, versions 1 and 2: a Python literal of three known keys."""
    start = stream.read(8)
    width = {b"\1\0": 2, b"\2\0": 4}.get(start[6:])
    if start[:6] != b"\x93NUMPY" or width is None:
        raise FileFormatError(where, expected="a .npy of version 1 or 2", found=repr(start))
    size = int.from_bytes(stream.read(width), "little")
    if size > _MAX_HEADER:
        raise FileFormatError(where, expected=f"a header of at most {_MAX_HEADER} bytes", found=f"{size}")
    header = ast.literal_eval(stream.read(size).decode("latin-1").strip())
    shape, fortran, descr = header["shape"], header["fortran_order"], header["descr"]
    if not isinstance(descr, str) or not _NUMBERS_OR_TEXT.fullmatch(descr):
        fix = "objects need pickle, which is never read"
        raise FileFormatError(where, expected="numbers or texts", found=f"{descr!r:.80}", fix=fix)
    if not all(isinstance(n, int) and n >= 0 for n in shape) or fortran not in (True, False):
        raise FileFormatError(where, expected="dimensions >= 0", found=f"{shape!r:.80}")
    if 0 in shape and math.prod(n or 1 for n in shape) > _RATIO_FREE:
        expected = f"at most {_RATIO_FREE} places in an empty array"
        raise FileFormatError(where, expected=expected, found=f"{shape!r:.80}")
    return tuple(shape), fortran, np.dtype(descr)


@contextmanager
def _one_line(where: str) -> Iterator[None]:
    """Turn whatever a damaged file raises on the way into one line."""
    try:
        yield
    except FileFormatError:
        raise
    except OSError as error:
        raise InputFileError(f"{where}: {error.strerror or error}") from None
    except _DAMAGE as error:
        raise FileFormatError(
            where, expected="a sound .npy or .npz", found=f"damage: {str(error)[:200]}"
        ) from None
