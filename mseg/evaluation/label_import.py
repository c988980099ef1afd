"""Existing label vectors: MATLAB cell arrays, text, Brox ``.dat``."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import FileFormatError, InputFileError
from kt3dmoseg.files import read_bytes
from kt3dmoseg.io.predictions import first_few, label_vector
from kt3dmoseg.types import Clip, IntArray

CELLS = "ClusterIdx"
_LIMIT = 256 << 20
_MAX_DIGITS = 18  # these fit into 64 bits
_FORMATS = (
    f"a .mat with the cell array {CELLS} (one label vector per sequence, as the authors' scripts save), "
    "or a folder of <clip>.txt (one label per line), <clip>.mat or <clip>.dat (Brox)"
)


def read_label_files(
    source: str | os.PathLike[str], clips: Mapping[str, Clip], *, names: Sequence[str] = ()
) -> dict[str, IntArray]:
    """Read the predictions that somebody has for the given clips.

    Parameters
    ----------
    source : path
        A MAT-file with the cell array `ClusterIdx`, or a folder of one label file per clip.
    clips : mapping of str to Clip
        The clips.
    names : sequence of str
        Names of all sequences of the benchmark, in the order of the cells; used when there are
        as many cells. By default, and otherwise, the clips sorted by name.

    Returns
    -------
    dict of str to (n,) int64
        Labels of the evaluated trajectories, for every clip that was found. Vectors over all
        trajectories of a clip are reduced to the evaluated ones.

    Raises
    ------
    InputFileError, FileFormatError, InvalidValueError
        When nothing is found, a file is none of these formats, or a vector fits no clip.
    """
    path = Path(source)
    found = _folder(path, clips) if path.is_dir() else _cells_by_name(path, clips, names)
    if not found:
        raise InputFileError(f"{path}", expected=_FORMATS, found="labels of none of the clips")
    return {name: fit_to_clip(labels, clips[name], f"{path}: {name}") for name, labels in found.items()}


def fit_to_clip(labels: npt.ArrayLike, clip: Clip, where: str) -> IntArray:
    """Reduce a label vector over all or the evaluated trajectories to the evaluated ones."""
    vector = label_vector(labels, where)
    n, n_all = len(clip.evaluated), len(clip.dense)
    if len(vector) not in (n, n_all):
        expected = f"{n} labels (evaluated trajectories) or {n_all} (all)"
        raise FileFormatError(where, expected=expected, found=f"{len(vector)}")
    return vector if len(vector) == n else vector[clip.evaluated]


def read_cluster_idx(path: Path) -> list[npt.NDArray[Any]]:
    """Read the label vectors of the cell array `ClusterIdx`, in order; empty cells are empty vectors."""
    content = _matlab(path)
    if CELLS not in content:
        raise FileFormatError(f"{path}", expected=f"the variable {CELLS}", found=first_few(list(content)))
    cells = content[CELLS]
    return [np.asarray(v).ravel() for v in (cells.ravel() if cells.dtype == object else [cells])]


def read_label_text(path: Path) -> IntArray:
    """Read one label per line; empty lines and lines that start with # are skipped."""
    lines = read_bytes(path, _LIMIT).decode("utf-8-sig", "replace").splitlines()
    cells = [line.strip().rstrip(",;") for line in lines if line.strip() and not line.startswith("#")]
    wrong = next((c for c in cells if not c.lstrip("+-").isdecimal() or len(c) > _MAX_DIGITS), None)
    if wrong is not None:
        raise FileFormatError(f"{path}", expected="one whole number per line", found=repr(wrong[:40]))
    return np.array(cells, dtype=np.str_).astype(np.int64)


def read_brox_labels(path: Path) -> IntArray:
    """Read the label of each track of a Brox ``.dat``, counted from 1, 0 = none.

    There, clusters count from 0 and -1 means none; a file without a label below 1 is taken as
    counting from 1.
    """
    from kt3dmoseg.io.brox import read_labels

    labels = read_labels(path)
    return labels if labels.min(initial=1) >= 1 else labels + 1


def _folder(folder: Path, clips: Mapping[str, Clip]) -> dict[str, npt.NDArray[Any]]:
    out: dict[str, npt.NDArray[Any]] = {}
    for file in sorted(folder.iterdir()):
        name = next((n for n in (file.stem, file.stem.removesuffix("_Tracks")) if n in clips), None)
        if name is not None and file.suffix.lower() in _READERS:
            if name in out:
                raise FileFormatError(f"{file}", expected=f"one label file for clip {name}", found="several")
            out[name] = _READERS[file.suffix.lower()](file)
    return out


def _cells_by_name(
    path: Path, clips: Mapping[str, Clip], names: Sequence[str]
) -> dict[str, npt.NDArray[Any]]:
    if path.suffix.lower() != ".mat":
        found = path.suffix or ("no ending" if path.exists() else "nothing there")
        raise FileFormatError(f"{path}", expected=_FORMATS, found=found)
    cells = read_cluster_idx(path)
    order = list(names) if len(names) == len(cells) else sorted(clips)
    if len(order) != len(cells):
        raise FileFormatError(
            f"{path}: {CELLS}",
            expected=f"{len(order)} cells, one per clip of the data",
            found=f"{len(cells)}",
            fix="save one label file per clip in a folder instead",
        )
    return {name: v for name, v in zip(order, cells, strict=True) if v.size and name in clips}


def _single_vector(path: Path) -> npt.NDArray[Any]:
    vectors = {
        name: value.ravel()
        for name, value in _matlab(path).items()
        if value.dtype.kind in "iuf" and value.size == max(value.shape, default=0) and value.size > 1
    }
    if len(vectors) != 1:
        found = f"the vectors {first_few(list(vectors)) or 'none'}"
        raise FileFormatError(f"{path}", expected="one vector of labels", found=found)
    return next(iter(vectors.values()))


def _matlab(path: Path) -> dict[str, npt.NDArray[Any]]:
    """Read the variables of a MAT-file of any version, cells included."""
    if not path.is_file():
        raise InputFileError(f"{path}", expected="a MAT-file", found="no such file")
    with path.open("rb") as stream:
        is_hdf5 = b"\x89HDF" in stream.read(1024)
    try:
        if is_hdf5:
            return _matlab73(path)
        from scipy.io import loadmat

        return {k: np.asarray(v) for k, v in loadmat(f"{path}").items() if not k.startswith("__")}
    except Exception as error:  # scipy and h5py raise anything on damaged files
        found = f"a file that cannot be read as one ({type(error).__name__})"
        raise FileFormatError(f"{path}", expected="a MAT-file", found=found) from None


def _matlab73(path: Path) -> dict[str, npt.NDArray[Any]]:
    import h5py

    out: dict[str, npt.NDArray[Any]] = {}
    with h5py.File(path, "r") as file:
        for name, item in file.items():
            if not isinstance(item, h5py.Dataset) or name.startswith("#"):
                continue
            if item.dtype == h5py.ref_dtype:
                # MATLAB stores arrays transposed, cells as references into the same file.
                cells = [np.asarray(file[ref]).ravel() for ref in np.asarray(item).T.ravel()]
                out[name] = np.empty(len(cells), dtype=object)
                out[name][:] = cells
            elif item.dtype.kind in "iuf":
                out[name] = np.asarray(item)
    return out


_READERS: dict[str, Callable[[Path], npt.NDArray[Any]]] = {
    ".txt": read_label_text,
    ".csv": read_label_text,
    ".dat": read_brox_labels,
    ".mat": _single_vector,
}
