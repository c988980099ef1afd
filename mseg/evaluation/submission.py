"""A submission, format version 1: its layout, writing one, and reading one without trusting it.

::

    my-submission/                 a folder, or a zip of its content
        meta.toml                  who, how, on which data
        Seq005_Clip01.csv          one file per clip: track,label
        Seq005_Clip02.failed       ... or the reason why the method failed on it

Predictions of several seeds lie in one folder per seed, ``seed-0/Seq005_Clip01.csv``.
"""

from __future__ import annotations

import hashlib
import re
import stat
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from numbers import Real
from pathlib import Path, PurePosixPath
from typing import Any, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import FileFormatError, InputFileError, InvalidValueError, KT3DMoSegError
from kt3dmoseg.files import (
    PathLike,
    SafeZip,
    ZipFault,
    ZipLimits,
    atomic_path,
    check_writable,
    is_hidden,
    one_line,
    parse_toml,
    read_bytes,
    sha256_arrays,
    write_text,
)
from kt3dmoseg.io.npz import write_npz
from kt3dmoseg.io.predictions import (
    MAX_FILE_BYTES,
    MAX_ROWS,
    SUFFIXES,
    Prediction,
    Problem,
    clip_labels,
    label_table,
    parse_prediction,
)
from kt3dmoseg.registry import nearest, strict
from kt3dmoseg.text import several, toml_text
from kt3dmoseg.types import Clip, IntArray, Labels
from mseg.evaluation.protocol import list_protocols
from mseg.types import Segmentation

FORMAT_VERSION = 1
META = "meta.toml"
FAILED = ".failed"
LIMITS = ZipLimits(files=50_000, file_bytes=MAX_FILE_BYTES, total_bytes=512 << 20, depth=4)
FileFormat: TypeAlias = Literal["csv", "npz", "h5"]
_CLIP_NAME = re.compile(r"\w[\w .-]{0,127}")
_ENDINGS = (*SUFFIXES, FAILED)
# Seed, clip and ending of a file of predictions.
_PLACE = re.compile(rf"(?:seed-(\d{{1,18}})/)?([^/]+)((?i:{'|'.join(map(re.escape, _ENDINGS))}))")
_PASSED_OVER = re.compile(r"(?i:(?:readme|licen)[^.]*(?:\.txt|\.md)?)")
_TEXT_LIMIT = 2000
_MOST_FIELDS = 100  # each that is wrong is named
_CONTROL = re.compile("[\\x00-\\x1f\\x7f-\\x9f]")  # terminals act on it
_EXAMPLE = "see docs/submit.md, or let 'mseg example-submission' write one"
_MOST = f"{LIMITS.files} files of at most {MAX_FILE_BYTES >> 20} MiB, {LIMITS.total_bytes >> 20} MiB together"
_FIX_LARGE = "only meta.toml and prediction files belong here, with one label per evaluated trajectory"
_FIX_ZIP = "make it with: cd my-submission && zip -r ../my-submission.zip ."


def _are_texts(value: object, also: str = "") -> bool:
    """Whether these are texts without control characters other than some."""
    texts = value if isinstance(value, list) else [None]
    return len(texts) <= _TEXT_LIMIT and all(
        isinstance(t, str) and len(t) <= _TEXT_LIMIT and {*_CONTROL.findall(t)} <= {*also} for t in texts
    )


def _are_seconds(value: Any) -> bool:  # noqa: ANN401
    if not isinstance(value, int) and isinstance(value, Real):  # numpy's, too
        value = float(value)
    return type(value) in (int, float) and 0 <= value <= sys.float_info.max


