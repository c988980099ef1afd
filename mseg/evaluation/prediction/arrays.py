"""Prediction files as arrays: npz and HDF5 with the vectors `track` and `label`, never pickles."""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import KT3DMoSegError
from mseg.evaluation.problems import first_few

NAMES = ("track", "label")
MAX_ROWS = 1_000_000
_MAX_HEADER = 4096
_FIX = "save two integer vectors: np.savez(file, track=ids, label=labels)"


@dataclass
class Columns:
    """The two columns of a file as far as they could be read, and what was wrong."""

    track: npt.NDArray[Any] | None = None
    label: npt.NDArray[Any] | None = None
    problems: list[tuple[str, str, str, str]] = field(default_factory=list)

    def bad(self, code: str, expected: str, found: str, fix: str) -> Columns:
        """Note a problem."""
        self.problems.append((code, expected, found, fix))
        return self


def parse_npz(content: bytes) -> Columns:
    """Read an npz: the header of each array is checked before the array is touched."""
    return _guarded(content, _npz, "an npz archive of numpy")


def parse_h5(content: bytes) -> Columns:
    """Read an HDF5 file: only plain datasets of this very file, of checked size."""
    return _guarded(content, _h5, "an HDF5 file")


def _guarded(content: bytes, parse: Callable[[bytes, Columns], None], kind: str) -> Columns:
    out = Columns()
    try:
        parse(content, out)
    except Exception as error:  # zipfile, numpy and libhdf5 raise anything on hostile bytes
        reason = str(error) if isinstance(error, KT3DMoSegError) else type(error).__name__
        found = f"a file that starts with {content[:8]!r} and cannot be read ({reason[:200]})"
        return Columns().bad("unreadable", kind, found, _FIX)
    return out


def _npz(content: bytes, out: Columns) -> None:
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = {i.filename.removesuffix(".npy"): i for i in archive.infolist()}
        _check_names(list(members), out)
        for name in NAMES:
            if name in members:
                with archive.open(members[name]) as stream:
                    _npy(stream, members[name].file_size, name, out)


def _npy(stream: Any, size: int, name: str, out: Columns) -> None:  # noqa: ANN401  # a binary stream
    version = np.lib.format.read_magic(stream)
    read_header = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }[version]
    shape, _, dtype = read_header(stream, max_header_size=_MAX_HEADER)
    if dtype.hasobject:
        out.bad(
            "object-array",
            f"integers in '{name}'",
            "an array of Python objects (a pickle), which is never opened",
            "save labels.astype(np.int64)",
        )
    elif _shape_is_fine(shape, name, out):
        count = math.prod(shape)
        if dtype.itemsize * count > size:
            out.bad("truncated", f"{count} values in '{name}'", "fewer bytes", _FIX)
            return
        data = stream.read(dtype.itemsize * count)
        setattr(out, name, np.frombuffer(data, dtype=dtype, count=count))


def _h5(content: bytes, out: Columns) -> None:
    import h5py

    from kt3dmoseg.io.hdf5 import read_array

    with h5py.File(io.BytesIO(content), "r") as file:
        present = [name for name in file if name in NAMES] or list(file)[:10]
        _check_names(present, out)
        for name in NAMES:
            if name not in present:
                continue
            dataset = file[name] if isinstance(file.get(name, getlink=True), h5py.HardLink) else None
            if not isinstance(dataset, h5py.Dataset):
                out.bad("not-a-dataset", f"a dataset '{name}' in this file", "a link or group", _FIX)
            elif dataset.dtype.kind not in "iuf":
                out.bad("not-a-number", f"integers in '{name}'", f"type {dataset.dtype}", _FIX)
            elif _shape_is_fine(dataset.shape, name, out):
                setattr(out, name, read_array(file, name, "file", dataset.dtype.str, 1))


def _check_names(present: list[str], out: Columns) -> None:
    missing = [name for name in NAMES if name not in present]
    if missing:
        wanted = " and ".join(f"'{name}'" for name in missing)
        out.bad("missing-array", f"arrays named {wanted}", first_few(present) or "no array", _FIX)


def _shape_is_fine(shape: tuple[int, ...], name: str, out: Columns) -> bool:
    if len(shape) != 1:
        fix = "transpose or flatten it: labels.ravel()" if len(shape) == 2 else _FIX
        out.bad("transposed", f"'{name}' of shape (n,)", f"shape {shape}", fix)
    elif shape[0] > MAX_ROWS:
        out.bad("too-large", f"at most {MAX_ROWS} values in '{name}'", f"{shape[0]}", _FIX)
    else:
        if name == "track" or out.track is None or len(out.track) == shape[0]:
            return True
        out.bad("ragged", f"as many labels as tracks ({len(out.track)})", f"{shape[0]}", _FIX)
    return False
