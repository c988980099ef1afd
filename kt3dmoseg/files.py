"""Atomic writes, locks and content hashes: what every reader and writer of files shares."""

from __future__ import annotations

import errno
import hashlib
import io
import os
import tempfile
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import InputFileError

try:
    import fcntl
except ImportError:  # pragma: no cover  # Windows
    fcntl = None  # type: ignore[assignment]

_BLOCK = 1 << 20
_REMEDIES = {
    errno.ENOSPC: "free some space, or write somewhere else",
    errno.EEXIST: "a file is where a folder should be; remove it, or write somewhere else",
    errno.ENOTDIR: "a file is where a folder should be; remove it, or write somewhere else",
}


@contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a temporary path beside `path`; on success it takes the name `path`, durably.

    The folder is created when missing. On any exception, and on ``kill -9``, `path` keeps its
    former content or stays absent; the temporary file is removed when the process can.

    Raises
    ------
    InputFileError
        When the folder cannot be created or written, or the disk is full.
    """
    target = Path(path)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{target.name}.", suffix=".part", dir=target.parent)
        os.close(handle)
        os.chmod(name, 0o666 & ~_umask())
    except OSError as error:
        raise _unwritable(target, error) from error
    temporary = Path(name)
    try:
        yield temporary
        _sync(temporary)
        os.replace(temporary, target)
        _sync(target.parent)
    except OSError as error:
        raise error if isinstance(error, InputFileError) else _unwritable(target, error) from error
    finally:
        temporary.unlink(missing_ok=True)


def check_writable(path: str | os.PathLike[str]) -> None:
    """See that files can be made in a folder, which need not exist yet, before long work is done for it.

    Raises
    ------
    InputFileError
        When not.
    """
    folder = Path(path)
    there = next(place for place in (folder, *folder.absolute().parents) if place.exists())
    try:
        with tempfile.TemporaryFile(dir=there):
            pass
    except OSError as error:
        raise _unwritable(folder, error) from error


@contextmanager
def hold_folder(path: str | os.PathLike[str], busy: Callable[[], object] | None = None) -> Iterator[Path]:
    """Make a folder and hold it alone while the block runs, against other threads and processes.

    The system releases the folder when the process ends, however it ends. Where there is no ``flock``
    (Windows) nothing is held.

    Parameters
    ----------
    path : path
        The folder.
    busy : callable, optional
        Called when somebody else holds it, before waiting for it; may raise instead.

    Raises
    ------
    InputFileError
        When the folder cannot be created or opened.
    """
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        handle = os.open(folder, os.O_RDONLY) if fcntl else None
    except OSError as error:
        raise _unwritable(folder, error) from error
    try:
        if handle is not None:
            _lock(handle, busy or (lambda: None))
        yield folder
    finally:
        if handle is not None:
            os.close(handle)


def write_bytes(path: str | os.PathLike[str], content: bytes) -> None:
    """Write `content` to `path` atomically."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


def write_text(path: str | os.PathLike[str], content: str) -> None:
    """Write `content` to `path` atomically, as UTF-8 with the newlines it has."""
    write_bytes(path, content.encode())


def read_bytes(path: str | os.PathLike[str], limit: int) -> bytes:
    """Read a file of at most `limit` bytes.

    Raises
    ------
    InputFileError
        When it cannot be read or is larger.
    """
    try:
        with open(path, "rb") as stream:
            # By blocks: asking for n bytes at once allocates n, however small the file is.
            blocks, room = [], limit + 1
            while room > 0 and (block := stream.read(min(_BLOCK, room))):
                blocks.append(block)
                room -= len(block)
    except OSError as error:
        raise InputFileError(f"{os.fspath(path)}: {error.strerror or error}") from error
    if room <= 0:
        raise InputFileError(os.fspath(path), expected=f"at most {limit} bytes", found="more")
    return b"".join(blocks)


def zip_bytes(entries: Mapping[str, bytes]) -> bytes:
    """Pack a zip file without times, readable by everyone: the same entries give the same bytes."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, content in entries.items():
            info = zipfile.ZipInfo(name)  # dated 1980, whatever the day
            info.external_attr = 0o644 << 16
            archive.writestr(info, content, zipfile.ZIP_DEFLATED)
    return buffer.getvalue()


def sha256_file(path: str | os.PathLike[str]) -> str:
    """Hexadecimal SHA-256 of a file's bytes."""
    digest = hashlib.sha256()
    try:
        with open(path, "rb") as stream:
            while block := stream.read(_BLOCK):
                digest.update(block)
    except OSError as error:
        raise InputFileError(f"{os.fspath(path)}: {error.strerror or error}") from error
    return digest.hexdigest()


def sha256_files(paths: Iterable[str | os.PathLike[str]]) -> str:
    """Hexadecimal SHA-256 over the SHA-256 of each file, in order; names do not count."""
    return hashlib.sha256("\n".join(map(sha256_file, paths)).encode()).hexdigest()


def sha256_arrays(*arrays: npt.NDArray[Any]) -> str:
    """Hexadecimal SHA-256 over dtype, shape and little-endian content of the arrays, in order."""
    digest = hashlib.sha256()
    for array in arrays:
        little = array.astype(array.dtype.newbyteorder("<"), copy=False)
        digest.update(f"{little.dtype.str}{little.shape}".encode())
        digest.update(np.ascontiguousarray(little).data)
    return digest.hexdigest()


def _lock(handle: int, busy: Callable[[], object]) -> None:
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        busy()
        fcntl.flock(handle, fcntl.LOCK_EX)


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _umask() -> int:
    current = os.umask(0)
    os.umask(current)
    return current


def _unwritable(path: Path, error: OSError) -> InputFileError:
    reason = f"{path}: cannot write: {error.strerror or error}"
    return InputFileError(reason, fix=_REMEDIES.get(error.errno or 0, "write somewhere else"))