@dataclass(frozen=True)
class SubmissionMeta:
    """The meta data of a submission: the fields of ``meta.toml``."""

    method: str  # name of the method, as it shall appear in tables
    authors: tuple[str, ...] = ("unnamed",)
    dataset_version: str = ""  # such as "2018", the release of that year; may be empty with fingerprints
    benchmark: str = ""  # name of the protocol; empty = the one that the clips belong to
    n_motions_given: bool = True  # whether the method was given the number of motions of each clip
    link: str = ""  # paper or code
    hardware: str = ""
    seconds: float = 0.0  # for all clips, of one seed
    outliers: bool = False  # label 0 is meant; otherwise it is refused as a sign of labels from 0
    baseline: bool = False  # one label for a whole clip is meant; otherwise refused as a mistake
    fingerprints: Mapping[str, str] = field(default_factory=dict)  # clip -> clip_checksum
    parameters: Mapping[str, str] = field(default_factory=dict)  # options of the method, free
    supervised: bool = False  # trained with labels, of other clips
    # Clip -> what one must know to trust its labels, such as a method that did not converge.
    notes: Mapping[str, str] = field(default_factory=dict)


# Of each type of a field of meta.toml, and of each field, what its value must be, in words and as a check.
_KINDS: dict[str, tuple[str, Callable[[Any], bool]]] = {
    "str": ("a text of one line", lambda v: _are_texts([v])),
    "bool": ("true or false", lambda v: isinstance(v, bool)),
    "float": ("seconds >= 0", _are_seconds),
    "tuple[str, ...]": ('a list of names, ["A. Author"]', _are_texts),
    "Mapping[str, str]": (
        "a table of texts",
        lambda v: isinstance(v, dict) and _are_texts([*v]) and _are_texts([*v.values()], "\t\n"),
    ),
}
_FIELDS = {each.name: _KINDS[str(each.type)] for each in fields(SubmissionMeta)} | {
    "format_version": (f"{FORMAT_VERSION}", lambda v: type(v) is int and v == FORMAT_VERSION),
    "n_motions_given": ("true if the method was given the number of motions, or false", _KINDS["bool"][1]),
    "benchmark": (f"one of {', '.join(list_protocols())}", lambda v: v in ("", "custom", *list_protocols())),
}
_REQUIRED = ("format_version", "method", "authors", "n_motions_given", "dataset_version")


def clip_checksum(clip: Clip) -> str:
    """Identify the evaluated trajectories of a clip: 16 hexadecimal digits.

    Ids and visibility count exactly, positions as float32, so that the same data in another file
    format has the same checksum; the order of the trajectories and the labels do not count.
    """
    tracks = clip.evaluated_trajectories
    order = np.argsort(tracks.track_id)
    xy = np.where(tracks.visible[..., None], tracks.xy, 0.0).astype(np.float32) + np.float32(0)
    return sha256_arrays(tracks.track_id[order], tracks.visible[order], xy[order])[:16]


def looks_like_submission(path: Path) -> bool:
    """Whether a path is a zip or a folder with ``meta.toml``, as opposed to a folder of clips."""
    return path.suffix.lower() == ".zip" or (path / META).is_file()


def write_meta(folder: PathLike, meta: SubmissionMeta) -> Path:
    """Write ``meta.toml``; returns its path."""
    path = Path(folder) / META
    values = asdict(meta)
    lines, tables = [f"format_version = {FORMAT_VERSION}"], list[str]()
    for key, value in values.items():
        if not isinstance(value, dict):
            lines.append(f"{key} = {toml_text(value)}")
        elif value:
            pairs = (f"{toml_text(k)} = {toml_text(v)}" for k, v in sorted(value.items()))
            tables += ["", f"[{key}]", *pairs]
    write_text(path, "\n".join([*lines, *tables, ""]))
    return path


@strict
def write_prediction(
    folder: PathLike,
    clip: Clip,
    labels: npt.ArrayLike,
    *,
    seed: int | None = None,
    format: FileFormat = "csv",
) -> Path:
    """Write the labels of one clip into a submission, a folder; returns the path.

    Labels (n,), one per evaluated trajectory, are 1, 2, ...; 0 = outlier. A `seed` writes into
    ``seed-<seed>/``; None is for a submission of a single run. InvalidValueError when the labels do not fit
    the clip, or its name cannot be a file name.
    """
    label = clip_labels(bare_labels(labels, clip), clip, f"labels of {clip.name}")
    path = file_of(folder, clip.name, seed, f".{format}")
    track = clip.dense.track_id[clip.evaluated]
    if format == "csv":
        rows = "\n".join(f"{t},{v}" for t, v in zip(track.tolist(), label.tolist(), strict=True))
        write_text(path, f"track,label\n{rows}\n")
    elif format == "npz":
        write_npz(path, {"track": track, "label": label})
    else:
        import h5py

        with atomic_path(path) as temporary, h5py.File(temporary, "w") as stream:
            stream.create_dataset("track", data=track)
            stream.create_dataset("label", data=label)
    for ending in {*_ENDINGS} - {path.suffix}:  # what an earlier run wrote about the clip
        file_of(folder, clip.name, seed, ending).unlink(missing_ok=True)
    return path


