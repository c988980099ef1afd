"""Hartley's normalisation: centroid to the origin, mean distance to sqrt 2."""

from __future__ import annotations

import numpy as np

from kt3dmoseg.types import FloatArray

_SQRT2 = float(np.sqrt(2.0))


def normalise(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Translate and scale sets of points to a common size.

    Parameters
    ----------
    points : (..., P, 2) float64
        One or many sets of points.

    Returns
    -------
    normalised : (..., P, 2) float64
        The points with their centroid at the origin and mean distance sqrt 2 from it. A set whose
        points all coincide is only translated.
    transform : (..., 3, 3) float64
        The similarity that does it, on homogeneous columns.

    References
    ----------
    Hartley, "In defense of the eight-point algorithm", TPAMI 1997, section 4.
    """
    centroid = points.mean(axis=-2, keepdims=True)
    centred = points - centroid
    distance = np.sqrt(np.einsum("...pc,...pc->...p", centred, centred)).mean(axis=-1)
    scale = np.ones_like(distance)
    # Below a billionth of the coordinates the spread is rounding, not geometry.
    spread = distance > 1e-9 * (1.0 + np.abs(centroid[..., 0, :]).max(axis=-1))
    np.divide(_SQRT2, distance, out=scale, where=spread)
    transform = np.zeros((*points.shape[:-2], 3, 3))
    transform[..., 0, 0] = transform[..., 1, 1] = scale
    transform[..., :2, 2] = -scale[..., None] * centroid[..., 0, :]
    transform[..., 2, 2] = 1.0
    return centred * scale[..., None, None], transform


def inverse(transform: FloatArray) -> FloatArray:
    """Invert similarities of the form [s 0 a; 0 s b; 0 0 1], (..., 3, 3)."""
    out = np.zeros_like(transform)
    scale = transform[..., 0, 0]
    out[..., 0, 0] = out[..., 1, 1] = 1.0 / scale
    out[..., :2, 2] = -transform[..., :2, 2] / scale[..., None]
    out[..., 2, 2] = 1.0
    return out


def before(models: FloatArray, transform: FloatArray) -> FloatArray:
    """Multiply models by similarities [s 0 a; 0 s b; 0 0 1] from the right, both (..., 3, 3).

    Written out, because products of many small matrices spend their time on calls.
    """
    scale, a, b = (transform[..., i, j, None] for i, j in ((0, 0), (0, 2), (1, 2)))
    first, second, third = models[..., 0], models[..., 1], models[..., 2]
    return np.stack([first * scale, second * scale, first * a + second * b + third], axis=-1)


def after(transform: FloatArray, models: FloatArray) -> FloatArray:
    """Multiply models by similarities from the left; see `before`."""
    scale, a, b = (transform[..., i, j, None] for i, j in ((0, 0), (0, 2), (1, 2)))
    first, second, third = models[..., 0, :], models[..., 1, :], models[..., 2, :]
    return np.stack([first * scale + third * a, second * scale + third * b, third], axis=-2)
