"""NumPy files: arrays read without pickles and without trusting a size; clips written as .npz.

docs/formats.md lists the arrays of a clip, for those who have no HDF5.
"""

import io
import math
import os
from collections.abc import Container, Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import FileFormatError
from kt3dmoseg.files import PathLike, SafeZip, ZipLimits, write_bytes, zip_bytes
from kt3dmoseg.io.fields import clip_values
from kt3dmoseg.types import Clip

_FREE = 1 << 24
# A video of TAP-Vid may be large; most of it is not read.
_LIMITS = ZipLimits(256, 1 << 32, 1 << 40, ratio=100, free_bytes=1 << 26)
_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
_MAX_HEADER = 10_000


def read_npz(path: PathLike, shapes: Container[str] = (), rows: int = 0) -> dict[str, npt.NDArray[Any]]:
    """Read the arrays of a .npz file; FileFormatError when it is damaged, or one is refused by `read_npy`.

    Of those named in `shapes` only shape and type are read: their values are zeros, which take no memory;
    with `rows`, their first rows.
    """
    where, out = os.fspath(path), {}
    with SafeZip(path, _LIMITS, where) as archive:
        for file, size in archive.sizes.items():
            name = file.removesuffix(".npy")
            if name == file:
                raise FileFormatError(where, expected="arrays (.npy)", found=file, fix="unpack the archive")
            with archive.open(file) as stream:
                out[name] = read_npy(stream, size, f"{where}: {name}", rows if name in shapes else None)
    return out


def is_lone_array(path: Path) -> bool:
    """Whether a file is a .npz of a single array."""
    with SafeZip(path, _LIMITS, f"{path}", faults=[]) as archive:
        return len(archive.sizes) == 1


def read_npy(stream: IO[bytes], size: int, where: str, rows: int | None = None) -> npt.NDArray[Any]:
    """Read a .npy of numbers or texts from a stream of at most `size` bytes, or its first rows only.

    Of 0 rows, or of a file in Fortran's order, there are shape and type, and zeros.

    FileFormatError when it is damaged, declares a wrong size, or holds Python objects that would be read.
    """
    try:
        shape, fortran, dtype = read_header(stream)
    except Exception as error:  # a header is a Python literal: numpy raises anything on a damaged one
        found = f"damage: {str(error)[:200]}"
        raise FileFormatError(where, expected="an intact .npy of version 1 or 2", found=found) from None
    if rows != 0 and (dtype.kind not in "biufcSU" or dtype.hasobject):
        fix = "objects need pickle, which is never read"
        raise FileFormatError(where, expected="numbers or texts", found=f"{dtype!s:.80}", fix=fix)
    if min(shape, default=0) < 0 or (0 in shape and math.prod(n or 1 for n in shape) > _FREE):
        expected = f"dimensions >= 0, in an empty array at most {_FREE} elements"
        raise FileFormatError(where, expected=expected, found=f"{shape!r:.80}")
    if rows == 0 or (rows and fortran):
        return np.broadcast_to(np.zeros((), dtype), shape)
    shape = (min(rows, shape[0]), *shape[1:]) if rows else shape
    needed = math.prod(shape) * dtype.itemsize
    content = stream.read(needed) if needed <= size else b""
    if len(content) != needed:
        found = f"{len(content)}" if needed <= size else f"at most {size}"
        raise FileFormatError(where, expected=f"{needed} bytes for {shape}", found=found)
    return np.frombuffer(content, dtype).reshape(shape, order="F" if fortran else "C").copy()


def read_header(stream: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Read shape, order (whether Fortran's) and type of a .npy; on a damaged one numpy raises anything."""
    return _HEADERS[np.lib.format.read_magic(stream)](stream, max_header_size=_MAX_HEADER)


def write_npz(path: PathLike, arrays: Mapping[str, npt.ArrayLike]) -> None:
    """Write a compressed .npz atomically; equal arrays give equal bytes."""
    write_bytes(path, zip_bytes({f"{name}.npy": npy_bytes(np.asarray(a)) for name, a in arrays.items()}))


def npy_bytes(array: npt.NDArray[Any]) -> bytes:
    """Return the content of a .npy file."""
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, array, allow_pickle=False)
    return buffer.getvalue()


def write(clip: Clip, path: PathLike) -> None:
    """Write a clip; the same clip gives the same bytes."""
    write_npz(
        path, {"name": clip.name, "xy": clip.dense.xy, "visible": clip.dense.visible} | clip_values(clip)
    )
