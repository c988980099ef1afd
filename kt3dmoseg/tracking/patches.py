"""Windows of gray values about points, seen through an affine map."""

from __future__ import annotations

from typing import cast

import cv2
import numpy as np

from kt3dmoseg.types import ByteArray, Float32Array, FloatArray

_ROWS = 4096  # OpenCV's remap takes fewer than 32,768
_POLE = np.sqrt(8) - 3  # of the inverse of (1, 6, 1) / 8
_SHARPEN = _POLE ** np.abs(np.arange(-4, 5))
_SHARPEN = (_SHARPEN / _SHARPEN.sum()).astype(np.float32)
_EDGE = 2  # pixels beyond which `cv2.pyrUp` takes no account of the lower and right border


def doubled(frame: ByteArray) -> Float32Array:
    """Interpolate a frame (H, W) at every half pixel, (2H, 2W).

    By a cubic spline: `cv2.pyrUp` refines the spline's coefficients, which a filter with the inverse of its
    kernel finds first (Unser, IEEE Signal Processing Magazine 1999). Bilinear look-up in the result errs far
    less than in the frame, and unlike OpenCV's bicubic one (a = -0.75), which is up to 0.05 px off, it is
    exact on a ramp.
    """
    height, width = frame.shape
    around = cv2.copyMakeBorder(frame, 0, _EDGE, 0, _EDGE, cv2.BORDER_REFLECT_101)
    coefficients = cv2.sepFilter2D(around, cv2.CV_32F, _SHARPEN, _SHARPEN, borderType=cv2.BORDER_REFLECT_101)
    return cast(Float32Array, cv2.pyrUp(coefficients)[: 2 * height, : 2 * width])


class Window:
    """A disc of pixels with weights that fall off with the distance from its centre.

    Parameters
    ----------
    radius : int
        R in pixels. The weights are a Gaussian of sigma R / 2: what lies beyond an outline at the rim
        counts little.

    Attributes
    ----------
    lattice : (3, P) float32
        x and y of its pixels from its centre, and 1.
    weight : (P,) float32
        Their weights; the sum is 1.
    """

    def __init__(self, radius: int) -> None:
        side = np.arange(-radius - 1, radius + 2, dtype=np.float32)
        x, y = (axis.ravel() for axis in np.meshgrid(side, side))
        self._disc = np.flatnonzero(x**2 + y**2 <= (radius + 0.5) ** 2)
        self._side = len(side)
        square = np.stack([x, y, np.ones_like(x)])
        self.lattice = square[:, self._disc]
        self._look_square, self._look_disc = _spread(square), _spread(self.lattice)
        weight = np.exp(-2 * (self.lattice[:2] ** 2).sum(axis=0) / radius**2)
        self.weight = cast(Float32Array, weight / weight.sum())

    def look(self, image: Float32Array, place: FloatArray) -> Float32Array:
        """Gray values at A d + x for all offsets d.

        Parameters
        ----------
        image : (2H, 2W) float32
            A frame, `doubled`; beyond its border its edge goes on.
        place : (N, 2, 3) float64
            A and x, in pixels, side by side.

        Returns
        -------
        (N, P) float32
        """
        return _look(image, place, self._look_disc)

    def start(self, image: Float32Array, xy: FloatArray) -> Float32Array:
        """Upright patches about points (N, 2) and their x- and y-derivatives, (N, 3, P)."""
        upright = np.broadcast_to(np.eye(2), (len(xy), 2, 2))
        seen = _look(image, np.concatenate([upright, xy[..., None]], axis=2), self._look_square)
        out = np.empty((len(xy), 3, len(self.weight)), dtype=np.float32)
        out[:, 0] = seen[:, self._disc]
        for row, step in ((1, 1), (2, self._side)):
            out[:, row] = (seen[:, self._disc + step] - seen[:, self._disc - step]) / 2
        return out

    def centred(self, patch: Float32Array) -> Float32Array:
        """Patches (N, P) less their weighted means, so that a change of brightness does not count."""
        return cast(Float32Array, patch - (patch @ self.weight)[:, None])


def _spread(lattice: Float32Array) -> Float32Array:
    """Matrix (6, 2 Q) that takes rows A, x to the positions A d + x in a doubled image, x and y in turns."""
    return (2 * np.eye(2, dtype=np.float32)[:, None, None] * lattice[..., None]).reshape(6, -1)


def _look(image: Float32Array, place: FloatArray, spread: Float32Array) -> Float32Array:
    rows, count = place.reshape(-1, 6).astype(np.float32), spread.shape[1] // 2
    out = np.empty((len(rows), count), dtype=np.float32)
    for first in range(0, len(rows), _ROWS):
        part = slice(first, first + _ROWS)
        at = (rows[part] @ spread).reshape(-1, count, 2)
        out[part] = cv2.remap(  # type: ignore[call-overload]  # the stubs do not know that one map may do
            image, at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
    return out
