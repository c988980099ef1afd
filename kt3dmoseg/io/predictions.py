"""Labels of one clip from CSV, npz, HDF5 or Python values, checked and joined by track id.

Everything that is wrong with a file is listed at once, as `Problem`; nothing is unpickled, and sizes
are checked before anything is read.
"""

import io
import re
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from numbers import Integral
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import FileFormatError, InvalidValueError, KT3DMoSegError
from kt3dmoseg.files import PathLike, read_bytes
from kt3dmoseg.io.npz import read_header
from kt3dmoseg.text import several
from kt3dmoseg.types import Clip, IntArray

MAX_FILE_BYTES = 32 << 20
MAX_ROWS = 200_000
_NAMES = ("track", "label")
_WHOLE = re.compile(r"\s*[+-]?[0-9]{1,16}\s*")
_MAX_CELL = 64
_HUGE = 2**53
_SAME = 0.5
_FIX_NAN = "give every trajectory a label; if 0 is meant as outlier, set outliers = true in meta.toml"
_FIX_ROWS = "write one row per evaluated trajectory"
_FIX_NAME = "write the motion's number, not its name"
_FIX_ARRAYS = "save two integer vectors: np.savez(file, track=ids, label=labels)"
_FIX_HEADER = "make the first line 'track,label' and write one 'id,label' line per evaluated trajectory"


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong with predictions, and what to do about it."""

    code: str  # stable short name, for scripts
    file: str = ""  # empty when it is about all of them, as is clip
    clip: str = ""
    expected: str = ""
    found: str = ""
    fix: str = ""  # how to repair it

    def __str__(self) -> str:
        where = ", ".join(filter(None, (self.file, self.clip and f"clip {self.clip}"))) or "submission"
        facts = {"expected": self.expected, "found": self.found, "fix": self.fix}
        return str(KT3DMoSegError(f"[{self.code}] {where}", **facts))


def numbered(problems: Sequence[Problem]) -> str:
    """Lay problems out as a numbered list, one line each."""
    width = len(str(len(problems)))
    return "\n".join(f"{i:>{width}}. {problem}" for i, problem in enumerate(problems, start=1))


@dataclass(eq=False)
class Prediction:
    """The columns `track` and `label` as far as they could be read, and what is wrong with them."""

    columns: dict[str, npt.NDArray[Any]] = field(default_factory=dict)
    file: str = ""
    clip: str = ""
    problems: list[Problem] = field(default_factory=list)
    most: int = MAX_ROWS  # rows

    def bad(self, code: str, expected: str, found: str, fix: str) -> None:
        """Add a problem."""
        self.problems.append(Problem(code, self.file, self.clip, expected, found, fix))

    def named(self, present: Sequence[str]) -> list[str]:
        """Return the columns that are there, after reporting the others."""
        missing = " and ".join(f"'{name}'" for name in _NAMES if name not in present)
        if missing:
            found = several(present, 5) or "no array"
            self.bad("missing-array", f"arrays named {missing}", found, _FIX_ARRAYS)
        return [name for name in _NAMES if name in present]

    def accepts(self, name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> bool:
        """Check type and shape of a column before it is read."""
        rows = len(self.columns["track"]) if name == "label" and "track" in self.columns else None
        if dtype.hasobject:
            found = "an array of Python objects (a pickle), which is never opened"
            self.bad("object-array", f"integers in '{name}'", found, "save labels.astype(np.int64)")
        elif dtype.kind not in "iuf":
            self.bad("not-a-number", f"integers in '{name}'", f"values of type {dtype}", "write integers")
        elif len(shape) != 1:
            self.bad("transposed", f"'{name}' of shape (n,)", f"shape {shape}", "flatten it: labels.ravel()")
        elif shape[0] > self.most:
            self.bad("too-large", f"at most {self.most} values in '{name}'", f"{shape[0]}", _FIX_ROWS)
        elif rows not in (None, shape[0]):
            self.bad("ragged", f"as many labels as tracks ({rows})", f"{shape[0]}", _FIX_ARRAYS)
        elif not shape[0]:
            self.bad("empty-file", "one label per trajectory", "none", _FIX_ROWS)
        else:
            return True
        return False

    def check_values(self) -> None:
        """Name every kind of value that is no whole number >= 0."""
        for name, values in self.columns.items():
            wanted, before = f"whole numbers >= 0 as {name}", len(self.problems)
            numbers = values.astype(np.float64)
            huge = np.isfinite(numbers) & (np.abs(numbers) >= _HUGE)
            for code, wrong, what, fix in (
                ("nan", np.isnan(numbers), "NaN", _FIX_NAN),
                ("infinite", np.isinf(numbers), "infinite values", "write whole numbers"),
                ("too-big", huge, "huge numbers", "keep below 2^53"),
                ("negative", numbers < 0, "negative numbers", "motions are 1, 2, ...; 0 is an outlier"),
            ):
                if wrong.any():
                    self.bad(code, wanted, f"{what} in {int(wrong.sum())} of {len(wrong)} rows", fix)
            if values.dtype.kind == "f" and len(self.problems) == before:
                example = f"floating-point numbers such as {float(numbers[np.argmax(numbers % 1)])!r}"
                self.bad("float", wanted, example, "write integers, 2 and not 2.0")


def read_prediction(path: PathLike, clip: Clip) -> IntArray:
    """Read the predicted labels of a clip, (n,) int64 in the order of ``clip.evaluated``, joined by track id.

    The file is a ``.csv`` with the header ``track,label``, or an ``.npz`` or ``.h5`` with these vectors.
    InputFileError when it cannot be read; FileFormatError, with everything that is wrong, when it is of
    another form or not of this clip.
    """
    file = Path(path)
    if file.suffix.lower() not in SUFFIXES:
        raise InvalidValueError(f"{file}", expected=f"a suffix of {', '.join(SUFFIXES)}", found=file.suffix)
    found = parse_prediction(read_bytes(file, MAX_FILE_BYTES), file.name, clip.name)
    labels, problems = join_labels(found, clip, file.name)
    if labels is None:
        raise FileFormatError(f"{file}: {numbered(problems)}")
    return labels


def label_vector(values: Any, name: str) -> IntArray:  # noqa: ANN401  # checked
    """Return labels as an (n,) int64 vector; InvalidValueError for anything but whole numbers >= 0.

    Whole numbers held as floats (as MATLAB does) and (n, 1) or (1, n) arrays are accepted.
    """
    if _index(values) is not None:
        fix = "mseg.score joins by track; or give values.to_numpy()"
        raise InvalidValueError(name, expected="a vector", found="a series with an index", fix=fix)
    try:
        array = np.asarray(values)
    except ValueError:  # lists of unequal lengths
        raise InvalidValueError(name, expected="a vector of labels", found="rows of unequal length") from None
    except TypeError as error:  # of a tensor on a GPU, which says what to do
        found = f"{type(values).__name__}: {error}"
        raise InvalidValueError(name, expected="a vector of labels", found=found) from None
    array = array.ravel() if array.ndim == 2 and 1 in array.shape else array
    if array.ndim != 1:
        found = f"{type(values).__name__} of shape {array.shape}"
        raise InvalidValueError(name, expected="a vector of labels", found=found)
    if array.dtype.kind not in "iufO":
        found = f"values of type {array.dtype}"
        raise InvalidValueError(name, expected="a vector of labels, whole numbers", found=found)
    good = _are_labels(array)
    if type(values).__module__.startswith("numpy.ma"):  # asked so, since numpy.ma is slow to import
        good &= ~np.ma.getmaskarray(values).ravel()
    if not good.all():
        row = int(np.argmin(good))
        value: Any = array[row]
        text = f"the text {value!r:.40}" if isinstance(value, str) else f"{value!s:.40}"
        found = f"{'NaN' if value != value else text} in row {row}"
        expected = "labels >= 0, whole numbers, of every trajectory"
        raise InvalidValueError(name, expected=expected, found=found)
    return array.astype(np.int64)


def _are_labels(array: npt.NDArray[Any]) -> npt.NDArray[np.bool_]:
    if array.dtype.kind == "O":  # of a data frame that can miss some, or of more than 64 bits
        whole = [type(v) is not bool and isinstance(v, Integral) and 0 <= int(v) < _HUGE for v in array]
        return np.array(whole, dtype=np.bool_)
    return np.asarray((array >= 0) & (array < _HUGE) & (array == np.round(array)))


def clip_labels(values: Any, clip: Clip, name: str) -> IntArray:  # noqa: ANN401  # checked
    """Return labels of a clip, (n,) int64 in the order of ``clip.evaluated``: a vector or `label_table`."""
    table = label_table(values, name)
    if table is not None:
        labels, problems = join_labels(table, clip, name)
        if labels is None:
            raise InvalidValueError("; ".join(map(str, problems)))
        return labels
    labels = label_vector(values, name)
    if len(labels) != len(clip.evaluated):
        expected = f"{len(clip.evaluated)} labels, one per evaluated trajectory of {clip.name}"
        raise InvalidValueError(name, expected=expected, found=f"{len(labels)}")
    return labels


def is_zero_based(labels: IntArray) -> bool:
    """Whether labels count from 0 without a gap."""
    groups = np.unique(labels)
    return len(groups) > 1 and np.array_equal(groups, np.arange(len(groups)))


def label_table(values: Any, name: str) -> Prediction | None:  # noqa: ANN401  # checked
    """Return tracks and labels of a data frame, mapping or record array of both, or of an indexed series.

    The index of a series, or of a frame without a column `track`, holds the tracks when it is called so; of a
    series also when it is not 0, 1, ... None for a vector.
    """
    names = getattr(values, "columns", getattr(getattr(values, "dtype", None), "names", None))
    if isinstance(values, Mapping):
        names = _NAMES if {*_NAMES} <= {*values} else None
    track = index = _index(values)
    if names is None and index is None:
        return None
    if names is not None:
        by_index = "track" not in names and getattr(index, "name", None) == "track"
        if "label" not in names or not ("track" in names or by_index):
            expected, found = "the columns track and label", several(list(names), 5) or "none"
            raise InvalidValueError(name, expected=expected, found=found)
        track, values = index if by_index else values["track"], values["label"]
    columns = {"track": np.asarray(track), "label": np.asarray(values)}
    return Prediction({key: label_vector(column, f"{name}: {key}") for key, column in columns.items()})


def _index(values: Any) -> Any | None:  # noqa: ANN401  # of pandas
    """Return the index of a pandas series or frame, unless it is just 0, 1, ..."""
    index = getattr(values, "index", None)
    if index is None or callable(index):  # that of a list
        return None
    plain = index.name != "track" and np.array_equal(index, np.arange(len(index)))
    return None if plain else index


def parse_prediction(content: bytes, file: str, clip: str, most: int = MAX_ROWS) -> Prediction:
    """Read a prediction file of a clip, listing everything that is wrong; the ending chooses the format."""
    out = Prediction(file=file, clip=clip, most=most)
    kind, parse = _PARSERS[Path(file).suffix.lower()]
    foreign = () if parse is _csv else (Exception,)  # an error of our own parser is a bug, and must show
    try:
        parse(content, out)
        out.check_values()
    except foreign as error:  # zipfile, numpy and libhdf5 raise anything on hostile bytes
        reason = str(error) if isinstance(error, KT3DMoSegError) else type(error).__name__
        found = f"a file that starts with {content[:8]!r} and cannot be read ({reason[:200]})"
        out.problems = [Problem("unreadable", file, clip, kind, found, _FIX_ARRAYS)]
    return out


def join_labels(found: Prediction, clip: Clip, file: str) -> tuple[IntArray | None, list[Problem]]:
    """Sort predicted labels into the order of ``clip.evaluated``, or report why that fails."""
    if found.problems:
        return None, found.problems
    wanted = clip.dense.track_id[clip.evaluated]
    problems = []
    ids, first, counts = np.unique(found.columns["track"], return_index=True, return_counts=True)
    label = found.columns["label"][first].astype(np.int64)
    if (counts > 1).any():
        twice = ids[counts > 1].tolist()
        text = f"{len(twice)} given more than once (track {several(twice, 5)})"
        fix = "keep one row per trajectory"
        problems.append(Problem("duplicate-rows", file, clip.name, "each trajectory once", text, fix))
    if not np.array_equal(ids, np.sort(wanted)):
        code, text, fix = _mismatch(ids, found.columns["label"], wanted, clip)
        expected = f"the {len(wanted)} evaluated trajectories"
        problems.append(Problem(code, file, clip.name, expected, text, fix))
    return (None, problems) if problems else (label[np.searchsorted(ids, wanted)], [])


def _mismatch(ids: IntArray, label: IntArray, wanted: IntArray, clip: Clip) -> tuple[str, str, str]:
    """Recognise what is written instead of the ids: code, what was found, repair."""
    n, found = len(wanted), len(ids)
    if found > n and np.array_equal(ids, np.sort(clip.dense.track_id)):
        text = f"{found} labels: those are all trajectories of the clip"
        return "all-trajectories", text, "keep the evaluated ones (clip.dense.track_id[clip.evaluated])"
    if 0 < 2 * found < n and np.isin(wanted, label).mean() > _SAME:
        return "swapped-columns", "the ids in the column label", "swap the columns: track first, then label"
    if found == n and np.array_equal(ids - 1, np.sort(wanted)):
        text = "ids that are each one larger, counted from 1 as in MATLAB"
        return "one-based-ids", text, "subtract 1 from every track"
    if found == n and ids[0] in (0, 1) and np.array_equal(ids - ids[0], np.arange(n)):
        text = f"row numbers {ids[0]}..{ids[-1]} instead of track ids"
        return "row-numbers", text, "write clip.dense.track_id[clip.evaluated] as track"
    missing, extra = np.setdiff1d(wanted, ids).tolist(), np.setdiff1d(ids, wanted).tolist()
    parts = [f"{len(missing)} missing (track {several(missing, 5)})"] if missing else []
    parts += [f"{len(extra)} that are not evaluated (track {several(extra, 5)})"] if extra else []
    if len(missing) > _SAME * n and len(extra) > _SAME * found:
        fix = "most ids do not fit: these look like labels for another clip or another version of the data"
        return "other-trajectories", " and ".join(parts), fix
    return "trajectories", " and ".join(parts), "write one row per evaluated trajectory, by its track id"


def _npz(content: bytes, out: Prediction) -> None:
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        for name in out.named([file.removesuffix(".npy") for file in archive.namelist()]):
            with archive.open(f"{name}.npy") as stream:
                shape, _, dtype = read_header(stream)
                if out.accepts(name, shape, dtype):
                    values = stream.read(dtype.itemsize * shape[0])
                    out.columns[name] = np.frombuffer(values, dtype, count=shape[0])


def _h5(content: bytes, out: Prediction) -> None:
    """Read plain datasets of this very file."""
    import h5py

    from kt3dmoseg.io.hdf5 import check_storage

    with h5py.File(io.BytesIO(content), "r") as file:
        for name in out.named([name for name in file if name in _NAMES] or list(file)[:10]):
            dataset = file[name] if isinstance(file.get(name, getlink=True), h5py.HardLink) else None
            if not isinstance(dataset, h5py.Dataset):
                out.bad("not-a-dataset", f"a dataset '{name}' in this file", "a link or group", _FIX_ARRAYS)
            elif out.accepts(name, dataset.shape, dataset.dtype):
                check_storage(dataset, name)
                out.columns[name] = dataset[()]


def _csv(content: bytes, out: Prediction) -> None:
    """Read ``track,label`` rows.

    A byte order mark, Windows line ends, blanks around values, empty lines and the columns in the
    order ``label,track`` are accepted.
    """
    n_cells = sum(map(content.count, (b"\n", b"\r", b",")))
    if n_cells > 4 * out.most:  # checked first: every cell becomes an object
        return out.bad("too-large", f"at most {out.most} rows", f"{n_cells} cells", _FIX_ROWS)
    try:
        lines = io.StringIO(content.decode("utf-8-sig"), newline=None)
    except UnicodeDecodeError:
        return out.bad("encoding", "UTF-8 text", "other bytes", "save the file as plain UTF-8 CSV")
    rows = {i: line.split(",") for i, line in enumerate(lines, start=1) if line.strip()}
    if not rows:
        return out.bad("empty-file", "'track,label' and rows", "an empty file", _FIX_HEADER)
    first = next(iter(rows))
    head = [cell.strip().strip('"').lower() for cell in rows[first]]
    if sorted(head) == sorted(_NAMES):
        del rows[first]
        return _csv_columns(out, rows, head)
    code, *problem = _header_problem(head, len(rows))
    out.bad(code, *problem)
    return _csv_columns(out, rows, list(_NAMES)) if code == "no-header" else None


def _header_problem(head: list[str], n_rows: int) -> tuple[str, str, str, str]:
    """Report why the first line, given in cells, is not the header."""
    line, numbers = ",".join(head), None not in map(_number, head)
    separator = next((s for s in ";\t |" if s in line), "")
    if len(head) == 1 and separator:
        fix = "separate the values by commas"
        return "separator", "values separated by commas", f"{separator!r} between them", fix
    if len(head) == 1 and numbers:
        fix = f"{_FIX_HEADER}; or turn label files into a submission with 'mseg example-submission'"
        return "label-only", "two columns, track and label", f"{n_rows} lines of one value", fix
    if len(head) > 2 and {*_NAMES} <= {*head}:
        fix = "remove the other columns, in every line"
        return "header", "the columns track and label only", repr(line[:60]), fix
    if len(head) > 2 and (n_rows <= 2 or head[0] in _NAMES):
        found = f"{n_rows} lines of up to {len(head)} values"
        fix = "transpose the table: two columns, track and label"
        return "transposed", "one row per trajectory", found, fix
    code = "no-header" if len(head) == 2 and numbers else "header"
    return code, "the first line 'track,label'", repr(line[:60]), _FIX_HEADER


def _csv_columns(out: Prediction, rows: dict[int, list[str]], names: list[str]) -> None:
    ragged = [number for number, row in rows.items() if len(row) != 2]
    if ragged:
        found = f"another number in line {several(ragged, 5)}"
        return out.bad("ragged", "two values in every line", found, _FIX_HEADER)
    for name, cells in zip(names, zip(*rows.values(), strict=True) if rows else ((), ()), strict=True):
        whole = all(map(_WHOLE.fullmatch, cells))
        values = list(map(int if whole else _number, cells))
        wrong = {i: cell for i, cell, value in zip(rows, cells, values, strict=True) if value is None}
        if wrong:
            found = f"{next(iter(wrong.values())).strip()[:40]!r} (line {several(list(wrong), 5)})"
            out.bad("not-a-number", f"whole numbers below 2^53 as {name}", found, _FIX_NAME)
        elif out.accepts(name, (len(values),), np.dtype(np.int64)):
            out.columns[name] = np.array(values, dtype=np.int64 if whole else np.float64)
    return None


def _number(cell: str) -> float | None:
    """Convert a cell to a number; None when it is none, or of more digits than any number needs."""
    try:  # Python would take 1_0 for 10
        return float(cell) if len(cell) <= _MAX_CELL and "_" not in cell and cell.isascii() else None
    except ValueError:
        return None


_PARSERS: dict[str, tuple[str, Callable[[bytes, Prediction], None]]] = {
    ".csv": ("a CSV file", _csv),
    ".npz": ("an npz archive of numpy", _npz),
    ".h5": ("an HDF5 file", _h5),
}
SUFFIXES = tuple(_PARSERS)
