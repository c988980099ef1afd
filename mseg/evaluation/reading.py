"""Reading a submission without trusting it: its files, its meta data, its predictions, and every problem."""

from __future__ import annotations

import hashlib
import os
import re
import stat
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path, PurePosixPath
from typing import Any

from kt3dmoseg.errors import FileFormatError, InputFileError, KT3DMoSegError
from kt3dmoseg.files import SafeZip, ZipFault, ZipLimits, parse_toml, read_bytes
from kt3dmoseg.io.predictions import MAX_FILE_BYTES, SUFFIXES, Prediction, Problem, parse_prediction
from kt3dmoseg.registry import nearest
from mseg.evaluation.protocol import list_protocols
from mseg.evaluation.submission import FAILED, FORMAT_VERSION, META, SubmissionMeta

LIMITS = ZipLimits(files=50_000, file_bytes=MAX_FILE_BYTES, total_bytes=512 << 20, depth=4)
_SEED_FOLDER = re.compile(r"seed-(\d{1,18})")
_TEXT_LIMIT = 2000
_ENDINGS = (*SUFFIXES, FAILED)
_IGNORED_NAMES = {"__MACOSX", "Thumbs.db", "desktop.ini"}
_LABEL_FILES = (".mat", ".dat", ".txt", ".npy", ".pkl", ".pickle", ".tsv", ".xlsx")
_EXAMPLE = "see docs/submit.md, or let 'mseg example-submission' write one"


def _is_text(value: object) -> bool:
    return isinstance(value, str) and len(value) <= _TEXT_LIMIT


def _are_texts(value: object) -> bool:
    return isinstance(value, list) and len(value) <= _TEXT_LIMIT and all(map(_is_text, value))


# Of each type of a field of meta.toml what its value must be, in words and as a check.
_KINDS: dict[str, tuple[str, Callable[[Any], bool]]] = {
    "str": ("a text", _is_text),
    "bool": ("true or false", lambda v: isinstance(v, bool)),
    "float": ("seconds >= 0", lambda v: type(v) in (int, float) and 0 <= v <= sys.float_info.max),
    "tuple[str, ...]": ('a list of names, ["A. Author"]', _are_texts),
    "Mapping[str, str]": ("a table of texts", lambda v: isinstance(v, dict) and _are_texts([*v.values()])),
}


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
        return sorted({seed for seed, _ in (*self.predictions, *self.failures)})

    @property
    def clips(self) -> list[str]:
        """Names of the clips, of any seed, sorted."""
        return sorted({clip for _, clip in (*self.predictions, *self.failures)})

    def bad(self, code: str, file: str, expected: str, found: str, fix: str) -> None:
        """Add a problem."""
        self.problems.append(Problem(code, file, "", expected, found, fix))


def read_submission(path: str | os.PathLike[str]) -> Submission:
    """Read a submission from a folder or a zip, in memory; what is wrong with it is listed, not raised.

    Raises
    ------
    InputFileError
        When there is nothing at `path`.
    """
    root, out = Path(path), Submission(SubmissionMeta("unnamed"))
    if not root.exists():
        raise InputFileError(f"{root}", expected="a submission (folder or zip)", found="nothing there")
    names, content_of = _files_of_folder(root, out) if root.is_dir() else _files_of_zip(root, out)
    if out.problems and not names:  # no zip, or too large: nothing more can be checked
        return out
    prefix = _root(names, out)
    digest = hashlib.sha256()
    for name in sorted(names, key=lambda name: (name != prefix + META, name)):
        if not name.startswith(prefix):
            continue
        relative = PurePosixPath(name[len(prefix) :])
        key = _key(name, relative, out)
        if key is None:
            continue
        try:
            content = content_of(name)
        except KT3DMoSegError as error:
            out.bad("unreadable", name, "a readable file", str(error), "make the archive again")
            continue
        digest.update(f"{relative}\0{len(content)}\0".encode() + content)
        if name == prefix + META:
            out.meta, problems = parse_meta(content)
            out.problems += problems
        else:
            _add_file(name, content, key, out)
    out.sha256 = digest.hexdigest()
    _check_layout([PurePosixPath(name[len(prefix) :]) for name in names if name.startswith(prefix)], out)
    return out


