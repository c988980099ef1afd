"""Label vectors that people already have: MATLAB cell arrays, text, Brox ``.dat``."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError, KT3DMoSegError
from kt3dmoseg.files import read_bytes
from kt3dmoseg.io.predictions import first_few
from kt3dmoseg.types import Clip, IntArray
from mseg.evaluation.contingency import label_vector

CELLS = "ClusterIdx"
_LIMIT = 256 << 20
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
    try:
        vector = label_vector(labels, where)
    except InvalidValueError as error:
        raise FileFormatError(str(error)) from None
    n, n_all = len(clip.evaluated), len(clip.dense)
    if len(vector) == n:
        return vector
    if len(vector) == n_all:
        return vector[clip.evaluated]
    raise FileFormatError(
        where, expected=f"{n} labels (evaluated trajectories) or {n_all} (all)", found=f"{len(vector)}"
    )


def read_cluster_idx(path: str | os.PathLike[str]) -> list[npt.NDArray[Any]]:
    """Read the label vectors of the cell array `ClusterIdx`, in order; empty cells are empty vectors.

    Raises
    ------
    FileFormatError
        When it is no MAT-file with that variable.
    """
    content = _guarded(Path(path), _read_mat73 if _is_hdf5(path) else _read_mat5)
    if CELLS not in content:
        raise FileFormatError(f"{path}", expected=f"the variable {CELLS}", found=first_few(list(content)))
    cells = content[CELLS]
    vectors = list(cells.ravel()) if cells.dtype == object else [cells]
    return [np.asarray(v).ravel() for v in vectors]


def read_label_text(path: str | os.PathLike[str]) -> IntArray:
    """Read one label per line; empty lines and lines that start with # are skipped."""
    lines = read_bytes(path, _LIMIT).decode("utf-8-sig", "replace").splitlines()
    cells = [line.strip().rstrip(",;") for line in lines if line.strip() and not line.startswith("#")]
    bad = next((i for i, cell in enumerate(cells) if not cell.lstrip("+-").isdecimal()), None)
    if bad is not None or max(map(len, cells), default=0) > 18:
        found = repr(cells[bad or 0][:40])
        raise FileFormatError(f"{path}", expected="one whole number per line", found=found)
    return np.array([int(cell) for cell in cells], dtype=np.int64)


def read_brox_labels(path: str | os.PathLike[str]) -> IntArray:
    """Read the label of each track of a Brox ``.dat``.

    There, clusters count from 0 and -1 means none; a file without a label below 1 is taken as
    counting from 1. The result counts from 1, 0 = none.
    """
    from kt3dmoseg.io.brox import read_labels

    labels = read_labels(path)
    return labels if labels.min(initial=1) >= 1 else labels + 1


def _folder(folder: Path, clips: Mapping[str, Clip]) -> dict[str, npt.NDArray[Any]]:
    readers: dict[str, Callable[[Path], npt.NDArray[Any]]] = {
        ".txt": read_label_text,
        ".csv": read_label_text,
        ".dat": read_brox_labels,
        ".mat": _single_vector,
    }
    out: dict[str, npt.NDArray[Any]] = {}
    for file in sorted(folder.iterdir()):
        name = next((n for n in (file.stem, file.stem.removesuffix("_Tracks")) if n in clips), None)
        if name is not None and file.suffix.lower() in readers:
            if name in out:
                raise FileFormatError(f"{file}", expected=f"one label file for clip {name}", found="several")
            out[name] = readers[file.suffix.lower()](file)
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
    content = _guarded(path, _read_mat73 if _is_hdf5(path) else _read_mat5)
    vectors = {
        k: np.asarray(v).ravel()
        for k, v in content.items()
        if v.dtype.kind in "iuf" and v.size == max(v.shape)
    }
    long = {k: v for k, v in vectors.items() if v.size > 1}
    if len(long) != 1:
        raise FileFormatError(
            f"{path}", expected="one vector of labels", found=f"the vectors {first_few(list(long)) or 'none'}"
        )
    return next(iter(long.values()))


def _guarded(path: Path, read: Callable[[Path], dict[str, Any]]) -> dict[str, Any]:
    if not path.is_file():
        raise InputFileError(f"{path}", expected="a MAT-file", found="no such file")
    try:
        return read(path)
    except KT3DMoSegError:
        raise
    except Exception as error:  # scipy and h5py raise anything on damaged files
        found = f"a file that cannot be read as one ({type(error).__name__})"
        raise FileFormatError(f"{path}", expected="a MAT-file", found=found) from None


def _is_hdf5(path: str | os.PathLike[str]) -> bool:
    try:
        with open(path, "rb") as stream:
            head = stream.read(1024)
    except OSError:
        return False
    return b"\x89HDF" in head


def _read_mat5(path: Path) -> dict[str, Any]:
    from scipy.io import loadmat

    content = loadmat(os.fspath(path), mat_dtype=False)
    return {k: np.asarray(v) for k, v in content.items() if not k.startswith("__")}


def _read_mat73(path: Path) -> dict[str, Any]:
    import h5py

    out: dict[str, Any] = {}
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