def write_failure(folder: PathLike, clip: Clip, reason: str, *, seed: int | None = None) -> Path:
    """Record that the method failed on a clip, and why; it will count as fully wrong."""
    path = file_of(folder, clip.name, seed, FAILED)
    write_text(path, " ".join(reason.split()) + "\n")
    return path


@strict
def write_submission(
    folder: PathLike,
    clips: Iterable[Clip],
    predictions: Mapping[str, npt.ArrayLike] | Mapping[int, Mapping[str, npt.ArrayLike]],
    meta: SubmissionMeta,
    *,
    format: FileFormat = "csv",
) -> Path:
    """Write a whole submission.

    Parameters
    ----------
    folder : path
        Where; created when missing.
    clips : iterable of Clip
        The clips that were segmented.
    predictions : mapping
        Clip name -> labels for a single run, or seed -> clip name -> labels.
    meta : SubmissionMeta
        The meta data; the checksums of the clips are added.
    format : {"csv", "npz", "h5"}
        File format of the predictions.
    """
    for name in wrong_fields(asdict(meta)):
        raise InvalidValueError(f"meta.{name}", expected=_FIELDS[name][0], found=f"{vars(meta)[name]!r:.80}")
    check_writable(folder)
    by_name = clips_by_name(clips)
    labels: dict[tuple[int | None, str], IntArray] = {}
    for seed, run in prediction_runs(predictions).items():
        check_names(run, by_name, "predictions")
        for name, values in run.items():
            clip = by_name[name]
            labels[seed, name] = clip_labels(bare_labels(values, clip), clip, f"predictions of {name}")
    written = {file_of(folder, name, seed, "") for seed, name in labels}
    older = [path for path in prediction_files(folder) if path.with_suffix("") not in written]
    if older:
        found = f"{several([p.relative_to(folder).as_posix() for p in older], 5)} of an earlier one"
        fix = "remove them, or write to another folder"
        raise InvalidValueError(f"{folder}", expected="no other predictions", found=found, fix=fix)
    (Path(folder) / META).unlink(missing_ok=True)  # until all is written, nothing counts
    for (seed, name), vector in labels.items():
        write_prediction(folder, by_name[name], vector, seed=seed, format=format)
    checksums = {name: clip_checksum(clip) for name, clip in by_name.items()}
    write_meta(folder, replace(meta, fingerprints={**checksums, **meta.fingerprints}))
    return Path(folder)


def prediction_files(folder: PathLike) -> list[Path]:
    """List the files of predictions and failures in a folder, sorted; hidden ones do not count."""
    files = sorted(path for path in Path(folder).rglob("*") if path.suffix.lower() in _ENDINGS)
    return [path for path in files if not is_hidden(path.relative_to(folder).as_posix())]


def bare_labels(values: Any, clip: Clip | Labels) -> Any:  # noqa: ANN401  # as clip_labels takes them
    """Take the vector out of a Labels or a Segmentation, of one of all trajectories the clip's evaluated."""
    if isinstance(values, Segmentation) and values.rows is not None and isinstance(clip, Clip):
        return values.evaluated_labels(clip)
    if isinstance(values, Labels):
        return values.label
    return values.labels if isinstance(values, Segmentation) else values


def prediction_runs(predictions: Any) -> dict[int | None, Mapping[str, Any]]:  # noqa: ANN401
    """Sort out whether predictions are of clips, one run without a seed (None), or of seeds and clips."""
    values = predictions.values()
    nested = [isinstance(v, Mapping) and label_table(v, "predictions") is None for v in values]
    if nested and not any(nested):
        return {None: predictions}
    seeds = predictions if nested and all(nested) else [None]
    if not all(isinstance(s, (int, np.integer)) and not isinstance(s, bool) and s >= 0 for s in seeds):
        expected = "a mapping of clip names to their labels, or of seeds (0, 1, ...) to such mappings"
        found = several(list(predictions), 5) if values else "nothing"
        raise InvalidValueError("predictions", expected=expected, found=found)
    return {int(seed): run for seed, run in predictions.items()}


