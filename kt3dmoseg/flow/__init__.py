"""Optical flow: one frozen dataclass per backend, the table of their names, and a cache of their fields.

>>> flow = create("dis")
>>> field = flow(a, b)  # (H, W, 2) float32  # doctest: +SKIP
"""

from __future__ import annotations

import builtins
import dataclasses
import os
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import cv2
import numpy as np

from kt3dmoseg.files import sha256_file
from kt3dmoseg.flow.base import Flow, check_pair, sample
from kt3dmoseg.options import from_mapping
from kt3dmoseg.parallel import Cache, algorithm_version, cache_key
from kt3dmoseg.registry import Registry
from kt3dmoseg.types import ByteArray, Float32Array

ALGORITHM_VERSION = 1
"""Raised when a backend of this package computes other fields."""

FLOWS = Registry(
    "flow",
    {
        "dis": "kt3dmoseg.flow.pyramid:VariationalPyramid",
        "dis_medium": "kt3dmoseg.flow.opencv:DisMedium",
        "farneback": "kt3dmoseg.flow.opencv:Farneback",
        "files": "kt3dmoseg.flow.from_files:FlowFiles",
        "raft": "kt3dmoseg.flow.raft:Raft",
    },
    group="kt3dmoseg.flows",
)

__all__ = ["FLOWS", "Flow", "FlowCache", "check_pair", "create", "flow_pair", "list", "sample"]


def list() -> builtins.list[str]:
    """Names of all flow backends, third parties' included."""
    return FLOWS.names()


def create(name: str, **parameters: Any) -> Flow:  # noqa: ANN401
    """Make a flow backend from its name and parameters.

    Parameters
    ----------
    name : str
        A name of `list`.
    **parameters
        Fields of the backend's dataclass; strings are converted.

    Raises
    ------
    UnknownNameError
        For an unknown backend or a misspelt parameter, with the nearest name.
    InvalidValueError
        For a parameter of the wrong type or out of bounds.
    MissingDependencyError
        When the backend needs a package that is not installed.
    """
    backend: Flow = from_mapping(FLOWS.load(name), parameters, where=f"flow {name}")
    return backend


class FlowCache:
    """Flow fields in a folder, found by both frames and everything that `backend_identity` lists.

    Several processes may share the folder. A backend without an identity is computed every time.

    Parameters
    ----------
    folder : path
        Where the fields lie; made when missing.
    """

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self._cache = Cache(folder)

    def get(self, flow: Flow, a: ByteArray, b: ByteArray) -> Float32Array:
        """Return ``flow(a, b)``, (H, W, 2) float32, from the folder when it is there.

        Raises
        ------
        InputFileError
            When the folder cannot be written.
        """
        identity = backend_identity(flow)
        if identity is None:
            return flow(a, b)
        key = cache_key({**identity, "frames": [a, b]})
        stored = self._cache.get(key)
        if stored is not None:
            return stored["flow"]
        field = flow(a, b)
        self._cache.put(key, {"flow": field})
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


def backend_identity(flow: Flow) -> dict[str, Any] | None:
    """Everything but the frames that a field depends on: class, parameters and versions, as JSON values.

    None for a backend that is no dataclass or states no version (`kt3dmoseg.parallel.algorithm_version`), and
    for one whose class says ``uncached = True``, since it depends on more than its parameters (files). A
    parameter that is listed in the class's ``files`` counts by the content of the file it names; ``packages``
    lists what it computes with beyond numpy and OpenCV.
    """
    cls: type[Any] = type(flow)
    algorithm = algorithm_version(cls)
    if algorithm is None or not dataclasses.is_dataclass(cls) or getattr(cls, "uncached", False):
        return None
    parameters = {f.name: getattr(flow, f.name) for f in dataclasses.fields(cls) if f.init}
    files = {name: sha256_file(parameters[name]) for name in getattr(cls, "files", ()) if parameters[name]}
    return {
        "backend": f"{cls.__module__}:{cls.__qualname__}",
        "parameters": {name: repr(value) for name, value in parameters.items()} | files,
        "algorithm": algorithm,
        "versions": {"numpy": np.__version__, "opencv": cv2.__version__}
        | {package: _version(package) for package in getattr(cls, "packages", ())},
    }


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
