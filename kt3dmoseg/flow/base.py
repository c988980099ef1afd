"""What flow backends are and share: their contract, the check of frames, smoothing and look-up."""

from __future__ import annotations

from functools import cache
from typing import Any, Protocol, cast, runtime_checkable

import cv2
import numpy as np
import numpy.typing as npt

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.types import ByteArray, Float32Array, FloatArray

MIN_SIDE = 32
_NEGLIGIBLE = 12.0  # kernel radius in decay lengths


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
    """Reject what no backend can work on.

    Raises
    ------
    InvalidValueError
        When a frame is not (H, W) uint8, the two differ in size, or a side is under 32 pixels
        (OpenCV's DIS crashes on thinner frames instead of raising).
    """
    for name, frame in (("first frame", a), ("second frame", b)):
        if not isinstance(frame, np.ndarray) or frame.ndim != 2 or frame.dtype != np.uint8:
            found = f"{getattr(frame, 'dtype', type(frame).__name__)} of shape {np.shape(frame)}"
            raise InvalidValueError(name, expected="a gray frame, (H, W) uint8", found=found)
        if min(frame.shape) < MIN_SIDE:
            raise InvalidValueError(
                name,
                expected=f"sides of at least {MIN_SIDE} pixels",
                found=_size(frame),
                fix="enlarge it first",
            )
    if a.shape != b.shape:
        raise InvalidValueError("second frame", expected=f"{_size(a)} pixels like the first", found=_size(b))


def _size(frame: ByteArray) -> str:
    height, width = frame.shape
    return f"{width}x{height}"


def sample(field: npt.NDArray[Any], xy: npt.ArrayLike) -> FloatArray:
    """Interpolate a field bilinearly in plain numpy; outside, its edge goes on.

    ``cv2.remap`` is not used: up to OpenCV 4 it rounds coordinates to 1/32 pixel.

    Parameters
    ----------
    field : (H, W) or (H, W, C)
        Values at the pixel centres.
    xy : (N, 2)
        Points in pixels, x right, y down.

    Returns
    -------
    (N,) or (N, C) float64
        The field at the points; NaN at a point that is NaN or next to one where the field is.
    """
    points = np.asarray(xy, dtype=np.float64).reshape(-1, 2)
    height, width = field.shape[:2]
    x = np.clip(points[:, 0], 0, width - 1)
    y = np.clip(points[:, 1], 0, height - 1)
    left = np.minimum(np.nan_to_num(x).astype(np.intp), width - 2)
    top = np.minimum(np.nan_to_num(y).astype(np.intp), height - 2)
    shape = (-1,) + (1,) * (field.ndim - 2)
    fx, fy = (x - left).reshape(shape), (y - top).reshape(shape)
    upper = field[top, left] * (1 - fx) + field[top, left + 1] * fx
    lower = field[top + 1, left] * (1 - fx) + field[top + 1, left + 1] * fx
    result: FloatArray = upper * (1 - fy) + lower * fy
    return result


def smooth(image: Float32Array, sigma: float) -> Float32Array:
    """Smooth an image as the release's tracker did; sigma 0 leaves it as it is.

    A Gaussian is approximated: the kernel is (1 + a |x|) exp(-a |x|) with a = 2.5 / (sqrt(pi) sigma),
    normalised (Deriche, "Fast algorithms for low-level vision", PAMI 1990). Its tails are longer
    than a Gaussian's: its standard deviation is 2 / a = 1.42 sigma. It is usually run as a recursive filter;
    at these widths a finite kernel cut where it has fallen to about 1e-4 is quicker. Beyond its
    border the image (H, W) is mirrored; `sigma` is in pixels.
    """
    if sigma <= 0:
        return image
    kernel = _kernel(sigma)
    return cast(
        Float32Array, cv2.sepFilter2D(image, cv2.CV_32F, kernel, kernel, borderType=cv2.BORDER_REFLECT)
    )


@cache
def _kernel(sigma: float) -> Float32Array:
    decay = 2.5 / (np.sqrt(np.pi) * sigma)
    radius = int(np.ceil(_NEGLIGIBLE / decay))
    x = decay * np.abs(np.arange(-radius, radius + 1))
    kernel = (1 + x) * np.exp(-x)
    return cast(Float32Array, (kernel / kernel.sum()).astype(np.float32))