def check_names(names: Iterable[str], clips: Iterable[str], where: str, *, complete: bool = False) -> None:
    """Refuse predictions of clips that do not exist and, for `complete` ones, clips without predictions."""
    wanted, given = list(clips), list(names)
    extra = [name for name in given if name not in wanted]
    missing = [name for name in wanted if name not in given] if complete else []
    if extra or missing:
        found = f"{several(extra, 5)}, which is no clip" if extra else f"nothing for {several(missing, 5)}"
        fix = did_you_mean(str(extra[0]), wanted) if extra else ""
        raise InvalidValueError(where, expected=f"labels of {several(wanted, 5)}", found=found, fix=fix)


def did_you_mean(word: str, known: Iterable[str], otherwise: str = "") -> str:
    """Propose the known word that a misspelt one is most like."""
    meant = nearest(word, known)
    return f"did you mean {meant!r}?" if meant else otherwise


def clips_by_name(clips: Mapping[str, Clip] | Iterable[Clip]) -> dict[str, Clip]:
    """Return clips by their names; InvalidValueError when two have one name, or one is no clip."""
    out: dict[str, Clip] = {}
    for clip in clips.values() if isinstance(clips, Mapping) else clips:
        if not isinstance(clip, Clip) or clip.name in out:
            found = f"two named {clip.name}" if isinstance(clip, Clip) else type(clip).__name__
            raise InvalidValueError("clips", expected="clips, each of its own name", found=found)
        out[clip.name] = clip
    return out


def file_of(folder: PathLike, clip: str, seed: int | None, ending: str) -> Path:
    """Path of a clip's file in a submission; InvalidValueError when its name cannot be a file name."""
    if not _CLIP_NAME.fullmatch(clip) or ".." in clip:
        expected = "a plain file name: letters, digits, space, '.', '_', '-'"
        raise InvalidValueError("clip name", expected=expected, found=repr(clip), fix="rename the clip")
    return (Path(folder) if seed is None else Path(folder) / f"seed-{seed}") / f"{clip}{ending}"


@dataclass(eq=False)
class Submission:
    """What a submission holds, before it is compared with the data; keys are (seed, clip)."""

    meta: SubmissionMeta
    predictions: dict[tuple[int, str], Prediction] = field(default_factory=dict)  # seed 0 without folders
    failures: dict[tuple[int, str], str] = field(default_factory=dict)  # where the method failed, and why
    files: dict[tuple[int, str], str] = field(default_factory=dict)
    problems: list[Problem] = field(default_factory=list)  # everything that is wrong so far
    sha256: str = ""  # over names and contents, the same for a folder and its zip

    @property
    def seeds(self) -> list[int]:
        """The seeds, ascending."""
        return sorted({seed for seed, _ in self.files})

    @property
    def clips(self) -> list[str]:
        """Names of the clips, of any seed, sorted."""
        return sorted({clip for _, clip in self.files})

    def bad(self, code: str, file: str, expected: str, found: str, fix: str, clip: str = "") -> None:
        """Add a problem."""
        self.problems.append(Problem(code, file, clip, expected, found, fix))


