"""Optical flow: what a backend is, the table of their names, a cache of their fields, and what they share.

>>> flow = create("dis")
>>> field = flow(a, b)  # (H, W, 2) float32  # doctest: +SKIP
"""

import builtins
import dataclasses
import os
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import Any, Protocol, runtime_checkable

import cv2
import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.files import sha256_file
from kt3dmoseg.options import from_mapping
from kt3dmoseg.parallel import Cache, algorithm_version, cache_key
from kt3dmoseg.registry import Registry
from kt3dmoseg.types import ByteArray, Float32Array, FloatArray

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

__all__ = ["FLOWS", "Flow", "cached_flow", "check_pair", "create", "flow_pair", "list", "sample", "smooth"]

_MIN_SIDE = 32
_NEGLIGIBLE = 12.0  # radius of the kernel of `smooth`, in its decay lengths

# glibc gives freed memory back to the system beyond twice the largest block that was freed, of up to 32 MB.
# To fetch it again for every frame takes as long as to compute in it.
np.empty((32 << 20) - (1 << 16), np.uint8)


@runtime_checkable
class Flow(Protocol):
    """Dense optical flow between two frames; a frozen dataclass of its parameters."""

    def __call__(self, a: ByteArray, b: ByteArray) -> Float32Array:
        """Displacement of every pixel of `a` on its way to `b`.

        Parameters
        ----------
        a, b : (H, W) uint8
            Gray frames of the same size.

        Returns
        -------
        (H, W, 2) float32
            (x right, y down) in pixels: pixel p of `a` lies at p + flow[p] in `b`.
        """
        ...


def check_pair(a: ByteArray, b: ByteArray) -> None:
    """Raise an `InvalidValueError` for frames that no backend can work on; see `check_frame`."""
    check_frame("first frame", a)
    check_frame("second frame", b, a.shape)


def check_frame(name: str, frame: ByteArray, first: tuple[int, ...] | None = None) -> None:
    """Reject a frame that is not (H, W) uint8, differs in size from the first, or has a side under 32 pixels.

    OpenCV's DIS crashes on thinner frames instead of raising.
    """
    if not isinstance(frame, np.ndarray) or frame.ndim != 2 or frame.dtype != np.uint8:
        found = f"{getattr(frame, 'dtype', type(frame).__name__)} of shape {np.shape(frame)}"
        raise InvalidValueError(name, expected="a gray frame, (H, W) uint8", found=found)
    if np.ma.is_masked(frame):
        raise InvalidValueError(name, expected="no masked pixels", found="some", fix="fill them first")
    size, fix = f"{frame.shape[1]}x{frame.shape[0]}", "enlarge it first"
    if min(frame.shape) < _MIN_SIDE:
        raise InvalidValueError(name, expected=f"sides of at least {_MIN_SIDE} pixels", found=size, fix=fix)
    if first is not None and frame.shape != first:
        expected, fix = f"{first[1]}x{first[0]} pixels like the first frame", "give frames of one size"
        raise InvalidValueError(name, expected=expected, found=size, fix=fix)


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


def flow_pair(
    flow: Flow, a: ByteArray, b: ByteArray, folder: str | os.PathLike[str] | None = None
) -> tuple[Float32Array, Float32Array]:
    """Forward flow of `a` to `b` and backward flow of `b` to `a`, (H, W, 2) float32; see `cached_flow`."""
    return cached_flow(flow, a, b, folder), cached_flow(flow, b, a, folder)


def cached_flow(
    flow: Flow, a: ByteArray, b: ByteArray, folder: str | os.PathLike[str] | None
) -> Float32Array:
    """Return ``flow(a, b)``, (H, W, 2) float32, from a folder when it is there, and keep it there.

    Fields are found by both frames and everything that `backend_identity` lists; a backend without an
    identity is computed every time. Several processes may share the folder.

    Raises
    ------
    InputFileError
        When the folder cannot be written.
    """
    identity = None if folder is None else backend_identity(flow)
    if identity is None:
        return flow(a, b)
    cache, key = Cache(folder), cache_key({**identity, "frames": [a, b]})
    stored = cache.get(key)
    if stored is not None:
        return stored["flow"]
    field = flow(a, b)
    cache.put(key, {"flow": field})
    return field


def backend_identity(flow: Flow) -> dict[str, Any] | None:
    """Everything but the frames that a field depends on: class, parameters and versions, as JSON values.

    None for a backend that is no dataclass or states no version (`kt3dmoseg.parallel.algorithm_version`), or
    whose class has ``uncached = True``. The class's ``files`` lists the parameters that count by the content
    of the file they name, ``packages`` what it computes with beyond numpy and OpenCV.
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


def sample(field: npt.NDArray[Any], xy: npt.ArrayLike) -> FloatArray:
    """Interpolate a field (H, W) or (H, W, C) at points (N, 2) bilinearly; outside, its edge goes on.

    Returns (N,) or (N, C) float64: NaN at a point that is NaN or next to one where the field is. Plain numpy,
    since ``cv2.remap`` rounds coordinates to 1/32 pixel up to OpenCV 4.
    """
    points = np.asarray(xy, dtype=np.float64).reshape(-1, 2)
    height, width = field.shape[:2]
    x = np.clip(points[:, 0], 0, width - 1)
    y = np.clip(points[:, 1], 0, height - 1)
    left = np.minimum(np.nan_to_num(x).astype(np.intp), width - 2)
    top = np.minimum(np.nan_to_num(y).astype(np.intp), height - 2)
    shape = (-1,) + (1,) * (field.ndim - 2)
    fx, fy = (x - left).reshape(shape), (y - top).reshape(shape)
    values, at = field.reshape(height * width, *field.shape[2:]), top * width + left
    upper = values.take(at, axis=0) * (1 - fx) + values.take(at + 1, axis=0) * fx
    lower = values.take(at + width, axis=0) * (1 - fx) + values.take(at + width + 1, axis=0) * fx
    return np.asarray(upper * (1 - fy) + lower * fy)


def smooth(image: Float32Array, sigma: float, out: Float32Array | None = None) -> Float32Array:
    """Smooth an image as the release's tracker did; sigma 0 leaves it as it is.

    A Gaussian is approximated: the kernel is (1 + a |x|) exp(-a |x|) with a = 2.5 / (sqrt(pi) sigma),
    normalised (Deriche, "Fast algorithms for low-level vision", PAMI 1990). Its tails are longer
    than a Gaussian's: its standard deviation is 2 / a = 1.42 sigma. It is usually run as a recursive filter;
    at these widths a finite kernel cut where it has fallen to about 1e-4 is quicker. Beyond its
    border the image (H, W) is mirrored; `sigma` is in pixels. `out` is filled, and may be the image.
    """
    if sigma <= 0:
        return image
    kernel = _kernel(sigma)
    smoothed = cv2.sepFilter2D(image, cv2.CV_32F, kernel, kernel, out, borderType=cv2.BORDER_REFLECT)
    return np.asarray(smoothed, np.float32)


@cache
def _kernel(sigma: float) -> Float32Array:
    decay = 2.5 / (np.sqrt(np.pi) * sigma)
    radius = int(np.ceil(_NEGLIGIBLE / decay))
    x = decay * np.abs(np.arange(-radius, radius + 1))
    kernel = (1 + x) * np.exp(-x)
    return np.asarray(kernel / kernel.sum(), np.float32)
