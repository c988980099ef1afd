"""Existing label vectors: MATLAB cell arrays, text, Brox ``.dat``."""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError
from kt3dmoseg.files import read_bytes
from kt3dmoseg.io.predictions import MAX_FILE_BYTES, first_few, is_zero_based, label_vector
from kt3dmoseg.types import Clip, IntArray
from mseg.evaluation.protocol import count

if TYPE_CHECKING:
    import h5py

Zero: TypeAlias = Literal["", "first", "outlier"]
CELLS = "ClusterIdx"
_MAX_LABELS = 1_000_000
_WHOLE = re.compile(r"[+-]?[0-9]{1,18}")  # so many digits fit into 64 bits
_FORMATS = (
    f"a .mat with the cell array {CELLS} (one label vector per sequence, as the authors' scripts save), "
    "or a folder of <clip>.txt (one label per line), <clip>.mat or <clip>.dat (Brox)"
)


def read_label_files(
    source: str | os.PathLike[str],
    clips: Mapping[str, Clip],
    *,
    names: Sequence[str] = (),
    zero: Zero = "",
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
    zero : {"", "first", "outlier"}
        What label 0 is: the first cluster, so that 1 is added to all labels, or an outlier. By default the
        first cluster when the labels of every clip are 0, 1, ... up to less than its number of motions, with
        a warning; otherwise label 0 is refused. In a Brox file it is the first cluster, and -1 an outlier.

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
    labels, note = labels_and_note(source, clips, names=names, zero=zero)
    if note:
        warnings.warn(note, stacklevel=2)
    return labels


def labels_and_note(
    source: str | os.PathLike[str], clips: Mapping[str, Clip], *, names: Sequence[str], zero: Zero
) -> tuple[dict[str, IntArray], str]:
    """Read labels as `read_label_files` does, with a sentence on what was done to them, or none."""
    path = Path(source)
    files = _label_files(path, clips) if path.is_dir() else {}
    vectors = {name: _READERS[file.suffix.lower()](file) for name, file in files.items()}
    if not path.is_dir():
        vectors = _cells_by_name(path, clips, names)
    if not vectors:
        raise InputFileError(f"{path}", expected=_FORMATS, found="labels of none of the clips")
    labels = {name: fit_to_clip(vector, clips[name], f"{path}: {name}") for name, vector in vectors.items()}
    brox = {name for name, file in files.items() if file.suffix.lower() == ".dat"}
    others = {name: label for name, label in labels.items() if name not in brox}
    with_zero = [name for name, label in others.items() if (label == 0).any()]
    if not with_zero or zero == "outlier":
        return labels, ""
    contiguous = all(is_zero_based(label) and label.max() < clips[n].n_motions for n, label in others.items())
    if zero != "first" and not contiguous:
        found = f"label 0 in {first_few(with_zero)} ({len(with_zero)} of {count(len(others), 'clip')})"
        fix = "state what it is: --zero first (1 is added to all labels) or --zero outlier"
        raise InvalidValueError(f"{path}", expected="labels 1, 2, ...", found=found, fix=fix)
    note = f"labels count from 0: 1 was added to every label of {count(len(others), 'clip')}"
    return labels | {name: label + 1 for name, label in others.items()}, note


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
    content = read_bytes(path, MAX_FILE_BYTES)
    if content.count(b"\n") > _MAX_LABELS:
        raise FileFormatError(f"{path}", expected=f"at most {_MAX_LABELS} labels", found="more lines")
    lines = content.decode("utf-8-sig", "replace").replace("\r", "\n").split("\n")
    cells = [line.strip().rstrip(",;") for line in lines if line.strip() and not line.startswith("#")]
    wrong = next((cell for cell in cells if not _WHOLE.fullmatch(cell)), None)
    if wrong is not None:
        raise FileFormatError(f"{path}", expected="one whole number per line", found=repr(wrong[:40]))
    return np.array(cells, dtype=np.str_).astype(np.int64)


def read_brox_labels(path: Path) -> IntArray:
    """Read the label of each track of a Brox ``.dat``, counted from 1, 0 = none.

    There, clusters count from 0 and -1 means none; a file without a label below 1 is taken as
    counting from 1.
    """
    from kt3dmoseg.io.brox import read_tracks

    labels, _ = read_tracks(path)
    return labels + int(labels.min(initial=1) < 1)


def _label_files(folder: Path, clips: Mapping[str, Clip]) -> dict[str, Path]:
    files: dict[str, Path] = {}
    for file in sorted(folder.iterdir()):
        name = file.stem if file.stem in clips else file.stem.removesuffix("_Tracks")
        if name in clips and file.suffix.lower() in _READERS:
            if name in files:
                expected, found = f"one label file for clip {name}", f"also {files[name].name}"
                raise FileFormatError(f"{file}", expected=expected, found=found)
            files[name] = file
    return files


def _cells_by_name(
    path: Path, clips: Mapping[str, Clip], names: Sequence[str]
) -> dict[str, npt.NDArray[Any]]:
    if path.suffix.lower() != ".mat":
        found = path.suffix or ("no ending" if path.exists() else "nothing there")
        raise FileFormatError(f"{path}", expected=_FORMATS, found=found)
    cells = read_cluster_idx(path)
    order = list(names) if len(names) == len(cells) else sorted(clips)
    if len(order) != len(cells):
        expected, fix = (
            f"{len(order)} cells, one per clip",
            "save one label file per clip in a folder instead",
        )
        raise FileFormatError(f"{path}: {CELLS}", expected=expected, found=f"{len(cells)} cells", fix=fix)
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
    import h5py
    from scipy.io import loadmat

    try:
        if h5py.is_hdf5(path):
            with h5py.File(path, "r") as file:
                return _matlab73(file)
        return {k: np.asarray(v) for k, v in loadmat(f"{path}").items() if not k.startswith("__")}
    except Exception as error:  # scipy and h5py raise anything on damaged files
        found = f"what cannot be read as one ({type(error).__name__})"
        raise FileFormatError(f"{path}", expected="a MAT-file", found=found) from None


def _matlab73(file: h5py.File) -> dict[str, npt.NDArray[Any]]:
    import h5py

    out: dict[str, npt.NDArray[Any]] = {}
    for name, item in file.items():
        if isinstance(item, h5py.Dataset) and item.dtype == h5py.ref_dtype:
            # MATLAB stores arrays transposed, cells as references into the same file.
            cells = [np.asarray(file[ref]).ravel() for ref in np.asarray(item).T.ravel()]
            out[name] = np.empty(len(cells), dtype=object)
            out[name][:] = cells
        elif isinstance(item, h5py.Dataset) and item.dtype.kind in "iuf":
            out[name] = np.asarray(item)
    return out


_READERS: dict[str, Callable[[Path], npt.NDArray[Any]]] = {
    ".txt": read_label_text,
    ".csv": read_label_text,
    ".dat": read_brox_labels,
    ".mat": _single_vector,
}
