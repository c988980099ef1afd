"""Submissions to start from: a simple example, or one made of label files (MATLAB, text, Brox ``.dat``)."""

import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError
from kt3dmoseg.files import PathLike, listed, read_bytes
from kt3dmoseg.io import save
from kt3dmoseg.io.formats import recognise
from kt3dmoseg.io.matlab import Value, read_mat
from kt3dmoseg.io.predictions import MAX_FILE_BYTES, is_zero_based, label_vector
from kt3dmoseg.registry import strict
from kt3dmoseg.text import count, several
from kt3dmoseg.types import Clip, IntArray, Labels, Trajectories
from mseg.evaluation.protocol import choose_protocol
from mseg.evaluation.submission import FileFormat, SubmissionMeta, clip_checksum, write_submission
from mseg.evaluation.validation import load_clips

Zero: TypeAlias = Literal["", "first", "outlier"]
CELLS = "ClusterIdx"
_MAX_LABELS = 1_000_000
_WHOLE = re.compile(r"[+-]?[0-9]{1,18}")  # so many digits fit into 64 bits
_FORMATS = (
    f"a .mat with the cell array {CELLS} (one label vector per sequence, as the authors' scripts save), "
    "or a folder of <clip>.txt (one label per line), <clip>.mat or <clip>.dat (Brox)"
)
_EXAMPLE: dict[str, Any] = {
    "method": "example: left and right",
    "authors": ("Your Name",),
    "n_motions_given": False,
    "link": "https://example.org/paper-or-code",
    "hardware": "one CPU core",
}


class Written(NamedTuple):
    """What was written: the submission, the data that it is for, and how many clips."""

    folder: Path
    data: Path
    clips: int
    note: str = ""  # what was done to the labels


@strict
def example_submission(
    data: PathLike | None,
    output: PathLike,
    *,
    seeds: int = 1,
    format: FileFormat = "csv",
    method: str = "",
    benchmark: str = "",
    source: PathLike | None = None,
    zero: Zero = "",
) -> Written:
    """Write a valid submission whose labels cut each clip in a left and a right part, or come from files.

    Without `data` two small clips are made up, in ``<output>-data``. With more than one, each seed cuts
    elsewhere and has its own folder. `method` and `benchmark` are for ``meta.toml``; `source` are label files
    and `zero` is what their label 0 is, see `mseg.evaluation.read_label_files`. InvalidValueError for fewer
    than one seed, label files without data or with several seeds, `zero` without them, or when `output`
    exists.
    """
    _check_options(data, seeds, source, zero)
    folder = Path(output)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        expected, fix = "a new or empty folder", "remove it, or choose another output"
        raise InvalidValueError(f"{folder}", expected=expected, found="something there", fix=fix)
    place = Path(data) if data is not None else folder.with_name(folder.name + "-data")
    if data is None:
        for clip in made_up_clips().values():
            save(clip, place / f"{clip.name}.h5")
    clips = load_clips(place)
    protocol = choose_protocol(benchmark, clips)
    meta, note = SubmissionMeta(method or "unnamed", benchmark=protocol.name), ""
    labels: Any
    if source is not None:
        labels, note = labels_and_note(source, clips, names=protocol.clips, zero=zero)
        used = {name: clips[name] for name in labels}
        meta = replace(meta, outliers=any(0 in v for v in labels.values()))
    else:
        used = {name: clip for name, clip in clips.items() if protocol.holds(name)}
        runs = {seed: {n: _left_right(c, seed) for n, c in used.items()} for seed in range(seeds)}
        labels = runs[0] if seeds == 1 else runs
        meta = replace(meta, **_EXAMPLE | ({"method": method} if method else {}))
    version = protocol.version_of({name: clip_checksum(clip) for name, clip in used.items()})
    meta = replace(meta, dataset_version=version or "unnamed")
    write_submission(folder, used.values(), labels, meta, format=format)
    return Written(folder, place, len(used), note)


def _check_options(data: PathLike | None, seeds: int, source: PathLike | None, zero: Zero) -> None:
    if seeds < 1:
        raise InvalidValueError("seeds", expected="1 or more", found=str(seeds))
    if data is None and source is not None:
        expected = "the folder of clips that the labels are for"
        raise InvalidValueError("data", expected=expected, found="nothing")
    if source is not None and seeds > 1:
        expected, fix = "1 with label files, which are of one run", "leave it out"
        raise InvalidValueError("seeds", expected=expected, found=f"{seeds}", fix=fix)
    if source is None and zero:
        fix = "give source=FILES, or leave it out"
        raise InvalidValueError("zero", expected="none without label files", found=zero, fix=fix)