def _files_of_folder(root: Path, out: Submission) -> tuple[list[str], Callable[[str], bytes]]:
    """List the plain files of moderate size."""
    sizes: dict[str, int] = {}
    for folder, subfolders, files in os.walk(root, followlinks=False):
        subfolders.sort()
        for each in sorted([*files, *subfolders]):
            path = Path(folder) / each
            name = path.relative_to(root).as_posix()
            status = path.stat(follow_symlinks=False)
            if path.is_symlink():
                fix = "put the file itself there (zip follows links by default; cp -L does too)"
                out.bad("symlink", name, "a plain file", "a symbolic link", fix)
            elif each not in files or _ignored(name):
                continue
            elif not stat.S_ISREG(status.st_mode):
                out.bad("special-file", name, "a plain file", "a device or pipe", "remove it")
            elif status.st_size > MAX_FILE_BYTES:
                _too_large(name, f"{status.st_size} bytes", out)
            else:
                sizes[name] = status.st_size
        subfolders[:] = [each for each in subfolders if not _ignored(each)]
        if len(sizes) > LIMITS.files or sum(sizes.values()) > LIMITS.total_bytes:
            _too_large("", f"over {LIMITS.files} files or {LIMITS.total_bytes >> 20} MiB", out)
            sizes.clear()
            break
    return sorted(sizes), lambda name: read_bytes(root / name, MAX_FILE_BYTES)


def _files_of_zip(path: Path, out: Submission) -> tuple[list[str], Callable[[str], bytes]]:
    faults: list[ZipFault] = []
    archive = SafeZip(path, LIMITS, path.name, faults=faults)
    for code, file, expected, found, fix in faults:
        if code == "not-a-zip":
            fix = "make it with: cd my-submission && zip -r ../my-submission.zip ."
            out.bad(code, path.name, "a folder, or a zip of its content", found, fix)
        elif code == "too-large":
            _too_large(file, found, out)
        else:
            out.bad(code, file, expected, found, fix)
    return [name for name in archive.sizes if not _ignored(name)], archive.read


def _too_large(file: str, found: str, out: Submission) -> None:
    whole = f"at most {LIMITS.files} files and {LIMITS.total_bytes >> 20} MiB"
    expected = f"at most {MAX_FILE_BYTES >> 20} MiB" if file else whole
    fix = "only meta.toml and prediction files belong here, with one label per evaluated trajectory"
    out.bad("too-large", file, expected, found, fix)


def _ignored(name: str) -> bool:
    """Whether the file is hidden, or an operating system left it there: no part of the submission."""
    return any(part in _IGNORED_NAMES or part.startswith(".") for part in PurePosixPath(name).parts)


def _root(names: list[str], out: Submission) -> str:
    """Find where meta.toml lies: at the top, or one folder down when the folder itself was zipped."""
    if META in names:
        return ""
    below = [name for name in names if PurePosixPath(name).name == META]
    if len(below) == 1 and len({PurePosixPath(name).parts[0] for name in names}) == 1:
        prefix = below[0].removesuffix(META)
        folder = prefix.rstrip("/")
        found = f"everything inside the folder {prefix}"
        fix = f"zip the content, not the folder: cd {folder} && zip -r ../{folder}.zip ."
        out.bad("wrapped-folder", below[0], f"{META} at the top", found, fix)
        return prefix
    near = next((name for name in names if name.lower() == META), "")
    found = f"{near} (lower case is needed)" if near else "none"
    out.bad("no-meta", META, f"{META} at the top", found, _EXAMPLE)
    return ""


def _key(name: str, path: PurePosixPath, out: Submission) -> tuple[int, str] | None:
    """Seed and clip of a file; None when it is none of a submission's."""
    folder = _SEED_FOLDER.fullmatch(path.parts[0])
    if len(path.parts) > 1 and not (folder and len(path.parts) == 2):
        expected = "files at the top, or in folders seed-0, seed-1, ..."
        fix = "name the folders seed-<number>, or move the files to the top"
        out.bad("unknown-folder", name, expected, f"the folder {path.parent}", fix)
        return None
    suffix = path.suffix.lower()
    if suffix in _ENDINGS or str(path) == META:
        return int(folder[1]) if folder and len(path.parts) == 2 else 0, path.stem
    if suffix in (".txt", ".md", "") and path.name.lower().startswith(("readme", "licen")):
        return None
    expected = f"{META} and files ending in {', '.join(SUFFIXES)} or {FAILED}"
    convert = (
        "make it a csv 'track,label'; for label files (.mat, .txt, .dat) "
        "'mseg example-submission DATA --from FILES -o OUT' does it"
    )
    fix = convert if suffix in _LABEL_FILES else "remove it"
    out.bad("unknown-file", name, expected, path.suffix or "no ending", fix)
    return None


