"""What a flow backend is, and the check of its input that all of them share."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np

from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.types import ByteArray, Float32Array

MIN_SIDE = 32


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
    """Refuse what no backend can work on.

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
