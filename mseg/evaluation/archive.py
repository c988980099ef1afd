"""A submission's files, from a folder or a zip, without trusting either.

Nothing is ever unpacked to disk: members are read into memory, after their names and sizes were
checked. A file that is not safe to read becomes a problem, not an exception.
"""

from __future__ import annotations

import os
import re
import stat
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from kt3dmoseg.errors import InputFileError
from kt3dmoseg.files import read_bytes
from mseg.evaluation.problems import Problem

MAX_FILES = 50_000
MAX_FILE_BYTES = 32 << 20
MAX_TOTAL_BYTES = 512 << 20
_MAX_RATIO, _RATIO_FREE = 200, 1 << 20
_MAX_DEPTH = 4
_DRIVE = re.compile(r"[A-Za-z]:")
_IGNORED_NAMES = {"__MACOSX", "Thumbs.db", "desktop.ini"}
_UNZIPPABLE = (
    zipfile.BadZipFile,
    zlib.error,
    OSError,
    EOFError,
    RuntimeError,
    ValueError,
    NotImplementedError,
)


@dataclass
class Contents:
    """The readable files of a submission and the problems met on the way.

    Parameters
    ----------
    read : callable
        From a name in `names` to its bytes.
    names : list of str
        POSIX paths inside the submission, sorted.
    problems : list of Problem
        What was left out, and why.
    """

    read: Callable[[str], bytes]
    names: list[str] = field(default_factory=list)
    problems: list[Problem] = field(default_factory=list)

    def add(self, code: str, file: str, *, expected: str, found: str, fix: str) -> None:
        """Note a problem."""
        self.problems.append(Problem(code, file, expected=expected, found=found, fix=fix))


def open_contents(path: str | os.PathLike[str]) -> Contents:
    """List the files of a submission.

    Parameters
    ----------
    path : path
        A folder, or a zip of its content.

    Raises
    ------
    InputFileError
        When there is nothing at `path`, or it cannot be opened at all.
    """
    root = Path(path)
    if root.is_dir():
        return _folder(root)
    if not root.exists():
        raise InputFileError(f"{root}", expected="a submission (folder or zip)", found="nothing there")
    contents = Contents(_nothing)
    _zip(root, contents)
    return contents


def _nothing(name: str) -> bytes:
    raise InputFileError(name, expected="a file of the submission", found="nothing")


def _folder(root: Path) -> Contents:
    contents = Contents(lambda name: read_bytes(root / name, MAX_FILE_BYTES))
    total = 0
    for folder, subfolders, files in os.walk(root, followlinks=False):
        subfolders.sort()
        for entry in sorted([*files, *subfolders]):
            place = Path(folder) / entry
            name = place.relative_to(root).as_posix()
            if place.is_symlink():
                contents.problems.append(_link(name))
            elif entry in files and not _ignored(name):
                total += _accept_file(contents, place, name)
        subfolders[:] = [s for s in subfolders if not _ignored(s)]
        if len(contents.names) > MAX_FILES or total > MAX_TOTAL_BYTES:
            _too_much(contents, f"over {MAX_FILES} files or {MAX_TOTAL_BYTES >> 20} MiB")
            break
    contents.names.sort()
    return contents


def _accept_file(contents: Contents, place: Path, name: str) -> int:
    status = place.stat(follow_symlinks=False)
    if not stat.S_ISREG(status.st_mode):
        contents.add("special-file", name, expected="a plain file", found="a device or pipe", fix="remove it")
        return 0
    if status.st_size > MAX_FILE_BYTES:
        contents.problems.append(_large(name, status.st_size))
        return 0
    contents.names.append(name)
    return status.st_size


