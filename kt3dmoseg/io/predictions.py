"""Predicted labels of one clip, to be looked at: `track` and `label`, joined by id.

Scoring reads them in mseg, which reports every fault; here the first one stops.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import FileFormatError, InvalidValueError
from kt3dmoseg.files import read_bytes
from kt3dmoseg.io.npz import read_npz
from kt3dmoseg.types import Clip, IntArray

_MAX_FILE = 1 << 27
_HEADER = "track,label"
_ROW = re.compile(r"\s*(-?[0-9]{1,18})\s*,\s*(-?[0-9]{1,18})\s*")  # 18 digits fit into 64 bits


def read_prediction(path: str | os.PathLike[str], clip: Clip) -> IntArray:
    """Read the predicted labels of the evaluated trajectories of a clip.

    Parameters
    ----------
    path : path
        ``.csv`` with the header ``track,label``, or ``.npz`` or ``.h5`` with the vectors `track` and
        `label`.
    clip : Clip
        The clip; tracks are found by their ids.

    Returns
    -------
    (n,) int64
        In the order of ``clip.evaluated``.

    Raises
    ------
    InputFileError
        When the file cannot be read.
    FileFormatError
        When it is of another form, or not of this clip.
    """
    where = os.fspath(path)
    reader = _READERS.get(Path(path).suffix.lower())
    if reader is None:
        raise InvalidValueError(where, expected=f"a suffix of {', '.join(_READERS)}", found=Path(path).suffix)
    track, label = (_vector(values, where) for values in reader(where))
    if len(track) != len(label) or len(np.unique(track)) != len(track):
        raise FileFormatError(where, expected="one label for each track", found=f"{len(track)}, {len(label)}")
    wanted = clip.dense.track_id[clip.evaluated]
    if len(other := np.setxor1d(wanted, track)):
        raise FileFormatError(
            where,
            expected=f"labels of the {len(wanted)} evaluated tracks of {clip.name}",
            found=f"{'none' if other[0] in wanted else 'one'} of track {other[0]}",
            fix="give the prediction of this very clip",
        )
    order = np.argsort(track)
    return label[order][np.searchsorted(track[order], wanted)]


def _csv(where: str) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    lines = read_bytes(where, _MAX_FILE).decode("utf-8-sig", errors="replace").splitlines()
    if not lines or lines[0].strip() != _HEADER:
        raise FileFormatError(where, expected=f"the header {_HEADER}", found=repr("".join(lines[:1])[:40]))
    numbered = ((number, line) for number, line in enumerate(lines[1:], start=2) if line.strip())
    rows = np.array([_row(line, f"{where}: line {number}") for number, line in numbered], dtype=np.int64)
    return rows.reshape(-1, 2)[:, 0], rows.reshape(-1, 2)[:, 1]


def _row(line: str, where: str) -> tuple[int, int]:
    found = _ROW.fullmatch(line)
    if found is None:
        raise FileFormatError(where, expected="two whole numbers", found=repr(line[:40]))
    return int(found[1]), int(found[2])


def _npz(where: str) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    arrays = read_npz(where, {"track", "label"})
    if len(arrays) != 2:
        raise FileFormatError(where, expected="the arrays track and label", found=", ".join(arrays) or "none")
    return arrays["track"], arrays["label"]


def _hdf5(where: str) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    from kt3dmoseg.io.hdf5 import open_hdf5, read_array

    with open_hdf5(where) as file:
        return read_array(file, "track", where, "i8", 1), read_array(file, "label", where, "i8", 1)


def _vector(values: npt.NDArray[Any], where: str) -> IntArray:
    if values.ndim != 1 or values.dtype.kind not in "iu":
        raise FileFormatError(
            where, expected="vectors of whole numbers", found=f"{values.dtype} {values.shape}"
        )
    return values.astype(np.int64)


_READERS: dict[str, Callable[[str], tuple[npt.NDArray[Any], npt.NDArray[Any]]]] = {
    ".csv": _csv,
    ".npz": _npz,
    ".h5": _hdf5,
}