def read_submission(path: PathLike, *, most: int = MAX_ROWS) -> Submission:
    """Read a submission from a folder or a zip, in memory; what is wrong with it is listed, not raised.

    A file of predictions has `most` rows at most. InputFileError when there is nothing at `path`.
    """
    root, out = Path(path), Submission(SubmissionMeta("unnamed"))
    if not root.exists():
        raise InputFileError(f"{root}", expected="a submission (folder or zip)", found="nothing there")
    names, content_of = _files_of_folder(root, out) if root.is_dir() else _files_of_zip(root, out)
    if out.problems and not names:  # no zip, or too large: nothing more can be checked
        return out
    prefix = _root(names, out)
    inner = sorted(name.removeprefix(prefix) for name in names if name.startswith(prefix))
    places = {name: _PLACE.fullmatch(name) for name in sorted(inner, key=lambda name: name != META)}
    digest = hashlib.sha256()
    for name, place in places.items():
        if place is None and name != META:
            continue
        try:
            content = content_of(prefix + name)
        except KT3DMoSegError as error:
            fix = "make the archive again" if root.is_file() else "check its permissions"
            out.bad("unreadable", prefix + name, "a readable file", str(error), fix)
            continue
        digest.update(f"{name}\0{len(content)}\0".encode() + content)
        if place is not None:
            _add_file(prefix + name, place, content, out, most)
        else:
            out.meta, problems = parse_meta(content)
            out.problems += problems
    out.sha256 = digest.hexdigest()
    _report_strays([name for name, place in places.items() if place is None and name != META], out)
    _check_layout([place[1] is not None for place in places.values() if place], out)
    return out


def _files_of_folder(root: Path, out: Submission) -> tuple[list[str], Callable[[str], bytes]]:
    sizes: dict[str, int] = {}
    with one_line(root):
        list(root.iterdir())  # which rglob would take for empty where it may not be read
    for path in sorted(root.rglob("*")):
        name, status = path.relative_to(root).as_posix(), path.lstat()
        if is_hidden(name) or stat.S_ISDIR(status.st_mode):
            continue
        if not name.isprintable():
            out.bad("unsafe-path", ascii(name), "a name in UTF-8", "other bytes", "rename the file")
        elif stat.S_ISLNK(status.st_mode):
            out.bad("symlink", name, "a plain file", "a symbolic link", "put the file itself there (cp -L)")
        elif not stat.S_ISREG(status.st_mode):
            out.bad("special-file", name, "a plain file", "a device or pipe", "remove it")
        elif status.st_size > MAX_FILE_BYTES:
            out.bad("too-large", name, _MOST, f"{status.st_size} bytes", _FIX_LARGE)
        else:
            sizes[name] = status.st_size
    if len(sizes) > LIMITS.files or sum(sizes.values()) > LIMITS.total_bytes:
        out.bad("too-large", "", _MOST, f"{len(sizes)} files, {sum(sizes.values())} bytes", _FIX_LARGE)
        sizes.clear()
    return list(sizes), lambda name: read_bytes(root / name, MAX_FILE_BYTES)


def _files_of_zip(path: Path, out: Submission) -> tuple[list[str], Callable[[str], bytes]]:
    faults: list[ZipFault] = []
    archive = SafeZip(path, LIMITS, path.name, faults=faults)
    for code, file, expected, found, fix in faults:
        fix = fix or (_FIX_ZIP if code == "not-a-zip" else _FIX_LARGE)
        out.bad(code, file or path.name, expected, found, fix)
    return [name for name in archive.sizes if not is_hidden(name)], archive.read


def _root(names: list[str], out: Submission) -> str:
    """Find where meta.toml lies: at the top, or one folder down when the folder itself was zipped."""
    if META in names:
        return ""
    below = [name for name in names if name.endswith(f"/{META}")]
    if len(below) == 1 and len({name.partition("/")[0] for name in names}) == 1:
        folder = below[0].removesuffix(f"/{META}")
        made = "../" * (folder.count("/") + 1) + folder.rpartition("/")[2]
        fix = f"zip the content, not the folder: cd {folder} && zip -r {made}.zip ."
        out.bad("wrapped-folder", below[0], f"{META} at the top", f"everything inside {folder}/", fix)
        return f"{folder}/"
    out.bad("no-meta", META, f"{META} (in lower case) at the top", "none", _EXAMPLE)
    return ""