def _zip(path: Path, contents: Contents) -> None:
    try:
        if path.stat().st_size > MAX_TOTAL_BYTES:
            _too_much(contents, f"{path.stat().st_size >> 20} MiB")
            return
        archive = zipfile.ZipFile(path)
    except _UNZIPPABLE:
        contents.add(
            "not-a-zip",
            path.name,
            expected="a folder, or a zip of its content",
            found="a file that is no readable zip archive",
            fix="make it with: cd my-submission && zip -r ../my-submission.zip .",
        )
        return
    members = _safe_members(archive, contents)
    contents.names = sorted(members)

    def read(name: str) -> bytes:
        try:
            with archive.open(members[name]) as stream:
                content = stream.read(MAX_FILE_BYTES + 1)
        except _UNZIPPABLE as error:
            raise InputFileError(name, expected="an intact zip member", found=str(error)) from None
        if len(content) != members[name].file_size:
            raise InputFileError(
                name, expected=f"{members[name].file_size} bytes as declared", found=f"{len(content)}"
            )
        return content

    contents.read = read


def _safe_members(archive: zipfile.ZipFile, contents: Contents) -> dict[str, zipfile.ZipInfo]:
    members: dict[str, zipfile.ZipInfo] = {}
    infos = [i for i in archive.infolist() if not i.filename.endswith("/")]
    if len(infos) > MAX_FILES or sum(i.file_size for i in infos) > MAX_TOTAL_BYTES:
        _too_much(contents, f"{len(infos)} files, {sum(i.file_size for i in infos) >> 20} MiB unpacked")
        return members
    for info in infos:
        name = str(PurePosixPath(info.filename))
        problem = _refusal(info, name in members)
        if problem is not None:
            contents.problems.append(problem)
        elif not _ignored(name):
            members[name] = info
    return members


def _refusal(info: zipfile.ZipInfo, twice: bool) -> Problem | None:
    """Say why a member is not safe to read; None when it is."""
    name = info.filename
    if _unsafe(info.orig_filename) or _unsafe(name):
        return Problem(
            "unsafe-path",
            repr(name)[1:-1],
            expected="a path inside the submission",
            found="'..', an absolute path, a drive, a backslash or too many folders",
            fix="zip the content of the folder with relative names",
        )
    if stat.S_ISLNK(info.external_attr >> 16):
        return _link(name)
    if twice:
        return Problem(
            "duplicate-name", name, expected="each file once", found="it twice", fix="keep one of them"
        )
    if info.file_size > MAX_FILE_BYTES or _is_bomb(info):
        return _large(name, info.file_size)
    if info.flag_bits & 1:
        return Problem(
            "encrypted", name, expected="no password", found="an encrypted member", fix="zip it without"
        )
    return None


def _unsafe(name: str) -> bool:
    parts = PurePosixPath(name).parts
    odd = "\\" in name or "\0" in name or not name.isprintable() or _DRIVE.match(name) is not None
    return odd or name.startswith("/") or ".." in parts or len(parts) > _MAX_DEPTH or not parts


def _is_bomb(info: zipfile.ZipInfo) -> bool:
    return info.file_size > _RATIO_FREE and info.file_size > _MAX_RATIO * max(1, info.compress_size)


def _ignored(name: str) -> bool:
    """Whether the file is hidden, or an operating system left it there: no part of the submission."""
    return any(part in _IGNORED_NAMES or part.startswith(".") for part in PurePosixPath(name).parts)


def _link(name: str) -> Problem:
    return Problem(
        "symlink",
        name,
        expected="a plain file",
        found="a symbolic link",
        fix="put the file itself there (zip follows links by default; cp -L does too)",
    )


def _large(name: str, size: int) -> Problem:
    return Problem(
        "too-large",
        name,
        expected=f"at most {MAX_FILE_BYTES >> 20} MiB, packed at most {_MAX_RATIO} to 1",
        found=f"{size} bytes unpacked",
        fix="one label per evaluated trajectory is all that belongs in it",
    )


def _too_much(contents: Contents, found: str) -> None:
    contents.names.clear()
    contents.add(
        "too-large",
        "",
        expected=f"at most {MAX_FILES} files and {MAX_TOTAL_BYTES >> 20} MiB",
        found=found,
        fix="only meta.toml and the prediction files belong in a submission",
    )