def made_up_clips() -> dict[str, Clip]:
    """Small clips of points in two and three motions, always the same."""
    made = {}
    for name, motions in (("example_two", 2), ("example_three", 3)):
        rng = np.random.default_rng(motions)
        n, frames = 30 * motions, 10
        label = np.repeat(np.arange(1, motions + 1), 30)
        start = rng.uniform((0, 40), (200, 200), size=(n, 2))
        velocity = np.array([[1.0, 0.0], [4.0, 2.0], [-2.0, -3.0]])[label - 1]
        xy = start[:, None] + velocity[:, None] * np.arange(frames)[:, None]
        xy[::7, frames // 2 :] = np.nan
        dense = Trajectories(xy, ~np.isnan(xy[..., 0]), image_size=(320, 240))
        rows = np.flatnonzero(np.arange(n) % 3 > 0)
        made[name] = Clip(name, dense, rows, Labels(label[rows], background=1))
    return made


def _left_right(clip: Clip, seed: int) -> IntArray:
    tracks = clip.evaluated_trajectories
    x = np.nan_to_num(tracks.xy[..., 0]).sum(axis=1) / np.maximum(tracks.visible.sum(axis=1), 1)
    share = np.random.default_rng(seed).uniform(0.35, 0.65)
    cut = min(max(1, round(share * len(x))), len(x) - 1)
    label = np.full(len(x), 2, dtype=np.int64)
    label[np.argsort(x, kind="stable")[:cut]] = 1
    return label


@strict
def read_label_files(
    source: PathLike, clips: Mapping[str, Clip], *, names: Sequence[str] = (), zero: Zero = ""
) -> dict[str, IntArray]:
    """Read the predictions that somebody has for the given clips, (n,) int64 for every clip that is found.

    `source` is a MAT-file with the cell array `ClusterIdx`, or a folder of one label file per clip. `names`
    are those of all sequences of the benchmark, in the order of the cells, where there are as many; otherwise
    the cells are those of the clips sorted by name. Vectors over all trajectories of a clip are reduced to
    the evaluated ones.

    `zero` states what label 0 is: the first cluster, so that 1 is added to all labels, or an outlier. By
    default it is the first cluster when the labels of every clip are 0, 1, ... up to less than its number of
    motions, with a warning; otherwise label 0 is refused. In a Brox file that has -1 this is an outlier, and
    0 the first cluster.

    InputFileError, FileFormatError or InvalidValueError when nothing is found, a file is none of these
    formats, or a vector fits no clip.
    """
    labels, note = labels_and_note(source, clips, names=names, zero=zero)
    if note:
        warnings.warn(note, stacklevel=2)
    return labels


def labels_and_note(
    source: PathLike, clips: Mapping[str, Clip], *, names: Sequence[str], zero: Zero
) -> tuple[dict[str, IntArray], str]:
    """Read labels as `read_label_files` does, with a sentence on what was done to them, or none."""
    path = Path(source)
    files = _label_files(path, clips) if path.is_dir() else {}
    read = {name: _READERS[file.suffix.lower()](file) for name, file in files.items()}
    vectors = read if path.is_dir() else _cells_by_name(path, clips, names)
    if not vectors:
        raise InputFileError(f"{path}", expected=_FORMATS, found="labels of none of the clips")
    brox = {n for n, file in files.items() if file.suffix.lower() == ".dat" and (vectors[n] < 0).any()}
    vectors |= {n: np.maximum(vectors[n] + (vectors[n] == 0).any(), 0) for n in brox}
    labels = {name: fit_to_clip(vector, clips[name], f"{path}: {name}") for name, vector in vectors.items()}
    others = {name: label for name, label in labels.items() if name not in brox}
    with_zero = [name for name, label in others.items() if (label == 0).any()]
    if not with_zero or zero == "outlier":
        return labels, ""
    contiguous = all(is_zero_based(label) and label.max() < clips[n].n_motions for n, label in others.items())
    if zero != "first" and not contiguous:
        found = f"label 0 in {several(with_zero, 5)} ({len(with_zero)} of {count(len(others), 'clip')})"
        fix = "state what it is: zero='first' (1 is added to all labels) or zero='outlier'"
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
    """Read the label of each track of a Brox ``.dat``, as the file has it."""
    from kt3dmoseg.io.brox import read_tracks

    return read_tracks(path)[0]


def _label_files(folder: Path, clips: Mapping[str, Clip]) -> dict[str, Path]:
    files: dict[str, Path] = {}
    for file in filter(Path.is_file, listed(folder)):
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
    content = _matlab(path)
    if CELLS not in content:
        raise FileFormatError(f"{path}", expected=f"the variable {CELLS}", found=several(list(content), 5))
    cells = content[CELLS] if isinstance(content[CELLS], list) else [content[CELLS]]
    order = list(names) if len(names) == len(cells) else sorted(clips)
    if len(order) != len(cells):
        expected, fix = f"{len(order)} cells, one per clip", "save one file per clip in a folder instead"
        raise FileFormatError(f"{path}: {CELLS}", expected=expected, found=f"{len(cells)} cells", fix=fix)
    vectors = {name: cell for name, cell in zip(order, cells, strict=True) if name in clips}
    if odd := [name for name, cell in vectors.items() if not isinstance(cell, np.ndarray)]:
        where, expected = f"{path}: {CELLS} of {odd[0]}", "a vector of labels"
        raise FileFormatError(where, expected=expected, found=type(vectors[odd[0]]).__name__)
    return {name: np.ravel(cell) for name, cell in vectors.items() if np.size(cell)}


def _single_vector(path: Path) -> npt.NDArray[Any]:
    arrays = {name: value for name, value in _matlab(path).items() if isinstance(value, np.ndarray)}
    vectors = {
        name: value.ravel()
        for name, value in arrays.items()
        if value.dtype.kind in "iuf" and 1 < value.size == max(value.shape)
    }
    if len(vectors) != 1:
        found = f"the vectors {several(list(vectors), 5) or 'none'}"
        raise FileFormatError(f"{path}", expected="one vector of labels", found=found)
    return next(iter(vectors.values()))


def _matlab(path: Path) -> Mapping[str, Value]:
    recognise(path)  # it says what another file is
    return read_mat(path)


_READERS: dict[str, Callable[[Path], npt.NDArray[Any]]] = {
    ".txt": read_label_text,
    ".csv": read_label_text,
    ".dat": read_brox_labels,
    ".mat": _single_vector,
}
