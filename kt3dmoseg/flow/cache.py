"""A content-addressed store of flow fields.

The name of an entry is the hash of everything the field depends on: both frames, the backend's class,
parameters and source, and the versions of the packages it computes with. Nothing is ever looked up by
file name or date, so an entry cannot be stale; one that is damaged is computed anew.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import sys
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from kt3dmoseg import __version__
from kt3dmoseg.errors import InputFileError
from kt3dmoseg.files import read_bytes, sha256_arrays, sha256_file, sha256_files, write_bytes
from kt3dmoseg.flow.base import Flow
from kt3dmoseg.types import ByteArray, Float32Array

_MAGIC = b"kt3dmoseg flow 1\n"
_PACKAGES = (
    "numpy",
    "opencv-python-headless",
    "opencv-python",
    "opencv-contrib-python-headless",
    "torch",
    "torchvision",
)
_HEADER_ROOM = 4096


class FlowCache:
    """Flow fields in a folder, one file each, written atomically.

    Several processes may share a folder. Two kinds of backend are computed every time: those that are
    no dataclasses, since their parameters cannot be told, and those whose class says ``uncached = True``,
    since they depend on more than their parameters (files). A parameter that names one file, listed in the
    class's ``files``, counts by the file's content.

    Parameters
    ----------
    folder : path-like
        Where the entries lie; made when missing.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)

    def get(self, flow: Flow, a: ByteArray, b: ByteArray) -> Float32Array:
        """Return ``flow(a, b)``, from the store when it is there.

        Raises
        ------
        InputFileError
            When the folder cannot be written.
        """
        identity = backend_identity(flow)
        if identity is None:
            return flow(a, b)
        key = hashlib.sha256(f"{identity}\n{sha256_arrays(a, b)}".encode()).hexdigest()
        path = self.folder / key[:2] / f"{key}.flow"
        shape = (*a.shape, 2)
        stored = _read(path, key, shape)
        if stored is not None:
            return stored
        field = flow(a, b)
        write_bytes(path, _encode(key, field))
        return field


def flow_pair(
    flow: Flow, a: ByteArray, b: ByteArray, cache: FlowCache | None = None
) -> tuple[Float32Array, Float32Array]:
    """Forward flow of `a` to `b` and backward flow of `b` to `a`, each (H, W, 2) float32.

    Parameters
    ----------
    flow : Flow
        The backend.
    a, b : (H, W) uint8
        Frames.
    cache : FlowCache or None
        Where to look first and to keep the result.
    """
    if cache is None:
        return flow(a, b), flow(b, a)
    return cache.get(flow, a, b), cache.get(flow, b, a)


def backend_identity(flow: Flow) -> str | None:
    """Everything but the frames that a field depends on, as one line of JSON; None when unknown."""
    cls: type[Any] = type(flow)
    if not dataclasses.is_dataclass(cls) or getattr(flow, "uncached", False):
        return None
    parameters = {f.name: getattr(flow, f.name) for f in dataclasses.fields(cls) if f.init}
    files = {name: sha256_file(parameters[name]) for name in getattr(cls, "files", ()) if parameters[name]}
    return json.dumps(
        {
            "backend": f"{cls.__module__}:{cls.__qualname__}",
            "parameters": {name: repr(value) for name, value in parameters.items()} | files,
            "source": _source(cls.__module__),
            "versions": _versions(),
        },
        sort_keys=True,
    )


@cache
def _source(module: str) -> str:
    """Hash of the backend's module and of this package: a changed algorithm makes new entries."""
    own = getattr(sys.modules.get(module), "__file__", None)
    files = sorted(Path(__file__).parent.glob("*.py")) + ([Path(own)] if own else [])
    return sha256_files(files)


@cache
def _versions() -> dict[str, str]:
    found = {"kt3dmoseg": __version__}
    for package in _PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


def _encode(key: str, field: Float32Array) -> bytes:
    payload = np.ascontiguousarray(field, dtype="<f4").tobytes()
    header = {"key": key, "shape": list(field.shape), "sha256": hashlib.sha256(payload).hexdigest()}
    return _MAGIC + json.dumps(header).encode() + b"\n" + payload


def _read(path: Path, key: str, shape: tuple[int, ...]) -> Float32Array | None:
    """Read an entry; None when it is absent or not exactly what was written."""
    size = 4 * int(np.prod(shape))
    try:
        content = read_bytes(path, _HEADER_ROOM + size)
    except InputFileError:
        return None
    magic, header, payload = content[: len(_MAGIC)], *content[len(_MAGIC) :].partition(b"\n")[::2]
    digest = hashlib.sha256(payload).hexdigest()
    expected = {"key": key, "shape": list(shape), "sha256": digest}
    if magic != _MAGIC or len(payload) != size or header != json.dumps(expected).encode():
        return None
    return np.frombuffer(payload, dtype="<f4").reshape(shape).astype(np.float32)