def _add_file(name: str, content: bytes, key: tuple[int, str], out: Submission) -> None:
    if key in out.files:
        fix = "keep one of them"
        out.bad("duplicate-clip", name, "one file per clip and seed", f"also {out.files[key]}", fix)
        return
    out.files[key] = name
    suffix = PurePosixPath(name).suffix.lower()
    if suffix == FAILED:
        reason = " ".join(content.decode("utf-8", "replace").split())[:300]
        out.failures[key] = reason or "no reason given"
    else:
        out.predictions[key] = parse_prediction(content, name[: -len(suffix)] + suffix, key[1])
        out.problems += out.predictions[key].problems


def _check_layout(paths: list[PurePosixPath], out: Submission) -> None:
    at_top = sum(len(path.parts) == 1 and path.suffix.lower() in _ENDINGS for path in paths)
    in_folders = sum(bool(len(path.parts) == 2 and _SEED_FOLDER.fullmatch(path.parts[0])) for path in paths)
    if at_top and in_folders:
        expected = "all predictions at the top, or all in seed-<number> folders"
        found = f"{at_top} at the top and {in_folders} in seed folders"
        fix = "move the files at the top into a seed folder of their own"
        out.bad("mixed-seeds", "", expected, found, fix)
    if not at_top and not in_folders:
        out.bad("no-predictions", "", f"one file per clip ({', '.join(SUFFIXES)})", "none", _EXAMPLE)


def parse_meta(content: bytes) -> tuple[SubmissionMeta, list[Problem]]:
    """Read ``meta.toml``: with defaults where a field is missing or wrong, and the problems."""
    problems: list[Problem] = []

    def bad(field: str, expected: str, found: str, fix: str = _EXAMPLE) -> None:
        expected = f"{field} = {expected}" if field else expected
        problems.append(Problem("meta-field", META, "", expected, found[:80], fix))

    try:
        raw = parse_toml(content, META)
    except FileFormatError as error:
        problem = Problem("meta-syntax", META, "", error.expected, error.found[:160], _EXAMPLE)
        return SubmissionMeta("unnamed"), [problem]
    version = raw.pop("format_version", None)
    if version != FORMAT_VERSION or isinstance(version, bool):
        bad("format_version", str(FORMAT_VERSION), repr(version))
    kinds = {each.name: _KINDS[str(each.type)] for each in fields(SubmissionMeta)}
    values: dict[str, Any] = {"method": "unnamed"}
    for name, value in raw.items():
        if name not in kinds:
            meant = nearest(name, kinds)
            fix = f"did you mean {meant!r}?" if meant else f"put it under [parameters]; {_EXAMPLE}"
            bad("", "a known field", repr(name), fix)
        elif kinds[name][1](value):
            values[name] = value
        else:
            bad(name, kinds[name][0], repr(value))
    _check_required(raw, bad)
    return SubmissionMeta(**{**values, "authors": tuple(values.get("authors", ("unnamed",)))}), problems


def wrong_fields(meta: Mapping[str, Any]) -> list[str]:
    """Name the fields of a `SubmissionMeta`, as a mapping, with a value that ``meta.toml`` could not have."""
    values = {name: list(value) if isinstance(value, tuple) else value for name, value in meta.items()}
    wrong = [f.name for f in fields(SubmissionMeta) if not _KINDS[str(f.type)][1](values[f.name])]
    return wrong if meta["method"] else ["method", *wrong]


def _check_required(raw: Mapping[str, Any], bad: Callable[..., None]) -> None:
    for name, example in (("method", '"My method"'), ("authors", '["A. Author"]')):
        if not raw.get(name):
            bad(name, example, "nothing")
    if "n_motions_given" not in raw:
        fix = "state whether the method was given the number of motions"
        bad("n_motions_given", "true or false", "nothing", fix)
    benchmark = raw.get("benchmark", "")
    if isinstance(benchmark, str) and benchmark not in ("", "custom", *list_protocols()):
        meant = nearest(benchmark, list_protocols())
        fix = f"did you mean {meant!r}?" if meant else ""
        bad("benchmark", "one of " + ", ".join(list_protocols()), repr(benchmark), fix)
    if not raw.get("dataset_version") and not raw.get("fingerprints"):
        bad("dataset_version", '"2018", the version of the data that was segmented', "nothing")