def _report_strays(names: Iterable[str], out: Submission) -> None:
    """Report files that are none of a submission's, once per folder and ending; readmes are passed over."""
    folders: dict[str, list[str]] = {}
    files: dict[str, list[str]] = {}
    for name in names:
        folder, _, file = name.rpartition("/")
        if folder and not re.fullmatch(r"seed-\d{1,18}", folder):
            folders.setdefault(folder.partition("/")[0], []).append(name)
        elif not _PASSED_OVER.fullmatch(file):
            files.setdefault(PurePosixPath(file).suffix or "no ending", []).append(name)
    for top, those in folders.items():
        expected = "files at the top, or in folders seed-0, seed-1, ..."
        fix = "name the folders seed-<number>, or move the files to the top"
        found = f"the folder {those[0].rpartition('/')[0]}" + _amount(those, f" in {top}/")
        out.bad("unknown-folder", those[0], expected, found, fix)
    for ending, those in files.items():
        fix = "remove it, or convert label files with 'mseg example-submission'"
        expected = f"{META} and files ending in {', '.join(SUFFIXES)} or {FAILED}"
        out.bad("unknown-file", those[0], expected, ending + _amount(those), fix)


def _amount(names: list[str], where: str = "") -> str:
    return f", {len(names)} files{where}" if len(names) > 1 else ""


def _add_file(name: str, place: re.Match[str], content: bytes, out: Submission, most: int) -> None:
    key = int(place[1] or 0), place[2]
    if key in out.files:
        found, fix = f"also {name}", "keep one of them"
        return out.bad(
            "duplicate-clip", out.files[key], "one file per clip and seed", found, fix, clip=key[1]
        )
    out.files[key] = name
    if place[3].lower() == FAILED:
        reason = " ".join(content.decode("utf-8", "replace").split())[:300]
        out.failures[key] = reason or "no reason given"
    else:
        out.predictions[key] = parse_prediction(content, name, key[1], most)
        out.problems += out.predictions[key].problems
    return None


def _check_layout(in_seed_folder: list[bool], out: Submission) -> None:
    if not in_seed_folder:
        out.bad("no-predictions", "", f"one file per clip ({', '.join(SUFFIXES)})", "none", _EXAMPLE)
    elif len(set(in_seed_folder)) == 2:
        fix = "move the files at the top into a seed folder of their own"
        out.bad("mixed-seeds", "", "all predictions at the top, or all in seed-<number> folders", "both", fix)


def parse_meta(content: bytes) -> tuple[SubmissionMeta, list[Problem]]:
    """Read ``meta.toml``: with defaults where a field is missing or wrong, and the problems."""
    problems: list[Problem] = []

    def bad(expected: str, found: str, fix: str = _EXAMPLE) -> None:
        problems.append(Problem("meta-field", META, "", expected, found[:80], fix))

    try:
        raw = _few_fields(parse_toml(content, META))
    except FileFormatError as error:
        problem = Problem("meta-syntax", META, "", error.expected, error.found[:160], _EXAMPLE)
        return SubmissionMeta("unnamed"), [problem]
    values: dict[str, Any] = {"method": "unnamed", "authors": ["unnamed"]}
    for name, value in raw.items():
        if name not in _FIELDS:
            otherwise = f"put it under [parameters]; {_EXAMPLE}"
            bad("a known field", repr(name), did_you_mean(name, _FIELDS, otherwise))
        elif _FIELDS[name][1](value):
            values[name] = value
        else:
            names = list_protocols() if name == "benchmark" else []
            bad(f"{name} = {_FIELDS[name][0]}", repr(value), did_you_mean(str(value), names, _EXAMPLE))
    for name in _REQUIRED:
        if raw.get(name) in (None, "", []) and not (name == "dataset_version" and raw.get("fingerprints")):
            bad(f"{name} = {_FIELDS[name][0]}", "nothing")
    values.pop("format_version", None)
    return SubmissionMeta(**{**values, "authors": tuple(values["authors"])}), problems


def _few_fields(raw: dict[str, Any]) -> dict[str, Any]:
    if len(raw) > _MOST_FIELDS:
        raise FileFormatError(META, expected=f"at most {_MOST_FIELDS} fields", found=f"{len(raw)}")
    return raw


def wrong_fields(meta: Mapping[str, Any]) -> list[str]:
    """Name the fields of a `SubmissionMeta`, as a mapping, with a value that ``meta.toml`` could not have."""
    values = {name: list(value) if isinstance(value, tuple) else value for name, value in meta.items()}
    return [name for name in values if not _FIELDS[name][1](values[name])] + ["method"] * (not meta["method"])
